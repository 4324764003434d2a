"""The re-fit: same minimum as plain tracking, exact second derivatives, honest failures."""

from __future__ import annotations

import numpy as np
import pytest

from gaitcal.motion.track import TrackSettings, track_nodes
from gaitcal.motion.trial_problem import TrialProblem
from gaitcal.study.monte_carlo.context import MonteCarloContext
from gaitcal.study.monte_carlo.draw import disturb
from gaitcal.study.monte_carlo.refit import refit
from gaitcal.study.monte_carlo.refit_equations import RefitEquations
from gaitcal.study.monte_carlo.settings import RefitSettings, Varied
from tests.derivatives import Array, assert_derivative, perturbed_parameters, random_trial

NODES = 3e-7
"""m, rad: the last step of a re-fit is below 1e-6, what is left a fraction of it."""


def dense(band: Array) -> Array:
    n, width = band.shape
    out = np.zeros((n, n))
    for k in range(width):
        rows = np.arange(n - k)
        out[rows + k, rows] = out[rows, rows + k] = band[: n - k, k]
    return out


def test_curved_matrix_is_the_derivative_of_the_gradient() -> None:
    rng = np.random.default_rng(4)
    problem, true = random_trial(rng, perturbed_parameters(rng), frames=30, nodes=7)
    other = perturbed_parameters(rng)
    constants, equations = problem.constants(other), RefitEquations(problem)
    nodes = true + rng.normal(0, 0.05, true.shape)

    def gradient(x: Array) -> Array:
        return equations.gradient(problem.data, x.reshape(nodes.shape), constants)[1]

    band = equations.band(problem.data, nodes, constants, curved=True)
    assert_derivative(dense(band), gradient, nodes.ravel())
    plain = equations.band(problem.data, nodes, constants, curved=False)
    assert np.abs(band - plain).max() > 0.01 * np.abs(plain).max()  # far above the tolerance


def test_equations_are_those_of_the_trial() -> None:
    rng = np.random.default_rng(5)
    problem, true = random_trial(rng, perturbed_parameters(rng), frames=40, nodes=8)
    constants, equations = problem.constants(perturbed_parameters(rng)), RefitEquations(problem)
    expected = problem.equations(true, constants)
    np.testing.assert_array_equal(equations.band(problem.data, true, constants, curved=False), expected.band)
    cost, gradient = equations.gradient(problem.data, true, constants)
    assert cost == pytest.approx(expected.cost)
    np.testing.assert_allclose(gradient, expected.node_gradient, rtol=0, atol=1e-12)


@pytest.mark.parametrize("level", [25, 100])
def test_same_minimum_as_tracking(context: MonteCarloContext, level: int) -> None:
    """Tracking, started at the re-fit and given many small steps, stays there; and the cost is no higher from afar."""
    for number in range(4):
        change = disturb(context, Varied.JP, level, number)
        assert change.joint is not None
        parameters = context.case.parameters.with_joint(context.names, context.joint_values + change.joint)
        constants = context.problem.constants(parameters)
        start = context.case.nodes + context.sensitivity @ change.joint
        found = refit(context.equations, context.data, constants, start, RefitSettings())
        assert found.failure == ""
        tight = TrackSettings(tolerance=0.0, most_steps=60)
        kept = track_nodes(context.problem, constants, found.nodes, tight)
        assert np.abs(kept.nodes - found.nodes).max() < NODES
        afar = track_nodes(context.problem, constants, context.case.nodes, TrackSettings(tolerance=1e-12))
        assert context.problem.cost(found.nodes, constants) <= afar.cost * (1 + 1e-9)


def test_the_predictor_is_the_slope_of_the_motion(context: MonteCarloContext) -> None:
    change = 1e-4 * context.settings.joint_bounds * np.random.default_rng(3).uniform(-1, 1, len(context.names))
    parameters = context.case.parameters.with_joint(context.names, context.joint_values + change)
    constants = context.problem.constants(parameters)
    found = refit(context.equations, context.data, constants, context.case.nodes, RefitSettings(tolerance=1e-10))
    moved = found.nodes - context.case.nodes
    np.testing.assert_allclose(context.sensitivity @ change, moved, rtol=0, atol=2e-3 * np.abs(moved).max())


def test_noise_is_fitted_from_the_known_factor_as_from_a_fresh_one(context: MonteCarloContext) -> None:
    change = disturb(context, Varied.NOISE, 100, 1)
    problem = context.problem
    data = context.data
    noisy = TrialProblem(
        "noisy",
        problem.chain,
        problem.basis,
        type(data)(data.segment, data.local, data.measured + change.noise, data.weight),
        problem.labels,
    )
    constants = problem.constants(context.case.parameters)
    found = [
        refit(context.equations, noisy.data, constants, context.case.nodes, RefitSettings(), known)
        for known in (None, context.undisturbed_factor)
    ]
    np.testing.assert_array_equal(found[0].nodes, found[1].nodes)
    assert np.abs(noisy.gradient(found[0].nodes, constants)[1]).max() < 1e-6


def test_a_refit_that_is_cut_short_says_so(context: MonteCarloContext) -> None:
    change = disturb(context, Varied.NOISE, 100, 1)
    data = type(context.data)(
        context.data.segment, context.data.local, context.data.measured + change.noise, context.data.weight
    )
    constants = context.problem.constants(context.case.parameters)
    found = refit(context.equations, data, constants, context.case.nodes, RefitSettings(most_evaluations=2))
    assert "2 evaluations" in found.failure
    lost = type(data)(data.segment, data.local, np.full_like(data.measured, np.nan), data.weight)
    assert refit(context.equations, lost, constants, context.case.nodes, RefitSettings()).failure
