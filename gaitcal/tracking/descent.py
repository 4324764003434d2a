"""Damped Gauss-Newton iteration for sums of squares.

With g half the gradient of the cost at x and M its Gauss-Newton matrix,

    (M + damping diag(M)) step = -g,        predicted reduction of the cost  = -g . step.

Tracking, the elimination of trial motions, the combined fit and the Monte Carlo studies all call
`descend`. They differ in their `Problem` and `DescentSettings`.

- *Damping* (Levenberg 1944, Marquardt 1963) is raised only after a step that raised the cost, and
  falls again afterwards.
- *Kept factor.* Forming and factorising M costs three gradients, and M hardly changes near the
  minimum. After a short undamped step its factor is kept, until a step predicts more than a tenth
  of the reduction before.
- *Curvature.* Where residuals stay large, Gauss-Newton steps shrink slowly, or grow. M is then
  half the full Hessian, as long as that is positive definite (Newton's method).
- *End.* A step that predicts too little, or is too short, is taken and is the last. So is a step
  after which the cost has hardly fallen. Every other `Ending` counts as not converged.
"""

from dataclasses import dataclass
from enum import Enum
from typing import Generic, Protocol, TypeVar

import numpy as np

from gaitcal.arrays import Array

STALE_RATIO = 0.1
"""A kept factor is stale if a step predicts more than this part of the reduction before."""
LEAST_DAMPING, MOST_DAMPING = 1e-6, 1e12
"""Relative to the diagonal of M: the first damping of a refused step, and what no step lowers the
cost beyond.
"""
DAMPING_FACTOR = 10.0
"""Factor by which damping is raised after a refused step."""
NEGLIGIBLE_DAMPING = 1e-12
"""Damping below this is set to zero."""
DECISIVE_DAMPING = 1e-2
"""With more damping, a small gain is a sign of the damping and not of the minimum."""
ROUNDING = 1e-14
"""A cost that is higher by this part of `nothing_left` is no higher, a gain of this part of the
cost is none.
"""


@dataclass(frozen=True)
class Evaluation:
    """Cost and half gradient at a point."""

    cost: float
    gradient: Array  # half of it, in the shape of x


class Factor(Protocol):
    """A factorised matrix M."""

    def solve(self, gradient: Array) -> Array:
        """Return M^-1 gradient, in the shape of x."""


Point = TypeVar("Point", bound=Evaluation, covariant=True)
AnyFactor = TypeVar("AnyFactor", bound=Factor, covariant=True)


class Linearisation(Protocol[Point, AnyFactor]):
    """Cost, gradient and matrix at a point.

    `spent`: the factor has replaced the matrix in memory.
    """

    @property
    def evaluation(self) -> Point: ...  # noqa: D102
    @property
    def spent(self) -> bool: ...  # noqa: D102

    def factor(self, damping: float) -> AnyFactor:
        """Factorise M + damping diag(M); LinAlgError if it is not positive definite."""


class Problem(Protocol[Point, AnyFactor]):
    """Sum of squares to minimise.

    `nothing_left`: cost below which the fit is exact. `has_curvature`: Newton's matrix is
    available.
    """

    nothing_left: float
    has_curvature: bool

    def evaluate(self, x: Array) -> Point:
        """Compute cost and half gradient at x."""

    def linearise(self, x: Array, *, curved: bool) -> Linearisation[Point, AnyFactor]:
        """Compute cost, half gradient and matrix: Gauss-Newton, or Newton if `curved`."""


class Ending(Enum):
    """Reason why an iteration ended."""

    SMALL_REDUCTION = "the next step promises too little"
    SHORT_STEP = "the last step is too short to matter"
    SMALL_GAIN = "the cost falls no further"
    NOTHING_LEFT = "nothing is left to fit"
    MOST_STEPS = "stopped at the largest number of steps"
    NO_DESCENT = "no step lowers the cost, however much it is damped"
    SLOW = "plain steps do not shrink"
    NOT_FINITE = "the cost or a step is not finite"

    @property
    def converged(self) -> bool:
        """Whether the tolerance was reached."""
        return self in (
            Ending.SMALL_REDUCTION,
            Ending.SHORT_STEP,
            Ending.SMALL_GAIN,
            Ending.NOTHING_LEFT,
        )


