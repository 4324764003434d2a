"""Estimate joint parameters, soft tissue and motions of all trials together, with their errors.

    min  sum_t C_t(p, z, N_t) / (f_t nu_t^2)  +  |(p - p_0)|^2_Sigma_p  +  |z|^2_Sigma_z

C_t is the marker cost of trial t (a joint alone, or pelvis and legs for gait), N_t its motion, p
the joint parameters with their prior from anatomy or a cohort (`joint_prior.py`), z the soft tissue
of every kind of task with its prior from people (`soft_tissue_artefact.py`). Motions and z are
eliminated (`reduced_problem.py`), p is found by SciPy. The published protocol (Reinbolt et al.
2007, eq. 1) is this with z = 0, without a prior (or a weak one), and with one f nu^2 for all trials
of a phase, their mean.

nu_t is the noise of the trial's independent samples (`joint_prior.py`), from a fit of its kind of
task alone: a disagreement with gait is no noise of a functional trial. Trials of one task repeat
their errors. With g_t and H_t the reduced gradients and matrices by p at the common estimate, in
units of the noise of each trial, K trials err independently if

    chi^2 = sum_t g_t^T H_t^-1 g_t - (sum g_t)^T (sum H_t)^-1 (sum g_t)

has (K - 1) n degrees of freedom, over the n directions that they determine. If chi^2 is the
share s of that, they
have 1 - s of their variance in common and count as  K / (s + K (1 - s))  trials: f = s + K (1 - s).
Kinds of task may disagree more than their errors allow: a cluster was put on anew for one, skin is
not linear. With the same chi^2 between kinds, the soft tissue of each eliminated, b^2 = max(chi^2 /
degrees of freedom, 1) is by how much the variances of all are too small (Birge, Phys Rev 40:207,
1932); the estimate stays.

With H the Hessian at the end, motions eliminated, and S_t the part of trial t, the errors of (p, z)
are

    -H^-1 ( sum_t b S_t^1/2 n_t  -  Sigma_p^-1 F_p e_p  -  Sigma_z^-1 F_z e_z ),    n, e_p, e_z independent, variance 1:

F F^T = Sigma, the columns of F_p being causes (`joint_prior.py`): columns of an `ErrorSources` by
source, markers of each trial, nominal values, soft tissue (`error_sources.py`). Their squares sum
to H^-1.

What is uncertain and not fitted, k, is considered (Schmidt-Kalman): joint parameters that stay as
they are, and z where
it stays zero. With S_pk of the same trials with k open, and errors R_k R_k^T of k, it makes errors  -H^-1 S_pk R_k.
Residuals do not show these errors: soft tissue that moves in proportion to a joint angle looks like a
joint in another position.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from gaitcal.arrays import Array, IntArray
from gaitcal.calibration.error_sources import ErrorSources, make_nominal_errors, propagate_errors
from gaitcal.calibration.joint_calibration import JointFit, JointSearch, JointSettings
from gaitcal.calibration.joint_prior import (
    ANATOMY,
    NoisePrior,
    compute_least_noise,
    estimate_forbidden_noise,
    estimate_trial_noises,
    get_noise_prior,
    select_prior,
)
from gaitcal.calibration.reduced_problem import NULL, ReducedState
from gaitcal.calibration.soft_tissue_artefact import NO_TISSUE, TissuePrior, make_secondary_prior
from gaitcal.calibration.tissue_elimination import Arrow, split_by_kind
from gaitcal.model.parameters import JOINT_PARAMETERS, JP_INDEX, ParameterKind, Parameters
from gaitcal.study.cohort_prior import JointPrior
from gaitcal.tracking.banded import eliminate
from gaitcal.tracking.coordinate_prior import find_undetermined_joints
from gaitcal.tracking.soft_tissue import SoftTissue
from gaitcal.tracking.spline import compute_frame_rate
from gaitcal.tracking.start import find_start_coefficients
from gaitcal.tracking.trial_problem import MotionProblem

BY_EVIDENCE = JointSettings(tolerance=1e-7)
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
# Information of trials over that of the prior from which they determine a direction
DETERMINED = 4.0

Tasks = Mapping[str, Sequence[MotionProblem]]
"""Kind of task, `gait` or the joint that isolated trials move -> trials, with the soft tissue that
may move their markers, if any."""


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


def select_movable_parameters(
    problems: Sequence[MotionProblem], wanted: Sequence[str]
) -> tuple[str, ...]:
    """Select the joint parameters that some trial can determine.

    A trial qualifies if it shows segments on both sides of the joint and its markers determine the
    joint's angles.

    Parameters
    ----------
    problems : sequence of MotionProblem
        The trials.
    wanted : sequence of str
        Joint parameters to select from.

    Returns
    -------
    tuple of str
        In the order of `wanted`.
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
    *,
    tissue: TissuePrior = NO_TISSUE,
    fits_tissue: bool = True,
    prior: JointPrior | None = ANATOMY,
    settings: JointSettings = BY_EVIDENCE,
    equal_weights: bool = False,
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
    tissue : TissuePrior
        Prior of the soft tissue of the problems.
    fits_tissue : bool
        Whether the soft tissue is fitted. Else it is zero, and a source of error.
    prior : JointPrior or None
        Prior of the joint parameters about `nominal`; None: no prior.
    settings : JointSettings
        Bounds and tolerances.
    equal_weights : bool
        Whether all trials have the mean noise as they show it; else the noise of people is a prior
        (`joint_prior.get_noise_prior`).
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
    began = time.perf_counter()
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
            of_kind, present, free, None if equal_weights else get_noise_prior(kind)
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
    weighed = _weigh(search, noise, equal=equal_weights)
    repeated: dict[str, float] = {}
    if len(kinds) > len(tasks):
        state = search.run_to_tolerance(NOISE_TOLERANCE)
        repeated = _count_effective_trials(
            kinds,
            search,
            state,
            noise,
            _make_wide_precision(free) if expected is None else expected[1],
        )
        noise = [
            nu * float(np.sqrt(repeated.get(kind, 1.0)))
            for nu, kind in zip(noise, kinds, strict=True)
        ]
        weighed = _weigh(search, noise, equal=equal_weights)
    fit = search.run()
    arrow = Arrow(fit.state.kinds, _get_prior_precision(search), NULL if prior is None else None)
    birge_ratio = (
        1.0 if prior is None or len(tasks) < 2 else _compute_birge_ratio(fit.state, arrow.precision)
    )
    sizes = [birge_ratio * nu / by for nu, by in zip(noise, weighed, strict=True)]
    unknowns, columns = (*free, *fit.keys), _list_columns(search, arrow)
    parts = [trial.hessian / nu**2 for trial, nu in zip(fit.state.trials, weighed, strict=True)]
    scores = _compute_scores([p.name for p in problems], unknowns, parts, columns, sizes)
    known = known or make_nominal_errors(free, prior)
    opened = [
        [key for problem in task for key in problem.with_free(free).unknowns]
        for task in tasks.values()
    ]
    of_kinds = split_by_kind(tissue, opened)
    tissue_keys = [key for of_kind in of_kinds for key in of_kind.keys]
    known = ErrorSources(
        (*known.free, *tissue_keys),
        block_diag(known.parameters, *(of_kind.root for of_kind in of_kinds)),
        (*known.clusters, *(f"skin/{key}" for key in tissue_keys)),
    )
    considered = tuple(name for name in known.free if name not in unknowns)
    coupling = _compute_coupling(with_columns, fit, unknowns, considered, weighed)
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
        covariance=_compute_covariance(arrow, parts, columns, sizes),
        tissue_errors=by_tissue,
    )
    return estimate, propagate_errors(unknowns, scores, arrow, coupling, known)


