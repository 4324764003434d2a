"""The one iteration of gaitcal: a sum of squares is brought down step by step, from a start to its
minimum.

Tracking, the motions behind joint parameters, the combined fit and the re-fits of a Monte Carlo
study all call `descend`; they differ in what they minimise (a `Problem`) and in `DescentSettings`.
With g the half gradient of the cost at x and M its Gauss-Newton matrix,

    (M + damping diag(M)) step = -g,        predicted reduction of the cost  = -g . step.

- *Damping* (Levenberg 1944, Marquardt 1963) is raised only when a step raised the cost, and falls
  again afterwards.
- *A kept factor.* Forming and factorising M costs three times a gradient, and near the minimum M
  hardly changes: after a short undamped step its factor is kept, until a step predicts more than a
  tenth of what the one before did.
- *Curvature.* Where the residuals stay large, Gauss-Newton's steps shrink slowly, or grow. M then
  becomes half the whole Hessian, as long as that is positive definite, and the steps are Newton's.
- *The end.* A step that predicts too little, or is too short, is the last and is taken; so is one
  after which the cost has hardly fallen. Whatever else ends the iteration has an `Ending` of its
  own, and is not called converged.
"""

from dataclasses import dataclass
from enum import Enum
from typing import Generic, Protocol, TypeVar

import numpy as np

from gaitcal.arrays import Array

# a factor is stale when a step on it predicts more than this part of what the step before did
STALE = 0.1
LEAST_DAMPING, MOST_DAMPING = 1e-6, 1e12
"""Relative to the diagonal of M: the first damping of a refused step, and what no step lowers the
cost beyond.
"""
RAISED_BY = 10.0
NO_DAMPING = 1e-12  # damping below this is dropped
# with more damping than this a small gain says something of the damping, not of the minimum
DECISIVE_DAMPING = 1e-2
ROUNDING = 1e-14
"""A cost that is higher by this part of `nothing_left` is no higher, a gain of this part of the
cost is none.
"""


@dataclass(frozen=True)
class Evaluation:
    """The cost at a point."""

    cost: float
    gradient: Array  # half of it, in the shape of x


class Factor(Protocol):
    """A factorised matrix M."""

    def solve(self, gradient: Array) -> Array:
        """M^-1 gradient, in the shape of x."""


Point = TypeVar("Point", bound=Evaluation, covariant=True)
AnyFactor = TypeVar("AnyFactor", bound=Factor, covariant=True)


class Linearisation(Protocol[Point, AnyFactor]):
    """Cost, gradient and matrix at a point. `spent`: the factor took the place of the matrix in
    memory.
    """

    @property
    def evaluation(self) -> Point: ...  # noqa: D102
    @property
    def spent(self) -> bool: ...  # noqa: D102

    def factor(self, damping: float) -> AnyFactor:
        """The factor of M + damping diag(M); LinAlgError where that is not positive definite."""


class Problem(Protocol[Point, AnyFactor]):
    """What is minimised. Below `nothing_left` nothing is left to fit; `has_curvature`: it can give
    Newton's matrix.
    """

    nothing_left: float
    has_curvature: bool

    def evaluate(self, x: Array) -> Point:
        """Cost and gradient at x."""

    def linearise(self, x: Array, *, curved: bool) -> Linearisation[Point, AnyFactor]:
        """The same with the matrix: Gauss-Newton's or, if `curved`, Newton's."""


class Ending(Enum):
    """Why an iteration ended, in words."""

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
    """When an iteration ends, and what it may do on the way."""

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
    curved_tries: int = (
        3  # times that Newton's steps are begun, where those of Gauss-Newton are slow
    )
    persistent: bool = (
        True  # False: end with `Ending.SLOW` where damping or another matrix would be needed
    )


