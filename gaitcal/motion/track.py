"""Marker tracking: the nodes that bring the model's markers nearest to the measured ones, over a whole trial.

Gauss-Newton on the banded normal equations, with Levenberg's damping (relative to the diagonal) only where a plain
step does not lower the cost: from rigid fits it is hardly ever needed, from absolute zero it is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gaitcal.model.chain import ChainConstants
from gaitcal.motion.banded import BandFactor, NormalEquations
from gaitcal.motion.trial_problem import TrialProblem

Array = NDArray[np.float64]


LARGE_BYTES = 2**27
"""Size of a normal matrix above which only one is held at a time: a trial of some 20 000 frames."""


@dataclass(frozen=True)
class TrackSettings:
    """When tracking ends."""

    tolerance: float = 1e-6
    """Relative gain of a step below which it is the last; what is then left to gain is about its square."""
    floor_m: float = 1e-14
    """RMS residual below which there is nothing left to fit (m)."""
    most_steps: int = 100
    first_damping: float = 0.0
    """Levenberg damping of the first step; 1e-3 when starting far away."""


@dataclass(frozen=True)
class Tracked:
    """The end of a tracking run."""

    nodes: Array
    """(nn, nq) m, rad."""
    cost: float
    """m^2 at `nodes`."""
    steps: int
    converged: bool


def track_nodes(
    problem: TrialProblem, constants: ChainConstants, start: Array, settings: TrackSettings | None = None
) -> Tracked:
    """Minimise the weighted sum of squared marker distances over the nodes, starting at `start` (nn, nq)."""
    settings = settings or TrackSettings()
    nodes, damping = start, settings.first_damping
    equations: NormalEquations | None = problem.equations(nodes, constants)
    small = settings.floor_m**2 * float(problem.data.weight.sum())
    converged, step_count = False, 0
    while step_count < settings.most_steps:
        step_count += 1
        if equations is None:  # let go of for the sake of memory, and the step was refused
            equations = problem.equations(nodes, constants)
        cost, gradient = equations.cost, equations.node_gradient
        step = -_solve(problem, equations, damping, nodes, constants).reshape(nodes.shape)
        expected = -float(np.vdot(gradient, step))
        if damping == 0.0 and expected <= settings.tolerance * cost:
            nodes, converged = nodes + step, True
            break
        if equations.band.nbytes > LARGE_BYTES:
            equations = None
        trial = problem.equations(nodes + step, constants)
        if trial.cost <= cost + 1e-14 * small:
            nodes, fall, cost, equations = nodes + step, cost - trial.cost, trial.cost, trial
            damping = damping / 30 if damping > 1e-12 else 0.0
            if fall <= settings.tolerance * cost or cost <= small:
                converged = True
                break
        else:
            if expected <= max(settings.tolerance * cost, small):
                converged = True
                break
            damping = max(10 * damping, 1e-6)
            if damping > 1e12:
                break
        del trial
    return Tracked(nodes, cost, step_count, converged)


def _solve(
    problem: TrialProblem, equations: NormalEquations, damping: float, nodes: Array, constants: ChainConstants
) -> Array:
    """H_qq^-1 g_q; a large matrix is factored in its own place, and formed anew if that fails."""
    right = equations.node_gradient.ravel()
    if equations.band.nbytes <= LARGE_BYTES:
        return BandFactor(equations.band, damping).solve(right)
    try:
        return BandFactor(equations.band, damping, overwrite=True).solve(right)
    except np.linalg.LinAlgError:
        return BandFactor(problem.equations(nodes, constants).band, damping).solve(right)
