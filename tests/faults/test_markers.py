"""Markers that are metres away, gone for a while, or alone on their segment; gaps accuse nobody of exchanged labels."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaitcal.errors import Finding, Severity
from gaitcal.faults.evidence import MarkerEvidence
from gaitcal.faults.exchanged import exchanged
from gaitcal.faults.markers import gaps
from gaitcal.faults.study import check_study
from gaitcal.io.recording import Recording
from gaitcal.model.linkage import LOWER_BODY
from gaitcal.model.rebuilt_markers import without_outliers
from gaitcal.motion.motion import Motion, tracked_motion
from gaitcal.motion.spline import NodeRule
from gaitcal.motion.trial_problem import trial_problem
from gaitcal.session.session import prepare_trial
from gaitcal.study.study import Study, cleaned, nominal_of
from tests.faults.spoilt import Array, moved, put, sound_study, with_trial
from tests.real_studies import REAL, write_study

MISSING = 0.2


def accused(study: Study, seed: int, weights: float | None = None) -> list[str]:
    rng = np.random.default_rng(seed)
    own = dict.fromkeys(study.marker_set.tracked, weights) if weights else dict(study.weights)
    model, out = nominal_of(study), []
    for trial in study.moving[:3]:
        markers = trial.recording.markers.copy()
        markers[rng.random(markers.shape[:2]) < MISSING] = np.nan
        markers[:, rng.random(markers.shape[1]) < 0.1] = np.nan
        spoilt = replace(trial, recording=replace(trial.recording, markers=markers))
        marker_set = study.marker_set.with_weights(own)
        evidence = MarkerEvidence.of(spoilt, marker_set, study.subject, study.settings, model)
        out += [f.line for f in exchanged(evidence)]
    return out


@pytest.mark.parametrize("seed", range(2))
def test_synthetic_person(seed: int) -> None:
    assert accused(sound_study(), seed) == []


@pytest.mark.parametrize("name", ["subject01", "uf3"])
def test_real_people_whatever_the_weights(name: str, data_dir: Path, tmp_path: Path) -> None:
    study = Study.load(write_study(name, data_dir, tmp_path))
    for seed in range(3):
        assert accused(study, seed, weights=1.0) == []


def test_arms_that_turn_under_their_skin_are_not_accused(data_dir: Path, tmp_path: Path) -> None:
    """In `knee_r` of functional_c3d both elbows' epicondyles lie a right angle from where the static trial has them."""
    study = Study.load(write_study("functional_c3d", data_dir, tmp_path))
    model = nominal_of(study)
    trial = next(t for t in study.trials if t.name == "knee_r")
    evidence = MarkerEvidence.of(trial, study.marker_set, study.subject, study.settings, model)
    assert [f.found for f in exchanged(evidence) if "LHE" in f.found] == []


def without_pelvis(study: Study, r: Recording, lost: Callable[[float, int], bool]) -> Array:
    """Markers with all but two of the pelvis unseen where `lost` (s, frame)."""
    markers = r.markers.copy()
    away = np.array([lost(float(t), k) for k, t in enumerate(r.time)])
    of_pelvis = [i for i, label in enumerate(r.labels) if study.marker_set.segment_of.get(label) == "pelvis"]
    for i in of_pelvis[2:]:
        markers[away, i] = np.nan
    return markers


def pelvis_found(study: Study, lost: Callable[[float, int], bool]) -> tuple[Finding, ...]:
    """What is said of gaps, beside each marker's own, in such a walk."""
    trial = next(t for t in study.moving if t.name == "walk")
    spoilt = replace(trial, recording=replace(trial.recording, markers=without_pelvis(study, trial.recording, lost)))
    evidence = MarkerEvidence.of(spoilt, study.marker_set, study.subject, study.settings, nominal_of(study))
    return tuple(f for f in gaps(evidence) if "pelvis markers" in f.found)


def test_single_frames_without_the_pelvis_need_no_cure() -> None:
    (found,) = pelvis_found(sound_study(), lambda t, k: k % 12 == 5)
    assert found.severity is Severity.INFO and "8 % of the frames" in found.found and not found.cure


def test_a_walk_is_cut_to_the_part_that_shows_the_pelvis() -> None:
    """47 % without three pelvis markers were fitted for minutes, to angles of thousands of degrees."""

    def lost(t: float, k: int) -> bool:
        return 0.1 < t < 0.34 or t > 0.79 or k % 12 == 5

    cut, bridged = pelvis_found(sound_study(), lost)
    assert cut.severity is bridged.severity is Severity.INFO
    assert "cut to 0.34-0.79 s" in cut.found and "0.10-0.34, 0.80-1.03 s" in cut.found
    study = with_trial(sound_study(), "walk", lambda r: replace(r, markers=without_pelvis(sound_study(), r, lost)))
    walk, whole = (next(t for t in one.trials if t.name == "walk") for one in (cleaned(study), study))
    inside = (whole.recording.time > 0.3375) & (whole.recording.time < 0.7925)
    np.testing.assert_array_equal(walk.recording.time, whole.recording.time[inside])
    np.testing.assert_array_equal(walk.recording.markers, whole.recording.markers[inside])
    assert not cleaned(study).static.cut


@pytest.mark.parametrize("name", REAL)
def test_nothing_of_real_recordings_is_left_out(name: str, data_dir: Path, tmp_path: Path) -> None:
    study = Study.load(write_study(name, data_dir, tmp_path))
    for trial in study.trials:
        assert without_outliers(trial.recording, study.marker_set.segment_of)[1] == (), trial.name


