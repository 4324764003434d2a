"""What ankle angles are counted from: soles on the floor, markers, a file's angles."""

from dataclasses import replace
from pathlib import Path

import ezc3d
import numpy as np
import pytest

from gaitcal.errors import InputError
from gaitcal.io.formats import read_recording
from gaitcal.io.still import still_window
from gaitcal.model.ankle_zero import AnkleZero, StandingAnkles, standing_ankles
from gaitcal.model.chain import axis_rotation
from gaitcal.model.landmarks import StaticPosture, static_posture
from gaitcal.model.marker_set import load_marker_set
from gaitcal.model.nominal import PUBLISHED, nominal_model
from gaitcal.model.present_markers import complete_static, worn
from gaitcal.model.segment_frames import HipCentre, lower_body
from gaitcal.motion.motion import track
from gaitcal.motion.spline import NodeRule
from gaitcal.study.settings import CalibrationSettings
from tests.model.people import published_static

SAME_DEG = 1e-9
VENDOR_DEG = 3.0
"""Of two programs whose knee and ankle centres differ by up to 15 mm: what they do to a shank of 0.4 m."""


def published_posture() -> StaticPosture:
    return static_posture(published_static(), load_marker_set("published"), slice(0, 1))


def displaced(posture: StaticPosture, **by: tuple[float, float, float]) -> StaticPosture:
    """Landmarks moved by m."""
    moved = {name: posture.landmarks[name] + np.array(shift) for name, shift in by.items()}
    return replace(posture, landmarks={**posture.landmarks, **moved})


def with_heel_raised(posture: StaticPosture, side: str, degrees: float) -> StaticPosture:
    """One foot's markers turned about its toe marker, heel up; the ankle keeps its place (the knee gives way)."""
    toe, heel = posture.landmarks[f"toe_{side}"], posture.landmarks[f"heel_{side}"]
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    x, y, z = heel - toe
    turned = toe + np.array([c * x + s * y, -s * x + c * y, z])
    assert turned[1] > heel[1]
    return replace(posture, landmarks={**posture.landmarks, f"heel_{side}": turned})


def ankles(posture: StaticPosture, rule: AnkleZero, file: dict[str, float] | None = None) -> StandingAnkles:
    legs = lower_body(posture, PUBLISHED.height, HipCentre.BELL)
    return standing_ankles(posture, legs, {s: np.deg2rad(v) for s, v in (file or {}).items()}, rule)


def degrees(found: StandingAnkles) -> list[float]:
    return [float(np.rad2deg(found.dorsiflexion[side])) for side in "rl"]


def test_the_height_of_the_heel_marker_does_not_matter_to_a_sole_on_the_floor() -> None:
    """15 mm lower on both feet: 3 degrees by the markers, none by the sole."""
    flat = published_posture()
    low = displaced(flat, heel_r=(0, -0.015, 0), heel_l=(0, -0.015, 0))
    assert degrees(ankles(low, AnkleZero.AUTO)) == pytest.approx(degrees(ankles(flat, AnkleZero.AUTO)), abs=SAME_DEG)
    slope = np.rad2deg(np.arctan2(0.015, np.linalg.norm((flat.landmarks["toe_r"] - flat.landmarks["heel_r"])[[0, 2]])))
    by_markers = np.subtract(degrees(ankles(low, AnkleZero.MARKERS)), degrees(ankles(flat, AnkleZero.MARKERS)))
    assert by_markers == pytest.approx([slope, slope], abs=0.05)


@pytest.mark.parametrize("side", ["r", "l"])
@pytest.mark.parametrize("low_m", [0.0, 0.015])
def test_a_raised_heel_is_plantarflexed_by_what_it_is_raised(side: str, low_m: float) -> None:
    """The other foot tells how the markers lie to the sole."""
    flat = displaced(published_posture(), heel_r=(0, -low_m, 0), heel_l=(0, -low_m, 0))
    at, before = "rl".index(side), ankles(flat, AnkleZero.AUTO)
    after = ankles(with_heel_raised(flat, side, 15.0), AnkleZero.AUTO)
    assert degrees(after)[at] - degrees(before)[at] == pytest.approx(-15.0, abs=0.1)
    assert degrees(after)[1 - at] == pytest.approx(degrees(before)[1 - at], abs=SAME_DEG)
    assert "its heel seems off the floor; its markers" in after.notes[0]


