"""Marker tracking: the nodes that bring the model's markers nearest to the measured ones, over whole trials.

As problems for `descend`: one trial with fixed joint parameters, whose x are the nodes and whose matrix is a band, and
several trials that share joint parameters, whose matrix is an arrow (`banded.py`). From rigid fits undamped
Gauss-Newton steps nearly always do; markers that stay far from where the model has them ask for Newton's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from gaitcal.arrays import Array
from gaitcal.model.chain import ChainConstants
from gaitcal.model.parameters import Parameters
from gaitcal.motion.banded import ArrowEquations, BandFactor
from gaitcal.motion.descent import DescentSettings, Ending, Evaluation, descend
from gaitcal.motion.trial_problem import MotionProblem

LARGE_BYTES = 2**27  # of a normal matrix above which only one is held at a time: a trial of some 20 000 frames
NOTHING_LEFT_M = 1e-14  # m, RMS residual below which there is nothing left to fit


@dataclass(frozen=True, kw_only=True)
class Tracked:
    """The end of a tracking run."""

    nodes: Array  # (nn, nq) m, rad
    cost: float  # m^2; where the last step was taken on its prediction alone, that of the nodes before it
    steps: int
    ending: Ending
    curved: bool  # whether it ended with Newton's steps

    @property
    def converged(self) -> bool:
        """Whether it reached its tolerance."""
        return self.ending.converged


def track_nodes(
    problem: MotionProblem,
    constants: ChainConstants,
    start: Array,
    settings: DescentSettings | None = None,
    known: BandFactor | None = None,
) -> Tracked:
    """Minimise the weighted sum of squared marker distances over the nodes, starting at `start` (nn, nq).

    `known`: the factor of a matrix that serves at `start`, if there is one: it does not depend on the markers.
    """
    end = descend(_Tracking(problem, constants), start.ravel(), settings or DescentSettings(), known)
    nodes = end.x.reshape(start.shape)
    return Tracked(nodes=nodes, cost=end.cost, steps=end.steps, ending=end.ending, curved=end.curved)


class _Tracking:
    """The marker cost of a trial by its nodes, one after the other; all joint parameters are fixed."""

    def __init__(self, problem: MotionProblem, constants: ChainConstants) -> None:
        self.problem, self.constants = problem, constants
        self.nothing_left = NOTHING_LEFT_M**2 * float(problem.data.weight.sum())
        self.has_curvature = not problem.chain.free

    def nodes(self, x: Array) -> Array:
        return x.reshape(self.problem.basis.nodes, -1)

    def evaluate(self, x: Array) -> Evaluation:
        cost, gradient = self.problem.gradient(self.nodes(x), self.constants)
        return Evaluation(cost, gradient.ravel())

    def linearise(self, x: Array, *, curved: bool) -> _TrackingMatrix:
        return _TrackingMatrix(self, x, curved)


class _TrackingMatrix:
    """The normal equations at some nodes. A large matrix is factorised in its own place."""

    def __init__(self, tracking: _Tracking, x: Array, curved: bool) -> None:
        self._form = partial(tracking.problem.equations, tracking.nodes(x), tracking.constants, curved=curved)
        equations = self._form()
        self.evaluation = Evaluation(equations.cost, equations.node_gradient.ravel())
        self._band: Array | None = equations.band
        self.spent = equations.band.nbytes > LARGE_BYTES

    def factor(self, damping: float) -> BandFactor:
        band = self._form().band if self._band is None else self._band
        if not self.spent:
            return BandFactor(band, damping)
        self._band = None
        try:
            return BandFactor(band, damping, overwrite=True)
        except np.linalg.LinAlgError:
            return BandFactor(self._form().band, damping)  # with a copy: a larger floor may do


class SharedMotions:
    """Markers of several trials by x = (joint parameters, nodes of each trial), as a problem for `descend`."""

    has_curvature = False

    def __init__(self, problems: Sequence[MotionProblem], parameters: Parameters, free: tuple[str, ...]) -> None:
        self.parameters, self.free, self.size = parameters, free, len(free)
        self.open = [problem.with_free(free) for problem in problems]
        self.columns = [problem.places_in(free) for problem in self.open]
        self.nothing_left = NOTHING_LEFT_M**2 * sum(float(problem.data.weight.sum()) for problem in self.open)

    def joined(self, p: Array, nodes: Sequence[Array]) -> Array:
        """The vector x."""
        return np.concatenate([p, *(of_trial.ravel() for of_trial in nodes)])

    def parted(self, x: Array) -> tuple[Array, list[Array]]:
        """The shared parameters (np,) and the nodes (nn, nq) of each trial."""
        sizes = [self.size, *(problem.basis.nodes * len(problem.chain.coordinates) for problem in self.open)]
        p, *nodes = np.split(x, np.cumsum(sizes)[:-1])
        return p, [flat.reshape(problem.basis.nodes, -1) for flat, problem in zip(nodes, self.open, strict=True)]

    def evaluate(self, x: Array) -> Evaluation:
        """Cost (m^2) and half gradient."""
        return self.linearise(x, curved=False).evaluation

    def linearise(self, x: Array, *, curved: bool) -> ArrowEquations:
        """The same with the arrow."""
        p, nodes = self.parted(x)
        moved = self.parameters.with_joint(self.free, p)
        trials = [problem.equations(n, problem.constants(moved)) for problem, n in zip(self.open, nodes, strict=True)]
        return ArrowEquations(trials, self.columns, self.size)
