"""Markers that software held: a position repeated while others move, a coordinate that never changes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gaitcal.arrays import Array
from gaitcal.codes import Code
from gaitcal.faults.evidence import TrialEvidence
from gaitcal.findings import Finding, listed
from gaitcal.io.intervals import runs, spans

HALF = 0.5
"""Share of the markers."""
FROZEN_S = 0.1
"""A position repeated bit for bit for so long, while others move, is held by software."""
MOVED_M = 0.01
"""How far the others must have moved meanwhile: somebody who stands still repeats rounded positions honestly. As far
must a marker have moved in one coordinate for another, which never changes, to be odd."""


def frozen(trial: TrialEvidence) -> Iterator[Finding]:
    """Markers that repeat their position bit for bit while the others move."""
    x = trial.recording.markers
    if len(x) < 5:
        return
    same = (x[1:] == x[:-1]).all(axis=2)
    shortest = max(4, round(FROZEN_S * trial.recording.rate))
    labels, when = [], []
    for label in trial.present:
        held = [run for run in runs(same[:, trial.place[label]], shortest) if _others_move(x, run)]
        if held:
            labels.append(label)
            when += held
    if labels:
        yield trial.warning(
            "frozen",
            f"positions repeated bit for bit while others move: {listed(labels)} ({spans(trial.recording.time, when)})",
            "software held the last value over a gap: export gaps as gaps, or give the marker no weight",
            code=Code.FROZEN_MARKER,
        )


def _others_move(x: Array, run: slice) -> bool:
    """Whether most of the markers (nf, nm, 3) are elsewhere at the end of a run of steps than at its beginning."""
    moved = np.linalg.norm(x[run.stop] - x[run.start], axis=1)
    moved = moved[np.isfinite(moved)]
    return bool(len(moved)) and float(np.median(moved)) > MOVED_M


def flat(trial: TrialEvidence) -> Iterator[Finding]:
    """Markers with a coordinate that never changes."""
    labels = []
    for label in trial.present:
        x = trial.path(label)[trial.seen[:, trial.place[label]]]
        if len(x) <= 10:
            continue
        way = np.ptp(x, axis=0)
        # A segment that is held still moves by rounding alone: there a coordinate without a change says nothing.
        if (way == 0).any() and way.max() > MOVED_M:
            labels.append(label)
    if 0 < len(labels) < HALF * len(trial.present):
        yield trial.warning(
            "frozen",
            f"one coordinate never changes: {listed(labels)}",
            "a column of the file is constant: export the trial again",
            code=Code.CONSTANT_COORDINATE,
        )
