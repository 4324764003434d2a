"""Priors on coefficients: their derivatives, walls that nothing feels inside, and a foot that cannot turn over."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gaitcal.model.nominal import published_model
from gaitcal.motion.coordinate_prior import WALLS, CoordinatePrior, about_posture, walls, within_walls
from gaitcal.motion.motion import tracked_motion
from gaitcal.motion.spline import NodeRule
from gaitcal.motion.start import starting_nodes
from gaitcal.motion.track import track_nodes
from gaitcal.motion.trial_problem import TrialProblem, trial_problem
from gaitcal.synthetic.motion import gait_motion
from tests.derivatives import Array, assert_derivative, central_differences, perturbed_parameters, random_trial
from tests.synthetic_studies import made_recording

MODEL = published_model()
BAND = 1e-6
"""Of the matrix' largest entry: central differences of the gradient."""


def far_away(rng: np.random.Generator) -> tuple[TrialProblem, Array]:
    """A trial with walls and a normal prior, and nodes beyond some of the walls."""
    parameters = perturbed_parameters(rng)
    problem, true = random_trial(rng, parameters, frames=30, nodes=7)
    coordinates = problem.chain.coordinates
    course = np.linspace(-0.3, 0.2, 30)[:, None]
    moving = CoordinatePrior(
        names=("lumbar_bending",), time=problem.basis.time, low=course, high=course, scale=np.array([0.1])
    )
    priors = (walls(coordinates, {"hip_rotation_l": 0.2}), about_posture(("arm_add_r",), {"arm_add_r": 0.4}), moving)
    nodes = true.copy()
    for name in WALLS:
        nodes[::2, coordinates.index(name)] += rng.choice([-1.0, 1.0]) * 1.5
    return replace(problem, priors=priors), nodes


def test_cost_gradient_and_matrix_belong_together() -> None:
    problem, nodes = far_away(np.random.default_rng(41))
    constants = problem.constants(perturbed_parameters(np.random.default_rng(41)))
    shape = nodes.shape
    alone = [pull.both(nodes)[0] for pull in problem.pulls]
    assert min(alone) > 0.0
    cost, gradient = problem.gradient(nodes, constants)
    equations = problem.equations(nodes, constants)
    assert equations.cost == pytest.approx(cost, rel=1e-12)
    assert problem.cost(nodes, constants) == pytest.approx(cost, rel=1e-12)
    assert cost - problem.marker_cost(nodes, constants) == pytest.approx(sum(alone), rel=1e-9)
    np.testing.assert_allclose(equations.node_gradient, gradient, atol=1e-12 * np.abs(gradient).max())
    assert_derivative(
        2.0 * gradient.reshape(1, -1), lambda x: np.array([problem.cost(x.reshape(shape), constants)]), nodes.ravel()
    )
    plain = replace(problem, priors=())
    added = (equations.band - plain.equations(nodes, constants).band)[:, 0]

    def of_priors(x: Array) -> Array:
        own = x.reshape(shape)
        return np.asarray(sum(pull.both(own)[1] for pull in problem.pulls)).ravel()

    numeric = central_differences(of_priors, nodes.ravel())
    np.testing.assert_allclose(np.diag(added), numeric, atol=BAND * np.abs(numeric).max())


def test_a_share_of_the_cost_is_a_share_of_the_prior() -> None:
    problem, nodes = far_away(np.random.default_rng(42))
    half = problem.scaled(0.5)
    for whole, part in zip(problem.pulls, half.pulls, strict=True):
        assert part.both(nodes)[0] == pytest.approx(0.5 * whole.both(nodes)[0], rel=1e-12)
    scores = [p.scores(problem.basis, problem.chain.coordinates) for p in (problem.priors[1], half.priors[1])]
    np.testing.assert_allclose(scores[1], 0.5 * scores[0], rtol=1e-12)


def test_a_part_keeps_what_is_known_of_its_own_coordinates() -> None:
    problem, _ = far_away(np.random.default_rng(43))
    part = problem.part("shank_r", ("shank_r", "talus_r", "foot_r"))
    assert [prior.names for prior in part.priors] == [("ankle_angle_r", "subtalar_angle_r")]
    assert problem.part("pelvis", ("pelvis", "head_trunk")).guessed == ("lumbar_bending",)


def test_inside_the_walls_not_a_digit_changes() -> None:
    problem = trial_problem("walk", MODEL, made_recording(gait_motion()), NodeRule())
    assert set(problem.priors[0].names) == set(WALLS)
    assert problem.guessed == ()
    rng = np.random.default_rng(44)
    noisy = problem.with_measured(problem.data.measured + rng.normal(0.0, 0.003, problem.data.measured.shape))
    with_walls = tracked_motion(noisy, MODEL.parameters)
    without = tracked_motion(replace(noisy, priors=()), MODEL.parameters)
    np.testing.assert_array_equal(with_walls.nodes, without.nodes)


def test_a_foot_that_no_marker_holds_stays_at_its_wall() -> None:
    """A foot marker on the wrong side, and a start a whole turn away: the joint ends near its wall, not at 370 deg."""
    walk = made_recording(gait_motion())
    problem = trial_problem("walk", MODEL, walk, NodeRule(), root="shank_r", segments=("shank_r", "talus_r", "foot_r"))
    k = problem.chain.coordinates.index("subtalar_angle_r")
    constants = problem.constants(MODEL.parameters)
    weight = np.where((problem.data.segment == 2)[:, None], 0.0, problem.data.weight)
    (first, *_) = np.flatnonzero(problem.data.segment == 2)
    weight[first] = 1.0
    loose = problem.with_weight(weight)
    start = starting_nodes(problem.chain, constants, problem.data, problem.basis)
    start[:, k] += np.deg2rad(370.0)
    most = [
        np.rad2deg(np.abs(loose.basis.evaluate(track_nodes(p, constants, start).nodes)[:, k]).max())
        for p in (loose, replace(loose, priors=()))
    ]
    assert most[0] < 60.0
    assert most[1] > 180.0


def test_angles_start_within_the_walls() -> None:
    angles, known = np.deg2rad([[370.0], [-355.0], [170.0], [-30.0]]), np.ones(4, dtype=bool)
    told = within_walls(["subtalar_angle_r"], angles, known, determined=True)
    np.testing.assert_allclose(np.rad2deg(told), [[10.0], [5.0], [50.0], [-30.0]])
    assert not within_walls(["subtalar_angle_r"], angles, known, determined=False).any()
    np.testing.assert_array_equal(within_walls(["knee_angle_r"], angles, known, determined=False), angles)
    hips = ["hip_flexion_r", "hip_rotation_r"]
    both = np.deg2rad([[200.0, 370.0], [0.0, 60.0]])
    assert np.rad2deg(within_walls(hips, both, known[:2], determined=False)) == pytest.approx(
        np.array([[200, 10], [0, 50]])
    )
