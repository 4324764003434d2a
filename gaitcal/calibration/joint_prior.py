"""Priors of joint parameters, and the noise of trials.

Deviations d from nominal values are N(m0, P0): from anatomy (`TABLE`), with means and
deviations of a study file (`[calibration] joint_prior`) if any, or from a cohort, which replaces
both (`make_study_prior`).

A joint centre is one position of one bone end, described in two segments: hip in pelvis and thigh,
knee in thigh and shank, the talus in shank and foot, and the subtalar axis in talus and foot. An
error of a landmark or regression is the same in both. In each direction

    cov(parent, child) = [ d^2   d^2       ]      d: the centre about its nominal position,
                         [ d^2   d^2 + a^2 ]      a: difference between the two segments.

The lower triangle [d, 0; d, a] is the Cholesky root F of that: its columns are the causes, the
error of the centre under the parent's name and the difference under the child's. Markers that are
attached again move the centre in both segments alike (`make_shared_centre_covariance`), and do not
change the second cause.

`TABLE` has mean, d and a; their sources:

hip         Harrington's regression against computed tomography of 29 people, 39 hips: 6.5 mm
            forward, 6.9 up, 7.0 lateral (SD; landmarks of Fischer 2019 to 2023; `python -m
            scripts.validation people --parts hips`). Palpation and flesh over the ASIS come on top,
            10, 8 and 6 mm (Della Croce et al., Gait Posture 21:226-237, 2005): 11.9, 10.6 and 9.2
            together, known to a tenth. The means, 2.3, 1.9 and 0.2 mm, differ between both sources
            by 4 mm, and flesh moves markers the other way: none is taken.
knee        five raters put the middle of the epicondyles of 19 femurs in images within 1.7 mm along
            each axis, and their line within 2 degrees; palpated ones scatter by some 4 mm and 5 to
            10 degrees about the thigh, by less in the frontal plane (Della Croce 2005). The axis
            about which tracked bones flex is 10 mm (RMS along each axis, four people) and 5 degrees
            from the transepicondylar one (`bones`).
talocrural  its axis runs just below the tips of the malleoli (Inman 1976), markers sit on their
            most prominent points, in front of its middle: 5 mm behind and 10 mm below; axes of
            living ankles scatter by 9 to 11 degrees.
subtalar    deviates by 23 +- 11 degrees (nominal) from the midline of cadavers' feet (Inman 1976),
            by 18 +- 16 of living ones (van den Bogert et al., J Biomech 27:1477-1488, 1994): one
            axis, described in talus and foot. It is inclined by 42 +- 9 degrees, so the scatter in
            the talus is smaller (12 for 16 in the foot: common 14, difference 6); its position is
            that of the talocrural axis.
others      20 mm and 10 degrees: landmarks of trunk and arms, which one hinge or ball stands for.

Noise of a trial: the part of the markers' errors that a joint can see. A segment's markers follow
the segment (its rigid fit) up to their deformation; the linkage follows the rigid fits up to
movements that its joints forbid. Joint parameters act on the second part alone. In frame f let P
project the weighted residuals r of the linkage on the displacements of visible markers by rigid
motions of its segments. With d = P r, smoothed in each marker by the trial's splines, fitted to its
visible samples only,

    nu^2 = tau / D * sum |d|^2 * n / (n - p),     D = sum_f c_f,     n = D / tau,
    c_f = sum_s rank(P_s) - rank(J_f),            tau = 1 + 2 sum_k a_k rho_k.

c_f are the directions that joints forbid in the frame: a segment has as many as its visible markers
show (six of three markers, five of two, three of one), and the linkage takes as many as its
coordinates move these markers in. Segments count frame by frame, so that one which is never or
seldom complete removes only its share. Segments with fewer than three markers leave their joints
out, if joints between others remain. If none remains, all count, with P = 1 for such a segment: a
pair shows the deformation of its skin in one direction, which serves as well as the others.
rho_k is the autocorrelation of d (summed until it first falls below 0.05; Bartlett 1946), a_k^2 how
often a sample that is k frames from a visible one is visible, too. Once smoothed, errors that last
no longer than the splines and slower ones look alike; the first ask for a_k^2 in its place (samples
that are missing repeat no other), the second for 1. With half of the samples missing nu is 19 %
from either. n are the independent samples and p the joint parameters that these have
to serve. A cost divided by nu^2 counts every sample as if it were independent: slow noise in a
short trial weighs little. White noise of variance s^2 gives nu = s; clusters that move as a whole
against their bones give more than their deformation shows.

A noise has a prior itself, at 100 Hz ln nu ~ N(ln m, s^2) by kind of task (`PEOPLE_NOISE`), and an
estimate of it has an error. It comes from n - p samples, and its fit absorbs errors in proportion
to the joint angles. That is much in an isolated trial, which has nearly as many joint parameters as
its motion has harmonics. It makes the estimate too low, never too high. With v = 1 / 2 (n - p) +
a^2, a how far ln nu may be too low, the most probable noise is

    ln nu = max(ln nu_hat, (ln nu_hat / v + ln m / s^2) / (1 / v + 1 / s^2)).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gaitcal.arrays import Array, BoolArray, IntArray
from gaitcal.model.linkage import ISOLATED_JOINTS
from gaitcal.model.parameters import (
    JOINT_PARAMETERS,
    JP_INDEX,
    JP_NAMES,
    JP_TO_SI,
    ParameterKind,
    Parameters,
)
from gaitcal.model.subject_model import PointNoise
from gaitcal.study.cohort_prior import SIDES_OF, JointPrior
from gaitcal.study.settings import ParameterPriorTable
from gaitcal.tracking import spline, trial_problem
from gaitcal.tracking.marker_residual import MarkerData
from gaitcal.tracking.rigid import FEWEST_MARKERS
from gaitcal.tracking.soft_tissue import build_rigid_pattern


@dataclass(frozen=True, kw_only=True)
class _Row:
    """One direction of one joint, in mm or deg."""

    parameters: tuple[str, ...]  # Parent's, then child's, without side
    deviation: float
    segment_difference: float = 0.0
    mean: float = 0.0

    @property
    def by_side(self) -> tuple[list[int], ...]:
        """Indices of its parameters, for each side."""
        right, left = list[int](), list[int]()
        for name in self.parameters:
            right_name, left_name = SIDES_OF[name]
            right.append(JP_INDEX[right_name])
            left.append(JP_INDEX[left_name])
        return right, left


def _make_rows(
    joint: str,
    parent: str,
    child: str,
    directions: str,
    deviation: Sequence[float],
    difference: float,
) -> tuple[_Row, ...]:
    """Make the rows of a bone end in two adjacent segments."""
    return tuple(
        _Row(
            parameters=(f"{joint}.{parent}.{name}", f"{joint}.{child}.{name}"),
            deviation=d,
            segment_difference=difference,
        )
        for name, d in zip(directions.split(), deviation, strict=True)
    )


TABLE: tuple[_Row, ...] = (
    *_make_rows("hip", "pelvis", "thigh", "ant sup lat", (12.0, 10.0, 9.0), 4.0),
    *_make_rows("knee", "thigh", "shank", "ant sup", (10.0, 10.0), 4.0),
    _Row(parameters=("knee.shank.lat",), deviation=10.0),
    *_make_rows("knee", "thigh", "shank", "front trans", (6.0, 10.0), 4.0),
    _Row(
        parameters=("talocrural.shank.ant", "subtalar.foot.ant"),
        deviation=8.0,
        segment_difference=5.0,
        mean=-5.0,
    ),
    _Row(
        parameters=("talocrural.shank.sup", "subtalar.foot.sup"),
        deviation=8.0,
        segment_difference=5.0,
        mean=-10.0,
    ),
    _Row(
        parameters=("talocrural.shank.lat", "subtalar.foot.lat"),
        deviation=8.0,
        segment_difference=5.0,
    ),
    _Row(
        parameters=("subtalar.talus.trans", "subtalar.foot.trans"),
        deviation=14.0,
        segment_difference=6.0,
        mean=-4.0,
    ),
)
"""Joints of the legs; all others have `OTHER_MM` or `OTHER_DEG`."""
OTHER_MM, OTHER_DEG = 20.0, 10.0
OTHER_DEVIATIONS = np.where(
    [p.kind is ParameterKind.POSITION for p in JOINT_PARAMETERS], OTHER_MM, OTHER_DEG
)  # (98,) mm, deg


def _find_shared_parameters() -> IntArray:
    """Find the parameter whose error each joint parameter shares."""
    out = np.arange(len(JP_NAMES))
    for row in TABLE:
        for indices in row.by_side:
            out[indices] = indices[0]
    return out


SHARED_PARAMETER_INDEX = _find_shared_parameters()
"""(98,) index of the parameter with the same joint centre error: that of the same direction in the
parent segment; of all others their index.
"""


def make_shared_centre_covariance(deviation: Array) -> Array:
    """Make the covariance of joint centre errors that both adjacent segments share.

    Parameters
    ----------
    deviation : (98,) array
        Standard deviations, m and rad; of a shared error that of the parent segment is used.

    Returns
    -------
    (98, 98) array
        m^2, m rad and rad^2.
    """
    size = deviation[SHARED_PARAMETER_INDEX]
    return np.outer(size, size) * (SHARED_PARAMETER_INDEX[:, None] == SHARED_PARAMETER_INDEX)


def _make_anatomy_prior() -> JointPrior:
    """Make the prior of anatomy from `TABLE`."""
    mean, difference = np.zeros(len(JP_NAMES)), np.zeros(len(JP_NAMES))
    deviation = OTHER_DEVIATIONS.copy()
    for row in TABLE:
        for side, indices in enumerate(row.by_side):
            mirrored = np.array([JOINT_PARAMETERS[k].mirrored for k in indices])
            mean[indices] = row.mean * np.where(mirrored & (side == 1), -1.0, 1.0)
            deviation[indices], difference[indices[1:]] = row.deviation, row.segment_difference
    covariance = make_shared_centre_covariance(JP_TO_SI * deviation) + np.diag(
        (JP_TO_SI * difference) ** 2
    )
    return JointPrior(names=JP_NAMES, mean=JP_TO_SI * mean, covariance=covariance)


ANATOMY = _make_anatomy_prior()
WEAK = JointPrior(
    names=JP_NAMES,
    mean=np.zeros(len(JP_NAMES)),
    covariance=np.diag((JP_TO_SI * OTHER_DEVIATIONS) ** 2),
)
"""Of the published protocol, where it has one (`prior = "weak"`): the same for all joints, none
tied to another.
"""
MEAN, COVARIANCE = ANATOMY.mean, ANATOMY.covariance


def get_prior_deviations(names: Sequence[str]) -> Array:
    """Get standard deviations (n,) of joint parameters by anatomy, m and rad."""
    return np.sqrt(np.diag(COVARIANCE))[[JP_INDEX[name] for name in names]]


def select_prior(names: Sequence[str], prior: JointPrior | None) -> tuple[Array, Array]:
    """Select the prior of deviations from nominal values for some joint parameters.

    Parameters
    ----------
    names : sequence of str
        Joint parameters.
    prior : JointPrior or None
        Prior of some parameters; anatomy's for the others.

    Returns
    -------
    tuple of array
        Mean m0 (n,) and covariance P0 (n, n), m and rad.
    """
    at, whole = (
        [JP_INDEX[name] for name in names],
        ANATOMY if prior is None else ANATOMY.update(prior),
    )
    return whole.mean[at], whole.covariance[np.ix_(at, at)]


def factor_prior(names: Sequence[str], prior: JointPrior | None) -> Array:
    """Factor the prior covariance: F (n, n), lower triangular, F F^T = P0.

    Parameters
    ----------
    names : sequence of str
        Joint parameters.
    prior : JointPrior or None
        As in `select_prior`.

    Returns
    -------
    (n, n) array
        Each column is the effect of one cause, under its parameter's name.
    """
    return np.asarray(np.linalg.cholesky(select_prior(names, prior)[1]), float)


def make_study_prior(
    given: Mapping[str, ParameterPriorTable],
    learnt: JointPrior | None = None,
    noise: PointNoise | None = None,
) -> JointPrior:
    """Make the prior of all joint parameters by anatomy, study file and cohort.

    A study file gives mean and standard deviation of a parameter, and correlations stay those of
    anatomy. Rows and columns of P0 are scaled. Both parameters of a shared centre, with deviations
    d and e and correlation c, may then differ by (d^2 + e^2 - 2 c d e)^1/2. A name without a side
    is for both, the left as the mirror image of the right. A name with a side takes precedence.

    Parameters
    ----------
    given : mapping of str to ParameterPriorTable
        Entries of the study file, mm and deg; they replace anatomy's.
    learnt : JointPrior, optional
        Prior of a cohort; it replaces both.
    noise : PointNoise, optional
        For points that are no markers: anatomy's deviations times `joints`, for hinges times
        `hinges`.

    Returns
    -------
    JointPrior
        m and rad.
    """
    mean, scale = MEAN.copy(), np.ones(len(JP_NAMES))
    if noise is not None:
        positions = [p.kind is ParameterKind.POSITION for p in JOINT_PARAMETERS]
        scale = np.where(positions, noise.joints, noise.hinges)
    for name in sorted(given, key=lambda name: name in JP_INDEX):
        for side, parameter in enumerate(SIDES_OF[name]):
            k, entry = JP_INDEX[parameter], given[name]
            if entry.mean is not None:
                mean[k] = (
                    JP_TO_SI[k]
                    * entry.mean
                    * (-1.0 if side and JOINT_PARAMETERS[k].mirrored else 1.0)
                )
            if entry.deviation is not None:
                scale[k] = JP_TO_SI[k] * entry.deviation / np.sqrt(COVARIANCE[k, k])
    of_study = tuple(dict.fromkeys(parameter for name in given for parameter in SIDES_OF[name]))
    notes = (f"priors from the study file: {', '.join(given)}",) if given else ()
    covariance = np.outer(scale, scale) * COVARIANCE
    prior = replace(ANATOMY, mean=mean, covariance=covariance, of_study=of_study, notes=notes)
    if learnt is None:
        return prior
    return replace(prior.update(learnt), of_cohort=learnt.names, notes=(*notes, *learnt.notes))


UNCORRELATED = 0.05  # Autocorrelation below which the sum ends
# Of the trial: beyond, too few pairs of frames are left
LONGEST_LAG = 1.0 / 3.0
# Smallest share of the independent samples that is left after the parameters are taken off
LEAST_SAMPLES = 0.3
# Share of the largest eigenvalue below which markers do not determine a direction
RANK_TOLERANCE = 1e-8
# m, s: smallest error of cameras, and how long it lasts at least
LEAST_ERROR, MEMORY_S = 5e-5, 0.25


@dataclass(frozen=True)
class ForbiddenNoise:
    """Noise of one trial in the directions that its joints forbid."""

    # m^2, tau times the mean square of d per direction and frame
    variance: float
    samples: float  # n, independent ones


def estimate_frames_per_sample(errors: Array, visible: BoolArray | None = None) -> float:
    """Estimate tau, the number of samples for one that is independent.

    Parameters
    ----------
    errors : (nf, k) array
        Errors; all columns are taken together.
    visible : (nf, k) bool array, optional
        Samples that count; all if not given.

    Returns
    -------
    float
        At least 1 for errors without correlation.
    """
    nf = len(errors)
    known = np.ones(errors.shape) if visible is None else visible.astype(np.float64)
    power, pairs = _sum_lagged_products(errors * known), _sum_lagged_products(known)
    if power[0] <= 0.0:
        return 1.0
    lags = np.arange(1, max(int(nf * LONGEST_LAG), 2))
    rho = power[lags] / power[0] * pairs[0] / np.maximum(pairs[lags], 1.0)
    # A trial of nf frames has at most nf - k pairs at lag k; fewer pairs mean missing samples.
    shown = np.sqrt(np.clip(pairs[lags] / pairs[0] * nf / (nf - lags), 0.0, 1.0))
    small = np.flatnonzero(rho < UNCORRELATED)
    summed = slice(small[0] if len(small) else None)
    return 1.0 + 2.0 * float((shown * rho)[summed].sum())


def _sum_lagged_products(columns: Array) -> Array:
    """Sum products of entries so many rows apart, over all columns (nf, k): (nf,)."""
    nf = len(columns)
    spectrum = np.abs(np.fft.rfft(columns, 2 * nf, axis=0)) ** 2
    return np.asarray(np.fft.irfft(spectrum.sum(axis=1))[:nf], float)


def compute_least_noise(basis: spline.SplineBasis, noise: PointNoise | None = None) -> float:
    """Compute the smallest nu (m) that is assumed: of cameras, or of points that are no markers.

    Parameters
    ----------
    basis : SplineBasis
        Splines of the trial, for its frame rate.
    noise : PointNoise, optional
        Errors of points that are no markers.

    Returns
    -------
    float
        m.
    """
    if noise is not None:
        return noise.compute_least_noise(spline.compute_frame_rate(basis))
    return LEAST_ERROR * float(np.sqrt(max(MEMORY_S * spline.compute_frame_rate(basis), 1.0)))


def estimate_forbidden_noise(
    problem: trial_problem.MotionProblem, parameters: Parameters, coefficients: Array
) -> ForbiddenNoise:
    """Estimate the noise of a trial at a motion.

    If no joint is between segments with visible markers, d is the residual of all
    markers, in c = 3 (visible markers) - rank(J) directions.

    Parameters
    ----------
    problem : MotionProblem
        The trial, no joint parameter free.
    parameters : Parameters
        Parameters of the linkage.
    coefficients : (nn, nq) array
        The motion.

    Returns
    -------
    ForbiddenNoise
        Variance (m^2) and number of independent samples.
    """
    model = problem.compute_positions(coefficients, problem.build_body(parameters))
    for counted_markers in (_find_full_clusters(problem.data), np.ones(len(model), dtype=bool)):
        weight = problem.data.weight * counted_markers[:, None]
        some = problem.with_weight(weight)
        residual = np.sqrt(weight)[:, None] * (problem.data.measured - model)
        moved, shown = _project_on_rigid_motions(residual, model, some.data)
        taken = _count_linkage_directions(some, coefficients, parameters)
        directions = shown - taken
        if (directions > 0).any():
            break
    else:
        moved, directions = residual, 3 * (weight > 0).sum(axis=0) - taken
    visible = weight > 0
    counted = visible & (directions > 0)
    total = max(float(np.maximum(directions, 0).sum()), 1.0)
    smooth = np.zeros_like(moved)
    patterns, which = np.unique(counted, axis=0, return_inverse=True)
    for k, pattern in enumerate(patterns):
        if not pattern.any():
            continue
        markers = np.flatnonzero(which.ravel() == k)
        columns = moved[markers].reshape(-1, len(pattern)).T
        fitted = problem.basis.evaluate(problem.basis.fit(columns, pattern.astype(float))).T
        smooth[markers] = fitted.reshape(len(markers), 3, -1) * pattern
    tau = estimate_frames_per_sample(
        smooth.reshape(-1, smooth.shape[-1]).T, np.repeat(counted, 3, axis=0).T
    )
    return ForbiddenNoise(tau * float((smooth**2).sum()) / total, total / tau)


def _find_full_clusters(data: MarkerData) -> BoolArray:
    """Find the markers (nm,) of segments with three or more weighted markers."""
    out = np.zeros(len(data.weight), dtype=bool)
    for _, markers in data.placed.groups:
        out[markers] = (data.weight[markers] > 0).any(axis=1).sum() >= FEWEST_MARKERS
    return out


def _project_on_rigid_motions(
    residual: Array, model: Array, data: MarkerData
) -> tuple[Array, IntArray]:
    """Project weighted residuals (nm, 3, nf) m on rigid motions of the segments, to first order.

    Returns the projection, and (nf,) the number of directions of such motions that are visible.
    """
    out, shown = np.zeros_like(residual), np.zeros(residual.shape[-1], dtype=np.intp)
    for _, markers in data.placed.groups:
        weight = data.weight[markers]
        if (weight > 0).any(axis=1).sum() < FEWEST_MARKERS:
            out[markers] = residual[markers]
            shown += 3 * (weight > 0).sum(axis=0)
            continue
        total = np.maximum(weight.sum(axis=0), 1e-12)
        arm = (model[markers] - (weight[:, None] * model[markers]).sum(axis=0) / total).transpose(
            0, 2, 1
        )
        # a rotation in units of one that moves markers as far as a translation does
        size = max(float(np.sqrt(np.mean(arm**2))), 1e-6)
        pattern = build_rigid_pattern((arm / size).reshape(-1, 3)).reshape(*arm.shape[:2], 3, -1)
        columns = (np.sqrt(weight)[:, :, None, None] * pattern).transpose(1, 0, 2, 3)
        # (nf, 3 nm, 6)
        columns = columns.reshape(residual.shape[-1], -1, pattern.shape[-1])
        values, vectors = np.linalg.eigh(columns.transpose(0, 2, 1) @ columns)
        kept = values > RANK_TOLERANCE * values[:, -1:]
        inverse = np.where(kept, 1.0 / np.where(kept, values, 1.0), 0.0)
        basis = columns @ vectors  # orthogonal, of squared length `values`
        flat = residual[markers].transpose(2, 0, 1).reshape(residual.shape[-1], -1, 1)
        projected = basis @ (inverse[:, :, None] * (basis.transpose(0, 2, 1) @ flat))
        out[markers] = projected.reshape(residual.shape[-1], -1, 3).transpose(1, 2, 0)
        shown += kept.sum(axis=1)
    return out, shown


def _count_linkage_directions(
    problem: trial_problem.MotionProblem, coefficients: Array, parameters: Parameters
) -> IntArray:
    """Count the directions (nf,) in which the coordinates move the visible markers.

    They are computed once for all frames with the same visible markers.
    """
    visible = np.asarray(problem.data.weight > 0)
    _, first, which = np.unique(visible, axis=1, return_index=True, return_inverse=True)
    frames = np.sort(first)
    some = replace(
        problem, basis=problem.basis.select_frames(frames), data=problem.data.select_frames(frames)
    )
    q = problem.basis.evaluate(coefficients)[frames]
    hessian = some.compute_frame_hessians(q, some.build_body(parameters))
    size = np.sqrt(np.einsum("fii->fi", hessian))
    inverse = np.where(size > 0, 1.0 / np.where(size > 0, size, 1.0), 0.0)
    values = np.linalg.eigvalsh(hessian * inverse[:, :, None] * inverse[:, None, :])
    ranks = (values > RANK_TOLERANCE * np.maximum(values[:, -1:], 1e-300)).sum(axis=1)
    return np.asarray(ranks[np.searchsorted(frames, first)][which.ravel()], dtype=np.intp)


@dataclass(frozen=True)
class NoisePrior:
    """Log-normal prior of the noise in one kind of task, and how far an estimate may be too low."""

    median: float  # m, at 100 Hz
    spread: float  # s of ln nu
    absorbed: float  # a of ln nu: share of the noise that a fit of the trial's joints may absorb


WALK_NOISE = NoisePrior(0.009, 1.0, 0.0)
"""Seventeen walks of nine people of six laboratories: legs 9 to 23 mm, trunks and arms 1 to 15 mm.
"""
ISOLATED_NOISE = NoisePrior(0.012, 0.8, 1.0)
"""Eight isolated trials of two people: 2.5 to 29 mm, median 12, spread of ln nu 0.8. Separate
fits of one ankle trial had a quarter and four tenths of the noise of its fit together with other
trials (5.3 mm): a factor of e."""


def get_noise_prior(kind: str) -> NoisePrior:
    """Get the noise prior of a kind of task; a walk's for all but functional trials."""
    return ISOLATED_NOISE if kind in ISOLATED_JOINTS else WALK_NOISE


