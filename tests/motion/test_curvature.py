"""Newton's matrix is the derivative of the gradient, and tracking uses it where Gauss-Newton does not converge."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gaitcal.model.chain import ChainConstants
from gaitcal.model.parameters import gait_parameters
from gaitcal.motion.descent import DescentSettings
from gaitcal.motion.start import starting_nodes
from gaitcal.motion.track import track_nodes
from gaitcal.motion.trial_problem import TrialProblem
from tests.derivatives import Array, assert_derivative, perturbed_parameters, random_trial
from tests.motion.test_marker_equations import dense

EXACT = DescentSettings(gain=1e-13)


def misplaced_trial() -> tuple[TrialProblem, ChainConstants, Array]:
    """Markers of little weight 0.3 m from where the model has them, as on arms held otherwise in the static trial."""
    rng = np.random.default_rng(40)
    parameters = perturbed_parameters(rng)
    problem, _ = random_trial(rng, parameters, frames=60, nodes=10)
    local, weight = problem.data.local.copy(), problem.data.weight.copy()
    wrong = np.arange(len(local)) % 3 == 0
    local[wrong] += 0.3 * rng.normal(size=(int(wrong.sum()), 3))
    weight[wrong] = 0.05
    problem = replace(
        problem, data=replace(problem.data, placed=replace(problem.data.placed, local=local), weight=weight)
    )
    constants = problem.constants(parameters)
    return problem, constants, starting_nodes(problem.chain, constants, problem.data, problem.basis)


def test_the_curved_matrix_is_the_derivative_of_the_gradient() -> None:
    """With weights that change and markers that are missing."""
    rng = np.random.default_rng(41)
    parameters = perturbed_parameters(rng)
    problem, true = random_trial(rng, parameters, frames=25, nodes=7)
    weight = rng.uniform(0.2, 2.0, problem.data.weight.shape) * (rng.random(problem.data.weight.shape) > 0.2)
    problem, constants = problem.with_weight(weight), problem.constants(parameters)
    nodes = true + rng.normal(0, 0.05, true.shape)
    found = problem.equations(nodes, constants, curved=True)
    plain = problem.equations(nodes, constants)
    assert_derivative(dense(found), lambda x: problem.gradient(x.reshape(nodes.shape), constants)[1], nodes.ravel())
    np.testing.assert_array_equal(found.node_gradient, plain.node_gradient)
    assert np.abs(found.band - plain.band).max() > 1e-3 * np.abs(plain.band).max()  # far above the tolerance


def test_free_joint_parameters_are_refused() -> None:
    rng = np.random.default_rng(43)
    parameters = perturbed_parameters(rng)
    problem, true = random_trial(rng, parameters, free=gait_parameters("r"), frames=25, nodes=7)
    with pytest.raises(ValueError, match="no joint parameter may be free"):
        problem.equations(true, problem.constants(parameters), curved=True)


def test_tracking_ends_where_gauss_newton_does_not() -> None:
    problem, constants, start = misplaced_trial()
    found = track_nodes(problem, constants, start, EXACT)
    assert found.converged and found.curved
    size = np.abs(problem.gradient(start, constants)[1]).max()
    assert np.abs(problem.gradient(found.nodes, constants)[1]).max() < 1e-9 * size
    without = track_nodes(problem, constants, start, replace(EXACT, curved_tries=0))
    assert without.steps > 2 * found.steps
    assert found.cost <= without.cost * (1 + 1e-9)


def test_well_placed_markers_need_no_curvature() -> None:
    rng = np.random.default_rng(42)
    parameters = perturbed_parameters(rng)
    problem, _ = random_trial(rng, parameters, frames=60, nodes=10)
    measured = problem.data.measured + rng.normal(0, 0.002, problem.data.measured.shape)
    problem = replace(problem, data=replace(problem.data, measured=measured))
    constants = problem.constants(parameters)
    start = starting_nodes(problem.chain, constants, problem.data, problem.basis)
    assert not track_nodes(problem, constants, start).curved
