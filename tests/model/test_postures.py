"""What the static posture tells: where ankle angles are counted from, and the trunk from any three
markers.
"""

from dataclasses import replace
from pathlib import Path

import ezc3d
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gaitcal.arrays import Array
from gaitcal.errors import InputError
from gaitcal.io.formats import read_recording
from gaitcal.io.recording import find_still_window
from gaitcal.model.ankle_zero import AnkleZero, StandingAnkles, measure_standing_ankles
from gaitcal.model.landmarks import StaticPosture, measure_static_posture
from gaitcal.model.marker_set import MarkerSet, load_marker_set
from gaitcal.model.nominal import PUBLISHED
from gaitcal.model.present_markers import complete_static, resolve_marker_set
from gaitcal.model.rotations import make_axis_rotation
from gaitcal.model.segment_frames import Frame, HipCentre, measure_lower_body
from gaitcal.model.subject_model import Subject
from gaitcal.model.trunk import MIDLINE, Trunk, compute_neck_height, measure_trunk
from gaitcal.tracking.motion import track
from gaitcal.tracking.spline import ControlPointRule
from tests.messages import check_text, refuses
from tests.model.people import PEOPLE, from_published, published_static

SAME_DEG = 1e-9
VENDOR_DEG = 3.0
"""Of two programs whose knee and ankle centres differ by up to 15 mm: what they do to a shank of
0.4 m.
"""


def published_posture() -> StaticPosture:
    return measure_static_posture(published_static(), load_marker_set("published"), slice(0, 1))


def displaced(posture: StaticPosture, by: dict[str, Array]) -> StaticPosture:
    """Landmarks moved by m."""
    moved = {name: posture.landmarks[name] + d for name, d in by.items()}
    return replace(posture, landmarks=posture.landmarks | moved)


def feet(low_m: float = 0.0) -> StaticPosture:
    """The published subject standing, its heel markers lower by so many m."""
    down = np.array([0.0, -low_m, 0.0])
    return displaced(published_posture(), {"heel_r": down, "heel_l": down})


def turned_foot(
    posture: StaticPosture, end: str, degrees: float, about: Array | None = None
) -> StaticPosture:
    """A landmark of a foot turned in the sagittal plane, toes up, about the other end of the foot
    or a point.
    """
    other = {"heel": "toe", "toe": "heel"}[end[:-2]] + end[-2:]
    centre = posture.landmarks[other] if about is None else about
    arm = posture.landmarks[end] - centre
    return displaced(posture, {end: make_axis_rotation(2, np.deg2rad(degrees)) @ arm - arm})


def ankles(
    posture: StaticPosture, rule: AnkleZero, file: dict[str, float] | None = None
) -> StandingAnkles:
    legs = measure_lower_body(posture, PUBLISHED.height, HipCentre.BELL)
    return measure_standing_ankles(
        posture, legs, {s: np.deg2rad(v) for s, v in (file or {}).items()}, rule
    )


def degrees(found: StandingAnkles) -> list[float]:
    return [float(np.rad2deg(found.dorsiflexion[side])) for side in "rl"]


def change(after: StandingAnkles, before: StandingAnkles) -> Array:
    """deg, right and left."""
    return np.subtract(degrees(after), degrees(before))


def test_the_height_of_the_heel_marker_does_not_matter_to_a_sole_on_the_floor() -> None:
    """15 mm lower on both feet: 3 degrees by the markers, none by the sole."""
    flat, low = feet(), feet(0.015)
    assert change(ankles(low, AnkleZero.AUTO), ankles(flat, AnkleZero.AUTO)) == pytest.approx(
        [0, 0], abs=SAME_DEG
    )
    slope = np.rad2deg(
        np.arctan2(
            0.015, np.linalg.norm((flat.landmarks["toe_r"] - flat.landmarks["heel_r"])[[0, 2]])
        )
    )
    by_markers = change(ankles(low, AnkleZero.MARKERS), ankles(flat, AnkleZero.MARKERS))
    assert by_markers == pytest.approx([slope, slope], abs=0.05)


