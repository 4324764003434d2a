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


@dataclass(frozen=True)
class TrackSettings:
    """When tracking ends."""

    tolerance: float = 1e-9
    """Relative fall of the cost below which the next step is not taken."""
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
    equations: NormalEquations
    """At the last point where they were formed; at `nodes` itself when `fresh`."""
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
    equations = problem.equations(nodes, constants)
    small = settings.floor_m**2 * float(problem.data.weight.sum())
    converged, step_count = False, 0
    while step_count < settings.most_steps:
        step_count += 1
        step = -BandFactor(equations.band, damping).solve(equations.node_gradient.ravel()).reshape(nodes.shape)
        expected = -float(np.vdot(equations.node_gradient, step))
        if damping == 0.0 and expected <= settings.tolerance * equations.cost:
            nodes, converged = nodes + step, True
            break
        trial = problem.equations(nodes + step, constants)
        if trial.cost <= equations.cost + 1e-14 * small:
            nodes, fall, equations = nodes + step, equations.cost - trial.cost, trial
            damping = damping / 30 if damping > 1e-12 else 0.0
            if fall <= settings.tolerance * equations.cost or equations.cost <= small:
                converged = True
                break
        else:
            if expected <= max(settings.tolerance * equations.cost, small):
                converged = True
                break
            damping = max(10 * damping, 1e-6)
            if damping > 1e12:
                break
    return Tracked(nodes, equations, equations.cost, step_count, converged)
