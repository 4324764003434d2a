"""Findings on the forces of a session."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from gaitcal.analysis.calibrate import calibrate
from gaitcal.analysis.trial_result import analyse
from gaitcal.dynamics.foot_contact import FootPoints
from gaitcal.dynamics.inverse_dynamics import Dynamics
from gaitcal.errors import STUDY, Code, Severity
from gaitcal.io.csv_recordings import write_forces_csv
from gaitcal.io.recording import ForcePlate, Recording
from gaitcal.model.anthropometry import move_limb_inertia
from gaitcal.model.nominal import nominal_model
from gaitcal.model.segment_frames import HipCentre
from gaitcal.model.subject_model import GRAVITY
from gaitcal.quality import force_choice, force_evidence
from gaitcal.quality.force_causes import ForceFault, list_causes
from gaitcal.quality.force_choice import ForceFit, choose
from gaitcal.quality.force_diagnosis import compute_torque_change, find_force_faults
from gaitcal.quality.force_evidence import FORCE_UNITS
from gaitcal.study.study import Study
from gaitcal.synthetic.synthetic_motion import simulate_gait
from tests.kept import kept_synthetic
from tests.messages import check_finding, check_text, numbers
from tests.quality.spoilt import plates, times
from tests.quality.walks import Walk, exact_walk, tracked
from tests.synthetic_studies import made_plates, write_synthetic_study

LATE = 0.06
MS = 8.0
"""Tolerance of a clock on a real walk."""


def later(plate: ForcePlate) -> ForcePlate:
    """LATE s late, on the same time axis."""
    moved = {
        name: np.stack(
            [np.interp(plate.time - LATE, plate.time, c) for c in getattr(plate, name).T], axis=1
        )
        for name in ("force", "point", "moment")
    }
    return replace(plate, **moved)


WEIGHT = 72.6 * GRAVITY  # N, of subject01


@pytest.fixture(scope="module")
def real_walk(real_study: Callable[[str], Study]) -> Walk:
    """subject01 with its nominal model: enough for faults as large as these."""
    study = real_study("subject01")
    model = nominal_model(
        study.static.recording, study.marker_set, study.subject, hip_centre=HipCentre("bell")
    )
    recording = study.moving[0].recording
    return Walk(model, recording, tracked(model, recording))


def test_a_leaning_force_on_a_step_is_under_the_foot_on_it() -> None:
    """By hand: 130 mm before the toe, and on the floor, 0.2 m lower, a fifth of that further:
    170 mm. Level plates with the centre there are off the feet.
    """
    time, height = np.arange(0.0, 1.0, 0.01), 0.2
    heel, toe = np.zeros((len(time), 2, 3)), np.zeros((len(time), 2, 3))
    heel[:, :, 0], toe[:, :, 0] = -0.2, 0.0
    speed = np.zeros((len(time), 2))
    feet = FootPoints(heel=heel, toe=toe, tip=toe, heel_speed=speed, toe_speed=speed)
    force = np.tile([-140.0, 700.0, 0.0], (len(time), 1))

    def is_off(ahead: float, height: float) -> bool:
        point = np.tile([ahead, height, 0.0], (len(time), 1))
        plate = ForcePlate(name="1", time=time, force=force, point=point, moment=0.0 * force)
        return force_evidence._is_off_feet((plate,), np.zeros((1, len(time)), int), time, feet)

    assert not is_off(0.13, height)
    assert is_off(0.17, height) and is_off(0.17, 0.0)


@pytest.mark.parametrize(
    ("fault", "code", "name"),
    [
        (lambda p: replace(p, force=p.force / FORCE_UNITS["kgf"]), Code.FORCE_UNIT, "kgf"),
        (lambda p: replace(p, force=p.force / WEIGHT), Code.FORCE_UNIT, "body weights"),
        (lambda p: replace(p, force=p.force * [-1, 1, 1]), Code.FORCE_SIGN, "fore-aft"),
        (lambda p: replace(p, moment=1e3 * p.moment), Code.FORCE_UNIT, "N·mm"),
        (times(2.0), Code.FORCE_GAIN, "2"),
    ],
)
def test_faults_of_a_real_walk_are_errors_and_named(
    real_walk: Walk, fault: Callable[[ForcePlate], ForcePlate], code: Code, name: str
) -> None:
    diagnosis = find_force_faults([real_walk.evidence(plates(fault))])
    (finding,) = diagnosis.findings
    check_finding(finding, code, Severity.ERROR, name)
    assert finding.weight > 1.0 and finding.cure
    assert diagnosis.faulty == {"walk"}


def test_time_offset_of_a_real_walk_is_reported_in_milliseconds(real_walk: Walk) -> None:
    (finding,) = find_force_faults([real_walk.evidence(plates(later))]).findings
    check_finding(finding, Code.CLOCKS_DIFFER)
    assert numbers(finding.cause) == [pytest.approx(1e3 * LATE, abs=MS)]


def test_clean_real_walk_has_no_findings(real_walk: Walk) -> None:
    diagnosis = find_force_faults([real_walk.evidence()])
    assert diagnosis.findings == () and not diagnosis.faulty


def test_a_moderate_fault_is_a_warning() -> None:
    (finding,) = find_force_faults([exact_walk().evidence(plates(times(1.1)))]).findings
    assert finding.severity is Severity.WARNING and 0.0 < finding.weight < 1.0
    check_finding(finding, Code.FORCE_GAIN, "mass_kg")
    assert any(9 <= number <= 11 for number in numbers(finding.evidence))


def test_common_fault_gives_one_finding_and_single_fault_names_its_trial() -> None:
    walk = exact_walk()
    late = [walk.evidence(plates(later), name) for name in ("one", "two")]
    common = find_force_faults(late)
    (finding,) = common.findings
    check_finding(finding, Code.CLOCKS_DIFFER, "one", "two", where=STUDY)
    assert common.faulty == {"one", "two"}
    alone = find_force_faults([walk.evidence(name="three"), late[1]])
    (finding,) = alone.findings
    assert finding.where == "two" and alone.faulty == {"two"}


def test_evidence_of_several_trials_is_summed() -> None:
    too_much = plates(lambda p: replace(p, force=p.force * [1.0, 1.07, 1.0]))
    several = [exact_walk().evidence(too_much, name) for name in "abc"]
    single = choose(several[:1])[0]
    together = choose(several)[0]
    assert together and len(together[0].trials) == 3
    assert not single or together[0].fits[0].gain > 2.0 * single[0].fits[0].gain


def test_unexplained_disagreement_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    evidence = exact_walk().evidence()
    noise = 60.0 * np.random.default_rng(0).normal(size=evidence.required_wrench.shape)
    shaken = replace(evidence, required_wrench=evidence.required_wrench + noise)
    (finding,) = find_force_faults([shaken]).findings
    check_finding(finding, Code.UNEXPLAINED_RESIDUAL, Severity.WARNING)
    assert find_force_faults([shaken]).faulty == {"walk"}
    monkeypatch.setattr(force_choice, "UNEXPLAINED_SQUARE", 1e6)
    assert find_force_faults([shaken]).findings == ()


def test_torque_change_is_that_of_inverse_dynamics() -> None:
    walk = exact_walk()
    evidence = walk.evidence(plates(times(2.0)))
    (named,), *_ = choose([evidence])
    torque, change = compute_torque_change([evidence], named.fits[0])
    frames = np.searchsorted(walk.motion.time, evidence.time - 1e-9)
    foot = np.stack([plate.wrench()[frames] for plate in made_plates(simulate_gait())], axis=1)
    dynamics = Dynamics(evidence.parameters)
    tau = dynamics.compute_ground_forces(dynamics.place(evidence.q), foot[..., None])[:, :, 0]
    largest = np.sqrt((tau[:, 6:] ** 2).mean(axis=0)).max() / evidence.bwh
    assert torque and change == pytest.approx(
        largest, rel=0.1
    )  # by as much as the plates make, twice being one more


@pytest.mark.slow
def test_trial_with_faulty_forces_is_left_out_of_the_inertial_fit(
    kept: Path, tmp_path: Path
) -> None:
    path = write_synthetic_study(tmp_path / "study")
    clean = kept_synthetic(kept)
    assert clean.inertial is not None and clean.warnings == ()
    write_forces_csv(
        tmp_path / "study" / "walk_forces.csv", [later(p) for p in made_plates(simulate_gait())]
    )
    study = Study.load(path)
    done = calibrate(study)
    assert done.inertial is None and done.phases[-1].name != "inertial"
    check_text(done.warnings)
    check_text(done.notes)
    nominal, fitted = done.nominal.parameters, done.model.parameters
    np.testing.assert_allclose(
        fitted.inertial, move_limb_inertia(nominal.inertial, nominal, fitted), atol=1e-12
    )
    further = analyse(clean.model, study.moving[0], study.settings, clean.uncertainty, {})
    assert [f for f in further.findings if f.code is Code.CLOCKS_DIFFER and f.topic == "forces"]


@pytest.mark.parametrize(
    ("late", "convicted"),
    [
        ((0.0174, 0.0174, 0.042, 0.0174, 0.0174), "3"),
        ((0.014, 0.014, 0.042, 0.014, 0.040), "35"),
        ((0.042, 0.040, 0.038, 0.039, 0.040), "12345"),
        ((0.030, 0.024, 0.042, 0.026, 0.025), "12345"),
        ((0.021, 0.021, 0.042, 0.021, 0.021), "12345"),
        ((0.014, 0.014, 0.014, 0.014, 0.014), ""),
    ],
)
def test_late_walk_does_not_make_slightly_late_walks_faulty(
    monkeypatch: pytest.MonkeyPatch, late: tuple[float, ...], convicted: str
) -> None:
    """Time offsets of real walks: 14 ms without a fault gain 11 nats, 42 ms 56 nats."""
    size = dict(zip("12345", late, strict=True))
    cause = next(c for c in list_causes([exact_walk().evidence()]) if c.kind is ForceFault.CLOCK)

    def fit_of(names: Sequence[str], x: float) -> ForceFit:
        best = np.array([56.0 * (size[name] / 0.042) ** 1.5 for name in names])
        gains = best * [1.0 - ((x - size[name]) / size[name]) ** 2 for name in names]
        return ForceFit(
            cause=cause, x=np.array([x]), gain=float(gains.sum()), explained=0.3, gains=gains
        )

    def best_fit(residual: SimpleNamespace, only: object = None) -> tuple[float, list[ForceFit]]:
        names = [trial.name for trial in residual.trials]
        sizes = np.linspace(0.0, 0.05, 101)[1:]
        return 1.0, [max((fit_of(names, float(x)) for x in sizes), key=lambda fit: fit.gain)]

    def in_each(alone: Sequence[SimpleNamespace], fit: ForceFit) -> ForceFit:
        return fit_of([trial.name for one in alone for trial in one.trials], float(fit.x[0]))

    monkeypatch.setattr(
        force_choice, "ForceResidual", lambda trials: SimpleNamespace(trials=tuple(trials))
    )
    monkeypatch.setattr(force_choice, "fit_causes", best_fit)
    monkeypatch.setattr(force_choice, "evaluate_at_size", in_each)
    evidence = exact_walk().evidence()
    named, left, _ = choose([replace(evidence, name=name) for name in size])
    assert "".join(sorted(t.name for one in named for t in one.trials)) == convicted and left == []


def test_lever_fault_must_explain_more_with_missing_samples(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """19 % and 14 nats: the effect of single missing frames in a clean real walk."""
    evidence = exact_walk().evidence()
    causes = {c.kind: c for c in list_causes([evidence]) if not c.plates}
    found = [
        ForceFit(
            cause=causes[kind],
            x=np.array([0.003, 0.05]),
            gain=14.0,
            explained=0.19,
            gains=np.array([14.0]),
        )
        for kind in (ForceFault.MARKERS_TILTED, ForceFault.PLACE, ForceFault.TILT)
    ]
    assert (
        len(force_choice.select_named(found)) == 3
        and force_choice.select_named(found, shaken=True) == ()
    )
    assert (
        len(force_choice.select_named([replace(fit, explained=0.3) for fit in found], shaken=True))
        == 3
    )
    monkeypatch.setattr(force_choice, "fit_causes", lambda residual, only=None: (1.0, found))
    assert len(choose([evidence])[0]) == 1 and choose([replace(evidence, missing=0.05)])[:2] == (
        [],
        [],
    )


def test_fault_with_doubtful_leg_must_explain_half(monkeypatch: pytest.MonkeyPatch) -> None:
    """18 to 27 %: the effect of a foot without toe, or of thighs and shanks with one marker, in a
    walk.
    """
    evidence = replace(exact_walk().evidence(), doubtful=True)
    (gain,) = [c for c in list_causes([evidence]) if c.kind is ForceFault.GAIN and not c.plates][:1]
    fit = ForceFit(
        cause=gain, x=np.array([-0.58]), gain=20.0, explained=0.27, gains=np.array([20.0])
    )
    size, found = 9.0, [fit]
    monkeypatch.setattr(force_choice, "fit_causes", lambda residual, only=None: (size, found))
    assert choose([evidence])[:2] == ([], [])
    assert len(choose([replace(evidence, doubtful=False)])[0]) == 1
    found[0] = replace(fit, explained=0.8)
    assert len(choose([evidence])[0]) == 1


def test_share_of_missing_samples() -> None:
    def blanked(recording: Recording) -> Recording:
        markers = recording.markers.copy()
        markers[::20] = np.nan
        return replace(recording, markers=markers)

    assert exact_walk().evidence().missing == 0.0
    assert exact_walk().evidence(blanked).missing == pytest.approx(0.05, abs=0.005)
