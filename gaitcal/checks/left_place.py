"""Markers that leave their place in the segment for a while, and paths that software made up over a gap.

A marker's distance from its mean place in the trial (`Cluster.strayed`) shows when it is elsewhere. A path that is held
still, or drawn as a straight line from one frame to another, has no second difference while the others go their way.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.checks.cluster import Cluster, alignment
from gaitcal.checks.evidence import TrialEvidence
from gaitcal.checks.exchanged import undone
from gaitcal.findings import Finding, Severity
from gaitcal.recording.intervals import runs, spans

AWAY_M = {"pelvis": 0.012, "thigh": 0.012, "shank": 0.012, "foot": 0.025}
"""Beyond the usual distance from its mean place; a heel that strikes and toes that bend stray by up to 20 mm."""
USUAL = 5.0
"""Times the marker's usual distance, if that is more."""
SHORTEST_FRAMES = 5
FAR_M = 0.025
LONG_S = 0.1
"""So far for so long moves the joints' angles by more than their error bars: an error."""
STILL_M = 2e-5
"""Second difference of a path that nobody measured: half the noise of good cameras."""
STRAIGHT_FRAMES = 6
STRAIGHT_M = 2e-4
BENT_M = 8e-3
"""How far the path of another marker of the segment must bend meanwhile."""
WRONG_M = 4e-3
"""Beyond the usual distance, from which a made-up path is told."""


@dataclass(frozen=True)
class Stretch:
    """A marker of a segment that is elsewhere for a while."""

    cluster: Cluster
    label: str
    frames: slice
    distance: float
    """m, largest distance from its mean place."""
    straight: bool
    """Whether the path is held or a straight line."""


def left_place(trial: TrialEvidence) -> Iterator[Finding]:
    """Markers that leave their place for a while, one finding a marker."""
    found = stretches(trial)
    if found and (mended := undone(trial)) is not trial:  # exchanges are told by a check of their own
        found = stretches(mended)
    for label, of_marker in found.items():
        yield _finding(trial, label, of_marker)


def stretches(trial: TrialEvidence) -> dict[str, list[Stretch]]:
    """Marker -> where it is elsewhere."""
    found: dict[str, list[Stretch]] = {}
    for cluster in trial.clusters.values():
        for stretch in (*made_up(trial, cluster), *strayed(trial, cluster)):
            here = found.setdefault(stretch.label, [])
            if not any(_overlap(stretch.frames, other.frames) for other in here):
                here.append(stretch)
    return found


def _finding(trial: TrialEvidence, label: str, found: list[Stretch]) -> Finding:
    time = trial.recording.time
    worst = max(found, key=lambda s: s.distance)
    frames = sum(s.frames.stop - s.frames.start for s in found)
    part = worst.cluster.segment
    bad = any(s.distance > FAR_M and _seconds(time, s.frames) >= LONG_S for s in found)
    what = f"marker '{label}' left its place on {part}"
    if worst.straight:
        what = f"the path of marker '{label}' on {part} was held or drawn as a straight line over a gap"
    return trial.finding(
        Severity.ERROR if bad else Severity.WARNING,
        "left its place",
        f"up to {1e3 * worst.distance:.0f} mm away in {frames} frames, {spans(time, [s.frames for s in found])}",
        f'leave that part out with time = [start, end], export gaps as gaps, or weights = {{ "{label}" = 0 }} under '
        "[markers]",
        cause=what,
        leg=part[-1] if part.endswith(("_r", "_l")) else "",
        weight=worst.distance / AWAY_M[worst.cluster.part],
    )


def _seconds(time: Array, frames: slice) -> float:
    return float(time[min(frames.stop, len(time) - 1)] - time[frames.start])


def _overlap(a: slice, b: slice) -> bool:
    return bool(a.start < b.stop and b.start < a.stop)


def strayed(trial: TrialEvidence, cluster: Cluster) -> Iterator[Stretch]:
    """Stretches in which a marker is far from its mean place, and more so than it usually is."""
    distance = np.nan_to_num(cluster.strayed[:, : cluster.own])
    usual = np.nanmedian(cluster.strayed[:, : cluster.own], axis=0)
    limit = usual + np.maximum(AWAY_M[cluster.part], USUAL * usual)
    beyond: BoolArray = np.any(distance > limit, axis=1)
    for run in runs(beyond, SHORTEST_FRAMES):
        k = _culprit(trial, cluster, run)
        if k is not None:
            yield Stretch(cluster, cluster.labels[k], run, float(distance[run, k].max()), False)


def _culprit(trial: TrialEvidence, cluster: Cluster, run: slice) -> int | None:
    """Which marker of a cluster left: without it the others are in their places; of three, the one that jumps."""
    columns = [trial.place[label] for label in cluster.labels[: cluster.own]]
    x = trial.recording.markers[:, columns]
    middle = x[(run.start + run.stop) // 2]
    if len(columns) > 3 and np.isfinite(middle).all():
        costs = []
        for k in range(len(columns)):
            rest = [i for i in range(len(columns)) if i != k]
            turn, shift = alignment(cluster.shape[rest], middle[rest])
            costs.append(float(((cluster.shape[rest] @ turn.T + shift - middle[rest]) ** 2).sum()))
        return int(np.argmin(costs))
    jumps = np.zeros(len(columns))
    for edge in (run.start, run.stop):
        if 1 < edge < len(x) - 1:
            bend = np.linalg.norm(x[edge - 2 : edge + 1] - 2 * x[edge - 1 : edge + 2] + _next(x, edge), axis=2)
            jumps += np.nan_to_num(bend).max(axis=0)
    inside = np.nan_to_num(cluster.strayed[run, : cluster.own]).max(axis=0)
    return int(np.argmax(inside + jumps))


def _next(x: Array, edge: int) -> Array:
    """(3, n, 3) the positions one frame after those around an edge, the last repeated."""
    return x[np.minimum(np.arange(edge, edge + 3), len(x) - 1)]


def made_up(trial: TrialEvidence, cluster: Cluster) -> Iterator[Stretch]:
    """Stretches in which a marker stands still or goes straight while the others of its segment do not."""
    columns = [trial.place[label] for label in cluster.labels[: cluster.own]]
    x = trial.recording.markers[:, columns]
    if len(x) < STRAIGHT_FRAMES + 2:
        return
    second = np.linalg.norm(x[2:] - 2 * x[1:-1] + x[:-2], axis=2)
    for k, label in enumerate(cluster.labels[: cluster.own]):
        usual = float(np.nanmedian(cluster.strayed[:, k]))
        for run in runs(second[:, k] < STILL_M, STRAIGHT_FRAMES):
            frames = slice(run.start, run.stop + 2)
            away = float(np.nan_to_num(cluster.strayed[frames, k]).max())
            if away < usual + WRONG_M or _bend(x[frames, k]) > STRAIGHT_M:
                continue
            if max(_bend(x[frames, i]) for i in range(len(columns)) if i != k) > BENT_M:
                yield Stretch(cluster, label, frames, away, True)


def _bend(path: Array) -> float:
    """m, largest distance of a path (n, 3) from even motion along the line between its ends."""
    line = path[0] + np.linspace(0.0, 1.0, len(path))[:, None] * (path[-1] - path[0])
    return float(np.nan_to_num(np.linalg.norm(path - line, axis=1)).max())
