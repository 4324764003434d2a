"""The lines through the epicondyles of the static trial against pelvis, malleoli, and how the knees bend in walks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from gaitcal.codes import Code
from gaitcal.faults.evidence import TrialEvidence
from gaitcal.faults.knee_geometry import OddLine, odd_lines
from gaitcal.faults.static_landmarks import label_words, landmarks
from gaitcal.findings import Finding, Severity
from gaitcal.model.linkage import SIDES
from gaitcal.model.segment_frames import sign

_WORDS = {
    "bending": "against the axis about which the knees bend in walks",
    "pelvis": "against the line through the ASIS",
    "torsion": "against the malleoli, less the usual torsion of a shank",
}


def knee_lines(trials: Sequence[TrialEvidence], said: Sequence[Finding]) -> Iterator[Finding]:
    """Knees whose epicondyles lie off their line, where nothing that was `said` already doubts these landmarks."""
    static = next((trial for trial in trials if trial.is_static), None)
    if static is None or any(_doubts_landmarks(found, static.name) for found in said):
        return
    for found in odd_lines(landmarks(static), bending(trials)):
        yield _finding(static, found)


def bending(trials: Sequence[TrialEvidence]) -> dict[str, float]:
    """Side -> deg from the axis of the knee to its epicondyles, median of the walks; where they tell one."""
    out: dict[str, float] = {}
    for side in SIDES:
        links = [trial.links.get(f"knee_{side}") for trial in trials if trial.is_gait]
        turns = [link.axis_turn for link in links if link is not None and link.axis_turn is not None]
        if turns:
            out[side] = sign(side) * float(np.rad2deg(np.median(turns)))
    return out


def _doubts_landmarks(found: Finding, static: str) -> bool:
    if found.severity is Severity.INFO:
        return False
    spoilt = found.severity is Severity.ERROR or found.topic in ("landmarks", "posture")
    return (found.where == static and spoilt) or "epicondyles" in found.cause


def _finding(static: TrialEvidence, found: OddLine) -> Finding:
    both = len(found.sides) == 2
    names = [label_words(static, f"knee_{end}_{side}") for side in found.sides for end in ("lat", "med")]
    knees = "both knees" if both else f"the {'right' if found.sides[0] == 'r' else 'left'} knee"
    way = "forward" if found.turn > 0 else "back"
    told = ", ".join(f"{x:+.0f} deg {_WORDS[name]}" for name, x in found.witnesses.items())
    return static.warning(
        "landmarks",
        f"seen from above: {told}; together {found.turn:+.0f} deg, usual within {found.usual:.0f}",
        f"look at {', '.join(names)} in the static trial (person, photograph), and record it again; hip rotation and "
        "knee adduction are wrong by as much",
        cause=f"the lateral and medial markers of {knees} lie about "
        f"{abs(found.turn):.0f} deg off the axis on which a knee bends, the lateral end too far {way}",
        leg="" if both else found.sides[0],
        weight=abs(found.turn) / found.usual,
        code=Code.KNEE_MARKERS,
    )
