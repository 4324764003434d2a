"""Standard errors of a smoothed motion: the penalty is in the matrix, and its bias is a source of its own."""

from dataclasses import replace

import numpy as np

from gaitcal.calibration.error_sources import coordinate_standard_errors, marker_moves, whole_body_scores
from gaitcal.model.parameters import Parameters
from gaitcal.motion.descent import DescentSettings
from gaitcal.motion.motion import track_nodes
from gaitcal.motion.spline import smoothing
from gaitcal.motion.trial_problem import MotionProblem
from tests.derivatives import Array, perturbed_parameters, random_trial

PARAMETERS = perturbed_parameters(np.random.default_rng(81))
HZ, STEP = 22.0, 1e-3
FIRST_ORDER = 0.05
"""Gauss-Newton's matrix against Newton's, where residuals are small."""


def solved(problem: MotionProblem, start: Array, parameters: Parameters = PARAMETERS) -> Array:
    return track_nodes(problem, problem.constants(parameters), start, DescentSettings(gain=1e-15)).nodes


def smoothed_trial() -> tuple[MotionProblem, Array]:
    """Markers without noise, smoothed a little."""
    problem, true = random_trial(np.random.default_rng(82), PARAMETERS, frames=50, nodes=12)
    problem = replace(problem, smoothing=smoothing(problem.basis, 4.0 * np.eye(true.shape[1]), HZ))
    return problem, solved(problem, true)


def test_the_source_is_what_more_of_the_penalty_would_do() -> None:
    problem, nodes = smoothed_trial()
    scores = whole_body_scores(problem, nodes, PARAMETERS, None)
    plain = whole_body_scores(replace(problem, smoothing=None), nodes, PARAMETERS, None)
    assert scores.clusters == (*plain.clusters, "bandwidth/random")
    stiffer = replace(problem.smoothing, coupling=(1 + STEP) * problem.smoothing.coupling)
    change = (solved(replace(problem, smoothing=stiffer), nodes) - nodes) / STEP
    source = scores.nodes[:, -1].reshape(nodes.shape)
    np.testing.assert_allclose(source, change, rtol=0, atol=FIRST_ORDER * np.abs(change).max())
    assert np.abs(change).max() > 1e-5


def test_the_source_widens_error_bars() -> None:
    problem, nodes = smoothed_trial()
    noisy = problem.with_measured(
        problem.data.measured + np.random.default_rng(83).normal(0, 1e-4, problem.data.measured.shape)
    )
    moves = marker_moves(noisy, solved(noisy, nodes), PARAMETERS, None)
    without = replace(moves, nodes=moves.nodes[:, :-1], own=moves.own[:-1])
    wide, narrow = (coordinate_standard_errors(noisy, m) for m in (moves, without))
    bias = noisy.basis.evaluate(moves.nodes[:, -1].reshape(nodes.shape))
    np.testing.assert_allclose(wide**2, narrow**2 + bias**2, rtol=1e-9)
    assert (wide > 1.05 * narrow).mean() > 0.2
