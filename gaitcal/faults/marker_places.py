"""Whether the markers of pelvis and legs lie at their segments in the static trial.

Each segment is a line between landmarks: ASIS to knee, knee to ankle, heel to toe, sacrum to the middle of the ASIS. A
marker lies at most 0.088 body heights from the line of its segment on thirteen people.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gaitcal.arrays import Array
from gaitcal.codes import Code
from gaitcal.faults.evidence import TrialEvidence
from gaitcal.faults.several_statics import still_positions
from gaitcal.findings import Finding, Severity, listed
from gaitcal.model.linkage import SIDES

LIMBS = ("thigh", "shank")
FARTHEST = 0.14
"""Share of body height; a marker on a stick is farther off than skin, by some 0.05."""
ELSEWHERE, CLEARLY = 0.06, 0.4
"""From the first share of body height on, a marker of a thigh or shank that another of these is nearer to by the second
belongs to that one: on thirteen people the nearest such neighbour is 0.9 times as far as the marker's own segment."""


def on_segments(trial: TrialEvidence) -> Iterator[Finding]:
    """Markers of a static trial that lie elsewhere than at their segment."""
    lines = _lines(trial)
    if not lines:
        return
    told = []
    for label, position in still_positions(trial).items():
        segment = trial.marker_set.segment_of.get(label)
        if segment not in lines:
            continue
        away = {other: _distance(position, *ends) for other, ends in lines.items()}
        nearest = min(away, key=lambda other: away[other])
        share = away[segment] / trial.subject.height
        limbs = segment.startswith(LIMBS) and nearest.startswith(LIMBS)
        other = limbs and share > ELSEWHERE and away[nearest] < CLEARLY * away[segment]
        if share > FARTHEST or other:
            told.append(f"'{label}' {1e3 * away[segment]:.0f} mm from {segment} (nearest: {nearest})")
    if told:
        yield trial.finding(
            Severity.ERROR,
            "marker places",
            f"{listed(told)}; usual: up to {1e3 * ELSEWHERE * trial.subject.height:.0f} mm, and nearer than any other",
            "label the static trial again, or give the marker no weight and leave it out of the file",
            cause="markers do not lie at the segments that they are to follow",
            weight=5.0,
            code=Code.MARKER_ELSEWHERE,
        )


def _lines(trial: TrialEvidence) -> dict[str, tuple[Array, Array]]:
    """Segment -> its two ends, (3,) m."""
    p = trial.posture or {}
    ends = {
        f"{segment}_{side}": (f"{a}_{side}", f"{b}_{side}")
        for side in SIDES
        for segment, a, b in (
            ("thigh", "asis", "knee_lat"),
            ("shank", "knee_lat", "ankle_lat"),
            ("foot", "heel", "toe"),
        )
    }
    out = {segment: (p[a], p[b]) for segment, (a, b) in ends.items() if a in p and b in p}
    if all(name in p for name in ("asis_r", "asis_l", "sacrum")):
        out["pelvis"] = (p["sacrum"], 0.5 * (p["asis_r"] + p["asis_l"]))
    return out


def _distance(point: Array, a: Array, b: Array) -> float:
    """m, of a point (3,) from the line from a to b."""
    along = b - a
    share = float(np.clip((point - a) @ along / max(float(along @ along), 1e-12), 0.0, 1.0))
    return float(np.linalg.norm(point - a - share * along))
