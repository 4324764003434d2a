"""Estimate joint parameters, soft tissue and motions of all trials together, with their errors.

    min  sum_t C_t(p, z, N_t) / (f_t nu_t^2)  +  |(p - p_0)|^2_Sigma_p  +  |z|^2_Sigma_z

C_t is the marker cost of trial t (a joint alone, or pelvis and legs for gait), N_t its motion, p
the joint parameters with their prior from anatomy or a cohort (`joint_prior.py`), z the soft tissue
of every kind of task with its prior (`soft_tissue_artefact.py`). Motions and z are eliminated
(`reduced_problem.py`), and SciPy's `least_squares` finds p. The published protocol (Reinbolt et al.
2007, eq. 1) is this with z = 0, without a prior (or with a weak one), and with one f nu^2 for all
trials of a phase, the mean of theirs.

nu_t is the noise of the trial's independent samples (`trial_noise.py`), from a fit of its kind of
task alone: a disagreement with gait is no noise of a functional trial. f_t accounts for errors that
trials share (`trial_agreement.py`). Errors by source are in `estimate_errors.py`.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import block_diag
from scipy.optimize import OptimizeResult, least_squares

from gaitcal.arrays import Array
from gaitcal.calibration.error_sources import ErrorSources, make_nominal_errors, propagate_errors
from gaitcal.calibration.estimate_errors import (
    compute_coupling,
    compute_covariance,
    compute_scores,
    list_columns,
)
from gaitcal.calibration.joint_prior import ANATOMY, select_prior
from gaitcal.calibration.reduced_problem import NULL, ReducedProblem, ReducedState
from gaitcal.calibration.soft_tissue_artefact import NO_TISSUE, TissuePrior, make_secondary_prior
from gaitcal.calibration.tissue_elimination import Arrow, split_by_kind
from gaitcal.calibration.trial_agreement import compute_birge_ratio, count_effective_trials
from gaitcal.calibration.trial_noise import (
    NoisePrior,
    compute_least_noise,
    estimate_forbidden_noise,
    estimate_trial_noises,
    get_noise_prior,
)
from gaitcal.model.parameters import JOINT_PARAMETERS, JP_INDEX, ParameterKind, Parameters
from gaitcal.study.normal_prior import JointPrior
from gaitcal.tracking.coordinate_prior import find_undetermined_joints
from gaitcal.tracking.descent import DescentSettings
from gaitcal.tracking.soft_tissue import SoftTissue
from gaitcal.tracking.spline import compute_frame_rate
from gaitcal.tracking.start import find_start_coefficients
from gaitcal.tracking.trial_problem import MotionProblem

POSITION_SCALE = 0.1
"""m: one unit of a position inside the solver is 1 dm, of an orientation 1 rad, as both move a
marker about as far.
"""


@dataclass(frozen=True, kw_only=True)
class JointSettings:
    """Bounds, tolerances, prior and weights of a fit of joint parameters."""

    # m, largest distance of a position from its nominal value
    position_bound: float = np.inf
    orientation_bound: float = np.inf  # rad, the same for orientations
    tolerance: float = 1e-11
    """Relative tolerance on cost and parameters: with 1e-10 a hardly determined subtalar axis ends
    6e-5 rad off.
    """
    most_evaluations: int = 100
    tracking: DescentSettings = field(default_factory=DescentSettings)
    prior: JointPrior | None = None
    """About nominal values; None: parameters that the trials do not determine are frozen."""
    equal_weights: bool = False
    """Whether all trials of a phase get the mean of their noise; else each gets its noise, for
    which that of people is a prior (`trial_noise.get_noise_prior`)."""
    fits_tissue: bool = True
    """Whether soft tissue is fitted; else it is zero, and a source of error."""

    def get_bound(self, name: str) -> float:
        """Get the largest distance (m, rad) of a joint parameter from its nominal value."""
        position = JOINT_PARAMETERS[JP_INDEX[name]].kind is ParameterKind.POSITION
        return self.position_bound if position else self.orientation_bound


BY_EVIDENCE = JointSettings(tolerance=1e-7, prior=ANATOMY)
"""Far below the error bars; an axis that trials hardly determine is held by its prior."""


# m, s: noise before any is known, and how long it lasts
FIRST_NOISE, MEMORY_S = 0.010, 0.1
ROUNDS = 3  # Fits after which the noise of every trial is found anew
NOISE_TOLERANCE = 1e-4
"""Relative tolerance of those: the nu of a walk's legs, trunk and single joints are then within 2 %
of where searches to the end have them, and a noise that is taken from a hundred samples is itself
known to 7 %."""
WIDE_M, WIDE_RAD = 0.020, np.deg2rad(10.0)
"""m, rad: prior deviation of joints while noise is estimated, and unit of directions without a
prior; wider than anatomy."""

Tasks = Mapping[str, Sequence[MotionProblem]]
"""Kind of task, `gait` or the joint that isolated trials move -> trials, with the soft tissue that
may move their markers, if any."""


@dataclass(frozen=True, kw_only=True)
class JointFit:
    """Result of a fit of joint parameters, with its state for error estimates."""

    free: tuple[str, ...]
    # Columns of the soft tissue, `kind/regressor/segment/component`, kind by kind
    keys: tuple[str, ...]
    # (np + nz,) m, rad of `free`; then those of the soft tissue, m, rad
    values: Array
    parameters: Parameters
    state: ReducedState
    iterations: int
    seconds: float
    converged: bool
    message: str
    at_bound: tuple[str, ...]  # Free parameters that ended on a bound

    @property
    def coefficients(self) -> tuple[Array, ...]:
        """Per trial (nn, nq)."""
        return tuple(trial.coefficients for trial in self.state.trials)

    @property
    def tissue(self) -> Array:
        """(nz,) m, rad."""
        return self.values[len(self.free) :]


@dataclass(frozen=True, kw_only=True)
class JointEstimate(JointFit):
    """Joint parameters, soft tissue and motions fitted together, with their errors."""

    noise: tuple[float, ...]  # m, sqrt(f) nu of every trial
    # Kind of task -> f, where several trials have it
    effective_trials: dict[str, float]
    # The factor b on standard errors by which kinds of task disagree; 1 where their errors explain
    # it
    birge_ratio: float
    # Parameters that the markers determined, rather than the priors: trace of H^-1 sum S_t
    effective_parameters: float
    # (np, np) of p by the markers, and the prior of soft tissue, alone
    information: Array
    covariance: Array
    """(np, np) of p by noise and priors; zero along directions that neither of them determines."""
    tissue_errors: Array
    """(np, nc) errors of p by soft tissue that was not fitted, in columns of variance one."""

    @property
    def whole_covariance(self) -> Array:
        """(np, np) covariance by noise, priors and soft tissue that was not fitted."""
        return self.covariance + self.tissue_errors @ self.tissue_errors.T


class JointSearch:
    """Search for joint parameters, which may be repeated with other weights of the trials."""

    def __init__(
        self,
        problems: Sequence[MotionProblem],
        parameters: Parameters,
        free: tuple[str, ...],
        starts: Sequence[Array],
        settings: JointSettings | None = None,
        *,
        nominal: Parameters | None = None,
        tissue: TissuePrior = NO_TISSUE,
        expected: tuple[Array, Array] | None = None,
        kinds: Sequence[str] | None = None,
    ) -> None:
        """Set up the search.

        Parameters
        ----------
        problems : sequence of MotionProblem
            The trials; each has its motion, all share the joint parameters.
        parameters : Parameters
            Start of the search, and the values of all that is not free.
        free : tuple of str
            Joint parameters to fit; those that no trial passes are left out.
        starts : sequence of (nn, nq) array
            Start coefficients of each trial.
        settings : JointSettings, optional
            Bounds and tolerances.
        nominal : Parameters, optional
            Centre of the bounds; `parameters` if not given.
        tissue : TissuePrior
            Prior of the soft tissue of the problems.
        expected : tuple of array, optional
            (np,) mean (m, rad) and (np, np) precision of the joint parameters `free` before any
            trial; no prior if not given.
        kinds : sequence of str, optional
            Kind of task of each trial, which has its separate soft tissue; one for all if not
            given.
        """
        self.settings = settings or JointSettings()
        self.free = select_parameters_in_linkage(problems, free)
        index = [JP_INDEX[name] for name in self.free]
        self.present = parameters.joint[index]
        self.middle = (nominal or parameters).joint[index]
        self.reach = np.array([self.settings.get_bound(name) for name in self.free])
        position = np.array(
            [JOINT_PARAMETERS[i].kind is ParameterKind.POSITION for i in index], dtype=bool
        )
        self.scale = np.where(position, POSITION_SCALE, 1.0)
        centre, rows = self.present, np.zeros((0, len(index)))
        if expected is not None:
            centre, rows = expected[0], np.asarray(np.linalg.cholesky(expected[1]).T, float)
        self.problem = ReducedProblem(
            problems,
            parameters,
            self.free,
            starts,
            self.settings.tracking,
            prior=rows,
            centre=centre,
            tissue=tissue,
            kinds=kinds,
        )

    def run(self, start_values: Array | None = None) -> JointFit:
        """Fit to the final tolerance.

        Parameters
        ----------
        start_values : (np,) array, optional
            Start (m, rad); the best point so far if not given.

        Returns
        -------
        JointFit
            Parameters, soft tissue and motions.
        """
        began = time.perf_counter()
        self.problem.may_curve = True
        result = self._run_least_squares(self.settings.tolerance, start_values)
        state = self.problem.settle(result.x)
        bounded = np.isfinite(self.reach)
        edge = bounded & (
            np.abs(result.x - self.middle) > 0.999 * np.where(bounded, self.reach, 1.0)
        )
        return JointFit(
            free=self.free,
            keys=tuple(key for kind in state.kinds for key in kind.prior.keys),
            values=np.concatenate([result.x, *(kind.z for kind in state.kinds)]),
            parameters=self.problem.get_parameters(result.x),
            state=state,
            iterations=int(result.nfev),
            seconds=time.perf_counter() - began,
            converged=bool(result.status > 0) and all(trial.converged for trial in state.trials),
            message=describe_ending(result),
            at_bound=tuple(name for name, on_edge in zip(self.free, edge, strict=True) if on_edge),
        )

    def run_to_tolerance(self, tolerance: float) -> ReducedState:
        """Search to a larger tolerance; motions are those of the last step."""
        return self.problem.at(self._run_least_squares(tolerance).x)

    def _run_least_squares(self, tolerance: float, start: Array | None = None) -> OptimizeResult:
        """Run SciPy's search from `start`, or from the best point so far."""
        if start is None:
            start = self.present if self.problem.best is None else self.problem.best.p
        if not len(start):
            return OptimizeResult(x=start, status=1, nfev=0, message="")
        lower, upper = self.middle - self.reach, self.middle + self.reach
        bounded = np.isfinite(self.reach)
        inside = np.clip(start, lower + 1e-9 * (upper - lower) if bounded.all() else lower, upper)
        return least_squares(
            self.problem.compute_residual,
            inside,
            jac=self.problem.compute_jacobian,
            bounds=(lower, upper) if bounded.any() else (-np.inf, np.inf),
            x_scale=self.scale,
            ftol=tolerance,
            xtol=tolerance,
            gtol=1e-15,
            max_nfev=self.settings.most_evaluations,
        )


