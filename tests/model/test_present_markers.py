"""Markers that a person wears decide what is open in a set."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gaitcal.arrays import Array
from gaitcal.errors import InputError
from gaitcal.io.formats import read_recording
from gaitcal.io.labels import ComputedPoints
from gaitcal.io.recording import Recording
from gaitcal.model.landmarks import is_device, locate_device_corner
from gaitcal.model.marker_set import MarkerSet, format_marker_set, load_marker_set
from gaitcal.model.nominal import nominal_model
from gaitcal.model.present_markers import complete_static, resolve_marker_set
from gaitcal.model.subject_model import SubjectModel
from tests.messages import check_note, refuses
from tests.model.people import PEOPLE, without
from tests.refusal import refusal

PIG = "plug-in-gait"


def static(data: Path) -> Recording:
    return PEOPLE[PIG].static(data)


def path_of(recording: Recording, *labels: str) -> np.ndarray:
    return np.mean(
        [recording.markers[:, recording.labels.index(label)] for label in labels], axis=0
    )


def with_marker(recording: Recording, label: str, path: np.ndarray) -> Recording:
    markers = np.concatenate([recording.markers, path[:, None]], axis=1)
    return replace(recording, labels=(*recording.labels, label), markers=markers)


def with_computed(recording: Recording, **paths: np.ndarray) -> Recording:
    """With points that another program computed."""
    return replace(
        recording, computed=ComputedPoints(tuple(paths), np.stack(list(paths.values()), axis=1))
    )


def model_of(recording: Recording, **changes: object) -> SubjectModel:
    """Of the person with something else known of it."""
    return nominal_model(recording, load_marker_set(PIG), replace(PEOPLE[PIG].subject, **changes))  # type: ignore[arg-type]


def test_one_marker_on_the_sacrum_serves_for_two(data_dir: Path) -> None:
    two = static(data_dir)
    one = without(with_marker(two, "SACR", path_of(two, "RPSI", "LPSI")), "RPSI", "LPSI")
    made = resolve_marker_set(load_marker_set(PIG), one)
    assert made.landmarks["sacrum"] == ("SACR",)
    assert set(made.tracking["pelvis"]) == {"RASI", "LASI", "SACR"}
    assert not {"RPSI", "LPSI"} & set(made.labels), "nobody misses what only the other way needs"
    check_note(made.notes, "sacrum", "SACR")
    np.testing.assert_allclose(
        model_of(one).parameters.joint, model_of(two).parameters.joint, atol=1e-12
    )


def test_nothing_open_is_left_and_a_result_keeps_it(data_dir: Path, tmp_path: Path) -> None:
    made = resolve_marker_set(load_marker_set(PIG), static(data_dir))
    assert not (made.alternatives or made.optional or made.knee_device)
    assert resolve_marker_set(made, static(data_dir)) is made
    path = tmp_path / "plug-in-gait.toml"
    path.write_text(format_marker_set(made), encoding="utf-8")
    back = load_marker_set(path)
    assert (back.landmarks, back.tracking, back.static_only) == (
        made.landmarks,
        made.tracking,
        made.static_only,
    )
    assert {"RKAX", "RKD1", "LKD2"} <= set(made.devices) and not set(made.devices) & set(
        made.labels
    )


def test_a_medial_marker_must_lie_as_far_as_a_joint_is_wide(data_dir: Path) -> None:
    recording = static(data_dir)
    ankle, knee, right, left = (
        path_of(recording, label) for label in ("RANK", "RKNE", "RASI", "LASI")
    )
    inwards = (left - right) / np.linalg.norm(left - right, axis=1, keepdims=True)
    at_ankle = with_marker(recording, "RMED", ankle + 0.08 * inwards)
    at_knee = with_marker(
        recording, "RMED", knee + 0.11 * inwards
    )  # some laboratories mean the knee by it
    assert resolve_marker_set(load_marker_set(PIG), at_ankle).landmarks["ankle_med_r"] == ("RMED",)
    made = resolve_marker_set(load_marker_set(PIG), at_knee)
    assert "ankle_med_r" not in made.landmarks
    check_note(made.notes, "RMED", "ankle_med_r")


def test_a_modelled_knee_serves_the_static_trial_and_is_told(data_dir: Path) -> None:
    recording = static(data_dir)
    points = {label: path_of(recording, label) for label in ("RKNE", "RTHI")}
    whole = complete_static(
        with_computed(without(recording, "RKNE"), **points), load_marker_set(PIG)
    )
    np.testing.assert_array_equal(path_of(whole, "RKNE"), path_of(recording, "RKNE"))
    assert any("RKNE" in note and "modelled" in note for note in whole.notes)
    measured = with_computed(recording, **{label: path + 0.1 for label, path in points.items()})
    assert complete_static(measured, load_marker_set(PIG)) is measured, (
        "what was measured comes first"
    )
    only_tracked = with_computed(without(recording, "RTHI"), **points)
    assert "RTHI" not in complete_static(only_tracked, load_marker_set(PIG)).labels, (
        "no landmark, not replaced"
    )


def test_the_rod_alone_gives_the_axis_of_a_modelled_knee(data_dir: Path) -> None:
    recording = read_recording(data_dir / "labs_c3d/kad/static.c3d")
    made = load_marker_set(PIG)
    whole, less = (complete_static(r, made) for r in (recording, without(recording, "RKD1")))
    assert any("RKNE" in note and "modelled" in note for note in less.notes)
    for one in (whole, less):
        assert resolve_marker_set(made, one).landmarks["knee_axis_r"] == ("RKAX",)
    assert np.nanmax(np.abs(path_of(less, "RKNE") - path_of(whole, "RKNE"))) < 1e-3
    child = read_recording(
        data_dir / "children/HC002D/static.c3d"
    )  # has a computed RKAX, and no device
    assert "knee_axis_r" not in resolve_marker_set(made, complete_static(child, made)).landmarks


def test_a_rod_renamed_to_the_knee_is_refused(data_dir: Path) -> None:
    recording = read_recording(data_dir / "labs_c3d/multi/static.c3d")
    renamed = replace(recording, labels=tuple(m.replace("KAX", "KNE") for m in recording.labels))
    said = refusal(complete_static, renamed, load_marker_set(PIG))
    assert re.search("marker 'RKNE': found the end of a rod .* Leave its label as 'RKAX'", said)


def test_what_markers_give_is_not_modelled(data_dir: Path) -> None:
    recording = static(data_dir)
    both = with_computed(recording, SACR=path_of(recording, "RPSI", "LPSI"))
    assert complete_static(both, load_marker_set(PIG)) is both
    assert "SACR" in complete_static(without(both, "LPSI"), load_marker_set(PIG)).labels


def test_a_measured_width_and_the_marker_place_the_knee_unless_nobody_has_it(
    data_dir: Path,
) -> None:
    recording = static(data_dir)
    model = model_of(recording, knee_width={"r": 0.12}, marker_diameter=0.010)
    apart = model.landmarks["knee_lat_r"][1] - model.landmarks["kjc_r"][1]
    assert np.linalg.norm(apart) == pytest.approx(0.5 * 0.12 + 0.005, abs=1e-9)
    check_note(model.notes, "knee, right", 65.0, 120)
    check_note(model.notes, "knee, left", "height")
    plain, wide = model_of(recording), model_of(recording, knee_width={"r": 0.30})
    np.testing.assert_array_equal(wide.landmarks["kjc_r"][1], plain.landmarks["kjc_r"][1])
    check_note(wide.notes, "knee", 300)


def test_a_foot_without_a_toe_marker_points_ahead(data_dir: Path) -> None:
    recording = static(data_dir)
    heel_only = without(with_marker(recording, "RP5M", path_of(recording, "RTOE")), "RTOE")
    made = model_of(heel_only)
    check_note(made.notes, "toe_r")
    length = np.linalg.norm(made.landmarks["toe_r"][1] - made.landmarks["heel_r"][1])
    assert length == pytest.approx(
        np.linalg.norm(model_of(recording).landmarks["toe_r"][1]), rel=0.1
    )
    in_walk = resolve_marker_set(load_marker_set(PIG), heel_only, elsewhere=["RTOE"])
    assert in_walk.landmarks["toe_r"] == ("RTOE",), (
        "a marker that walks have was lost, not left out"
    )


def test_capitals_are_forgiven_where_one_marker_alone_is_meant(data_dir: Path) -> None:
    recording = static(data_dir)
    small = replace(recording, labels=tuple(label.lower() for label in recording.labels))
    renamed = load_marker_set(PIG).renamed(small)
    assert renamed.labels == recording.labels
    check_note(renamed.notes, "rasi", "RASI")
    both = with_marker(without(recording, "RASI"), "rasi", path_of(recording, "RASI"))
    two = with_marker(both, "rAsi", path_of(recording, "RASI"))
    assert "RASI" in load_marker_set(PIG).renamed(both).labels
    assert "RASI" not in load_marker_set(PIG).renamed(two).labels


def test_clusters_take_the_place_of_landmarks_that_walks_lack() -> None:
    rng = np.random.default_rng(1)
    made: MarkerSet = load_marker_set("cast")
    labels = tuple(label for label in made.labels if not label.endswith(("FM2", "FMT2")))
    recording = Recording(
        source="made",
        time=np.arange(2) / 100.0,
        labels=labels,
        markers=rng.normal(size=(2, len(labels), 3)),
    )
    chosen = resolve_marker_set(made, recording)
    assert {"R_TH1", "R_TH2", "R_TH3", "R_TH4"} <= set(chosen.tracking["thigh_r"])
    assert "R_FLE" in chosen.static_only["thigh_r"]
    no_clusters = without(
        recording, *[label for label in labels if "_TH" in label or label.endswith("FTC")]
    )
    assert "R_FLE" in resolve_marker_set(made, no_clusters).tracking["thigh_r"]


@pytest.mark.parametrize("lost", ["RPSI", "LPSI"])
def test_one_posterior_spine_stands_for_both_by_its_mirror_image(lost: str, data_dir: Path) -> None:
    """The middle of the two is met within what the pelvis is uneven by, and the note says that it
    is a guess.
    """
    whole, one = (model_of(r) for r in (static(data_dir), without(static(data_dir), lost)))
    away = np.linalg.norm(whole.landmarks["sacrum"][1] - one.landmarks["sacrum"][1])
    assert away < 0.010, f"{1e3 * away:.1f} mm"
    other = {"RPSI": "LPSI", "LPSI": "RPSI"}[lost]
    check_note(set(one.notes) - set(whole.notes), "sacrum", other)


def test_a_label_of_another_landmark_is_not_proposed(data_dir: Path) -> None:
    """Neither spine is marked: RASI, the nearest label, is needed where it is. Both ends of a foot
    are not guessed.
    """
    bare = without(static(data_dir), "RPSI", "LPSI")
    said = refusal(model_of, bare)
    assert "RPSI" in said and "RASI" not in said
    misspelt = with_marker(bare, "RPSIx", path_of(static(data_dir), "RPSI"))
    with refuses(InputError, "RPSIx"):
        model_of(misspelt)
    with refuses(InputError, "RHEE", field="landmark heel_r"):
        model_of(without(static(data_dir), "RTOE", "RHEE"))


ROUNDING = 1e-12
"""m; a corner of a body of rods is found to rounding."""
MODELLED_MM = 0.1
"""mm; Vicon's program puts its own knee marker there to this, frame by frame."""
ROD = 0.095


