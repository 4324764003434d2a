"""The lines through the epicondyles of the static trial against pelvis, malleoli, and how the knees bend in walks.

Whether the lines through the epicondyles of a person's knees lie where knees have them, seen from above.

With k the angle of the line from the medial to the lateral epicondyle, a that of the malleoli and h that of the line
through both ASIS, each from the body's medial-lateral axis, positive where the lateral end lies forward, three
witnesses tell how far the line is off:

    bending    k - (axis about which the knee bends in a walk)     0 deg
    pelvis     k - h, the rotation of the hip                      0 deg
    torsion    (k - a) - TORSION_DEG, outward torsion of the shank

x_i with standard deviations s_i give e = sum(x_i / s_i^2) / sum(1 / s_i^2), whose own is s = sum(1 / s_i^2)^(-1/2). The
witnesses share k, so that people's own build scatters e less than that and no error of a marker does.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array
from gaitcal.codes import Code
from gaitcal.faults.body_plan import body_axes
from gaitcal.faults.evidence import TrialEvidence
from gaitcal.faults.static_landmarks import label_words, landmarks
from gaitcal.findings import Finding, Severity
from gaitcal.model.linkage import SIDES
from gaitcal.model.segment_frames import sign

TORSION_DEG = 10.0
"""Mean outward torsion between the lines of epicondyles and malleoli as they are palpated: 3 to 20 deg on the legs of
five recordings of people. By computed tomography it is 35 (Strecker et al. 1997), from the back of the tibia."""
BOTH_DEG = {"bending": 6.0, "pelvis": 10.0, "torsion": 8.0}
"""sd of the mean of both legs. Measured on clean recordings: bending -5 to 7.5 deg on eight people, pelvis -4 to 2.5,
torsion 5 to 16. Pelvis and torsion are wider: by tomography version of the femur scatters by 8.7 and torsion of the
tibia by 8.0 deg (Strecker et al. 1997, 505 femora and 504 tibiae: 17.4 and 15.9 for two standard deviations)."""
ONE_DEG = {"bending": 7.0, "pelvis": 12.0, "torsion": 9.0}
"""sd of one leg: bending -14 to 8, pelvis -11 to 11, torsion 3 to 20 deg."""
ODD, ODD_BOTH = 3.0, 2.5
"""Standard deviations of e from which one knee is doubted, and both where a walk shows how they bend: 11 deg. Of clean
recordings the mean of both is off by 4.0 deg at most (3.2 RMS), that of one leg by 10."""
OWN = 1.5
"""Least standard deviations of the bending alone, where a walk shows it: people whose thighs and shanks are twisted,
each the other way, bend about their epicondyles all the same."""
AGREE = 0.5
"""Standard deviations by which every other witness must say the same."""


@dataclass(frozen=True, kw_only=True)
class OddLine:
    """Epicondyles whose line is not the knee's."""

    sides: tuple[str, ...]
    turn: float
    """Degrees, e; positive where the lateral ends lie too far forward or the medial ones too far back."""
    usual: float
    """deg, largest e of people."""
    witnesses: Mapping[str, float]
    """deg, x of each."""


def odd_lines(p: Mapping[str, Array], bending: Mapping[str, float]) -> Iterator[OddLine]:
    """Knees whose epicondyles lie off their line: both, or one.

    p: landmarks of the static trial, (3,) m each, y up. bending: side -> deg of the walks, positive as k; may be empty.
    """
    legs = {side: _witnesses(p, side, bending.get(side)) for side in SIDES}
    mean = {name: 0.5 * (x + legs["l"][name]) for name, x in legs["r"].items() if name in legs["l"]}
    both = _odd(SIDES, mean, BOTH_DEG)
    alike = [_told(legs[side], ONE_DEG)[0] for side in SIDES]
    if both is not None and min(alike) * max(alike) > 0 and min(map(abs, alike)) > 0.5 * abs(both.turn):
        yield both
        return
    ones = [_odd((side,), legs[side], ONE_DEG) for side in SIDES]
    yield from (one for one in ones if one is not None)


def _witnesses(p: Mapping[str, Array], side: str, bending: float | None) -> dict[str, float]:
    """Degrees by name, those that can be told; empty without a line through the knee."""
    axes = body_axes(p)
    knee = None if axes is None else _line(p, axes, f"knee_med_{side}", f"knee_lat_{side}", side)
    if axes is None or knee is None:
        return {}
    found = {} if bending is None else {"bending": bending}
    pelvis = _line(p, axes, *(("asis_l", "asis_r") if side == "r" else ("asis_r", "asis_l")), side)
    if pelvis is not None:
        found["pelvis"] = knee - pelvis
    ankle = _line(p, axes, f"ankle_med_{side}", f"ankle_lat_{side}", side)
    if ankle is not None:
        found["torsion"] = knee - ankle - TORSION_DEG
    return found


def _line(p: Mapping[str, Array], axes: Array, medial: str, lateral: str, side: str) -> float | None:
    """Degrees from the body's medial-lateral axis, positive where the lateral end lies forward."""
    if medial not in p or lateral not in p:
        return None
    forward, _, right = (p[lateral] - p[medial]) @ axes
    return float(np.rad2deg(np.arctan2(forward, sign(side) * right)))


def _told(found: Mapping[str, float], sd: Mapping[str, float]) -> tuple[float, float]:
    """The estimate e and its s, deg."""
    weight = {name: sd[name] ** -2 for name in found}
    total = sum(weight.values())
    if not total:
        return 0.0, float("inf")
    return sum(weight[name] * x for name, x in found.items()) / total, total**-0.5


def _odd(sides: tuple[str, ...], found: Mapping[str, float], sd: Mapping[str, float]) -> OddLine | None:
    turn, spread = _told(found, sd)
    usual = spread * (ODD_BOTH if len(sides) == 2 and "bending" in found else ODD)
    if len(found) < 2 or abs(turn) < usual:
        return None
    agree = [np.sign(turn) * x / sd[name] > (OWN if name == "bending" else AGREE) for name, x in found.items()]
    return OddLine(sides=sides, turn=turn, usual=usual, witnesses=found) if all(agree) else None


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
