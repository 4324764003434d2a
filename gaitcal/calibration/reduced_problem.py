"""Variable projection: eliminate the motions of all trials and the soft tissue of each kind of task.

For given joint parameters p and soft tissue z every trial's nodes N(p, z) minimise that trial's marker cost C_t, with
Gauss-Newton matrix H_xx - H_xq H_qq^-1 H_qx and gradient g_x left in x = (p, z) (Golub and Pereyra 1973; Kaufman 1975).
The z of every kind of task, which its trials and prior determine for given p, is eliminated in the same way
(`tissue_elimination.py`): what is left is a small problem in p alone, cost C, gradient g and matrix S, sums over kinds.
Each new p is met with the z that the last matrices predict for it, one Gauss-Newton step of (p, z, N) together: to have
z at its minimum for a p that is far off would take more steps, and may lead into another valley. Where that does not
lower the cost, z is brought to its minimum at p, so that SciPy's shorter steps of p find a lower one.
With S = V diag(s) V^T it is handed to SciPy as the compressed pair

    f = [ s^-1/2 V^T g ; sqrt(C - |s^-1/2 V^T g|^2) ],     J = [ s^1/2 V^T ; 0 ]:

the same cost |f|^2 = C, the same J^T f = g and the same J^T J = S as the full problem of tens of thousands of rows
(where priors make S regular, with eigenvectors in units of the prior). A singular S is no obstacle: its null
directions are parameters that these trials cannot see, and p does not move along them. Priors add their cost, gradient
and matrix to C, g and S first.

Gauss-Newton leaves out how the markers curve, and follows valleys that bend in small steps: a hardly determined
subtalar axis took 60 of them. Near the minimum, where the promise of its steps shrinks by less than a factor of ten
(`descent.STALE`), all matrices above are Newton's. Where those are of a saddle, Gauss-Newton's take their place for the
kind of task. `settle` forms Gauss-Newton's, which errors are found with.

On the way, soft tissue and motion are predicted from the last point by dz/dp and dN/dx and solved no further than the
next step needs (`CORRECTOR`); while unknowns and motion have moved less than `KEPT_WITHIN` since H was formed, H, S and
dN/dx are kept and only the gradient is formed. `settle` ends with all of them formed anew, and with soft tissue and
motions solved as far as tracking alone would solve them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from gaitcal.arrays import Array
from gaitcal.calibration.soft_tissue_artefact import NO_TISSUE, TissuePrior
from gaitcal.calibration.tissue_elimination import EliminatedKind, eliminate_tissue, split_by_kind
from gaitcal.model.chain import LinkageModel
from gaitcal.model.parameters import Parameters
from gaitcal.motion.banded import Elimination, NormalEquations, eliminate
from gaitcal.motion.descent import STALE, DescentSettings, Evaluation, descend
from gaitcal.motion.motion import track_nodes
from gaitcal.motion.trial_problem import MotionProblem
from gaitcal.runtime import with_one_blas_thread

KEPT_WITHIN = 0.005
"""m, rad: a matrix formed nearer than this differs from the present one by less than the curvature it leaves out."""
CORRECTOR = DescentSettings(gain=1e-4, kept_gain=1.0, keep_within=KEPT_WITHIN, persistent=False)
"""A predicted motion is near enough, after one more step, where that step gains less than 1e-4 of the cost; where plain
steps do not get there, it is tracked."""
FIRST_GAIN = 0.1
"""What the first motion's last step may gain by, as a part of its cost, before full equations take over."""
NULL = 1e-12  # Eigenvalues of S below this fraction of the largest count as zero
TISSUE_GAIN = 1e-7
"""Part of the cost of its kind below which a step of soft tissue is the last, as SciPy ends where that of all falls by
no more."""
MOST_TISSUE_STEPS, KEPT_STEPS = 20, 5  # Of soft tissue at given joint parameters; those that correct the next
SHORTER_STEPS = (0.5, 0.1, 0.01, 0.001)  # Parts of a step of soft tissue that are tried where all of it is too far
NEARLY_THERE = 1e-3
"""Part of the cost that the next step promises, below which Newton's matrices may be formed: far
away they lead to saddles, and Gauss-Newton's always downhill."""
COST_FALLEN_TO = 0.5  # A trial whose cost has fallen to this part tries Gauss-Newton's steps again


