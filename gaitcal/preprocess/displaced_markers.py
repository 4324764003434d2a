"""Find markers that are displaced on their segment for a while, and paths that were drawn.

*Strayed:* a marker's distance from its mean position in the trial (`MarkerCluster.strayed`) is far
above its usual one. *Slipped:* the positions of the cluster's markers change from one frame to the
next, and their means over a quarter of a second before and after differ as much, which skin never
does; the marker that jumps in the laboratory is the one that slipped. *Drawn:* software held a path
still, drew it as a line or as a cubic over a gap; such a path has no second or fourth difference
while its neighbours move.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.io.recording import Recording, find_runs
from gaitcal.preprocess.marker_clusters import FEWEST, MarkerCluster, align_points

AWAY_M = {"pelvis": 0.012, "thigh": 0.012, "shank": 0.012, "foot": 0.025}
"""m beyond the usual distance from the mean position. A foot bends and strikes the floor, so that
its markers stray farther."""
TIMES_BASELINE = 5.0
"""Multiple of the marker's usual distance that must be exceeded, if that is more than `AWAY_M`."""
SHORTEST_FRAMES = 5
SHORTEST_S = 0.05
"""s, shortest interval away from the mean position."""
SLIP_M = 6e-3
"""m, smallest change of position from one frame to the next, and between the means before and
after. In clean recordings of 20 people no such change lasts and is one marker's alone."""
MOST_SLIPS = 2
"""Slips of one cluster; more are a rattling marker or a foot strike, not detached tape."""
MOST_JUMPS = 3
"""Jumps of one marker, lasting or not; more are cameras that lose it."""
SLIP_S = 0.25
"""s, duration of the means before and after a slip."""
SLIP_FRAMES = 8
"""Fewest frames of these means."""
TIMES_OTHERS = 2.0
"""Multiple of the other markers' jump in the laboratory: at foot strike all of them jump."""
SLIP_TIMES_BASELINE = 6.0
"""Multiple of the usual change from frame to frame."""
SLIP_RATE = 0.6
"""m/s, smallest rate of the change: between two frames of slow cameras skin moves, too."""
SLIP_SUDDEN = 2.5
"""Multiple of the largest change within `SUDDEN_S`, the adjacent frames left out: tape comes off
at once, skin deforms over several frames."""
SUDDEN_S = 0.1
SHORTEST_STAY_S = 0.15
"""s, shortest part of the trial before and after a slip."""
SLIP_STAYS = 0.6
"""Share of the change from one frame to the next that must last."""
SLIPPED_WEIGHT = 0.05
"""Weight of the slipped marker where the two others leave a rotation about their line free."""
STILL_M = 2e-5
"""m, second difference below which a path is not measured: half the noise of good cameras."""
STRAIGHT_FRAMES = 6
"""Shortest drawn interval."""
STRAIGHT_M = 2e-4
"""m, largest distance of a drawn line from uniform motion."""
CUBIC_SHARE = 0.01
"""Fourth difference of a path over its neighbours' below which it is not measured: a cubic
polynomial has none, measured paths have the noise of the cameras."""
BENT_M = 8e-3
"""m, by how much the path of another marker of the segment must bend meanwhile."""
WRONG_M = 4e-3
"""m beyond the usual distance from which a drawn path is reported."""


@dataclass(frozen=True)
class DisplacedInterval:
    """Frames in which a marker of a segment is displaced."""

    cluster: MarkerCluster
    label: str
    frames: slice
    distance: float
    """m, largest distance from its mean position."""
    straight: bool = False
    """Whether the path is drawn: held still, a line or a cubic."""
    slipped: bool = False
    """Whether it moved there from one frame to the next and stayed."""


def find_displaced_intervals(
    recording: Recording, clusters: Mapping[str, MarkerCluster]
) -> dict[str, list[DisplacedInterval]]:
    """Find the frames in which markers are displaced on their segment, or their paths drawn.

    Parameters
    ----------
    recording
        Of the trial.
    clusters
        Segment -> its markers against the static posture.

    Returns
    -------
    dict
        Label -> intervals that do not overlap; markers that keep their position are not listed.
    """
    found: dict[str, list[DisplacedInterval]] = {}
    column_of = {label: i for i, label in enumerate(recording.labels)}
    for cluster in clusters.values():
        columns = [column_of[label] for label in cluster.labels[: cluster.marker_count]]
        paths, rate = recording.markers[:, columns], recording.rate
        for interval in (
            *find_drawn_intervals(cluster, paths),
            *find_slipped_intervals(cluster, paths, rate),
            *find_strayed_intervals(cluster, paths, rate),
        ):
            kept, frames = found.setdefault(interval.label, []), interval.frames
            if not any(
                frames.start < other.frames.stop and other.frames.start < frames.stop
                for other in kept
            ):
                kept.append(interval)
    return found


