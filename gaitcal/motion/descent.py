"""The one iteration of gaitcal: a sum of squares is brought down step by step, from a start to its minimum.

Tracking, the motions behind joint parameters, starts from far away, the combined fit and the re-fits of a Monte Carlo
study all call `descend`; they differ in what they minimise (a `Problem`) and in `DescentSettings`. A step solves
(M + damping diag(M)) step = -g, with g the half gradient of the cost at x and M its Gauss-Newton matrix; -g . step is
the gain that it promises.

- *Damping* (Levenberg 1944, Marquardt 1963) is raised only when a step raised the cost, and falls again afterwards.
- *A kept factor.* Forming and factorising M costs three times a gradient, and near the minimum M hardly changes: after
  a short undamped step its factor is kept, until a step promises more than a tenth of the one before.
- *Curvature.* Where the residuals stay large, Gauss-Newton's steps shrink slowly, or grow. M then becomes half the
  whole Hessian, as long as that is positive definite, and the steps are Newton's.
- *Going further* (`secant.py`). Slow steps may take in what the one before shows of the curvature left out.
- *The end.* A step that promises too little, or is too short, is the last and is taken; so is one after which the cost
  has hardly fallen. Whatever else ends the iteration has an `Ending` of its own, and is not called converged.

What `descend` minimises: a sum of squares that tells its cost and gradient at a point, and, for more, its matrix.

A slow step that goes further: what two steps in a row tell of the curvature that their matrix leaves out.

With s the step at x, g the gradient there and d the changes since the step before, x + s - t d(x + s) takes back the
part of the last step that did not do what it promised; t makes s - t d(s) shortest in the metric of M, where M d(s) is
-d(g): t = d(s) . g / d(s) . d(g) (Anderson 1965, with one step remembered).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Generic, Protocol, TypeVar

import numpy as np

from gaitcal.arrays import Array


@dataclass(frozen=True)
class Evaluation:
    """The cost at a point."""

    cost: float
    gradient: Array
    """Half of it, in the shape of x."""


class Factor(Protocol):
    """A factorised matrix M."""

    def solve(self, gradient: Array) -> Array:
        """M^-1 gradient, in the shape of x."""


Point = TypeVar("Point", bound=Evaluation)
AnyFactor = TypeVar("AnyFactor", bound=Factor)
PointOf = TypeVar("PointOf", bound=Evaluation, covariant=True)
FactorOf = TypeVar("FactorOf", bound=Factor, covariant=True)


class Linearisation(Protocol[PointOf, FactorOf]):
    """Cost, gradient and matrix at a point. `spent`: the factor took the place of the matrix in memory."""

    @property
    def evaluation(self) -> PointOf: ...  # noqa: D102
    @property
    def spent(self) -> bool: ...  # noqa: D102

    def factor(self, damping: float) -> FactorOf:
        """The factor of M + damping diag(M); LinAlgError where that is not positive definite."""


class Problem(Protocol[PointOf, FactorOf]):
    """What is minimised. Below `nothing_left` nothing is left to fit; `has_curvature`: it can give Newton's matrix."""

    @property
    def nothing_left(self) -> float: ...  # noqa: D102
    @property
    def has_curvature(self) -> bool: ...  # noqa: D102

    def evaluate(self, x: Array) -> PointOf:
        """Cost and gradient at x."""

    def linearise(self, x: Array, *, curved: bool) -> Linearisation[PointOf, FactorOf]:
        """The same with the matrix: Gauss-Newton's or, if `curved`, Newton's."""


@dataclass(frozen=True)
class Step:
    """A step that a matrix formed where it begins gives."""

    x: Array
    """Where it begins."""
    step: Array
    gradient: Array
    """Half of it, at x."""


def further(now: Step, before: Step | None) -> Array | None:
    """Where a step and the one before it lead together; None where they tell nothing."""
    if before is None:
        return None
    change = now.step - before.step
    curvature = float(np.vdot(change, now.gradient - before.gradient))
    if curvature >= 0.0:
        return None
    t = float(np.vdot(change, now.gradient)) / curvature
    out: Array = now.x + now.step - t * (now.x - before.x + change)
    return out


STALE = 0.1
"""A factor is stale when a step on it promises more than this part of what the step before promised."""
LEAST_DAMPING, MOST_DAMPING = 1e-6, 1e12
"""Relative to the diagonal of M: the first damping of a refused step, and what no step lowers the cost beyond."""
RAISED_BY = 10.0
NO_DAMPING = 1e-12
"""Damping below this is dropped."""
DECISIVE_DAMPING = 1e-2
"""With more damping than this a small gain says something of the damping, not of the minimum."""
ROUNDING = 1e-14
"""A cost that is higher by this part of `nothing_left` is no higher, a gain of this part of the cost is none."""


