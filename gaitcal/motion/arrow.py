"""Trials that share parameters: each has a band for its own nodes, all meet in the corner of an arrow.

    [ H_1           C_1 ] [dN_1]     [g_1]       H_t: band of trial t,       C_t: (nodes of t, parameters)
    [       H_2     C_2 ] [dN_2] = - [g_2]
    [ C_1^T C_2^T   P   ] [dp  ]     [g_p]       P = sum_t H_pp + prior

Elimination of the nodes leaves the Schur complement S = P - sum_t C_t^T H_t^-1 C_t for the parameters:

    dp = -S^-1 (g_p - sum_t C_t^T H_t^-1 g_t),      dN_t = -H_t^-1 g_t - X_t dp,      X_t = H_t^-1 C_t.

X_t is what the nodes of trial t lose by the parameters: -dN_t/dp. With H_t = L L^T and Y = L^-1 C_t all of it
comes from half the substitutions: C_t^T H_t^-1 C_t = Y^T Y,  C_t^T H_t^-1 g = Y^T L^-1 g,  X_t dp = L^-T (Y dp).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from gaitcal.arrays import Array, IntArray
from gaitcal.model.parameters import Parameters
from gaitcal.motion.banded import BandFactor, NormalEquations
from gaitcal.motion.descent import Evaluation
from gaitcal.motion.track import NOTHING_LEFT_M
from gaitcal.motion.trial_problem import TrialProblem

ROUNDING = 1e-14
"""Part of its trace that is added to S: parameters that no trial sees do not move."""


@dataclass(frozen=True)
class Elimination:
    """One trial, its nodes eliminated."""

    factor: BandFactor
    """Of H_t."""
    halfway: Array
    """(nn * nq, np_t) Y."""
    hessian: Array
    """(np_t, np_t) H_pp - C_t^T X_t."""

    @cached_property
    def sensitivity(self) -> Array:
        """(nn * nq, np_t) X_t."""
        return self.factor.backward(self.halfway)

    def follow(self, change: Array) -> Array:
        """(nn * nq,) X_t dp."""
        return self.factor.backward(self.halfway @ change)

    def reduced(self, node_gradient: Array, parameter_gradient: Array) -> Array:
        """(np_t,) half gradient by the parameters, nodes following; from half gradients at one point."""
        out: Array = parameter_gradient - self.halfway.T @ self.factor.forward(node_gradient.ravel())
        return out


def eliminate(equations: NormalEquations, damping: float = 0.0) -> Elimination:
    """Eliminate the nodes of one trial; `damping` is relative to the diagonals of H_t and H_pp."""
    factor = BandFactor(equations.band, damping)
    halfway = factor.forward(equations.mixed) if equations.mixed.shape[1] else equations.mixed
    hessian = equations.parameters - halfway.T @ halfway
    if damping:
        hessian += damping * np.diag(np.diag(equations.parameters))
    return Elimination(factor, halfway, 0.5 * (hessian + hessian.T))


@dataclass(frozen=True)
class SharedPrior:
    """What is known of the shared parameters besides the trials: |L (p - c)|^2."""

    cost: float
    gradient: Array
    """(np,) half of it, L^T L (p - c)."""
    matrix: Array
    """(np, np) L^T L."""


class ArrowEquations:
    """Equations of several trials at x = (p, nodes of each trial), as `descend` asks for them.

    `columns`: per trial, places (np_t,) of its own parameters among the shared ones.
    """

    spent = False

    def __init__(
        self,
        trials: Sequence[NormalEquations],
        columns: Sequence[IntArray],
        size: int,
        prior: SharedPrior | None = None,
    ) -> None:
        self.trials, self.columns = trials, columns
        self.prior = prior or SharedPrior(0.0, np.zeros(size), np.zeros((size, size)))
        shared = self.prior.gradient.copy()
        for trial, places in zip(trials, columns, strict=True):
            shared[places] += trial.parameter_gradient
        gradient = np.concatenate([shared, *(trial.node_gradient.ravel() for trial in trials)])
        self.evaluation = Evaluation(sum(trial.cost for trial in trials) + self.prior.cost, gradient)

    def factor(self, damping: float) -> ArrowFactor:
        """With the nodes of every trial eliminated."""
        return ArrowFactor([eliminate(trial, damping) for trial in self.trials], self.columns, self.prior.matrix)


class ArrowFactor:
    """Solves for parameters and nodes together."""

    def __init__(self, trials: Sequence[Elimination], columns: Sequence[IntArray], prior: Array) -> None:
        self.trials, self.columns = trials, columns
        self.schur = prior.copy()
        for trial, places in zip(trials, columns, strict=True):
            self.schur[np.ix_(places, places)] += trial.hessian
        self.schur += ROUNDING * np.trace(self.schur) * np.eye(len(prior))

    def solve(self, gradient: Array) -> Array:
        """The whole matrix' inverse times `gradient`, both in the order of x."""
        size = len(self.schur)
        ends = size + np.cumsum([0, *(len(trial.halfway) for trial in self.trials)])
        halfway = [
            trial.factor.forward(gradient[a:b])
            for trial, (a, b) in zip(self.trials, pairwise(ends.tolist()), strict=True)
        ]
        right = gradient[:size].copy()
        for trial, places, of_trial in zip(self.trials, self.columns, halfway, strict=True):
            right[places] -= trial.halfway.T @ of_trial
        shared = np.linalg.solve(self.schur, right)
        nodes = [
            trial.factor.backward(of_trial - trial.halfway @ shared[places])
            for trial, places, of_trial in zip(self.trials, self.columns, halfway, strict=True)
        ]
        return np.concatenate([shared, *nodes])


class SharedTrials:
    """Markers of several trials by x = (joint parameters, nodes of each trial), as a problem for `descend`."""

    has_curvature = False

    def __init__(self, problems: Sequence[TrialProblem], parameters: Parameters, free: tuple[str, ...]) -> None:
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
