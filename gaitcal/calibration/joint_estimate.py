"""One estimate of all joint parameters: every trial, every parameter that a trial can move, soft tissue, the motions.

    min  sum_t C_t(p, z, N_t) / (f_t nu_t^2)  +  |(p - p_0)|^2_Sigma_p  +  |z|^2_Sigma_z

C_t is the marker cost of trial t (a joint alone, or pelvis and legs for gait), N_t its motion, p the joint parameters
with what anatomy or a cohort expects of them (`joint_prior.py`), z the soft tissue of every kind of task with what
people show (`soft_tissue_artefact.py`). The motions are eliminated (`reduced_problem.py`), (p, z) found by SciPy.
The published protocol (Reinbolt et al. 2007, eq. 1) is this with z = 0, without a prior (or a weak one), and with one
f nu^2 for all trials of a phase, the mean of their own.

nu_t is the noise of the trial's independent samples (`joint_prior.py`), from a fit of its own kind of task alone: what
gait disagrees with is no noise of an isolated trial. Trials of one task repeat their errors. With g_t and H_t the
reduced gradients and matrices by p at the common estimate, in units of each trial's own noise, K trials err
independently if

    chi^2 = sum_t g_t^T H_t^-1 g_t - (sum g_t)^T (sum H_t)^-1 (sum g_t)

has (K - 1) n degrees of freedom, over the n directions that they determine. A smaller share s of that says that they
have 1 - s of their variance in common, so that together they count as  K / (s + K (1 - s))  trials: f = s + K (1 - s).
Kinds of task may disagree more than their errors allow: a cluster was put on anew for one, skin is not linear. With the
same chi^2 between kinds, the soft tissue of each eliminated, b^2 = max(chi^2 / degrees of freedom, 1) is by how much
the variances of all are too small (Birge, Phys Rev 40:207, 1932); the estimate stays.

With H the Hessian at the end, motions eliminated, and S_t the part of trial t, the errors of (p, z) are

    -H^-1 ( sum_t b S_t^1/2 n_t  -  Sigma_p^-1 F_p e_p  -  Sigma_z^-1 F_z e_z ),    n, e_p, e_z independent, variance 1:

F F^T = Sigma, the columns of F_p being causes (`joint_prior.py`): columns of an `ErrorSources` by source, markers of
each trial, nominal values, soft tissue (`error_sources.py`). Their squares sum to H^-1.

What is uncertain and not fitted, k, is considered (Schmidt-Kalman): joint parameters that stay as they are, and z where
it stays zero. With S_pk of the same trials with k open, and errors R_k R_k^T of k, it makes errors  -H^-1 S_pk R_k.
Residuals do not tell these: skin in step with a joint looks just like a joint that lies elsewhere.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from gaitcal.arrays import Array, IntArray
from gaitcal.calibration.error_sources import ErrorSources, errors_by_source, nominal_errors
from gaitcal.calibration.joint_calibration import JointFit, JointSearch, JointSettings
from gaitcal.calibration.joint_prior import ANATOMY, forbidden_noise, least_noise, prior_of, trial_noises
from gaitcal.calibration.reduced_problem import NULL, ReducedState
from gaitcal.calibration.soft_tissue_artefact import NO_TISSUE, TissuePrior, secondary_prior
from gaitcal.model.parameters import JOINT_PARAMETERS, JP_INDEX, Kind, Parameters
from gaitcal.motion.banded import eliminate
from gaitcal.motion.coordinate_prior import joints_left_open
from gaitcal.motion.soft_tissue import SoftTissue
from gaitcal.motion.spline import frame_rate
from gaitcal.motion.start import starting_nodes
from gaitcal.motion.trial_problem import MotionProblem
from gaitcal.study.joint_prior import JointPrior

BY_EVIDENCE = JointSettings(tolerance=1e-7)
"""Far below the error bars; an axis that trials hardly determine is held by its prior."""
FIRST_NOISE, MEMORY_S = 0.010, 0.1  # m, s: noise before any is known, and how long it lasts
ROUNDS = 3  # Fits after which the noise of every trial is found anew
NOISE_TOLERANCE = 1e-4
"""Relative tolerance of those: the nu of a walk's legs, trunk and single joints are then within 2 % of where searches
to the end have them, and a noise that is taken from a hundred samples is itself known to 7 %."""
WIDE_M, WIDE_RAD = 0.020, np.deg2rad(10.0)
"""m, rad: how far joints may lie from nominal places where noise is sought, and what directions are measured by where
nothing is expected: further than anatomy has them."""
DETERMINED = 4.0  # Information of trials over that of the prior from which they determine a direction

Tasks = Mapping[str, Sequence[MotionProblem]]
"""Kind of task, `gait` or the joint that isolated trials move -> trials, with the soft tissue that may move their
markers, if any."""


@dataclass(frozen=True, kw_only=True)
class JointEstimate(JointFit):
    """Joint parameters, soft tissue and motions found together, with their errors."""

    keys: tuple[str, ...]  # Columns of the soft tissue, `kind/regressor/segment/component`
    noise: tuple[float, ...]  # m, sqrt(f) nu of every trial
    repeated: dict[str, float]  # Kind of task -> f, where several trials have it
    apart: float  # The factor b on standard errors by which kinds of task disagree; 1 where their errors explain it
    effective_parameters: float  # Parameters that the markers determined, rather than the priors: trace of H^-1 sum S_t
    information: Array  # (np + nz, np + nz) sum S_t, what the markers say by themselves
    covariance: Array
    """(np + nz, np + nz) of (p, z) by noise and priors; nothing along directions that neither of them tells."""
    by_tissue: Array
    """(np + nz, nc) what soft tissue that was not fitted makes of (p, z) besides, in columns of variance one."""

    @property
    def whole_covariance(self) -> Array:
        """(np + nz, np + nz) by noise, priors and soft tissue that was not fitted."""
        return self.covariance + self.by_tissue @ self.by_tissue.T


def free_of(problems: Sequence[MotionProblem], wanted: Sequence[str]) -> tuple[str, ...]:
    """The joint parameters of `wanted` that some trial can move: their joint lies between segments that it shows, and
    its markers determine the joint's angles.
    """
    passed = set()
    for problem in problems:
        opened = problem.with_free(tuple(wanted))
        shown = np.zeros(len(opened.chain.segments), dtype=bool)
        shown[opened.data.segment[(opened.data.weight > 0).any(axis=1)]] = True
        count = len(opened.chain.coordinates)
        beyond = opened.chain.support[count:] * shown
        before = (1.0 - opened.chain.support[count:]) * shown
        found = {name for name, b, a in zip(opened.chain.free, before, beyond, strict=True) if a.any() and b.any()}
        passed |= {name for name in found if name.split(".")[0] not in joints_left_open(problem.guessed)}
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
    """Fit the joint parameters `free` and the soft tissue to all trials together, and tell their errors by source.

    `nominal`: what the prior is about, and bounds.
    `tissue`: prior of the columns that the problems have.
    `fits_tissue`: whether these are fitted; else markers stay in their places, and the columns are a source of error.
    `prior`: of the joint parameters, about `nominal`; None: nothing is expected of them.
    `equal_weights`: whether all trials have one noise, the mean of their own.
    `present`: where the search starts, and values of all that is not free; `nominal` unless given.
    `known`: errors of the joint parameters before the fit, those that it keeps fixed too; by the prior of those that
    are free unless given, the rest being exact.
    """
    began = time.perf_counter()
    with_columns, present = [problem for problems in tasks.values() for problem in problems], present or nominal
    kinds = [kind for kind, problems in tasks.items() for _ in problems]
    problems = with_columns if fits_tissue else [replace(problem, tissue=None) for problem in with_columns]
    fitted, unfitted = (tissue, NO_TISSUE) if fits_tissue else (NO_TISSUE, tissue)
    noise: list[float] = []
    for kind in tasks:
        noise += noise_of([p for p, of in zip(problems, kinds, strict=True) if of == kind], present, free)
    starts = [starting_nodes(p.body(present), p.data, p.basis) for p in problems]
    expected = None if prior is None else _expected(nominal, free, prior)
    search = JointSearch(problems, present, free, starts, settings, nominal=nominal, tissue=fitted, expected=expected)
    weighed = _weigh(search, noise, equal=equal_weights)
    repeated: dict[str, float] = {}
    if len(kinds) > len(tasks):
        state = search.approach(NOISE_TOLERANCE)
        repeated = _repeated(kinds, search, state, noise, _wide(free) if expected is None else expected[1])
        noise = [nu * float(np.sqrt(repeated.get(kind, 1.0))) for nu, kind in zip(noise, kinds, strict=True)]
        weighed = _weigh(search, noise, equal=equal_weights)
    fit = search.run()
    parts = []
    for trial, places, nu in zip(fit.state.trials, search.problem.columns, weighed, strict=True):
        parts.append(_placed(trial.hessian / nu**2, places, len(fit.values)))
    precision = np.asarray(search.problem.prior.T @ search.problem.prior, float)
    information = np.asarray(sum(parts), float)
    hessian = information + precision
    if prior is None and hessian.size:  # zero along the directions that nobody sees
        inverse = np.asarray(np.linalg.pinv(hessian, rcond=NULL, hermitian=True), float)
    else:
        inverse = np.asarray(np.linalg.inv(hessian), float)
    unknowns = (*free, *fitted.keys)
    apart = 1.0 if prior is None or len(tasks) < 2 else _apart(kinds, search, fit, weighed, precision)
    sizes = [apart * own / by for own, by in zip(noise, weighed, strict=True)]
    scores = _scores([p.name for p in problems], unknowns, parts, sizes)
    known = known or nominal_errors(free, prior)
    known = ErrorSources(
        (*known.free, *tissue.keys),
        block_diag(known.parameters, np.linalg.cholesky(tissue.covariance)),
        (*known.clusters, *(f"skin/{key}" for key in tissue.keys)),
    )
    considered = tuple(name for name in known.free if name not in unknowns)
    coupling = _coupling(with_columns, fit, unknowns, considered, weighed)
    of_tissue = [considered.index(key) for key in unfitted.keys]
    of_fit = vars(fit) | {"iterations": search.problem.evaluations, "seconds": time.perf_counter() - began}
    estimate = JointEstimate(
        **of_fit,
        keys=fitted.keys,
        noise=tuple(noise),
        repeated=repeated,
        apart=apart,
        effective_parameters=float(np.trace(inverse @ information)),
        information=information,
        covariance=inverse @ (scores.covariance + precision) @ inverse,
        by_tissue=-inverse @ coupling[:, of_tissue] @ np.linalg.cholesky(unfitted.covariance),
    )
    return estimate, errors_by_source(unknowns, scores, inverse, precision, coupling, known)


def _weigh(search: JointSearch, noise: Sequence[float], *, equal: bool) -> list[float]:
    """m, the noise that each trial then counts by."""
    weighed = [float(np.sqrt(np.mean(np.square(noise))))] * len(noise) if equal else list(noise)
    search.problem.weigh([1.0 / nu**2 for nu in weighed])
    return weighed


def noise_of(problems: Sequence[MotionProblem], nominal: Parameters, free: tuple[str, ...]) -> list[float]:
    """m, nu of every trial of a kind of task, fitted by itself with markers that stay in their places: what no joint
    explains, wherever it may lie.
    """
    problems = [replace(p, tissue=SoftTissue((), p.secondary) if p.secondary else None) for p in problems]
    own = free_of(problems, free)
    noise = [FIRST_NOISE * float(np.sqrt(max(frame_rate(p.basis) * MEMORY_S, 1.0))) for p in problems]
    if not own:
        return noise
    starts = [starting_nodes(p.body(nominal), p.data, p.basis) for p in problems]
    expected = nominal.joint[[JP_INDEX[n] for n in own]], _wide(own)
    tissue, least = secondary_prior(problems), [least_noise(p.basis, p.noise) for p in problems]
    search = JointSearch(problems, nominal, own, starts, BY_EVIDENCE, tissue=tissue, expected=expected)
    precision = search.problem.prior.T @ search.problem.prior
    for _ in range(ROUNDS):
        _weigh(search, noise, equal=False)
        state = search.approach(NOISE_TOLERANCE)
        effective = float(np.trace(np.linalg.solve(state.hessian + precision, state.hessian)))
        moved, at = search.problem.moved(state.p), search.problem.linkage(state.p)
        left = [forbidden_noise(p, at, trial.coefficients) for p, trial in zip(moved, state.trials, strict=True)]
        noise = trial_noises(left, least, effective)
    return noise


def _wide(names: Sequence[str]) -> Array:
    """(np, np) precision of joint parameters that may lie `WIDE_M` or `WIDE_RAD` off."""
    wide = np.array([WIDE_M if JOINT_PARAMETERS[JP_INDEX[n]].kind is Kind.POSITION else WIDE_RAD for n in names])
    return np.diag(1.0 / wide**2)


def _expected(nominal: Parameters, free: tuple[str, ...], prior: JointPrior) -> tuple[Array, Array]:
    """(np,) expected values and (np, np) precision of joint parameters before any trial."""
    mean, covariance = prior_of(free, prior)
    return nominal.joint[[JP_INDEX[n] for n in free]] + mean, np.asarray(np.linalg.inv(covariance), float)


def _placed(part: Array, places: IntArray, size: int) -> Array:
    """(size, size) with a part of it at some rows and columns, zero elsewhere."""
    out = np.zeros((size, size))
    out[np.ix_(places, places)] = part
    return out


def _repeated(
    kinds: Sequence[str], search: JointSearch, state: ReducedState, noise: Sequence[float], precision: Array
) -> dict[str, float]:
    """Kind of task -> f, of those with several trials."""
    out, count = dict[str, float](), len(precision)
    for kind in dict.fromkeys(kinds):
        members = [k for k, of in enumerate(kinds) if of == kind]
        if len(members) < 2:
            continue
        scores, informations = [], []
        for k in members:
            trial, places = state.trials[k], search.problem.columns[k]
            joint = places < count
            score = np.zeros(count)
            score[places[joint]] = trial.reduced_gradient[joint] / noise[k] ** 2
            scores.append(score)
            informations.append(_placed(trial.hessian[np.ix_(joint, joint)] / noise[k] ** 2, places[joint], count))
        share = _independent_share(scores, informations, precision)
        out[kind] = share + len(members) * (1.0 - share)
    return out


def _independent_share(scores: Sequence[Array], informations: Sequence[Array], precision: Array) -> float:
    """S = chi^2 over its degrees of freedom, at most 1, of K scores (n,) with matrices (n, n)."""
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


def _apart(kinds: Sequence[str], search: JointSearch, fit: JointFit, noise: Sequence[float], precision: Array) -> float:
    """The factor b, at the common estimate; `precision`: (np + nz, np + nz) of all unknowns before any trial."""
    count, p, z = len(fit.free), slice(len(fit.free)), slice(len(fit.free), None)
    root = np.linalg.inv(np.linalg.cholesky(precision[p, p])).T

    def spread(score: Array, information: Array) -> Array:
        """Chi^2 and its degrees of freedom, of the directions that are determined."""
        values, vectors = np.linalg.eigh(root.T @ information @ root)
        known = values > DETERMINED
        return np.array([(((root @ vectors[:, known]).T @ score) ** 2 / values[known]).sum(), known.sum()])

    scores, informations = list[Array](), list[Array]()
    for kind in dict.fromkeys(kinds):
        score, whole = np.zeros(count), np.zeros_like(precision)
        for of, trial, places, nu in zip(kinds, fit.state.trials, search.problem.columns, noise, strict=True):
            if of == kind:
                score[places[places < count]] += trial.reduced_gradient[places < count] / nu**2
                whole += _placed(trial.hessian / nu**2, places, len(whole))
        scores.append(score)
        informations.append(whole[p, p] - whole[p, z] @ np.linalg.solve(whole[z, z] + precision[z, z], whole[z, p]))
    kept = [spread(*both) for both in zip(scores, informations, strict=True)]
    chi2, degrees = np.sum(kept, axis=0) - spread(np.sum(scores, axis=0), np.sum(informations, axis=0))
    return float(np.sqrt(max(chi2 / degrees, 1.0))) if degrees else 1.0


def _scores(
    trials: Sequence[str], free: tuple[str, ...], parts: Sequence[Array], sizes: Sequence[float]
) -> ErrorSources:
    """u_t of every trial by independent columns; `sizes`: its noise over the one that it counts by."""
    columns, sources = [], []
    for name, part, size in zip(trials, parts, sizes, strict=True):
        values, vectors = np.linalg.eigh(part)
        kept = values > NULL * max(float(values.max(initial=0.0)), 1e-300)
        columns.append(vectors[:, kept] * np.sqrt(values[kept]) * size)
        sources += [f"markers/{name}/{k}" for k in range(int(kept.sum()))]
    return ErrorSources(free, np.hstack(columns), tuple(sources))


def _coupling(
    problems: Sequence[MotionProblem],
    fit: JointFit,
    unknowns: tuple[str, ...],
    considered: tuple[str, ...],
    noise: Sequence[float],
) -> Array:
    """(np + nz, nk) S_pk: what errors of all that was not fitted do to the scores of what was, `unknowns`.

    Only what moves some trial counts there; its soft tissue and secondary motions are where the fit has them.
    """
    names, found = (*unknowns, *considered), dict(zip(unknowns, fit.values.tolist(), strict=True))
    out = np.zeros((len(names), len(names)))
    if considered:
        joints = tuple(name for name in names if name in JP_INDEX)
        for problem, coefficients, nu in zip(problems, fit.coefficients, noise, strict=True):
            opened = problem.with_free(joints)
            z = [found.get(name, 0.0) for name in opened.unknowns[opened.joint_parameters :]]
            moved = opened.displaced(np.array(z)) if z else opened
            of_trial = eliminate(moved.equations(coefficients, moved.body(fit.parameters)))
            places = moved.places_in(names)
            out[np.ix_(places, places)] += of_trial.hessian / nu**2
    return out[: len(unknowns), len(unknowns) :]
