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
MOST_DAMPING = 1e12
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
    """Whether it ended with Newton's steps."""


def track_nodes(
    problem: TrialProblem,
    constants: ChainConstants,
    start: Array,
    settings: TrackSettings | None = None,
) -> Tracked:
    """Minimise the weighted sum of squared marker distances over the nodes, starting at `start` (nn, nq)."""
    return _Descent(problem, constants, start, settings or TrackSettings()).run()


class _Descent:
    """Where the iteration stands."""

    def __init__(self, problem: TrialProblem, constants: ChainConstants, start: Array, settings: TrackSettings) -> None:
        self.problem, self.constants, self.settings = problem, constants, settings
        self.small = settings.floor_m**2 * float(problem.data.weight.sum())
        self.nodes, self.cost, self.gradient = start, np.inf, np.zeros_like(start)
        self.damping = settings.first_damping
        self.equations: NormalEquations | None = None
        """At `nodes`, as far as they were formed and are still needed."""
        self.factor: BandFactor | None = None
        self.fresh = False
        """Whether the factor was formed at `nodes`."""
        self.promised = np.inf
        """m^2, what the last step on this factor promised."""
        self.promised_fresh = np.inf
        """m^2, what the last step on a fresh factor promised."""
        self.curved = settings.curved
        self.tries = 0 if problem.chain.free else MOST_TRIES
        self.converged = False

    def run(self) -> Tracked:
        """Step until a step promises, or brings, too little."""
        count = 0
        while count < self.settings.most_steps and not self.converged and self.damping <= MOST_DAMPING:
            count += 1
            step = self._direction()
            if step is not None:
                self._look(step)
        return Tracked(self.nodes, self.cost, count, self.converged, self.curved)

    def _direction(self) -> Array | None:
        """The next step, on the present factor or a new one; None where there is none."""
        factor = self.factor or self._factorise()
        return None if factor is None else -factor.solve(self.gradient.ravel()).reshape(self.nodes.shape)

    def _factorise(self) -> BandFactor | None:
        """Form the factor; None where curvature makes the matrix indefinite, and Gauss-Newton takes over."""
        self.equations = self.equations or self._equations(self.nodes)
        self.cost, self.gradient = self.equations.cost, self.equations.node_gradient
        try:
            self.factor, self.equations = self._factor(self.equations)
        except np.linalg.LinAlgError:
            if not self.curved:
                raise
            self._leave_newton()
            return None
        self.fresh, self.promised = True, np.inf
        return self.factor

    def _look(self, step: Array) -> None:
        """End, where a step promises too little; go on with another matrix, where it promises too much; or try it."""
        expected = -float(np.vdot(self.gradient, step))
        if self.fresh and expected > SLOW * self.promised_fresh and not self.curved and self.tries:
            self.curved, self.tries, self.damping, self.factor, self.equations = True, self.tries - 1, 0.0, None, None
            return
        enough = self.settings.tolerance * self.cost * (1.0 if self.fresh else KEPT)
        if self.damping == 0.0 and expected <= enough:
            self.nodes, self.converged = self.nodes + step, True
        elif not self.fresh and expected > SLOW * self.promised:
            self.factor = None
        else:
            self._try(self.nodes + step, expected, enough, near=float(np.abs(step).max()) < NEAR)

    def _try(self, nodes: Array, expected: float, enough: float, *, near: bool) -> None:
        """Take a step if it lowers the cost; else form another matrix, or damp this one more."""
        self.promised = expected
        if self.fresh:
            self.promised_fresh = expected
        there: NormalEquations | None = None
        keep = near and self.damping == 0.0
        if keep:
            cost, gradient = self.problem.gradient(nodes, self.constants)
        else:
            if self.equations is None:
                self.factor = None  # a large one makes room
            there = self._equations(nodes)
            cost, gradient = there.cost, there.node_gradient
        if cost <= self.cost + 1e-14 * self.small:
            self.converged = self.cost - cost <= enough or cost <= self.small
            self.nodes, self.cost, self.gradient, self.equations = nodes, cost, gradient, there
            self.damping = self.damping / 30 if self.damping > 1e-12 else 0.0
            self.fresh, self.factor = False, self.factor if keep else None
        elif expected <= max(enough, self.small):
            self.converged = True
        elif self.curved:
            self._leave_newton()
        else:
            self.factor = None
            if self.fresh:
                self.damping = max(10 * self.damping, 1e-6)

    def _leave_newton(self) -> None:
        self.curved, self.factor, self.equations, self.promised_fresh = False, None, None, np.inf

    def _equations(self, nodes: Array) -> NormalEquations:
        return self.problem.equations(nodes, self.constants, curved=self.curved)

    def _factor(self, equations: NormalEquations) -> tuple[BandFactor, NormalEquations | None]:
        """The factor of H_qq, and the equations if they outlive it: a large matrix is factored in its own place, and
        formed anew if that fails.
        """
        if equations.band.nbytes <= LARGE_BYTES:
            return BandFactor(equations.band, self.damping), equations
        try:
            return BandFactor(equations.band, self.damping, overwrite=True), None
        except np.linalg.LinAlgError:
            return BandFactor(self._equations(self.nodes).band, self.damping), None
