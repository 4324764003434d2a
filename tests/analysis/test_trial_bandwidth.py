"""Who chooses the bandwidth of a trial, what is told of it, and what follows from it."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaitcal.analysis.calibrate import calibrate
from gaitcal.analysis.prepared_trials import MovingTrial, choose_force_cutoff, prepare_trial
from gaitcal.analysis.trial_bandwidth import JOINTS_HZ, REACH, Bandwidth, ChosenBy
from gaitcal.analysis.trial_result import analyse
from gaitcal.dynamics.ground_reactions import FORCE_HZ, GroundReactions, compute_motion_reactions
from gaitcal.dynamics.inverse_dynamics import Dynamics
from gaitcal.errors import Code
from gaitcal.io.recording import ForcePlate, Recording
from gaitcal.model.nominal import published_model
from gaitcal.preprocess.static_disagreement import PossibleMove
from gaitcal.results.summary import summarise_calibration, summarise_trial
from gaitcal.study.settings import CalibrationSettings
from gaitcal.study.study import Study
from gaitcal.study.study_trial import Role, Trial
from gaitcal.synthetic.synthetic_motion import simulate_gait, simulate_isolated_trial
from gaitcal.tracking.bandwidth import DenseMotion
from gaitcal.tracking.motion import Motion, track_motion
from tests.messages import check_finding, check_text, refuses
from tests.synthetic_studies import made_plates, made_recording, write_synthetic_study

MODEL = published_model()


def noisy(recording: Recording, deviation: float) -> Recording:
    noise = np.random.default_rng(71).normal(0, deviation, recording.markers.shape)
    return replace(recording, markers=recording.markers + noise)


def walk(deviation: float = 0.001, plates: Sequence[ForcePlate] = ()) -> Trial:
    recording = replace(noisy(made_recording(simulate_gait()), deviation), plates=tuple(plates))
    return Trial(name="walk", role=Role.GAIT, recording=recording)


def prepared(trial: Trial, **settings: object) -> MovingTrial:
    return prepare_trial(trial, MODEL, CalibrationSettings(**settings))


def reactions(trial: MovingTrial, hz: float | None = FORCE_HZ) -> tuple[Motion, GroundReactions]:
    """The trial tracked, and the ground's reactions to it, filtered at so many Hz."""
    motion = track_motion(trial.whole_body_problem, MODEL.parameters)
    return motion, compute_motion_reactions(
        MODEL, MODEL.parameters, motion, trial.recording, {}, hz
    )


def cutoffs(trial: MovingTrial) -> list[float | None]:
    return [
        p.smoothing.cutoff_hz if p.smoothing else None
        for p in (trial.whole_body_problem, trial.reported_problem)
    ]


def test_markers_choose_without_plates() -> None:
    recording = noisy(made_recording(simulate_isolated_trial("knee_r")), 0.001)
    for trial in (
        walk(),
        Trial(name="knee_r", role=Role.JOINT, joint="knee_r", recording=recording),
    ):
        found = prepared(trial)
        told = found.bandwidth
        assert told.chosen_by is ChosenBy.MARKERS and told.joints_hz == max(
            told.motion_hz, JOINTS_HZ
        )
        assert cutoffs(found) == [told.motion_hz, told.joints_hz]
        assert told.findings == ()
        check_text(told.notes[0], f"{told.motion_hz:.1f}")
        # an isolated trial is judged by what its joint parameters are fitted to
        assert told.motion_hz == pytest.approx(
            DenseMotion(found.reported_problem, MODEL.parameters).choose_cutoff(), rel=1e-6
        )


def test_the_frame_rate_is_named_where_it_sets_the_limit() -> None:
    found = prepared(walk(0.0)).bandwidth
    assert found.motion_hz == pytest.approx(25.0)
    check_text(found.notes[0], 200)


def test_plates_bring_motion_and_forces_together() -> None:
    plates = made_plates(simulate_gait())
    found = prepared(walk(0.002, plates))
    told, markers = found.bandwidth, prepared(walk(0.002)).bandwidth
    assert told.chosen_by is ChosenBy.PLATES and told.motion_hz != markers.motion_hz
    assert markers.motion_hz / REACH <= told.motion_hz <= markers.motion_hz * REACH
    assert told.joints_hz == max(markers.motion_hz, told.motion_hz, JOINTS_HZ)
    assert cutoffs(found) == [told.motion_hz, told.joints_hz]
    check_text(told.notes[0], f"{markers.motion_hz:.1f}")

    def residual(hz: float) -> float:
        motion, ground = reactions(prepared(walk(0.002, plates), bandwidth_hz=hz))
        state = (motion.q, motion.velocity, motion.acceleration)
        forces = Dynamics(MODEL.parameters).compute_forces(*state, ground.wrench)[24:-24, :3]
        return float(np.sqrt(np.mean(forces**2)))

    chosen = residual(told.motion_hz)
    assert chosen < 1.02 * min(residual(hz) for hz in (told.motion_hz / REACH, markers.motion_hz))


