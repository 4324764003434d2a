"""Centres of pressure outside of what presses on the plate: frames in which a plate does not tell the force of a foot.

The ground pushes and does not pull, so the centre of pressure lies in the convex hull of what touches the plate: of one
sole, or of both with the ground between where the other foot may press on the same plate. Markers tell that outline,
and a plate its centre, so well:

    allowed = OUTLINE_M + MOMENT_NM / F_y

A total force that a program divided between two feet is told by itself: both plates then report one centre of pressure,
between the feet.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Protocol

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.codes import Code
from gaitcal.dynamics.foot_contact import HEEL_M, SHAPE, FootPoints, near, sole_of
from gaitcal.dynamics.plate_errors import outline_known
from gaitcal.dynamics.plate_steps import SIDE_WORDS, Step
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
