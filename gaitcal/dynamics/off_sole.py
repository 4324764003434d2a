"""Centres of pressure outside of what presses on the plate: frames in which a plate does not tell the force of a foot.

The ground pushes and does not pull, so the centre of pressure lies in the convex hull of what touches the plate: of one
sole, or of both with the ground between where the other foot may press on the same plate. Markers tell that outline,
and a plate its centre, so well:

    allowed = OUTLINE_M + MOMENT_NM / F_y

A total force that a program divided between two feet is told by itself: both plates then report one centre of pressure,
between the feet.

Feet that plates measure in part only, or together with the other foot: frames in which no torque of a leg is known.

**Beside.** What of a sole rests beside all plates presses on the floor, and no plate tells how much. Two things speak
for a loss that matters, each by itself:

- more than a tenth of the half that rests, heel or toes, lies there (`MOST_BESIDE`). In a walk with 39 mm of the heel
  beside (9 % of the sole) they bear 60 % of the body as the other foot leaves the ground and 20 % in mid-stance, with
  the centre of pressure of what is measured far ahead. Where the plates read nothing yet, or no more, all that the foot
  bears may be on any part of it that lies beside;
- the centre of pressure comes near to what lies beside (`REACH_ALONG`, `REACH_ACROSS`). A heel whose marker is 26 mm
  beside the plate, 3 % of the sole, loses 12 % while the centre of pressure is within 40 mm of the edge, and nothing to
  speak of afterwards.

A foot bears a little before it is seen to rest, and after: as much of it is lost there as in the next resting frame.

Forces measured elsewhere play no part: these figures come from walks whose body's acceleration was asked afterwards.

**Shared.** A plate under both feet tells the sum of them: neither leg is known. Where the corners of a plate are not
known, the centre of pressure says whether the other foot stands on it too: it leaves the sole then.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Protocol

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.codes import Code
from gaitcal.dynamics.foot_contact import (
    HEEL_M,
    LANDING,
    LEAVING,
    SHAPE,
    SIDE_WORDS,
    FootPoints,
    SoleCells,
    Step,
    meeting,
    near,
    sole_of,
)
from gaitcal.dynamics.plate_errors import outline_known
from gaitcal.findings import Finding, Severity
from gaitcal.io.force_plate import BODY_N, LOADED_N, centre_on_ground
from gaitcal.io.intervals import runs, spans
from gaitcal.io.recording import ForcePlate
from gaitcal.model.linkage import SIDES

OUTLINE_M = 0.03
"""m, two standard deviations of the outline: 10 mm of heel and toe markers on skin or shoe, 8 mm of the sole's breadth
and of the toe marker's place across it, 8 mm of the plate's place (`plate_errors.py`). In 41 steps of nine people whose
plates are right no centre of more than a fifth of body weight lies outside at all; in two people that OpenSim
simulated, up to 13 mm."""
MOMENT_NM = 2.0
"""N·m, two standard deviations of a plate's moments: 4 cm at 50 N. An empty plate's reading of 5 N at 0.3 m of its
middle makes as much."""
SAME_M = 0.02
"""m within which two plates under two feet report one centre of pressure; a foot is three to five times as broad."""
EQUAL_M = 0.001
"""m, the same of two plates that are given to one foot: it may really press on both sides of their border."""
MOSTLY = 0.8
"""Of the frames in which both plates are loaded."""
DIVIDED = (
    "both plates report one centre of pressure, between the feet: the total force was divided, not measured under each "
    "foot"
)
DIRECTIONS = 240
"""Unit vectors in the floor; a distance from an edge 0.26 m long is short by at most 2 mm."""


@dataclass(frozen=True, kw_only=True)
class Loading:
    """One plate under load, the foot that it is given to, and where its load is."""

    plate: ForcePlate
    foot: int
    """0 right, 1 left."""
    frames: slice
    point: Array
    """(n, 3) m, centre of pressure at these frames."""
    load: Array
    """(n,) N, vertical force."""

    @staticmethod
    def of(plate: ForcePlate, foot: int, frames: slice, wrench: Array) -> Loading:
        """From the plate's wrench (nf, 6) about the laboratory origin at all frames."""
        own = wrench[frames]
        return Loading(
            plate=plate, foot=foot, frames=frames, point=centre_on_ground(own, surface_height(plate)), load=own[:, 1]
        )


