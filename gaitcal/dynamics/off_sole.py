"""Frames with invalid foot loading: partial contact, shared plate, centre of pressure off the sole.

**Off the sole.** The ground pushes and does not pull, so the centre of pressure is in the convex
hull of all that touches the plate: one sole, or both with the ground between where the other foot
may press on the same plate. Markers locate that outline, and a plate its centre, within

    allowed = OUTLINE_ERROR_M + PLATE_MOMENT_NM / F_y

A total force that a program divided between two feet is recognised too: both plates then report one
centre of pressure, between the feet.

**Partial contact.** The part of a sole off all plates presses on the floor, with an unknown force.
Either of two signs shows a relevant loss:

- more than a tenth of the resting half of the sole, heel or toes, is off the plates
  (`MAX_OFF_PLATE_SHARE`). In a walk with 39 mm of the heel off the plate (9 % of the sole) it
  carries 60 % of the body as the other foot leaves the ground and 20 % in mid-stance. Where the
  plates are not yet loaded, or no longer, the part off the plates may carry the whole load;
- the centre of pressure is near to the part off the plates (`REACH_ALONG`, `REACH_ACROSS`). A heel
  with its marker 26 mm off the plate, 3 % of the sole, loses 12 % while the centre of pressure is
  within 40 mm of the edge.

A foot carries some load before its motion shows that it rests, and after. The same share is lost
there as in the next resting frame.

**Shared.** A plate under both feet measures their sum: neither leg is known. Where the corners of a
plate are unknown, a centre of pressure off the sole shows that the other foot stands on it too.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.dynamics import foot_contact, plate_outline
from gaitcal.errors import Code, Finding, Severity
from gaitcal.io.force_plate import BODY_N, LOADED_N, compute_centre_on_ground
from gaitcal.io.recording import ForcePlate, find_runs, format_spans
from gaitcal.model.linkage import SIDE_WORDS, SIDES

OUTLINE_ERROR_M = 0.03
"""m, two standard deviations of the outline: 10 mm of heel and toe markers on skin or shoe, 8 mm of
the breadth of the sole and of the toe marker across it, 8 mm of the position of the plate
(`measurement_errors.py`). In 41 steps of nine people with correct plates no centre of pressure of
more than a fifth of body weight is outside; in two people simulated by OpenSim, up to 13 mm."""
PLATE_MOMENT_NM = 2.0
"""N·m, two standard deviations of a plate's moments: 4 cm at 50 N. An empty plate's reading of 5 N
at 0.3 m of its middle makes as much."""
COMMON_CENTRE_M = 0.02
"""m within which two plates under two feet report the same centre of pressure. A foot is three to
five times as broad."""
IDENTICAL_CENTRE_M = 0.001
"""m, the same for two plates under one foot, which may press on both sides of their border."""
MIN_COMMON_SHARE = 0.8
"""Share of the frames with both plates loaded."""
DIVIDED = (
    "both plates report one centre of pressure, between the feet: the total force was divided, not "
    "measured under each "
    "foot"
)
DIRECTIONS = 240
"""Unit vectors in the floor. A distance from an edge 0.26 m long is short by at most 2 mm."""
MAX_OFF_PLATE_SHARE = 0.10
"""Largest share of a half of the sole off the plates: 17 mm of a heel."""
REACH_ALONG, REACH_ACROSS = 0.04, 0.02
"""m along and across the foot over which the pressure is distributed round its centre."""
OFF_SOLE_M = 0.03
"""m: a centre of pressure further from the sole is not that of this foot alone."""
OFF_SOLE_SHARE = 0.1
"""Share of the frames in which it must be, as the centre of a small load is noise."""


@dataclass(frozen=True, kw_only=True)
class PressurePosition:
    """Centre of pressure of one loading relative to the outline of the soles on its plate."""

    distance: Array  # (n,) m outside, negative inside; -inf where a foot is not visible
    direction: Array  # (n, 2) unit vector, x and z of the laboratory: outwards
    allowed: Array  # (n,) m

    @property
    def outside(self) -> BoolArray:
        """(n,) whether it is further outside than errors of outline and plate explain."""
        return np.asarray(self.distance > self.allowed)


def _mark_frames(frames: slice, count: int, chosen: BoolArray | bool = True) -> BoolArray:
    """Mark those `chosen` of some frames, (count,)."""
    out = np.zeros(count, dtype=bool)
    out[frames] = chosen
    return out


def _report_fact(code: Code, cause: str, found: str, leg: str = "") -> Finding:
    """Report a fact that needs no action, as the frames or the outline are not used."""
    return Finding(
        severity=Severity.INFO, topic="plate to foot", cause=cause, found=found, leg=leg, code=code
    )


def compute_sole_edge(feet: foot_contact.FootPoints, foot: int, frames: slice) -> Array:
    """Compute the edge of the sole of a foot, with the shape of `build_sole`.

    Toes stay on the ground after the heel has left it: the part before the toe marker keeps its
    length.

    `feet`: heels, toes and tips of both feet. `foot`: 0 right, 1 left. `frames`: frames to compute.
    Returns: (n, m, 2) m, x and z of the laboratory.
    """
    heel, toe, tip = (path[frames, foot] for path in (feet.heel, feet.toe, feet.tip))
    line = (toe - heel)[:, [0, 2]]
    back = np.linalg.norm(line, axis=1)
    forward = line / np.maximum(back, 1e-9)[:, None]
    length = back + np.linalg.norm(tip - toe, axis=1)
    begin = np.minimum(foot_contact.HEEL_RADIUS_M, 0.5 * length)
    part, share = np.array(foot_contact.SOLE_SHAPE)
    ahead = begin[:, None] + (length - begin)[:, None] * part
    across = np.stack([-forward[:, 1], forward[:, 0]], axis=1)
    middle = heel[:, None, [0, 2]] + ahead[:, :, None] * forward[:, None]
    aside = 0.5 * feet.width * share[:, None] * across[:, None]
    return np.concatenate([middle - aside, middle + aside], axis=1)


def compute_distance_outside_hull(point: Array, edge: Array) -> tuple[Array, Array]:
    """Compute the distance of points outside convex hulls.

    Parameters
    ----------
    point
        (n, 2) m.
    edge
        (n, m, 2) m, points that span the hulls.

    Returns
    -------
    (n,) array
        m, negative inside; -inf where a point is not a number.
    (n, 2) array
        Unit vectors outwards.

    Notes
    -----
    The distance is max_u ( u . p - max_v u . v ) over unit vectors u.
    """
    angle = 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    directions = np.column_stack([np.cos(angle), np.sin(angle)])
    reach = np.full((len(point), DIRECTIONS), -np.inf)
    # One edge point after the other bounds memory: loadings of treadmills last for minutes.
    for k in range(edge.shape[1]):
        np.maximum(reach, edge[:, k] @ directions.T, out=reach)
    beyond = point @ directions.T - reach
    beyond = np.where(np.isfinite(beyond), beyond, -np.inf)
    farthest = beyond.argmax(axis=1)
    away: Array = beyond[np.arange(len(point)), farthest]
    return away, directions[farthest]


def locate_pressures(
    loadings: Sequence[foot_contact.Loading], feet: foot_contact.FootPoints, time: Array
) -> list[PressurePosition]:
    """Locate the centre of pressure of each loading relative to the soles on its plate.

    Parameters
    ----------
    loadings
        Loadings of all plates of the trial.
    feet
        Heels, toes and tips of both feet.
    time
        (nf,) s.

    Returns
    -------
    list of PressurePosition
    """
    out = []
    for loading in loadings:
        others = [other for other in loadings if other.plate is not loading.plate]
        out.append(_locate_pressure(loading, others, feet, time))
    return out


def _locate_pressure(
    loading: foot_contact.Loading,
    others: Sequence[foot_contact.Loading],
    feet: foot_contact.FootPoints,
    time: Array,
) -> PressurePosition:
    """Locate one centre of pressure. `others`: loadings of the other plates of the trial."""
    point, frames = loading.point[:, [0, 2]], loading.frames
    away, direction = compute_distance_outside_hull(
        point, compute_sole_edge(feet, loading.foot, frames)
    )
    presses = _detect_other_foot(loading, others, feet, len(time))
    shared = foot_contact.mark_near(_mark_frames(frames, len(time), presses), time)[frames]
    if shared.any():
        both = np.concatenate(
            [compute_sole_edge(feet, foot, frames)[shared] for foot in (0, 1)], axis=1
        )
        away[shared], direction[shared] = compute_distance_outside_hull(point[shared], both)
    return PressurePosition(
        distance=away,
        direction=direction,
        allowed=OUTLINE_ERROR_M + PLATE_MOMENT_NM / np.maximum(loading.load, LOADED_N),
    )


def _detect_other_foot(
    loading: foot_contact.Loading,
    others: Sequence[foot_contact.Loading],
    feet: foot_contact.FootPoints,
    count: int,
) -> BoolArray:
    """Detect frames (n,) in which the other foot may rest on this plate, and on no other one."""
    foot = 1 - loading.foot
    sole = foot_contact.build_sole(feet, foot, loading.frames)
    here = sole.resting.copy()
    if plate_outline.has_known_outline(loading.plate, LOADED_N):
        here &= ~sole.find_cells_off_plates([loading.plate])
    for other in others:
        meanwhile = _mark_frames(other.frames, count)[loading.frames]
        if plate_outline.has_known_outline(other.plate, LOADED_N):
            here &= ~(meanwhile[:, None] & ~sole.find_cells_off_plates([other.plate]))
        elif other.foot == foot:
            here &= ~meanwhile[:, None]
    return np.asarray(here.any(axis=1))


def detect_common_centre(
    one: foot_contact.Loading, other: foot_contact.Loading, count: int
) -> BoolArray:
    """Detect frames in which two plates report the same centre of pressure.

    Two feet cannot have the same centre: it is outside of at least one of them. Nor can one foot
    across two plates, to the millimetre. Frames with too little load, at the ends of both loadings,
    are included.

    Parameters
    ----------
    one, other
        Loadings of two plates.
    count
        nf, frames of the trial.

    Returns
    -------
    (nf,) array of bool
        None of them unless it is so in most frames.
    """
    first, last = max(one.frames.start, other.frames.start), min(one.frames.stop, other.frames.stop)
    if one.plate is other.plate or last <= first:
        return np.zeros(count, dtype=bool)
    # Frames that both loadings share, as indices of each.
    mine, its = (slice(first - x.frames.start, last - x.frames.start) for x in (one, other))
    pressed = np.minimum(one.load[mine], other.load[its]) > BODY_N
    distance = np.linalg.norm((one.point[mine] - other.point[its])[:, [0, 2]], axis=1)
    same = distance < (COMMON_CENTRE_M if one.foot != other.foot else IDENTICAL_CENTRE_M)
    as_a_rule = bool(pressed.any() and same[pressed].mean() > MIN_COMMON_SHARE)
    return _mark_frames(slice(first, last), count, np.asarray((same | ~pressed) & as_a_rule))


def find_divided_frames(
    one: foot_contact.Loading,
    other: foot_contact.Loading,
    places: tuple[PressurePosition, PressurePosition],
    count: int,
) -> BoolArray:
    """Find frames in which a total force was divided between two plates, by one centre of pressure.

    Parameters
    ----------
    one, other
        Loadings of two plates.
    places
        Positions of their centres of pressure.
    count
        nf, frames of the trial.

    Returns
    -------
    (nf,) array of bool
    """
    same = detect_common_centre(one, other, count)
    if one.foot != other.foot:
        same &= any(
            place.outside[same[x.frames]].any()
            for x, place in zip((one, other), places, strict=True)
        )
    return same


def describe_divided_force(plates: Sequence[str]) -> str:
    """Describe the fault of plates that report one centre of pressure."""
    return f"{DIVIDED} (plates {' and '.join(plates)})"


def find_off_sole_frames(
    steps: Sequence[foot_contact.FootContact], time: Array, feet: foot_contact.FootPoints
) -> tuple[BoolArray, list[Finding]]:
    """Find frames in which the force of a plate is not that on its foot.

    Parameters
    ----------
    steps
        Loadings and their feet.
    time
        (nf,) s.
    feet
        Heels, toes and tips of both feet.

    Returns
    -------
    (nf, 2) array of bool
    list of Finding
    """
    places, count = locate_pressures(steps, feet, time), len(time)
    off, causes = np.zeros((count, 2), dtype=bool), dict[tuple[str, str], BoolArray]()
    """Cause and leg -> (nf,) frames."""

    def add(cause: str, leg: str, frames: BoolArray) -> None:
        causes[cause, leg] = causes.get((cause, leg), False) | frames

    for (one, place), (other, its_place) in combinations(zip(steps, places, strict=True), 2):
        divided = find_divided_frames(one, other, (place, its_place), count)
        if divided.any():
            off[divided] = True
            add(describe_divided_force((one.plate.name, other.plate.name)), "", divided)
    for step, place in zip(steps, places, strict=True):
        outside = _mark_frames(step.frames, count, place.outside) & ~off[:, step.foot]
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
            f"{format_spans(time, find_runs(frames), most=count)}; not valid for "
            f"{'this' if leg else 'either'} leg"
        )
        findings.append(
            _report_fact(
                Code.PRESSURE_LEAVES_FOOT if leg else Code.DIVIDED_FORCE, cause, found, leg
            )
        )
    return off, findings


def find_partial_contact(
    steps: Sequence[foot_contact.FootContact],
    plates: Sequence[ForcePlate],
    time: Array,
    feet: foot_contact.FootPoints,
    loaded: BoolArray,
) -> tuple[BoolArray, list[Finding]]:
    """Find frames in which a foot rests partly off its plates.

    Parameters
    ----------
    steps
        Loadings and their feet.
    plates
        All that may carry a foot; those with an outline are one surface.
    time
        (nf,) s.
    feet
        Heels, toes and tips of both feet.
    loaded
        (nf, 2) whether a plate carries the foot.

    Returns
    -------
    (nf, 2) array of bool
    list of Finding
    """
    partly, findings = np.zeros_like(loaded), []
    surface = [plate for plate in plates if plate_outline.has_known_outline(plate, LOADED_N)]
    down: BoolArray = loaded | feet.resting
    for foot, side in enumerate(SIDES):
        for contact in find_runs(down[:, foot]):
            carriers = foot_contact.select_overlapping_steps(steps, foot, contact)
            unknown = [
                step
                for step in carriers
                if not plate_outline.has_known_outline(step.plate, LOADED_N)
            ]
            for step in unknown:
                if step.plate.corners is not None:
                    found = (
                        f"{step.label}: the centre of pressure leaves the plate's corners; corners "
                        "not used"
                    )
                    cause = f"the corners of plate {step.plate.name} do not hold its forces"
                    findings.append(_report_fact(Code.PLATE_CORNERS, cause, found))
            if unknown or not carriers:
                continue
            sole = foot_contact.build_sole(feet, foot, contact)
            off_plates = sole.find_cells_off_plates(surface)
            # Either sign of a loss is enough.
            lost = _detect_load_off_plates(sole, off_plates, loaded[contact, foot])
            lost |= _detect_pressure_near_edge(sole, off_plates, carriers, contact)
            if lost.any():
                around = _extend_contact(lost, contact, time)
                partly[:, foot] |= around
                names = " and ".join(dict.fromkeys(step.plate.name for step in carriers))
                first, last = time[around][[0, -1]]
                found = (
                    f"{100 * sole.sum_share(off_plates)[lost].max():.0f} % of the sole of the "
                    f"{SIDE_WORDS[side]} foot are "
                    f"beside it; not valid for this leg, {first:.2f}-{last:.2f} s"
                )
                cause = f"a foot rests partly beside plate {names}"
                findings.append(_report_fact(Code.FOOT_BESIDE_PLATE, cause, found, side))
    return partly, findings


def _detect_load_off_plates(
    sole: foot_contact.SoleCells, off_plates: BoolArray, loaded: BoolArray
) -> BoolArray:
    """Detect frames (nf,) in which the part of the sole off the plates may carry much load.

    Judged by motion; before and after resting as in the next resting frame.
    """
    resting = off_plates & sole.resting
    lost = (sole.sum_half_shares(resting) > MAX_OFF_PLATE_SHARE).any(axis=1)
    # Without a loaded plate the part off the plates may carry the whole load.
    lost |= resting.any(axis=1) & ~loaded
    down = np.flatnonzero(sole.resting.any(axis=1))
    if len(down):
        lost[: down[0]], lost[down[-1] + 1 :] = lost[down[0]], lost[down[-1]]
    return np.asarray(lost)


def _extend_contact(lost: BoolArray, contact: slice, time: Array) -> BoolArray:
    """Extend lost frames of a contact to those around it in which the foot may carry load."""
    out = np.zeros(len(time), dtype=bool)
    out[contact] = lost
    if lost[0]:
        out |= (time < time[contact.start]) & (time > time[contact.start] - foot_contact.LANDING_S)
    if lost[-1]:
        out |= (time >= time[contact.stop - 1]) & (
            time < time[contact.stop - 1] + foot_contact.LEAVING_S
        )
    return out


def _detect_pressure_near_edge(
    sole: foot_contact.SoleCells,
    off_plates: BoolArray,
    carriers: Sequence[foot_contact.FootContact],
    frames: slice,
) -> BoolArray:
    """Detect frames (nf,) with the centre of pressure near to a part off the plates."""
    wrench = np.sum([step.extract_wrench(frames) for step in carriers], axis=0)
    pressed = wrench[:, 1] > LOADED_N
    centre = np.full((len(wrench), 3), np.nan)
    centre[pressed] = compute_centre_on_ground(wrench[pressed], _average_surface_height(carriers))
    along, across = sole.compute_offsets(centre)
    with np.errstate(invalid="ignore"):
        reached = off_plates & (along < REACH_ALONG) & (across < REACH_ACROSS)
    return np.asarray(reached.any(axis=1))


def find_shared_plates(
    steps: Sequence[foot_contact.FootContact],
    plates: Sequence[ForcePlate],
    time: Array,
    feet: foot_contact.FootPoints,
    on_floor: BoolArray,
) -> tuple[BoolArray, list[Finding]]:
    """Find frames in which one plate carries both feet.

    Parameters
    ----------
    steps
        Loadings and their feet.
    plates
        All that may carry a foot.
    time
        (nf,) s.
    feet
        Heels, toes and tips of both feet.
    on_floor
        (nf, 2) whether a foot is on the ground without a plate.

    Returns
    -------
    (nf,) array of bool
    list of Finding
    """
    shared, findings, of_plate = (
        np.zeros(len(time), dtype=bool),
        list[Finding](),
        dict[str, BoolArray](),
    )
    surface = [plate for plate in plates if plate_outline.has_known_outline(plate, LOADED_N)]
    for step in steps:
        other, stance = 1 - step.foot, _mark_frames(step.frames, len(time))
        if plate_outline.has_known_outline(step.plate, LOADED_N):
            # The other foot rests on this plate and on no other one. An edge between two plates is
            # not known to the millimetre.
            sole = foot_contact.build_sole(feet, other, step.frames)
            here = sole.resting & ~sole.find_cells_off_plates([step.plate])
            here &= sole.find_cells_off_plates(
                [plate for plate in surface if plate is not step.plate]
            )
            much = np.asarray((sole.sum_half_shares(here) > MAX_OFF_PLATE_SHARE).any(axis=1))
            both = stance & foot_contact.mark_near(_mark_frames(step.frames, len(time), much), time)
        else:
            both = (
                stance
                & on_floor[:, other]
                & _detect_pressure_off_sole(step, steps, feet, on_floor[:, other])
            )
        of_plate.setdefault(step.plate.name, np.zeros(len(time), dtype=bool))[both] = True
    for name, both in of_plate.items():
        if both.any():
            shared |= both
            times = format_spans(time, find_runs(both))
            found = (
                f"plate {name}, {times}: it carries both feet at once and measures their sum; "
                "not valid for either leg"
            )
            findings.append(_report_fact(Code.BOTH_FEET, f"both feet are on plate {name}", found))
    return shared, findings


def _detect_pressure_off_sole(
    step: foot_contact.FootContact,
    steps: Sequence[foot_contact.FootContact],
    feet: foot_contact.FootPoints,
    floor: BoolArray,
) -> bool:
    """Check that the centre of pressure leaves the sole while the other foot stands somewhere."""
    frames = step.frames
    carriers = foot_contact.select_overlapping_steps(steps, step.foot, frames)
    wrench = np.sum([other.extract_wrench(frames) for other in carriers], axis=0)
    chosen = floor[frames] & (wrench[:, 1] > LOADED_N)
    if not chosen.any():
        return False
    centre = compute_centre_on_ground(wrench[chosen], _average_surface_height(carriers))
    cells = foot_contact.build_sole(feet, step.foot, frames).cells[chosen]
    away = np.linalg.norm((cells - centre[:, None])[:, :, [0, 2]], axis=2).min(axis=1)
    return bool(np.mean(away > OFF_SOLE_M) > OFF_SOLE_SHARE)


def _average_surface_height(carriers: Sequence[foot_contact.FootContact]) -> float:
    """Average the surface heights (m) of the plates under one foot."""
    return float(np.mean([foot_contact.get_surface_height(step.plate) for step in carriers]))
