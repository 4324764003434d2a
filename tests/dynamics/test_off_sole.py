"""Frames in which the centre of pressure is not under the foot: no torque of that leg is valid in them."""

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from gaitcal.dynamics.foot_contact import FOOT_BREADTH, FootPoints, sole_of
from gaitcal.dynamics.ground_reactions import GroundReactions, ground_reactions_on_feet
from gaitcal.dynamics.off_sole import DIVIDED, MOMENT_NM, OUTLINE_M, outside_hull, sole_edge
from gaitcal.faults.foot_on_plate import Feet
from gaitcal.findings import Severity
from gaitcal.io.recording import Recording
from tests.dynamics.test_ground_contact import STANCE, TIME, right_foot, square
from tests.faults.test_foot_on_plate import HEIGHT, divided_walk, evidence

Array = NDArray[np.float64]


def reactions(recording: Recording) -> GroundReactions:
    feet = Feet(evidence(recording)).points(HEIGHT)
    return ground_reactions_on_feet(recording.plates, recording.time, feet, cutoff=None)


def test_a_divided_total_leaves_neither_leg_valid_while_both_plates_are_loaded() -> None:
    """The sum is right, and stays so for the pelvis and the masses."""
    walk = divided_walk()
    found = reactions(walk)
    both = found.loaded.all(axis=1)
    assert 0.15 < both.mean() < 0.2
    assert not found.valid_legs[both].any() and found.valid[both].mean() > 0.9
    (said,) = [f for f in found.findings if f.cause.startswith(DIVIDED)]
    assert said.severity is Severity.INFO and "0.02-0.10, 0.54-0.62 s; not valid for either leg" in said.found

    apart = tuple(replace(p, point=p.point + [0.0, 0.0, z]) for p, z in zip(walk.plates, (0.0, 0.03), strict=True))
    assert not any(f.cause.startswith(DIVIDED) for f in reactions(replace(walk, plates=apart)).findings)


def test_a_centre_of_pressure_beside_the_foot_leaves_that_leg_not_valid() -> None:
    feet = replace(right_foot(0.35), width=FOOT_BREADTH * HEIGHT)
    early = STANCE & (TIME < 0.5)

    def found(aside: float) -> GroundReactions:
        plate = square(0.0)
        point = plate.point + np.where(early, aside, 0.0)[:, None] * [0.0, 0.0, 1.0]
        return ground_reactions_on_feet([replace(plate, point=point)], TIME, feet, cutoff=None)

    half = 0.5 * FOOT_BREADTH * HEIGHT
    under, beside = found(half), found(half + OUTLINE_M + MOMENT_NM / 700.0 + 0.02)
    assert under.valid_legs.all()
    np.testing.assert_array_equal(beside.valid_legs[:, 0], ~early)
    assert beside.valid_legs[:, 1].all()
    np.testing.assert_array_equal(beside.valid, under.valid)
    (said,) = [f for f in beside.findings if "leaves the right foot" in f.cause]
    assert said.leg == "r" and "0.20-0.49 s" in said.found


numbers = st.lists(st.floats(-0.03, 0.03), min_size=24, max_size=24)
DENSE = np.linspace(0.0, 1.0, 500)[:, None, None]


@given(numbers, st.lists(st.tuples(st.floats(0.0, 2.0 * np.pi), st.floats(0.0, 0.4)), min_size=1, max_size=8))
def test_distance_from_a_hull_is_that_from_its_edges(shape: list[float], places: list[tuple[float, float]]) -> None:
    angle, away = np.array(places).T
    point = away[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    turns = np.arange(12) * np.pi / 6.0
    corners = np.column_stack([0.13 * np.cos(turns), 0.06 * np.sin(turns)]) + np.array(shape).reshape(12, 2)
    hull = ConvexHull(corners)
    ring = corners[hull.vertices]
    edges = (ring + DENSE * (np.roll(ring, -1, axis=0) - ring)).reshape(-1, 2)
    nearest = np.linalg.norm(point[:, None] - edges, axis=2).min(axis=1)
    inside = (hull.equations[:, :2] @ point.T + hull.equations[:, 2:]).max(axis=0) <= 0.0
    found, way = outside_hull(point, np.tile(corners, (len(point), 1, 1)))
    np.testing.assert_allclose(found, np.where(inside, -nearest, nearest), atol=0.0025)
    step = point[~inside] - (found[:, None] * way)[~inside]  # back by as much, along the way: on the edge
    assert (np.linalg.norm(step[:, None] - edges, axis=2).min(axis=1, initial=1.0) < 0.02).all()


def test_the_edge_holds_the_cells_of_the_sole_and_toes_keep_their_length() -> None:
    heel, toe = np.zeros((3, 2, 3)), np.zeros((3, 2, 3))
    heel[:, :, 1] = np.array([0.0, 0.05, 0.12])[:, None]  # the heel rises over the toe marker
    toe[:, :, 0] = np.sqrt(0.19**2 - heel[:, :, 1] ** 2)
    tip = toe + (toe - heel) / 0.19 * 0.07
    still = np.zeros((3, 2))
    feet = FootPoints(heel=heel, toe=toe, tip=tip, heel_speed=still, toe_speed=still, width=0.09)
    edge = sole_edge(feet, 0, slice(0, 3))
    cells = sole_of(feet, 0, slice(0, 3)).cells[:, :, [0, 2]]
    for k in range(cells.shape[1]):
        assert (outside_hull(cells[:, k], edge)[0] <= 0.0).all()
    np.testing.assert_allclose(edge[:, :, 0].max(axis=1) - toe[:, 0, 0], 0.07)


def test_a_small_load_leaves_its_centre_open_and_a_great_one_does_not() -> None:
    """60 mm beside the foot: noise of 1.5 N·m at 25 N, and no noise at all at 700 N."""
    feet = replace(right_foot(0.35), width=FOOT_BREADTH * HEIGHT)
    for load, valid in ((25.0, True), (700.0, False)):
        plate = square(0.0, load=load)
        aside = replace(plate, point=plate.point + [0.0, 0.0, 0.5 * FOOT_BREADTH * HEIGHT + 0.06])
        legs = ground_reactions_on_feet([aside], TIME, feet, cutoff=None).valid_legs
        assert bool(legs[STANCE, 0].all()) is valid
