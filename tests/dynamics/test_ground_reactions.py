"""From force plates to torques: as in a calibration; pressure beside the sole; clear words for what
cannot be.
"""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

import gaitcal as gc
from gaitcal.dynamics.foot_contact import FOOT_BREADTH, RESTING_SPEED, FootPoints, build_sole
from gaitcal.dynamics.ground_reactions import (
    GroundReactions,
    compute_foot_points,
    compute_foot_reactions,
    find_unobserved_frames,
)
from gaitcal.dynamics.off_sole import (
    DIVIDED,
    OUTLINE_ERROR_M,
    PLATE_MOMENT_NM,
    compute_distance_outside_hull,
    compute_sole_edge,
)
from gaitcal.errors import Code, Severity
from gaitcal.io.recording import Recording
from gaitcal.model.subject_model import GRAVITY
from gaitcal.preprocess.plate_contacts import Feet
from gaitcal.synthetic.synthetic_motion import simulate_gait
from tests.dynamics.test_ground_contact import STANCE, TIME, found, right_foot, square
from tests.messages import check_finding, check_text, refuses
from tests.quality.test_foot_on_plate import HEIGHT, divided_walk, evidence
from tests.synthetic_studies import made_plates, made_recording

UNEXPLAINED_N = 5.0
"""RMS of the pelvis residual that filter and splines leave of data without noise; 2.4 N in a
calibration.
"""


@pytest.fixture(scope="module")
def walk() -> Recording:
    motion = simulate_gait()
    return replace(made_recording(motion), plates=made_plates(motion))


@pytest.fixture(scope="module")
def tracked(walk: Recording) -> gc.Motion:
    return gc.track(gc.published_model(), walk)


def test_plates_of_a_recording_give_torques(walk: Recording, tracked: gc.Motion) -> None:
    model = gc.published_model()
    ground = gc.ground_reactions(model, tracked, walk)
    assert ground.wrench.shape == (len(walk.time), 2, 6)
    assert ground.valid.mean() > 0.5
    moments = gc.inverse_dynamics(model, tracked, ground.wrench)
    assert np.sqrt(np.mean(moments.residual_force[ground.valid] ** 2)) < UNEXPLAINED_N
    unfiltered = gc.ground_reactions(model, tracked, walk, cutoff_hz=None)
    check_text(unfiltered.notes)
    left = gc.ground_reactions(model, tracked, walk, plates={"1": "l", "2": "none"})
    assert not left.loaded[:, 0].any() and left.loaded[:, 1].any()


@pytest.mark.parametrize(("share", "told"), [(0.22, False), (0.28, True)])
def test_forces_that_the_motion_contradicts_are_told(
    walk: Recording, tracked: gc.Motion, share: float, told: bool
) -> None:
    """A share of body weight too much on the first plate; a quarter is the limit. The frames stay
    valid.
    """
    model = gc.published_model()
    more = share * model.subject.weight * np.array([0.0, 1.0, 0.0])
    first = walk.plates[0]
    pressed = first.force[:, 1:2] > 100.0
    spoilt = replace(first, force=first.force + pressed * more)
    found = gc.ground_reactions(
        model, tracked, replace(walk, plates=(spoilt, walk.plates[1])), cutoff_hz=None
    )
    assert any("it differs by up to" in warning for warning in found.warnings) == told
    assert found.valid.any()


def test_what_cannot_be_is_one_clear_line(walk: Recording, tracked: gc.Motion) -> None:
    model = gc.published_model()
    with refuses(Code.ARGUMENT, "gaitcal.ground_reactions", field="forces"):
        gc.inverse_dynamics(model, tracked, walk.plates)
    few = replace(tracked, coordinates=tracked.coordinates[:6])
    with refuses(Code.ARGUMENT, field="plates"):
        gc.ground_reactions(model, tracked, replace(walk, plates=()))
    with refuses(Code.ARGUMENT, "3", 1, 2, field="plates"):
        gc.ground_reactions(model, tracked, walk, plates={"3": "r"})
    with refuses(Code.ARGUMENT, f"{len(gc.COORDINATES)}", field="motion"):
        gc.ground_reactions(model, few, walk)


