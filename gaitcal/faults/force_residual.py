"""The pelvis residual of one or several trials in units of what clean recordings leave, inertial errors marginalised.

    r = e + N eta,  eta ~ N(0, 1)      N: change of r with one standard deviation of each inertial parameter, which all
                                       trials of a person share
    e: first-order autoregressive in each of the six components of each trial, rho = exp(-dt / TAU), standard
       deviations USUAL times body weight (forces) and body weight times height (moments)
    white(r)_i = (r_i - rho_i r_(i-1)) / (USUAL sqrt(1 - rho_i^2))
    A = white(N) = U S V^T
    y = (I + A A^T)^(-1/2) white(r) = white(r) - U (1 - 1 / sqrt(1 + S^2)) U^T white(r)

so that |y|^2 = r^T cov(r)^(-1) r.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gaitcal.arrays import Array
from gaitcal.dynamics.expected_residual import TAU, USUAL
from gaitcal.faults.force_evidence import ForceEvidence

BROKEN_S = 0.06
"""Frames further apart know nothing of each other."""


class ForceResidual:
    """Several trials of one person with the same force plates, or one."""

    def __init__(self, trials: Sequence[ForceEvidence]) -> None:
        self.trials = tuple(trials)
        self._rho = [_memory(trial.time) for trial in self.trials]
        spread = np.concatenate([self._white(i, trial.spread) for i, trial in enumerate(self.trials)])
        self._u, s, _ = np.linalg.svd(spread, full_matrices=False)
        self._shrink = 1.0 - 1.0 / np.sqrt(1.0 + s**2)
        ends = np.cumsum([6 * len(trial.time) for trial in self.trials])
        self._parts = [slice(int(end) - 6 * len(t.time), int(end)) for end, t in zip(ends, self.trials, strict=True)]

    def whitened(self, residuals: Sequence[Array]) -> Array:
        """(rows,) y of residuals (k, 6), one for each trial."""
        y = np.concatenate([self._white(i, r) for i, r in enumerate(residuals)])
        out: Array = y - self._u @ (self._shrink * (self._u.T @ y))
        return out

    def squares(self, y: Array) -> Array:
        """(trials,) sum of the squares of each trial's rows."""
        return np.array([float(y[part] @ y[part]) for part in self._parts])

    @property
    def rows(self) -> Array:
        """(trials,) how many rows each trial has."""
        return np.array([part.stop - part.start for part in self._parts])

    def _white(self, trial: int, r: Array) -> Array:
        """(6 k, ...) of (k, 6, ...)."""
        evidence = self.trials[trial]
        scale = USUAL * np.repeat([evidence.weight, evidence.bwh], 3)
        r = r / scale.reshape((6,) + (1,) * (r.ndim - 2))
        rho = self._rho[trial].reshape((-1,) + (1,) * (r.ndim - 1))
        out = r.copy()
        out[1:] -= rho[1:] * r[:-1]
        white: Array = (out / np.sqrt(1.0 - rho**2)).reshape((-1,) + r.shape[2:])
        return white


def _memory(time: Array) -> Array:
    """(k,) correlation of each frame with the one before it."""
    step = np.diff(time)
    return np.concatenate([[0.0], np.where(step < BROKEN_S, np.exp(-step / TAU), 0.0)])