@dataclass(frozen=True, kw_only=True)
class Place:
    """Where the centre of pressure of one loading lies against the outline of what presses on its plate."""

    away: Array
    """(n,) m outside, negative inside; -inf where a foot is not seen."""
    way: Array
    """(n, 2) unit vector, x and z of the laboratory: outwards."""
    allowed: Array
    """(n,) m."""

    @property
    def outside(self) -> BoolArray:
        """(n,) further outside than outline and plate leave open."""
        return np.asarray(self.away > self.allowed)


def surface_height(plate: ForcePlate) -> float:
    """m, of the plane in which the centre of pressure lies."""
    if plate.corners is not None and np.isfinite(plate.corners).all():
        return float(plate.corners[:, 1].mean())
    height = plate.point[np.nan_to_num(plate.force[:, 1]) > LOADED_N, 1]
    return float(np.nanmedian(height)) if np.isfinite(height).any() else 0.0


def sole_edge(feet: FootPoints, foot: int, frames: slice) -> Array:
    """(n, m, 2) m, x and z of the edge of a foot's sole (0 right, 1 left), as `dynamics.sole` shapes it.

    Toes stay on the ground when the heel has left it: the part before the toe marker keeps its length.
    """
    heel, toe, tip = (path[frames, foot] for path in (feet.heel, feet.toe, feet.tip))
    line = (toe - heel)[:, [0, 2]]
    back = np.linalg.norm(line, axis=1)
    forward = line / np.maximum(back, 1e-9)[:, None]
    length = back + np.linalg.norm(tip - toe, axis=1)
    begin = np.minimum(HEEL_M, 0.5 * length)
    part, share = np.array(SHAPE)
    ahead = begin[:, None] + (length - begin)[:, None] * part
    across = np.stack([-forward[:, 1], forward[:, 0]], axis=1)
    middle = heel[:, None, [0, 2]] + ahead[:, :, None] * forward[:, None]
    aside = 0.5 * feet.width * share[:, None] * across[:, None]
    return np.concatenate([middle - aside, middle + aside], axis=1)


def outside_hull(point: Array, edge: Array) -> tuple[Array, Array]:
    """(n,) m that points (n, 2) lie outside the convex hulls of points (n, m, 2), negative inside; (n, 2) which way.

    The distance is max_u ( u . p - max_v u . v ) over unit vectors u; -inf where a point is not a number.
    """
    angle = 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    ways = np.column_stack([np.cos(angle), np.sin(angle)])
    reach = np.full((len(point), DIRECTIONS), -np.inf)
    for k in range(edge.shape[1]):  # one after the other: a treadmill's loading may last for minutes
        np.maximum(reach, edge[:, k] @ ways.T, out=reach)
    beyond = point @ ways.T - reach
    beyond = np.where(np.isfinite(beyond), beyond, -np.inf)
    farthest = beyond.argmax(axis=1)
    away: Array = beyond[np.arange(len(point)), farthest]
    return away, ways[farthest]


def place_of(loading: Loading, others: Sequence[Loading], feet: FootPoints, time: Array) -> Place:
    """Where the centre of pressure of a loading lies; `others` are those of the other plates of the trial."""
    point, frames = loading.point[:, [0, 2]], loading.frames
    away, way = outside_hull(point, sole_edge(feet, loading.foot, frames))
    shared = near(_other_foot_presses(loading, others, feet, len(time)), time)[frames]
    if shared.any():
        both = np.concatenate([sole_edge(feet, foot, frames)[shared] for foot in (0, 1)], axis=1)
        away[shared], way[shared] = outside_hull(point[shared], both)
    return Place(away=away, way=way, allowed=OUTLINE_M + MOMENT_NM / np.maximum(loading.load, LOADED_N))


def _other_foot_presses(loading: Loading, others: Sequence[Loading], feet: FootPoints, count: int) -> BoolArray:
    """(nf,) the foot that the loading was not given to rests where this plate may be, and no other plate carries it."""
    foot, frames = 1 - loading.foot, loading.frames
    sole = sole_of(feet, foot, frames)
    here = sole.resting.copy()
    if outline_known(loading.plate, LOADED_N):
        here &= ~sole.beside([loading.plate])
    for other in others:
        meanwhile = np.zeros(count, dtype=bool)
        meanwhile[other.frames] = True
        meanwhile = meanwhile[frames]
        if outline_known(other.plate, LOADED_N) and other.plate.corners is not None:
            here &= ~(meanwhile[:, None] & ~sole.beside([other.plate]))
        elif other.foot == foot:
            here &= ~meanwhile[:, None]
    out = np.zeros(count, dtype=bool)
    out[frames] = here.any(axis=1)
    return out