def select_parameters_in_linkage(
    problems: Sequence[MotionProblem], names: Sequence[str]
) -> tuple[str, ...]:
    """Select the parameters whose joint is in the linkage of some trial."""
    found = {name for problem in problems for name in problem.with_free(tuple(names)).chain.free}
    return tuple(name for name in names if name in found)


def select_movable_parameters(
    problems: Sequence[MotionProblem], wanted: Sequence[str]
) -> tuple[str, ...]:
    """Select the joint parameters that some trial can determine.

    A trial qualifies if it shows segments on both sides of the joint and its markers determine the
    joint's angles.

    `wanted`: joint parameters to select from. Returns: in the order of `wanted`.
    """
    passed = set()
    for problem in problems:
        opened = problem.with_free(tuple(wanted))
        shown = np.zeros(len(opened.chain.segments), dtype=bool)
        shown[opened.data.segment[(opened.data.weight > 0).any(axis=1)]] = True
        count = len(opened.chain.coordinates)
        distal = opened.chain.support[count:] * shown
        proximal = (1.0 - opened.chain.support[count:]) * shown
        found = {
            name
            for name, b, a in zip(opened.chain.free, proximal, distal, strict=True)
            if a.any() and b.any()
        }
        passed |= {
            name
            for name in found
            if name.split(".")[0] not in find_undetermined_joints(problem.guessed)
        }
    return tuple(name for name in wanted if name in passed)