def rods(seed: int) -> tuple[Array, Array]:
    """The corner (1, 3) and the ends (3, 1, 3) of three rods that point away from the origin,
    whichever way turned.
    """
    rng = np.random.default_rng(seed)
    at = rng.normal(size=3)
    at = 0.3 * at / np.linalg.norm(at)
    towards = Rotation.align_vectors([at], [np.ones(3)])[0] * Rotation.from_rotvec(
        0.3 * rng.normal(size=3)
    )
    return at[None], at + ROD * towards.as_matrix().T[:, None]


@pytest.mark.parametrize("seed", range(8))
def test_the_corner_is_where_the_rods_meet(seed: int) -> None:
    at, ends = rods(seed)
    np.testing.assert_allclose(locate_device_corner(*ends, inwards=-at), at, atol=ROUNDING)
    assert is_device(*ends)


@pytest.mark.parametrize("up", [0.0, 40.0])
def test_the_device_of_a_right_knee_points_to_the_left_one(up: float) -> None:
    """Rods that point outwards and upwards, as they may: the pelvis then lies beyond them, and the
    knee does not.
    """
    spread = Rotation.align_vectors([[0.0, 0.0, 1.0]], [np.ones(3)])[0]
    raised = Rotation.from_euler("x", -up, degrees=True)
    ends = ROD * (raised * spread).as_matrix().T[:, None]
    found = locate_device_corner(*ends, inwards=np.array([[0.0, 0.0, -0.24]]))
    np.testing.assert_allclose(found, np.zeros((1, 3)), atol=ROUNDING)
    wrong = locate_device_corner(*ends, inwards=np.array([[0.0, 0.0, 0.24]]))
    assert wrong is not None and np.linalg.norm(wrong) > 0.08
    witness = locate_device_corner(
        *ends, inwards=np.array([[0.0, 0.0, 0.24]]), modelled=np.full((1, 3), 1e-3)
    )
    np.testing.assert_allclose(witness, np.zeros((1, 3)), atol=ROUNDING)
    assert locate_device_corner(*ends) is None


def test_other_markers_are_no_device() -> None:
    _, ends = rods(0)
    assert not is_device(ends[0], ends[1], ends[2] + 0.1)
    assert not is_device(*(3.0 * ends))
    assert not is_device(*np.full_like(ends, np.nan))


@pytest.mark.parametrize("lab", ["kad", "multi"])
def test_it_is_where_the_vendors_program_has_it(lab: str, data_dir: Path) -> None:
    static = read_recording(data_dir / "labs_c3d" / lab / "static.c3d")
    whole = complete_static(static, load_marker_set("plug-in-gait"))
    for label in ("RKNE", "LKNE"):
        theirs = static.computed.points[:, static.computed.labels.index(label)]
        ours = whole.markers[:, whole.labels.index(label)]
        apart = 1e3 * np.linalg.norm(ours - theirs, axis=1)
        assert np.nanmedian(apart) < MODELLED_MM
    check_note(whole.notes, "RKNE", "knee alignment device")
