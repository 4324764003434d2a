"""The landmarks of a static trial against the body of a person: exchanged, displaced, or of another height."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from gaitcal.arrays import Array
from gaitcal.codes import Code
from gaitcal.faults.evidence import TrialEvidence
from gaitcal.faults.landmark_faults import Displaced, Exchange, exchanged, faults, height_factor
from gaitcal.faults.lengths import HIP_HEIGHT, hip_height
from gaitcal.faults.measure import Measure
from gaitcal.faults.plan import measures
from gaitcal.faults.posture import standing_legs
from gaitcal.findings import Finding, Severity, listed
from gaitcal.model.landmark_names import REQUIRED

IMPOSSIBLE_Z = 5.5
"""Standard deviations from which no body has such a length."""
GROSS_M = 0.060
"""A landmark this far off moves a joint centre by more than the 20 mm that its prior allows: the trial is refused."""
EVIDENCE = 3
"""Measures that are told as evidence."""
_USED = ("asis", "sacrum", "knee_lat", "knee_med", "ankle_lat", "ankle_med", "heel", "toe")
_WAYS = (("back", "forward"), ("down", "up"), ("left", "right"))


def proportions(trial: TrialEvidence) -> Iterator[Finding]:
    """Landmarks that carry each other's labels, or lie off their bones, in a static trial; a height that is wrong."""
    p = landmarks(trial)
    if not p:
        return
    given = trial.subject.height
    below = hip_height(trial)
    if below is not None and below < 0:
        yield _upside_down(trial, below)
        return
    if any(name not in p for name in REQUIRED):
        return  # told already as what keeps the nominal model from being made: the rest would be read askew without it
    found = list(faults(p, given))
    if any(isinstance(fault, Displaced) for fault in found):
        # A leg that is bent or lifted looks like landmarks off their bones: then only what posture leaves alone counts.
        stands = standing_legs(p, given)
        even = stands is None or not (stands.uneven or stands.bent or stands.sitting)
        found = found if even else list(faults(p, given, even=False))
    swapped = [pairs for fault in found if isinstance(fault, Exchange) for pairs in fault.pairs]
    sound = exchanged(p, tuple(swapped))
    stands = standing_legs(sound, given)
    straight = stands is None or not (stands.bent or stands.sitting)
    factor = height_factor(sound, given, even=straight)
    legs = hip_height(trial) if straight else None
    if factor != 1.0 or (not found and legs is not None and not HIP_HEIGHT[0] <= legs / given <= HIP_HEIGHT[1]):
        yield _height(trial, sound, factor, legs)
        found = list(faults(p, factor * given))
    for fault in found:
        if isinstance(fault, Exchange):
            yield _exchanged(trial, fault)
        else:
            yield _displaced(trial, fault)
    if not found:
        yield from _impossible(trial, measures(sound, factor * given))


def _upside_down(trial: TrialEvidence, below: float) -> Finding:
    return trial.finding(
        Severity.ERROR,
        "landmarks",
        f"the ASIS lie {-below:.2f} m below the ankles",
        "write the file with its vertical axis upwards",
        cause="the vertical axis of the static trial points down",
        weight=10.0,
        code=Code.NOT_UPRIGHT,
    )


def landmarks(trial: TrialEvidence) -> dict[str, Array]:
    """Landmark -> (3,) m, of pelvis and legs, mean of the still window of a static trial; empty where there is none."""
    posture = trial.posture
    if posture is None:
        return {}
    return {name: point for name, point in posture.items() if name == "sacrum" or name.rsplit("_", 1)[0] in _USED}


def _exchanged(trial: TrialEvidence, fault: Exchange) -> Finding:
    pairs = label_pairs(trial, fault.pairs)
    words = listed([f"'{a}' and '{b}'" for a, b in pairs], 4)
    if {"asis_r", "heel_r", "knee_lat_r"} <= {name for pair in fault.pairs for name in pair}:
        words = f"right and left ({words}), or an axis is mirrored: they"
    swaps = ", ".join(f'"{a}" = "{b}", "{b}" = "{a}"' for a, b in pairs)
    return trial.finding(
        Severity.ERROR,
        "landmarks",
        _evidence(fault.before),
        f"exchange the labels in this file or, where every trial that has them has them so, with [markers] rename = "
        f"{{ {swaps} }}",
        cause=f"{words} carry each other's labels in the static trial",
        leg=_leg(*(name for pair in fault.pairs for name in pair)),
        weight=10.0,
        code=Code.LANDMARKS_EXCHANGED,
    )


