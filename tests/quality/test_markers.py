"""Markers that are metres away, missing for a while, or single on their segment; gaps are no
swaps.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pytest

from gaitcal.analysis.prepared_trials import prepare_trial
from gaitcal.errors import Code, Finding, Severity
from gaitcal.io.recording import Recording
from gaitcal.model.linkage import LOWER_BODY
from gaitcal.preprocess.clean_trial import remove_outliers
from gaitcal.preprocess.preprocessed_study import preprocess_study
from gaitcal.preprocess.study_model import build_nominal_model
from gaitcal.quality.label_checks import check_swapped_labels
from gaitcal.quality.marker_checks import check_gaps
from gaitcal.study.study import Study
from gaitcal.tracking.motion import Motion, track_motion
from gaitcal.tracking.spline import ControlPointRule
from gaitcal.tracking.trial_problem import build_trial_problem
from tests.messages import check_finding
from tests.quality.spoilt import (
    Change,
    evidence,
    findings,
    gone,
    moved,
    put,
    recording_of,
    with_trial,
)

RealStudies = Callable[[str], Study]


def accused(study: Study, seed: int) -> list[Finding]:
    """Labels reported as swapped where a fifth of samples and a tenth of markers are missing."""
    rng = np.random.default_rng(seed)
    model, out = build_nominal_model(study), []
    for trial in study.moving[:3]:
        markers = trial.recording.markers.copy()
        markers[rng.random(markers.shape[:2]) < 0.2] = np.nan
        markers[:, rng.random(markers.shape[1]) < 0.1] = np.nan
        spoilt = replace(trial, recording=replace(trial.recording, markers=markers))
        out += check_swapped_labels(evidence(study, spoilt, model))
    return out


@pytest.mark.parametrize("seed", range(2))
def test_gaps_are_no_displacement(seed: int, sound: Study) -> None:
    assert accused(sound, seed) == []


@pytest.mark.parametrize("name", ["subject01", "uf3"])
def test_gaps_of_real_walks_are_no_displacement_with_any_weights(
    name: str, real_study: RealStudies
) -> None:
    study = real_study(name)
    study = replace(study, weights=dict.fromkeys(study.marker_set.tracked, 1.0))
    for seed in range(3):
        assert accused(study, seed) == []


def test_arms_rotating_under_soft_tissue_are_not_reported(real_study: RealStudies) -> None:
    """In `knee_r` of functional_c3d both elbows' epicondyles are 90 deg from their static
    position.
    """
    study = real_study("functional_c3d")
    (trial,) = [t for t in study.trials if t.name == "knee_r"]
    found = check_swapped_labels(evidence(study, trial, build_nominal_model(study)))
    assert [f.found for f in found if "LHE" in f.found] == []


def without_pelvis(study: Study, lost: Callable[[float, int], bool]) -> Change:
    """All but two markers of the pelvis invisible where `lost` (s, frame)."""

    def spoil(r: Recording) -> Recording:
        markers = r.markers.copy()
        away = np.array([lost(float(t), k) for k, t in enumerate(r.time)])
        of_pelvis = [
            i
            for i, label in enumerate(r.labels)
            if study.marker_set.segment_of.get(label) == "pelvis"
        ]
        for i in of_pelvis[2:]:
            markers[away, i] = np.nan
        return replace(r, markers=markers)

    return spoil


def pelvis_found(study: Study) -> tuple[Finding, ...]:
    """Findings on the walk's gaps, apart from single markers."""
    return tuple(
        f
        for f in check_gaps(evidence(study, study.trials[1], build_nominal_model(study)))
        if f.code is Code.PELVIS_LOST
    )


def test_single_frames_without_pelvis_need_no_remedy(sound: Study) -> None:
    (found,) = pelvis_found(
        with_trial(sound, "walk", without_pelvis(sound, lambda t, k: k % 12 == 5))
    )
    check_finding(found, Code.PELVIS_LOST, Severity.INFO, 8, cure="")


def test_a_walk_is_cut_to_the_part_that_shows_the_pelvis(sound: Study) -> None:
    """47 % without three pelvis markers were fitted for minutes, with angles of thousands of
    degrees.
    """
    lost = without_pelvis(sound, lambda t, k: 0.1 < t < 0.34 or t > 0.79 or k % 12 == 5)
    study = with_trial(sound, "walk", lost)
    cut, bridged = pelvis_found(study)
    check_finding(cut, Code.PELVIS_LOST, Severity.INFO, 0.34, 0.79, 0.1, 0.8, 1.03)
    check_finding(bridged, Code.PELVIS_LOST, Severity.INFO)
    clean = preprocess_study(study).clean
    walk, whole = recording_of(clean), recording_of(study)
    inside = (whole.time > 0.3375) & (whole.time < 0.7925)
    np.testing.assert_array_equal(walk.time, whole.time[inside])
    np.testing.assert_array_equal(walk.markers, whole.markers[inside])


