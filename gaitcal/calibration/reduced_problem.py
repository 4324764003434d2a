"""What trials share, alone: the motions of all trials eliminated (variable projection).

Trials share the joint parameters and the columns of soft tissue, together p. For given p every trial's nodes N(p)
minimise that trial's marker cost C_t. What is left is a small problem in p with gradient
g = sum_t g_p and Gauss-Newton matrix S = sum_t (H_pp - H_pq H_qq^-1 H_qp) (Golub and Pereyra 1973; Kaufman 1975). With
S = V diag(s) V^T it is handed to SciPy as the compressed pair

    f = [ s^-1/2 V^T g ; sqrt(C - |s^-1/2 V^T g|^2) ],     J = [ s^1/2 V^T ; 0 ]:

the same cost |f|^2 = C, the same J^T f = g and the same J^T J = S as the full problem of tens of thousands of rows
(where priors make S regular, with its Cholesky factor in place of V s^1/2). A singular S is no obstacle: its null
directions are parameters that these trials cannot see, and p does not move along them. Priors add their cost, gradient
and matrix to C, g and S first.

On the way, a motion is predicted from the last point by dN/dp and solved no further than the next step needs
(`CORRECTOR`); while parameters and motion have moved less than `KEPT_WITHIN` since H was formed, H, S and dN/dp are
kept and only the gradient is formed. `settle` ends with all of them formed anew, and with motions solved as far as
tracking alone would solve them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_triangular

from gaitcal.arrays import Array
from gaitcal.model.chain import LinkageModel
from gaitcal.model.parameters import Parameters
from gaitcal.motion.banded import Elimination, NormalEquations, eliminate
from gaitcal.motion.descent import DescentSettings, Evaluation, descend
from gaitcal.motion.motion import track_nodes
from gaitcal.motion.trial_problem import MotionProblem

KEPT_WITHIN = 0.005
"""m, rad: a matrix formed nearer than this differs from the present one by less than the curvature it leaves out."""
CORRECTOR = DescentSettings(gain=1e-4, kept_gain=1.0, keep_within=KEPT_WITHIN, persistent=False)
"""A predicted motion is near enough, after one more step, where that step gains less than 1e-4 of the cost; where plain
steps do not get there, it is tracked."""
FIRST_GAIN = 0.1
"""What the first motion's last step may gain by, as a part of its cost, before full equations take over."""
NULL = 1e-12  # Eigenvalues of S below this fraction of the largest count as zero
COST_FALLEN_TO = 0.5  # A trial whose cost has fallen to this part tries Gauss-Newton's steps again


@dataclass(frozen=True)
class Matrices:
    """A trial's normal equations at one point, the coefficients eliminated; kept for points nearby."""

    values: Array  # (np_t,) the free parameters of this trial's chain where they were formed
    coefficients: Array  # (nn, nq) where they were formed
    eliminated: Elimination

    def near(self, values: Array, coefficients: Array) -> bool:
        """Whether another point is near enough."""
        apart = max(
            np.abs(values - self.values).max(initial=0.0), np.abs(coefficients - self.coefficients).max(initial=0.0)
        )
        return bool(apart < KEPT_WITHIN)

    def solve(self, gradient: Array) -> Array:
        """H_qq^-1 times a gradient by the coefficients, one after the other."""
        return self.eliminated.factor.solve(gradient)


@dataclass(frozen=True, kw_only=True)
class MotionState:
    """One trial at the joint parameters last visited."""

    coefficients: Array  # (nn, nq)
    matrices: Matrices
    cost: float  # m^2
    reduced_gradient: Array  # (np_t,) half gradient
    converged: bool

    @property
    def hessian(self) -> Array:
        """(np_t, np_t) reduced."""
        return self.matrices.eliminated.hessian


@dataclass(frozen=True)
class OpenEvaluation(Evaluation):
    """With the gradient by the joint parameters too."""

    by_parameter: Array  # (np_t,) half gradient


