"""Check markers that are displaced, slip or freeze.

Displaced markers are found by `preprocess/displaced_markers.py`. A position repeated exactly while
others move, or a coordinate that never changes, is found without a static trial.
"""

from collections.abc import Iterator

import numpy as np

from gaitcal.arrays import Array
from gaitcal.errors import Code, Finding, Severity, join_names
from gaitcal.io.recording import find_runs, format_spans
from gaitcal.preprocess.displaced_markers import AWAY_M, DisplacedInterval
from gaitcal.preprocess.marker_clusters import FEWEST
from gaitcal.preprocess.trial_evidence import TrialEvidence, get_side

REFUSED_M = 0.025
REFUSED_SURE_M = {"pelvis": 0.015, "thigh": 0.015, "shank": 0.015, "foot": 0.025}
"""The same where it slipped or its path was interpolated, which soft tissue never does."""
# For so long such a displacement changes joint angles by more than their error bars: an error
LONG_S = 0.1
HALF = 0.5  # Share of the markers
# A position repeated exactly for so long, while others move, is held by software
FROZEN_S = 0.1
MOVED_M = 0.01
"""Distance that the others must have moved meanwhile: a person who stands still repeats rounded
positions. A marker must move as far in one coordinate before a constant one is reported."""


def check_displaced_markers(trial: TrialEvidence) -> Iterator[Finding]:
    """Report markers that are displaced for a while.

    Yields one error or warning a marker.
    """
    time = trial.recording.time
    for label, of_marker in trial.displaced.items():
        frames = [s.frames for s in of_marker]
        worst = max(of_marker, key=lambda s: s.distance)
        part = worst.cluster.segment
        verb = "slipped" if any(s.slipped for s in of_marker) else "is displaced for a while"
        cause = f"marker '{label}' {verb} on {part}"
        if worst.straight:
            cause = (
                f"a gap of marker '{label}' on {part} was filled with a constant, straight or "
                "smooth line"
            )
        cure = (
            "export the trial without gap filling, or set weights = "
            f'{{ "{worst.label}" = 0 }} under [markers]'
        )
        if worst.cluster.marker_count < FEWEST:
            cure = (
                "or export the trial without gap filling; the weight cannot be 0, as the other "
                "marker alone does not determine the pose of the segment"
            )
        yield trial.make_finding(
            Severity.ERROR if any(_is_harmful(s, time) for s in of_marker) else Severity.WARNING,
            "displaced markers",
            f"up to {1e3 * worst.distance:.0f} mm away in {sum(f.stop - f.start for f in frames)} "
            f"frames, {format_spans(time, frames)}",
            f"leave this interval out with time = [start, end], {cure}",
            cause=cause,
            leg=get_side(part),
            weight=worst.distance / AWAY_M[worst.cluster.part],
            code=Code.MARKER_LEFT_PLACE,
        )


def _is_harmful(stretch: DisplacedInterval, time: Array) -> bool:
    """Return whether a displacement is large and long enough for an error."""
    sure = stretch.slipped or stretch.straight
    lasts = float(time[min(stretch.frames.stop, len(time) - 1)] - time[stretch.frames.start])
    return (
        stretch.distance > (REFUSED_SURE_M[stretch.cluster.part] if sure else REFUSED_M)
        and lasts >= LONG_S
    )


def check_frozen(trial: TrialEvidence) -> Iterator[Finding]:
    """Report markers that repeat their position exactly while the others move.

    Yields one warning, or nothing.
    """
    x = trial.recording.markers
    if len(x) < 5:
        return
    same = (x[1:] == x[:-1]).all(axis=2)
    # at low frame rates a few equal samples are by chance
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
            f"positions repeated exactly while others move: {join_names(labels)} "
            f"({format_spans(trial.recording.time, when)})",
            "software filled a gap with the last value: export the trial without gap filling, or "
            "set the weight of the marker to 0",
            code=Code.FROZEN_MARKER,
        )


def _has_body_moved(x: Array, run: slice) -> bool:
    """Return whether most markers (nf, nm, 3) move by more than `MOVED_M` over a run of steps."""
    moved = np.linalg.norm(x[run.stop] - x[run.start], axis=1)
    return (
        bool(np.median(moved[np.isfinite(moved)]) > MOVED_M) if np.isfinite(moved).any() else False
    )


def check_constant_coordinates(trial: TrialEvidence) -> Iterator[Finding]:
    """Report markers with a coordinate that never changes.

    Yields one warning, or nothing.
    """
    trial, labels = trial.as_fitted, []
    for label in trial.present:
        x = trial.path(label)[trial.visible[:, trial.column[label]]]
        if len(x) <= 10:
            continue
        movement = np.ptp(x, axis=0)
        # a segment that is held still changes by rounding alone: a constant coordinate is usual
        if (movement == 0).any() and movement.max() > MOVED_M:
            labels.append(label)
    if 0 < len(labels) < HALF * len(trial.present):
        found = f"one coordinate never changes: {join_names(labels)}"
        cure = "check this column of the file, and export the trial again"
        yield trial.warning("frozen", found, cure, code=Code.CONSTANT_COORDINATE)
