"""What markers do, whatever they are called: which keep their distance, which way the person faces, where they stand.

Skin moves the markers of a segment against each other by some millimetres; those of two segments change their distance
by a few centimetres and more as joints turn. S_ij, the standard deviation of the distance of markers i and j over a
trial (the largest over all of them; half of what its mean differs between two trials, where that is more), is
log-normal about ON_ONE if they are on one segment, about APART if not.

Where a foot is higher it swings forward, over the ground and on a treadmill, and where it is lower it stays, or goes
back with the belt. With h the height and u the horizontal velocity of a low marker, in the axes of the standing person
(`_turns_to`: the turn about the vertical that fits all markers best),

    forward ~ sum over frames of (h - mean h) (u - mean u),

by each foot for itself; what counts is in how far both say the same, 2 min(a, b) / (a + b) with a and b how much each
says, and a recording counts by 2 min(a, b): one in which one foot moves says nothing.
"""

import warnings
from collections.abc import Sequence

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage

from gaitcal.arrays import Array, IntArray
from gaitcal.io.recording import Recording, seen_mask, still_window
from gaitcal.motion.rigid import best_rotation

ON_ONE, APART = (0.005, 0.8), (0.05, 1.2)
"""Median of S_ij (m) and standard deviation of its logarithm, of two markers on one segment and on two: skin and flesh
against bone move by 5 mm RMS, give or take a factor of two (Leardini et al., Gait Posture 21:212-225, 2005)."""
MOST_FRAMES = 150
FEWEST_FRAMES = 10
LAG_S = 0.05
LOW_M = 0.16
"""Height over the lowest marker of those that are taken for the feet's."""
SEEN_BESIDE = 6
"""Markers, those that keep their distance best, by which one is placed that the static trial lacks."""


def standing_points(recording: Recording, labels: Sequence[str]) -> Array:
    """(n, 3) m, where markers are in the stillest part of a recording; NaN of those that are not seen in it.

    InputError where nobody stands still in it.
    """
    frames = still_window(recording, labels).frames
    out = np.full((len(labels), 3), np.nan)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # all NaN: not seen
        for i, label in enumerate(labels):
            if label in recording.labels:
                path = recording.markers[:, recording.labels.index(label)]
                still = np.nanmean(path[frames], axis=0)
                out[i] = still if np.isfinite(still).all() else np.nanmean(path, axis=0)
    return out


