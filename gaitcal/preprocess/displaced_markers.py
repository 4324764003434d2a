"""Find markers that leave their place in the segment for a while, and paths that software held or
made up over a gap.

A marker's distance from its mean place in the trial (`MarkerCluster.strayed`) shows when it is elsewhere.
Where it slips from one frame to the next and stays there, the whole cluster's fit jumps: the means
of its markers' places over a quarter of a second before and after differ as much as the two frames
do, which skin never does; the marker that slipped is the one that jumps in the laboratory. A path
that is held still, or drawn as a straight line from one frame to another, has no second difference
while the others go their way.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.io.recording import Recording, find_runs
from gaitcal.preprocess.marker_clusters import FEWEST, MarkerCluster, align_points

AWAY_M = {"pelvis": 0.012, "thigh": 0.012, "shank": 0.012, "foot": 0.025}
"""Beyond the usual distance from its mean place; a foot bends and strikes the floor, and its
markers stray farther."""
TIMES_BASELINE = 5.0  # Times the marker's usual distance, if that is more
SHORTEST_FRAMES, SHORTEST_S = 5, 0.05
SLIP_M = 6e-3
"""Change of a marker's place in its segment from one frame to the next, and at least so much
between the means; no clean recording of 20 people has one that lasts and is one marker's alone."""
MOST_SLIPS = (
    2  # In a cluster: more are a rattling marker or a foot that strikes, not tape that came off
)
MOST_JUMPS = (
    3  # Of one marker, whether it stays or comes back at once: more are cameras that lose it
)
SLIP_S, SLIP_FRAMES = 0.25, 8  # Stretch of the means before and after, and fewest frames of it
TIMES_OTHERS = (
    2.0  # Times the others' jump in the laboratory: a foot that strikes the floor jumps as a whole
)
SLIP_TIMES_BASELINE = 6.0  # Times the usual change from frame to frame
SLIP_RATE = (
    0.6  # m/s of the same: skin goes on moving between two frames, and slow cameras see it jump
)
SLIP_SUDDEN, SUDDEN_S = 2.5, 0.1
"""Times the changes of the frames so near before and after (but for the next ones): tape that comes
off does so at once, skin deforms over several frames."""
SHORTEST_STAY_S = 0.15
SLIP_STAYS = 0.6  # Share of a change that must last
# Weight of a marker that slipped, where the two others alone do not tell how the segment lies
SLIPPED_WEIGHT = 0.05
STILL_M = 2e-5  # Second difference of a path that nobody measured: half the noise of good cameras
STRAIGHT_FRAMES = 6
STRAIGHT_M = 2e-4
CUBIC_SHARE = 0.01
"""Fourth difference of a path over that of its neighbours, below which nobody measured it: a cubic
polynomial has none, measured paths have the noise of their cameras."""
BENT_M = 8e-3  # How far the path of another marker of the segment must bend meanwhile
WRONG_M = 4e-3  # Beyond the usual distance, from which a made-up path is told


@dataclass(frozen=True)
class DisplacedInterval:
    """A marker of a segment that is elsewhere for a while."""

    cluster: MarkerCluster
    label: str
    frames: slice
    distance: float  # m, largest distance from its mean place
    straight: bool = False  # Whether the path is held or a straight line
    slipped: bool = False  # Whether it went there from one frame to the next, and stayed


def find_displaced_intervals(
    recording: Recording, clusters: Mapping[str, MarkerCluster]
) -> dict[str, list[DisplacedInterval]]:
    """Find when each marker of a trial is elsewhere.

    Parameters
    ----------
    recording
        Of the trial.
    clusters
        Segment -> its markers against the static posture.

    Returns
    -------
    dict
        Label -> intervals that do not overlap; markers that keep their place are not in it.
    """
    found: dict[str, list[DisplacedInterval]] = {}
    place = {label: i for i, label in enumerate(recording.labels)}
    for cluster in clusters.values():
        columns = [place[label] for label in cluster.labels[: cluster.marker_count]]
        paths, rate = recording.markers[:, columns], recording.rate
        for stretch in (
            *find_drawn_intervals(cluster, paths),
            *find_slipped_intervals(cluster, paths, rate),
            *find_strayed_intervals(cluster, paths, rate),
        ):
            here, at = found.setdefault(stretch.label, []), stretch.frames
            if not any(
                at.start < other.frames.stop and other.frames.start < at.stop for other in here
            ):
                here.append(stretch)
    return found


