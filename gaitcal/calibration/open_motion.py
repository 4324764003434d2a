"""One trial with its joint parameters open: its motion moves, and what the parameters would change is carried along.

Of a trial's normal equations at one point, the nodes eliminated, the matrices are kept for points nearby.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array
from gaitcal.model.chain import ChainConstants
from gaitcal.motion.arrow import Elimination, eliminate
from gaitcal.motion.banded import NormalEquations
from gaitcal.motion.descent import Descent
from gaitcal.motion.minimised import Evaluation
from gaitcal.motion.trial_problem import TrialProblem

KEPT_WITHIN = 0.005
"""m, rad: a matrix formed nearer than this differs from the present one by less than the curvature it leaves out."""


@dataclass(frozen=True, kw_only=True)
class Matrices:
    """What a trial's normal equations give at one point, as long as it serves."""

    values: Array
    """(np_t,) the free parameters of this trial's chain where they were formed."""
    nodes: Array
    """(nn, nq) where they were formed."""
    eliminated: Elimination

    @property
    def hessian(self) -> Array:
        """(np_t, np_t) reduced."""
        return self.eliminated.hessian

    def serve(self, values: Array, nodes: Array) -> bool:
        """Whether another point is near enough."""
        far = max(np.abs(values - self.values).max(initial=0.0), np.abs(nodes - self.nodes).max(initial=0.0))
        return bool(far < KEPT_WITHIN)

    def solve(self, gradient: Array) -> Array:
        """H_qq^-1 times a gradient by the nodes, one after the other."""
        return self.eliminated.factor.solve(gradient)


@dataclass(frozen=True, kw_only=True)
class TrialState:
    """One trial at the joint parameters last visited."""

    nodes: Array
    """(nn, nq)."""
    matrices: Matrices
    cost: float
    """m^2."""
    reduced_gradient: Array
    """(np_t,) half gradient."""
    converged: bool


@dataclass(frozen=True)
class OpenEvaluation(Evaluation):
    """With the gradient by the joint parameters too."""

    by_parameter: Array
    """(np_t,) half gradient."""


class OpenMotion:
    """A trial's marker cost by its nodes; what the free joint parameters would change is carried along."""

    nothing_left = 0.0
    has_curvature = False

    def __init__(self, problem: TrialProblem, constants: ChainConstants, values: Array) -> None:
        self.problem, self.constants, self.values = problem, constants, values

    def nodes(self, x: Array) -> Array:
        """(nn, nq) of a vector of them all."""
        return x.reshape(self.problem.basis.nodes, -1)

    def evaluate(self, x: Array) -> OpenEvaluation:
        """Cost and half gradients."""
        cost, by_nodes, by_parameter = self.problem.both_gradients(self.nodes(x), self.constants)
        return OpenEvaluation(cost, by_nodes.ravel(), by_parameter)

    def linearise(self, x: Array, *, curved: bool) -> OpenMatrix:
        """The equations there."""
        nodes = self.nodes(x)
        return OpenMatrix(self.values, nodes, self.problem.equations(nodes, self.constants, curved=curved))

    def ended(self, end: Descent[OpenEvaluation, Matrices]) -> TrialState:
        """The trial where an iteration on it converged."""
        matrices = end.factor or self.linearise(end.x, curved=False).factor(0.0)
        return self._state(end.x, end.evaluation, matrices, end.promise, converged=True)

    def stepped(self, nodes: Array, *, converged: bool) -> tuple[TrialState, float]:
        """The trial one plain step from `nodes` (nn, nq), and the share of the cost that this promises to gain."""
        matrix = self.linearise(nodes.ravel(), curved=False)
        here, matrices = matrix.evaluation, matrix.factor(0.0)
        step = -matrices.solve(here.gradient)
        promise = -float(here.gradient @ step)
        state = self._state(nodes.ravel() + step, here, matrices, promise, converged=converged)
        return state, promise / here.cost if here.cost > 0.0 else 0.0

    def _state(
        self, x: Array, before: OpenEvaluation, matrices: Matrices, promise: float, *, converged: bool
    ) -> TrialState:
        """At nodes x, reached from `before` by a last step that promised to gain `promise`."""
        return TrialState(
            nodes=self.nodes(x),
            matrices=matrices,
            cost=max(before.cost - promise, 0.0),
            reduced_gradient=matrices.eliminated.reduced(before.gradient, before.by_parameter),
            converged=converged,
        )


class OpenMatrix:
    """Its equations at some nodes."""

    spent = False

    def __init__(self, values: Array, nodes: Array, equations: NormalEquations) -> None:
        self.values, self.nodes, self.equations = values, nodes, equations
        by_node, by_parameter = equations.node_gradient.ravel(), equations.parameter_gradient
        self.evaluation = OpenEvaluation(equations.cost, by_node, by_parameter)

    def factor(self, damping: float) -> Matrices:
        """With the nodes eliminated."""
        return Matrices(values=self.values, nodes=self.nodes, eliminated=eliminate(self.equations, damping))