@pytest.mark.parametrize("side", ["r", "l"])
@pytest.mark.parametrize(
    ("end", "turn", "low_m"), [("heel", -15.0, 0.0), ("heel", -15.0, 0.015), ("toe", 12.0, 0.0)]
)
def test_a_foot_is_flexed_by_what_its_heel_or_toes_are_raised(
    end: str, turn: float, low_m: float, side: str
) -> None:
    """The other foot tells how the markers lie to the sole."""
    flat = feet(low_m)
    before = ankles(flat, AnkleZero.AUTO)
    after = ankles(turned_foot(flat, f"{end}_{side}", turn), AnkleZero.AUTO)
    own, other = change(after, before)[:: 1 if side == "r" else -1]
    assert own == pytest.approx(turn, abs=0.1) and other == pytest.approx(0.0, abs=SAME_DEG)
    assert (
        f"its {'toes seem' if end == 'toe' else 'heel seems'} off the floor; its markers"
        in after.notes[0]
    )


def test_two_high_heels_are_left_as_their_markers_are_unless_the_file_tells() -> None:
    high = turned_foot(turned_foot(published_posture(), "heel_r", -20.0), "heel_l", -20.0)
    auto = ankles(high, AnkleZero.AUTO)
    assert (
        degrees(auto)
        == degrees(ankles(high, AnkleZero.MARKERS))
        != degrees(ankles(high, AnkleZero.SOLE))
    )
    check_text(auto.notes[0], "heel", "sole")
    told = {"r": 5.0, "l": 6.0}
    assert degrees(ankles(high, AnkleZero.AUTO, told)) == degrees(
        ankles(high, AnkleZero.FILE, told)
    )


def told_flat(posture: StaticPosture) -> dict[str, float]:
    """The file's angles, deg, of feet whose soles lie on the floor."""
    legs = measure_lower_body(posture, PUBLISHED.height, HipCentre.BELL)
    lines = {s: posture.landmarks[f"toe_{s}"] - legs.centres[f"ajc_{s}"] for s in "rl"}
    return {s: float(np.rad2deg(np.arctan2(-a[1], np.hypot(a[0], a[2])))) for s, a in lines.items()}


def on_forefeet(posture: StaticPosture, degrees: float) -> StaticPosture:
    """Both feet's markers turned about the ankles' centres, toes down."""
    legs = measure_lower_body(posture, PUBLISHED.height, HipCentre.BELL)
    for end in ("heel_r", "toe_r", "heel_l", "toe_l"):
        posture = turned_foot(posture, end, -degrees, about=legs.centres[f"ajc_{end[-1]}"])
    return posture


@pytest.mark.parametrize("low_m", [0.0, 0.015])
def test_feet_on_their_forefeet_are_plantarflexed_as_the_file_tells(low_m: float) -> None:
    """Its angle is that of the foot's markers, and stays when the foot turns; heel markers tell
    less.
    """
    flat = feet(low_m)
    told = told_flat(flat)
    before, after = (
        ankles(flat, AnkleZero.AUTO, told),
        ankles(on_forefeet(flat, 10.0), AnkleZero.AUTO, told),
    )
    assert change(after, before) == pytest.approx([-10.0, -10.0], abs=0.5)
    assert not before.doubts and set(after.doubts) == {"r", "l"}
    check_text(after.doubts["r"], 10)
    check_text(after.notes[0], 10)
    for rule in (AnkleZero.SOLE, AnkleZero.MARKERS, AnkleZero.FILE):
        assert not ankles(on_forefeet(flat, 10.0), rule, told).doubts, "the user has said it"


@pytest.mark.parametrize(("tilt", "doubted"), [(6.0, False), (10.0, True), (16.0, True)])
def test_high_heels_that_no_file_explains_are_doubted(tilt: float, doubted: bool) -> None:
    assert bool(ankles(on_forefeet(published_posture(), tilt), AnkleZero.AUTO).doubts) is doubted


def test_a_file_angle_is_that_of_ankle_and_toe_with_the_foot() -> None:
    """The slope of the line from ankle centre to toe marker, given as the file's angle, is a sole
    on the floor.
    """
    posture = published_posture()
    told = told_flat(posture)
    assert min(told.values()) > 5.0
    found = degrees(ankles(posture, AnkleZero.FILE, told))
    assert found == pytest.approx(degrees(ankles(posture, AnkleZero.SOLE)), abs=0.3)


def test_a_file_without_angles_cannot_be_followed() -> None:
    with refuses(InputError, "ankle_zero = 'file'"):
        ankles(published_posture(), AnkleZero.FILE, {"r": 3.0})


