"""Estimate the noise of trials in the directions that their joints forbid.

Noise of a trial: the part of the markers' errors that a joint can see. A segment's markers follow
the segment (its rigid fit) up to their deformation; the linkage follows the rigid fits up to
movements that its joints forbid. Joint parameters act on the second part alone. Let U N be the
displacements of visible markers by rigid motions of their segments, whose six components are
splines of the trial with control points N, and P the projector on these. With d = P r, r the
weighted residuals of the linkage,

    nu^2 = tau / D * sum |d|^2 * n / (n - p),     D = sum_f c_f,     n = D / tau,
    c_f = (1 - rank(J) / sum_s rank(B_s)) sum_s rank(B_s) v_s / u_s,
    tau^2 = (1 + 2 sum_k rho_k) (1 + 2 sum_k a_k rho_k).

P takes all frames together. Projected frame by frame, a segment that shows two of its markers by
turns would count deformations of its skin as motions. c_f are the directions that joints forbid: a
segment has as many as its markers show (rank(B_s): six of three markers, five of two, three of
one), and the linkage takes as many as its coordinates move these markers in. These are the u_s
markers that any frame of the same knot span shows, as splines connect the frames of a span; the
frame itself shows v_s of them. In a complete trial c_f = sum_s rank(B_s) - rank(J). Segments with
fewer than three markers leave their joints out, if joints between others remain. If none remains,
all count, each marker of such a segment by itself: a pair shows the deformation of its skin in one
direction, which serves as well as the others.

rho_k is the autocorrelation of d (products of samples, over those of errors that do not change, in
the same pairs of the same markers), a_k how often a sample that is k frames from a visible one is
visible, too. rho_k is at most that of any smaller lag, and zero from the first that is not positive
(initial monotone sequence: Geyer, Statistical Science 7:473-483, 1992). A sum that ended at a
threshold would double where chance, or a few missing samples, keeps rho_k above it. Once smoothed,
errors that last no longer than the splines and slower ones look alike; the first ask for a_k
(samples that are missing repeat no other), the second for 1. tau is the geometric mean: with half
of the samples missing nu is at most 19 % from either.

n are the independent samples and p the joint parameters that these have to serve. A cost divided by
nu^2 counts every sample as if it were independent: slow noise in a
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
from gaitcal.tracking.banded import BandFactor
from gaitcal.tracking.marker_residual import MarkerData
from gaitcal.tracking.rigid import FEWEST_MARKERS
from gaitcal.tracking.soft_tissue import build_rigid_pattern

# Autocorrelation that counts as none
TINY = 1e-12
LEAST_PAIRS = 0.5  # Pairs of visible samples are counted by a Fourier transform, not exactly
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
    # products of errors that are the same at every lag: pairs of large and of small ones differ
    size = np.sqrt(((errors * known) ** 2).sum(axis=0) / np.maximum(known.sum(axis=0), 1.0))
    expected = _sum_lagged_products(size * known)
    lags = np.arange(1, max(int(nf * LONGEST_LAG), 2))
    shown = lags[pairs[lags] > LEAST_PAIRS]
    if not len(shown):
        return 1.0
    # The sum ends at the last lag that some pair shows.
    lags = lags[: shown[-1]]
    # A trial of nf frames has at most nf - k pairs at lag k; fewer pairs mean missing samples.
    share = np.clip(pairs[lags] / pairs[0] * nf / (nf - lags), 0.0, 1.0)
    rho = power[shown] / np.maximum(expected[shown], TINY * power[0])
    # lags that no pair shows decay exponentially between those beside them
    logs = np.log(np.maximum(rho, TINY))
    falling = np.minimum.accumulate(np.exp(np.interp(lags, [0, *shown], [0.0, *logs])))
    every, of_visible = float(falling.sum()), float((share * falling).sum())
    return float(np.sqrt((1.0 + 2.0 * every) * (1.0 + 2.0 * of_visible)))


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
    every = np.ones(len(model), dtype=bool)
    for counted_markers, rigid in (
        (_find_full_clusters(problem.data), True),
        (every, True),
        (every, False),
    ):
        some = problem.with_weight(problem.data.weight * counted_markers[:, None])
        clusters = _list_clusters(some.data, rigid=rigid)
        directions = _count_forbidden_directions(some, clusters, model, coefficients, parameters)
        if (directions > 0).any():
            break
    weight = some.data.weight
    residual = np.sqrt(weight)[:, None] * (problem.data.measured - model)
    smooth = np.zeros_like(residual)
    for markers in clusters:
        columns = _make_columns(model[markers], weight[markers], rigid=rigid)
        smooth[markers] = _project_on_splines(residual[markers], columns, problem.basis)
    counted = (weight > 0) & (directions > 0)
    smooth *= counted[:, None]
    total = max(float(directions.sum()), 1.0)
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


def _list_clusters(data: MarkerData, *, rigid: bool) -> list[IntArray]:
    """List the markers that move together: those of a segment, or single ones.

    Markers of a segment with fewer than three weighted ones are single; if not `rigid`, all are.
    """
    full, out = _find_full_clusters(data), list[IntArray]()
    for _, group in data.placed.groups:
        markers = np.arange(group.start, group.stop)
        together = rigid and full[markers].all()
        out += [markers] if together else list(markers[:, None])
    return out


def _make_columns(model: Array, weight: Array, *, rigid: bool) -> Array:
    """Make the columns (nf, 3 nm, 6 or 3) of a cluster's rigid motions on weighted markers.

    `model` (nm, 3, nf) m are its markers, of which a single one is translated only. Rotations are
    in units of one that moves markers as far as a translation does.
    """
    count, _, nf = model.shape
    root = np.sqrt(weight).T
    if count == 1 or not rigid:
        return np.asarray(root[:, :, None] * np.eye(3))
    used = (weight > 0).any(axis=1)
    arm = (model - model[used].mean(axis=0)).transpose(2, 0, 1)
    size = max(float(np.sqrt(np.mean(arm**2))), 1e-6)
    pattern = build_rigid_pattern((arm / size).reshape(-1, 3)).reshape(nf, count, 3, -1)
    return np.asarray((root[:, :, None, None] * pattern).reshape(nf, 3 * count, -1))


def _project_on_splines(residual: Array, columns: Array, basis: spline.SplineBasis) -> Array:
    """Project weighted residuals (nm, 3, nf) m on motions of a cluster that are splines.

    `columns` (nf, 3 nm, k) are zero where no marker is visible: U N with (U^T U) N = U^T r, where
    U are the columns times the basis.
    """
    count, _, nf = residual.shape
    width, nn = columns.shape[-1], basis.control_points
    flat = residual.transpose(2, 0, 1).reshape(nf, -1, 1)
    gradient = (columns.transpose(0, 2, 1) @ flat)[:, :, 0]
    grams = (columns.transpose(0, 2, 1) @ columns).reshape(nf, -1)
    blocks, right = np.zeros((nn, spline.ORDER, width**2)), np.zeros((nn, width))
    for block in basis.stretches:
        summed = block.products @ grams[block.frames]
        blocks[block.nodes] += summed.reshape(-1, spline.ORDER, width**2)
        right[block.nodes] += block.weights @ gradient[block.frames]
    # Row (control point a, component j), column (a + d, component i): band[a, j, d k + i - j]
    band = np.zeros((nn, width, spline.ORDER * width))
    for d in range(spline.ORDER):
        for j in range(width):
            first = j if d == 0 else 0
            start = d * width + first - j
            row = blocks[:, d, j * width + first : (j + 1) * width]
            band[:, j, start : start + width - first] = row
    band[:, :, 0] += spline.GAP_FLOOR * max(float(band[:, :, 0].max()), 1e-300)
    motion = BandFactor(band.reshape(nn * width, -1)).solve(right.ravel()).reshape(nn, width)
    projected = columns @ basis.evaluate(motion)[:, :, None]
    return np.asarray(projected.reshape(nf, count, 3).transpose(1, 2, 0))


def _count_forbidden_directions(
    problem: trial_problem.MotionProblem,
    clusters: Sequence[IntArray],
    model: Array,
    coefficients: Array,
    parameters: Parameters,
) -> Array:
    """Count the directions c (nf,) that joints forbid, as far as a frame shows their clusters."""
    visible = np.asarray(problem.data.weight > 0)
    together = _find_visible_in_span(visible, problem.basis)
    # one frame of each set of markers stands for all others
    _, first, which = np.unique(together, axis=1, return_index=True, return_inverse=True)
    order = np.argsort(first)
    frames, of_frame = first[order], np.argsort(order)[which.ravel()]
    taken = _count_linkage_directions(
        problem.with_weight(together.astype(np.float64)), frames, coefficients, parameters
    )
    shown, of_markers = np.zeros(len(frames)), np.zeros(visible.shape[1])
    for markers in clusters:
        columns = _make_columns(
            model[markers][..., frames], together[markers][:, frames].astype(float), rigid=True
        )
        values = np.linalg.eigvalsh(columns.transpose(0, 2, 1) @ columns)
        ranks = (values > RANK_TOLERANCE * np.maximum(values[:, -1:], 1e-300)).sum(axis=1)
        share = visible[markers].sum(axis=0) / np.maximum(together[markers].sum(axis=0), 1)
        shown += ranks
        of_markers += ranks[of_frame] * share
    forbidden = np.maximum(1.0 - taken / np.maximum(shown, 1.0), 0.0)
    return np.asarray(of_markers * forbidden[of_frame])


def _find_visible_in_span(visible: BoolArray, basis: spline.SplineBasis) -> BoolArray:
    """Find the markers (nm, nf) that are visible in any frame of the same knot span.

    Within a span splines connect all frames, so markers that are visible by turns determine as many
    directions as if they were visible together.
    """
    out = np.empty_like(visible)
    for _, frames in basis.spans:
        out[:, frames] = visible[:, frames].any(axis=1, keepdims=True)
    return out


def _count_linkage_directions(
    problem: trial_problem.MotionProblem,
    frames: IntArray,
    coefficients: Array,
    parameters: Parameters,
) -> IntArray:
    """Count the directions (n,) in which the coordinates move the visible markers of n frames."""
    some = replace(
        problem, basis=problem.basis.select_frames(frames), data=problem.data.select_frames(frames)
    )
    q = problem.basis.evaluate(coefficients)[frames]
    hessian = some.compute_frame_hessians(q, some.build_body(parameters))
    size = np.sqrt(np.einsum("fii->fi", hessian))
    inverse = np.where(size > 0, 1.0 / np.where(size > 0, size, 1.0), 0.0)
    values = np.linalg.eigvalsh(hessian * inverse[:, :, None] * inverse[:, None, :])
    ranks = (values > RANK_TOLERANCE * np.maximum(values[:, -1:], 1e-300)).sum(axis=1)
    return np.asarray(ranks, dtype=np.intp)


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