@dataclass(frozen=True, kw_only=True)
class Descent(Generic[Point, AnyFactor]):
    """Where an iteration ended."""

    x: Array
    evaluation: Point
    """The last one; where the last step was taken on its prediction alone, that of the point before
    it.
    """
    factor: AnyFactor | None  # of the last step; None where it was not kept, or damped
    predicted_reduction: (
        float  # of the cost by the last step, if it was taken on that alone; else 0
    )
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
    """Minimise from `start`; `known` is a factor that serves there already."""
    x, small = start, problem.nothing_left
    # linear: at x, as long as its matrix may be wanted with other damping
    linear = problem.linearise(x, curved=settings.curved) if known is None else None
    here = problem.evaluate(x) if linear is None else linear.evaluation
    factor, fresh, damping = (
        known,
        False,
        settings.first_damping,
    )  # fresh: the factor was formed at x
    curved, curved_tries = settings.curved, settings.curved_tries if problem.has_curvature else 0
    predicted = predicted_fresh = (
        np.inf
    )  # by the step before, and by the last one whose factor was formed there
    taken_blindly, steps, ending = 0.0, 0, None
    while ending is None:
        if steps == settings.most_steps or damping > MOST_DAMPING:
            ending = Ending.MOST_STEPS if steps == settings.most_steps else Ending.NO_DESCENT
            break
        steps += 1
        refused, tried = False, False  # refused: another matrix or more damping must do
        try:
            if factor is None:
                if linear is None:
                    linear = problem.linearise(x, curved=curved)
                    here = linear.evaluation
                factor = linear.factor(damping)
                linear, fresh = None if linear.spent else linear, True
            step = -factor.solve(here.gradient)
        except np.linalg.LinAlgError:
            refused = True
        else:
            reduction, length = (
                -float(np.vdot(here.gradient, step)),
                float(np.abs(step).max(initial=0.0)),
            )
            if not np.isfinite([here.cost, reduction, length]).all():
                ending = Ending.NOT_FINITE
                break
            stale = reduction > STALE * predicted
            if fresh and reduction > STALE * predicted_fresh and not curved and curved_tries:
                curved, curved_tries, damping, factor, linear = (
                    True,
                    curved_tries - 1,
                    0.0,
                    None,
                    None,
                )
                continue
            enough = settings.gain * here.cost * (1.0 if fresh else settings.kept_gain)
            refused = reduction < -max(enough, small)
        if refused:  # the matrix leads uphill, or nowhere
            ending = None if np.isfinite(here.cost) else Ending.NOT_FINITE
        elif damping == 0.0 and (reduction <= enough or length < settings.shortest_step):
            x, taken_blindly = x + step, reduction
            ending = Ending.SMALL_REDUCTION if reduction <= enough else Ending.SHORT_STEP
        elif stale and not settings.persistent:
            refused = True
        elif stale and not fresh:
            factor = None
        else:
            tried, predicted = True, reduction
            predicted_fresh = reduction if fresh else predicted_fresh
            keep = length < settings.keep_within and damping == 0.0
            factor = factor if keep or linear is not None else None  # a large one makes room
            there = None if keep else problem.linearise(x + step, curved=curved)
            evaluation = problem.evaluate(x + step) if there is None else there.evaluation
            if evaluation.cost <= here.cost + ROUNDING * small:
                gained, x, here, linear = here.cost - evaluation.cost, x + step, evaluation, there
                if here.cost <= small:
                    ending = Ending.NOTHING_LEFT
                elif gained <= enough and damping < DECISIVE_DAMPING:
                    ending = Ending.SMALL_GAIN
                damping = damping / settings.lowered_by if damping > NO_DAMPING else 0.0
                fresh, factor = False, factor if keep else None
            elif predicted <= max(ROUNDING * here.cost, small) and damping < DECISIVE_DAMPING:
                ending = Ending.SMALL_REDUCTION
            else:
                refused = True
            there = None  # a large matrix makes room, too
        if not refused or ending is not None:
            continue
        if not settings.persistent:
            ending = Ending.SLOW
        elif curved:  # Gauss-Newton takes over: its matrix is always positive definite
            curved, factor, linear, predicted_fresh = False, None, None, np.inf
        else:
            factor = None
            if fresh or not tried:
                damping = max(RAISED_BY * damping, LEAST_DAMPING)
    return Descent(
        x=x,
        evaluation=here,
        factor=factor if damping == 0.0 else None,
        predicted_reduction=taken_blindly,
        steps=steps,
        curved=curved,
        ending=ending,
    )