class OpenMotion:
    """A trial's marker cost by its coefficients; what the free joint parameters would change is carried along."""

    nothing_left = 0.0
    has_curvature = False

    def __init__(self, problem: MotionProblem, body: LinkageModel, values: Array) -> None:
        self.problem, self.body, self.values = problem, body, values

    def coefficients(self, x: Array) -> Array:
        """(nn, nq) of a vector of them all."""
        return x.reshape(self.problem.basis.nodes, -1)

    def evaluate(self, x: Array) -> OpenEvaluation:
        """Cost and half gradients."""
        cost, by_nodes, by_parameter = self.problem.both_gradients(self.coefficients(x), self.body)
        return OpenEvaluation(cost, by_nodes.ravel(), by_parameter)

    def linearise(self, x: Array, *, curved: bool) -> OpenMatrix:
        """The equations there."""
        coefficients = self.coefficients(x)
        return OpenMatrix(self.values, coefficients, self.problem.equations(coefficients, self.body, curved=curved))

    def corrected(self, coefficients: Array, kept: Matrices | None) -> MotionState | None:
        """The trial where plain steps from `coefficients` (nn, nq) converge; None where they do not."""
        end = descend(self, coefficients.ravel(), CORRECTOR, kept)
        if not end.converged:
            return None
        matrices = end.factor or self.linearise(end.x, curved=False).factor(0.0)
        return self._state(end.x, end.evaluation, matrices, end.predicted_reduction, converged=True)

    def stepped(self, coefficients: Array, *, converged: bool) -> tuple[MotionState, float]:
        """The trial one plain step from `coefficients` (nn, nq), and the share of the cost that it should gain."""
        matrix = self.linearise(coefficients.ravel(), curved=False)
        here, matrices = matrix.evaluation, matrix.factor(0.0)
        step = -matrices.solve(here.gradient)
        predicted_reduction = -float(here.gradient @ step)
        state = self._state(coefficients.ravel() + step, here, matrices, predicted_reduction, converged=converged)
        return state, predicted_reduction / here.cost if here.cost > 0.0 else 0.0

    def _state(
        self, x: Array, before: OpenEvaluation, matrices: Matrices, predicted_reduction: float, *, converged: bool
    ) -> MotionState:
        """At coefficients x, reached from `before` by a last step predicted to gain `predicted_reduction`."""
        return MotionState(
            coefficients=self.coefficients(x),
            matrices=matrices,
            cost=max(before.cost - predicted_reduction, 0.0),
            reduced_gradient=matrices.eliminated.reduced(before.gradient, before.by_parameter),
            converged=converged,
        )


class OpenMatrix:
    """Its equations at some coefficients."""

    spent = False

    def __init__(self, values: Array, coefficients: Array, equations: NormalEquations) -> None:
        self.values, self.coefficients, self.equations = values, coefficients, equations
        by_node, by_parameter = equations.node_gradient.ravel(), equations.parameter_gradient
        self.evaluation = OpenEvaluation(equations.cost, by_node, by_parameter)

    def factor(self, damping: float) -> Matrices:
        """With the coefficients eliminated."""
        return Matrices(self.values, self.coefficients, eliminate(self.equations, damping))


@dataclass(frozen=True, kw_only=True)
class ReducedState:
    """All trials at one p."""

    p: Array
    trials: tuple[MotionState, ...]
    cost: float  # m^2 (as shares have no unit), markers only
    hessian: Array  # (np, np) S of the markers
    gradient: Array  # (np,) half gradient of the markers