def places_of(loadings: Sequence[Loading], feet: FootPoints, time: Array) -> list[Place]:
    """Where the centre of pressure of each loading lies."""
    return [
        place_of(one, [other for other in loadings if other.plate is not one.plate], feet, time) for one in loadings
    ]


class Pressed(Protocol):
    """A loading of a plate: where its load is, and how much of it."""

    @property
    def plate(self) -> ForcePlate:
        """The plate."""

    @property
    def foot(self) -> int:
        """0 right, 1 left."""

    @property
    def frames(self) -> slice:
        """In which it is loaded."""

    @property
    def point(self) -> Array:
        """(n, 3) m, centre of pressure at these frames."""

    @property
    def load(self) -> Array:
        """(n,) N."""


def one_centre(one: Pressed, other: Pressed, count: int) -> BoolArray:
    """(nf,) of `count` frames in which two plates report one centre of pressure; none unless they do as a rule.

    Two feet cannot: it is outside of one of them, if not of both. Nor can one foot across two plates, to the
    millimetre. What is too light to tell, at the ends of both loadings, belongs to these frames.
    """
    out = np.zeros(count, dtype=bool)
    first, last = max(one.frames.start, other.frames.start), min(one.frames.stop, other.frames.stop)
    if one.plate is other.plate or last <= first:
        return out
    mine, its = (slice(first - x.frames.start, last - x.frames.start) for x in (one, other))
    pressed = np.minimum(one.load[mine], other.load[its]) > BODY_N
    apart = np.linalg.norm((one.point[mine] - other.point[its])[:, [0, 2]], axis=1)
    same = apart < (SAME_M if one.foot != other.foot else EQUAL_M)
    if pressed.any() and same[pressed].mean() > MOSTLY:
        out[first:last] = same | ~pressed
    return out


def divided_frames(one: Loading, other: Loading, places: tuple[Place, Place], count: int) -> BoolArray:
    """(nf,) of `count` frames: a total force was divided between two plates, by their common centre of pressure."""
    same = one_centre(one, other, count)
    if one.foot != other.foot:
        off = any(place.outside[same[x.frames]].any() for x, place in zip((one, other), places, strict=True))
        same &= off
    return same


def off_sole_frames(steps: Sequence[Step], time: Array, feet: FootPoints) -> tuple[BoolArray, list[Finding]]:
    """(nf, 2) frames in which what a plate says is not the force on its foot, and what to say of them."""
    loadings = [Loading.of(step.plate, step.foot, step.frames, step.wrench) for step in steps]
    places = places_of(loadings, feet, time)
    off, findings = np.zeros((len(time), 2), dtype=bool), []
    told: dict[tuple[str, str], BoolArray] = {}
    """Cause and leg -> (nf,) frames."""
    for i, k in combinations(range(len(loadings)), 2):
        divided = divided_frames(loadings[i], loadings[k], (places[i], places[k]), len(time))
        if divided.any():
            off[divided] = True
            cause = divided_cause((loadings[i].plate.name, loadings[k].plate.name))
            told[cause, ""] = told.get((cause, ""), np.zeros(len(time), dtype=bool)) | divided
    for loading, place in zip(loadings, places, strict=True):
        own = np.zeros(len(time), dtype=bool)
        own[loading.frames] = place.outside
        own &= ~off[:, loading.foot]
        if own.any():
            off[:, loading.foot] |= own
            cause = f"the centre of pressure of plate {loading.plate.name} leaves the {SIDE_WORDS[loading.foot]} foot"
            key = cause, SIDES[loading.foot]
            told[key] = told.get(key, np.zeros(len(time), dtype=bool)) | own
    for (cause, leg), frames in told.items():
        found = f"{spans(time, runs(frames), most=len(time))}; not valid for {'this' if leg else 'either'} leg"
        code = Code.PRESSURE_LEAVES_FOOT if leg else Code.DIVIDED_FORCE
        findings.append(_note(code, cause, found, leg))
    return off, findings


