"""Robust tracking: markers that are far out of line get less weight, sample by sample.

Instead of  sum w |r|^2  the cost is  s^2 sum rho(u),  u = sqrt(w) |r| / s,  |r| the distance of a marker from its place
on the model. Its minimum is that of least squares with weights w f(u), f = rho'(u) / (2 u), iterated until the
weights settle (Holland and Welsch 1977):

    Huber    f = min(1, k / u)            convex: one minimum, outliers pull with a constant force
    Cauchy   f = 1 / (1 + (u / c)^2)      outliers let go; begun from Huber's solution, as it may have several minima

k and c keep 95 % efficiency when the three coordinates of a residual are Gaussian. The scale s of one coordinate is
1.4826 times the median absolute deviation of the coordinates (from zero), which outliers move little.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.model.parameters import Parameters
from gaitcal.motion.motion import Tracked, track_nodes
from gaitcal.motion.start import starting_nodes
from gaitcal.motion.trial_problem import MotionProblem

HUBER = 1.7
CAUCHY = 2.8
MAD = 1.4826
LEAST_SCALE = 0.0005  # m: residuals of half a millimetre are measurement noise, however well the rest fits
SETTLED = 0.02  # largest change of a factor at which the iteration ends
MOST_ROUNDS = 30
FIRST_ROUNDS = 4  # of Huber's loss before Cauchy's
OUTLIER = 0.25
"""A sample whose factor is below this was all but left out: sqrt(3) c scales away for Cauchy, 4 k for Huber."""


class Loss(Enum):
    """How residuals count."""

    HUBER = "huber"
    CAUCHY = "cauchy"

    def factor(self, u: Array) -> Array:
        """f(u) in (0, 1]: what a sample `u` scales away keeps of its weight."""
        if self is Loss.HUBER:
            return np.minimum(1.0, HUBER / np.maximum(u, 1e-300))
        return 1.0 / (1.0 + (u / CAUCHY) ** 2)


@dataclass(frozen=True, kw_only=True)
class RobustTracking:
    """Where the iteration ended."""

    problem: MotionProblem  # with the weights w f(u)
    factor: Array  # (nm, nf) f(u); 1 where a marker was not seen or has no weight
    scale: float  # m, s
    tracked: Tracked
    rounds: int
    settled: bool

    @property
    def outliers(self) -> BoolArray:
        """(nm, nf) samples all but left out."""
        return np.less(self.factor, OUTLIER)


def residual_scale(standardised: Array) -> float:
    """m, s from residual coordinates sqrt(w) r (n, 3) of the samples with weight."""
    if not len(standardised):
        return LEAST_SCALE
    return max(MAD * float(np.median(np.abs(standardised))), LEAST_SCALE)


def robust_tracking(
    problem: MotionProblem, parameters: Parameters, loss: Loss, factor: Array | None = None
) -> RobustTracking:
    """Track one trial from rigid fits under a robust loss; its own weights are those that the marker set gives.

    `factor` (nm, nf): where the weights start, if something like them is known already.
    """
    constants, weight = problem.constants(parameters), problem.data.weight
    used, begun = weight > 0, 0 if factor is None else FIRST_ROUNDS
    present = np.ones_like(weight) if factor is None else factor
    weighted = problem.with_weight(weight * present)
    nodes = starting_nodes(problem.chain, constants, weighted.data, problem.basis)
    tracked = track_nodes(weighted, constants, nodes)
    scale, settled, count = LEAST_SCALE, False, 0
    while count < MOST_ROUNDS and not settled:
        shape = Loss.HUBER if begun + count < FIRST_ROUNDS else loss
        residual = problem.positions(tracked.nodes, constants) - problem.data.measured
        standardised = np.sqrt(weight)[:, None] * residual
        scale = residual_scale(standardised.transpose(0, 2, 1)[used])
        changed = np.where(used, shape.factor(np.linalg.norm(standardised, axis=1) / scale), 1.0)
        settled = shape is loss and float(np.abs(changed - present).max(initial=0.0)) < SETTLED
        present = changed
        weighted = problem.with_weight(weight * present)
        tracked = track_nodes(weighted, constants, tracked.nodes)
        count += 1
    return RobustTracking(problem=weighted, factor=present, scale=scale, tracked=tracked, rounds=count, settled=settled)