class Ending(Enum):
    """Why an iteration ended, in words."""

    SMALL_PROMISE = "the next step promises too little"
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
        return self in (Ending.SMALL_PROMISE, Ending.SHORT_STEP, Ending.SMALL_GAIN, Ending.NOTHING_LEFT)


@dataclass(frozen=True, kw_only=True)
class DescentSettings:
    """When an iteration ends, and what it may do on the way."""

    gain: float = 1e-6
    """Relative gain of a step below which it is the last; what is then left to gain is about its square."""
    kept_gain: float = 0.1
    """The same on a kept factor, as a part of `gain`: such a step leaves more to gain than the square."""
    shortest_step: float = 0.0
    """Largest entry (m, rad) below which a step is the last."""
    most_steps: int = 100
    keep_within: float = 0.05
    """A factor is kept after steps whose largest entry (m, rad) is below this: they change M by less than the
    curvature of the residuals, which Gauss-Newton leaves out."""
    first_damping: float = 0.0
    """1e-3 when starting far away."""
    lowered_by: float = 30.0
    """Divides the damping after a step that lowered the cost."""
    curved: bool = False
    """Whether to begin with Newton's steps."""
    curved_tries: int = 3
    """Times that Newton's steps are begun, where those of Gauss-Newton are slow."""
    goes_further: bool = False
    """Whether slow steps try to go further."""
    persistent: bool = True
    """False: end with `Ending.SLOW` where damping or another matrix would be needed."""


@dataclass(frozen=True, kw_only=True)
class Descent(Generic[Point, AnyFactor]):
    """Where an iteration ended."""

    x: Array
    evaluation: Point
    """The last one; where the last step was taken on its promise alone, that of the point before it."""
    factor: AnyFactor | None
    """Of the last step; None where it was not kept, or damped."""
    promise: float
    """What the last step promised to gain, if it was taken on its promise alone; else 0."""
    steps: int
    curved: bool
    """Whether it ended with Newton's steps."""
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
    problem: Problem[Point, AnyFactor], start: Array, settings: DescentSettings, known: AnyFactor | None = None
) -> Descent[Point, AnyFactor]:
    """Minimise from `start`; `known` is a factor that serves there already."""
    return _Iteration(problem, start, settings, known).run()


