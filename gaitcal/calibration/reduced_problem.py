"""Joint parameters alone: the motions of all trials eliminated (variable projection).

For given joint parameters p every trial's nodes N(p) minimise that trial's marker cost C_t. What is left is a small
problem in p with gradient g = sum_t g_p and Gauss-Newton matrix S = sum_t (H_pp - H_pq H_qq^-1 H_qp) (Golub and
Pereyra 1973; Kaufman 1975). With S = V diag(s) V^T it is handed to SciPy as the compressed pair

    f = [ s^-1/2 V^T g ; sqrt(C - |s^-1/2 V^T g|^2) ],     J = [ s^1/2 V^T ; 0 ]:

the same cost |f|^2 = C, the same J^T f = g and the same J^T J = S as the full problem of tens of thousands of rows.
A singular S is no obstacle: its null directions are parameters that these trials cannot see, and p does not move
along them. Priors add one row each, (p - p0) / sigma.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gaitcal.model.chain import ChainConstants
from gaitcal.model.parameters import Parameters
from gaitcal.motion.banded import BandFactor
from gaitcal.motion.track import TrackSettings, track_nodes
from gaitcal.motion.trial_problem import TrialProblem

Array = NDArray[np.float64]

NEAR = 1e-4
"""A motion predicted from the last point is near enough, after one more step, where that step gains less than this."""
NULL = 1e-12
"""Eigenvalues of S below this fraction of the largest count as zero."""


@dataclass(frozen=True)
class TrialState:
    """One trial at the joint parameters last visited."""

    nodes: Array
    """(nn, nq)."""
    sensitivity: Array
    """(nn * nq, np_t) -dN/dp = H_qq^-1 H_qp for the free parameters of this trial's chain."""
    cost: float
    """m^2."""
    reduced_hessian: Array
    """(np_t, np_t)."""
    reduced_gradient: Array
    """(np_t,) half gradient."""
    steps: int
    converged: bool


@dataclass(frozen=True)
class ReducedState:
    """All trials at one p."""

    p: Array
    trials: tuple[TrialState, ...]
    cost: float
    """m^2, markers only."""
    hessian: Array
    """(np, np) S of the markers."""
    gradient: Array
    """(np,) half gradient of the markers."""


class ReducedProblem:
    """The trials' common problem in the joint parameters `free`; remembers the last point as a warm start."""

    def __init__(
        self,
        problems: Sequence[TrialProblem],
        parameters: Parameters,
        free: tuple[str, ...],
        starts: Sequence[Array],
        settings: TrackSettings,
        prior: Array | None = None,
        centre: Array | None = None,
    ) -> None:
        """`prior`: (np,) weights in m per unit of p of the rows (p - centre) * prior; none unless given."""
        self.free = free
        self.parameters = parameters
        self.settings = settings
        self.fixed = [problem.with_free(()) for problem in problems]
        self.open = [problem.with_free(free) for problem in problems]
        place = {name: k for k, name in enumerate(free)}
        self.columns = [np.array([place[name] for name in problem.chain.free], dtype=np.intp) for problem in self.open]
        self.starts = list(starts)
        self.prior = np.zeros(len(free)) if prior is None else prior
        self.centre = np.zeros(len(free)) if centre is None else centre
        self.state: ReducedState | None = None
        self.evaluations = 0
        self.inner_steps = 0

    def at(self, p: Array) -> ReducedState:
        """Solve all motions at p, warm-started from the last point and dN/dp."""
        if self.state is not None and np.array_equal(self.state.p, p):
            return self.state
        self.evaluations += 1
        parameters = self.parameters.with_joint(self.free, p)
        trials = tuple(self._solve(k, p, parameters) for k in range(len(self.open)))
        hessian, gradient = np.zeros((len(p), len(p))), np.zeros(len(p))
        for trial, columns in zip(trials, self.columns, strict=True):
            hessian[np.ix_(columns, columns)] += trial.reduced_hessian
            gradient[columns] += trial.reduced_gradient
        self.state = ReducedState(p.copy(), trials, sum(t.cost for t in trials), hessian, gradient)
        return self.state

    def _solve(self, k: int, p: Array, parameters: Parameters) -> TrialState:
        problem, steps, converged = self.open[k], 0, True
        constants = problem.constants(parameters)
        nodes = self._predicted(k, p)
        if nodes is not None:
            found = _linearised(problem, constants, nodes)
            if found.gain <= NEAR * found.cost:
                return found.state(steps, converged)
        settings = self.settings if nodes is None else replace(self.settings, first_damping=0.0)
        start = self.starts[k] if nodes is None else nodes
        tracked = track_nodes(self.fixed[k], self.fixed[k].constants(parameters), start, settings)
        self.inner_steps += tracked.steps
        return _linearised(problem, constants, tracked.nodes).state(tracked.steps, tracked.converged)

    def _predicted(self, k: int, p: Array) -> Array | None:
        """Nodes to first order from the last point; None at the first."""
        if self.state is None:
            return None
        last, step = self.state.trials[k], (p - self.state.p)[self.columns[k]]
        return last.nodes - (last.sensitivity @ step).reshape(last.nodes.shape)

    def residual(self, p: Array) -> Array:
        """Compressed residuals f, followed by the prior's rows; m."""
        state = self.at(p)
        values, vectors = _spectrum(state.hessian)
        projected = np.where(values > 0, vectors.T @ state.gradient / np.sqrt(np.where(values > 0, values, 1.0)), 0.0)
        rest = np.sqrt(max(state.cost - float(projected @ projected), 0.0))
        return np.concatenate([projected, [rest], self.prior * (p - self.centre)])

    def jacobian(self, p: Array) -> Array:
        """Compressed Jacobian of `residual`."""
        state = self.at(p)
        values, vectors = _spectrum(state.hessian)
        return np.vstack([np.sqrt(values)[:, None] * vectors.T, np.zeros((1, len(p))), np.diag(self.prior)])


@dataclass(frozen=True)
class _Linearised:
    """A trial's equations at some nodes, solved for the nodes."""

    nodes: Array
    cost: float
    gain: float
    """m^2 by which one Gauss-Newton step of the nodes lowers the cost."""
    step: Array
    sensitivity: Array
    hessian: Array
    gradient: Array

    def state(self, steps: int, converged: bool) -> TrialState:
        """The trial after that step."""
        return TrialState(
            self.nodes - self.step,
            self.sensitivity,
            max(self.cost - self.gain, 0.0),
            self.hessian,
            self.gradient,
            steps,
            converged,
        )


def _linearised(problem: TrialProblem, constants: ChainConstants, nodes: Array) -> _Linearised:
    equations = problem.equations(nodes, constants)
    solved = BandFactor(equations.band).solve(np.column_stack([equations.mixed, equations.node_gradient.ravel()]))
    sensitivity, step = solved[:, :-1], solved[:, -1]
    hessian = equations.parameters - equations.mixed.T @ sensitivity
    return _Linearised(
        nodes,
        equations.cost,
        float(equations.node_gradient.ravel() @ step),
        step.reshape(nodes.shape),
        sensitivity,
        0.5 * (hessian + hessian.T),
        equations.parameter_gradient - equations.mixed.T @ step,
    )


def _spectrum(hessian: Array) -> tuple[Array, Array]:
    """Eigenvalues (those that count as zero set to zero) and eigenvectors."""
    values, vectors = np.linalg.eigh(hessian)
    return np.where(values > NULL * max(float(values[-1]), 0.0), values, 0.0), vectors