@dataclass(frozen=True)
class Matrices:
    """A trial's normal equations at one point, the coefficients eliminated; kept for points nearby."""

    values: Array  # (nx_t,) the unknowns of this trial, joint parameters first, where they were formed
    coefficients: Array  # (nn, nq) where they were formed
    eliminated: Elimination
    curved: bool  # Newton's, else Gauss-Newton's

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
    """One trial at the unknowns last visited."""

    values: Array  # (nx_t,) its joint parameters and soft tissue
    coefficients: Array  # (nn, nq)
    matrices: Matrices
    cost: float  # m^2
    reduced_gradient: Array  # (nx_t,) half gradient
    converged: bool

    @property
    def hessian(self) -> Array:
        """(nx_t, nx_t) reduced."""
        return self.matrices.eliminated.hessian

    def predicted(self, values: Array) -> Array:
        """(nn, nq) coefficients at other values of its unknowns (nx_t,)."""
        ahead = self.matrices.eliminated.follow(values - self.values)
        return np.asarray(self.coefficients - ahead.reshape(self.coefficients.shape), float)


@dataclass(frozen=True)
class OpenEvaluation(Evaluation):
    """With the gradient by joint parameters and soft tissue too."""

    by_parameter: Array  # (nx_t,) half gradient


class OpenMotion:
    """A trial's marker cost by its coefficients; what the free joint parameters would change is carried along."""

    nothing_left = 0.0
    has_curvature = False

    def __init__(self, problem: MotionProblem, body: LinkageModel, values: Array, *, curved: bool = False) -> None:
        self.problem, self.body, self.values, self.curved = problem, body, values, curved

    def coefficients(self, x: Array) -> Array:
        """(nn, nq) of a vector of them all."""
        return x.reshape(self.problem.basis.nodes, -1)

    def evaluate(self, x: Array) -> OpenEvaluation:
        """Cost and half gradients."""
        cost, by_nodes, by_parameter = self.problem.both_gradients(self.coefficients(x), self.body)
        return OpenEvaluation(cost, by_nodes.ravel(), by_parameter)

    def linearise(self, x: Array, *, curved: bool) -> OpenMatrix:
        """The equations there."""
        coefficients, curved = self.coefficients(x), curved or self.curved
        equations = self.problem.equations(coefficients, self.body, curved=curved)
        return OpenMatrix(self.values, coefficients, equations, curved=curved)

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
            values=self.values,
            coefficients=self.coefficients(x),
            matrices=matrices,
            cost=max(before.cost - predicted_reduction, 0.0),
            reduced_gradient=matrices.eliminated.reduced(before.gradient, before.by_parameter),
            converged=converged,
        )


class OpenMatrix:
    """Its equations at some coefficients."""

    spent = False

    def __init__(self, values: Array, coefficients: Array, equations: NormalEquations, *, curved: bool) -> None:
        self.values, self.coefficients = values, coefficients
        self.equations, self.curved = equations, curved
        by_node, by_parameter = equations.node_gradient.ravel(), equations.parameter_gradient
        self.evaluation = OpenEvaluation(equations.cost, by_node, by_parameter)

    def factor(self, damping: float) -> Matrices:
        """With the coefficients eliminated."""
        eliminated = eliminate(self.equations, damping)
        return Matrices(self.values, self.coefficients, eliminated, self.curved)


@dataclass(frozen=True)
class KindState:
    """The trials of one kind of task, and its soft tissue eliminated."""

    trials: tuple[MotionState, ...]
    tissue: EliminatedKind


@dataclass(frozen=True, kw_only=True)
class ReducedState:
    """All trials at one p."""

    p: Array
    kinds: tuple[EliminatedKind, ...]
    trials: tuple[MotionState, ...]
    cost: float  # m^2 (as shares have no unit), markers and the prior of soft tissue
    total: float  # m^2, that of the joint parameters besides
    hessian: Array  # (np, np) S of the markers, soft tissue following
    gradient: Array  # (np,) half gradient of the same


