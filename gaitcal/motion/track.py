"""Marker tracking: the nodes that bring the model's markers nearest to the measured ones, over a whole trial.

Gauss-Newton on the banded normal equations, with Levenberg's damping (relative to the diagonal) only where a plain
step does not lower the cost: from rigid fits it is hardly ever needed, from absolute zero it is. Near the minimum the
matrix hardly changes from step to step, and its factor is kept: a step then costs a gradient, a third of the work.
What ends the iteration is the same either way, the gain that a step promises.

Where markers stay far from where the model has them, Gauss-Newton's steps shrink slowly, or grow: then the matrix gets
the markers' curvature as well, as long as it is positive definite with it, and the steps are Newton's.
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


NEAR = 0.05
"""Steps shorter than this (m, rad) change the matrix by less than the residuals' curvature, which it leaves out."""
KEPT = 0.1
"""What a last step on a kept factor may promise, as a part of what is allowed on one formed at these nodes: it leaves
more to gain than the square."""
SLOW = 0.1
"""A kept factor whose next step promises more than this part of what the last one did is formed anew."""
MOST_TRIES = 3
"""Times that Newton's steps are begun, where those of Gauss-Newton are slow."""


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
    curved: bool = False
    """Whether to begin with Newton's steps."""


@dataclass(frozen=True)
class Tracked:
    """The end of a tracking run."""

    nodes: Array
    """(nn, nq) m, rad."""
    cost: float
    """m^2 at `nodes`."""
    steps: int
    converged: bool
    curved: bool
    """Whether it took Newton's steps."""


def track_nodes(
    problem: TrialProblem,
    constants: ChainConstants,
    start: Array,
    settings: TrackSettings | None = None,
) -> Tracked:
    """Minimise the weighted sum of squared marker distances over the nodes, starting at `start` (nn, nq)."""
    settings = settings or TrackSettings()
    small = settings.floor_m**2 * float(problem.data.weight.sum())
    nodes, damping = start, settings.first_damping
    equations: NormalEquations | None = None
    factor: BandFactor | None = None
    fresh, promised, last = False, np.inf, np.inf
    curved, tries = settings.curved, 0 if problem.chain.free else MOST_TRIES
    converged, step_count, cost, gradient = False, 0, np.inf, np.zeros_like(start)
    while step_count < settings.most_steps:
        step_count += 1
        if factor is None:
            equations = equations or problem.equations(nodes, constants, curved=curved)
            cost, gradient = equations.cost, equations.node_gradient
            try:
                factor, equations = _factor(problem, equations, damping, nodes, constants, curved=curved)
            except np.linalg.LinAlgError:
                if not curved:
                    raise
                curved, equations, last = False, None, np.inf
                continue
            fresh, promised = True, np.inf
        step = -factor.solve(gradient.ravel()).reshape(nodes.shape)
        expected = -float(np.vdot(gradient, step))
        slow = fresh and expected > SLOW * last
        if slow and not curved and tries:
            curved, tries, damping, factor, equations = True, tries - 1, 0.0, None, None
            continue
        enough = settings.tolerance * cost * (1.0 if fresh else KEPT)
        if damping == 0.0 and expected <= enough:
            nodes, converged = nodes + step, True
            break
        if not fresh and expected > SLOW * promised:
            factor = None
            continue
        promised, last = expected, expected if fresh else last
        near = damping == 0.0 and float(np.abs(step).max()) < NEAR
        trial: NormalEquations | None = None
        if near:
            trial_cost, trial_gradient = problem.gradient(nodes + step, constants)
        else:
            if equations is None:
                factor = None  # a large one makes room
            trial = problem.equations(nodes + step, constants, curved=curved)
            trial_cost, trial_gradient = trial.cost, trial.node_gradient
        if trial_cost <= cost + 1e-14 * small:
            fall = cost - trial_cost
            nodes, cost, gradient, equations = nodes + step, trial_cost, trial_gradient, trial
            damping = damping / 30 if damping > 1e-12 else 0.0
            fresh = False
            if not near:
                factor = None
            if fall <= enough or cost <= small:
                converged = True
                break
        else:
            if expected <= max(enough, small):
                converged = True
                break
            factor = None
            if curved:
                curved, equations, last = False, None, np.inf
            elif fresh:
                damping = max(10 * damping, 1e-6)
            if damping > 1e12:
                break
        del trial
    return Tracked(nodes, cost, step_count, converged, curved)


def _factor(
    problem: TrialProblem,
    equations: NormalEquations,
    damping: float,
    nodes: Array,
    constants: ChainConstants,
    *,
    curved: bool,
) -> tuple[BandFactor, NormalEquations | None]:
    """The factor of H_qq, and the equations if they outlive it: a large matrix is factored in its own place, and formed
    anew if that fails.
    """
    if equations.band.nbytes <= LARGE_BYTES:
        return BandFactor(equations.band, damping), equations
    try:
        return BandFactor(equations.band, damping, overwrite=True), None
    except np.linalg.LinAlgError:
        return BandFactor(problem.equations(nodes, constants, curved=curved).band, damping), None