def find_strayed_intervals(
    cluster: MarkerCluster, paths: Array, rate: float
) -> Iterator[DisplacedInterval]:
    """Find intervals in which a marker is far from its mean position, and more so than usually.

    `paths`: (nf, n, 3) m, of these markers in the laboratory. `rate`: Hz.
    """
    distance = np.nan_to_num(cluster.strayed[:, : cluster.marker_count])
    baseline = np.nanmedian(cluster.strayed[:, : cluster.marker_count], axis=0)
    limit = baseline + np.maximum(cluster.size * AWAY_M[cluster.part], TIMES_BASELINE * baseline)
    beyond: BoolArray = np.any(distance > limit, axis=1)
    for run in find_runs(beyond, max(SHORTEST_FRAMES, round(SHORTEST_S * rate))):
        k = _identify_displaced(cluster, paths, run)
        yield DisplacedInterval(cluster, cluster.labels[k], run, _measure_farthest(cluster, k, run))


def find_slipped_intervals(
    cluster: MarkerCluster, paths: Array, rate: float
) -> Iterator[DisplacedInterval]:
    """Find intervals that begin where a marker slips and end at its next slip or with the trial.

    Parameters and yields are those of `find_strayed_intervals`.
    """
    away = cluster.away[:, : cluster.marker_count]
    frames = np.flatnonzero(np.isfinite(away).all(axis=(1, 2)))
    window = max(SLIP_FRAMES, round(SLIP_S * rate))
    fewest, near = max(SLIP_FRAMES, round(SHORTEST_STAY_S * rate)), max(3, round(SUDDEN_S * rate))
    if len(frames) < 2 * fewest:
        return
    away = away[frames]
    step = np.linalg.norm(np.diff(away, axis=0), axis=2).max(axis=1)
    least = cluster.size * SLIP_M
    limit = max(least, SLIP_RATE / rate, SLIP_TIMES_BASELINE * float(np.median(step)))
    slips: list[tuple[int, int, float]] = []
    sudden = np.flatnonzero(step > limit).tolist()
    jumpers = [int(np.argmax(_measure_jumps(paths, int(frames[f + 1])))) for f in sudden]
    for f, k in zip(sudden, jumpers, strict=True):
        # it must be sudden, and last
        before, after = away[max(0, f + 1 - window) : f + 1], away[f + 1 : f + 1 + window]
        if min(len(before), len(after)) < fewest or step[f] < SLIP_SUDDEN * _find_largest_nearby(
            step, f, near
        ):
            continue
        change = np.linalg.norm(after.mean(axis=0) - before.mean(axis=0), axis=1).max()
        if change < max(least, SLIP_STAYS * float(step[f])):
            continue
        # one marker jumps, and not often
        edge = int(frames[f + 1])
        jumps = _measure_jumps(paths, edge)
        if jumpers.count(k) > MOST_JUMPS or jumps[k] < TIMES_OTHERS * float(
            np.delete(jumps, k).max()
        ):
            continue
        shape = cluster.shape[: cluster.marker_count]
        slips.append(
            (
                edge,
                k,
                _measure_single_displacement(
                    cluster, k, shape + before.mean(axis=0), shape + after.mean(axis=0)
                ),
            )
        )
    if len(slips) > MOST_SLIPS:
        return
    for i, (edge, k, size) in enumerate(slips):
        again = next(
            (other for other, marker, _ in slips[i + 1 :] if marker == k), len(cluster.away)
        )
        yield DisplacedInterval(cluster, cluster.labels[k], slice(edge, again), size, slipped=True)


def _find_largest_nearby(step: Array, f: int, near: int) -> float:
    """Return the largest change (m) from frame to frame near f, adjacent changes left out."""
    return float(
        np.concatenate([step[max(0, f - near) : max(0, f - 1)], step[f + 2 : f + 1 + near]]).max(
            initial=0.0
        )
    )