def divided_cause(plates: Sequence[str]) -> str:
    """What is wrong where plates of these names report one centre of pressure."""
    return f"{DIVIDED} (plates {' and '.join(plates)})"


def _note(code: Code, cause: str, found: str, leg: str = "") -> Finding:
    """A fact that frames that are not valid already answer."""
    return Finding(
        severity=Severity.INFO, topic="plate to foot", where="", cause=cause, found=found, cure="", leg=leg, code=code
    )


MOST_BESIDE = 0.10
"""Of the area of a half of the sole: 17 mm of a heel."""
REACH_ALONG, REACH_ACROSS = 0.04, 0.02
"""m along and across the foot within which the pressure is spread round its centre."""
OFF_SOLE_M = 0.03
"""A centre of pressure further from the sole is not of this foot alone."""
OFTEN = 0.1
"""Share of the frames in which it must be, as the centre of a small load is noise."""


def beside_plates(
    steps: Sequence[Step], plates: Sequence[ForcePlate], time: Array, feet: FootPoints, loaded: BoolArray
) -> tuple[BoolArray, list[Finding]]:
    """(nf, 2) frames in which a foot rests partly beside its plates, and what to say of them.

    Parameters
    ----------
    plates : all that may carry a foot; those with an outline are one surface.
    loaded : (nf, 2) a plate carries the foot.
    """
    partly, findings = np.zeros_like(loaded), []
    surface = [plate for plate in plates if outline_known(plate, LOADED_N)]
    down: BoolArray = loaded | feet.resting
    for foot in range(loaded.shape[1]):
        for contact in runs(down[:, foot]):
            carriers = meeting(steps, foot, contact)
            if not carriers:
                continue
            unknown = [step for step in carriers if not outline_known(step.plate, LOADED_N)]
            if unknown:
                findings += [_no_outline(step) for step in unknown if step.plate.corners is not None]
                continue
            sole = sole_of(feet, foot, contact)
            beside = sole.beside(surface)
            lost = _bears_beside(sole, beside, loaded[contact, foot]) | _reached(sole, beside, carriers, contact)
            if lost.any():
                around = _around(lost, contact, time)
                partly[:, foot] |= around
                share = float(sole.share_of(beside)[lost].max())
                findings.append(_beside(carriers, foot, time[around], share))
    return partly, findings


def _bears_beside(sole: SoleCells, beside: BoolArray, loaded: BoolArray) -> BoolArray:
    """(nf,) what rests beside the plates may bear much, judged by motion; before and after resting as next to it."""
    resting = beside & sole.resting
    lost = (sole.share_of_halves(resting) > MOST_BESIDE).any(axis=1)
    lost |= resting.any(axis=1) & ~loaded  # all that the foot bears may be there
    down = np.flatnonzero(sole.resting.any(axis=1))
    if len(down):
        lost[: down[0]], lost[down[-1] + 1 :] = lost[down[0]], lost[down[-1]]
    return np.asarray(lost)


def _around(lost: BoolArray, contact: slice, time: Array) -> BoolArray:
    """(nf,) lost frames of a contact (its own), and those around it in which the foot may bear already, or still."""
    out = np.zeros(len(time), dtype=bool)
    out[contact] = lost
    if lost[0]:
        out |= (time < time[contact.start]) & (time > time[contact.start] - LANDING)
    if lost[-1]:
        out |= (time >= time[contact.stop - 1]) & (time < time[contact.stop - 1] + LEAVING)
    return out


def _reached(sole: SoleCells, beside: BoolArray, carriers: Sequence[Step], frames: slice) -> BoolArray:
    """(nf,) the centre of pressure comes near to a part of the sole that lies beside the plates."""
    wrench = np.sum([_own(step, frames) for step in carriers], axis=0)
    pressed = wrench[:, 1] > LOADED_N
    corners = [step.plate.corners for step in carriers if step.plate.corners is not None]
    centre = np.full((len(wrench), 3), np.nan)
    centre[pressed] = centre_on_ground(wrench[pressed], float(np.mean([c[:, 1].mean() for c in corners])))
    along, across = sole.offsets(centre)
    with np.errstate(invalid="ignore"):
        reached = beside & (along < REACH_ALONG) & (across < REACH_ACROSS)
    return np.asarray(reached.any(axis=1))


