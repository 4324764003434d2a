"""Markers that leave their place, slip or freeze.

When a marker is elsewhere is found by `preprocess/displaced_markers.py`. A position repeated bit
for bit while others move, or a coordinate that never changes, needs no static trial to be told.
"""

from collections.abc import Iterator

import numpy as np

from gaitcal.arrays import Array
from gaitcal.errors import Code, Finding, Severity, listed
from gaitcal.io.recording import find_runs, format_spans
from gaitcal.preprocess.displaced_markers import AWAY_M, DisplacedInterval
from gaitcal.preprocess.marker_clusters import FEWEST
from gaitcal.preprocess.trial_evidence import TrialEvidence, get_side

REFUSED_M = 0.025
REFUSED_SURE_M = {"pelvis": 0.015, "thigh": 0.015, "shank": 0.015, "foot": 0.025}
"""The same where it slipped or its path was made up, which skin never does."""
LONG_S = 0.1  # So far for so long moves the joints' angles by more than their error bars: an error
HALF = 0.5  # Share of the markers
FROZEN_S = (
    0.1  # A position repeated bit for bit for so long, while others move, is held by software
)
MOVED_M = 0.01
"""How far the others must have moved meanwhile: somebody who stands still repeats rounded positions
honestly. As far must a marker have moved in one coordinate for another, which never changes, to be
odd."""


def check_displaced_markers(trial: TrialEvidence) -> Iterator[Finding]:
    """Markers that leave their place for a while, one finding a marker."""
    time = trial.recording.time
    for label, of_marker in trial.displaced.items():
        frames = [s.frames for s in of_marker]
        worst = max(of_marker, key=lambda s: s.distance)
        part = worst.cluster.segment
        what = (
            f"marker '{label}' "
            f"{'slipped' if any(s.slipped for s in of_marker) else 'left its place'} on {part}"
        )
        if worst.straight:
            what = (
                f"the path of marker '{label}' on {part} was held or drawn as a straight or smooth "
                "line over a gap"
            )
        cure = f'export gaps as gaps, or weights = {{ "{worst.label}" = 0 }} under [markers]'
        if worst.cluster.marker_count < FEWEST:
            cure = (
                "or export gaps as gaps: without this marker the other does not tell how the "
                "segment lies"
            )
        yield trial.make_finding(
            Severity.ERROR if any(_is_harmful(s, time) for s in of_marker) else Severity.WARNING,
            "left its place",
            f"up to {1e3 * worst.distance:.0f} mm away in {sum(f.stop - f.start for f in frames)} "
            "frames, "
            f"{format_spans(time, frames)}",
            f"leave that part out with time = [start, end], {cure}",
            cause=what,
            leg=get_side(part),
            weight=worst.distance / AWAY_M[worst.cluster.part],
            code=Code.MARKER_LEFT_PLACE,
        )


def _is_harmful(stretch: DisplacedInterval, time: Array) -> bool:
    sure = stretch.slipped or stretch.straight
    lasts = float(time[min(stretch.frames.stop, len(time) - 1)] - time[stretch.frames.start])
    return (
        stretch.distance > (REFUSED_SURE_M[stretch.cluster.part] if sure else REFUSED_M)
        and lasts >= LONG_S
    )


def check_frozen(trial: TrialEvidence) -> Iterator[Finding]:
    """Markers that repeat their position bit for bit while the others move."""
    x = trial.recording.markers
    if len(x) < 5:
        return
    same = (x[1:] == x[:-1]).all(axis=2)
    shortest = max(4, round(FROZEN_S * trial.recording.rate))
    labels, when = [], []
    for label in trial.as_fitted.present:
        held = [
            run
            for run in find_runs(same[:, trial.column[label]], shortest)
            if _has_body_moved(x, run)
        ]
        if held:
            labels.append(label)
            when += held
    if labels:
        yield trial.warning(
            "frozen",
            f"positions repeated bit for bit while others move: {listed(labels)} "
            f"({format_spans(trial.recording.time, when)})",
            "software held the last value over a gap: export gaps as gaps, or give the marker no "
            "weight",
            code=Code.FROZEN_MARKER,
        )


def _has_body_moved(x: Array, run: slice) -> bool:
    """Whether most of the markers (nf, nm, 3) are elsewhere at the end of a run of steps than at
    its beginning.
    """
    moved = np.linalg.norm(x[run.stop] - x[run.start], axis=1)
    return (
        bool(np.median(moved[np.isfinite(moved)]) > MOVED_M) if np.isfinite(moved).any() else False
    )


def check_constant_coordinates(trial: TrialEvidence) -> Iterator[Finding]:
    """Markers with a coordinate that never changes."""
    trial, labels = trial.as_fitted, []
    for label in trial.present:
        x = trial.path(label)[trial.visible[:, trial.column[label]]]
        if len(x) <= 10:
            continue
        way = np.ptp(x, axis=0)
        # A segment that is held still moves by rounding alone: there a coordinate without a change
        # says nothing.
        if (way == 0).any() and way.max() > MOVED_M:
            labels.append(label)
    if 0 < len(labels) < HALF * len(trial.present):
        found = f"one coordinate never changes: {listed(labels)}"
        cure = "a column of the file is constant: export the trial again"
        yield trial.warning("frozen", found, cure, code=Code.CONSTANT_COORDINATE)