def _displaced(trial: TrialEvidence, fault: Displaced) -> Finding:
    way = int(np.argmax(np.abs(fault.away)))
    where = _WAYS[way][int(fault.away[way] > 0)]
    name = label_words(trial, fault.landmark)
    rivals = [f"{label_words(trial, other)} by {1e3 * m:.0f} mm" for other, m in fault.rivals[:3]]
    return trial.finding(
        Severity.ERROR if fault.size > GROSS_M else Severity.WARNING,
        "landmarks",
        _evidence(fault.before) + (f"; as well it could be {' or '.join(rivals)}" if rivals else ""),
        "look where the marker sat (person, photograph, video), and record or label the static trial again",
        cause=f"{name} lies about {1e3 * fault.size:.0f} mm off its bone in the static trial, mostly {where}",
        leg=_leg(fault.landmark),
        weight=fault.size / 0.02,
        code=Code.LANDMARK_DISPLACED,
    )


def _height(trial: TrialEvidence, p: Mapping[str, Array], factor: float, legs: float | None) -> Finding:
    given = trial.subject.height
    lengths = [m for m in measures(p, given) if m.absolute and abs(m.z) > 1.0]
    found = ""
    if legs is not None:
        low, high = HIP_HEIGHT
        found = f"the ASIS stand {legs:.3f} m above the ankles; a height of {given:.2f} m lets expect "
        found += f"{low * given:.2f} to {high * given:.2f} m; "
    likely = f"all lengths together fit {factor * given:.2f} m" if factor != 1.0 else "other lengths do not decide"
    return trial.finding(
        Severity.WARNING,
        "height",
        f"{found}{likely}{'; ' + _evidence(lengths) if factor != 1.0 and lengths else ''}",
        "correct subject.height_m, or the unit or scale of the markers",
        cause=f"a body height of {given:.2f} m does not go with the markers",
        weight=3.0,
        code=Code.BODY_HEIGHT,
    )


def _impossible(trial: TrialEvidence, found: list[Measure]) -> Iterator[Finding]:
    """Lengths that no body has, where no single fault explains them."""
    worst = [m for m in found if m.absolute and abs(m.z) > IMPOSSIBLE_Z]
    if worst:
        names = dict.fromkeys(name for m in worst for name in m.landmarks)
        yield trial.finding(
            Severity.ERROR,
            "landmarks",
            _evidence(worst),
            f"look at {', '.join(label_words(trial, name) for name in names)}: labels, place, unit",
            cause="the static trial shows lengths that nobody has",
            weight=10.0,
            code=Code.IMPOSSIBLE_LENGTHS,
        )


def _evidence(found: tuple[Measure, ...] | list[Measure]) -> str:
    worst = sorted(found, key=lambda m: -abs(m.z))
    return ", ".join(m.words for m in worst[:EVIDENCE])


def label_words(trial: TrialEvidence, landmark: str) -> str:
    """The markers of a landmark, in words."""
    labels = trial.marker_set.landmarks.get(landmark, (landmark,))
    return " and ".join(f"'{label}'" for label in labels)


def label_pairs(trial: TrialEvidence, pairs: tuple[tuple[str, str], ...]) -> list[tuple[str, str]]:
    """The markers of exchanged landmarks, pair by pair."""
    of = trial.marker_set.landmarks
    return [labels for a, b in pairs for labels in zip(of.get(a, (a,)), of.get(b, (b,)), strict=False)]


def _leg(*names: str) -> str:
    """The leg that all these landmarks belong to; empty for both."""
    sides = {name[-1] for name in names if name != "sacrum"}
    return sides.pop() if len(sides) == 1 else ""