@dataclass(frozen=True, kw_only=True)
class DescentSettings:
    """Tolerances and options of an iteration."""

    gain: float = 1e-6
    """Relative gain of a step below which it is the last; what is then left to gain is about its
    square.
    """
    kept_gain: float = 0.1
    """The same on a kept factor, as a part of `gain`: such a step leaves more to gain than the
    square.
    """
    shortest_step: float = 0.0  # largest entry (m, rad) below which a step is the last
    most_steps: int = 100
    keep_within: float = 0.05
    """A factor is kept after steps whose largest entry (m, rad) is below this: they change M by
    less than the curvature of the residuals, which Gauss-Newton leaves out."""
    first_damping: float = 0.0  # 1e-3 when starting far away
    lowered_by: float = 30.0  # divides the damping after a step that lowered the cost
    curved: bool = False  # whether to begin with Newton's steps
    # times that Newton's steps are begun, where those of Gauss-Newton are slow
    curved_tries: int = 3
    # False: end with `Ending.SLOW` where damping or another matrix would be needed
    persistent: bool = True


@dataclass(frozen=True, kw_only=True)
class Descent(Generic[Point, AnyFactor]):
    """Result of an iteration."""

    x: Array
    evaluation: Point
    """The last one; where the last step was taken on its prediction alone, that of the point before
    it.
    """
    factor: AnyFactor | None  # of the last step; None where it was not kept, or damped
    # of the cost by the last step, if it was taken on that alone; else 0
    predicted_reduction: float
    steps: int
    curved: bool  # whether it ended with Newton's steps
    ending: Ending

    @property
    def cost(self) -> float:
        """Of the last evaluation."""
        return self.evaluation.cost

    @property
    def converged(self) -> bool:
        """Whether the iteration reached its tolerance."""
        return self.ending.converged


def descend(
    problem: Problem[Point, AnyFactor],
    start: Array,
    settings: DescentSettings,
    known: AnyFactor | None = None,
) -> Descent[Point, AnyFactor]:
    """Minimise a sum of squares from a starting point.

    Parameters
    ----------
    problem
        Cost, gradient and matrix as functions of x.
    start
        x at the start, in any shape that `problem` accepts.
    settings
        Tolerances and options.
    known
        Factor of the matrix that already serves at `start`, if there is one.

    Returns
    -------
    Descent
        The last x, its evaluation, and the reason for the end. No factor is returned after damped
        steps.
    """
    iteration = _Iteration(problem, start, settings, known)
    steps, ending = 0, None
    while ending is None:
        if steps == settings.most_steps:
            ending = Ending.MOST_STEPS
        elif iteration.damping > MOST_DAMPING:
            ending = Ending.NO_DESCENT
        else:
            steps += 1
            ending = iteration.advance()
    return Descent(
        x=iteration.x,
        evaluation=iteration.here,
        factor=iteration.factor if iteration.damping == 0.0 else None,
        predicted_reduction=iteration.taken_blindly,
        steps=steps,
        curved=iteration.curved,
        ending=ending,
    )


