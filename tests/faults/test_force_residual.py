"""Whitening and marginalisation against a dense covariance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gaitcal.dynamics.expected_residual import BASELINE, TAU
from gaitcal.faults.force_evidence import BROKEN_S, ForceEvidence, ForceResidual
from tests.faults.walks import exact_walk

SAME = 1e-8
"""Relative: one factor of 200 rows each."""


def some_frames(count: int) -> ForceEvidence:
    whole = exact_walk().evidence()
    chosen = np.r_[0:count, count + 5 : count + 9]  # with a gap
    return replace(whole, time=whole.time[chosen], spread=whole.spread[chosen])


def dense(trials: list[ForceEvidence]) -> np.ndarray:
    """Covariance of the residuals of all trials, row by row."""
    blocks = []
    for trial in trials:
        apart = np.abs(trial.time[:, None] - trial.time[None, :])
        piece = np.concatenate([[0], np.cumsum(np.diff(trial.time) >= BROKEN_S)])
        memory = np.where(piece[:, None] == piece[None, :], np.exp(-apart / TAU), 0.0)
        scale = np.diag((BASELINE * np.repeat([trial.weight, trial.bwh], 3)) ** 2)
        blocks.append(np.kron(memory, scale))
    spread = np.concatenate([t.spread.reshape(-1, t.spread.shape[2]) for t in trials])
    out = spread @ spread.T
    at = 0
    for block in blocks:
        out[at : at + len(block), at : at + len(block)] += block
        at += len(block)
    return out


def test_whitened_squares_are_those_of_the_dense_covariance() -> None:
    rng = np.random.default_rng(0)
    trials = [some_frames(8), some_frames(12)]
    residuals = [rng.normal(size=(len(t.time), 6)) * [20, 30, 10, 5, 2, 8] for t in trials]
    y = ForceResidual(trials).whitened(residuals)
    stacked = np.concatenate([r.ravel() for r in residuals])
    expected = stacked @ np.linalg.solve(dense(trials), stacked)
    np.testing.assert_allclose(y @ y, expected, rtol=SAME)
    residual = ForceResidual(trials)
    np.testing.assert_allclose(residual.squares(y).sum(), y @ y, rtol=SAME)


def test_an_error_that_inertial_parameters_can_make_weighs_little() -> None:
    trial = some_frames(12)
    usual = trial.spread[:, :, 3]
    other = np.random.default_rng(1).permutation(usual.ravel()).reshape(usual.shape)
    residual = ForceResidual([trial])
    as_inertia, as_anything = (float((y := residual.whitened([r])) @ y) for r in (usual, other))
    assert as_inertia <= 1.0 + SAME  # one standard deviation of one unknown
    assert as_anything > 3.0 * as_inertia