def test_a_foot_on_its_heel_is_dorsiflexed_by_what_its_toes_are_raised() -> None:
    flat = published_posture()
    heel, toe = flat.landmarks["heel_r"], flat.landmarks["toe_r"]
    along, degree = toe - heel, np.deg2rad(12.0)
    c, s = np.cos(degree), np.sin(degree)
    up = heel + np.array([c * along[0] - s * along[1], s * along[0] + c * along[1], along[2]])
    raised = ankles(replace(flat, landmarks={**flat.landmarks, "toe_r": up}), AnkleZero.AUTO)
    before = degrees(ankles(flat, AnkleZero.AUTO))
    assert np.subtract(degrees(raised), before) == pytest.approx([12.0, 0.0], abs=0.1)
    assert "its toes seem off the floor" in raised.notes[0]


def test_two_high_heels_are_left_as_their_markers_are_unless_the_file_tells() -> None:
    high = with_heel_raised(with_heel_raised(published_posture(), "r", 20.0), "l", 20.0)
    auto = ankles(high, AnkleZero.AUTO)
    assert degrees(auto) == degrees(ankles(high, AnkleZero.MARKERS)) != degrees(ankles(high, AnkleZero.SOLE))
    assert "its heel seems off the floor; the line" in auto.notes[0]
    told = {"r": 5.0, "l": 6.0}
    assert degrees(ankles(high, AnkleZero.AUTO, told)) == degrees(ankles(high, AnkleZero.FILE, told))


def told_flat(posture: StaticPosture) -> dict[str, float]:
    """The file's angles, deg, of feet whose soles lie on the floor."""
    legs = lower_body(posture, PUBLISHED.height, HipCentre.BELL)
    lines = {s: posture.landmarks[f"toe_{s}"] - legs.centres[f"ajc_{s}"] for s in "rl"}
    return {s: float(np.rad2deg(np.arctan2(-a[1], np.hypot(a[0], a[2])))) for s, a in lines.items()}


def on_forefeet(posture: StaticPosture, degrees: float) -> StaticPosture:
    """Both feet's markers turned about the ankles' centres, toes down."""
    legs = lower_body(posture, PUBLISHED.height, HipCentre.BELL)
    turn = axis_rotation(2, -np.deg2rad(degrees))
    turned = {
        f"{end}_{s}": c + turn @ (posture.landmarks[f"{end}_{s}"] - c)
        for s in "rl"
        for end in ("heel", "toe")
        for c in [legs.centres[f"ajc_{s}"]]
    }
    return replace(posture, landmarks={**posture.landmarks, **turned})


@pytest.mark.parametrize("low_m", [0.0, 0.015])
def test_feet_on_their_forefeet_are_plantarflexed_as_the_file_tells(low_m: float) -> None:
    """Its angle is that of the foot's markers, and stays when the foot turns; heel markers tell less."""
    flat = displaced(published_posture(), heel_r=(0, -low_m, 0), heel_l=(0, -low_m, 0))
    told = told_flat(flat)
    before, after = ankles(flat, AnkleZero.AUTO, told), ankles(on_forefeet(flat, 10.0), AnkleZero.AUTO, told)
    assert np.subtract(degrees(after), degrees(before)) == pytest.approx([-10.0, -10.0], abs=0.5)
    assert not before.doubts and set(after.doubts) == {"r", "l"}
    assert "10 deg more plantarflexed" in after.doubts["r"] and "10 deg from a sole on the floor" in after.notes[0]
    for rule in (AnkleZero.SOLE, AnkleZero.MARKERS, AnkleZero.FILE):
        assert not ankles(on_forefeet(flat, 10.0), rule, told).doubts, "the user has said it"


