"""Where tracking starts: all segments fitted at once, and segments of too few markers turned about
their joint.
"""

from dataclasses import replace

import numpy as np
import pytest

from gaitcal.model.kinematics import Kinematics, compute_coordinate_axes
from gaitcal.model.linkage import ISOLATED_JOINTS, list_joint_segments
from gaitcal.model.parameters import read_published_parameters
from gaitcal.tracking.marker_residual import MarkerData, PlacedMarkers, compute_marker_positions
from gaitcal.tracking.motion import track_coefficients
from gaitcal.tracking.rigid import SegmentMoments, fit_rigid
from gaitcal.tracking.start import find_start_coordinates
from tests.derivatives import Array, random_trial, seeded_trial, started, without_segments

ROUNDING = 1e-11
"""m, rad: fits of a few markers, in doubles."""
SETTLED = 0.02
"""rad: two oblique turns are visited in turn four times, which brings them this near."""


def test_all_segments_together_are_each_fitted_as_alone() -> None:
    rng, _, problem, _ = seeded_trial(20, frames=40, nodes=8)
    weight = rng.uniform(0.2, 1.0, problem.data.weight.shape) * (
        rng.random(problem.data.weight.shape) > 0.2
    )
    noisy = problem.data.measured + rng.normal(0, 0.005, problem.data.measured.shape)
    for data in (
        replace(problem.data, measured=noisy),
        replace(problem.data, measured=noisy, weight=weight),
    ):
        together = SegmentMoments(data).fit_segments()
        assert sorted(together) == np.unique(data.segment).tolist()
        for s, found in together.items():
            own = data.segment == s
            alone = fit_rigid(data.local[own], data.measured[own], data.weight[own])
            np.testing.assert_array_equal(found.determined, alone.determined)
            known = alone.determined
            np.testing.assert_allclose(
                found.rotation[known], alone.rotation[known], rtol=0, atol=ROUNDING
            )
            np.testing.assert_allclose(
                found.origin[known], alone.origin[known], rtol=0, atol=ROUNDING
            )


@pytest.mark.parametrize("isolated", ISOLATED_JOINTS)
def test_a_part_of_the_body_starts_where_its_rigid_segments_are(isolated: str) -> None:
    """Parts whose axes are all reversed on the left, and parts in which none is."""
    segments = list_joint_segments(isolated)
    _, parameters, problem, true = seeded_trial(
        26, root=segments[0], segments=segments, frames=20, nodes=6
    )
    found = find_start_coordinates(problem.build_body(parameters), problem.data)
    expected = problem.basis.evaluate(true)
    turned = np.round((found - expected) / (2 * np.pi)) * 2 * np.pi
    np.testing.assert_allclose(found - turned, expected, atol=SETTLED)


def test_two_markers_and_the_joint_before_them_place_an_arm() -> None:
    """A rigid fit asks for three markers; the turns of elbow and shoulder are found from two all
    the same.
    """
    _, parameters, problem, true = seeded_trial(21, frames=40, nodes=8)
    place = np.zeros(len(problem.data.segment), dtype=int)
    for s in (k for k, name in enumerate(problem.chain.segments) if "arm" in name):
        place[problem.data.segment == s] = np.arange(4)
    data = with_markers(problem.data, np.flatnonzero(place < 2))
    found = find_start_coordinates(problem.build_body(parameters), data)
    off = np.abs(found - problem.basis.evaluate(true))
    columns = [
        k for k, name in enumerate(problem.chain.coordinates) if name.startswith(("arm", "elbow"))
    ]
    assert len(columns) == 6 and off[:, columns].max() < SETTLED


def with_markers(data: MarkerData, kept: Array) -> MarkerData:
    """Some of the markers."""
    placed = PlacedMarkers(data.segment[kept], data.local[kept])
    return replace(data, placed=placed, measured=data.measured[kept], weight=data.weight[kept])


