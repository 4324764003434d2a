"""The re-fit: same minimum as plain tracking, exact second derivatives, honest failures."""

from __future__ import annotations

import numpy as np
import pytest

from gaitcal.motion.descent import DescentSettings
from gaitcal.motion.track import track_nodes
from gaitcal.motion.trial_problem import TrialProblem
from gaitcal.published.draw import MonteCarloContext, disturb, refit
from gaitcal.published.protocol import RefitSettings, Varied
from tests.derivatives import perturbed_parameters, random_trial

NODES = 3e-7
"""m, rad: the last step of a re-fit is below 1e-6, what is left a fraction of it."""


def test_other_measured_markers_keep_the_pattern() -> None:
    rng = np.random.default_rng(5)
    problem, true = random_trial(rng, perturbed_parameters(rng), frames=40, nodes=8)
    constants = problem.constants(perturbed_parameters(rng))
    measured = problem.data.measured + rng.normal(0, 0.01, problem.data.measured.shape)
    other = problem.with_measured(measured)
    made = TrialProblem(
        name=problem.name, chain=problem.chain, basis=problem.basis, data=other.data, labels=problem.labels
    )
    assert other._assembler is problem._assembler
    found, expected = (p.equations(true, constants, curved=True) for p in (other, made))
    np.testing.assert_array_equal(found.band, expected.band)
    np.testing.assert_array_equal(found.node_gradient, expected.node_gradient)
    assert found.cost == expected.cost != problem.cost(true, constants)


@pytest.mark.parametrize("level", [25, 100])
def test_same_minimum_as_tracking(context: MonteCarloContext, level: int) -> None:
    """Tracking, started at the re-fit and given many small steps, stays there; and the cost is no higher from afar."""
    for number in range(4):
        change = disturb(context, Varied.JP, level, number)
        assert change.joint is not None
        parameters = context.case.parameters.with_joint(context.names, context.joint_values + change.joint)
        constants = context.problem.constants(parameters)
        start = context.case.nodes + context.sensitivity @ change.joint
        found = refit(context.problem, constants, start, RefitSettings())
        assert found.failure == ""
        tight = DescentSettings(gain=0.0, most_steps=60)
        kept = track_nodes(context.problem, constants, found.nodes, tight)
        assert np.abs(kept.nodes - found.nodes).max() < NODES
        afar = track_nodes(context.problem, constants, context.case.nodes, DescentSettings(gain=1e-12))
        assert context.problem.cost(found.nodes, constants) <= afar.cost * (1 + 1e-9)


def test_the_predictor_is_the_slope_of_the_motion(context: MonteCarloContext) -> None:
    change = 1e-4 * context.settings.joint_bounds * np.random.default_rng(3).uniform(-1, 1, len(context.names))
    parameters = context.case.parameters.with_joint(context.names, context.joint_values + change)
    constants = context.problem.constants(parameters)
    found = refit(context.problem, constants, context.case.nodes, RefitSettings(tolerance=1e-10))
    moved = found.nodes - context.case.nodes
    np.testing.assert_allclose(context.sensitivity @ change, moved, rtol=0, atol=2e-3 * np.abs(moved).max())


def test_noise_is_fitted_from_the_known_factor_as_from_a_fresh_one(context: MonteCarloContext) -> None:
    change = disturb(context, Varied.NOISE, 100, 1)
    noisy = context.problem.with_measured(context.data.measured + change.noise)
    constants = context.problem.constants(context.case.parameters)
    found = [
        refit(noisy, constants, context.case.nodes, RefitSettings(), known)
        for known in (None, context.undisturbed_factor)
    ]
    np.testing.assert_array_equal(found[0].nodes, found[1].nodes)
    assert np.abs(noisy.gradient(found[0].nodes, constants)[1]).max() < 1e-6


def test_a_refit_that_is_cut_short_says_so(context: MonteCarloContext) -> None:
    change = disturb(context, Varied.NOISE, 100, 1)
    noisy = context.problem.with_measured(context.data.measured + change.noise)
    constants = context.problem.constants(context.case.parameters)
    found = refit(noisy, constants, context.case.nodes, RefitSettings(most_evaluations=2))
    assert "2 evaluations" in found.failure
    lost = context.problem.with_measured(np.full_like(context.data.measured, np.nan))
    assert refit(lost, constants, context.case.nodes, RefitSettings()).failure