def test_forces_that_the_motion_contradicts_are_told_where_they_count(
    walk: Recording, tracked: gc.Motion
) -> None:
    """Plates that read half as much again; with one plate alone no frame of the other foot's step
    counts.
    """
    model = gc.published_model()
    heavy = replace(
        walk,
        plates=tuple(replace(p, force=1.5 * p.force, moment=1.5 * p.moment) for p in walk.plates),
    )
    contradiction = "vertical force contradicts the body's acceleration"
    assert any(
        contradiction in warning for warning in gc.ground_reactions(model, tracked, heavy).warnings
    )
    for plates in ({}, {"2": "none"}):
        reactions = gc.ground_reactions(model, tracked, walk, plates=plates)
        assert reactions.valid.any()
        assert not any(contradiction in warning for warning in reactions.warnings)


def test_a_belt_under_the_feet_changes_no_speed(tracked: gc.Motion) -> None:
    model, belt = gc.published_model(), 1.3
    drift = np.zeros_like(tracked.q)
    drift[:, 0] = -belt * tracked.time
    carried = replace(tracked, coefficients=tracked.coefficients + tracked.basis.fit(drift))
    still, moving = (compute_foot_points(model, m, model.parameters) for m in (tracked, carried))
    for name in ("heel", "toe"):
        path, speed = getattr(still, name), getattr(still, f"{name}_speed")
        np.testing.assert_allclose(
            speed, np.linalg.norm(np.gradient(path, tracked.time, axis=0), axis=2), rtol=1e-9
        )
        np.testing.assert_allclose(
            getattr(moving, f"{name}_speed"), speed, atol=0.5 * RESTING_SPEED
        )


def test_feet_at_the_top_of_a_jump_rest_on_nothing(tracked: gc.Motion) -> None:
    """A posture that falls freely: its feet stand still for a moment, as they do on the ground."""
    model, time = gc.published_model(), tracked.time
    q = np.repeat(tracked.q[:1], len(time), axis=0)
    top = len(time) // 2
    for weight, rests in ((0.0, True), (1.0, False)):
        q[:, 1] = 1.0 - 0.5 * weight * GRAVITY * (time - time[top]) ** 2
        still = replace(tracked, coefficients=tracked.basis.fit(q))
        feet = compute_foot_points(model, still, model.parameters)
        assert (
            (feet.heel_speed[top] < RESTING_SPEED).all()
            == (feet.toe_speed[top] < RESTING_SPEED).all()
            == rests
        )


def test_a_leg_that_no_weighted_marker_shows_is_not_valid(
    walk: Recording, tracked: gc.Motion
) -> None:
    """Nor does a marker without weight show it."""
    model, errors, hidden = gc.published_model(), tracked.errors, slice(60, 70)
    shank = np.array([s == "shank_r" for s in errors.segments])
    lightest = np.flatnonzero(shank)[0]
    distance, weight = errors.distance.copy(), errors.weight.copy()
    distance[hidden, shank & (np.arange(len(shank)) != lightest)] = np.nan
    weight[lightest] = 0.0
    motion = replace(tracked, errors=replace(errors, distance=distance, weight=weight))
    (name, lost), *others = find_unobserved_frames(motion).items()
    assert name == "shank_r" and others == []
    np.testing.assert_array_equal(np.flatnonzero(lost), np.arange(60, 70))
    before, after = (gc.ground_reactions(model, m, walk) for m in (tracked, motion))
    assert before.valid[hidden].all(), "valid while the shank is seen"
    np.testing.assert_array_equal(after.valid, before.valid & ~lost)
    np.testing.assert_array_equal(after.valid_r, before.valid_r & ~lost)
    np.testing.assert_array_equal(after.valid_l, before.valid_l, err_msg="the other leg stays")


def reactions(recording: Recording) -> GroundReactions:
    feet = Feet(recording.time, evidence(recording).landmark).build_points(HEIGHT)
    return compute_foot_reactions(recording.plates, recording.time, feet, cutoff=None)


def test_a_divided_total_leaves_neither_leg_valid_while_both_plates_are_loaded() -> None:
    """The sum is right, and stays so for the pelvis and the masses."""
    walk = divided_walk()
    found = reactions(walk)
    both = found.loaded.all(axis=1)
    assert 0.15 < both.mean() < 0.2
    assert not found.valid_legs[both].any() and found.valid[both].mean() > 0.9
    (said,) = [f for f in found.findings if f.cause.startswith(DIVIDED)]
    check_finding(said, Code.DIVIDED_FORCE, Severity.INFO, 0.02, 0.1, 0.54, 0.62)

    apart = tuple(
        replace(p, point=p.point + [0.0, 0.0, z])
        for p, z in zip(walk.plates, (0.0, 0.03), strict=True)
    )
    assert not any(
        f.cause.startswith(DIVIDED) for f in reactions(replace(walk, plates=apart)).findings
    )