def _get_prior_precision(search: JointSearch) -> Array:
    """Get the precision (np, np) of the joint parameters before any trial."""
    return np.asarray(search.problem.prior.T @ search.problem.prior, float)


def _list_columns(search: JointSearch, arrow: Arrow) -> list[IntArray]:
    """List the indices of each trial's unknowns among those of all kinds."""
    problem, count = search.problem, len(search.free)
    out = [np.zeros(0, dtype=np.intp)] * len(problem.columns)
    for members, places in zip(problem.members, arrow.places, strict=True):
        every = np.concatenate([np.arange(count), places])
        for t in members:
            out[t] = every[problem.columns[t]]
    return out


def _compute_covariance(
    arrow: Arrow, parts: Sequence[Array], columns: Sequence[IntArray], sizes: Sequence[float]
) -> Array:
    """Compute the covariance (np, np) of joint parameters by priors and by the noise of trials.

    The noise may be larger than the one that the trials were weighed by (`sizes`). The rows of H^-1
    of joint parameters are C [1, -F_1^T, -F_2^T, ...], with their covariance C and the sensitivity
    F_k of z_k.
    """
    along = np.vstack([np.eye(len(arrow.precision)), *(-kind.sensitivity for kind in arrow.kinds)])
    spread = arrow.precision.copy()
    for kind in arrow.kinds:
        spread += kind.sensitivity.T @ kind.prior.precision @ kind.sensitivity
    for part, places, size in zip(parts, columns, sizes, strict=True):
        spread += size**2 * (along[places].T @ part @ along[places])
    covariance = arrow.covariance @ spread @ arrow.covariance
    return np.asarray(0.5 * (covariance + covariance.T), float)


def _weigh(search: JointSearch, noise: Sequence[float], *, equal: bool) -> list[float]:
    """Weigh the trials by their noise; return the noise (m) that each one counts by."""
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

    Parameters
    ----------
    problems : sequence of MotionProblem
        Trials of one kind.
    nominal : Parameters
        Start of the fit.
    free : tuple of str
        Joint parameters that may be free.
    expected : NoisePrior, optional
        Prior of people's noise. Points that are no markers have a least noise instead.

    Returns
    -------
    list of float
        nu of each trial, m: noise that no joint position explains.
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
        _weigh(search, noise, equal=False)
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


def _place_block(part: Array, places: IntArray, size: int) -> Array:
    """Place a block at some rows and columns of a zero matrix (size, size)."""
    out = np.zeros((size, size))
    out[np.ix_(places, places)] = part
    return out