@pytest.mark.parametrize("label", ["L.Heel", "R.Wrist.Lat"])
def test_a_marker_two_metres_off_is_told_and_left_out_throughout(sound: Study, label: str) -> None:
    spoilt = with_trial(sound, "walk", moved(label, lambda x: x + [0.0, 2.0, 0.0]))
    told = [f for f in check_study(spoilt) if f.topic == "strays"]
    assert len(told) == 1 and told[0].severity is Severity.WARNING
    assert f"'{label}' is metres away" in told[0].cause and "208 of 208 frames (0.00-1.03 s)" in told[0].found
    walk = next(t for t in cleaned(spoilt).trials if t.name == "walk")
    fitted = prepare_trial(walk, nominal_of(spoilt), spoilt.settings).recording
    assert label not in fitted.labels and label in fitted.notes[-1]


def test_a_marker_that_flies_off_is_left_out_there_alone(sound: Study) -> None:
    spoilt = with_trial(sound, "walk", moved("R.Thigh.Front", lambda x: put(x, slice(50, 60), [5.0, 3.0, 0.0])))
    walk = next(t for t in spoilt.trials if t.name == "walk").recording
    kept, strays = without_outliers(walk, spoilt.marker_set.segment_of)
    gone = ~np.isfinite(kept.markers[:, kept.labels.index("R.Thigh.Front")]).all(axis=1)
    assert np.flatnonzero(gone).tolist() == list(range(50, 60))
    assert [(s.label, s.frames) for s in strays] == [("R.Thigh.Front", 10)]
    assert any("0.25-0.29 s" in f.found for f in check_study(spoilt) if f.topic == "strays")


def test_a_tracking_marker_metres_away_in_the_static_trial_is_in_no_model(sound: Study) -> None:
    spoilt = with_trial(sound, "static", moved("R.Thigh.Front", lambda x: x + [0.0, 0.0, 2.0]))
    assert "R.Thigh.Front" not in nominal_of(replace(spoilt, weights={"R.Thigh.Front": 0.0})).markers.labels
    assert any(f.topic == "strays" and f.where == "static" for f in check_study(spoilt))


CLOSE_DEG = 6.0
"""RMS between hip, knee and ankle angles with and without the second markers of thighs and shanks: at most 3.6."""


@pytest.fixture(scope="module")
def pig(data_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Study:
    return Study.load(write_study("pig_c3d", data_dir, tmp_path_factory.mktemp("pig")))


def renamed(study: Study, names: Mapping[str, str], trials: tuple[str, ...]) -> Study:
    out = []
    for trial in study.trials:
        r = trial.recording
        other = replace(r, labels=tuple(names.get(label, label) for label in r.labels))
        out.append(replace(trial, recording=other) if trial.name in trials else trial)
    return replace(study, trials=tuple(out))


def of_one_marker(study: Study) -> list[Finding]:
    return [f for f in check_study(study) if f.topic == "one marker"]


def test_wands_that_the_set_does_not_know_are_named_and_the_joints_tell_the_rest(pig: Study) -> None:
    names = {"RTHI": "WandA", "RTIB": "WandB"}
    found = of_one_marker(renamed(pig, names, ("static", "gait")))
    assert [f.severity for f in found] == [Severity.WARNING] * 2
    assert {f.leg for f in found} == {"r"}
    thigh, shank = found
    assert "'WandA'" in thigh.cure and "'WandB'" not in thigh.cure
    assert "'WandB'" in shank.cure and "'WandA'" not in shank.cure
    assert "('RKNE')" in thigh.found


def test_a_foot_without_its_toe_is_refused_with_the_angles_that_nobody_knows(pig: Study) -> None:
    (found,) = of_one_marker(renamed(pig, {"RTOE": "Unknown"}, ("gait",)))
    assert found.severity is Severity.ERROR
    assert "subtalar_angle_r" in found.found  # the heel and the posture tell the ankle's
    assert "'Unknown'" in found.cure


def test_one_marker_on_each_segment_of_a_leg_is_refused(pig: Study) -> None:
    found = of_one_marker(renamed(pig, {"LTHI": "A", "LTIB": "B", "LHEE": "C"}, ("gait",)))
    assert [f.severity for f in found] == [Severity.ERROR] * 3
    assert {f.leg for f in found} == {"l"}


def test_a_while_with_one_marker_is_a_note_with_its_seconds(pig: Study) -> None:
    gait = pig.trials[1]
    markers = gait.recording.markers.copy()
    markers[100:140, gait.recording.labels.index("RTHI")] = np.nan
    gappy = replace(gait, recording=replace(gait.recording, markers=markers))
    (found,) = of_one_marker(replace(pig, trials=(pig.trials[0], gappy)))
    start = gait.recording.time[100]
    assert found.severity is Severity.INFO
    assert f"thigh_r shows fewer than two markers with weight in {start:.2f}" in found.found


def tracked(study: Study) -> Motion:
    model, recording = nominal_of(study), study.trials[1].recording
    problem = trial_problem("gait", model, recording, NodeRule(), root="pelvis", segments=LOWER_BODY)
    return tracked_motion(problem, model.parameters)


def test_the_posture_found_is_that_of_all_markers(pig: Study) -> None:
    """Started with the thigh straight below the pelvis, both legs fell into another posture 33 to 56 deg away."""
    whole = tracked(pig)
    reduced = tracked(renamed(pig, {f"{s}{m}": f"{s}{m}x" for s in "RL" for m in ("THI", "TIB")}, ("gait",)))
    away = np.degrees(np.sqrt(np.mean((whole.q - reduced.q) ** 2, axis=0)))
    judged = {n: a for n, a in zip(whole.coordinates, away, strict=True) if n.startswith(("hip", "knee", "ankle"))}
    assert reduced.converged
    assert max(judged.values()) < CLOSE_DEG, judged
