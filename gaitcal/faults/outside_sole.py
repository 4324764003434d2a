"""Centres of pressure outside of the feet that press on the plates, frame by frame.

Which frames those are is told by `dynamics/off_sole.py`, as for the tracked motion, whose torques do not count there.
A plate whose load is far from both feet, or under the other foot, is told in `contacts.py`; a fault that puts soles,
plates or clocks in disorder is told by its own check, and what it does here is not told again (`_explained`).
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.codes import Code
from gaitcal.dynamics.foot_contact import UNDER_FOOT, Loading, near
from gaitcal.dynamics.off_sole import Place, divided_cause, divided_frames, places_of
from gaitcal.faults.contacts import FEET, Feet, Step, feet_of, steps
from gaitcal.faults.evidence import TrialEvidence
from gaitcal.faults.plates import PLATES_ELSEWHERE
from gaitcal.findings import Finding, Severity
from gaitcal.io.intervals import runs, spans
from gaitcal.model.linkage import SIDES

TOPIC = "plate to foot"
TOLD_SHARE, TOLD_S = 0.02, 0.03
"""Share of the impulse of a plate under a foot, and s, that must lie outside to be told: landing and lifting off are
over in 10 to 20 ms (Whittle 1999), and bear less than that share where clocks differ by a few frames."""
ALIKE = 0.7
"""Cosine between directions that are told as one."""
ENDWAYS = 0.7
"""Cosine with the line of the foot above which a place is behind or in front of it, and not beside it."""
IN_AIR = 0.5
"""Of the load outside of a foot: that much while it moves is a matter of clocks, not of places."""
DISORDER = ("units", "axes", "sides", "exchanged", "time", "forces")
"""Topics of warnings and errors about what puts centres of pressure off their feet by itself."""


@dataclass(frozen=True, kw_only=True)
class Outside:
    """What a plate reports outside of a foot, in all its loadings by that foot."""

    plate: str
    foot: int
    frames: BoolArray
    """(nf,)."""
    away: Array
    """(n,) m, in these frames."""
    moving: float
    """Of the load in these frames: while the foot is in the air by its motion."""
    shift: Array
    """(2,) m, x and z of the laboratory: the mean way outwards, weighed by the load."""
    along: float
    """Cosine of that way with the line from heel to toe."""
    right: float
    """The same with the direction to the right of that line."""
    share: float
    """Of the loaded frames."""
    impulse: float
    """Of the loadings."""

    @property
    def where(self) -> str:
        """In words."""
        if abs(self.along) > ENDWAYS:
            return "in front of the toes" if self.along > 0 else "behind the heel"
        return f"beside the foot, to its {'right' if self.right > 0 else 'left'}"

    def words(self, time: Array) -> str:
        """Plate and foot, when, how far and where, and how much of the load it is."""
        median, most = 1e3 * float(np.median(self.away)), 1e3 * float(self.away.max())
        return (
            f"plate {self.plate}, {FEET[self.foot]} foot, {spans(time, runs(self.frames))}: {median:.0f} mm (at most "
            f"{most:.0f} mm) {self.where}, in {100 * self.share:.0f} % of the loaded frames "
            f"({100 * self.impulse:.0f} % of the impulse)"
        )


def outside_sole(trial: TrialEvidence, others: Sequence[Finding]) -> Iterator[Finding]:
    """Loaded frames of all plates whose centre of pressure is outside of the soles that may press on the plate.

    `others`: what the other checks found in this trial.
    """
    feet = feet_of(trial)
    if feet is None or not trial.recording.plates:
        return
    made = [step for step in steps(trial, feet) if trial.trial.plates.get(step.plate.name) != "none"]
    loadings = [_loading(trial, step) for step in made]
    places = places_of(loadings, feet.points(trial.subject.height), feet.time)
    outside = np.zeros((len(loadings), len(feet.time)), dtype=bool)
    for own, one, place, step in zip(outside, loadings, places, made, strict=True):
        # what is further away is told in contacts.py
        own[one.frames] = place.outside & ((step.distance if one.foot == step.foot else step.other) < UNDER_FOOT)
    told_divided = np.zeros_like(outside)
    for i, k in combinations(range(len(loadings)), 2):
        told_divided[[i, k]] |= divided_frames(loadings[i], loadings[k], (places[i], places[k]), len(feet.time))
    made_up = {one.plate.name for one, own in zip(loadings, told_divided, strict=True) if own.any()}
    if made_up:
        yield _divided(trial, feet.time, loadings, places, told_divided)
    found = []
    for plate, foot in dict.fromkeys((x.plate.name, x.foot) for x in loadings if x.plate.name not in made_up):
        own_ones = [i for i, one in enumerate(loadings) if (one.plate.name, one.foot) == (plate, foot)]
        off = _outside(feet, [(loadings[i], places[i], outside[i]) for i in own_ones])
        found += [] if off is None else [off]
    yield from _findings(trial, feet.time, [off for off in found if not _explained(trial, off, others)])


def _loading(trial: TrialEvidence, step: Step) -> Step:
    """A step under the foot that the study names, or else the nearer one."""
    side = trial.trial.plates.get(step.plate.name)
    foot = SIDES.index(side) if side in SIDES else step.foot
    return replace(step, foot=foot)


def _outside(feet: Feet, parts: Sequence[tuple[Loading, Place, BoolArray]]) -> Outside | None:
    """What the loadings of one plate by one foot have outside, in (nf,) frames each; None where it is too little."""
    frames = np.any([off for *_, off in parts], axis=0)
    loaded = np.concatenate([one.load for one, *_ in parts])
    chosen = np.concatenate([off[one.frames] for one, _, off in parts])
    away = np.concatenate([place.away for _, place, _ in parts])[chosen]
    impulse = float(loaded[chosen].sum() / loaded.sum())
    if impulse < TOLD_SHARE or chosen.sum() * float(np.median(np.diff(feet.time))) < TOLD_S:
        return None
    way = np.concatenate([place.way for _, place, _ in parts])[chosen]
    foot = parts[0][0].foot
    line = np.concatenate([(feet.toe - feet.heel)[one.frames, foot][:, [0, 2]] for one, *_ in parts])[chosen]
    line = line / np.maximum(np.linalg.norm(line, axis=1, keepdims=True), 1e-9)
    right = np.column_stack([-line[:, 1], line[:, 0]])
    weights = loaded[chosen]
    down = near(feet.resting(foot), feet.time)
    in_air = np.concatenate([~down[one.frames] for one, *_ in parts])[chosen]
    mean = [float(np.average(np.sum(way * axis, axis=1), weights=weights)) for axis in (line, right)]
    return Outside(
        plate=parts[0][0].plate.name,
        foot=foot,
        frames=frames,
        away=away,
        moving=float(np.average(in_air, weights=weights)),
        shift=np.average(away[:, None] * way, axis=0, weights=weights),
        along=mean[0] / max(float(np.linalg.norm(mean)), 1e-9),
        right=mean[1],
        share=float(chosen.mean()),
        impulse=impulse,
    )


def _findings(trial: TrialEvidence, time: Array, found: Sequence[Outside]) -> Iterator[Finding]:
    """One finding where feet are in the air meanwhile, one where all plates are off in one direction of the room, else
    one a plate and foot.
    """
    if not found:
        return
    words = "; ".join(off.words(time) for off in found)
    if np.average([off.moving for off in found], weights=[off.impulse for off in found]) > IN_AIR:
        yield trial.warning(
            TOPIC,
            words,
            "compare the clocks of markers and forces (time columns, first frames); no torque of a leg counts in these "
            "frames",
            cause="plates are loaded while the foot that stood on them is in the air",
            weight=2.0,
            code=Code.LOADED_IN_AIR,
        )
        return
    shifts = np.array([off.shift / np.linalg.norm(off.shift) for off in found])
    if len({off.plate for off in found}) > 1 and (shifts @ shifts.T).min() > ALIKE:
        yield trial.warning(
            TOPIC,
            words,
            "check the positions of the plates in the room (corners), and the origin of the markers; no torque of a "
            "leg counts in these frames",
            cause=PLATES_ELSEWHERE,
            weight=2.0,
            code=Code.PLATES_ELSEWHERE,
        )
        return
    for off in found:
        yield trial.warning(
            TOPIC,
            off.words(time),
            "check the place of this plate (corners, origin of its moments), whether something else stood on it, and "
            "the heel and toe markers; no torque of this leg counts in these frames",
            cause=f"the centre of pressure of plate {off.plate} leaves the {FEET[off.foot]} foot",
            leg=SIDES[off.foot],
            weight=2.0,
            code=Code.PRESSURE_LEAVES_FOOT,
        )


def _divided(
    trial: TrialEvidence, time: Array, loadings: Sequence[Loading], places: Sequence[Place], divided: BoolArray
) -> Finding:
    """Two plates with one centre of pressure, (loadings, nf) frames."""
    both: BoolArray = np.asarray(divided.any(axis=0))
    names = list(dict.fromkeys(one.plate.name for one, own in zip(loadings, divided, strict=True) if own.any()))
    off = [p.away[own[x.frames] & p.outside] for x, p, own in zip(loadings, places, divided, strict=True)]
    away = 1e3 * np.concatenate(off)
    how_far = f": {np.median(away):.0f} mm (at most {away.max():.0f} mm) outside of the foot" if len(away) else ""
    loaded = sum(len(x.load) for x, own in zip(loadings, divided, strict=True) if own.any())
    return trial.warning(
        TOPIC,
        f"{spans(time, runs(both))}{how_far}, in {100 * divided.sum() / loaded:.0f} % of the loaded frames",
        "export what each plate or belt measured by itself; no torque of either leg counts in these frames",
        cause=divided_cause(names),
        weight=3.0,
        code=Code.DIVIDED_FORCE,
    )


def _explained(trial: TrialEvidence, off: Outside, others: Sequence[Finding]) -> bool:
    """Whether another warning or error of the trial says why the centre of pressure is not under the foot."""
    blaming = [f for f in others if f.severity is not Severity.INFO]
    if any(f.topic in DISORDER or f.cause == PLATES_ELSEWHERE for f in blaming):
        return True
    plate = re.compile(rf"\bplate {re.escape(off.plate)}(?!\w)", re.IGNORECASE)
    if any(plate.search(f.evidence) for f in blaming if f.topic in (TOPIC, "plates")):
        return True
    ends = [f"{end}_{SIDES[off.foot]}" for end in ("heel", "toe")]
    labels = [label for end in ends for label in trial.marker_set.landmarks.get(end, ())]
    return any(f"'{label}'" in f.evidence for f in blaming for label in labels)
