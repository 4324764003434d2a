"""The trunk from any three markers: where it faces, where its shoulders are, and when nothing can be said."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gaitcal.arrays import Array
from gaitcal.io.still import still_window
from gaitcal.model.chain import axis_rotation
from gaitcal.model.landmarks import StaticPosture, static_posture
from gaitcal.model.marker_set import MarkerSet
from gaitcal.model.segment_frames import Frame, HipCentre, lower_body
from gaitcal.model.subject_model import Subject
from gaitcal.model.trunk import MIDLINE, Trunk, neck_above_shoulders, trunk_of
from tests.model.people import PEOPLE

ROUNDING = 1e-12
LUMBAR = np.array([0.4, 1.0, -0.2])
PELVIS = Frame(np.eye(3), LUMBAR + [0.1, -0.08, 0.0])
PERSON = Subject("made up", 70.0, 1.741, "male")
LABELS = {"c7": "C7", "t10": "T10", "jugular_notch": "CLAV", "xiphoid": "STRN", "acromion_r": "R", "acromion_l": "L"}
PLACES = {
    "c7": [-0.06, 0.48, 0.0],
    "t10": [-0.08, 0.20, 0.0],
    "jugular_notch": [0.06, 0.42, 0.0],
    "xiphoid": [0.10, 0.22, 0.0],
    "acromion_r": [0.0, 0.42, 0.17],
    "acromion_l": [0.0, 0.42, -0.17],
}
"""m from the lumbar joint: one who stands upright and straight."""
SHOULDER_MM, TURNED_DEG = 55.0, 6.0
"""Derived against measured shoulders, and trunk frames, of real people: 52 mm and 4.6 degrees at most; the acromia of
one person lie up to 40 mm from each other's mirror image."""


def made_up(names: tuple[str, ...], turn: Array | None = None) -> tuple[StaticPosture, MarkerSet]:
    """A person whose trunk shows these landmarks, turned about the lumbar joint."""
    rotation = np.eye(3) if turn is None else turn
    markers = {LABELS[n]: LUMBAR + rotation @ np.array(PLACES[n]) for n in names}
    landmarks = {n: markers[LABELS[n]] for n in names}
    marker_set = MarkerSet(
        name="made up",
        description="",
        landmarks={n: (LABELS[n],) for n in PLACES},
        tracking={"head_trunk": tuple(LABELS[n] for n in PLACES)},
    )
    absent = {n: (LABELS[n],) for n in PLACES if n not in names}
    return StaticPosture("made up", markers, landmarks, absent), marker_set


def trunk(names: tuple[str, ...], turn: Array | None = None) -> Trunk:
    return trunk_of(*made_up(names, turn), PELVIS, LUMBAR, PERSON)


@given(yaw=st.floats(-25.0, 25.0), lean=st.floats(-20.0, 20.0), list_=st.floats(-15.0, 15.0))
def test_the_trunk_turns_with_its_midline_markers(yaw: float, lean: float, list_: float) -> None:
    turn = axis_rotation(1, np.deg2rad(yaw)) @ axis_rotation(0, np.deg2rad(list_)) @ axis_rotation(2, np.deg2rad(lean))
    off = np.arccos(np.clip((turn @ [0.0, 0.0, 1.0])[2], -1.0, 1.0))
    if off > np.deg2rad(29.0):
        return  # as far from the pelvis's plane as none is believed
    straight, turned = trunk(MIDLINE), trunk(MIDLINE, turn)
    np.testing.assert_allclose(turned.frame.rotation, turn @ straight.frame.rotation, atol=ROUNDING)
    for side in ("sjc_r", "sjc_l"):
        moved = LUMBAR + turn @ (straight.shoulders[side] - LUMBAR)
        np.testing.assert_allclose(turned.shoulders[side], moved, atol=ROUNDING)


def test_derived_shoulders_lie_where_de_leva_has_them() -> None:
    """Men 52 mm, women 74 mm below the middle of C7 and jugular notch, in people of his height."""
    assert neck_above_shoulders(PERSON) == pytest.approx(0.5 * (0.0878 + 0.0164))
    assert neck_above_shoulders(Subject("", 61.9, 1.735, "female")) == pytest.approx(0.5 * (0.1169 + 0.0314))
    found = trunk(MIDLINE)
    middle = 0.5 * (found.shoulders["sjc_r"] + found.shoulders["sjc_l"]) - LUMBAR
    np.testing.assert_allclose(middle, [0.0, 0.45 - neck_above_shoulders(PERSON), 0.0], atol=ROUNDING)
    assert (found.shoulders["sjc_r"] - found.shoulders["sjc_l"])[2] == pytest.approx(2 * 0.165 / 1.70 * PERSON.height)
    assert found.seen
    assert "no acromion is known" in found.notes[0]