def estimate_trial_noises(
    estimates: Sequence[ForbiddenNoise],
    least: Sequence[float],
    effective_parameters: float,
    priors: Sequence[NoisePrior] | None = None,
    rates: Sequence[float] | None = None,
) -> list[float]:
    """Estimate nu (m) of every trial of a fit.

    Parameters
    ----------
    estimates : sequence of ForbiddenNoise
        Estimate of every trial.
    least : sequence of float
        Smallest noise of every trial, m.
    effective_parameters : float
        Number of parameters that the samples of all trials determine.
    priors : sequence of NoisePrior, optional
        Prior of every trial; none if not given.
    rates : sequence of float, optional
        Frames per second of every trial.

    Returns
    -------
    list of float
        m.
    """
    samples = sum(trial.samples for trial in estimates)
    left = max(samples - effective_parameters - 2.0, LEAST_SAMPLES * samples)
    out = []
    for k, (trial, floor) in enumerate(zip(estimates, least, strict=True)):
        found = max(float(np.sqrt(samples / left * trial.variance)), floor)
        if priors is not None and rates is not None:
            # slow errors at twice the rate are the same errors in twice the samples
            prior, median = priors[k], priors[k].median * float(np.sqrt(rates[k] / 100.0))
            of_data = 1.0 / (0.5 * samples / (left * max(trial.samples, 1.0)) + prior.absorbed**2)
            of_prior = prior.spread**-2.0
            mode = (of_data * np.log(found) + of_prior * np.log(median)) / (of_data + of_prior)
            found = max(found, float(np.exp(mode)))
        out.append(found)
    return out
