"""What was seen: gaps, markers that stand still in space, markers that lie in a plane."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from gaitcal.checks.evidence import TrialEvidence
from gaitcal.checks.finding import Finding, info, listed, warning
from gaitcal.recording import marker_gaps
from gaitcal.recording.intervals import runs, spans

Array = NDArray[np.float64]

LONG_S = 0.2
"""A gap longer than this hides a part of a step."""
HALF = 0.5
FROZEN_S = 0.1
"""A position repeated bit for bit for so long, while others move, is held by software."""
MOVED_M = 0.01
"""How far the others must have moved meanwhile: somebody who stands still repeats rounded positions honestly. As far
must a marker have moved in one coordinate for another, which never changes, to be odd."""


def gaps(trial: TrialEvidence) -> Iterator[Finding]:
    """Long gaps, and markers that are missing most of the time."""
    used = {m for m in trial.expected if m in trial.place and trial.seen[:, trial.place[m]].any()}
    own = [gap for gap in marker_gaps(trial.recording) if gap.label in used]
    rare = [f"{g.label} {100 * g.seen:.0f} %" for g in own if g.seen < HALF]
    if rare:
        cure = "they say little of this trial; label it further, or look at the camera setup"
        yield warning("gaps", trial.name, f"seen in less than half of the frames: {listed(rare)}", cure, trial.source)
    long = sorted((g for g in own if g.seen >= HALF and g.longest_gap > LONG_S), key=lambda g: -g.longest_gap)
    if long:
        told = listed([f"{g.label} {g.longest_gap:.2f} s" for g in long])
        cure = "gaps get no weight and are not filled; the rest of the segment carries it"
        yield info("gaps", trial.name, f"gaps longer than {LONG_S:g} s: {told}", cure)
    pelvis = trial.pelvis
    if pelvis is not None and not pelvis.determined.all():
        lost = runs(~pelvis.determined)
        share = 100 * float(np.mean(~pelvis.determined))
        yield warning(
            "gaps",
            trial.name,
            f"fewer than three pelvis markers in {share:.0f} % of the frames ({spans(trial.recording.time, lost)})",
            "set time = [start, end] to the part where the pelvis is seen",
            trial.source,
        )


def frozen(trial: TrialEvidence) -> Iterator[Finding]:
    """Markers that repeat their position bit for bit while the others move."""
    x = trial.recording.markers
    if len(x) < 5:
        return
    same = (x[1:] == x[:-1]).all(axis=2)
    shortest = max(4, round(FROZEN_S * trial.recording.rate))
    told, when = [], []
    for label in trial.expected:
        if label not in trial.place:
            continue
        held = [run for run in runs(same[:, trial.place[label]], shortest) if _others_move(x, run)]
        if held:
            told.append(label)
            when += held
    if told:
        yield warning(
            "frozen",
            trial.name,
            f"positions repeated bit for bit while others move: {listed(told)} ({spans(trial.recording.time, when)})",
            "software held the last value over a gap: export gaps as gaps, or give the marker no weight",
            trial.source,
        )


def _others_move(x: Array, run: slice) -> bool:
    moved = np.linalg.norm(x[run.stop] - x[run.start], axis=1)
    moved = moved[np.isfinite(moved)]
    return bool(len(moved)) and float(np.median(moved)) > MOVED_M


def flat(trial: TrialEvidence) -> Iterator[Finding]:
    """Markers with a coordinate that never changes."""
    told = []
    own = [label for label in trial.expected if label in trial.place]
    for label in own:
        x = trial.recording.markers[trial.seen[:, trial.place[label]], trial.place[label]]
        if len(x) <= 10:
            continue
        way = np.ptp(x, axis=0)
        # A segment that is held still moves by rounding alone: there a coordinate without a change says nothing.
        if (way == 0).any() and way.max() > MOVED_M:
            told.append(label)
    if 0 < len(told) < HALF * len(own):
        yield warning(
            "frozen",
            trial.name,
            f"one coordinate never changes: {listed(told)}",
            "a column of the file is constant: export the trial again",
            trial.source,
        )