def test_a_centre_of_pressure_beside_the_foot_leaves_that_leg_not_valid() -> None:
    feet = replace(right_foot(0.35), width=FOOT_BREADTH * HEIGHT)
    early = STANCE & (TIME < 0.5)

    def pressed(aside: float) -> GroundReactions:
        plate = square(0.0)
        point = plate.point + np.where(early, aside, 0.0)[:, None] * [0.0, 0.0, 1.0]
        return found(feet, replace(plate, point=point))

    half = 0.5 * FOOT_BREADTH * HEIGHT
    under, beside = pressed(half), pressed(half + OUTLINE_ERROR_M + PLATE_MOMENT_NM / 700.0 + 0.02)
    assert under.valid_legs.all()
    np.testing.assert_array_equal(beside.valid_legs[:, 0], ~early)
    assert beside.valid_legs[:, 1].all()
    np.testing.assert_array_equal(beside.valid, under.valid)
    (said,) = [f for f in beside.findings if "leaves the right foot" in f.cause]
    assert said.leg == "r" and "0.20-0.49 s" in said.found


numbers = st.lists(st.floats(-0.03, 0.03), min_size=24, max_size=24)
DENSE = np.linspace(0.0, 1.0, 500)[:, None, None]


@given(
    numbers,
    st.lists(st.tuples(st.floats(0.0, 2.0 * np.pi), st.floats(0.0, 0.4)), min_size=1, max_size=8),
)
def test_distance_from_a_hull_is_that_from_its_edges(
    shape: list[float], places: list[tuple[float, float]]
) -> None:
    angle, away = np.array(places).T
    point = away[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    turns = np.arange(12) * np.pi / 6.0
    corners = np.column_stack([0.13 * np.cos(turns), 0.06 * np.sin(turns)]) + np.array(
        shape
    ).reshape(12, 2)
    hull = ConvexHull(corners)
    ring = corners[hull.vertices]
    edges = (ring + DENSE * (np.roll(ring, -1, axis=0) - ring)).reshape(-1, 2)
    nearest = np.linalg.norm(point[:, None] - edges, axis=2).min(axis=1)
    inside = (hull.equations[:, :2] @ point.T + hull.equations[:, 2:]).max(axis=0) <= 0.0
    found, way = compute_distance_outside_hull(point, np.tile(corners, (len(point), 1, 1)))
    np.testing.assert_allclose(found, np.where(inside, -nearest, nearest), atol=0.0025)
    step = (
        point[~inside] - (found[:, None] * way)[~inside]
    )  # back by as much, along the way: on the edge
    assert (np.linalg.norm(step[:, None] - edges, axis=2).min(axis=1, initial=1.0) < 0.02).all()


def test_the_edge_holds_the_cells_of_the_sole_and_toes_keep_their_length() -> None:
    heel, toe = np.zeros((3, 2, 3)), np.zeros((3, 2, 3))
    heel[:, :, 1] = np.array([0.0, 0.05, 0.12])[:, None]  # the heel rises over the toe marker
    toe[:, :, 0] = np.sqrt(0.19**2 - heel[:, :, 1] ** 2)
    tip = toe + (toe - heel) / 0.19 * 0.07
    still = np.zeros((3, 2))
    feet = FootPoints(heel=heel, toe=toe, tip=tip, heel_speed=still, toe_speed=still, width=0.09)
    edge = compute_sole_edge(feet, 0, slice(0, 3))
    cells = build_sole(feet, 0, slice(0, 3)).cells[:, :, [0, 2]]
    for k in range(cells.shape[1]):
        assert (compute_distance_outside_hull(cells[:, k], edge)[0] <= 0.0).all()
    np.testing.assert_allclose(edge[:, :, 0].max(axis=1) - toe[:, 0, 0], 0.07)


def test_a_small_load_leaves_its_centre_open_and_a_great_one_does_not() -> None:
    """60 mm beside the foot: noise of 1.5 N·m at 25 N, and no noise at all at 700 N."""
    feet = replace(right_foot(0.35), width=FOOT_BREADTH * HEIGHT)
    for load, valid in ((25.0, True), (700.0, False)):
        plate = square(0.0, load=load)
        aside = replace(plate, point=plate.point + [0.0, 0.0, 0.5 * FOOT_BREADTH * HEIGHT + 0.06])
        assert bool(found(feet, aside).valid_legs[STANCE, 0].all()) is valid
