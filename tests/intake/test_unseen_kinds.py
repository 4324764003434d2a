"""Kinds of recordings that trip other tools: each on the case that showed it, or on one made like
it.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from gaitcal.dynamics.ground_reactions import _detect_seated
from gaitcal.errors import Code, Finding, Severity
from gaitcal.intake.draft_file import Draft, build_study, describe_marker_set
from gaitcal.intake.drafting import draft_folder
from gaitcal.intake.people_in_folder import describe_placement_difference, measure_pair_distances
from gaitcal.intake.recordings_folder import read_folder
from gaitcal.intake.subject_metadata import Options
from gaitcal.io.formats import read_recording
from gaitcal.io.recording import Recording
from gaitcal.preprocess.marker_clusters import SPREAD_RAD, compute_tissue_spread
from gaitcal.preprocess.preprocessed_study import preprocess_study
from gaitcal.quality.named_joint_centres import identify_computed_points
from gaitcal.quality.study_checks import check_study
from gaitcal.study.study import Study
from tests.intake.folders import write
from tests.quality.spoilt import findings, sound_study, with_trial, without

ROUNDING_M = 1e-6
"""m, of a coordinate that a C3D file holds in 16 or 32 bits of mm, written twice."""
MEASURED = {"RKNE": "r knee 1", "RANK": "r mall", "LKNE": "l knee 1", "LANK": "l mall"}
CENTRES = {"RKNE": "r knee", "RANK": "r ankle", "LKNE": "l knee", "LANK": "l ankle"}


@pytest.fixture(scope="module")
def case(data_dir: Path) -> Callable[[str], Draft]:
    """What follows from the folder of a case; read once, as nobody changes it."""
    return cache(
        lambda name: draft_folder(read_folder(data_dir / "cases" / name), Options(mass=68.5))
    )


@pytest.fixture(scope="module")
def stairs(case: Callable[[str], Draft]) -> Study:
    return build_study(case("stairs"))


def serious(study: Study) -> set[Code]:
    return {f.code for f in check_study(study) if f.severity is Severity.ERROR}


def of_code(study: Study, code: Code) -> list[Finding]:
    return [f for f in check_study(study) if f.code is code]


def test_centres_under_the_names_of_markers_give_way_to_the_markers(
    case: Callable[[str], Draft], data_dir: Path
) -> None:
    """Knee adduction moments were 25 N·m RMS from those of `pig_c3d`; from the same markers come
    the same moments.
    """
    made = case("joint_centres_named_like_markers")
    assert made.choice is not None
    assert made.choice.rename == {label: name for name, label in MEASURED.items()}
    assert set(made.choice.centres) == set(CENTRES.values()) and not made.choice.certain
    assert all(f"{label} = {name}" in describe_marker_set(made) for name, label in MEASURED.items())
    plain = build_study(draft_folder(read_folder(data_dir / "pig_c3d"), Options()))
    for ours, theirs in zip(build_study(made).trials, plain.trials, strict=True):
        for label in (m for m in theirs.recording.labels if m in plain.marker_set.labels):
            paths = (
                t.recording.markers[:, t.recording.labels.index(label)] for t in (ours, theirs)
            )
            assert np.allclose(*paths, atol=ROUNDING_M, equal_nan=True), label


def renamed_files(data_dir: Path, names: Mapping[str, str]) -> dict[str, Recording]:
    folder = data_dir / "cases/joint_centres_named_like_markers"
    read = {path.stem: read_recording(path) for path in sorted(folder.glob("*.c3d"))}
    return {
        stem: replace(r, labels=tuple(names.get(m, m) for m in r.labels), plates=(), computed=None)
        for stem, r in read.items()
    }


def test_a_centre_with_the_very_label_of_the_set_is_put_aside(
    tmp_path: Path, data_dir: Path
) -> None:
    names = {old: new for new, old in CENTRES.items()} | {
        old: f"{new}_skin" for new, old in MEASURED.items()
    }
    folder = write(tmp_path / "person", renamed_files(data_dir, names))
    made = draft_folder(read_folder(folder), Options(mass=66.5, height=1.79, sex="male"))
    assert made.choice is not None
    expected = {f"{name}_skin": name for name in MEASURED} | {
        name: f"{name} (centre)" for name in MEASURED
    }
    assert made.choice.rename == expected
    study = build_study(made)
    assert not of_code(study, Code.LANDMARK_DISPLACED)
    back = {v: k for k, v in expected.items()}
    trusting = replace(
        study,
        trials=tuple(
            replace(
                t,
                recording=replace(
                    t.recording, labels=tuple(back.get(m, m) for m in t.recording.labels)
                ),
            )
            for t in study.trials
        ),
    )
    (found,) = of_code(trusting, Code.LANDMARK_DISPLACED)
    assert found.severity is Severity.ERROR and all(name in found.cure for name in back)


def test_of_a_rigid_pair_the_inner_point_is_computed_and_both_where_the_body_lies_between() -> None:
    middle, inner, outer = np.zeros(3), np.array([0.0, 0.5, 0.08]), np.array([0.01, 0.5, 0.14])
    assert identify_computed_points(inner, outer, middle) == (True, False)
    assert identify_computed_points(outer, inner, middle) == (False, True)
    assert identify_computed_points(inner, inner * [1.0, 1.0, -1.0], middle) == (True, True)


def test_a_real_file_of_the_names_of_bts_is_understood(case: Callable[[str], Draft]) -> None:
    made = case("bts_labels")
    assert (
        made.choice is not None
        and made.choice.entry == "davis"
        and made.choice.further_markers is not None
    )
    assert [(t.name, t.role) for t in made.trials] == [("standing", "static"), ("dynamic", "gait")]
    assert not made.choice.coverage.missing and not made.choice.further_markers.tracking
    lateral = {
        name: made.choice.marker_set.landmarks[name] for name in ("knee_lat_r", "ankle_lat_l")
    }
    assert lateral == {"knee_lat_r": ("r knee 1",), "ankle_lat_l": ("l mall",)}
    assert {"r hip", "r knee", "r ankle", "r asis#2"} <= set(made.choice.further_markers.unused)


def part(study: Study, start: int, stop: int) -> Study:
    def cut(r: Recording) -> Recording:
        return r.frames((np.arange(len(r.time)) >= start) & (np.arange(len(r.time)) < stop))

    return with_trial(study, "Movement_trial", cut)


def sized(study: Study, by: float) -> Study:
    return with_trial(study, "Movement_trial", lambda r: replace(r, markers=by * r.markers))


@pytest.mark.parametrize(("start", "stop"), [(0, 323), (36, 82), (156, 200)])
def test_flexed_knees_make_no_other_body(stairs: Study, start: int, stop: int) -> None:
    """Stairs down, and the parts in which a knee is flexed by 60 to 100 deg: sizes were 0.971,
    allowed 0.983.
    """
    study = part(stairs, start, stop)
    assert not of_code(study, Code.BODY_SIZE)
    static, moving = (measure_pair_distances(t.recording, study.marker_set) for t in study.trials)
    assert not describe_placement_difference(static, moving, study.marker_set)


def test_nothing_refuses_a_walk_down_stairs(stairs: Study) -> None:
    assert not serious(stairs)


@pytest.mark.parametrize("by", [0.95, 1.06])
def test_another_body_is_found_on_stairs_and_in_a_lunge(stairs: Study, by: float) -> None:
    for study in (stairs, part(stairs, 36, 82)):
        assert of_code(sized(study, by), Code.BODY_SIZE)


def test_soft_tissue_grows_with_flexion_beyond_what_is_near() -> None:
    assert compute_tissue_spread(1e-3, 0.0) == 0.0
    assert compute_tissue_spread(2e-3, SPREAD_RAD) == pytest.approx(
        2.0 * compute_tissue_spread(1e-3, SPREAD_RAD)
    )
    # bones of three people, thigh, 60 deg beyond: 4.5 to 11 mm along each axis of a marker by
    # itself
    assert 4e-3 < compute_tissue_spread(1e-3, np.deg2rad(60.0)) < 11e-3


def test_labels_exchanged_in_every_third_frame_are_put_back_before_anything_is_judged(
    case: Callable[[str], Draft],
) -> None:
    """A heel was refused, the right leg with it: its shape was that of a foot whose toes flip."""
    study = build_study(case("run_labels_exchanged"))
    (trial,) = preprocess_study(study).moving
    (found,) = trial.restored_swaps
    assert {found.label, found.other} == {"RTOE", "RMT5"}
    for label in ("RTOE", "RMT5"):
        bends = np.linalg.norm(np.diff(trial.path(label), 2, axis=0), axis=1)
        assert bends.max() < 0.02, "m between frames at 150 Hz; exchanged it is 0.1"
    severities = {f.code: f.severity for f in check_study(study)}
    assert severities[Code.EXCHANGED_BACK] is Severity.INFO
    assert set(severities.values()) == {Severity.INFO}


def test_who_walks_backwards_brakes_before_driving_all_the_same(
    case: Callable[[str], Draft],
) -> None:
    study = build_study(case("backwards"))
    assert not of_code(study, Code.FORCE_SIGN)
    (note,) = of_code(study, Code.HEADING)
    assert note.severity is Severity.INFO

    def pushed_back(r: Recording) -> Recording:
        turned = [-1.0, 1.0, 1.0]
        return replace(r, plates=tuple(replace(p, force=p.force * turned) for p in r.plates))

    spoilt = with_trial(study, "walk", pushed_back)
    assert of_code(spoilt, Code.FORCE_SIGN)
    (doubt,) = of_code(spoilt, Code.HEADING)
    assert doubt.severity is Severity.WARNING, "no force says that time runs forwards"


def test_a_seat_bears_part_of_the_body_until_the_plates_carry_all_of_it() -> None:
    usual = 0.01
    missing = np.concatenate(
        [np.full(20, 0.7), np.linspace(0.7, 0.02, 20), np.full(40, usual), np.full(20, -0.02)]
    )
    lying = np.arange(len(missing)) < 25
    seated = _detect_seated(missing, lying)
    assert seated[:40].all() and not seated[40:].any()
    assert not _detect_seated(missing, np.zeros_like(lying)).any(), "nobody sits who stands"
    assert not _detect_seated(np.where(lying, 0.1, usual), lying).any(), (
        "a crouch over plates that read a tenth too little"
    )


def test_missing_markers_of_static_trial_and_arms_are_not_reported() -> None:
    study = sound_study()
    medial = [m for name, of in study.marker_set.landmarks.items() if "_med_" in name for m in of]
    arms = [m for s in ("upper_arm_r", "upper_arm_l") for m in study.marker_set.tracking[s]]
    free = with_trial(study, "walk", without(*medial, *arms))
    assert not findings(free, severity=Severity.WARNING, code=Code.MISSING_MARKERS)
    (finding,) = findings(
        with_trial(free, "walk", without("R.Thigh.Front")), code=Code.MISSING_MARKERS
    )[:1]
    assert (
        finding.severity is Severity.WARNING
        and "R.Thigh.Front" in finding.evidence
        and "R.Bicep" not in finding.evidence
    )