def distance_scatter(recordings: Sequence[Recording], labels: Sequence[str], standing: Array | None = None) -> Array:
    """(n, n) m, S_ij; NaN where two markers are never seen together for long enough. `standing`: (n, 3) m, where they
    are in a further trial, in which nothing moves.
    """
    number = {label: i for i, label in enumerate(labels)}
    out = np.full((len(labels), len(labels)), np.nan)
    low, high = np.full_like(out, np.nan), np.full_like(out, np.nan)
    if standing is not None:
        low = high = np.linalg.norm(standing[:, None] - standing, axis=2)
        low, high = low.copy(), high.copy()
    for recording in recordings:
        columns = [c for c, label in enumerate(recording.labels) if label in number]
        markers = recording.markers[:: max(1, len(recording.markers) // MOST_FRAMES)][:, columns]
        seen = seen_mask(markers)
        both = seen.T.astype(np.float64) @ seen
        if not (both >= FEWEST_FRAMES).any():
            continue
        apart = np.linalg.norm(markers[:, :, None] - markers[:, None], axis=3)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)
            scatter = np.where(both >= FEWEST_FRAMES, np.nanstd(apart, axis=0), np.nan)
            mean = np.where(both >= FEWEST_FRAMES, np.nanmean(apart, axis=0), np.nan)
        rows = np.ix_(*[[number[recording.labels[c]] for c in columns]] * 2)
        out[rows] = np.fmax(out[rows], scatter)
        low[rows], high[rows] = np.fmin(low[rows], mean), np.fmax(high[rows], mean)
    return np.where(np.isfinite(out), np.fmax(out, 0.5 * (high - low)), np.nan)


def on_one_segment(scatter: Array) -> Array:
    """(n, n) log ratio of the likelihoods that two markers are on one segment or on two; 0 where nothing is known."""
    log = np.log(np.maximum(scatter, 1e-3))

    def density(median: float, deviation: float) -> Array:
        out: Array = -0.5 * np.square((log - np.log(median)) / deviation) - np.log(deviation)
        return out

    out = np.nan_to_num(density(*ON_ONE) - density(*APART))
    np.fill_diagonal(out, 0.0)
    return out


def with_missing(points: Array, labels: Sequence[str], recordings: Sequence[Recording], scatter: Array) -> Array:
    """`points` (n, 3) with markers that only the moving trials have, placed by those that they move with."""
    out = points.copy()
    known = np.isfinite(points).all(axis=1)
    for i in np.flatnonzero(~known):
        beside = np.flatnonzero(known & np.isfinite(scatter[i]))
        beside = beside[np.argsort(scatter[i, beside])][:SEEN_BESIDE]
        for recording in recordings:
            wanted = [labels[k] for k in (i, *beside)]
            if len(beside) < 3 or not set(wanted) <= set(recording.labels):
                continue
            paths = recording.markers[:, [recording.labels.index(label) for label in wanted]]
            paths = paths[seen_mask(paths).all(axis=1)][:MOST_FRAMES]
            if len(paths) < FEWEST_FRAMES:
                continue
            middle, place = paths[:, 1:].mean(axis=1), points[beside].mean(axis=0)
            moments = np.einsum("fmi,mj->ijf", paths[:, 1:] - middle[:, None], points[beside] - place)
            turn = best_rotation(moments)[0]
            out[i] = place + np.einsum("ijf,fi->fj", turn, paths[:, 0] - middle).mean(axis=0)
            break
    return out


def _turns_to(markers: Array, points: Array) -> Array:
    """(nf,) rad, turn about the vertical that brings markers (nf, n, 3) nearest to where they stand (n, 3)."""
    seen = seen_mask(markers).astype(np.float64)[..., None]
    count = np.maximum(seen.sum(axis=1), 1.0)
    x = np.where(seen > 0, markers, 0.0)
    here = x - (x * seen).sum(axis=1, keepdims=True) / count[:, None]
    there = points[None] - ((seen * points).sum(axis=1) / count)[:, None]
    along = (seen[..., 0] * (here[..., 0] * there[..., 0] + here[..., 2] * there[..., 2])).sum(axis=1)
    across = (seen[..., 0] * (here[..., 0] * there[..., 2] - here[..., 2] * there[..., 0])).sum(axis=1)
    out: Array = np.arctan2(across, along)
    return out


def forward_direction(recordings: Sequence[Recording], points: Array, labels: Sequence[str]) -> Array:
    """(2,) horizontal direction (x, z) in which the person faces who stands at `points` (n, 3); its length, 0 to 1, is
    how far both feet of all recordings say the same. Zero where nobody walks.
    """
    total, weight = np.zeros(2), 0.0
    known = {label: k for k, label in enumerate(labels) if np.isfinite(points[k]).all()}
    for recording in recordings:
        columns = [c for c, label in enumerate(recording.labels) if label in known]
        lag = max(1, round(LAG_S * recording.rate)) if len(recording.time) > 1 else 1
        if len(columns) < 4 or len(recording.time) < FEWEST_FRAMES + 2 * lag:
            continue
        names = [recording.labels[c] for c in columns]
        standing = points[[known[name] for name in names]]
        markers = recording.markers[:, columns]
        low = standing[:, 1] < standing[:, 1].min() + LOW_M
        feet = _two_groups(distance_scatter([recording], [n for n, k in zip(names, low, strict=True) if k]))
        if feet is None:
            continue
        turn = _turns_to(markers, standing)[lag:-lag, None]
        velocity = (markers[2 * lag :, low] - markers[: -2 * lag, low]) / (2 * lag / recording.rate)
        height = markers[lag:-lag, low, 1]
        cos, sin = np.cos(turn), np.sin(turn)
        u = np.stack([cos * velocity[..., 0] - sin * velocity[..., 2], sin * velocity[..., 0] + cos * velocity[..., 2]])
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)
            swing = np.nansum((height - np.nanmean(height, axis=0)) * (u - np.nanmean(u, axis=1)[:, None]), axis=1)
        one, other = swing[:, feet == 1].sum(axis=1), swing[:, feet == 2].sum(axis=1)
        sizes = np.linalg.norm(one), np.linalg.norm(other)
        both = 2 * float(min(sizes))
        weight += both
        if one @ other > 0:
            total += both**2 / float(sum(sizes)) * (one + other) / float(np.linalg.norm(one + other))
    out: Array = total / weight if weight > 0 else total
    return out


def _two_groups(scatter: Array) -> IntArray | None:
    """(n,) 1 or 2, which low markers move together: those of a foot; None where there are no two."""
    if len(scatter) < 2 or not np.isfinite(scatter).any():
        return None
    pairs = np.nan_to_num(scatter, nan=float(np.nanmax(scatter)))[np.triu_indices(len(scatter), 1)]
    return np.asarray(fcluster(linkage(pairs, "average"), 2, "maxclust"), dtype=np.intp)
