"""Which frames are valid for each leg: its foot wholly on plates of its own, or in the air; told
without forces.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from gaitcal.dynamics.foot_contact import (
    LANDING_S,
    LEAVING_S,
    RESTING_SPEED,
    FootPoints,
    build_sole,
    compute_distance_to_line,
    estimate_ground_velocity,
)
from gaitcal.dynamics.ground_reactions import GroundReactions, compute_foot_reactions, get_leg
from gaitcal.dynamics.plate_outline import (
    compute_depth_inside,
    compute_foot_tip,
    compute_share_outside,
)
from gaitcal.errors import Code
from gaitcal.io.force_plate import filter_plate, resample_wrench
from gaitcal.io.labels import FootEvent, FootMoment
from gaitcal.io.recording import ForcePlate
from tests.messages import check_text

TIME = np.arange(0.0, 1.0, 0.01)
STANCE = (TIME >= 0.2) & (TIME <= 0.8)
HEEL_ONLY = (TIME >= 0.2) & (TIME < 0.3)
"""The heel is down, the toes still move."""
HEIGHT = 1.8


def square(x: float, name: str = "1", load: float = 700.0, pressed: float = 0.25) -> ForcePlate:
    """A plate of 0.5 m from x on, loaded in stance `pressed` m from its edge."""
    corners = np.array(
        [[x, 0.0, -0.25], [x + 0.5, 0.0, -0.25], [x + 0.5, 0.0, 0.25], [x, 0.0, 0.25]]
    )
    force = np.zeros((len(TIME), 3))
    force[STANCE, 1] = load
    point = np.tile([x + pressed, 0.0, 0.0], (len(TIME), 1))
    return ForcePlate(
        name=name, time=TIME, force=force, point=point, moment=np.zeros_like(force), corners=corners
    )


def right_foot(toe: float) -> FootPoints:
    """The right foot stands with its toe marker at x = `toe`; the left swings high above."""
    nf = len(TIME)
    heel, toes = np.zeros((nf, 2, 3)), np.zeros((nf, 2, 3))
    heel[:, 0, 0], toes[:, 0, 0] = toe - 0.2, toe
    heel[:, 1], toes[:, 1] = (9.0, 1.0, 9.0), (9.2, 1.0, 9.0)
    heel_speed, toe_speed = np.full((nf, 2), 2.0), np.full((nf, 2), 2.0)
    heel_speed[STANCE, 0] = 0.0
    toe_speed[STANCE & ~HEEL_ONLY, 0] = 0.0
    tip = compute_foot_tip(heel, toes, HEIGHT)
    return FootPoints(heel=heel, toe=toes, tip=tip, heel_speed=heel_speed, toe_speed=toe_speed)


def found(toe: float | FootPoints, *plates: ForcePlate, **options: Any) -> GroundReactions:
    feet = right_foot(toe) if isinstance(toe, float) else toe
    return compute_foot_reactions(plates, TIME, feet, cutoff=None, **options)


@pytest.mark.parametrize(
    ("toe", "plates"),
    [
        (0.35, [square(0.0)]),
        (0.35, [square(0.0, load=100.0)]),  # the size of the force plays no part
        (0.49, [square(0.0), square(0.5, "2", pressed=0.03)]),  # across two plates
        (0.6, [replace(square(0.0), corners=None)]),  # nothing is known of the outline
    ],
)
def test_a_foot_wholly_on_its_plates_is_valid_throughout(
    toe: float, plates: list[ForcePlate]
) -> None:
    np.testing.assert_array_equal(found(toe, *plates).valid, STANCE)


def test_toes_beside_the_plate_are_not_valid_once_they_rest() -> None:
    reactions = found(0.49, square(0.0, pressed=0.35))
    np.testing.assert_array_equal(reactions.valid, HEEL_ONLY)
    pushing_off = (TIME > 0.8) & (TIME < 0.8 + LEAVING_S - 1e-6)
    np.testing.assert_array_equal(reactions.valid_r, HEEL_ONLY | ~STANCE & ~pushing_off)
    assert reactions.valid_l.all(), "the left leg swings"
    (finding,) = [f for f in reactions.findings if f.code is Code.FOOT_BESIDE_PLATE]
    assert finding.leg == "r" and "0.30-0.89 s" in finding.found


def test_a_foot_across_two_plates_gets_the_sum_of_both() -> None:
    """By hand: 700 N at x = 0.25 m and 400 N at x = 0.53 m, both upwards; their moments about z add
    up too.
    """
    wrench = found(0.49, square(0.0), square(0.5, "2", load=400.0, pressed=0.03)).wrench
    np.testing.assert_allclose(
        wrench[STANCE, 0], np.tile([0, 1100.0, 0, 0, 0, 387.0], (STANCE.sum(), 1)), rtol=1e-12
    )
    assert not wrench[~STANCE].any() and not wrench[:, 1].any()


def test_a_knock_is_no_step() -> None:
    plate = square(0.0)
    knocked = replace(
        plate, force=np.where((TIME > 0.9) & (TIME < 0.94), 300.0, 0.0)[:, None] * [0.0, 1.0, 0.0]
    )
    reactions = found(0.35, knocked)
    assert not reactions.wrench.any() and not reactions.loaded.any() and reactions.notes == ()


def test_a_plate_that_the_study_leaves_out_carries_nothing() -> None:
    reactions = found(0.35, square(0.0), assigned={"1": "none"})
    assert not reactions.wrench.any() and not reactions.valid.any()
    assert reactions.notes == () and reactions.warnings == ()


def test_a_load_far_from_both_feet_is_given_to_none() -> None:
    reactions = found(0.35, square(2.0))
    assert not reactions.wrench.any()
    (told,) = reactions.warnings
    check_text(told, 1, 0.2, 0.8)


def test_frames_that_any_plate_did_not_record_are_not_valid() -> None:
    """The other foot might stand on it."""
    empty, gap = square(2.0, "2", load=0.0), slice(40, 43)
    force, expected = empty.force.copy(), STANCE.copy()
    force[gap], expected[gap] = np.nan, False
    np.testing.assert_array_equal(
        found(0.35, square(0.0), replace(empty, force=force)).valid, expected
    )


def left_on_the_floor(feet: FootPoints, first: float, last: float, end: str = "heel") -> FootPoints:
    """The left foot is down from `first` to `last` with one end alone."""
    speed = getattr(feet, f"{end}_speed").copy()
    speed[(first - 1e-6 < TIME) & (last + 1e-6 > TIME), 1] = 0.0
    return replace(feet, **{f"{end}_speed": speed})


def on_the_floor(
    around: tuple[float, float], first: float = 0.45, last: float = 0.55
) -> NDArray[np.bool_]:
    return (first - around[0] + 1e-6 < TIME) & (last + around[1] - 1e-6 > TIME)


@pytest.mark.parametrize("end", ["heel", "toe"])
@pytest.mark.parametrize("corners", [True, False])
def test_a_foot_beside_all_plates_spoils_its_own_leg(end: str, corners: bool) -> None:
    """For a little before and after nothing is known; the other foot, whose load stays under it, is
    not concerned.
    """
    feet = left_on_the_floor(right_foot(0.35), 0.45, 0.55, end)
    plate = square(0.0) if corners else replace(square(0.0), corners=None)
    reactions = found(feet, plate)
    np.testing.assert_array_equal(reactions.valid_l, ~on_the_floor((LANDING_S, LEAVING_S)))
    assert reactions.valid_r.all()
    np.testing.assert_array_equal(reactions.valid, STANCE & reactions.valid_l)


def strike_and_off(side: str, strike: float, off: float) -> tuple[FootEvent, FootEvent]:
    return FootEvent(FootMoment.STRIKE, side, strike), FootEvent(FootMoment.OFF, side, off)


@pytest.mark.parametrize("late", [0.0, 0.2])
def test_events_that_agree_with_the_plates_tell_when_a_foot_is_on_the_floor(late: float) -> None:
    """Between the frames next to them; events of another clock tell nothing."""
    feet = left_on_the_floor(right_foot(0.35), 0.45, 0.55)
    events = (*strike_and_off("r", 0.19 + late / 3, 0.81), *strike_and_off("l", 0.435, 0.605))
    around = (0.015, 0.055) if late == 0.0 else (LANDING_S, LEAVING_S)
    np.testing.assert_array_equal(
        found(feet, square(0.0), events=events).valid_l, ~on_the_floor(around)
    )


def left_foot_here(feet: FootPoints, heel: float, moving: bool = False) -> FootPoints:
    """The left foot beside the right one, 0.2 m to the left, from 0.5 s on; before it swings far
    above.
    """
    points = {name: getattr(feet, name).copy() for name in ("heel", "toe", "tip")}
    for name, x in (("heel", heel), ("toe", heel + 0.2), ("tip", heel + 0.27)):
        points[name][:, 1] = x, 0.0, -0.2
    speed = feet.heel_speed.copy()
    speed[(TIME > 0.495) & (TIME < 0.905), 1] = 2.0 if moving else 0.0
    return replace(feet, heel_speed=speed, **points)


def test_two_feet_on_one_plate_are_both_not_valid() -> None:
    """A foot that swings over the plate of the other shares nothing."""
    reactions = found(left_foot_here(right_foot(0.35), 0.1), square(0.0))
    together = (TIME > 0.495) & STANCE
    assert (
        not reactions.valid_legs[together].any()
        and reactions.valid_legs[STANCE & (TIME < 0.41)].all()
    )
    assert any(f.code is Code.BOTH_FEET and not f.leg for f in reactions.findings)
    assert found(left_foot_here(right_foot(0.35), 0.1, moving=True), square(0.0)).valid_legs.all()


def test_without_corners_the_pressure_leaves_the_sole_of_one_foot_where_two_are_on_the_plate() -> (
    None
):
    plate, feet = replace(square(0.0), corners=None), left_foot_here(right_foot(0.35), 0.1)
    assert found(feet, plate).valid_r.all()
    between = np.where((TIME > 0.5)[:, None], [0.25, 0.0, -0.08], plate.point)
    shared = found(feet, replace(plate, point=between))
    assert not shared.valid_legs[(TIME > 0.505) & STANCE].any() and shared.valid_r[TIME < 0.4].all()


@pytest.mark.parametrize("corners", [True, False])
def test_the_pressure_on_a_step_is_under_the_foot_where_a_leaning_force_meets_its_surface(
    corners: bool,
) -> None:
    """A force that leans by a fifth meets the floor 40 mm beside; the other foot is down there."""
    height = 0.2
    feet = left_foot_here(right_foot(0.35), -0.5)
    plate = square(0.0)
    assert plate.corners is not None
    step = replace(
        plate,
        force=plate.force + 0.2 * plate.force[:, [1]] * [0.0, 0.0, 1.0],
        point=plate.point + [0.0, height, 0.0],
        corners=plate.corners + [0.0, height, 0.0] if corners else None,
    )
    reactions = found(feet, step)
    assert reactions.valid_r.all() and not reactions.valid_l[(TIME > 0.505) & STANCE].any()
    assert not any(f.code is Code.BOTH_FEET for f in reactions.findings)


def test_one_plate_carries_one_foot_after_the_other() -> None:
    """A loading without a pause: the right foot, then both, then the left alone; each gets its own
    part.
    """
    feet = left_foot_here(right_foot(0.35), 0.1)
    speed = {name: getattr(feet, name).copy() for name in ("heel_speed", "toe_speed")}
    for value in speed.values():
        value[TIME > 0.6, 0] = 2.0
    plate = square(0.0)
    point = np.where((TIME > 0.6)[:, None], [0.2, 0.0, -0.2], plate.point)
    reactions = found(replace(feet, **speed), replace(plate, point=point))
    assert (
        reactions.loaded[TIME < 0.55][:, 1].sum() == 0
        and reactions.loaded[(TIME > 0.7) & STANCE, 1].all()
    )
    alone = (TIME > 0.78) & STANCE
    assert reactions.valid_legs[alone].all() and not reactions.wrench[alone, 0].any()
    assert not reactions.valid_legs[(TIME > 0.495) & (TIME < 0.6)].any()


def along_the_side(aside: float, pressed: float) -> GroundReactions:
    """The plate ends 0.25 m to the right; the foot's middle lies at `aside`, the centre of pressure
    at `pressed`.
    """
    feet = right_foot(0.35)
    points = {name: getattr(feet, name).copy() for name in ("heel", "toe", "tip")}
    for path in points.values():
        path[:, 0, 2] = aside
    plate = square(0.0, pressed=0.34)
    plate = replace(plate, point=plate.point + [0.0, 0.0, pressed])
    return found(replace(feet, width=0.09, **points), plate)


@pytest.mark.parametrize(("pressed", "valid"), [(0.2, True), (0.245, False)])
def test_a_small_overhang_counts_where_the_pressure_comes_near(pressed: float, valid: bool) -> None:
    """Of the ball of the foot, where it is widest, 12 mm lie beside the plate."""
    assert bool(along_the_side(0.226, pressed).valid_r[STANCE].all()) is valid


@pytest.mark.parametrize(("aside", "valid"), [(0.0, True), (0.21, True), (0.25, False)])
def test_a_sole_has_width(aside: float, valid: bool) -> None:
    """A foot along the side of its plate hangs over with a half of its width."""
    assert bool(along_the_side(aside, min(aside, 0.2)).valid_r[STANCE].all()) is valid


def test_a_heel_beside_its_plate_is_lost_while_it_rests_though_the_sole_is_not() -> None:
    """39 mm of the heel, under a tenth of the sole, bear 60 % of the body in a real walk, the
    pressure far ahead.
    """
    feet, lifted = right_foot(-0.054 + 0.2), TIME > 0.6
    speed = feet.heel_speed.copy()
    speed[lifted, 0] = 2.0
    feet = replace(feet, heel_speed=speed)
    sole = build_sole(feet, 0, slice(0, len(TIME)))
    assert sole.sum_share(sole.find_cells_off_plates([square(0.0)])).max() < 0.1
    np.testing.assert_array_equal(found(feet, square(0.0, pressed=0.15)).valid, STANCE & lifted)


@pytest.mark.parametrize(("begin", "end"), [(0.25, 0.8), (0.2, 0.75)])
def test_a_foot_beside_its_plate_is_lost_before_and_after_the_plate_reads(
    begin: float, end: float
) -> None:
    """The heel stands beside the plate 50 ms before it is loaded, or the toes 50 ms after it is."""
    plate = square(0.0, pressed=0.2 if begin > 0.2 else 0.3)
    plate = replace(
        plate, force=np.where(((begin < TIME) & (end > TIME))[:, None], plate.force, 0.0)
    )
    feet = right_foot(0.14 if begin > 0.2 else 0.49)
    if begin > 0.2:
        speed = np.where(
            (TIME > 0.4)[:, None], 2.0, feet.heel_speed
        )  # the heel lifts: later the foot is on its plate
        lost, feet = (
            (TIME > 0.2 - LANDING_S + 1e-6) & (TIME < 0.405),
            replace(feet, heel_speed=speed),
        )
    else:
        lost = (TIME > 0.295) & (TIME < 0.8 + LEAVING_S - 1e-6)
    np.testing.assert_array_equal(found(feet, plate).valid_r, ~lost)


def test_toes_that_reach_a_little_onto_the_plate_of_the_other_foot_share_nothing() -> None:
    """Both plates end there: to the millimetre nobody knows on which of them such toes are."""
    feet = left_foot_here(right_foot(0.449), 0.6)
    plates = [square(0.0), square(0.5, "2", pressed=0.15)]
    plates[1] = replace(plates[1], point=plates[1].point + [0.0, 0.0, -0.2])
    assert feet.tip[0, 0, 0] > 0.52 and found(feet, *plates).valid_r.all()


def test_a_small_gap_between_plates_is_no_floor() -> None:
    """One of them is hardly loaded: it is a part of the surface all the same."""
    near, far = square(0.0, pressed=0.35), square(0.504, "2", load=0.0)
    assert found(0.49, near, far).valid_r.all()
    assert not found(0.49, near, square(0.58, "2", load=0.0)).valid_r.all()


@pytest.mark.parametrize(
    ("name", "side"),
    [("hip_flexion_r", "r"), ("knee_adduction_l", "l"), ("subtalar_angle_l", "l")]
    + [(name, "") for name in ("pelvis_tilt", "lumbar_bending", "arm_flex_r", "elbow_flex_l")],
)
def test_what_belongs_to_a_leg_is_valid_by_its_foot(name: str, side: str) -> None:
    reactions = found(left_on_the_floor(right_foot(0.35), 0.4, 0.5), square(0.0))
    expected = {"r": reactions.valid_r, "l": reactions.valid_l, "": reactions.valid}[side]
    assert get_leg(name) == side
    np.testing.assert_array_equal(reactions.valid_for(name), expected)
    without = reactions.without(("l",))
    assert not without.valid_l.any() and not without.valid.any()
    np.testing.assert_array_equal(without.valid_r, reactions.valid_r)


def test_filtered_loads_keep_their_tails_and_share_nothing_with_the_next_step() -> None:
    """One plate under the right foot, then under the left: both together are the filtered plate,
    each frame of one.
    """
    cutoff, plate = 12.0, square(0.0, pressed=0.15)
    second = (TIME >= 0.47) & (TIME <= 0.8)
    force = np.where((TIME >= 0.2) & (TIME <= 0.4) | second, 700.0, 0.0)[:, None] * [0.0, 1.0, 0.0]
    plate = replace(
        plate, force=force, point=np.where(second[:, None], [0.45, 0.0, 0.0], plate.point)
    )
    heel, toe = np.zeros((len(TIME), 2, 3)), np.zeros((len(TIME), 2, 3))
    heel[:, 0, 0], toe[:, 0, 0], heel[:, 1, 0], toe[:, 1, 0] = 0.1, 0.2, 0.4, 0.5
    moving = np.full((len(TIME), 2), 2.0)
    feet = FootPoints(heel=heel, toe=toe, tip=toe, heel_speed=moving, toe_speed=moving)
    wrench = compute_foot_reactions([plate], TIME, feet, cutoff=cutoff).wrench
    filtered = resample_wrench(filter_plate(plate, cutoff), TIME)
    tails = (0.2 - 1 / cutoff < TIME) & (0.8 + 1 / cutoff > TIME)
    np.testing.assert_allclose(wrench[tails].sum(axis=1), filtered[tails], atol=1e-9)
    assert not (wrench[:, 0].any(axis=1) & wrench[:, 1].any(axis=1)).any()
    assert wrench[TIME < 0.19, 0].any() and wrench[TIME > 0.81, 1].any(), "tails"
    assert not wrench[TIME > 0.445, 0].any() and not wrench[TIME < 0.425, 1].any()


@pytest.mark.parametrize("steps", [2, 6])
def test_a_belt_that_is_never_empty_carries_feet_in_turn(steps: int) -> None:
    """Single support every 0.6 s, right first, 0.1 s of double support between: the sum tells of a
    foot only alone.
    """
    time = np.arange(0.0, 0.6 * steps, 0.01)
    turn, within = (time // 0.6).astype(int), time % 0.6
    stands = turn % 2
    both = (within >= 0.5) & (turn < steps - 1)
    heel_speed = np.full((len(time), 2), 2.0)
    heel_speed[np.arange(len(time)), stands] = 0.0
    heel_speed[both] = 0.0
    heel = np.zeros((len(time), 2, 3)) + [[-0.1, 0.0, 0.2], [-0.1, 0.0, -0.2]]
    toe = heel + [0.2, 0.0, 0.0]
    feet = FootPoints(
        heel=heel, toe=toe, tip=toe, heel_speed=heel_speed, toe_speed=heel_speed.copy(), width=0.09
    )
    share = np.where(both, (within - 0.5) / 0.1, 0.0)
    z = np.array([0.2, -0.2])[stands] * (1.0 - 2.0 * share)
    load = np.tile([0.0, 700.0, 0.0], (len(time), 1))
    corners = np.array([[-1.0, 0.0, -0.5], [1.0, 0.0, -0.5], [1.0, 0.0, 0.5], [-1.0, 0.0, 0.5]])
    point = np.stack([0.0 * z, 0.0 * z, z], axis=1)
    belt = ForcePlate(
        name="1", time=time, force=load, point=point, moment=0.0 * load, corners=corners
    )
    made = compute_foot_reactions([belt], time, feet, cutoff=None)
    assert [foot for _, foot, _ in made.steps] == [k % 2 for k in range(steps)]
    np.testing.assert_allclose(made.wrench.sum(axis=1)[:, 1], 700.0)
    middle = (within > 0.12) & (within < 0.38)
    assert made.valid[middle].all() and not made.valid[both].any()
    assert (made.wrench[middle, stands[middle], 1] == 700.0).all()
    assert ["carries both feet at once" in f.found for f in made.findings] == [True]


def test_the_load_outside_the_corners_is_weighed() -> None:
    """By hand: 900 N inside, 100 N a metre outside: a tenth of the load, though half of the
    samples.
    """
    plate = square(0.0)
    force, point = np.zeros((2, 3)), np.array([[0.25, 0.0, 0.0], [1.5, 0.0, 0.0]])
    force[:, 1] = 900.0, 100.0
    pressed = replace(plate, time=TIME[:2], force=force, point=point)
    assert plate.corners is not None
    assert compute_share_outside(pressed, plate.corners, 20.0) == pytest.approx(
        (0.1, 1.0), rel=1e-12
    )


def test_distance_to_a_foot_ends_at_heel_and_toe() -> None:
    heel, toe = np.zeros((3, 2)), np.tile([0.2, 0.0], (3, 1))
    points = np.array([[0.1, 0.05], [0.5, 0.0], [-0.3, 0.4]])
    np.testing.assert_allclose(compute_distance_to_line(points, heel, toe), [0.05, 0.3, 0.5])


def test_corners_that_the_pressure_leaves_are_not_used() -> None:
    elsewhere = replace(square(0.0), corners=square(0.9).corners)
    reactions = found(0.35, elsewhere)
    np.testing.assert_array_equal(reactions.valid, STANCE)
    assert any(f.code is Code.PLATE_CORNERS for f in reactions.findings)


@given(
    angle=st.floats(-3.0, 3.0),
    along=st.floats(-0.4, 0.4),
    across=st.floats(-0.4, 0.4),
    turned=st.booleans(),
)
def test_depth_in_a_turned_plate(angle: float, along: float, across: float, turned: bool) -> None:
    half = np.array([0.3, 0.2])
    c, s = np.cos(angle), np.sin(angle)

    def at(x: float, z: float) -> NDArray[np.float64]:
        return np.array([1.0 + c * x - s * z, 0.0, -2.0 + s * x + c * z])

    corners = np.array([at(*half), at(-half[0], half[1]), at(*-half), at(half[0], -half[1])])
    depth = compute_depth_inside(corners[::-1] if turned else corners, at(along, across)[None])[0]
    assert depth == pytest.approx(min(half[0] - abs(along), half[1] - abs(across)), abs=1e-12)


@pytest.mark.parametrize("belt", [0.0, 0.2, 1.3])
def test_a_moving_belt_is_found_under_the_feet(belt: float) -> None:
    """The stance foot is the lower one; below the speed of a resting foot there is no belt to speak
    of.
    """
    nf = len(TIME)
    points, velocity = np.zeros((nf, 4, 3)), np.zeros((nf, 4, 3))
    velocity[:, :, 0] = 2.0
    stance = np.where((TIME * 5).astype(int) % 2 == 0, 0, 3)
    points[:, :, 1] = 0.1
    points[np.arange(nf), stance, 1] = 0.0
    velocity[np.arange(nf), stance, 0] = -belt
    expected = -belt if belt > RESTING_SPEED else 0.0
    np.testing.assert_allclose(estimate_ground_velocity(points, velocity), [expected, 0.0, 0.0])
    np.testing.assert_array_equal(
        estimate_ground_velocity(np.full((nf, 4, 3), np.nan), velocity), np.zeros(3)
    )


@pytest.mark.parametrize("belt", [0.1, 0.25, 0.35])
@pytest.mark.parametrize("on_belt", [False, True])
def test_a_slow_belt_is_told_by_feet_that_get_no_further(belt: float, on_belt: bool) -> None:
    """The same slow walk on a belt, and over a floor: 70 % stance, points of the sole that roll at
    0.04 m/s.
    """
    time = np.arange(0.0, 6.0, 0.01)
    velocity, points = np.zeros((len(time), 4, 3)), np.zeros((len(time), 4, 3))
    for point, phase in enumerate(
        (0.0, 0.5, 0.05, 0.55)
    ):  # heels, toes, of the right and the left foot
        swing = (time / 1.5 + phase) % 1.0 > 0.7
        velocity[:, point, 0] = np.where(swing, belt / 0.3, 0.04 * np.sin(9.0 * time)) - (
            belt if on_belt else 0.0
        )
        points[:, point, 1] = np.where(swing, 0.08, 0.0)
    found = estimate_ground_velocity(points, velocity)
    np.testing.assert_allclose(found, [-belt if on_belt else 0.0, 0.0, 0.0], atol=0.03)
    assert on_belt or not found.any()