class ReducedProblem:
    """The trials' common problem in the joint parameters `free`; remembers the best point as a warm start."""

    def __init__(
        self,
        problems: Sequence[MotionProblem],
        parameters: Parameters,
        free: tuple[str, ...],
        starts: Sequence[Array],
        settings: DescentSettings,
        prior: Array | None = None,
        centre: Array | None = None,
        tissue: TissuePrior = NO_TISSUE,
        kinds: Sequence[str] | None = None,
    ) -> None:
        """Set up the problem.

        Parameters
        ----------
        prior, centre
            (n, np) weights in m per unit of p, and (np,), of the rows prior (p - centre); none unless given.
        tissue
            Prior of the soft tissue and secondary motions of the trials.
        kinds
            Kind of task of each trial; all of the same unless given.
        """
        self.free = free
        self.parameters, self.settings, self.starts = parameters, settings, list(starts)
        self.shares = [1.0] * len(problems)
        """What the cost of each trial counts."""
        self.fixed = [replace(problem.with_free(()), tissue=None) for problem in problems]
        self.open = [problem.with_free(free) for problem in problems]
        self.bodies = [problem.body(parameters) for problem in self.open]
        """Of each trial; a free joint parameter is a joint, so that nothing is built anew when it changes."""
        of_trial = list(kinds or [""] * len(problems))
        self.members = [[t for t, of in enumerate(of_trial) if of == kind] for kind in dict.fromkeys(of_trial)]
        """Of each kind of task, its trials."""
        opened = [[name for t in members for name in self.open[t].unknowns] for members in self.members]
        self.tissue = split_by_kind(tissue, opened)
        self.columns = [np.zeros(0, dtype=np.intp)] * len(problems)
        """Of each trial, places of its unknowns among the joint parameters and the soft tissue of its kind."""
        for members, own in zip(self.members, self.tissue, strict=True):
            for t in members:
                self.columns[t] = self.open[t].places_in((*free, *own.keys))
        self.prior = np.zeros((0, len(free))) if prior is None else prior
        self.centre = np.zeros(len(free)) if centre is None else centre
        self.state: ReducedState | None = None
        self.best: ReducedState | None = None
        """The point of least cost so far: where SciPy steps from, and motions are predicted from. A point that it
        refused may have motions that folded up, and they would lead into valleys of their own.
        """
        self._known: tuple[ReducedState, Array, Array] | None = None
        """The last matrix that was taken apart."""
        self.evaluations = 0
        self.may_curve = False
        """Whether Newton's matrices may be formed where Gauss-Newton's steps shrink slowly."""
        self.curved = False
        """Whether they are."""
        self.slow_at = [np.inf] * len(self.open)
        """m^2, the least cost at which Gauss-Newton's steps of a trial's motion promised more than they held."""

    def at(self, p: Array) -> ReducedState:
        """Solve soft tissue and motions at p, warm-started from the best point so far."""
        for known in (self.state, self.best):
            if known is not None and np.array_equal(known.p, p):
                return known
        self.evaluations += 1
        every = range(len(self.members))
        kinds = _side_by_side(lambda k: self._solved(k, p, *self._predicted(k, p)), every)
        if self.best is not None and self._sum(p, kinds).total > self.best.total:
            # before SciPy takes a shorter step: soft tissue may have gone too far, and not the joint parameters
            solved = kinds
            kinds = _side_by_side(lambda k: self._followed(k, p, self._shorter(k, p, solved[k])), every)
        return self._keep(p, kinds)

    def _predicted(self, k: int, p: Array, share: float = 1.0) -> tuple[Array, Sequence[MotionState] | None]:
        """Soft tissue of one kind at p, a share of its step beyond that of the best point, and the
        motions there.
        """
        if self.best is None:
            return self.tissue[k].mean, None
        last = self.best.kinds[k]
        z = last.z + share * last.step - last.sensitivity @ (p - self.best.p)
        return z, [self.best.trials[t] for t in self.members[k]]

    def _shorter(self, k: int, p: Array, whole: KindState) -> KindState:
        """One kind at p, without its own step where that does not pay: the cost is then as near to
        that of the best point as p is, however far the step went wrong.
        """
        if self.best is None or whole.tissue.cost <= self.best.kinds[k].cost:
            return whole
        without = self._solved(k, p, *self._predicted(k, p, 0.0))
        return whole if whole.tissue.cost <= without.tissue.cost else without

    def settle(self, p: Array) -> ReducedState:
        """The same with soft tissue and motions solved as far as the settings ask, nothing kept from other points."""
        state = self.at(p)

        def settled(k: int) -> KindState:
            members = self.members[k]
            here = self._followed(k, p, KindState(tuple(state.trials[t] for t in members), state.kinds[k]))
            z, trials = here.tissue.z + here.tissue.step, here.trials
            here = self._summed(k, z, self._each(k, lambda i: self._settled(members[i], p, z, trials[i])))
            if here.tissue.reduction > self.settings.gain * here.tissue.cost:
                here = replace(here, trials=tuple(replace(trial, converged=False) for trial in here.trials))
            return here

        return self._keep(p, _side_by_side(settled, range(len(self.members))))

    def linkage(self, p: Array) -> Parameters:
        """All joint parameters at p."""
        return self.parameters.with_joint(self.free, p)

    def moved(self, state: ReducedState) -> list[MotionProblem]:
        """Per trial, the motion alone, with soft tissue and secondary motions where a state has them."""
        return [self._placed(t, trial.values)[0] for t, trial in enumerate(state.trials)]

    def weigh(self, shares: Sequence[float]) -> None:
        """Let the cost of each trial count so much. At given soft tissue no motion moves by that; it moves itself where
        trials count less or more against its prior.
        """
        self.shares, best = list(shares), self.best
        self.state = self.best = None
        self.curved = False
        if best is None:
            return
        kinds = list[KindState]()
        for k, (members, of) in enumerate(zip(self.members, best.kinds, strict=True)):
            trials = [best.trials[t] for t in members]
            if any(trial.matrices.curved for trial in trials):
                kinds.append(self._solved(k, best.p, of.z, trials))
            else:
                kinds.append(self._summed(k, of.z, trials))
        self._keep(best.p, kinds)

    def _followed(self, k: int, p: Array, here: KindState) -> KindState:
        """One kind where its soft tissue has gone to the minimum at p.

        Gauss-Newton steps f leave out the curvature of large residuals, and may overshoot in the few directions that
        markers hardly determine. Steps of earlier points correct them there (Anderson, J ACM 12:547-560, 1965): the
        next point is the combination of these points that has the smallest combined step.
        """
        points, steps = list[Array](), list[Array]()
        for _ in range(MOST_TISSUE_STEPS):
            tissue = here.tissue
            if tissue.reduction <= TISSUE_GAIN * tissue.cost:
                break
            points, steps = [*points, tissue.z][-KEPT_STEPS:], [*steps, tissue.step][-KEPT_STEPS:]
            step = steps[-1]
            if len(steps) > 1:
                changes = np.diff(steps, axis=0).T
                moves = np.diff(points, axis=0).T + changes
                # in units of the matrix here, in which the cost is round
                weight = np.linalg.lstsq(tissue.root.T @ changes, -tissue.forward, rcond=None)[0]
                step = step - moves @ weight
            there = self._solved(k, p, tissue.z + step, here.trials, keep=True)
            if there.tissue.cost > tissue.cost:
                # what was learnt there serves from here: the next step is a shorter one
                points, steps = [there.tissue.z, *points][-KEPT_STEPS:], [there.tissue.step, *steps][-KEPT_STEPS:]
                for share in SHORTER_STEPS:
                    there = self._solved(k, p, tissue.z + share * tissue.step, here.trials, keep=True)
                    if there.tissue.cost <= tissue.cost:
                        break
                else:
                    break
            here = there
        return here

    def _solved(
        self, k: int, p: Array, z: Array, near: Sequence[MotionState] | None, *, keep: bool = False
    ) -> KindState:
        """One kind with its motions solved at p and z, from those of a point `near`, of which matrices may be kept."""
        unknowns = np.append(p, z)

        def solved(i: int, *, curved: bool) -> MotionState:
            t = self.members[k][i]
            close = None if near is None else near[i]
            return self._solve(t, unknowns[self.columns[t]], close, keep=keep, curved=curved)

        if self.curved:
            try:
                return self._summed(k, z, self._each(k, lambda i: solved(i, curved=True)))
            except np.linalg.LinAlgError:
                # Gauss-Newton takes over: its matrix is always positive definite
                pass
        return self._summed(k, z, self._each(k, lambda i: solved(i, curved=False)))

    def _each(self, k: int, function: Callable[[int], MotionState]) -> list[MotionState]:
        """What a function makes of each trial of a kind, two at a time where there is no other kind."""
        every = range(len(self.members[k]))
        return _side_by_side(function, every) if len(self.members) == 1 else [function(i) for i in every]

    def _summed(self, k: int, z: Array, trials: Sequence[MotionState]) -> KindState:
        """Sum the trials of a kind up, and eliminate its soft tissue."""
        size = len(self.free) + len(z)
        hessian, gradient, cost = np.zeros((size, size)), np.zeros(size), 0.0
        for t, trial in zip(self.members[k], trials, strict=True):
            columns, share = self.columns[t], self.shares[t]
            hessian[np.ix_(columns, columns)] += share * trial.hessian
            gradient[columns] += share * trial.reduced_gradient
            cost += share * trial.cost
        return KindState(tuple(trials), eliminate_tissue(self.tissue[k], z, hessian, gradient, cost))

    def _sum(self, p: Array, kinds: Sequence[KindState]) -> ReducedState:
        """Sum the kinds up."""
        trials: dict[int, MotionState] = {}
        for members, kind in zip(self.members, kinds, strict=True):
            trials |= dict(zip(members, kind.trials, strict=True))
        hessian, gradient, cost = np.zeros((len(p), len(p))), np.zeros(len(p)), 0.0
        for kind in kinds:
            hessian += kind.tissue.hessian
            gradient += kind.tissue.gradient
            cost += kind.tissue.cost
        return ReducedState(
            p=p.copy(),
            kinds=tuple(kind.tissue for kind in kinds),
            trials=tuple(trials[t] for t in range(len(trials))),
            cost=cost,
            total=cost + float(np.sum((self.prior @ (p - self.centre)) ** 2)),
            hessian=hessian,
            gradient=gradient,
        )

    def _keep(self, p: Array, kinds: Sequence[KindState]) -> ReducedState:
        """Sum the kinds up, and remember the point if it is the best."""
        state = self._sum(p, kinds)
        if self.best is None or state.total <= self.best.total:
            if self.may_curve and self.best is not None and len(self.prior) == len(p):
                promise, before = self._promise(state), self._promise(self.best)
                slow = promise > STALE * before and promise < NEARLY_THERE * state.total
                self.curved = self.curved or slow
            self.best = state
        self.state = state
        return state

    def _promise(self, state: ReducedState) -> float:
        """By how much the cost is to fall with the next step of joint parameters and soft tissue."""
        gradient = state.gradient + self.prior.T @ (self.prior @ (state.p - self.centre))
        along = self._root(state)[1] @ gradient
        return float(along @ along) + sum(kind.reduction for kind in state.kinds)

    def _placed(self, t: int, values: Array) -> tuple[MotionProblem, MotionProblem]:
        """A trial with its soft tissue and secondary motions at its unknowns (nx_t,): for the motion alone, and with
        all of them open.
        """
        opened = self.open[t]
        if opened.tissue is None:
            return self.fixed[t], opened
        moved = opened.displaced(values[opened.joint_parameters :])
        return self.fixed[t].with_data(moved.data), moved

    def _motion(self, t: int, values: Array, *, curved: bool = False) -> tuple[MotionProblem, OpenMotion]:
        fixed, problem = self._placed(t, values)
        body = self.bodies[t].with_free(self._linkage_of(t, values))
        return fixed, OpenMotion(problem, body, values, curved=curved)

    def _linkage_of(self, t: int, values: Array) -> Parameters:
        """All joint parameters at the unknowns (nx_t,) of a trial."""
        count = self.open[t].joint_parameters
        return self.parameters.with_joint(self.open[t].unknowns[:count], values[:count])

    def _settled(self, t: int, p: Array, z: Array, last: MotionState) -> MotionState:
        """The motion of one trial at p and z, with equations formed there."""
        values = np.append(p, z)[self.columns[t]]
        fixed, motion = self._motion(t, values)
        predicted = last.predicted(values)
        stepped, share = motion.stepped(predicted, converged=last.converged)
        if share > self.settings.gain:
            curved = self._curved(t, last)
            stepped = self._tracked(t, predicted, fixed, motion, self.settings, curved=curved)
        return stepped

    def _solve(self, t: int, values: Array, near: MotionState | None, *, keep: bool, curved: bool) -> MotionState:
        """The motion of one trial, predicted from a point near by and corrected by a few plain steps, or tracked."""
        fixed, motion = self._motion(t, values, curved=curved)
        nearly = replace(self.settings, gain=max(self.settings.gain, CORRECTOR.gain))
        kept: Matrices | None = None
        if near is None:
            damped = self.settings.first_damping > 0.0  # then a small gain may be the damping's
            about = self.settings if damped else replace(nearly, gain=max(nearly.gain, FIRST_GAIN))
            predicted = track_nodes(fixed, fixed.body(self._linkage_of(t, values)), self.starts[t], about).x
        else:
            predicted = near.predicted(values)
            alike = near.matrices.curved == curved
            kept = near.matrices if alike and (keep or near.matrices.near(values, predicted)) else None
        if near is not None and self._curved(t, near):
            return self._tracked(t, predicted, fixed, motion, self.settings, curved=True)
        found = motion.corrected(predicted, kept)
        if found is None and kept is not None:
            found = motion.corrected(predicted, None)
        return found or self._tracked(t, predicted, fixed, motion, nearly)

    def _tracked(
        self,
        t: int,
        coefficients: Array,
        fixed: MotionProblem,
        motion: OpenMotion,
        settings: DescentSettings,
        *,
        curved: bool = False,
    ) -> MotionState:
        """The motion found by tracking, and one step of the open equations from there."""
        settings = replace(settings, first_damping=0.0, curved=curved)
        tracked = track_nodes(fixed, fixed.body(self._linkage_of(t, motion.values)), coefficients, settings)
        if tracked.curved and not settings.curved:
            self.slow_at[t] = min(self.slow_at[t], tracked.cost)
        return motion.stepped(tracked.x, converged=tracked.converged)[0]

    def _curved(self, t: int, near: MotionState) -> bool:
        """Whether a trial's motion wants Newton's steps: its markers are not much nearer than where it did."""
        return near.cost > COST_FALLEN_TO * self.slow_at[t]

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
        """(np, np) R with R^T R = S and the prior, and the inverse of R^T.

        Newton's S may be of a saddle: a direction in which the cost bends down, or less than that of the prior alone,
        has its curvature downwards, or that of the prior.
        """
        if self._known is None or self._known[0] is not state:
            matrix = state.hessian + self.prior.T @ self.prior
            if len(self.prior) == len(matrix):
                # in units of the prior, which curves everywhere at least as much as it does alone
                unit = np.linalg.inv(self.prior)
                values, vectors = np.linalg.eigh(unit.T @ matrix @ unit)
                size = np.sqrt(np.maximum(np.abs(values), 1.0))
                self._known = state, (vectors * size).T @ self.prior, (vectors / size).T @ unit.T
            else:
                values, vectors = np.linalg.eigh(matrix)
                size = np.sqrt(np.where(values > NULL * max(float(values[-1]), 0.0), values, 0.0))
                inverse = np.where(size > 0, 1.0 / np.where(size > 0, size, 1.0), 0.0)
                self._known = state, size[:, None] * vectors.T, inverse[:, None] * vectors.T
        return self._known[1:]


_Made = TypeVar("_Made")


def _side_by_side(function: Callable[[int], _Made], numbers: Sequence[int]) -> list[_Made]:
    """What a function makes of each number, two at a time: products of matrices let the other thread compute."""
    if len(numbers) < 2:
        return [function(number) for number in numbers]
    with ThreadPoolExecutor(2) as pool:
        return list(pool.map(with_one_blas_thread(function), numbers))