def estimate_joints(
    tasks: Tasks,
    nominal: Parameters,
    free: tuple[str, ...],
    settings: JointSettings = BY_EVIDENCE,
    *,
    tissue: TissuePrior = NO_TISSUE,
    present: Parameters | None = None,
    known: ErrorSources | None = None,
) -> tuple[JointEstimate, ErrorSources]:
    """Fit joint parameters and soft tissue to all trials together, with their errors by source.

    Parameters
    ----------
    tasks : mapping of str to sequence of MotionProblem
        Kind of task -> trials.
    nominal : Parameters
        Centre of the prior and of the bounds.
    free : tuple of str
        Joint parameters to fit.
    settings : JointSettings
        Bounds, tolerances, prior and weights.
    tissue : TissuePrior
        Prior of the soft tissue of the problems.
    present : Parameters, optional
        Start of the search, and values of all that is not free; `nominal` if not given.
    known : ErrorSources, optional
        Errors of the joint parameters before the fit, fixed ones included. If not given, those of
        the free ones by the prior; the others are exact.

    Returns
    -------
    tuple of JointEstimate and ErrorSources
        The estimate, and the errors of all parameters by source.
    """
    began, prior, fits_tissue = time.perf_counter(), settings.prior, settings.fits_tissue
    with_columns, present = (
        [problem for problems in tasks.values() for problem in problems],
        present or nominal,
    )
    kinds = [kind for kind, problems in tasks.items() for _ in problems]
    problems = (
        with_columns if fits_tissue else [replace(problem, tissue=None) for problem in with_columns]
    )
    noise: list[float] = []
    for kind in tasks:
        of_kind = [p for p, task in zip(problems, kinds, strict=True) if task == kind]
        noise += estimate_noise(
            of_kind, present, free, None if settings.equal_weights else get_noise_prior(kind)
        )
    starts = [find_start_coefficients(p.build_body(present), p.data, p.basis) for p in problems]
    expected = None if prior is None else _compute_expected(nominal, free, prior)
    search = JointSearch(
        problems,
        present,
        free,
        starts,
        settings,
        nominal=nominal,
        tissue=tissue if fits_tissue else NO_TISSUE,
        expected=expected,
        kinds=kinds,
    )
    weighed = _set_trial_weights(search, noise, equal=settings.equal_weights)
    repeated: dict[str, float] = {}
    if len(kinds) > len(tasks):
        state = search.run_to_tolerance(NOISE_TOLERANCE)
        repeated = count_effective_trials(
            kinds,
            search.problem.columns,
            state,
            noise,
            _make_wide_precision(free) if expected is None else expected[1],
        )
        noise = [
            nu * float(np.sqrt(repeated.get(kind, 1.0)))
            for nu, kind in zip(noise, kinds, strict=True)
        ]
        weighed = _set_trial_weights(search, noise, equal=settings.equal_weights)
    fit = search.run()
    arrow = Arrow(fit.state.kinds, _get_prior_precision(search), NULL if prior is None else None)
    birge_ratio = (
        1.0 if prior is None or len(tasks) < 2 else compute_birge_ratio(fit.state, arrow.precision)
    )
    sizes = [birge_ratio * nu / by for nu, by in zip(noise, weighed, strict=True)]
    unknowns, columns = (*free, *fit.keys), list_columns(search.problem, arrow)
    parts = [trial.hessian / nu**2 for trial, nu in zip(fit.state.trials, weighed, strict=True)]
    scores = compute_scores([p.name for p in problems], unknowns, parts, columns, sizes)
    known = known or make_nominal_errors(free, prior)
    opened = list[list[str]]()
    for task in tasks.values():
        unknowns_of_task = list[str]()
        for problem in task:
            unknowns_of_task += problem.with_free(free).unknowns
        opened.append(unknowns_of_task)
    of_kinds = split_by_kind(tissue, opened)
    tissue_keys = [key for of_kind in of_kinds for key in of_kind.keys]
    known = ErrorSources(
        (*known.names, *tissue_keys),
        block_diag(known.effects, *(of_kind.root for of_kind in of_kinds)),
        (*known.sources, *(f"skin/{key}" for key in tissue_keys)),
    )
    considered = tuple(name for name in known.names if name not in unknowns)
    coupling = compute_coupling(
        with_columns, fit.parameters, fit.values, fit.coefficients, unknowns, considered, weighed
    )
    by_tissue = np.zeros((len(free), 0))
    if not fits_tissue:
        of_tissue = [considered.index(key) for key in tissue_keys]
        roots = block_diag(*(of_kind.root for of_kind in of_kinds))
        by_tissue = -arrow.solve(coupling[:, of_tissue]) @ roots[: len(of_tissue)]
    of_fit = vars(fit) | {
        "iterations": search.problem.evaluations,
        "seconds": time.perf_counter() - began,
    }
    estimate = JointEstimate(
        **of_fit,
        noise=tuple(noise),
        effective_trials=repeated,
        birge_ratio=birge_ratio,
        effective_parameters=arrow.count_effective_parameters(),
        information=arrow.information,
        covariance=compute_covariance(arrow, parts, columns, sizes),
        tissue_errors=by_tissue,
    )
    return estimate, propagate_errors(unknowns, scores, arrow, coupling, known)