def find_strayed_intervals(
    cluster: MarkerCluster, paths: Array, rate: float
) -> Iterator[DisplacedInterval]:
    """Stretches in which a marker is far from its mean place, and more so than it usually is;
    `paths` (nf, own, 3) m, of the cluster in the laboratory.
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
    """Stretches that begin where a marker slips, until it slips again or the trial ends."""
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
        before, after = away[max(0, f + 1 - window) : f + 1], away[f + 1 : f + 1 + window]
        if min(len(before), len(after)) < fewest or step[f] < SLIP_SUDDEN * _find_largest_nearby(
            step, f, near
        ):
            continue
        change = np.linalg.norm(after.mean(axis=0) - before.mean(axis=0), axis=1).max()
        if change < max(least, SLIP_STAYS * float(step[f])):
            continue
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
    """m, the largest change from frame to frame near change f, without its neighbours."""
    return float(
        np.concatenate([step[max(0, f - near) : max(0, f - 1)], step[f + 2 : f + 1 + near]]).max(
            initial=0.0
        )
    )


def _measure_single_displacement(
    cluster: MarkerCluster, k: int, before: Array, after: Array
) -> float:
    """m, how far marker k went between two mean places (own, 3) of the markers, if it alone moved."""
    rest = [i for i in range(cluster.marker_count) if i != k]
    turn, shift = align_points(after[rest], before[rest])
    if (
        len(rest) < FEWEST
    ):  # two points leave a turn about their line free: the smallest way that explains it
        turn, shift = align_points(
            after, before, np.where(np.arange(cluster.marker_count) == k, SLIPPED_WEIGHT, 1.0)
        )
    return float(np.linalg.norm(turn @ after[k] + shift - before[k]))


def _measure_farthest(cluster: MarkerCluster, k: int, frames: slice) -> float:
    """m, how far marker k is from its mean place where its cluster is bent most, if it alone moved."""
    bent = np.nan_to_num(cluster.strayed[frames, : cluster.marker_count])
    after = cluster.away[frames.start + int(bent.max(axis=1).argmax()), : cluster.marker_count]
    if not np.isfinite(after).all():
        return float(bent[:, k].max())
    shape = cluster.shape[: cluster.marker_count]
    return _measure_single_displacement(cluster, k, shape, shape + after)


def _measure_jumps(x: Array, edge: int) -> Array:
    """(own,) m, how far each of the markers x (nf, own, 3) jumps out of line in the laboratory
    between the frames edge - 1 and edge.
    """
    two_before, two_after = max(edge - 2, 0), min(edge + 1, len(x) - 1)
    smooth = 0.5 * (x[edge - 1] - x[two_before] + x[two_after] - x[edge])
    out: Array = np.nan_to_num(np.linalg.norm(x[edge] - x[edge - 1] - smooth, axis=1))
    return out


def _identify_displaced(cluster: MarkerCluster, paths: Array, run: slice) -> int:
    """Which marker of a cluster left: without it the others are in their places; of three, the one
    that jumps.
    """
    middle = paths[(run.start + run.stop) // 2]
    if cluster.marker_count > FEWEST and np.isfinite(middle).all():
        costs = []
        for k in range(cluster.marker_count):
            rest = [i for i in range(cluster.marker_count) if i != k]
            turn, shift = align_points(cluster.shape[rest], middle[rest])
            costs.append(float(((cluster.shape[rest] @ turn.T + shift - middle[rest]) ** 2).sum()))
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
    """Stretches in which a marker stands still, goes straight or along a cubic while others of its
    segment do not.
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
    """m, largest distance of a path (n, 3) from even motion along the line between its ends."""
    line = path[0] + np.linspace(0.0, 1.0, len(path))[:, None] * (path[-1] - path[0])
    return float(np.nan_to_num(np.linalg.norm(path - line, axis=1)).max())
