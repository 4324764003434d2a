"""Directions: which way is up, which way the person faces and goes, which side is right."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import permutations

import numpy as np

from gaitcal.codes import Code
from gaitcal.faults.evidence import TrialEvidence
from gaitcal.findings import Finding, Severity, listed
from gaitcal.io.axes import PROGRESSION_M, net_progression
from gaitcal.io.intervals import runs, spans
from gaitcal.model.linkage import SIDES

ALONG_DEG = 50.0
"""Angle between facing and going above which the person does not walk forwards."""
TILT_DEG = 60.0
"""Largest tilt of the pelvis in standing and walking."""
LYING_DEG = 120.0
"""The same for an isolated trial, in which the person may lie on a bench, face up or down."""
WRONG_SIDE_M = 0.02
"""How far a right marker may lie to the left of its left one, as feet may cross."""
CROSSED_M = 0.06
"""The same in most frames of an isolated trial, in which one leg may be held across the other."""
HEAD_DOWN = 0.2
"""Share of body height by which knees, ankles and heels may be above the pelvis, as when a leg is raised lying."""
LEGS = ("thigh", "shank", "foot")


def upright(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether the body is the right way up in the y-up axes that were made of the file's, in every kind of trial.

    A pelvis whose right and left are exchanged, by labels or by a mirrored axis, looks the same as itself turned about
    its forward axis: upside down. Where the feet are above it, the vertical is.
    """
    pelvis = trial.pelvis
    if pelvis is None:
        return
    tilt = np.rad2deg(np.arccos(np.clip(pelvis.rotation[pelvis.determined][:, 1, 1], -1, 1)))
    allowed = LYING_DEG if trial.is_isolated else TILT_DEG
    middle, above = float(np.median(tilt)), feet_above(trial)
    found = f"the pelvis is tilted by {middle:.0f} deg against the vertical found; allowed: {allowed:.0f} deg"
    cause, cure = "the body does not stand upright", "write the file with one of its axes vertical"
    if above is not None and above > HEAD_DOWN * trial.subject.height:
        cause, cure = "the vertical axis points down", "write the file with its vertical axis upwards"
        found = f"the legs are {above:.2f} m above the pelvis"
    elif middle <= allowed:
        return
    elif middle > LYING_DEG:
        cause = "right and left are exchanged: the labels (of the pelvis, or of all markers), or an axis is mirrored"
        cure = "exchange the labels of right and left in the file, or change the sign of the axis that was mirrored"
    yield trial.finding(Severity.ERROR, "axes", found, cure, cause=cause, weight=10.0, code=Code.NOT_UPRIGHT)


def feet_above(trial: TrialEvidence) -> float | None:
    """m, median height of ankles or heels over the ASIS; None where neither is seen."""
    hips = [path[:, 1] for side in SIDES if (path := trial.landmark(f"asis_{side}")) is not None]
    ends = [f"{name}_{side}" for name in ("ankle_lat", "heel", "knee_lat") for side in SIDES]
    feet = [path[:, 1] for name in ends if (path := trial.landmark(name)) is not None]
    if not hips or not feet:
        markers = trial.recording.markers[:, [trial.place[m] for m in _leg_markers(trial)], 1]
        if not hips or not np.isfinite(markers).any():
            return None
        return float(np.nanmedian(markers) - np.nanmedian(np.array(hips)))
    return float(np.nanmedian(np.array(feet)) - np.nanmedian(np.array(hips)))


def _leg_markers(trial: TrialEvidence) -> list[str]:
    legs = [m for segment, labels in trial.marker_set.tracking.items() if segment[:-2] in LEGS for m in labels]
    return [m for m in legs if m in trial.place]


def heading(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether the person goes where the pelvis faces, and is not carried along sideways."""
    pelvis = trial.pelvis
    if pelvis is None or not trial.is_gait:
        return
    way = net_progression(trial.recording)[[0, 2]]
    length = float(np.linalg.norm(way))
    if length < PROGRESSION_M:
        yield trial.info(
            "heading", f"the body moves {length:.2f} m (treadmill?): x is where the pelvis faces", code=Code.ON_THE_SPOT
        )
        return
    facing = pelvis.rotation[pelvis.determined][:, [0, 2], 0].mean(axis=0)
    cosine = float(facing @ way) / max(float(np.linalg.norm(facing)) * length, 1e-12)
    angle = float(np.rad2deg(np.arccos(np.clip(cosine, -1, 1))))
    if angle > ALONG_DEG:
        yield trial.warning(
            "heading",
            f"the pelvis faces {angle:.0f} deg away from the {length:.2f} m that the body moves",
            "if the person did not walk backwards or turn, the pelvis markers are exchanged (front and back, or sides)",
            code=Code.HEADING,
        )


def sides(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether right markers lie to the right of their left ones, seen along the pelvis."""
    pelvis = trial.pelvis
    if pelvis is None:
        return
    right = pelvis.rotation[:, :, 2]
    wrong: list[str] = []
    when: list[slice] = []
    farthest = 0.0
    for name, other in pairs(trial):
        apart = trial.path(name) - trial.path(other)
        lateral = np.einsum("fi,fi->f", apart, right)
        known = np.isfinite(lateral) & pelvis.determined
        if known.sum() < 3:
            continue
        bad = known & (lateral < -WRONG_SIDE_M)
        if bad.sum() > 0.5 * known.sum():
            away = -float(np.median(lateral[bad]))
            wrong.append(f"'{name}' and '{other}' by {1e3 * away:.0f} mm")
            farthest = max(farthest, away)
            when = runs(bad)
    if wrong:
        severity = Severity.WARNING if trial.is_isolated and farthest < CROSSED_M else Severity.ERROR
        yield trial.finding(
            severity,
            "sides",
            f"right markers lie to the left of their left ones: {listed(wrong)} ({spans(trial.recording.time, when)})",
            "exchange the labels of right and left in the file",
            cause="right and left are exchanged in the labels" if severity is Severity.ERROR else "",
            weight=10.0,
            code=Code.SIDES_EXCHANGED,
        )


def pairs(trial: TrialEvidence) -> Iterator[tuple[str, str]]:
    """Markers of the right side of pelvis and legs that have a namesake on the left, in this trial."""
    tracking = trial.marker_set.tracking
    for a, b in permutations(tracking.get("pelvis", ()), 2):
        if a in trial.place and b in trial.place and mirrored(a, b):
            yield a, b
    for segment in LEGS:
        ours, theirs = tracking.get(f"{segment}_r", ()), tracking.get(f"{segment}_l", ())
        # A built-in pattern with {S} or {s} gives both sides in one order; a user's own lists may differ.
        for a, b in zip(ours, theirs, strict=False):
            if a in trial.place and b in trial.place and mirrored(a, b):
                yield a, b


def mirrored(a: str, b: str) -> bool:
    """Whether two labels differ only by R and L at one place."""
    different = [(x, y) for x, y in zip(a.lower(), b.lower(), strict=False) if x != y]
    return len(a) == len(b) and different == [("r", "l")]