class _Iteration(Generic[Point, AnyFactor]):
    """Where the iteration stands."""

    def __init__(
        self, problem: Problem[Point, AnyFactor], start: Array, settings: DescentSettings, known: AnyFactor | None
    ) -> None:
        self.problem, self.settings, self.x = problem, settings, start
        self.linear = problem.linearise(start, curved=settings.curved) if known is None else None
        """At x, as long as its matrix may be wanted with other damping."""
        self.here = problem.evaluate(start) if self.linear is None else self.linear.evaluation
        """At x."""
        self.factor = known
        self.fresh = False
        """Whether the factor was formed at x."""
        self.damping = settings.first_damping
        self.promised = self.promised_fresh = np.inf
        """By the step before, and by the last one whose factor was formed where it was used."""
        self.before: Step | None = None
        """The one before, if its factor was formed where it was used."""
        self.unseen = 0.0
        """Promised by a last step that was taken without a look."""
        self.curved = settings.curved
        self.curved_tries = settings.curved_tries if problem.has_curvature else 0
        self.ending: Ending | None = None

    def run(self) -> Descent[Point, AnyFactor]:
        """Step until something ends it."""
        steps = 0
        while self.ending is None:
            if steps == self.settings.most_steps:
                self.ending = Ending.MOST_STEPS
            elif self.damping > MOST_DAMPING:
                self.ending = Ending.NO_DESCENT
            else:
                steps += 1
                self._advance()
        return Descent(
            x=self.x,
            evaluation=self.here,
            factor=self.factor if self.damping == 0.0 else None,
            promise=self.unseen,
            steps=steps,
            curved=self.curved,
            ending=self.ending,
        )

    def _advance(self) -> None:
        """One step on the present factor or a new one."""
        step = self._direction()
        if step is None:
            return
        promise, length = -float(np.vdot(self.here.gradient, step)), float(np.abs(step).max(initial=0.0))
        if np.isfinite([self.here.cost, promise, length]).all():
            self._judge(step, promise, length)
        else:
            self.ending = Ending.NOT_FINITE

    def _direction(self) -> Array | None:
        """The next step; None where the matrix gives none. No reference to a factor is kept: a large one must go."""
        factor = self.factor or self._factorise()
        try:
            return None if factor is None else -factor.solve(self.here.gradient)
        except np.linalg.LinAlgError:
            self._not_definite()
            return None

    def _factorise(self) -> AnyFactor | None:
        """The factor at x; None where the matrix is not positive definite, which another one may then be."""
        if self.linear is None:
            self.linear = self.problem.linearise(self.x, curved=self.curved)
            self.here = self.linear.evaluation
        try:
            self.factor = self.linear.factor(self.damping)
        except np.linalg.LinAlgError:
            self._not_definite()
            return None
        self.linear = None if self.linear.spent else self.linear
        self.fresh = True
        return self.factor

    def _judge(self, step: Array, promise: float, length: float) -> None:
        """End with a step that promises too little, go on with another matrix if it promises too much, or try it."""
        settings, stale = self.settings, promise > STALE * self.promised
        if self.fresh and promise > STALE * self.promised_fresh and not self.curved and self.curved_tries:
            self.curved, self.curved_tries, self.damping = True, self.curved_tries - 1, 0.0
            self.factor, self.linear = None, None
            return
        enough = settings.gain * self.here.cost * (1.0 if self.fresh else settings.kept_gain)
        little, short = promise <= enough, length < settings.shortest_step
        if promise < -max(enough, self.problem.nothing_left):
            self._not_definite()
        elif self.damping == 0.0 and (little or short):
            self.x, self.unseen = self.x + step, promise
            self.ending = Ending.SMALL_PROMISE if little else Ending.SHORT_STEP
        elif stale and not settings.persistent:
            self.ending = Ending.SLOW
        elif stale and not self.fresh:
            self.factor = None
        else:
            self.promised = promise
            if self.fresh:
                self.promised_fresh = promise
            now = Step(self.x, step, self.here.gradient) if self.fresh and self.damping == 0.0 else None
            leap = further(now, self.before) if now and stale and settings.goes_further else None
            self.before = now
            if leap is None or not self._leap(leap, enough):
                self._try(self.x + step, enough, keep=length < settings.keep_within and self.damping == 0.0)

    def _leap(self, x: Array, enough: float) -> bool:
        """Go to x if that gains half of what the plain step promises."""
        if self.linear is None:
            self.factor = None  # a large one makes room
        linear = self.problem.linearise(x, curved=self.curved)
        if not linear.evaluation.cost <= self.here.cost - 0.5 * self.promised:
            return False
        self._take(x, linear.evaluation, linear, enough, keep=False)
        return True

    def _try(self, x: Array, enough: float, *, keep: bool) -> None:
        """Take a step if it lowers the cost; else form another matrix, or damp this one more."""
        linear: Linearisation[Point, AnyFactor] | None = None
        if keep:
            there = self.problem.evaluate(x)
        else:
            if self.linear is None:
                self.factor = None  # a large one makes room
            linear = self.problem.linearise(x, curved=self.curved)
            there = linear.evaluation
        small = self.problem.nothing_left
        if there.cost <= self.here.cost + ROUNDING * small:
            self._take(x, there, linear, enough, keep=keep)
        elif self.promised <= max(ROUNDING * self.here.cost, small) and self.damping < DECISIVE_DAMPING:
            self.ending = Ending.SMALL_PROMISE
        elif not self.settings.persistent:
            self.ending = Ending.SLOW
        elif self.curved:
            self._leave_newton()
        else:
            self.factor = None
            if self.fresh:
                self._raise_damping()

    def _take(
        self, x: Array, there: Point, linear: Linearisation[Point, AnyFactor] | None, enough: float, *, keep: bool
    ) -> None:
        """Go to x, where the cost is lower."""
        small = self.problem.nothing_left
        if there.cost <= small:
            self.ending = Ending.NOTHING_LEFT
        elif self.here.cost - there.cost <= enough and self.damping < DECISIVE_DAMPING:
            self.ending = Ending.SMALL_GAIN
        self.x, self.here, self.linear = x, there, linear
        self.damping = self.damping / self.settings.lowered_by if self.damping > NO_DAMPING else 0.0
        self.fresh, self.factor = False, self.factor if keep else None

    def _not_definite(self) -> None:
        """The matrix leads uphill, or nowhere: go on with another."""
        if not np.isfinite(self.here.cost):
            self.ending = Ending.NOT_FINITE
        elif not self.settings.persistent:
            self.ending = Ending.SLOW
        elif self.curved:
            self._leave_newton()
        else:
            self.factor = None
            self._raise_damping()

    def _raise_damping(self) -> None:
        self.damping = max(RAISED_BY * self.damping, LEAST_DAMPING)

    def _leave_newton(self) -> None:
        """Gauss-Newton takes over: its matrix is always positive definite."""
        self.curved, self.factor, self.linear, self.promised_fresh = False, None, None, np.inf
