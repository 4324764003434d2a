"""Checks of swapped labels: in a part of a trial (`preprocess/swapped_labels.py`), or by sides.

Sides are swapped if right markers are to the left of their left namesakes, in the pelvis frame.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import permutations

import numpy as np

from gaitcal.errors import Code, Finding, Severity, join_names
from gaitcal.io.recording import Recording, find_runs, format_spans, measure_duration
from gaitcal.model import linkage
from gaitcal.preprocess.put_back_labels import MOST_OF_A_PART
from gaitcal.preprocess.swapped_labels import SwappedLabels
from gaitcal.preprocess.trial_evidence import NEGLIGIBLE_WEIGHT, TrialEvidence

# Longer than filtering hides: angles of the segment are wrong by tens of degrees for that time
LONG_S = 0.05
# Allowed distance of a right marker to the left of its left namesake, as feet may cross
WRONG_SIDE_M = 0.02
# The same in most frames of a functional trial, in which one leg may be held across the other
CROSSED_M = 0.06
LEGS = ("thigh", "shank", "foot")


def check_swapped_labels(trial: TrialEvidence) -> Iterator[Finding]:
    """Report labels that are swapped in a part of the trial, or in all of it.

    Parameters
    ----------
    trial
        The trial as read.

    Yields
    ------
    Finding
        One for each pair: a note if the swap was corrected or has no effect.
    """
    back = trial.restored_swaps
    for k, found in enumerate((*back, *trial.swapped_labels)):
        count = int(found.frames.sum())
        what = (
            "have swapped labels"
            if found.mutual
            else "are confused: the first is at the position of the second"
        )
        message = f"'{found.label}' and '{found.other}' {what} in {count} frames, "
        message += format_spans(trial.recording.time, find_runs(found.frames))
        severity = Severity.ERROR
        cure = "relabel this interval, or leave it out with time = [start, end]"
        if k < len(back):
            severity = Severity.INFO
            cure = "corrected here; relabel this interval for use in other programs"
        elif max(trial.weight(found.label), trial.weight(found.other)) <= NEGLIGIBLE_WEIGHT:
            severity = Severity.INFO
            cure = "no effect, as both have little or no weight; relabel this interval to use them"
        elif (
            count / max(int(trial.visible[:, trial.column[found.label]].sum()), 1) > MOST_OF_A_PART
        ):
            cure = "swap the two labels in the file"
        elif not _is_harmful(trial, found):
            severity = Severity.WARNING
        code = Code.EXCHANGED_BACK if k < len(back) else Code.EXCHANGED_LABELS
        weight = 1.0 if severity is Severity.INFO else float(count)
        yield trial.make_finding(
            severity, "swapped labels", message, cure, weight=weight, code=code
        )


def _is_harmful(trial: TrialEvidence, found: SwappedLabels) -> bool:
    """Return whether a swap rotates a segment of pelvis or legs for `LONG_S` or longer."""
    if min(map(trial.weight, (found.label, found.other))) <= NEGLIGIBLE_WEIGHT:
        return False
    of_legs = {
        label for s in linkage.LOWER_BODY if s in trial.templates for label in trial.templates[s][0]
    }
    longest = max(measure_duration(trial.recording.time, run) for run in find_runs(found.frames))
    return {found.label, found.other} <= of_legs and longest >= LONG_S


def check_sides(trial: TrialEvidence) -> Iterator[Finding]:
    """Report right markers that are to the left of their left namesakes, in the pelvis frame.

    Parameters
    ----------
    trial
        The trial as read.

    Yields
    ------
    Finding
        One error or warning, or nothing.
    """
    if trial.pelvis is None:
        return
    wrong: list[str] = []
    when: list[slice] = []
    farthest = 0.0
    for name, other in _pair_namesakes(trial):
        # component along the pelvis' lateral axis; positive to the right
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
            f"right markers are to the left of the left ones: {join_names(wrong)} "
            f"({format_spans(trial.recording.time, when)})",
            "swap the labels of right and left in the file",
            cause="" if crossed else "the labels of right and left are swapped",
            weight=10.0,
            code=Code.SIDES_EXCHANGED,
        )


def _pair_namesakes(trial: TrialEvidence) -> Iterator[tuple[str, str]]:
    """Yield pairs of right and left markers of pelvis and legs with corresponding labels."""
    tracking = trial.marker_set.tracking
    pairs = [*permutations(tracking.get("pelvis", ()), 2)]
    for segment in LEGS:
        # a built-in pattern with {S} or {s} lists both sides in the same order; lists of users may
        # differ
        pairs += zip(
            tracking.get(f"{segment}_r", ()), tracking.get(f"{segment}_l", ()), strict=False
        )
    yield from (
        (a, b) for a, b in pairs if a in trial.column and b in trial.column and _is_right_of(a, b)
    )


def _is_right_of(a: str, b: str) -> bool:
    """Return whether two labels differ only by R and L at one position.

    `a`, `b`: labels of a right and a left marker, in any case.
    """
    different = [(x, y) for x, y in zip(a.lower(), b.lower(), strict=False) if x != y]
    return len(a) == len(b) and different == [("r", "l")]


def swap_sides(recording: Recording) -> Recording:
    """Swap the labels of right and left.

    Parameters
    ----------
    recording
        Any recording.

    Returns
    -------
    Recording
        With the label of its namesake for every marker that has one.
    """
    labels = recording.labels
    other = {a: b for a in labels for b in labels if _is_right_of(a, b) or _is_right_of(b, a)}
    return replace(recording, labels=tuple(other.get(label, label) for label in labels))
