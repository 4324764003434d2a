"""Joint parameters alone: the motions of all trials eliminated (variable projection).

For given joint parameters p every trial's nodes N(p) minimise that trial's marker cost C_t. What is left is a small
problem in p with gradient g = sum_t g_p and Gauss-Newton matrix S = sum_t (H_pp - H_pq H_qq^-1 H_qp) (Golub and
Pereyra 1973; Kaufman 1975). With S = V diag(s) V^T it is handed to SciPy as the compressed pair

    f = [ s^-1/2 V^T g ; sqrt(C - |s^-1/2 V^T g|^2) ],     J = [ s^1/2 V^T ; 0 ]:

the same cost |f|^2 = C, the same J^T f = g and the same J^T J = S as the full problem of tens of thousands of rows.
A singular S is no obstacle: its null directions are parameters that these trials cannot see, and p does not move
along them. Priors add one row each, (p - p0) / sigma.

On the way, a motion is solved no further than the next step needs (`NEAR`), and while parameters and motion have moved
less than `KEPT` since H was formed, H, S and dN/dp are kept and only the gradient is formed. `settle` ends with all of
them formed anew, and with motions solved as far as tracking alone would solve them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

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
START = 0.1
"""What the first motion's last step may gain by, as a part of its cost, before full equations take over."""
KEPT = 0.005
"""m, rad: a matrix formed nearer than this differs from the present one by less than the curvature it leaves out."""
NULL = 1e-12
"""Eigenvalues of S below this fraction of the largest count as zero."""
MUCH_NEARER = 0.5
"""A trial whose cost has fallen to this part tries Gauss-Newton's steps again."""
SLOW = 0.1
"""A motion whose steps do not each promise less than this part of the one before is tracked, with damping."""


@dataclass(frozen=True)
class Matrices:
    """What a trial's normal equations give at one point, as long as it serves."""

    values: Array
    """(np_t,) the free parameters of this trial's chain where they were formed."""
    nodes: Array
    """(nn, nq) where they were formed."""
    factor: BandFactor
    """Of H_qq."""
    sensitivity: Array
    """(nn * nq, np_t) -dN/dp = H_qq^-1 H_qp."""
    hessian: Array
    """(np_t, np_t) reduced."""

    def serve(self, values: Array, nodes: Array) -> bool:
        """Whether another point is near enough."""
        far = max(np.abs(values - self.values).max(initial=0.0), np.abs(nodes - self.nodes).max(initial=0.0))
        return bool(far < KEPT)


@dataclass(frozen=True)
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

    @cached_property
    def spectrum(self) -> tuple[Array, Array]:
        """Eigenvalues of S (those that count as zero set to zero) and eigenvectors."""
        values, vectors = np.linalg.eigh(self.hessian)
        return np.where(values > NULL * max(float(values[-1]), 0.0), values, 0.0), vectors