def _measure_single_displacement(
    cluster: MarkerCluster, k: int, before: Array, after: Array
) -> float:
    """Return how far marker k moved between two mean positions (n, 3) m if it alone moved (m)."""
    others = [i for i in range(cluster.marker_count) if i != k]
    rotation, shift = align_points(after[others], before[others])
    # two points leave the rotation about their line free: take the smallest displacement
    if len(others) < FEWEST:
        rotation, shift = align_points(
            after, before, np.where(np.arange(cluster.marker_count) == k, SLIPPED_WEIGHT, 1.0)
        )
    return float(np.linalg.norm(rotation @ after[k] + shift - before[k]))


def _measure_farthest(cluster: MarkerCluster, k: int, frames: slice) -> float:
    """Return how far marker k is from its mean position where its cluster is deformed most (m)."""
    bent = np.nan_to_num(cluster.strayed[frames, : cluster.marker_count])
    after = cluster.away[frames.start + int(bent.max(axis=1).argmax()), : cluster.marker_count]
    if not np.isfinite(after).all():
        return float(bent[:, k].max())
    shape = cluster.shape[: cluster.marker_count]
    return _measure_single_displacement(cluster, k, shape, shape + after)


def _measure_jumps(x: Array, edge: int) -> Array:
    """Return (n,) m, by how much markers x (nf, n, 3) jump between the frames edge - 1 and edge."""
    two_before, two_after = max(edge - 2, 0), min(edge + 1, len(x) - 1)
    smooth = 0.5 * (x[edge - 1] - x[two_before] + x[two_after] - x[edge])
    out: Array = np.nan_to_num(np.linalg.norm(x[edge] - x[edge - 1] - smooth, axis=1))
    return out


def _identify_displaced(cluster: MarkerCluster, paths: Array, run: slice) -> int:
    """Return which marker of a cluster is displaced.

    Of four markers or more it is the one without which the others fit best, else the one that
    jumps.
    """
    middle = paths[(run.start + run.stop) // 2]
    if cluster.marker_count > FEWEST and np.isfinite(middle).all():
        costs = []
        for k in range(cluster.marker_count):
            others = [i for i in range(cluster.marker_count) if i != k]
            rotation, shift = align_points(cluster.shape[others], middle[others])
            costs.append(
                float(((cluster.shape[others] @ rotation.T + shift - middle[others]) ** 2).sum())
            )
        return int(np.argmin(costs))
    inside = np.nan_to_num(cluster.strayed[run, : cluster.marker_count]).max(axis=0)
    edges = [edge for edge in (run.start, run.stop) if 0 < edge < len(cluster.away)]
    return int(
        np.argmax(
            inside
            + sum((_measure_jumps(paths, edge) for edge in edges), np.zeros(cluster.marker_count))
        )
    )


def find_drawn_intervals(cluster: MarkerCluster, x: Array) -> Iterator[DisplacedInterval]:
    """Find intervals in which a marker is still, or on a line or cubic, while its neighbours move.

    `x`: (nf, n, 3) m, their paths in the laboratory.
    """
    if len(x) < STRAIGHT_FRAMES + 2:
        return
    second, fourth = (np.linalg.norm(np.diff(x, order, axis=0), axis=2) for order in (2, 4))
    for k, label in enumerate(cluster.labels[: cluster.marker_count]):
        baseline = float(np.nanmedian(cluster.strayed[:, k]))
        drawn = [
            slice(run.start, run.stop + 2)
            for run in find_runs(second[:, k] < STILL_M, STRAIGHT_FRAMES)
        ]
        drawn = [frames for frames in drawn if measure_bend(x[frames, k]) <= STRAIGHT_M]
        # cubics: no fourth difference while the neighbours have one
        smooth = fourth[:, k] < CUBIC_SHARE * np.median(np.delete(fourth, k, axis=1), axis=1)
        drawn += [slice(run.start, run.stop + 4) for run in find_runs(smooth, STRAIGHT_FRAMES)]
        for frames in drawn:
            if float(np.nan_to_num(cluster.strayed[frames, k]).max()) < baseline + WRONG_M:
                continue
            if (
                max(measure_bend(x[frames, i]) for i in range(cluster.marker_count) if i != k)
                > BENT_M
            ):
                yield DisplacedInterval(
                    cluster, label, frames, _measure_farthest(cluster, k, frames), straight=True
                )


def measure_bend(path: Array) -> float:
    """Measure how far a path is from uniform motion along the line between its ends.

    Parameters
    ----------
    path
        (n, 3) m.

    Returns
    -------
    float
        m, the largest distance.
    """
    line = path[0] + np.linspace(0.0, 1.0, len(path))[:, None] * (path[-1] - path[0])
    return float(np.nan_to_num(np.linalg.norm(path - line, axis=1)).max())