def test_a_turn_past_half_a_circle_is_one_motion_about_the_least_angles() -> None:
    """A whole body that turns about the vertical from 170 to 290 deg: no jump, and most of the
    trial within 180 deg.
    """
    _, parameters, problem, _ = seeded_trial(23, frames=60, nodes=8)
    body, about = problem.build_body(parameters), problem.chain.coordinates.index("pelvis_rotation")
    q = np.zeros((60, len(problem.chain.coordinates)))
    q[:, about] = np.deg2rad(np.linspace(170.0, 290.0, 60))
    turned = replace(problem.data, measured=compute_marker_positions(body, problem.data.placed, q))
    found = find_start_coordinates(body, turned)
    np.testing.assert_allclose(found[:, about], q[:, about] - 2 * np.pi, atol=ROUNDING)


def test_a_segment_lost_for_a_while_is_bridged() -> None:
    """The shank is not seen in the middle of the trial: its knee is interpolated there and the foot
    still follows.
    """
    _, parameters, problem, true = seeded_trial(22, frames=60, nodes=8)
    gappy = without_segments(problem, "shank_r", frames=slice(20, 30))
    result = track_coefficients(gappy, *started(gappy, parameters))
    np.testing.assert_allclose(
        problem.basis.evaluate(result.x), problem.basis.evaluate(true), atol=1e-8
    )


def test_two_markers_in_disorder_do_not_turn_a_thigh_about_itself() -> None:
    """Two thigh markers, 30 mm off the line from the hip and displaced by more than that: the leg
    starts unturned.
    """
    _, parameters, problem, true = seeded_trial(22, frames=40, nodes=8)
    thigh = problem.chain.segments.index("thigh_r")
    of_thigh = np.flatnonzero(problem.data.segment == thigh)
    body = problem.build_body(parameters)
    local = problem.data.local.copy()
    local[of_thigh[:2]] = [[0.0, -0.2, 0.03], [0.0, -0.4, 0.0]]
    q, placed = problem.basis.evaluate(true), PlacedMarkers(problem.data.segment, local)
    measured = compute_marker_positions(body, placed, q)
    axes = Kinematics(body, q).axes
    measured[of_thigh[0]] -= 0.06 * axes[thigh][:, 2]
    data = replace(problem.data, placed=placed, measured=measured)
    few = with_markers(data, np.setdiff1d(np.arange(len(local)), of_thigh[2:]))
    found = find_start_coordinates(body, few)
    k = list(problem.chain.coordinates).index("hip_rotation_r")
    assert np.abs(found[:, k] - q[:, k]).max() < np.deg2rad(60.0)


def test_a_foot_of_two_markers_in_disorder_does_not_start_upside_down() -> None:
    """Heel and toe marker nearly in line with the ankle's centre, and 45 mm off: once in 80 it
    turned over.
    """
    rng = np.random.default_rng(24)
    parameters = read_published_parameters()
    problem, _ = random_trial(rng, parameters, frames=10, nodes=6)
    chain, body = problem.chain, problem.build_body(parameters)
    foot = chain.segments.index("foot_r")
    at_zero = np.zeros((1, len(chain.coordinates)))
    placed, (_, points) = (
        Kinematics(body, at_zero, columns=False),
        compute_coordinate_axes(body, at_zero),
    )
    subtalar = points[0, chain.coordinates.index("subtalar_angle_r")]
    ankle = placed.axes[foot, :, :, 0] @ (subtalar - placed.origins[foot, :, 0])
    of_foot = np.flatnonzero(problem.data.segment == foot)
    kept = np.setdiff1d(np.arange(len(problem.data.segment)), of_foot[2:])
    turns = [
        k
        for k, name in enumerate(chain.coordinates)
        if name in ("ankle_angle_r", "subtalar_angle_r")
    ]
    for _ in range(400):
        local = problem.data.local.copy()
        (heel, toe), (out_heel, out_toe) = rng.uniform(-0.04, 0.04, 2), rng.uniform(-0.01, 0.01, 2)
        local[of_foot[:2]] = ankle + np.array([[-0.05, heel, out_heel], [0.13, toe, out_toe]])
        placed = PlacedMarkers(problem.data.segment[kept], local[kept])
        measured = compute_marker_positions(body, placed, np.zeros((10, len(chain.coordinates))))
        measured[np.isin(kept, of_foot)] += rng.normal(0.0, 0.045, (2, 3, 1))
        data = replace(
            problem.data, placed=placed, measured=measured, weight=problem.data.weight[kept]
        )
        found = find_start_coordinates(body, data)
        assert np.abs(found[:, turns]).max() < np.deg2rad(71.0)
