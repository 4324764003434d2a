"""Estimate the noise of trials in the directions that their joints forbid.

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

A noise has a prior itself, at 100 Hz ln nu ~ N(ln m, s^2) by kind of task (`get_noise_prior`), and
an estimate of it has an error. It comes from n - p samples, and its fit absorbs errors in
proportion to the joint angles. That is much in an isolated trial, which has nearly as many joint
parameters as its motion has harmonics. It makes the estimate too low, never too high. With
v = 1 / 2 (n - p) + a^2, a how far ln nu may be too low, the most probable noise is

    ln nu = max(ln nu_hat, (ln nu_hat / v + ln m / s^2) / (1 / v + 1 / s^2)).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gaitcal.arrays import Array, BoolArray, IntArray
from gaitcal.model.linkage import ISOLATED_JOINTS
from gaitcal.model.parameters import Parameters
from gaitcal.model.subject_model import PointNoise
from gaitcal.tracking import spline, trial_problem
from gaitcal.tracking.marker_residual import MarkerData
from gaitcal.tracking.rigid import FEWEST_MARKERS
from gaitcal.tracking.soft_tissue import build_rigid_pattern

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