def test_plates_that_do_not_tell_have_no_say() -> None:
    """Where a plate reads 300 N too much, that is what F is made of, and no cut-off changes much of
    it.
    """
    plates = made_plates(simulate_gait())
    for force in (lambda f: f + [0.0, 300.0, 0.0] * (f[:, 1:2] > 20.0), np.zeros_like):
        trial = prepared(
            walk(0.002, [replace(plate, force=force(plate.force)) for plate in plates])
        )
        assert trial.bandwidth.chosen_by is ChosenBy.MARKERS
        assert trial.bandwidth.motion_hz == prepared(walk(0.002)).bandwidth.motion_hz


def test_plates_that_would_go_far_have_no_say() -> None:
    """All markers shake at 10 Hz, which they cannot tell from motion; with F alone 6.5 Hz would
    remain of 16.
    """
    trial = walk(0.0003, made_plates(simulate_gait()))
    shaken = trial.recording.markers.copy()
    shaken[:, :, 1] += 0.001 * np.sin(2 * np.pi * 10.0 * trial.recording.time)[:, None]
    told = prepared(replace(trial, recording=replace(trial.recording, markers=shaken))).bandwidth
    assert told.chosen_by is ChosenBy.MARKERS and told.motion_hz > 10.0


def test_given_by_the_settings() -> None:
    smoothed = prepared(walk(), bandwidth_hz=5.0)
    assert smoothed.bandwidth.chosen_by is ChosenBy.GIVEN and cutoffs(smoothed) == [5.0] * 2
    for settings, spans in (({"nodes": 25}, 20), ({"nodes_per_second": 15.0}, 16)):
        plain = prepared(walk(), **settings)
        assert plain.bandwidth.chosen_by is ChosenBy.GIVEN and cutoffs(plain) == [None] * 2
        assert plain.whole_body_problem.basis.control_points == spans + 5
        assert plain.bandwidth.motion_hz == pytest.approx(0.5 * spans / 1.035)
    with refuses(ValueError, "bandwidth_hz"):
        CalibrationSettings(bandwidth_hz=6.0, nodes=20)
    with refuses(ValueError, "'auto'"):
        CalibrationSettings(bandwidth_hz="automatic")  # type: ignore[arg-type]


def test_a_fit_that_suffers_is_told() -> None:
    for settings in ({"bandwidth_hz": 2.0}, {"nodes_per_second": 3.0}):
        (told,) = prepared(walk(), **settings).bandwidth.findings
        check_finding(told, Code.SMOOTHED_TOO_MUCH)
    assert prepared(walk(), bandwidth_hz=12.0).bandwidth.findings == ()


@pytest.mark.parametrize(
    "rate, hz, words",
    [(100.0, 50.0, "not filtered"), (100.0, 20.0, "at 20.0 Hz"), (200.0, 50.0, "50.0")],
)
def test_a_slow_plate_is_not_filtered(rate: float, hz: float, words: str) -> None:
    step, parts = round(200.0 / rate), ("time", "force", "point", "moment")
    plates = [
        replace(p, **{name: getattr(p, name)[::step] for name in parts})
        for p in made_plates(simulate_gait())
    ]
    _, ground = reactions(prepared(walk(0.0, plates)), hz)
    assert ground.valid.any()
    assert [note for note in ground.notes if "filtered" in note and words in note]


def test_forces_are_filtered_at_50_hz_or_like_the_motion() -> None:
    trial = prepared(walk(0.001))
    motion = track_motion(trial.whole_body_problem, MODEL.parameters)
    assert choose_force_cutoff(trial, motion, CalibrationSettings()) == FORCE_HZ == 50.0
    matched = choose_force_cutoff(trial, motion, CalibrationSettings(force_filter_hz="matched"))
    assert matched == pytest.approx(0.863 * trial.bandwidth.motion_hz, rel=1e-3)

    def first_valid(hz: float) -> float:
        own, ground = reactions(prepared(walk(0.0, made_plates(simulate_gait())), bandwidth_hz=hz))
        return float(own.time[ground.valid][0])

    assert first_valid(2.5) == pytest.approx(0.2, abs=0.01) and first_valid(10.0) < 0.11


@pytest.mark.slow
def test_summary_and_notes_tell_it(tmp_path: Path) -> None:
    study = Study.load(
        write_synthetic_study(tmp_path, ("knee_r",), more='[calibration]\nip = "none"\n')
    )
    done = calibrate(study)
    trials = summarise_calibration(done)["trials"]
    assert isinstance(trials, dict)
    for name in ("walk", "knee_r"):
        told, entry = done.trial(name).bandwidth, trials[name]
        assert isinstance(told, Bandwidth) and isinstance(entry, dict)
        assert entry["bandwidth_hz"] == pytest.approx(told.motion_hz, abs=1e-3)
        assert entry["bandwidth_by"] == told.chosen_by.value
        assert f"{name}: {told.notes[0]}" in done.notes
    turned = {"thigh_r": PossibleMove(np.array([0.0, 0.2, 0.0]), 0.0)}
    further = analyse(done.model, study.moving[0], study.settings, done.uncertainty, turned)
    k = further.body.coordinates.index("hip_rotation_r")
    assert (
        further.coordinate_errors[:, k].mean()
        > 0.2
        > done.trial("walk").coordinate_errors[:, k].mean()
    )
    assert summarise_trial(further, done.verdict)["bandwidth_by"] == trials["walk"]["bandwidth_by"]  # type: ignore[index,call-overload]
