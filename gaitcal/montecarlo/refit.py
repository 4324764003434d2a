"""A motion fitted anew to its markers after a disturbance: Newton's method with a matrix that is kept while it serves.

    N <- N - M^-1 g(N),        M ~ half the Hessian of the cost by the nodes, g its half gradient.

g costs a third of M, so M is formed at the start (Gauss-Newton, always positive) and again only where the steps do
not shrink fast enough; then with the curvature of the markers (`motion/marker_residual.py`), as soon as the minimum
is near. A step that would raise the cost is not taken: M is formed afresh and its diagonal raised (Levenberg), as
also where the curvature makes M indefinite. The end is told by the size of the step.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gaitcal.model.chain import ChainConstants
from gaitcal.montecarlo.settings import RefitSettings
from gaitcal.motion.banded import BandFactor
from gaitcal.motion.trial_problem import TrialProblem

Array = NDArray[np.float64]

SLOW = 0.2
"""A step longer than this part of the one before asks for a new matrix."""
NEAR = 0.1
"""Steps shorter than this (m, rad) are near enough to the minimum for the curvature of the markers to help."""
FIRST_DAMPING, RAISE, LOWER, NO_DAMPING = 0.01, 10.0, 10.0, 1e-4
MOST_RAISES = 30


@dataclass(frozen=True)
class Refit:
    """The end of a re-fit."""

    nodes: Array
    """(nn, nq) m, rad."""
    evaluations: int
    """Of the gradient."""
    failure: str
    """Why it did not converge; empty where it did."""


def refit(
    problem: TrialProblem,
    constants: ChainConstants,
    start: Array,
    settings: RefitSettings,
    known: BandFactor | None = None,
) -> Refit:
    """Minimise the weighted sum of squared marker distances over the nodes, starting at `start` (nn, nq).

    Parameters
    ----------
    problem : the markers to fit; no joint parameter is free.
    constants : of the disturbed linkage.
    known : the factor of the Gauss-Newton matrix at `start`, if there is one: it does not depend on the markers.
    """
    nodes, damping = start, 0.0
    factor = known or BandFactor(problem.equations(nodes, constants).band)
    cost, gradient = problem.gradient(nodes, constants)
    before, evaluations, longest = np.inf, 1, np.inf
    while evaluations < settings.most_evaluations:
        step = -factor.solve(gradient.ravel()).reshape(nodes.shape)
        longest = float(np.abs(step).max())
        if not np.isfinite(longest):
            return Refit(nodes, evaluations, "the step is not finite")
        if longest < settings.tolerance:
            return Refit(nodes + step, evaluations, "")
        new_cost, new_gradient = problem.gradient(nodes + step, constants)
        evaluations += 1
        refused = not new_cost <= cost
        if refused:
            damping = max(RAISE * damping, FIRST_DAMPING)
        else:
            nodes, cost, gradient = nodes + step, new_cost, new_gradient
            damping = damping / LOWER if damping > NO_DAMPING else 0.0
        if refused or longest > SLOW * before:
            found = _factor(problem, nodes, constants, damping, curved=refused or longest < NEAR)
            if found is None:
                return Refit(nodes, evaluations, "the matrix of the nodes is not positive definite")
            factor, damping = found
            before = np.inf
        else:
            before = longest
    return Refit(nodes, evaluations, f"{evaluations} evaluations did not settle it: last step {longest:.1e}")


def _factor(
    problem: TrialProblem,
    nodes: Array,
    constants: ChainConstants,
    damping: float,
    *,
    curved: bool,
) -> tuple[BandFactor, float] | None:
    """A factor at `nodes` and the damping that made it positive definite; None where none does."""
    band = problem.equations(nodes, constants, curved=curved).band
    for _ in range(MOST_RAISES):
        try:
            return BandFactor(band, damping), damping
        except np.linalg.LinAlgError:
            damping = max(RAISE * damping, FIRST_DAMPING)
    return None