class ReducedProblem:
    """The trials' common problem in the joint parameters `free`; remembers the best point as a warm start."""

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
        """`prior`: (n, np) weights in m per unit of p of the rows prior (p - centre); none unless given."""
        self.free = free
        self.parameters = parameters
        self.settings = settings
        self.fixed = [problem.with_free(()) for problem in problems]
        self.open = [problem.with_free(free) for problem in problems]
        place = {name: k for k, name in enumerate(free)}
        self.columns = [np.array([place[name] for name in problem.chain.free], dtype=np.intp) for problem in self.open]
        self.starts = list(starts)
        self.prior = np.zeros((0, len(free))) if prior is None else prior
        self.centre = np.zeros(len(free)) if centre is None else centre
        self.state: ReducedState | None = None
        self.best: ReducedState | None = None
        """The point of least cost so far: where SciPy steps from, and motions are predicted from. A point that it
        refused may have motions that folded up, and they would lead into valleys of their own.
        """
        self.evaluations = 0
        self.slow_at = [np.inf] * len(self.open)
        """m^2, the least cost at which Gauss-Newton's steps of a trial's motion promised more than they held."""

    def at(self, p: Array) -> ReducedState:
        """Solve all motions at p, warm-started from the best point so far and dN/dp."""
        for known in (self.state, self.best):
            if known is not None and np.array_equal(known.p, p):
                return known
        self.evaluations += 1
        parameters = self.parameters.with_joint(self.free, p)
        return self._keep(p, tuple(self._solve(k, p, parameters) for k in range(len(self.open))))

    def settle(self, p: Array) -> ReducedState:
        """The same with every motion solved to the end, and nothing kept from other points."""
        state, parameters = self.at(p), self.parameters.with_joint(self.free, p)
        return self._keep(p, tuple(self._settled(k, trial, p, parameters) for k, trial in enumerate(state.trials)))

    def _keep(self, p: Array, trials: tuple[TrialState, ...]) -> ReducedState:
        hessian, gradient = np.zeros((len(p), len(p))), np.zeros(len(p))
        for trial, columns in zip(trials, self.columns, strict=True):
            hessian[np.ix_(columns, columns)] += trial.matrices.hessian
            gradient[columns] += trial.reduced_gradient
        state = ReducedState(p.copy(), trials, sum(t.cost for t in trials), hessian, gradient)
        if self.best is None or self._total(state) <= self._total(self.best):
            self.best = state
        self.state = state
        return state

    def _total(self, state: ReducedState) -> float:
        """m^2, priors included."""
        return state.cost + float(np.sum((self.prior @ (state.p - self.centre)) ** 2))

    def _solve(self, k: int, p: Array, parameters: Parameters) -> TrialState:
        problem, values = self.open[k], p[self.columns[k]]
        constants = problem.constants(parameters)
        near = replace(self.settings, tolerance=max(self.settings.tolerance, NEAR))
        matrices: Matrices | None = None
        if self.best is None:
            damped = self.settings.first_damping > 0.0  # then a small gain may be the damping's
            about = self.settings if damped else replace(near, tolerance=max(near.tolerance, START))
            predicted = track_nodes(self.fixed[k], constants.without_parameters(), self.starts[k], about).nodes
        else:
            last = self.best.trials[k]
            ahead = last.matrices.sensitivity @ (p - self.best.p)[self.columns[k]]
            predicted, matrices = last.nodes - ahead.reshape(last.nodes.shape), last.matrices
        if self._curved(k):
            return self._tracked(k, predicted, values, constants, self.settings)
        nodes, before = predicted, np.inf
        while True:
            if matrices is not None and matrices.serve(values, nodes):
                found = _with_kept(problem, constants, matrices, nodes)
            else:
                found = _linearised(problem, constants, values, nodes)
            if found.gain <= NEAR * found.cost:
                return found.state(converged=True)
            if not found.gain <= SLOW * before:
                return self._tracked(k, predicted, values, constants, near)
            nodes, matrices, before = nodes - found.step, found.matrices, found.gain

    def _settled(self, k: int, trial: TrialState, p: Array, parameters: Parameters) -> TrialState:
        problem, values = self.open[k], p[self.columns[k]]
        constants = problem.constants(parameters)
        found = _linearised(problem, constants, values, trial.nodes)
        if found.gain <= self.settings.tolerance * found.cost:
            return found.state(trial.converged)
        return self._tracked(k, trial.nodes, values, constants, self.settings)

    def _tracked(
        self, k: int, nodes: Array, values: Array, constants: ChainConstants, settings: TrackSettings
    ) -> TrialState:
        settings = replace(settings, first_damping=0.0, curved=self._curved(k))
        tracked = track_nodes(self.fixed[k], constants.without_parameters(), nodes, settings)
        if tracked.curved and not settings.curved:
            self.slow_at[k] = min(self.slow_at[k], tracked.cost)
        return _linearised(self.open[k], constants, values, tracked.nodes).state(tracked.converged)

    def _curved(self, k: int) -> bool:
        """Whether a trial's motion wants Newton's steps: its markers are not much nearer than where it did."""
        return self.best is not None and self.best.trials[k].cost > MUCH_NEARER * self.slow_at[k]

    def residual(self, p: Array) -> Array:
        """Compressed residuals f, followed by the prior's rows; m."""
        state = self.at(p)
        values, vectors = state.spectrum
        projected = np.where(values > 0, vectors.T @ state.gradient / np.sqrt(np.where(values > 0, values, 1.0)), 0.0)
        rest = np.sqrt(max(state.cost - float(projected @ projected), 0.0))
        return np.concatenate([projected, [rest], self.prior @ (p - self.centre)])

    def jacobian(self, p: Array) -> Array:
        """Compressed Jacobian of `residual`."""
        values, vectors = self.at(p).spectrum
        return np.vstack([np.sqrt(values)[:, None] * vectors.T, np.zeros((1, len(p))), self.prior])


@dataclass(frozen=True)
class _Linearised:
    """A trial's equations at some nodes, solved for the nodes."""

    nodes: Array
    matrices: Matrices
    cost: float
    gain: float
    """m^2 by which one step of the nodes lowers the cost."""
    step: Array
    gradient: Array
    """(np_t,) reduced."""

    def state(self, converged: bool) -> TrialState:
        """The trial after that step."""
        cost = max(self.cost - self.gain, 0.0)
        return TrialState(self.nodes - self.step, self.matrices, cost, self.gradient, converged)


def _linearised(problem: TrialProblem, constants: ChainConstants, values: Array, nodes: Array) -> _Linearised:
    equations = problem.equations(nodes, constants)
    factor = BandFactor(equations.band)
    solved = factor.solve(np.column_stack([equations.mixed, equations.node_gradient.ravel()]))
    sensitivity, step = solved[:, :-1], solved[:, -1]
    hessian = equations.parameters - equations.mixed.T @ sensitivity
    return _Linearised(
        nodes,
        Matrices(values, nodes, factor, sensitivity, 0.5 * (hessian + hessian.T)),
        equations.cost,
        float(equations.node_gradient.ravel() @ step),
        step.reshape(nodes.shape),
        equations.parameter_gradient - equations.mixed.T @ step,
    )


def _with_kept(problem: TrialProblem, constants: ChainConstants, kept: Matrices, nodes: Array) -> _Linearised:
    """The same with matrices formed at a point nearby."""
    cost, by_nodes, by_values = problem.both_gradients(nodes, constants)
    right = by_nodes.ravel()
    step = kept.factor.solve(right)
    return _Linearised(
        nodes,
        kept,
        cost,
        float(right @ step),
        step.reshape(nodes.shape),
        by_values - kept.sensitivity.T @ right,
    )