@pytest.mark.parametrize("lost", ["acromion_r", "acromion_l"])
def test_a_lost_acromion_is_the_mirror_image_of_the_other(lost: str) -> None:
    turn = axis_rotation(1, np.deg2rad(12.0))
    whole = trunk(tuple(PLACES), turn)
    part = trunk(tuple(n for n in PLACES if n != lost), turn)
    for side in ("sjc_r", "sjc_l"):
        np.testing.assert_allclose(part.shoulders[side], whole.shoulders[side], atol=ROUNDING)
    assert "mirror image" in part.notes[0]
    assert LABELS[lost] in part.notes[0]


def test_markers_without_names_stand_under_shoulders_of_the_nominal_subject() -> None:
    """A cluster somewhere on the trunk: it is followed, and is upright as the person stands."""
    posture, marker_set = made_up(("c7", "t10", "xiphoid"))
    nameless = replace(posture, landmarks={})
    found = trunk_of(nameless, replace(marker_set, landmarks={}), PELVIS, LUMBAR, PERSON)
    assert found.seen
    np.testing.assert_allclose(found.frame.rotation, np.eye(3), atol=ROUNDING)
    np.testing.assert_allclose(found.shoulders["sjc_r"][1] - LUMBAR[1], 0.3519 / 1.70 * PERSON.height)


def test_a_trunk_without_markers_stands_upright() -> None:
    posture, marker_set = made_up(("c7",))
    assert trunk_of(posture, marker_set, PELVIS, LUMBAR, PERSON).seen
    bare = trunk_of(replace(posture, markers={}, landmarks={}), marker_set, PELVIS, LUMBAR, PERSON)
    assert not bare.seen
    np.testing.assert_allclose(bare.frame.rotation, np.eye(3), atol=ROUNDING)


def test_a_mislabelled_midline_is_not_believed() -> None:
    """The xiphoid's label on a shoulder: the plane through it is turned far, and the pelvis's serves."""
    posture, marker_set = made_up(("c7", "jugular_notch", "xiphoid"))
    wrong = {**posture.landmarks, "xiphoid": LUMBAR + PLACES["acromion_r"]}
    found = trunk_of(replace(posture, landmarks=wrong), marker_set, PELVIS, LUMBAR, PERSON)
    np.testing.assert_allclose(found.frame.rotation[:, 2], [0.0, 0.0, 1.0], atol=ROUNDING)
    assert "one of them is not where its name says" in found.notes[0]


def without_acromia(marker_set: MarkerSet) -> MarkerSet:
    gone = {label for side in "rl" for label in marker_set.landmarks[f"acromion_{side}"]}
    return replace(
        marker_set,
        landmarks={n: labels for n, labels in marker_set.landmarks.items() if not n.startswith("acromion")},
        tracking={s: tuple(m for m in labels if m not in gone) for s, labels in marker_set.tracking.items()},
    )


@pytest.mark.parametrize("name", ["plug-in-gait", "functional"])
def test_derived_shoulders_of_real_people_are_near_the_measured(name: str, data_dir: Path) -> None:
    person = PEOPLE[name]
    found = []
    for marker_set in (person.markers, without_acromia(person.markers)):
        static = marker_set.renamed(person.static(data_dir))
        posture = static_posture(static, marker_set, still_window(static, marker_set.labels).frames)
        legs = lower_body(posture, person.subject.height, HipCentre.BELL)
        found.append(trunk_of(posture, marker_set, legs.frames["pelvis"], legs.centres["lumbar"], person.subject))
    measured, derived = found
    assert derived.seen
    for side, centre in measured.shoulders.items():
        assert 1e3 * np.linalg.norm(derived.shoulders[side] - centre) < SHOULDER_MM
    turn = measured.frame.rotation.T @ derived.frame.rotation
    assert np.rad2deg(np.arccos((np.trace(turn) - 1.0) / 2.0)) < TURNED_DEG