def _count_effective_trials(
    kinds: Sequence[str],
    search: JointSearch,
    state: ReducedState,
    noise: Sequence[float],
    precision: Array,
) -> dict[str, float]:
    """Compute f of each kind of task with several trials."""
    out, count = dict[str, float](), len(precision)
    for kind in dict.fromkeys(kinds):
        members = [k for k, task in enumerate(kinds) if task == kind]
        if len(members) < 2:
            continue
        scores, informations = [], []
        for k in members:
            trial, places = state.trials[k], search.problem.columns[k]
            joint = places < count
            score = np.zeros(count)
            score[places[joint]] = trial.reduced_gradient[joint] / noise[k] ** 2
            scores.append(score)
            informations.append(
                _place_block(
                    trial.hessian[np.ix_(joint, joint)] / noise[k] ** 2, places[joint], count
                )
            )
        share = _estimate_independent_share(scores, informations, precision)
        out[kind] = share + len(members) * (1.0 - share)
    return out


def _estimate_independent_share(
    scores: Sequence[Array], informations: Sequence[Array], precision: Array
) -> float:
    """Estimate s of K scores (n,) with matrices (n, n): chi^2 per degree of freedom, at most 1."""
    root = np.linalg.inv(np.linalg.cholesky(precision)).T
    values, vectors = np.linalg.eigh(root.T @ sum(informations) @ root)
    base = root @ vectors[:, values > DETERMINED]
    if not base.shape[1]:
        return 1.0
    total, chi2 = base.T @ sum(scores), 0.0
    for score, information in zip(scores, informations, strict=True):
        part, along = base.T @ information @ base, base.T @ score
        part += 1e-9 * np.trace(part) / len(part) * np.eye(len(part))
        chi2 += float(along @ np.linalg.solve(part, along))
    chi2 -= float(total @ np.linalg.solve(base.T @ sum(informations) @ base, total))
    return float(min(chi2 / ((len(scores) - 1) * base.shape[1]), 1.0))


def _compute_birge_ratio(state: ReducedState, precision: Array) -> float:
    """Compute the factor b at the common estimate, given the prior precision (np, np)."""
    root = np.linalg.inv(np.linalg.cholesky(precision)).T

    def spread(score: Array, information: Array) -> Array:
        """Chi^2 and its degrees of freedom, of the directions that are determined."""
        values, vectors = np.linalg.eigh(root.T @ information @ root)
        known = values > DETERMINED
        return np.array(
            [(((root @ vectors[:, known]).T @ score) ** 2 / values[known]).sum(), known.sum()]
        )

    kept = [spread(kind.gradient, kind.hessian) for kind in state.kinds]
    chi2, degrees = np.sum(kept, axis=0) - spread(state.gradient, state.hessian)
    return float(np.sqrt(max(chi2 / degrees, 1.0))) if degrees else 1.0


def _compute_scores(
    trials: Sequence[str],
    unknowns: tuple[str, ...],
    parts: Sequence[Array],
    columns: Sequence[IntArray],
    sizes: Sequence[float],
) -> ErrorSources:
    """Compute u_t of every trial in independent columns; `sizes`: noise over that weighed by."""
    scores, sources = [], []
    for name, part, places, size in zip(trials, parts, columns, sizes, strict=True):
        values, vectors = np.linalg.eigh(part)
        kept = values > NULL * max(float(values.max(initial=0.0)), 1e-300)
        of_trial = np.zeros((len(unknowns), int(kept.sum())))
        of_trial[places] = vectors[:, kept] * np.sqrt(values[kept]) * size
        scores.append(of_trial)
        sources += [f"markers/{name}/{k}" for k in range(of_trial.shape[1])]
    return ErrorSources(unknowns, np.hstack(scores), tuple(sources))


def _compute_coupling(
    problems: Sequence[MotionProblem],
    fit: JointFit,
    unknowns: tuple[str, ...],
    considered: tuple[str, ...],
    noise: Sequence[float],
) -> Array:
    """Compute S_pk (np + nz, nk): effect of errors of fixed unknowns on the scores of fitted ones.

    Fixed unknowns that no trial depends on have no effect. Soft tissue and secondary motions are
    where the fit has them.
    """
    if not considered:
        return np.zeros((len(unknowns), 0))
    names, found = (*unknowns, *considered), dict(zip(unknowns, fit.values.tolist(), strict=True))
    out = np.zeros((len(names), len(names)))
    joints = tuple(name for name in names if name in JP_INDEX)
    for problem, coefficients, nu in zip(problems, fit.coefficients, noise, strict=True):
        opened = problem.with_free(joints)
        z = [found.get(name, 0.0) for name in opened.unknowns[opened.joint_parameters :]]
        moved = opened.displace(np.array(z)) if z else opened
        of_trial = eliminate(
            moved.assemble_equations(coefficients, moved.build_body(fit.parameters))
        )
        places = moved.locate_in(names)
        out[np.ix_(places, places)] += of_trial.hessian / nu**2
    return out[: len(unknowns), len(unknowns) :]