def _own(step: Step, frames: slice) -> Array:
    """(n, 6) the wrench of a step in `frames`, zero outside of it."""
    out = np.zeros((frames.stop - frames.start, 6))
    first, last = max(step.frames.start, frames.start), min(step.frames.stop, frames.stop)
    out[first - frames.start : last - frames.start] = step.wrench[first:last]
    return out


def shared_plates(
    steps: Sequence[Step], plates: Sequence[ForcePlate], time: Array, feet: FootPoints, on_floor: BoolArray
) -> tuple[BoolArray, list[Finding]]:
    """(nf,) frames in which one plate carries both feet, and what to say of them.

    Parameters
    ----------
    plates : all that may carry a foot.
    on_floor : (nf, 2) a foot is on the ground and no plate was given to it.
    """
    shared, findings = np.zeros(len(time), dtype=bool), []
    surface = [plate for plate in plates if outline_known(plate, LOADED_N)]
    for step in steps:
        other, frames = 1 - step.foot, step.frames
        if outline_known(step.plate, LOADED_N):
            sole = sole_of(feet, other, frames)
            here = (sole.share_of_halves(_only_on(step.plate, sole, surface)) > MOST_BESIDE).any(axis=1)
            both = np.zeros(len(time), dtype=bool)
            both[frames] = here
            both = near(both, time) & _within(frames, len(time))
        else:
            both = _within(frames, len(time)) & on_floor[:, other] & _leaves_sole(step, steps, feet, on_floor[:, other])
        if both.any():
            shared |= both
            findings.append(_shared(step, time[both]))
    return shared, findings


def _only_on(plate: ForcePlate, sole: SoleCells, surface: Sequence[ForcePlate]) -> BoolArray:
    """(nf, n) resting cells on this plate, and on no other one: an edge between two is not known to the millimetre."""
    others = [other for other in surface if other is not plate]
    return sole.resting & ~sole.beside([plate]) & sole.beside(others)


def _leaves_sole(step: Step, steps: Sequence[Step], feet: FootPoints, floor: BoolArray) -> bool:
    """Whether the centre of pressure is not under the foot alone while the other one stands somewhere."""
    frames = step.frames
    wrench = np.sum([_own(other, frames) for other in meeting(steps, step.foot, frames)], axis=0)
    chosen = floor[frames] & (wrench[:, 1] > LOADED_N)
    if not chosen.any():
        return False
    centre = centre_on_ground(wrench[chosen])
    cells = sole_of(feet, step.foot, frames).cells[chosen]
    away = np.linalg.norm((cells - centre[:, None])[:, :, [0, 2]], axis=2).min(axis=1)
    return bool(np.mean(away > OFF_SOLE_M) > OFTEN)


def _within(frames: slice, count: int) -> BoolArray:
    out = np.zeros(count, dtype=bool)
    out[frames] = True
    return out


def _note(code: Code, cause: str, found: str, leg: str = "") -> Finding:
    """A fact that frames that are not valid, or an outline that is not used, already answer."""
    return Finding(
        severity=Severity.INFO, topic="plate to foot", where="", cause=cause, found=found, cure="", leg=leg, code=code
    )


def _no_outline(step: Step) -> Finding:
    found = f"{step.words}: the centre of pressure leaves the plate's corners; corners not used"
    return _note(Code.PLATE_CORNERS, f"the corners of plate {step.plate.name} do not hold its forces", found)


def _beside(carriers: Sequence[Step], foot: int, times: Array, share: float) -> Finding:
    names = " and ".join(dict.fromkeys(step.plate.name for step in carriers))
    found = f"{100 * share:.0f} % of the sole of the {SIDE_WORDS[foot]} foot lie beside it; not valid for "
    found += f"this leg, {times[0]:.2f}-{times[-1]:.2f} s"
    return _note(Code.FOOT_BESIDE_PLATE, f"a foot rests partly beside plate {names}", found, SIDES[foot])


def _shared(step: Step, times: Array) -> Finding:
    found = f"plate {step.plate.name}, {times[0]:.2f}-{times[-1]:.2f} s: it carries both feet at once, and tells their "
    found += "sum; not valid for either leg"
    return _note(Code.BOTH_FEET, f"both feet are on plate {step.plate.name}", found)
