"""Variable projection: eliminate trial motions and soft tissue, leave the joint parameters.

For given joint parameters p and soft tissue z, every trial's control points N(p, z) minimise its
marker cost C_t. The Gauss-Newton matrix H_xx - H_xq H_qq^-1 H_qx and the gradient g_x remain in x =
(p, z) (Golub and Pereyra 1973; Kaufman 1975). The z of every kind of task is eliminated in the same
way (`tissue_elimination.py`). A small problem in p remains, with cost C, gradient g and matrix S,
sums over kinds. Each new p starts with the z that the last matrices predict: one Gauss-Newton step
of (p, z, N) together. Minimising z for a distant p would take more steps, and may lead to another
local minimum. If the cost does not fall, z is minimised at p to a tenth of what the step of p
promised, so that SciPy's shorter steps of p find a lower one. With S = V diag(s) V^T SciPy gets the
compressed pair

    f = [ s^-1/2 V^T g ; sqrt(C - |s^-1/2 V^T g|^2) ],     J = [ s^1/2 V^T ; 0 ]:

the same cost |f|^2 = C, the same J^T f = g and the same J^T J = S as the full problem of tens of
thousands of rows. (If priors make S regular, eigenvectors in units of the prior replace V.) S may
be singular: its null directions are unobservable in these trials, and p does not change along
them. Priors add their cost, gradient and matrix to C, g and S first.

Gauss-Newton leaves out the curvature of the marker paths, and follows a bent valley of the cost in
small steps (60 for a subtalar axis that is hardly determined). Near the minimum, once the predicted
gain falls by less than a factor of ten from step to step (`descent.STALE_RATIO`), all matrices
above are Newton's. Where Newton's matrix is that of a saddle point, Gauss-Newton's replaces it for
the kind of task. `settle` forms Gauss-Newton's, from which the errors are computed.

On the way, soft tissue and motion are predicted from the last point by dz/dp and dN/dx and solved
no further than the next step needs (`CORRECTOR`); while unknowns and motion have moved less than
`KEPT_WITHIN` since H was formed, H, S and dN/dx are kept and only the gradient is formed. `settle`
ends with all of them formed anew, and with soft tissue and motions solved as far as tracking alone
would solve them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from gaitcal.arrays import Array
from gaitcal.calibration.soft_tissue_artefact import NO_TISSUE, TissuePrior
from gaitcal.calibration.tissue_elimination import EliminatedKind, eliminate_tissue, split_by_kind
from gaitcal.model.chain import LinkageModel
from gaitcal.model.parameters import Parameters
from gaitcal.runtime import map_in_pairs
from gaitcal.tracking.banded import BandFactor, Elimination, NormalEquations, eliminate
from gaitcal.tracking.descent import STALE_RATIO, DescentSettings, Evaluation, descend
from gaitcal.tracking.motion import track_coefficients
from gaitcal.tracking.trial_problem import MotionProblem

KEPT_WITHIN = 0.005
"""m, rad: a matrix formed nearer than this differs from the present one by less than the curvature
it leaves out.
"""
CORRECTOR = DescentSettings(gain=1e-4, kept_gain=1.0, keep_within=KEPT_WITHIN, persistent=False)
"""A predicted motion is near enough, after one more step, where that step gains less than 1e-4 of
the cost; where plain steps do not get there, it is tracked."""
FIRST_GAIN = 0.1
"""What the first motion's last step may gain by, as a part of its cost, before full equations take
over.
"""
# Share of the largest eigenvalue of S below which an eigenvalue counts as zero
NULL = 1e-12
TISSUE_GAIN = 1e-7
"""Part of the cost of its kind below which a step of soft tissue is the last, as SciPy ends where
that of all falls by no more."""
TISSUE_SHARE = 0.1
"""Part of the reduction that a step of joint parameters promises which soft tissue may leave at its
end: the ratio of the real to the promised reduction decides on the next step, and is then known to
a tenth.
"""
# Largest number of steps of soft tissue at given joint parameters, and earlier steps that are used
MOST_TISSUE_STEPS, KEPT_STEPS = 20, 5
# Shares of a step of soft tissue that are tried in turn if the cost grows with the whole step
SHORTER_STEPS = (0.5, 0.1, 0.01, 0.001)
NEARLY_THERE = 1e-3
"""Predicted gain, as a share of the cost, below which Newton's matrices may be formed. Farther away
they lead to saddle points, whereas Gauss-Newton's always lead downhill.
"""
# Share of the cost of the last Newton step below which Gauss-Newton steps are tried again
COST_FALLEN_TO = 0.5


@dataclass(frozen=True)
class Matrices:
    """Normal equations of a trial at one point, coefficients eliminated; reused near it."""

    # (nx_t,) the unknowns of this trial, joint parameters first, where they were formed
    values: Array
    coefficients: Array  # (nn, nq) where they were formed
    eliminated: Elimination
    curved: bool  # Newton's, else Gauss-Newton's

    def is_near(self, values: Array, coefficients: Array) -> bool:
        """Return whether another point is near enough to reuse the matrices."""
        distance = max(
            np.abs(values - self.values).max(initial=0.0),
            np.abs(coefficients - self.coefficients).max(initial=0.0),
        )
        return bool(distance < KEPT_WITHIN)

    def solve(self, gradient: Array) -> Array:
        """Solve H_qq x = gradient for a gradient by the coefficients (nn * nq,)."""
        return self.eliminated.factor.solve(gradient)

    def eliminate(self) -> Matrices:
        """Return the same matrices, as the coefficients are eliminated."""
        return self


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

    def predict_coefficients(self, values: Array) -> Array:
        """Predict the coefficients (nn, nq) at other values of its unknowns (nx_t,)."""
        ahead = self.matrices.eliminated.follow(values - self.values)
        return np.asarray(self.coefficients - ahead.reshape(self.coefficients.shape), float)


@dataclass(frozen=True)
class OpenEvaluation(Evaluation):
    """Evaluation with the gradient by joint parameters and soft tissue too."""

    # () -> (nx_t,) half gradient
    compute_parameter_gradient: Callable[[], Array]


class OpenMotion:
    """Marker cost of a trial by its coefficients, with derivatives by the free unknowns."""

    nothing_left = 0.0
    has_curvature = False

    def __init__(
        self, problem: MotionProblem, body: LinkageModel, values: Array, *, curved: bool = False
    ) -> None:
        self.problem, self.body, self.values, self.curved = problem, body, values, curved

    def coefficients(self, x: Array) -> Array:
        """Reshape a vector to coefficients (nn, nq)."""
        return x.reshape(self.problem.basis.control_points, -1)

    def evaluate(self, x: Array) -> OpenEvaluation:
        """Evaluate cost and half gradients."""
        cost, by_nodes, by_parameter = self.problem.compute_gradients(
            self.coefficients(x), self.body
        )
        return OpenEvaluation(cost, by_nodes.ravel(), lambda: by_parameter)

    def linearise(self, x: Array, *, curved: bool) -> OpenMatrix:
        """Form the equations at x."""
        return OpenMatrix(self, self.coefficients(x), curved=curved or self.curved)

    def correct(self, coefficients: Array, kept: Matrices | None) -> MotionState | None:
        """Correct the motion by plain steps from `coefficients` (nn, nq); None if not converged."""
        end = descend(self, coefficients.ravel(), CORRECTOR, kept)
        if not end.converged:
            return None
        factor = end.factor or self.linearise(end.x, curved=False).factor(0.0)
        return self._state(end.x, end.evaluation, factor, end.predicted_reduction, converged=True)

    def take_step(self, coefficients: Array, *, converged: bool) -> tuple[MotionState, float]:
        """Take one plain step from `coefficients` (nn, nq).

        Returns
        -------
        tuple of MotionState and float
            The trial there, and the predicted gain as a share of the cost.
        """
        matrix = self.linearise(coefficients.ravel(), curved=False)
        here, factor = matrix.evaluation, matrix.factor(0.0)
        step = -factor.solve(here.gradient)
        predicted_reduction = -float(here.gradient @ step)
        state = self._state(
            coefficients.ravel() + step, here, factor, predicted_reduction, converged=converged
        )
        return state, predicted_reduction / here.cost if here.cost > 0.0 else 0.0

    def _state(
        self,
        x: Array,
        before: OpenEvaluation,
        factor: OpenFactor | Matrices,
        predicted_reduction: float,
        *,
        converged: bool,
    ) -> MotionState:
        """Make the state at coefficients x after a last step with a predicted gain."""
        by_parameter, matrices = before.compute_parameter_gradient(), factor.eliminate()
        return MotionState(
            values=self.values,
            coefficients=self.coefficients(x),
            matrices=matrices,
            cost=max(before.cost - predicted_reduction, 0.0),
            reduced_gradient=matrices.eliminated.reduce_gradient(before.gradient, by_parameter),
            converged=converged,
        )


class OpenMatrix:
    """Equations of an `OpenMotion` at some coefficients.

    Steps of the motion take the band alone. Columns of soft tissue cost several times as much, and
    are added where the last step begins.
    """

    spent = False

    def __init__(self, motion: OpenMotion, coefficients: Array, *, curved: bool) -> None:
        self.motion, self.coefficients, self.curved = motion, coefficients, curved
        self.band = motion.problem.assemble_motion_equations(
            coefficients, motion.body, curved=curved
        )

    @property
    def evaluation(self) -> OpenEvaluation:
        """Cost and gradients at these coefficients."""
        return OpenEvaluation(
            self.band.cost,
            self.band.node_gradient.ravel(),
            lambda: self.equations.parameter_gradient,
        )

    @cached_property
    def equations(self) -> NormalEquations:
        """With soft tissue."""
        return self.motion.problem.add_tissue(
            self.band, self.coefficients, self.motion.body, curved=self.curved
        )

    def factor(self, damping: float) -> OpenFactor:
        """Factorise the band."""
        return OpenFactor(self, BandFactor(self.band.band, damping))


@dataclass(frozen=True)
class OpenFactor:
    """Factor of the band of an `OpenMatrix`."""

    matrix: OpenMatrix
    factor: BandFactor

    def solve(self, gradient: Array) -> Array:
        """Solve H_qq x = gradient for a gradient by the coefficients (nn * nq,)."""
        return self.factor.solve(gradient)

    def eliminate(self) -> Matrices:
        """Eliminate the coefficients; overwrites the equations of the matrix."""
        matrix = self.matrix
        eliminated = eliminate(matrix.equations, factor=self.factor)
        return Matrices(matrix.motion.values, matrix.coefficients, eliminated, matrix.curved)


@dataclass(frozen=True)
class KindState:
    """Trials of one kind of task, with its soft tissue eliminated."""

    trials: tuple[MotionState, ...]
    tissue: EliminatedKind


@dataclass(frozen=True, kw_only=True)
class ReducedState:
    """All trials at one p."""

    p: Array
    kinds: tuple[EliminatedKind, ...]
    trials: tuple[MotionState, ...]
    # m^2 (as shares have no unit), markers and the prior of soft tissue
    cost: float
    total: float  # m^2, that of the joint parameters besides
    hessian: Array  # (np, np) S of the markers, soft tissue following
    gradient: Array  # (np,) half gradient of the same


class ReducedProblem:
    """Common problem of all trials in the joint parameters `free`, warm-started from its best
    point.
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
        tissue: TissuePrior = NO_TISSUE,
        kinds: Sequence[str] | None = None,
    ) -> None:
        """Set up the problem.

        Parameters
        ----------
        prior, centre
            (n, np) weights in m per unit of p, and (np,), of the rows prior (p - centre); none
            unless given.
        tissue
            Prior of the soft tissue and secondary motions of the trials.
        kinds
            Kind of task of each trial; all of the same unless given.
        """
        self.free = free
        self.parameters, self.settings, self.starts = parameters, settings, list(starts)
        self.shares = [1.0] * len(problems)
        """Weight of each trial's cost."""
        self.fixed = [replace(problem.with_free(()), tissue=None) for problem in problems]
        self.open = [problem.with_free(free) for problem in problems]
        self.bodies = [problem.build_body(parameters) for problem in self.open]
        """Of each trial; a free joint parameter is a joint, so that nothing is built anew when it
        changes.
        """
        of_trial = list(kinds or [""] * len(problems))
        self.members = [
            [t for t, task in enumerate(of_trial) if task == kind]
            for kind in dict.fromkeys(of_trial)
        ]
        """Of each kind of task, its trials."""
        opened = [
            [name for t in members for name in self.open[t].unknowns] for members in self.members
        ]
        self.tissue = split_by_kind(tissue, opened)
        self.columns = [np.zeros(0, dtype=np.intp)] * len(problems)
        """Of each trial, places of its unknowns among the joint parameters and the soft tissue of
        its kind.
        """
        for members, kind_prior in zip(self.members, self.tissue, strict=True):
            for t in members:
                self.columns[t] = self.open[t].locate_in((*free, *kind_prior.keys))
        self.prior = np.zeros((0, len(free))) if prior is None else prior
        self.centre = np.zeros(len(free)) if centre is None else centre
        self.state: ReducedState | None = None
        self.best: ReducedState | None = None
        """The point of least cost so far, from which SciPy steps and motions are predicted.

        Motions of a rejected point may be in another local minimum.
        """
        self._known: tuple[ReducedState, Array, Array] | None = None
        """The last matrix that was taken apart."""
        self.evaluations = 0
        self.may_curve = False
        """Whether Newton's matrices may be formed where Gauss-Newton's steps shrink slowly."""
        self.curved = False
        """Whether they are."""
        self.slow_at = [np.inf] * len(self.open)
        """m^2, the least cost at which Gauss-Newton's steps of a trial's motion promised more than
        they held.
        """

    def at(self, p: Array) -> ReducedState:
        """Solve soft tissue and motions at p, warm-started from the best point so far.

        Parameters
        ----------
        p : (np,) array
            Joint parameters, m and rad.

        Returns
        -------
        ReducedState
            Solved as far as the next step of p needs.
        """
        for known in (self.state, self.best):
            if known is not None and np.array_equal(known.p, p):
                return known
        self.evaluations += 1
        every = range(len(self.members))
        kinds = map_in_pairs(lambda k: self._solve_kind(k, p, *self._predict_tissue(k, p)), every)
        if self.best is not None and self._sum_kinds(p, kinds).total > self.best.total:
            # before SciPy takes a shorter step: soft tissue may have gone too far, and not the
            # joint parameters
            solved, left = kinds, TISSUE_SHARE * self._promise_reduction(p) / len(kinds)
            kinds = map_in_pairs(
                lambda k: self._minimise_tissue(k, p, self._drop_bad_step(k, p, solved[k]), left),
                every,
            )
        return self._keep(p, kinds)

    def _predict_tissue(
        self, k: int, p: Array, share: float = 1.0
    ) -> tuple[Array, Sequence[MotionState] | None]:
        """Predict the soft tissue of one kind at p from the best point; also its motions there.

        `share` is the part of the step of soft tissue that is taken from the best point.
        """
        if self.best is None:
            return self.tissue[k].mean, None
        last = self.best.kinds[k]
        z = last.z + share * last.step - last.sensitivity @ (p - self.best.p)
        return z, [self.best.trials[t] for t in self.members[k]]

    def _drop_bad_step(self, k: int, p: Array, whole: KindState) -> KindState:
        """Solve one kind at p without the step of its soft tissue if that gives a lower cost.

        The cost is then as near to that of the best point as p is, however wrong the step was.
        """
        if self.best is None or whole.tissue.cost <= self.best.kinds[k].cost:
            return whole
        without = self._solve_kind(k, p, *self._predict_tissue(k, p, 0.0))
        return whole if whole.tissue.cost <= without.tissue.cost else without

    def settle(self, p: Array) -> ReducedState:
        """Solve soft tissue and motions at p to the final tolerance, all matrices formed there.

        Parameters
        ----------
        p : (np,) array
            Joint parameters, m and rad.

        Returns
        -------
        ReducedState
            The end of a fit.
        """
        state = self.at(p)

        def settled(k: int) -> KindState:
            members = self.members[k]
            here = self._minimise_tissue(
                k, p, KindState(tuple(state.trials[t] for t in members), state.kinds[k])
            )
            z, trials = here.tissue.z + here.tissue.step, here.trials
            here = self._eliminate_kind(
                k,
                z,
                self._map_trials(k, lambda i: self._settle_motion(members[i], p, z, trials[i])),
            )
            if here.tissue.reduction > self.settings.gain * here.tissue.cost:
                here = replace(
                    here, trials=tuple(replace(trial, converged=False) for trial in here.trials)
                )
            return here

        return self._keep(p, map_in_pairs(settled, range(len(self.members))))

    def get_parameters(self, p: Array) -> Parameters:
        """Get all parameters of the linkage at p."""
        return self.parameters.with_joint(self.free, p)

    def place_tissue(self, state: ReducedState) -> list[MotionProblem]:
        """Place soft tissue and secondary motions of a state in each trial's motion problem."""
        return [self._place_trial(t, trial.values)[0] for t, trial in enumerate(state.trials)]

    def weigh(self, shares: Sequence[float]) -> None:
        """Set the weight of each trial's cost.

        At given soft tissue no motion depends on it. The soft tissue does, relative to its prior.
        """
        self.shares, best = list(shares), self.best
        self.state = self.best = None
        self.curved = False
        if best is None:
            return
        kinds = list[KindState]()
        for k, (members, tissue) in enumerate(zip(self.members, best.kinds, strict=True)):
            trials = [best.trials[t] for t in members]
            if any(trial.matrices.curved for trial in trials):
                kinds.append(self._solve_kind(k, best.p, tissue.z, trials))
            else:
                kinds.append(self._eliminate_kind(k, tissue.z, trials))
        self._keep(best.p, kinds)

    def _minimise_tissue(self, k: int, p: Array, here: KindState, left: float = 0.0) -> KindState:
        """Minimise the cost of one kind at p over its soft tissue.

        It ends where the next step promises to lower the cost (m^2) by no more than `left`.

        Gauss-Newton steps f leave out the curvature of large residuals. They may overshoot in the
        few directions that markers hardly determine. Steps of earlier points correct them there
        (Anderson, J ACM 12:547-560, 1965): the next point is the combination of these points with
        the smallest combined step.
        """
        points, steps = list[Array](), list[Array]()
        for _ in range(MOST_TISSUE_STEPS):
            tissue = here.tissue
            if tissue.reduction <= max(TISSUE_GAIN * tissue.cost, left):
                break
            points, steps = [*points, tissue.z][-KEPT_STEPS:], [*steps, tissue.step][-KEPT_STEPS:]
            step = steps[-1]
            if len(steps) > 1:
                changes = np.diff(steps, axis=0).T
                moves = np.diff(points, axis=0).T + changes
                # in units of the matrix here, in which the cost is round
                weight = np.linalg.lstsq(tissue.root.T @ changes, -tissue.forward, rcond=None)[0]
                step = step - moves @ weight
            there = self._solve_kind(k, p, tissue.z + step, here.trials, keep=True)
            if there.tissue.cost > tissue.cost:
                # The rejected point is kept: with it the next step is shorter.
                points, steps = (
                    [there.tissue.z, *points][-KEPT_STEPS:],
                    [there.tissue.step, *steps][-KEPT_STEPS:],
                )
                for share in SHORTER_STEPS:
                    there = self._solve_kind(
                        k, p, tissue.z + share * tissue.step, here.trials, keep=True
                    )
                    if there.tissue.cost <= tissue.cost:
                        break
                else:
                    break
            here = there
        return here

    def _solve_kind(
        self, k: int, p: Array, z: Array, near: Sequence[MotionState] | None, *, keep: bool = False
    ) -> KindState:
        """Solve the motions of one kind at p and z, from those of a point `near`.

        With `keep`, the matrices of that point are reused.
        """
        unknowns = np.append(p, z)

        def solved(i: int, *, curved: bool) -> MotionState:
            t = self.members[k][i]
            close = None if near is None else near[i]
            return self._solve_motion(t, unknowns[self.columns[t]], close, keep=keep, curved=curved)

        if self.curved:
            try:
                return self._eliminate_kind(
                    k, z, self._map_trials(k, lambda i: solved(i, curved=True))
                )
            except np.linalg.LinAlgError:
                # Gauss-Newton takes over: its matrix is always positive definite
                pass
        return self._eliminate_kind(k, z, self._map_trials(k, lambda i: solved(i, curved=False)))

    def _map_trials(self, k: int, function: Callable[[int], MotionState]) -> list[MotionState]:
        """Apply a function to each trial of a kind, two at a time if there is no other kind."""
        every = range(len(self.members[k]))
        return (
            map_in_pairs(function, every)
            if len(self.members) == 1
            else [function(i) for i in every]
        )

    def _eliminate_kind(self, k: int, z: Array, trials: Sequence[MotionState]) -> KindState:
        """Sum the trials of a kind, and eliminate its soft tissue."""
        size = len(self.free) + len(z)
        hessian, gradient, cost = np.zeros((size, size)), np.zeros(size), 0.0
        for t, trial in zip(self.members[k], trials, strict=True):
            columns, share = self.columns[t], self.shares[t]
            hessian[np.ix_(columns, columns)] += share * trial.hessian
            gradient[columns] += share * trial.reduced_gradient
            cost += share * trial.cost
        return KindState(
            tuple(trials), eliminate_tissue(self.tissue[k], z, hessian, gradient, cost)
        )

    def _sum_kinds(self, p: Array, kinds: Sequence[KindState]) -> ReducedState:
        """Sum the kinds."""
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
        """Sum the kinds, and keep the point if it is the best."""
        state = self._sum_kinds(p, kinds)
        if self.best is None or state.total <= self.best.total:
            if self.may_curve and self.best is not None and len(self.prior) == len(p):
                gain, previous_gain = self._predict_gain(state), self._predict_gain(self.best)
                is_slow = gain > STALE_RATIO * previous_gain
                self.curved = self.curved or (is_slow and gain < NEARLY_THERE * state.total)
            self.best = state
        self.state = state
        return state

    def _predict_gain(self, state: ReducedState) -> float:
        """Predict by how much (m^2) the next step of parameters and soft tissue lowers the cost."""
        gradient = state.gradient + self.prior.T @ (self.prior @ (state.p - self.centre))
        scaled = self._factorise(state)[1] @ gradient
        return float(scaled @ scaled) + sum(kind.reduction for kind in state.kinds)

    def _promise_reduction(self, p: Array) -> float:
        """Predict by how much (m^2) the step from the best point to p lowers the cost."""
        if self.best is None:
            return 0.0
        best, step = self.best, p - self.best.p
        gradient = best.gradient + self.prior.T @ (self.prior @ (best.p - self.centre))
        along = self._factorise(best)[0] @ step
        reduction = -2.0 * float(gradient @ step) - float(along @ along)
        return max(reduction, 0.0) + sum(kind.reduction for kind in best.kinds)

    def _place_trial(self, t: int, values: Array) -> tuple[MotionProblem, MotionProblem]:
        """Place soft tissue and secondary motions of a trial at its unknowns (nx_t,).

        Returns the problem of the motion alone, and that with all unknowns open.
        """
        opened = self.open[t]
        if opened.tissue is None:
            return self.fixed[t], opened
        moved = opened.displace(values[opened.joint_parameters :])
        return self.fixed[t].with_data(moved.data), moved

    def _open_motion(
        self, t: int, values: Array, *, curved: bool = False
    ) -> tuple[MotionProblem, OpenMotion]:
        """Open the motion of a trial at its unknowns (nx_t,)."""
        fixed, problem = self._place_trial(t, values)
        body = self.bodies[t].with_free(self._get_trial_parameters(t, values))
        return fixed, OpenMotion(problem, body, values, curved=curved)

    def _get_trial_parameters(self, t: int, values: Array) -> Parameters:
        """Get all parameters of the linkage at the unknowns (nx_t,) of a trial."""
        count = self.open[t].joint_parameters
        return self.parameters.with_joint(self.open[t].unknowns[:count], values[:count])

    def _settle_motion(self, t: int, p: Array, z: Array, last: MotionState) -> MotionState:
        """Solve the motion of one trial at p and z, with equations formed there."""
        values = np.append(p, z)[self.columns[t]]
        fixed, motion = self._open_motion(t, values)
        predicted = last.predict_coefficients(values)
        stepped, share = motion.take_step(predicted, converged=last.converged)
        if share > self.settings.gain:
            curved = self._needs_newton(t, last)
            stepped = self._track_motion(t, predicted, fixed, motion, self.settings, curved=curved)
        return stepped

    def _solve_motion(
        self, t: int, values: Array, near: MotionState | None, *, keep: bool, curved: bool
    ) -> MotionState:
        """Solve the motion of one trial: predicted, corrected by a few plain steps, or tracked."""
        fixed, motion = self._open_motion(t, values, curved=curved)
        nearly = replace(self.settings, gain=max(self.settings.gain, CORRECTOR.gain))
        kept: Matrices | None = None
        if near is None:
            # then a small gain may be the damping's
            damped = self.settings.first_damping > 0.0
            about = self.settings if damped else replace(nearly, gain=max(nearly.gain, FIRST_GAIN))
            predicted = track_coefficients(
                fixed,
                fixed.build_body(self._get_trial_parameters(t, values)),
                self.starts[t],
                about,
            ).x
        else:
            predicted = near.predict_coefficients(values)
            alike = near.matrices.curved == curved
            kept = (
                near.matrices
                if alike and (keep or near.matrices.is_near(values, predicted))
                else None
            )
        if near is not None and self._needs_newton(t, near):
            return self._track_motion(t, predicted, fixed, motion, self.settings, curved=True)
        found = motion.correct(predicted, kept)
        if found is None and kept is not None:
            found = motion.correct(predicted, None)
        return found or self._track_motion(t, predicted, fixed, motion, nearly)

    def _track_motion(
        self,
        t: int,
        coefficients: Array,
        fixed: MotionProblem,
        motion: OpenMotion,
        settings: DescentSettings,
        *,
        curved: bool = False,
    ) -> MotionState:
        """Track the motion, and take one step of the open equations from there."""
        settings = replace(settings, first_damping=0.0, curved=curved)
        tracked = track_coefficients(
            fixed,
            fixed.build_body(self._get_trial_parameters(t, motion.values)),
            coefficients,
            settings,
        )
        if tracked.curved and not settings.curved:
            self.slow_at[t] = min(self.slow_at[t], tracked.cost)
        return motion.take_step(tracked.x, converged=tracked.converged)[0]

    def _needs_newton(self, t: int, near: MotionState) -> bool:
        """Return whether a trial's motion still needs Newton steps, by its cost."""
        return near.cost > COST_FALLEN_TO * self.slow_at[t]

    def compute_residual(self, p: Array) -> Array:
        """Compute the compressed residuals f (np + 1,), m."""
        state, pull = self.at(p), self.prior @ (p - self.centre)
        _, divided = self._factorise(state)
        projected = divided @ (state.gradient + self.prior.T @ pull)
        rest = state.cost + float(pull @ pull) - float(projected @ projected)
        return np.append(projected, np.sqrt(max(rest, 0.0)))

    def compute_jacobian(self, p: Array) -> Array:
        """Compute the compressed Jacobian (np + 1, np) of `compute_residual`."""
        return np.vstack([self._factorise(self.at(p))[0], np.zeros((1, len(p)))])

    def _factorise(self, state: ReducedState) -> tuple[Array, Array]:
        """Factorise S with the prior: R (np, np) with R^T R = S, and the inverse of R^T.

        With Newton's matrices S may be that of a saddle point: a direction in which the cost bends
        down gets the absolute value of its curvature, and none gets less than the prior's.
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
