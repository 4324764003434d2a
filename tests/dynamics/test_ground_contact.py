"""Which frames are valid: every foot on the ground wholly on a plate, told by geometry and motion, not by force."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from gaitcal.dynamics.ground_contact import (
    EDGE,
    RESTING,
    FootPoints,
    GroundReactions,
    distance_to_line,
    ground_reactions_on_feet,
    ground_velocity,
)
from gaitcal.dynamics.plate_outline import FOOT_LENGTH, OVERHANG_M, foot_tip, inside, outside, share_outside
from gaitcal.recording import filter_plate, resample_wrench
from gaitcal.recording.recording import ForcePlate

TIME = np.arange(0.0, 1.0, 0.01)
STANCE = (TIME >= 0.2) & (TIME <= 0.8)
HEEL_ONLY = (TIME >= 0.2) & (TIME < 0.3)
"""The heel is down, the toes still move."""
HEIGHT = 1.8


def square(x: float, name: str = "1", load: float = 700.0, pressed: float = 0.25) -> ForcePlate:
    """A plate of 0.5 m from x on, loaded in stance `pressed` m from its edge."""
    corners = np.array([[x, 0.0, -0.25], [x + 0.5, 0.0, -0.25], [x + 0.5, 0.0, 0.25], [x, 0.0, 0.25]])
    force = np.zeros((len(TIME), 3))
    force[STANCE, 1] = load
    point = np.tile([x + pressed, 0.0, 0.0], (len(TIME), 1))
    return ForcePlate(name=name, time=TIME, force=force, point=point, moment=np.zeros_like(force), corners=corners)


def right_foot(toe: float) -> FootPoints:
    """The right foot stands with its toe marker at x = `toe`; the left swings high above."""
    nf = len(TIME)
    heel, toes = np.zeros((nf, 2, 3)), np.zeros((nf, 2, 3))
    heel[:, 0, 0], toes[:, 0, 0] = toe - 0.2, toe
    heel[:, 1], toes[:, 1] = (9.0, 1.0, 9.0), (9.2, 1.0, 9.0)
    heel_speed, toe_speed = np.full((nf, 2), 2.0), np.full((nf, 2), 2.0)
    heel_speed[STANCE, 0] = 0.0
    toe_speed[STANCE & ~HEEL_ONLY, 0] = 0.0
    tip = foot_tip(heel, toes, HEIGHT)
    return FootPoints(heel=heel, toe=toes, tip=tip, heel_speed=heel_speed, toe_speed=toe_speed)


def found(toe: float, *plates: ForcePlate) -> GroundReactions:
    return ground_reactions_on_feet(plates, TIME, right_foot(toe), cutoff=None)


def test_a_foot_wholly_on_its_plate_is_valid_throughout() -> None:
    np.testing.assert_array_equal(found(0.35, square(0.0)).valid, STANCE)


def test_toes_beside_the_plate_are_not_valid_once_they_rest() -> None:
    reactions = found(0.49, square(0.0))
    np.testing.assert_array_equal(reactions.valid, HEEL_ONLY)
    told = [f.found for f in reactions.findings if "beside the plate" in f.found]
    away = 1e3 * (0.29 + FOOT_LENGTH * HEIGHT - 0.5)
    assert len(told) == 1
    assert f"toes of the right foot rest up to {away:.0f} mm" in told[0]


def test_a_foot_across_two_plates_is_measured() -> None:
    np.testing.assert_array_equal(found(0.49, square(0.0), square(0.5, "2", pressed=0.03)).valid, STANCE)


def test_a_foot_across_two_plates_gets_the_sum_of_both() -> None:
    """By hand: 700 N at x = 0.25 m and 400 N at x = 0.53 m, both upwards; their moments about z add up too."""
    wrench = found(0.49, square(0.0), square(0.5, "2", load=400.0, pressed=0.03)).wrench
    np.testing.assert_allclose(wrench[STANCE, 0], np.tile([0, 1100.0, 0, 0, 0, 387.0], (STANCE.sum(), 1)), rtol=1e-12)
    assert not wrench[~STANCE].any() and not wrench[:, 1].any()


def test_a_knock_is_no_step() -> None:
    plate = square(0.0)
    knocked = replace(plate, force=np.where((TIME > 0.9) & (TIME < 0.94), 300.0, 0.0)[:, None] * [0.0, 1.0, 0.0])
    reactions = found(0.35, knocked)
    assert not reactions.wrench.any() and not reactions.loaded.any() and reactions.notes == ()


def test_a_plate_that_the_study_leaves_out_carries_nothing() -> None:
    reactions = ground_reactions_on_feet([square(0.0)], TIME, right_foot(0.35), cutoff=None, assigned={"1": "none"})
    assert not reactions.wrench.any() and not reactions.valid.any()
    assert reactions.notes == () and reactions.warnings == ()


def test_a_load_far_from_both_feet_is_given_to_none() -> None:
    reactions = found(0.35, square(2.0))
    assert not reactions.wrench.any()
    (told,) = reactions.warnings
    assert told.startswith("the load on plate 1 is under neither foot: plate 1, 0.20-0.80 s: ")


def test_frames_that_any_plate_did_not_record_are_not_valid() -> None:
    """The other foot might stand on it."""
    empty, gap = square(2.0, "2", load=0.0), slice(40, 43)
    force, expected = empty.force.copy(), STANCE.copy()
    force[gap], expected[gap] = np.nan, False
    np.testing.assert_array_equal(found(0.35, square(0.0), replace(empty, force=force)).valid, expected)


@pytest.mark.parametrize("end", ["heel", "toe"])
def test_a_foot_that_stands_beside_all_plates_spoils_its_time(end: str) -> None:
    """The left foot is down with one end alone, 0.45 to 0.55 s, and up to `EDGE` before and after nothing is known."""
    feet = right_foot(0.35)
    down = (TIME > 0.445) & (TIME < 0.555)
    speed = getattr(feet, f"{end}_speed").copy()
    speed[down, 1] = 0.0
    reactions = ground_reactions_on_feet([square(0.0)], TIME, replace(feet, **{f"{end}_speed": speed}), cutoff=None)
    away = np.maximum(0.45 - TIME, TIME - 0.55)
    clear = np.abs(away - EDGE) > 1e-6  # frames at the very edge go either way by rounding
    np.testing.assert_array_equal(reactions.valid[clear], (STANCE & (away > EDGE))[clear])


def test_resting_and_loading_may_differ_a_little() -> None:
    """The foot rests a little before its plate is loaded; no force is missing for that."""
    feet = right_foot(0.35)
    speed = feet.heel_speed.copy()
    speed[(TIME > 0.2 - 0.9 * EDGE) & (TIME < 0.3), 0] = 0.0
    reactions = ground_reactions_on_feet([square(0.0)], TIME, replace(feet, heel_speed=speed), cutoff=None)
    np.testing.assert_array_equal(reactions.valid, STANCE)


def test_filtered_loads_keep_their_tails_and_share_nothing_with_the_next_step() -> None:
    """One plate under the right foot, then under the left: both together are the filtered plate, each frame of one."""
    cutoff, plate = 12.0, square(0.0, pressed=0.15)
    second = (TIME >= 0.47) & (TIME <= 0.8)
    force = np.where((TIME >= 0.2) & (TIME <= 0.4) | second, 700.0, 0.0)[:, None] * [0.0, 1.0, 0.0]
    plate = replace(plate, force=force, point=np.where(second[:, None], [0.45, 0.0, 0.0], plate.point))
    heel, toe = np.zeros((len(TIME), 2, 3)), np.zeros((len(TIME), 2, 3))
    heel[:, 0, 0], toe[:, 0, 0], heel[:, 1, 0], toe[:, 1, 0] = 0.1, 0.2, 0.4, 0.5
    moving = np.full((len(TIME), 2), 2.0)
    feet = FootPoints(heel=heel, toe=toe, tip=toe, heel_speed=moving, toe_speed=moving)
    wrench = ground_reactions_on_feet([plate], TIME, feet, cutoff=cutoff).wrench
    filtered = resample_wrench(filter_plate(plate, cutoff), TIME)
    tails = (0.2 - 1 / cutoff < TIME) & (0.8 + 1 / cutoff > TIME)
    np.testing.assert_allclose(wrench[tails].sum(axis=1), filtered[tails], atol=1e-9)
    assert not (wrench[:, 0].any(axis=1) & wrench[:, 1].any(axis=1)).any()
    assert wrench[TIME < 0.19, 0].any() and wrench[TIME > 0.81, 1].any(), "tails"
    assert not wrench[TIME > 0.445, 0].any() and not wrench[TIME < 0.425, 1].any()


def test_the_load_outside_the_corners_is_weighed() -> None:
    """By hand: 900 N inside, 100 N a metre outside: a tenth of the load, though half of the samples."""
    plate = square(0.0)
    force, point = np.zeros((2, 3)), np.array([[0.25, 0.0, 0.0], [1.5, 0.0, 0.0]])
    force[:, 1] = 900.0, 100.0
    pressed = replace(plate, time=TIME[:2], force=force, point=point)
    assert plate.corners is not None
    assert share_outside(pressed, plate.corners, 20.0) == pytest.approx((0.1, 1.0), rel=1e-12)


def test_distance_to_a_foot_ends_at_heel_and_toe() -> None:
    heel, toe = np.zeros((3, 2)), np.tile([0.2, 0.0], (3, 1))
    points = np.array([[0.1, 0.05], [0.5, 0.0], [-0.3, 0.4]])
    np.testing.assert_allclose(distance_to_line(points, heel, toe), [0.05, 0.3, 0.5])


def test_the_size_of_the_force_plays_no_part() -> None:
    np.testing.assert_array_equal(found(0.35, square(0.0, load=100.0)).valid, STANCE)


def test_corners_that_the_pressure_leaves_are_not_used() -> None:
    elsewhere = replace(square(0.0), corners=square(0.9).corners)
    reactions = found(0.35, elsewhere)
    np.testing.assert_array_equal(reactions.valid, STANCE)
    assert any("corners not used" in f.found for f in reactions.findings)


def test_without_corners_nothing_is_known_of_the_outline() -> None:
    np.testing.assert_array_equal(found(0.6, replace(square(0.0), corners=None)).valid, STANCE)


@given(angle=st.floats(-3.0, 3.0), along=st.floats(-0.4, 0.4), across=st.floats(-0.4, 0.4), turned=st.booleans())
def test_depth_in_a_turned_plate(angle: float, along: float, across: float, turned: bool) -> None:
    half = np.array([0.3, 0.2])
    c, s = np.cos(angle), np.sin(angle)

    def at(x: float, z: float) -> NDArray[np.float64]:
        return np.array([1.0 + c * x - s * z, 0.0, -2.0 + s * x + c * z])

    corners = np.array([at(*half), at(-half[0], half[1]), at(*-half), at(half[0], -half[1])])
    depth = inside(corners[::-1] if turned else corners, at(along, across)[None])[0]
    assert depth == pytest.approx(min(half[0] - abs(along), half[1] - abs(across)), abs=1e-12)


def test_outside_is_judged_over_all_plates() -> None:
    point = np.array([[0.7, 0.0, 0.0], [1.1, 0.0, 0.0]])
    np.testing.assert_allclose(outside([square(0.0), square(0.5, "2")], point), [-0.2, 0.1], atol=1e-12)
    assert OVERHANG_M < 0.1


@pytest.mark.parametrize("belt", [0.0, 0.2, 1.3])
def test_a_moving_belt_is_found_under_the_feet(belt: float) -> None:
    """The stance foot is the lower one; below the speed of a resting foot there is no belt to speak of."""
    nf = len(TIME)
    points, velocity = np.zeros((nf, 4, 3)), np.zeros((nf, 4, 3))
    velocity[:, :, 0] = 2.0
    stance = np.where((TIME * 5).astype(int) % 2 == 0, 0, 3)
    points[:, :, 1] = 0.1
    points[np.arange(nf), stance, 1] = 0.0
    velocity[np.arange(nf), stance, 0] = -belt
    expected = -belt if belt > RESTING else 0.0
    np.testing.assert_allclose(ground_velocity(points, velocity), [expected, 0.0, 0.0])
    np.testing.assert_array_equal(ground_velocity(np.full((nf, 4, 3), np.nan), velocity), np.zeros(3))