@pytest.mark.parametrize("label", ["L.Heel", "R.Wrist.Lat"])
def test_marker_two_metres_off_is_left_out_throughout(sound: Study, label: str) -> None:
    spoilt = with_trial(sound, "walk", moved(label, lambda x: x + [0.0, 2.0, 0.0]))
    (reported,) = findings(spoilt, "stray markers")
    check_finding(reported, Code.STRAY_MARKER, Severity.WARNING, label, 208, 0.0, 1.03)
    fitted = prepare_trial(
        preprocess_study(spoilt).clean.trials[1], build_nominal_model(spoilt), spoilt.settings
    ).recording
    assert label not in fitted.labels and any(label in note for note in fitted.notes)


def test_stray_samples_are_left_out_there_only(sound: Study) -> None:
    spoilt = with_trial(
        sound, "walk", moved("R.Thigh.Front", lambda x: put(x, slice(50, 60), [5.0, 3.0, 0.0]))
    )
    kept, strays = remove_outliers(recording_of(spoilt), spoilt.marker_set.segment_of)
    gone = ~np.isfinite(kept.markers[:, kept.labels.index("R.Thigh.Front")]).all(axis=1)
    assert np.flatnonzero(gone).tolist() == list(range(50, 60))
    assert [(s.label, s.frames) for s in strays] == [("R.Thigh.Front", 10)]
    assert any("0.25-0.29 s" in f.found for f in findings(spoilt, "stray markers"))


def test_stray_marker_of_the_static_trial_is_not_in_the_model(sound: Study) -> None:
    spoilt = with_trial(sound, "static", moved("R.Thigh.Front", lambda x: x + [0.0, 0.0, 2.0]))
    assert (
        "R.Thigh.Front"
        not in build_nominal_model(replace(spoilt, weights={"R.Thigh.Front": 0.0})).markers.labels
    )
    assert any(f.where == "static" for f in findings(spoilt, "stray markers"))


CLOSE_DEG = 6.0
"""RMS between hip, knee and ankle angles with and without the second markers of thighs and shanks:
at most 3.6.
"""


@pytest.fixture(scope="module")
def pig(real_study: RealStudies) -> Study:
    return real_study("pig_c3d")


def renamed(study: Study, names: Mapping[str, str], trials: tuple[str, ...] = ("gait",)) -> Study:
    for trial in trials:
        study = with_trial(
            study, trial, lambda r: replace(r, labels=tuple(names.get(x, x) for x in r.labels))
        )
    return study


def of_one_marker(study: Study) -> list[Finding]:
    return findings(study, "one marker")


def test_unknown_wands_are_named_and_joints_determine_the_pose(pig: Study) -> None:
    thigh, shank = of_one_marker(
        renamed(pig, {"RTHI": "WandA", "RTIB": "WandB"}, ("static", "gait"))
    )
    for found, wand, other in ((thigh, "WandA", "WandB"), (shank, "WandB", "WandA")):
        assert (found.severity, found.leg) == (Severity.WARNING, "r")
        assert f"'{wand}'" in found.cure and f"'{other}'" not in found.cure
    assert "('RKNE')" in thigh.found


def test_foot_without_toe_is_refused_with_undetermined_angles(pig: Study) -> None:
    (found,) = of_one_marker(renamed(pig, {"RTOE": "Unknown"}))
    assert found.severity is Severity.ERROR
    assert "subtalar_angle_r" in found.found  # the heel and the posture tell the ankle's
    assert "'Unknown'" in found.cure


def test_one_marker_on_each_segment_of_a_leg_is_refused(pig: Study) -> None:
    found = of_one_marker(renamed(pig, {"LTHI": "A", "LTIB": "B", "LHEE": "C"}))
    assert [(f.severity, f.leg) for f in found] == [(Severity.ERROR, "l")] * 3


def test_a_while_with_one_marker_is_a_note_with_its_seconds(pig: Study) -> None:
    (found,) = of_one_marker(with_trial(pig, "gait", gone(slice(100, 140), "RTHI")))
    start = recording_of(pig, "gait").time[100]
    assert found.severity is Severity.INFO
    check_finding(found, Code.ONE_MARKER_SEGMENT, "thigh_r", f"{start:.2f}")


def tracked(study: Study) -> Motion:
    model, recording = build_nominal_model(study), study.trials[1].recording
    problem = build_trial_problem(
        "gait", model, recording, ControlPointRule(), root="pelvis", segments=LOWER_BODY
    )
    return track_motion(problem, model.parameters)


def test_posture_with_single_markers_is_that_of_all_markers(pig: Study) -> None:
    """From a thigh straight below the pelvis, both legs converged to a posture 33 to 56
    deg away.
    """
    whole = tracked(pig)
    reduced = tracked(renamed(pig, {f"{s}{m}": f"{s}{m}x" for s in "RL" for m in ("THI", "TIB")}))
    away = np.degrees(np.sqrt(np.mean((whole.q - reduced.q) ** 2, axis=0)))
    judged = {
        n: a
        for n, a in zip(whole.coordinates, away, strict=True)
        if n.startswith(("hip", "knee", "ankle"))
    }
    assert reduced.converged
    assert max(judged.values()) < CLOSE_DEG, judged