def test_only_the_zero_of_the_ankle_changes() -> None:
    """Another zero moves nothing but the coordinate, by the same in every frame."""
    static = published_static()
    low = [static.labels.index(f"{s}.Heel") for s in "RL"]
    markers = static.markers.copy()
    markers[:, low, 1] -= 0.015
    static = replace(static, markers=markers)
    a, b = (from_published(static, ankle_zero=rule) for rule in (AnkleZero.SOLE, AnkleZero.MARKERS))
    np.testing.assert_array_equal(a.parameters.joint, b.parameters.joint)
    np.testing.assert_array_equal(a.parameters.inertial, b.parameters.inertial)
    one, other = (track(model, static, rule=ControlPointRule(fixed=6)) for model in (a, b))
    moved = np.rad2deg(other.q - one.q)
    at = [one.coordinates.index(f"ankle_angle_{s}") for s in "rl"]
    assert np.abs(np.delete(moved, at, axis=1)).max() < 1e-6
    assert (moved[:, at] > 2.5).all()


@pytest.mark.parametrize(
    ("folder", "height"),
    [
        ("pig_c3d", 1.79),
        ("children/HC002D", 1.45),
        ("children/HC030A", 1.48),
        ("children/HC031A", 1.33),
        ("children/HC032A", 1.58),
    ],
)
def test_standing_ankles_as_the_laboratory_has_them(
    folder: str, height: float, data_dir: Path
) -> None:
    """Within a few degrees of the ankle angles that Plug-in Gait computed of the same
    static trial.
    """
    file, marker_set = data_dir / folder / "static.c3d", load_marker_set("plug-in-gait")
    static = complete_static(marker_set.renamed(read_recording(file)), marker_set)
    marker_set = resolve_marker_set(marker_set, static)
    posture = measure_static_posture(
        static, marker_set, find_still_window(static, marker_set.labels).frames
    )
    legs = measure_lower_body(posture, height, HipCentre.HARRINGTON)
    found = degrees(
        measure_standing_ankles(posture, legs, static.facts.static_plantarflexion, AnkleZero.AUTO)
    )
    points = ezc3d.c3d(str(file))
    labels = [label.split(":")[-1] for label in points["parameters"]["POINT"]["LABELS"]["value"]]
    angles = [
        np.nanmean(points["data"]["points"][0, labels.index(f"{s}AnkleAngles")]) for s in "RL"
    ]
    assert found == pytest.approx(angles, abs=VENDOR_DEG)


ROUNDING = 1e-12
LUMBAR = np.array([0.4, 1.0, -0.2])
PELVIS = Frame(np.eye(3), LUMBAR + [0.1, -0.08, 0.0])
PERSON = Subject("made up", 70.0, 1.741, "male")
LABELS = {
    "c7": "C7",
    "t10": "T10",
    "jugular_notch": "CLAV",
    "xiphoid": "STRN",
    "acromion_r": "R",
    "acromion_l": "L",
}
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
"""Derived against measured shoulders, and trunk frames, of real people: 52 mm and 4.6 degrees at
most; the acromia of one person lie up to 40 mm from each other's mirror image."""


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
    return measure_trunk(*made_up(names, turn), PELVIS, LUMBAR, PERSON)


@given(yaw=st.floats(-25.0, 25.0), lean=st.floats(-20.0, 20.0), list_=st.floats(-15.0, 15.0))
def test_the_trunk_turns_with_its_midline_markers(yaw: float, lean: float, list_: float) -> None:
    turn = (
        make_axis_rotation(1, np.deg2rad(yaw))
        @ make_axis_rotation(0, np.deg2rad(list_))
        @ make_axis_rotation(2, np.deg2rad(lean))
    )
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
    assert compute_neck_height(PERSON) == pytest.approx(0.5 * (0.0878 + 0.0164))
    assert compute_neck_height(Subject("", 61.9, 1.735, "female")) == pytest.approx(
        0.5 * (0.1169 + 0.0314)
    )
    found = trunk(MIDLINE)
    middle = 0.5 * (found.shoulders["sjc_r"] + found.shoulders["sjc_l"]) - LUMBAR
    np.testing.assert_allclose(
        middle, [0.0, 0.45 - compute_neck_height(PERSON), 0.0], atol=ROUNDING
    )
    assert (found.shoulders["sjc_r"] - found.shoulders["sjc_l"])[2] == pytest.approx(
        2 * 0.165 / 1.70 * PERSON.height
    )
    assert found.observed
    check_text(found.notes[0], "acromion")