class ReducedProblem:
    """The trials' common problem in the joint parameters `free` and the soft tissue's columns `tissue`; remembers the
    best point as a warm start.
    """

    def __init__(
        self,
        problems: Sequence[MotionProblem],
        parameters: Parameters,
        free: tuple[str, ...],
        starts: Sequence[Array],
        settings: DescentSettings,
        prior: Array | None = None,
        centre: Array | None = None,
        tissue: tuple[str, ...] = (),
    ) -> None:
        """`prior`: (n, np) weights in m per unit of p of the rows prior (p - centre); none unless given."""
        self.free, shared = free, (*free, *tissue)
        self.parameters, self.settings, self.starts = parameters, settings, list(starts)
        self.shares = [1.0] * len(problems)
        """What the cost of each trial counts."""
        self.fixed = [replace(problem.with_free(()), tissue=None) for problem in problems]
        self.open = [problem.with_free(free) for problem in problems]
        self.bodies = [problem.body(parameters) for problem in self.open]
        """Of each trial; a free joint parameter is a joint, so that nothing is built anew when it changes."""
        self.columns = [problem.places_in(shared) for problem in self.open]
        self.prior = np.zeros((0, len(shared))) if prior is None else prior
        self.centre = np.zeros(len(shared)) if centre is None else centre
        self.state: ReducedState | None = None
        self.best: ReducedState | None = None
        """The point of least cost so far: where SciPy steps from, and motions are predicted from. A point that it
        refused may have motions that folded up, and they would lead into valleys of their own.
        """
        self._known: tuple[ReducedState, Array, Array] | None = None
        """The last matrix that was taken apart."""
        self.evaluations = 0
        self.slow_at = [np.inf] * len(self.open)
        """m^2, the least cost at which Gauss-Newton's steps of a trial's motion promised more than they held."""

    def at(self, p: Array) -> ReducedState:
        """Solve all motions at p, warm-started from the best point so far and dN/dp."""
        for known in (self.state, self.best):
            if known is not None and np.array_equal(known.p, p):
                return known
        self.evaluations += 1
        parameters = self.linkage(p)
        return self._keep(p, tuple(self._solve(k, p, parameters) for k in range(len(self.open))))

    def settle(self, p: Array) -> ReducedState:
        """The same with every motion solved as far as the settings ask, and nothing kept from other points."""
        state, parameters = self.at(p), self.linkage(p)
        trials = list[MotionState]()
        for k, trial in enumerate(state.trials):
            fixed, motion = self._motion(k, p, parameters)
            stepped, share = motion.stepped(trial.coefficients, converged=trial.converged)
            if share > self.settings.gain:
                stepped = self._tracked(k, trial.coefficients, fixed, motion, parameters, self.settings)
            trials.append(stepped)
        return self._keep(p, tuple(trials))

    def linkage(self, p: Array) -> Parameters:
        """All joint parameters at p."""
        return self.parameters.with_joint(self.free, p[: len(self.free)])

    def moved(self, p: Array) -> list[MotionProblem]:
        """Per trial, the motion alone, with soft tissue and secondary motions where p has them."""
        return [self._placed(k, p)[0] for k in range(len(self.open))]

    def weigh(self, shares: Sequence[float]) -> None:
        """Let the cost of each trial count so much. No motion moves by that: the best point is summed up anew."""
        self.shares, best = list(shares), self.best
        self.state = self.best = None
        if best is not None:
            self._keep(best.p, best.trials)

    def _keep(self, p: Array, trials: tuple[MotionState, ...]) -> ReducedState:
        """Sum the trials up, and remember the point if it is the best."""
        hessian, gradient, cost = np.zeros((len(p), len(p))), np.zeros(len(p)), 0.0
        for trial, columns, share in zip(trials, self.columns, self.shares, strict=True):
            hessian[np.ix_(columns, columns)] += share * trial.hessian
            gradient[columns] += share * trial.reduced_gradient
            cost += share * trial.cost
        state = ReducedState(p=p.copy(), trials=trials, cost=cost, hessian=hessian, gradient=gradient)
        if self.best is None or self._total(state) <= self._total(self.best):
            self.best = state
        self.state = state
        return state

    def _total(self, state: ReducedState) -> float:
        """m^2, priors included."""
        return state.cost + float(np.sum((self.prior @ (state.p - self.centre)) ** 2))

    def _placed(self, k: int, p: Array) -> tuple[MotionProblem, MotionProblem]:
        """A trial with its soft tissue and secondary motions where p has them: for the motion alone, and with all of p
        open.
        """
        opened, values = self.open[k], p[self.columns[k]]
        if opened.tissue is None:
            return self.fixed[k], opened
        moved = opened.displaced(values[opened.joint_parameters :])
        return self.fixed[k].with_data(moved.data), moved

    def _motion(self, k: int, p: Array, parameters: Parameters) -> tuple[MotionProblem, OpenMotion]:
        fixed, problem = self._placed(k, p)
        return fixed, OpenMotion(problem, self.bodies[k].with_free(parameters), p[self.columns[k]])

    def _solve(self, k: int, p: Array, parameters: Parameters) -> MotionState:
        """The motion of one trial at p, predicted and then corrected by a few plain steps, or else tracked."""
        fixed, motion = self._motion(k, p, parameters)
        near = replace(self.settings, gain=max(self.settings.gain, CORRECTOR.gain))
        kept: Matrices | None = None
        if self.best is None:
            damped = self.settings.first_damping > 0.0  # then a small gain may be the damping's
            about = self.settings if damped else replace(near, gain=max(near.gain, FIRST_GAIN))
            predicted = track_nodes(fixed, fixed.body(parameters), self.starts[k], about).x
        else:
            last = self.best.trials[k]
            ahead = last.matrices.eliminated.follow((p - self.best.p)[self.columns[k]])
            predicted = last.coefficients - ahead.reshape(last.coefficients.shape)
            kept = last.matrices if last.matrices.near(motion.values, predicted) else None
        if self._curved(k):
            return self._tracked(k, predicted, fixed, motion, parameters, self.settings)
        return motion.corrected(predicted, kept) or self._tracked(k, predicted, fixed, motion, parameters, near)

    def _tracked(
        self,
        k: int,
        coefficients: Array,
        fixed: MotionProblem,
        motion: OpenMotion,
        parameters: Parameters,
        settings: DescentSettings,
    ) -> MotionState:
        """The motion found by tracking, and one step of the open equations from there."""
        settings = replace(settings, first_damping=0.0, curved=self._curved(k))
        tracked = track_nodes(fixed, fixed.body(parameters), coefficients, settings)
        if tracked.curved and not settings.curved:
            self.slow_at[k] = min(self.slow_at[k], tracked.cost)
        return motion.stepped(tracked.x, converged=tracked.converged)[0]

    def _curved(self, k: int) -> bool:
        """Whether a trial's motion wants Newton's steps: its markers are not much nearer than where it did."""
        return self.best is not None and self.best.trials[k].cost > COST_FALLEN_TO * self.slow_at[k]

    def residual(self, p: Array) -> Array:
        """(np + 1,) compressed residuals f, m."""
        state, pull = self.at(p), self.prior @ (p - self.centre)
        _, divided = self._root(state)
        projected = divided @ (state.gradient + self.prior.T @ pull)
        rest = state.cost + float(pull @ pull) - float(projected @ projected)
        return np.append(projected, np.sqrt(max(rest, 0.0)))

    def jacobian(self, p: Array) -> Array:
        """(np + 1, np) compressed Jacobian of `residual`."""
        return np.vstack([self._root(self.at(p))[0], np.zeros((1, len(p)))])

    def _root(self, state: ReducedState) -> tuple[Array, Array]:
        """(np, np) R with R^T R = S and the prior, and the inverse of R^T: by Cholesky where a prior holds every
        direction, in a tenth of the time of the eigenvectors that tell which directions count as zero elsewhere.
        """
        if self._known is None or self._known[0] is not state:
            matrix = state.hessian + self.prior.T @ self.prior
            if len(self.prior) == len(matrix):
                root = np.linalg.cholesky(matrix)
                inverse = solve_triangular(root, np.eye(len(root)), lower=True, check_finite=False)
                self._known = state, np.ascontiguousarray(root.T), np.asarray(inverse, float)
            else:
                values, vectors = np.linalg.eigh(matrix)
                size = np.sqrt(np.where(values > NULL * max(float(values[-1]), 0.0), values, 0.0))
                inverse = np.where(size > 0, 1.0 / np.where(size > 0, size, 1.0), 0.0)
                self._known = state, size[:, None] * vectors.T, inverse[:, None] * vectors.T
        return self._known[1:]
