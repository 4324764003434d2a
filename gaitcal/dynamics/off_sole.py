"""Frames in which plates do not tell the force of a foot: it rests partly beside them, shares one,
or is not under it.

**Off the sole.** The ground pushes and does not pull, so the centre of pressure lies in the convex
hull of what touches the plate: of one sole, or of both with the ground between where the other foot
may press on the same plate. Markers tell that outline, and a plate its centre, so well:

    allowed = OUTLINE_M + MOMENT_NM / F_y

A total force that a program divided between two feet is told by itself: both plates then report one
centre of pressure, between the feet.

**Beside.** What of a sole rests beside all plates presses on the floor, and no plate tells how
much. Two things speak for a loss that matters, each by itself:

- more than a tenth of the half that rests, heel or toes, lies there (`MOST_BESIDE`). In a walk with
  39 mm of the heel beside (9 % of the sole) they bear 60 % of the body as the other foot leaves the
  ground and 20 % in mid-stance. Where the plates read nothing yet, or no more, all that the foot
  bears may be on any part of it that lies beside;
- the centre of pressure comes near to what lies beside (`REACH_ALONG`, `REACH_ACROSS`). A heel
  whose marker is 26 mm beside the plate, 3 % of the sole, loses 12 % while the centre of pressure
  is within 40 mm of the edge.

A foot bears a little before it is seen to rest, and after: as much of it is lost there as in the
next resting frame.

**Shared.** A plate under both feet tells the sum of them: neither leg is known. Where the corners
of a plate are not known, the centre of pressure says whether the other foot stands on it too: it
leaves the sole then.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.dynamics import foot_contact, measurement_errors
from gaitcal.errors import Code, Finding, Severity
from gaitcal.io.force_plate import BODY_N, LOADED_N, compute_centre_on_ground
from gaitcal.io.recording import ForcePlate, find_runs, format_spans
from gaitcal.model.linkage import SIDE_WORDS, SIDES

OUTLINE_M = 0.03
"""m, two standard deviations of the outline: 10 mm of heel and toe markers on skin or shoe, 8 mm of
the sole's breadth and of the toe marker's place across it, 8 mm of the plate's place
(`measurement_errors.py`). In 41 steps of nine people whose plates are right no centre of more than
a fifth of body weight lies outside at all; in two people that OpenSim simulated, up to 13 mm."""
MOMENT_NM = 2.0
"""N·m, two standard deviations of a plate's moments: 4 cm at 50 N. An empty plate's reading of 5 N
at 0.3 m of its middle makes as much."""
SAME_M = 0.02
"""m within which two plates under two feet report one centre of pressure; a foot is three to five
times as broad.
"""
EQUAL_M = 0.001
"""m, the same of two plates that are given to one foot: it may really press on both sides of their
border.
"""
MOSTLY = 0.8  # Of the frames in which both plates are loaded
DIVIDED = (
    "both plates report one centre of pressure, between the feet: the total force was divided, not "
    "measured under each "
    "foot"
)
DIRECTIONS = (
    240  # Unit vectors in the floor; a distance from an edge 0.26 m long is short by at most 2 mm
)
MOST_BESIDE = 0.10  # Of the area of a half of the sole: 17 mm of a heel
REACH_ALONG, REACH_ACROSS = 0.04, 0.02
"""m along and across the foot within which the pressure is spread round its centre."""
OFF_SOLE_M = 0.03  # A centre of pressure further from the sole is not of this foot alone
OFF_SOLE_SHARE = (
    0.1  # Share of the frames in which it must be, as the centre of a small load is noise
)


@dataclass(frozen=True, kw_only=True)
class PressurePosition:
    """Where the centre of pressure of one loading lies against the outline of what presses on its
    plate.
    """

    away: Array  # (n,) m outside, negative inside; -inf where a foot is not seen
    way: Array  # (n, 2) unit vector, x and z of the laboratory: outwards
    allowed: Array  # (n,) m

    @property
    def outside(self) -> BoolArray:
        """(n,) further outside than outline and plate leave open."""
        return np.asarray(self.away > self.allowed)


def _marked(frames: slice, count: int, chosen: BoolArray | bool = True) -> BoolArray:
    """(count,) those `chosen` of some frames."""
    out = np.zeros(count, dtype=bool)
    out[frames] = chosen
    return out


def _note(code: Code, cause: str, found: str, leg: str = "") -> Finding:
    """A fact that frames that are not valid, or an outline that is not used, already answer."""
    return Finding(
        severity=Severity.INFO, topic="plate to foot", cause=cause, found=found, leg=leg, code=code
    )


def sole_edge(feet: foot_contact.FootPoints, foot: int, frames: slice) -> Array:
    """(n, m, 2) m, x and z of the edge of a foot's sole (0 right, 1 left), as `sole_of` shapes it.

    Toes stay on the ground when the heel has left it: the part before the toe marker keeps its
    length.
    """
    heel, toe, tip = (path[frames, foot] for path in (feet.heel, feet.toe, feet.tip))
    line = (toe - heel)[:, [0, 2]]
    back = np.linalg.norm(line, axis=1)
    forward = line / np.maximum(back, 1e-9)[:, None]
    length = back + np.linalg.norm(tip - toe, axis=1)
    begin = np.minimum(foot_contact.HEEL_M, 0.5 * length)
    part, share = np.array(foot_contact.SHAPE)
    ahead = begin[:, None] + (length - begin)[:, None] * part
    across = np.stack([-forward[:, 1], forward[:, 0]], axis=1)
    middle = heel[:, None, [0, 2]] + ahead[:, :, None] * forward[:, None]
    aside = 0.5 * feet.width * share[:, None] * across[:, None]
    return np.concatenate([middle - aside, middle + aside], axis=1)


def outside_hull(point: Array, edge: Array) -> tuple[Array, Array]:
    """(n,) m that points (n, 2) lie outside the convex hulls of points (n, m, 2), negative inside;
    (n, 2) which way.

    The distance is max_u ( u . p - max_v u . v ) over unit vectors u; -inf where a point is not a
    number.
    """
    angle = 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    ways = np.column_stack([np.cos(angle), np.sin(angle)])
    reach = np.full((len(point), DIRECTIONS), -np.inf)
    for k in range(
        edge.shape[1]
    ):  # one after the other: a treadmill's loading may last for minutes
        np.maximum(reach, edge[:, k] @ ways.T, out=reach)
    beyond = point @ ways.T - reach
    beyond = np.where(np.isfinite(beyond), beyond, -np.inf)
    farthest = beyond.argmax(axis=1)
    away: Array = beyond[np.arange(len(point)), farthest]
    return away, ways[farthest]


def places_of(
    loadings: Sequence[foot_contact.Loading], feet: foot_contact.FootPoints, time: Array
) -> list[PressurePosition]:
    """Where the centre of pressure of each loading lies."""
    return [
        _place_of(one, [x for x in loadings if x.plate is not one.plate], feet, time)
        for one in loadings
    ]


def _place_of(
    loading: foot_contact.Loading,
    others: Sequence[foot_contact.Loading],
    feet: foot_contact.FootPoints,
    time: Array,
) -> PressurePosition:
    """`others`: those of the other plates of the trial."""
    point, frames = loading.point[:, [0, 2]], loading.frames
    away, way = outside_hull(point, sole_edge(feet, loading.foot, frames))
    presses = _other_foot_presses(loading, others, feet, len(time))
    shared = foot_contact.near(_marked(frames, len(time), presses), time)[frames]
    if shared.any():
        both = np.concatenate([sole_edge(feet, foot, frames)[shared] for foot in (0, 1)], axis=1)
        away[shared], way[shared] = outside_hull(point[shared], both)
    return PressurePosition(
        away=away, way=way, allowed=OUTLINE_M + MOMENT_NM / np.maximum(loading.load, LOADED_N)
    )


def _other_foot_presses(
    loading: foot_contact.Loading,
    others: Sequence[foot_contact.Loading],
    feet: foot_contact.FootPoints,
    count: int,
) -> BoolArray:
    """(n,) the foot that the loading was not given to rests where this plate may be, and no other
    plate carries it.
    """
    foot = 1 - loading.foot
    sole = foot_contact.sole_of(feet, foot, loading.frames)
    here = sole.resting.copy()
    if measurement_errors.outline_known(loading.plate, LOADED_N):
        here &= ~sole.beside([loading.plate])
    for other in others:
        meanwhile = _marked(other.frames, count)[loading.frames]
        if measurement_errors.outline_known(other.plate, LOADED_N):
            here &= ~(meanwhile[:, None] & ~sole.beside([other.plate]))
        elif other.foot == foot:
            here &= ~meanwhile[:, None]
    return np.asarray(here.any(axis=1))


def one_centre(one: foot_contact.Loading, other: foot_contact.Loading, count: int) -> BoolArray:
    """(nf,) of `count` frames in which two plates report one centre of pressure; none unless they
    do as a rule.

    Two feet cannot: it is outside of one of them, if not of both. Nor can one foot across two
    plates, to the millimetre. What is too light to tell, at the ends of both loadings, belongs to
    these frames.
    """
    first, last = max(one.frames.start, other.frames.start), min(one.frames.stop, other.frames.stop)
    if one.plate is other.plate or last <= first:
        return np.zeros(count, dtype=bool)
    mine, its = (slice(first - x.frames.start, last - x.frames.start) for x in (one, other))
    pressed = np.minimum(one.load[mine], other.load[its]) > BODY_N
    apart = np.linalg.norm((one.point[mine] - other.point[its])[:, [0, 2]], axis=1)
    same = apart < (SAME_M if one.foot != other.foot else EQUAL_M)
    as_a_rule = bool(pressed.any() and same[pressed].mean() > MOSTLY)
    return _marked(slice(first, last), count, np.asarray((same | ~pressed) & as_a_rule))


def divided_frames(
    one: foot_contact.Loading,
    other: foot_contact.Loading,
    places: tuple[PressurePosition, PressurePosition],
    count: int,
) -> BoolArray:
    """(nf,) of `count` frames: a total force was divided between two plates, by their common centre
    of pressure.
    """
    same = one_centre(one, other, count)
    if one.foot != other.foot:
        same &= any(
            place.outside[same[x.frames]].any()
            for x, place in zip((one, other), places, strict=True)
        )
    return same


def divided_cause(plates: Sequence[str]) -> str:
    """What is wrong where plates of these names report one centre of pressure."""
    return f"{DIVIDED} (plates {' and '.join(plates)})"


def off_sole_frames(
    steps: Sequence[foot_contact.FootContact], time: Array, feet: foot_contact.FootPoints
) -> tuple[BoolArray, list[Finding]]:
    """(nf, 2) frames in which what a plate says is not the force on its foot, and what to say of
    them.
    """
    places, count = places_of(steps, feet, time), len(time)
    off, causes = np.zeros((count, 2), dtype=bool), dict[tuple[str, str], BoolArray]()
    """Cause and leg -> (nf,) frames."""

    def add(cause: str, leg: str, frames: BoolArray) -> None:
        causes[cause, leg] = causes.get((cause, leg), False) | frames

    for (one, place), (other, its_place) in combinations(zip(steps, places, strict=True), 2):
        divided = divided_frames(one, other, (place, its_place), count)
        if divided.any():
            off[divided] = True
            add(divided_cause((one.plate.name, other.plate.name)), "", divided)
    for step, place in zip(steps, places, strict=True):
        outside = _marked(step.frames, count, place.outside) & ~off[:, step.foot]
        if outside.any():
            off[:, step.foot] |= outside
            side = SIDES[step.foot]
            cause = (
                f"the centre of pressure of plate {step.plate.name} leaves the {SIDE_WORDS[side]} "
                "foot"
            )
            add(cause, side, outside)
    findings = []
    for (cause, leg), frames in causes.items():
        found = (
            f"{format_spans(time, find_runs(frames), most=count)}; not valid for {'this' if leg else 'either'} "
            "leg"
        )
        findings.append(
            _note(Code.PRESSURE_LEAVES_FOOT if leg else Code.DIVIDED_FORCE, cause, found, leg)
        )
    return off, findings


def beside_plates(
    steps: Sequence[foot_contact.FootContact],
    plates: Sequence[ForcePlate],
    time: Array,
    feet: foot_contact.FootPoints,
    loaded: BoolArray,
) -> tuple[BoolArray, list[Finding]]:
    """(nf, 2) frames in which a foot rests partly beside its plates, and what to say of them.

    `plates`: all that may carry a foot; those with an outline are one surface.
    `loaded`: (nf, 2) a plate carries the foot.
    """
    partly, findings = np.zeros_like(loaded), []
    surface = [plate for plate in plates if measurement_errors.outline_known(plate, LOADED_N)]
    down: BoolArray = loaded | feet.resting
    for foot, side in enumerate(SIDES):
        for contact in find_runs(down[:, foot]):
            carriers = foot_contact.meeting(steps, foot, contact)
            unknown = [
                step
                for step in carriers
                if not measurement_errors.outline_known(step.plate, LOADED_N)
            ]
            for step in unknown:
                if step.plate.corners is not None:
                    found = (
                        f"{step.words}: the centre of pressure leaves the plate's corners; corners "
                        "not used"
                    )
                    cause = f"the corners of plate {step.plate.name} do not hold its forces"
                    findings.append(_note(Code.PLATE_CORNERS, cause, found))
            if unknown or not carriers:
                continue
            sole = foot_contact.sole_of(feet, foot, contact)
            beside = sole.beside(surface)
            lost = _bears_beside(sole, beside, loaded[contact, foot]) | _reached(
                sole, beside, carriers, contact
            )
            if lost.any():
                around = _around(lost, contact, time)
                partly[:, foot] |= around
                names = " and ".join(dict.fromkeys(step.plate.name for step in carriers))
                first, last = time[around][[0, -1]]
                found = (
                    f"{100 * sole.share_of(beside)[lost].max():.0f} % of the sole of the "
                    f"{SIDE_WORDS[side]} foot lie "
                    f"beside it; not valid for this leg, {first:.2f}-{last:.2f} s"
                )
                cause = f"a foot rests partly beside plate {names}"
                findings.append(_note(Code.FOOT_BESIDE_PLATE, cause, found, side))
    return partly, findings


def _bears_beside(sole: foot_contact.SoleCells, beside: BoolArray, loaded: BoolArray) -> BoolArray:
    """(nf,) what rests beside the plates may bear much, judged by motion; before and after resting
    as next to it.
    """
    resting = beside & sole.resting
    lost = (sole.share_of_halves(resting) > MOST_BESIDE).any(axis=1)
    lost |= resting.any(axis=1) & ~loaded  # all that the foot bears may be there
    down = np.flatnonzero(sole.resting.any(axis=1))
    if len(down):
        lost[: down[0]], lost[down[-1] + 1 :] = lost[down[0]], lost[down[-1]]
    return np.asarray(lost)


def _around(lost: BoolArray, contact: slice, time: Array) -> BoolArray:
    """(nf,) lost frames of a contact (its own), and those around it in which the foot may bear
    already, or still.
    """
    out = np.zeros(len(time), dtype=bool)
    out[contact] = lost
    if lost[0]:
        out |= (time < time[contact.start]) & (time > time[contact.start] - foot_contact.LANDING)
    if lost[-1]:
        out |= (time >= time[contact.stop - 1]) & (
            time < time[contact.stop - 1] + foot_contact.LEAVING
        )
    return out


def _reached(
    sole: foot_contact.SoleCells,
    beside: BoolArray,
    carriers: Sequence[foot_contact.FootContact],
    frames: slice,
) -> BoolArray:
    """(nf,) the centre of pressure comes near to a part of the sole that lies beside the plates."""
    wrench = np.sum([step.wrench_in(frames) for step in carriers], axis=0)
    pressed = wrench[:, 1] > LOADED_N
    corners = [step.plate.corners for step in carriers if step.plate.corners is not None]
    centre = np.full((len(wrench), 3), np.nan)
    centre[pressed] = compute_centre_on_ground(
        wrench[pressed], float(np.mean([c[:, 1].mean() for c in corners]))
    )
    along, across = sole.offsets(centre)
    with np.errstate(invalid="ignore"):
        reached = beside & (along < REACH_ALONG) & (across < REACH_ACROSS)
    return np.asarray(reached.any(axis=1))


def shared_plates(
    steps: Sequence[foot_contact.FootContact],
    plates: Sequence[ForcePlate],
    time: Array,
    feet: foot_contact.FootPoints,
    on_floor: BoolArray,
) -> tuple[BoolArray, list[Finding]]:
    """(nf,) frames in which one plate carries both feet, and what to say of them.

    `plates`: all that may carry a foot.
    `on_floor`: (nf, 2) a foot is on the ground and no plate was given to it.
    """
    shared, findings, of_plate = (
        np.zeros(len(time), dtype=bool),
        list[Finding](),
        dict[str, BoolArray](),
    )
    surface = [plate for plate in plates if measurement_errors.outline_known(plate, LOADED_N)]
    for step in steps:
        other, own = 1 - step.foot, _marked(step.frames, len(time))
        if measurement_errors.outline_known(step.plate, LOADED_N):
            # resting on this plate, and on no other one: an edge between two is not known to the
            # millimetre
            sole = foot_contact.sole_of(feet, other, step.frames)
            here = sole.resting & ~sole.beside([step.plate])
            here &= sole.beside([plate for plate in surface if plate is not step.plate])
            much = np.asarray((sole.share_of_halves(here) > MOST_BESIDE).any(axis=1))
            both = own & foot_contact.near(_marked(step.frames, len(time), much), time)
        else:
            both = own & on_floor[:, other] & _leaves_sole(step, steps, feet, on_floor[:, other])
        of_plate.setdefault(step.plate.name, np.zeros(len(time), dtype=bool))[both] = True
    for name, both in of_plate.items():
        if both.any():
            shared |= both
            found = (
                f"plate {name}, {format_spans(time, find_runs(both))}: it carries both feet at once, and tells "
                "their "
            )
            found += "sum; not valid for either leg"
            findings.append(_note(Code.BOTH_FEET, f"both feet are on plate {name}", found))
    return shared, findings


def _leaves_sole(
    step: foot_contact.FootContact,
    steps: Sequence[foot_contact.FootContact],
    feet: foot_contact.FootPoints,
    floor: BoolArray,
) -> bool:
    """Whether the centre of pressure is not under the foot alone while the other one stands
    somewhere.
    """
    frames = step.frames
    wrench = np.sum(
        [other.wrench_in(frames) for other in foot_contact.meeting(steps, step.foot, frames)],
        axis=0,
    )
    chosen = floor[frames] & (wrench[:, 1] > LOADED_N)
    if not chosen.any():
        return False
    centre = compute_centre_on_ground(wrench[chosen])
    cells = foot_contact.sole_of(feet, step.foot, frames).cells[chosen]
    away = np.linalg.norm((cells - centre[:, None])[:, :, [0, 2]], axis=2).min(axis=1)
    return bool(np.mean(away > OFF_SOLE_M) > OFF_SOLE_SHARE)