def _get_prior_precision(search: JointSearch) -> Array:
    """Get the precision (np, np) of the joint parameters before any trial."""
    return np.asarray(search.problem.prior.T @ search.problem.prior, float)


def _set_trial_weights(search: JointSearch, noise: Sequence[float], *, equal: bool) -> list[float]:
    """Weight the trials by their noise; return the noise (m) used for each."""
    weighed = [float(np.sqrt(np.mean(np.square(noise))))] * len(noise) if equal else list(noise)
    search.problem.weigh([1.0 / nu**2 for nu in weighed])
    return weighed


def estimate_noise(
    problems: Sequence[MotionProblem],
    nominal: Parameters,
    free: tuple[str, ...],
    expected: NoisePrior | None = None,
) -> list[float]:
    """Estimate the noise of every trial of a kind of task, fitted separately without soft tissue.

    `free`: joint parameters that may be free. `expected`: prior of people's noise. Points that are
    no markers have a least noise instead. Returns: nu of each trial, m: noise that no joint
    position explains.
    """
    problems = [
        replace(p, tissue=SoftTissue((), p.secondary) if p.secondary else None) for p in problems
    ]
    movable = select_movable_parameters(problems, free)
    noise = [
        FIRST_NOISE * float(np.sqrt(max(compute_frame_rate(p.basis) * MEMORY_S, 1.0)))
        for p in problems
    ]
    if not movable:
        return noise
    starts = [find_start_coefficients(p.build_body(nominal), p.data, p.basis) for p in problems]
    about = nominal.joint[[JP_INDEX[n] for n in movable]], _make_wide_precision(movable)
    tissue, least = (
        make_secondary_prior(problems),
        [compute_least_noise(p.basis, p.noise) for p in problems],
    )
    search = JointSearch(
        problems, nominal, movable, starts, BY_EVIDENCE, tissue=tissue, expected=about
    )
    for _ in range(ROUNDS):
        _set_trial_weights(search, noise, equal=False)
        state = search.run_to_tolerance(NOISE_TOLERANCE)
        effective = Arrow(state.kinds, _get_prior_precision(search)).count_effective_parameters()
        moved, at = search.problem.place_tissue(state), search.problem.get_parameters(state.p)
        left = [
            estimate_forbidden_noise(p, at, trial.coefficients)
            for p, trial in zip(moved, state.trials, strict=True)
        ]
        rates = [compute_frame_rate(p.basis) for p in problems]
        priors = (
            None
            if expected is None or any(p.noise for p in problems)
            else [expected] * len(problems)
        )
        noise = estimate_trial_noises(left, least, effective, priors, rates)
    return noise


def _make_wide_precision(names: Sequence[str]) -> Array:
    """Make the precision (np, np) of joint parameters with deviations `WIDE_M` and `WIDE_RAD`."""
    wide = np.array(
        [
            WIDE_M if JOINT_PARAMETERS[JP_INDEX[n]].kind is ParameterKind.POSITION else WIDE_RAD
            for n in names
        ]
    )
    return np.diag(1.0 / wide**2)


def _compute_expected(
    nominal: Parameters, free: tuple[str, ...], prior: JointPrior
) -> tuple[Array, Array]:
    """Compute prior means (np,) and precision (np, np) of joint parameters, m and rad."""
    mean, covariance = select_prior(free, prior)
    return nominal.joint[[JP_INDEX[n] for n in free]] + mean, np.asarray(
        np.linalg.inv(covariance), float
    )


_STATUS = {
    0: "stopped at the largest number of evaluations",
    1: "the cost is stationary",
    2: "the cost falls no further",
    3: "the parameters move no further",
    4: "neither cost nor parameters change any more",
}


def describe_ending(result: OptimizeResult) -> str:
    """Describe SciPy's status; its message if the number is new."""
    return _STATUS.get(int(result.status), str(result.message))