@pytest.mark.parametrize(("tilt", "doubted"), [(6.0, False), (10.0, True), (16.0, True)])
def test_high_heels_that_no_file_explains_are_doubted(tilt: float, doubted: bool) -> None:
    assert bool(ankles(on_forefeet(published_posture(), tilt), AnkleZero.AUTO).doubts) is doubted


def test_a_file_angle_is_that_of_ankle_and_toe_with_the_foot() -> None:
    """The slope of the line from ankle centre to toe marker, given as the file's angle, is a sole on the floor."""
    posture = published_posture()
    told = told_flat(posture)
    assert min(told.values()) > 5.0
    found = degrees(ankles(posture, AnkleZero.FILE, told))
    assert found == pytest.approx(degrees(ankles(posture, AnkleZero.SOLE)), abs=0.3)


def test_a_file_without_angles_cannot_be_followed() -> None:
    with pytest.raises(InputError, match=r"ankle_zero = 'file': the static trial has no static plantarflexion angle"):
        ankles(published_posture(), AnkleZero.FILE, {"r": 3.0})


def test_only_the_zero_of_the_ankle_changes() -> None:
    """Another zero moves nothing but the coordinate, by the same in every frame."""
    static = published_static()
    low = [static.labels.index(f"{s}.Heel") for s in "RL"]
    markers = static.markers.copy()
    markers[:, low, 1] -= 0.015
    static = replace(static, markers=markers)
    marker_set = load_marker_set("published")
    q, models = {}, {}
    for rule in (AnkleZero.SOLE, AnkleZero.MARKERS):
        model = nominal_model(static, marker_set, PUBLISHED, ankle_zero=rule)
        q[rule], models[rule] = track(model, static, rule=NodeRule(fixed=6)), model
    a, b = models.values()
    np.testing.assert_array_equal(a.parameters.joint, b.parameters.joint)
    np.testing.assert_array_equal(a.parameters.inertial, b.parameters.inertial)
    one, other = q.values()
    moved = np.rad2deg(other.q - one.q)
    at = [one.coordinates.index(f"ankle_angle_{s}") for s in "rl"]
    assert np.abs(np.delete(moved, at, axis=1)).max() < 1e-6
    assert (moved[:, at] > 2.5).all()


VENDOR = {
    "pig_c3d/static.c3d": ("plug-in-gait", 1.79),
    **{f"children/{c}/static.c3d": ("plug-in-gait", h) for c, h in (("HC002D", 1.45), ("HC030A", 1.48))},
    **{f"children/{c}/static.c3d": ("plug-in-gait", h) for c, h in (("HC031A", 1.33), ("HC032A", 1.58))},
}


@pytest.mark.parametrize("file", VENDOR)
def test_standing_ankles_as_the_laboratory_has_them(file: str, data_dir: Path) -> None:
    """Within a few degrees of the ankle angles that Plug-in Gait computed of the same static trial."""
    name, height = VENDOR[file]
    marker_set = load_marker_set(name)
    static = complete_static(marker_set.renamed(read_recording(data_dir / file)), marker_set)
    marker_set = worn(marker_set, static)
    posture = static_posture(static, marker_set, still_window(static, marker_set.labels).frames)
    legs = lower_body(posture, height, HipCentre.HARRINGTON)
    found = degrees(standing_ankles(posture, legs, static.facts.static_plantarflexion, AnkleZero.AUTO))
    points = ezc3d.c3d(str(data_dir / file))
    labels = [label.split(":")[-1] for label in points["parameters"]["POINT"]["LABELS"]["value"]]
    angles = [np.nanmean(points["data"]["points"][0, labels.index(f"{s}AnkleAngles")]) for s in "RL"]
    assert found == pytest.approx(angles, abs=VENDOR_DEG)


def test_the_published_protocol_keeps_the_markers() -> None:
    assert CalibrationSettings().ankle_rule == "auto"
    assert CalibrationSettings(protocol="published").ankle_rule == "markers"
    assert CalibrationSettings(protocol="published", ankle_zero="sole").ankle_rule == "sole"