class _Iteration(Generic[Point, AnyFactor]):
    """The current point of an iteration, its matrix, and the reductions predicted before."""

    def __init__(
        self,
        problem: Problem[Point, AnyFactor],
        start: Array,
        settings: DescentSettings,
        known: AnyFactor | None,
    ) -> None:
        self.problem, self.settings, self.x = problem, settings, start
        # The linearisation at x is kept as long as its matrix may be needed with other damping.
        self.linear = problem.linearise(start, curved=settings.curved) if known is None else None
        self.here = problem.evaluate(start) if self.linear is None else self.linear.evaluation
        # `fresh`: the factor was formed at x, not kept from an earlier point.
        self.factor, self.fresh = known, False
        self.damping = settings.first_damping
        self.curved = settings.curved
        self.curved_tries = settings.curved_tries if problem.has_curvature else 0
        # Reductions predicted by the last step, and by the last one on a fresh factor.
        self.predicted = self.predicted_fresh = np.inf
        # Reduction predicted by a final step that was taken without an evaluation.
        self.taken_blindly = 0.0

    def advance(self) -> Ending | None:
        """Take a step, or change matrix or damping; return why the iteration ends, if it does."""
        settings = self.settings
        try:
            step = self._solve_step()
        except np.linalg.LinAlgError:
            return self._refuse(tried=False)
        reduction = -float(np.vdot(self.here.gradient, step))
        length = float(np.abs(step).max(initial=0.0))
        if not np.isfinite([self.here.cost, reduction, length]).all():
            return Ending.NOT_FINITE
        # Gauss-Newton steps that do not shrink: change to Newton's matrix.
        slow = self.fresh and reduction > STALE_RATIO * self.predicted_fresh
        if slow and not self.curved and self.curved_tries:
            self.curved, self.curved_tries = True, self.curved_tries - 1
            self.damping, self.factor, self.linear = 0.0, None, None
            return None
        # An indefinite Newton matrix may lead uphill.
        enough = settings.gain * self.here.cost * (1.0 if self.fresh else settings.kept_gain)
        if reduction < -max(enough, self.problem.nothing_left):
            return self._refuse(tried=False)
        # A small undamped step is the last, and is taken on its prediction.
        if self.damping == 0.0 and (reduction <= enough or length < settings.shortest_step):
            self.x, self.taken_blindly = self.x + step, reduction
            return Ending.SMALL_REDUCTION if reduction <= enough else Ending.SHORT_STEP
        # A kept factor that no longer reduces the predictions is formed anew.
        stale = reduction > STALE_RATIO * self.predicted
        if stale and not settings.persistent:
            return self._refuse(tried=False)
        if stale and not self.fresh:
            self.factor = None
            return None
        return self._try_step(step, reduction, length, enough)

    def _solve_step(self) -> Array:
        """Solve for the step, with a factor of the matrix at x if none is kept."""
        if self.factor is None:
            if self.linear is None:
                self.linear = self.problem.linearise(self.x, curved=self.curved)
                self.here = self.linear.evaluation
            self.factor = self.linear.factor(self.damping)
            if self.linear.spent:
                self.linear = None
            self.fresh = True
        return np.asarray(-self.factor.solve(self.here.gradient))

    def _try_step(
        self, step: Array, reduction: float, length: float, enough: float
    ) -> Ending | None:
        """Evaluate the cost after a step, and take the step if the cost is no higher."""
        small = self.problem.nothing_left
        self.predicted = reduction
        if self.fresh:
            self.predicted_fresh = reduction
        # Short undamped steps keep the factor: only a gradient is needed at the new point.
        keep = length < self.settings.keep_within and self.damping == 0.0
        if not keep and self.linear is None:
            # A large factor is released before the next matrix is formed.
            self.factor = None
        x = self.x + step
        there = None if keep else self.problem.linearise(x, curved=self.curved)
        evaluation = self.problem.evaluate(x) if there is None else there.evaluation
        ending = None
        if evaluation.cost <= self.here.cost + ROUNDING * small:
            gained = self.here.cost - evaluation.cost
            self.x, self.here, self.linear = x, evaluation, there
            if evaluation.cost <= small:
                ending = Ending.NOTHING_LEFT
            elif gained <= enough and self.damping < DECISIVE_DAMPING:
                ending = Ending.SMALL_GAIN
            # Damping falls after every step that lowered the cost.
            lowered = self.damping / self.settings.lowered_by
            self.damping = lowered if self.damping > NEGLIGIBLE_DAMPING else 0.0
            self.fresh, self.factor = False, self.factor if keep else None
            return ending
        # The cost rose by rounding alone: the minimum is reached.
        if reduction <= max(ROUNDING * self.here.cost, small) and self.damping < DECISIVE_DAMPING:
            return Ending.SMALL_REDUCTION
        return self._refuse(tried=True)

    def _refuse(self, *, tried: bool) -> Ending | None:
        """Choose another matrix or more damping after a step that is not taken.

        `tried`: the cost after the step was evaluated, and had risen.
        """
        if not np.isfinite(self.here.cost):
            return Ending.NOT_FINITE
        if not self.settings.persistent:
            return Ending.SLOW
        if self.curved:
            # Gauss-Newton takes over: its matrix is always positive definite.
            self.curved, self.factor, self.linear = False, None, None
            self.predicted_fresh = np.inf
            return None
        self.factor = None
        # A kept factor that failed is formed anew first; a fresh one needs more damping.
        if self.fresh or not tried:
            self.damping = max(DAMPING_FACTOR * self.damping, LEAST_DAMPING)
        return None
