"""Standard errors of a smoothed motion: the penalty is in the matrix, and its bias is a source of its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gaitcal.calibration.combined import CombinedSettings, CombinedTrial, combined_fit
from gaitcal.calibration.influence import trial_scores
from gaitcal.calibration.marker_moves import coordinate_standard_errors, marker_moves
from gaitcal.model.inertial_parameters import symmetric_set
from gaitcal.model.parameters import Parameters
from gaitcal.model.subject_model import Subject
from gaitcal.motion.descent import DescentSettings
from gaitcal.motion.roughness import smoothing
from gaitcal.motion.track import track_nodes
from gaitcal.motion.trial_problem import TrialProblem
from tests.derivatives import Array, perturbed_parameters, random_trial

PARAMETERS = perturbed_parameters(np.random.default_rng(81))
HZ, STEP = 22.0, 1e-3
FIRST_ORDER = 0.05
"""Gauss-Newton's matrix against Newton's, where residuals are small."""


def solved(problem: TrialProblem, start: Array, parameters: Parameters = PARAMETERS) -> Array:
    return track_nodes(problem, problem.constants(parameters), start, DescentSettings(gain=1e-15)).nodes


def smoothed_trial() -> tuple[TrialProblem, Array]:
    """Markers without noise, smoothed a little."""
    problem, true = random_trial(np.random.default_rng(82), PARAMETERS, frames=50, nodes=12)
    problem = replace(problem, smoothing=smoothing(problem.basis, 4.0 * np.eye(true.shape[1]), HZ))
    return problem, solved(problem, true)


def test_the_source_is_what_more_of_the_penalty_would_do() -> None:
    problem, nodes = smoothed_trial()
    assert problem.smoothing is not None
    scores = trial_scores(problem, PARAMETERS, nodes)
    assert scores.clusters[-1] == "bandwidth/random"
    stiffer = replace(problem.smoothing, coupling=(1 + STEP) * problem.smoothing.coupling)
    change = (solved(replace(problem, smoothing=stiffer), nodes) - nodes) / STEP
    source = -scores.nodes[:, -1].reshape(nodes.shape)
    np.testing.assert_allclose(source, change, rtol=0, atol=FIRST_ORDER * np.abs(change).max())
    assert np.abs(change).max() > 1e-5


def test_markers_move_a_smoothed_motion_less() -> None:
    problem, nodes = smoothed_trial()
    plain = replace(problem, smoothing=None)
    assert trial_scores(plain, PARAMETERS, nodes).clusters == trial_scores(problem, PARAMETERS, nodes).clusters[:-1]
    moved = problem.data.measured.copy()
    wave = 1e-4 * np.sin(np.arange(moved.shape[2]))  # fast against the cut-off
    moved[3, 0] += wave
    for trial in (problem, plain):
        before, after = (solved(t, nodes) for t in (trial, trial.with_measured(moved)))
        factor = trial_scores(trial, PARAMETERS, before)
        by_node = _pull(trial, before, 3, 0, wave)
        expected = np.linalg.lstsq(_matrix(trial, before), by_node, rcond=None)[0].reshape(nodes.shape)
        np.testing.assert_allclose(after - before, expected, rtol=0, atol=FIRST_ORDER * np.abs(expected).max())
        assert factor.nodes.shape[0] == nodes.size


def _matrix(problem: TrialProblem, nodes: Array) -> Array:
    band = problem.equations(nodes, problem.constants(PARAMETERS)).band
    out = np.zeros((len(band), len(band)))
    for d in range(band.shape[1]):
        values = band[: len(band) - d, d]
        out += np.diag(values, -d) + (np.diag(values, d) if d else 0.0)
    return out


def _pull(problem: TrialProblem, nodes: Array, marker: int, axis: int, wave: Array) -> Array:
    """(nn * nq,) what a change of one marker coordinate adds to minus the half gradient."""
    constants = problem.constants(PARAMETERS)
    other = problem.data.measured.copy()
    other[marker, axis] += wave
    _, here = problem.gradient(nodes, constants)
    _, there = problem.with_measured(other).gradient(nodes, constants)
    return np.asarray(here - there).ravel()


def test_the_source_widens_error_bars() -> None:
    problem, nodes = smoothed_trial()
    noisy = problem.with_measured(
        problem.data.measured + np.random.default_rng(83).normal(0, 1e-4, problem.data.measured.shape)
    )
    moves = marker_moves(noisy, solved(noisy, nodes), PARAMETERS, None)
    without = replace(moves, shift=moves.shift[:, :-1], nodes=moves.nodes[:, :-1], sources=moves.sources[:-1])
    wide, narrow = (coordinate_standard_errors(noisy, m) for m in (moves, without))
    bias = noisy.basis.evaluate(moves.nodes[:, -1].reshape(nodes.shape))
    np.testing.assert_allclose(wide**2, narrow**2 + bias**2, rtol=1e-9)
    assert (wide > 1.05 * narrow).mean() > 0.2


def test_the_penalty_is_no_marker_error() -> None:
    """The third step weighs markers by their own residual alone."""
    problem, nodes = smoothed_trial()
    settings = CombinedSettings(descent=DescentSettings(most_steps=1))
    subject = Subject("anyone", 70.0, 1.75, "male")
    sigmas = [
        combined_fit([CombinedTrial(trial, nodes, None, None)], PARAMETERS, (), symmetric_set(), subject, settings)
        for trial in (problem, replace(problem, smoothing=None))
    ]
    assert sigmas[0].marker_sigma == sigmas[1].marker_sigma > 0.0
