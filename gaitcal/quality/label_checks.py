"""Labels that are exchanged: for a part of a trial (`preprocess/swapped_labels.py`), or by sides.

By sides: right markers lie to the left of their left namesakes, seen along the pelvis.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import permutations

import numpy as np

from gaitcal.errors import Code, Finding, Severity, listed
from gaitcal.io.recording import Recording, find_runs, format_spans, measure_duration
from gaitcal.model import linkage
from gaitcal.preprocess.put_back_labels import MOST_OF_A_PART
from gaitcal.preprocess.swapped_labels import SwappedLabels
from gaitcal.preprocess.trial_evidence import NEGLIGIBLE_WEIGHT, TrialEvidence

# Longer than a filter bridges: angles of the segment are wrong by tens of degrees for so long
LONG_S = 0.05
WRONG_SIDE_M = 0.02  # How far a right marker may lie to the left of its left one, as feet may cross
# The same in most frames of an isolated trial, in which one leg may be held across the other
CROSSED_M = 0.06
LEGS = ("thigh", "shank", "foot")


def exchanged(trial: TrialEvidence) -> Iterator[Finding]:
    """Labels exchanged for a part of the trial, or for all of it."""
    back = trial.put_back
    for k, found in enumerate((*back, *trial.swapped_labels)):
        count = int(found.frames.sum())
        what = (
            "carry each other's label"
            if found.mutual
            else "are confused: the first is where the second should be"
        )
        message = f"'{found.label}' and '{found.other}' {what} in {count} frames, "
        message += format_spans(trial.recording.time, find_runs(found.frames))
        severity, cure = (
            Severity.ERROR,
            "label that part again, or leave it out with time = [start, end]",
        )
        if k < len(back):
            severity, cure = (
                Severity.INFO,
                "exchanged back; label that part again, so that other programs have it right",
            )
        elif max(trial.weight(found.label), trial.weight(found.other)) <= NEGLIGIBLE_WEIGHT:
            severity = Severity.INFO
            cure = (
                "no harm done, as both have little weight or none; label that part again to use "
                "them"
            )
        elif (
            count / max(int(trial.visible[:, trial.column[found.label]].sum()), 1) > MOST_OF_A_PART
        ):
            cure = "exchange the two labels in the file"
        elif not _harmful(trial, found):
            severity = Severity.WARNING
        code = Code.EXCHANGED_BACK if k < len(back) else Code.EXCHANGED_LABELS
        weight = 1.0 if severity is Severity.INFO else float(count)
        yield trial.make_finding(severity, "exchanged", message, cure, weight=weight, code=code)


def _harmful(trial: TrialEvidence, found: SwappedLabels) -> bool:
    """Whether a part of the trial turns a segment of the pelvis or legs by it: two full markers,
    for some time.
    """
    if min(map(trial.weight, (found.label, found.other))) <= NEGLIGIBLE_WEIGHT:
        return False
    of_legs = {
        label for s in linkage.LOWER_BODY if s in trial.templates for label in trial.templates[s][0]
    }
    longest = max(measure_duration(trial.recording.time, run) for run in find_runs(found.frames))
    return {found.label, found.other} <= of_legs and longest >= LONG_S


def sides(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether right markers lie to the right of their left ones, seen along the pelvis."""
    if trial.pelvis is None:
        return
    wrong: list[str] = []
    when: list[slice] = []
    farthest = 0.0
    for name, other in _namesakes(trial):
        lateral = np.einsum(
            "fi,fi->f", trial.path(name) - trial.path(other), trial.pelvis.rotation[:, :, 2]
        )
        known = np.isfinite(lateral) & trial.pelvis.determined
        bad = known & (lateral < -WRONG_SIDE_M)
        if known.sum() >= 3 and bad.sum() > 0.5 * known.sum():
            away = -float(np.median(lateral[bad]))
            wrong.append(f"'{name}' and '{other}' by {1e3 * away:.0f} mm")
            farthest = max(farthest, away)
            when = find_runs(bad)
    if wrong:
        crossed = trial.is_isolated and farthest < CROSSED_M
        yield trial.make_finding(
            Severity.WARNING if crossed else Severity.ERROR,
            "sides",
            f"right markers lie to the left of their left ones: {listed(wrong)} "
            f"({format_spans(trial.recording.time, when)})",
            "exchange the labels of right and left in the file",
            cause="" if crossed else "right and left are exchanged in the labels",
            weight=10.0,
            code=Code.SIDES_EXCHANGED,
        )


def _namesakes(trial: TrialEvidence) -> Iterator[tuple[str, str]]:
    """Markers of the right side of pelvis and legs that have a namesake on the left, in this trial."""
    tracking = trial.marker_set.tracking
    pairs = [*permutations(tracking.get("pelvis", ()), 2)]
    for segment in LEGS:
        # A built-in pattern with {S} or {s} gives both sides in one order; a user's own lists may
        # differ.
        pairs += zip(
            tracking.get(f"{segment}_r", ()), tracking.get(f"{segment}_l", ()), strict=False
        )
    yield from (
        (a, b) for a, b in pairs if a in trial.column and b in trial.column and is_right_of(a, b)
    )


def is_right_of(a: str, b: str) -> bool:
    """Whether two labels differ only by R and L at one place."""
    different = [(x, y) for x, y in zip(a.lower(), b.lower(), strict=False) if x != y]
    return len(a) == len(b) and different == [("r", "l")]


def sides_exchanged(recording: Recording) -> Recording:
    """The recording with every label that names a side given to its namesake."""
    labels = recording.labels
    other = {a: b for a in labels for b in labels if is_right_of(a, b) or is_right_of(b, a)}
    return replace(recording, labels=tuple(other.get(label, label) for label in labels))