@pytest.mark.parametrize("lost", ["acromion_r", "acromion_l"])
def test_a_lost_acromion_is_the_mirror_image_of_the_other(lost: str) -> None:
    turn = make_axis_rotation(1, np.deg2rad(12.0))
    whole = trunk(tuple(PLACES), turn)
    part = trunk(tuple(n for n in PLACES if n != lost), turn)
    for side in ("sjc_r", "sjc_l"):
        np.testing.assert_allclose(part.shoulders[side], whole.shoulders[side], atol=ROUNDING)
    check_text(part.notes[0], LABELS[lost])


def test_markers_without_names_stand_under_shoulders_of_the_nominal_subject() -> None:
    """A cluster somewhere on the trunk: it is followed, and is upright as the person stands."""
    posture, marker_set = made_up(("c7", "t10", "xiphoid"))
    nameless = replace(posture, landmarks={})
    found = measure_trunk(nameless, replace(marker_set, landmarks={}), PELVIS, LUMBAR, PERSON)
    assert found.observed
    np.testing.assert_allclose(found.frame.rotation, np.eye(3), atol=ROUNDING)
    np.testing.assert_allclose(
        found.shoulders["sjc_r"][1] - LUMBAR[1], 0.3519 / 1.70 * PERSON.height
    )


def test_a_trunk_without_markers_stands_upright() -> None:
    posture, marker_set = made_up(("c7",))
    assert measure_trunk(posture, marker_set, PELVIS, LUMBAR, PERSON).observed
    bare = measure_trunk(
        replace(posture, markers={}, landmarks={}), marker_set, PELVIS, LUMBAR, PERSON
    )
    assert not bare.observed
    np.testing.assert_allclose(bare.frame.rotation, np.eye(3), atol=ROUNDING)


def test_a_mislabelled_midline_is_not_believed() -> None:
    """The xiphoid's label on a shoulder: the plane through it is turned far, and the pelvis's
    serves.
    """
    posture, marker_set = made_up(("c7", "jugular_notch", "xiphoid"))
    wrong = {**posture.landmarks, "xiphoid": LUMBAR + PLACES["acromion_r"]}
    found = measure_trunk(replace(posture, landmarks=wrong), marker_set, PELVIS, LUMBAR, PERSON)
    np.testing.assert_allclose(found.frame.rotation[:, 2], [0.0, 0.0, 1.0], atol=ROUNDING)
    check_text(found.notes[0])


def without_acromia(marker_set: MarkerSet) -> MarkerSet:
    gone = {label for side in "rl" for label in marker_set.landmarks[f"acromion_{side}"]}
    landmarks = {
        n: labels for n, labels in marker_set.landmarks.items() if not n.startswith("acromion")
    }
    tracking = {
        s: tuple(m for m in labels if m not in gone) for s, labels in marker_set.tracking.items()
    }
    return replace(marker_set, landmarks=landmarks, tracking=tracking)


@pytest.mark.parametrize("name", ["plug-in-gait", "functional"])
def test_derived_shoulders_of_real_people_are_near_the_measured(name: str, data_dir: Path) -> None:
    person = PEOPLE[name]
    found = []
    for marker_set in (person.markers, without_acromia(person.markers)):
        static = marker_set.renamed(person.static(data_dir))
        posture = measure_static_posture(
            static, marker_set, find_still_window(static, marker_set.labels).frames
        )
        legs = measure_lower_body(posture, person.subject.height, HipCentre.BELL)
        found.append(
            measure_trunk(
                posture, marker_set, legs.frames["pelvis"], legs.centres["lumbar"], person.subject
            )
        )
    measured, derived = found
    assert derived.observed
    for side, centre in measured.shoulders.items():
        assert 1e3 * np.linalg.norm(derived.shoulders[side] - centre) < SHOULDER_MM
    turn = measured.frame.rotation.T @ derived.frame.rotation
    assert np.rad2deg(np.arccos((np.trace(turn) - 1.0) / 2.0)) < TURNED_DEG
