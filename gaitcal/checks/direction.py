"""Directions: which way is up, which way the person faces and goes, which side is right."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gaitcal.checks.evidence import TrialEvidence
from gaitcal.findings import Finding, Severity, listed
from gaitcal.recording.axes import PROGRESSION_M, net_progression
from gaitcal.recording.intervals import runs, spans

ALONG_DEG = 50.0
"""Angle between facing and going above which the person does not walk forwards."""
TILT_DEG = 60.0
"""Largest tilt of the pelvis in standing and walking."""
WRONG_SIDE_M = 0.02
"""How far a right marker may lie to the left of its left one, as feet may cross."""


def upright(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether the body stands upright in the y-up axes that were made of the file's."""
    pelvis = trial.pelvis
    if pelvis is None or trial.is_isolated:
        return
    tilt = np.rad2deg(np.arccos(np.clip(pelvis.rotation[pelvis.determined][:, 1, 1], -1, 1)))
    if (middle := float(np.median(tilt))) > TILT_DEG:
        yield trial.error(
            "axes",
            f"the pelvis is tilted by {middle:.0f} deg against the vertical found; allowed: {TILT_DEG:.0f} deg",
            "write the file with one of its axes vertical; check right, left, front and back of the pelvis",
        )


def heading(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether the person goes where the pelvis faces, and is not carried along sideways."""
    pelvis = trial.pelvis
    if pelvis is None or not trial.is_gait:
        return
    way = net_progression(trial.recording)[[0, 2]]
    length = float(np.linalg.norm(way))
    if length < PROGRESSION_M:
        yield trial.info("heading", f"the body moves {length:.2f} m (treadmill?): x is where the pelvis faces")
        return
    facing = pelvis.rotation[pelvis.determined][:, [0, 2], 0].mean(axis=0)
    cosine = float(facing @ way) / max(float(np.linalg.norm(facing)) * length, 1e-12)
    angle = float(np.rad2deg(np.arccos(np.clip(cosine, -1, 1))))
    if angle > ALONG_DEG:
        yield trial.warning(
            "heading",
            f"the pelvis faces {angle:.0f} deg away from the {length:.2f} m that the body moves",
            "if the person did not walk backwards or turn, the pelvis markers are exchanged (front and back, or sides)",
        )


def sides(trial: TrialEvidence) -> Iterator[Finding]:
    """Whether right markers lie to the right of their left ones, seen along the pelvis."""
    pelvis = trial.pelvis
    if pelvis is None:
        return
    right = pelvis.rotation[:, :, 2]
    wrong: list[str] = []
    when: list[slice] = []
    for name, other in pairs(trial):
        apart = trial.path(name) - trial.path(other)
        lateral = np.einsum("fi,fi->f", apart, right)
        known = np.isfinite(lateral) & pelvis.determined
        if known.sum() < 3:
            continue
        bad = known & (lateral < -WRONG_SIDE_M)
        if bad.sum() > 0.5 * known.sum():
            wrong.append(f"'{name}' and '{other}' by {-1e3 * float(np.median(lateral[bad])):.0f} mm")
            when = runs(bad)
    if wrong:
        severity = Severity.WARNING if trial.is_isolated else Severity.ERROR
        yield trial.finding(
            severity,
            "sides",
            f"right markers lie to the left of their left ones: {listed(wrong)} ({spans(trial.recording.time, when)})",
            "exchange the labels of right and left in the file, or with [markers.rename]",
        )


def pairs(trial: TrialEvidence) -> Iterator[tuple[str, str]]:
    """Markers of the right leg that have a namesake on the left, in this trial."""
    tracking = trial.marker_set.tracking
    for segment in ("thigh", "shank", "foot"):
        ours, theirs = tracking.get(f"{segment}_r", ()), tracking.get(f"{segment}_l", ())
        # A built-in pattern with {S} or {s} gives both sides in one order; a user's own lists may differ.
        for a, b in zip(ours, theirs, strict=False):
            if a in trial.place and b in trial.place and mirrored(a, b):
                yield a, b


def mirrored(a: str, b: str) -> bool:
    """Whether two labels differ only by R and L at one place."""
    different = [(x, y) for x, y in zip(a.lower(), b.lower(), strict=False) if x != y]
    return len(a) == len(b) and different == [("r", "l")]
