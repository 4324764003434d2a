"""Foot contact: when a foot rests, the area of its sole, and the foot that loads a plate.

A foot rests while its heel or its toe moves with the ground; forces are not used. A resting foot
that no plate carries stands on the floor, where its ground reaction is unknown. Resting begins up
to 40 ms after the true contact and ends up to 90 ms before its true end (40 contacts on plates of
nine people), so that frames around it are unknown too. Foot strikes and offs of the file are exact
to the frame where they agree with its plates.

The sole, seen from above, begins a little before the heel marker, which is on the back of the heel,
and ends at the tip of the foot. Its width is that of Winter (2009), less at heel and toes. Its
cells are weighted by their area.

A loading of a plate belongs to the foot under whose sole its centre of pressure is. A loading by
two feet in succession is divided where the first has left the ground and the second rests. A
loading over several steps, on a belt that carries both feet, is divided where a foot stands alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.dynamics.plate_outline import compute_distance_outside
from gaitcal.errors import Code, Finding, Severity
from gaitcal.io.force_plate import LOADED_N, compute_centre_on_ground
from gaitcal.io.labels import FootEvent, FootMoment, select_event_times
from gaitcal.io.recording import ForcePlate, find_runs, format_spans, measure_duration
from gaitcal.model.linkage import SIDES

RESTING_SPEED = 0.4
"""m/s: a heel or toe below this speed rests. In swing both are faster, also in slow gait."""
MIN_BELT_SPEED = 0.05
"""m/s: apparent speed of heels and toes that roll over a floor, or stand."""
MIN_SWING_SPEED = 0.25
"""m/s against the belt that a foot in swing exceeds, as in `gait/events.py`."""
SWING_QUANTILE = 0.9
"""Quantile, over all points and frames, of the speed that swing exceeds."""
CONTACT_TOLERANCE_S = 0.08
"""s by which resting and loading of a plate may differ at the beginning and end of one contact."""
LANDING_S, LEAVING_S = 0.05, 0.10
"""s before and after resting on the floor in which a foot may carry load."""
SAME_EVENT_S = 0.1
"""s from the beginning or end of a contact within which an event belongs to it."""
MAX_EVENT_ERROR_S = 0.05
"""s between an event and the loading of a plate. One larger difference, and no event of the file is
used."""


@dataclass(frozen=True, kw_only=True)
class FootPoints:
    """Heel and toe of both feet from the tracked model, in the order right, left."""

    heel: Array  # (nf, 2, 3) m
    toe: Array  # (nf, 2, 3) m
    tip: Array  # (nf, 2, 3) m, the foremost point of the sole
    heel_speed: Array  # (nf, 2) m/s, against the ground
    toe_speed: Array  # (nf, 2) m/s, against the ground
    width: float = 0.0  # m, of the sole where it is widest; 0: not known, a line from heel to tip
    ground: Array = field(default_factory=lambda: np.zeros((2, 3)))
    """(2, 3) m/s, how the ground moves under each foot: zero on a floor, its belt's velocity on a
    treadmill.
    """

    @property
    def resting(self) -> BoolArray:
        """(nf, 2) whether the foot rests: its heel or its toe moves with the ground."""
        return np.minimum(self.heel_speed, self.toe_speed) < RESTING_SPEED


def estimate_belt_velocities(points: Array, velocity: Array) -> Array:
    """Estimate the velocity of the ground under both feet.

    One velocity for both, unless their lowest points show two belts.

    Parameters
    ----------
    points, velocity
        (nf, 2 k, 3) m and m/s, of the right and the left foot in turn.

    Returns
    -------
    (2, 3) array
        m/s.
    """
    common = estimate_ground_velocity(points, velocity)
    out = np.tile(common, (len(SIDES), 1))
    whole = np.isfinite(points).all(axis=(1, 2)) & np.isfinite(velocity).all(axis=(1, 2))
    lowest = points[whole, :, 1].argmin(axis=1) if common.any() else np.zeros(0, dtype=int)
    if set(lowest % len(SIDES)) != set(range(len(SIDES))):
        return out
    under = velocity[whole, lowest]
    by_foot = np.array(
        [np.median(under[lowest % len(SIDES) == foot], axis=0) for foot in range(len(SIDES))]
    )
    return by_foot if np.linalg.norm(by_foot[0] - by_foot[1]) > 2.0 * MIN_BELT_SPEED else out


def estimate_ground_velocity(points: Array, velocity: Array) -> Array:
    """Estimate the velocity of the ground from the median of the lowest point's.

    A belt slower than a resting foot is detected by feet that move to and fro and do not advance
    beyond it. Over a floor they advance, at several times the speed of a rolling foot.

    Parameters
    ----------
    points, velocity
        (nf, n, 3) m and m/s, of the feet.

    Returns
    -------
    (3,) array
        m/s; zero on a floor.
    """
    whole = np.isfinite(points).all(axis=(1, 2)) & np.isfinite(velocity).all(axis=(1, 2))
    if not whole.any():
        return np.zeros(3)
    lowest = points[whole, :, 1].argmin(axis=1)
    out: Array = np.median(velocity[whole, lowest], axis=0)
    speed = float(np.linalg.norm(out))
    if speed > RESTING_SPEED:
        return out
    # Slow ground: a belt if feet swing against it and, in the room, do not advance (m/s, (nf, n)).
    direction = out / speed if speed > MIN_BELT_SPEED else np.zeros(3)
    forward = -(velocity[whole] @ direction)
    swings = float(np.quantile(forward, SWING_QUANTILE)) + speed > MIN_SWING_SPEED
    stays = abs(float(forward.mean())) < 0.5 * speed
    return out if swings and stays else np.zeros(3)


def mark_near(marked: BoolArray, time: Array) -> BoolArray:
    """Mark the frames within `CONTACT_TOLERANCE_S` of a marked one.

    Parameters
    ----------
    marked
        (nf,) or (nf, feet).
    time
        (nf,) s.

    Returns
    -------
    array of bool
        In the shape of `marked`.
    """
    if marked.ndim > 1:
        return np.stack([mark_near(column, time) for column in marked.T], axis=1)
    times = time[marked]
    if not len(times):
        return marked.copy()
    after = np.clip(np.searchsorted(times, time), min(1, len(times) - 1), len(times) - 1)
    gap = np.minimum(np.abs(time - times[after]), np.abs(time - times[np.maximum(after - 1, 0)]))
    return marked | (gap <= CONTACT_TOLERANCE_S)


def detect_floor_contact(
    resting: BoolArray, loaded: BoolArray, time: Array, events: Sequence[FootEvent] = ()
) -> BoolArray:
    """Detect frames in which a foot may be on the ground where no plate carries it.

    Parameters
    ----------
    resting
        (nf, 2) whether the foot rests, by its motion.
    loaded
        (nf, 2) whether a plate carries it.
    time
        (nf,) s.
    events
        Of the file; used where they agree with the plates.

    Returns
    -------
    (nf, 2) array of bool
    """
    used = events if _match_events_to_plates(events, loaded, time) else ()
    out = np.zeros_like(resting)
    for foot, side in enumerate(SIDES):
        strikes, offs = (
            np.array(select_event_times(used, side, moment))
            for moment in (FootMoment.STRIKE, FootMoment.OFF)
        )
        carried = mark_near(loaded[:, foot], time)
        for run in find_runs(resting[:, foot] & ~carried):
            begin, end = float(time[run.start]), float(time[run.stop - 1])
            before = time[: run.start][loaded[: run.start, foot]]
            after = time[run.stop :][loaded[run.stop :, foot]]
            # Begin: at the end of the plate's load, at a strike of the file, or a little earlier.
            if run.start > 0:
                strike = _find_event_near(
                    strikes, begin - SAME_EVENT_S, begin + MAX_EVENT_ERROR_S, begin
                )
                at_earliest = begin - LANDING_S if strike is None else strike
                begin = float(before[-1]) if carried[run.start - 1] else at_earliest
            # End: at the next load of a plate, at an off of the file, or a little later.
            if run.stop < len(time):
                off = _find_event_near(offs, end - MAX_EVENT_ERROR_S, end + SAME_EVENT_S, end)
                at_latest = end + LEAVING_S if off is None else off
                end = float(after[0]) if carried[run.stop] else at_latest
            # At the ends of the trial the contact has no known limit.
            inner = (time > begin) & (time < end)
            inner[run.start] |= run.start == 0
            inner[run.stop - 1] |= run.stop == len(time)
            out[:, foot] |= inner
    return out


def _find_event_near(times: Array, earliest: float, latest: float, contact: float) -> float | None:
    """Find the event (s) in a range that is nearest to the beginning or end of a contact (s)."""
    close = times[(times >= earliest) & (times <= latest)]
    return float(close[np.abs(close - contact).argmin()]) if len(close) else None


def _match_events_to_plates(events: Sequence[FootEvent], loaded: BoolArray, time: Array) -> bool:
    """Check that events are those of this walk.

    Some are those of plate loadings (nf, 2), and none is far from its loading.
    """
    gaps = []
    for foot, side in enumerate(SIDES):
        for run in find_runs(loaded[:, foot]):
            ends = {FootMoment.STRIKE: run.start > 0, FootMoment.OFF: run.stop < len(time)}
            for moment, inside in ends.items():
                at = time[run.start if moment is FootMoment.STRIKE else run.stop - 1]
                distances = (
                    [abs(t - at) for t in select_event_times(events, side, moment)]
                    if inside
                    else []
                )
                # only the nearest event of this contact counts
                gaps += sorted(gap for gap in distances if gap < SAME_EVENT_S)[:1]
    return bool(gaps) and max(gaps) <= MAX_EVENT_ERROR_S


FOOT_BREADTH = 0.055
"""Share of body height (Winter 2009)."""
HEEL_RADIUS_M = 0.015
"""m from the centre of a marker on the back of the heel to the sole: half a marker, and the
rounding of the heel.
"""
SOLE_SHAPE = ((0.0, 0.15, 0.35, 0.7, 0.9, 1.0), (0.4, 0.65, 0.65, 1.0, 0.85, 0.45))
"""Share of the length from heel to tip, and share of the greatest width there."""
CELLS_ALONG, CELLS_ACROSS = 15, 5
"""Number of cells of a sole."""
GAP_M = 0.01
"""m: plates this near to each other touch, and cells this near to a plate are on it. Markers locate
a sole no better."""


@dataclass(frozen=True, kw_only=True)
class SoleCells:
    """Cells of the sole of one foot in some frames."""

    cells: Array  # (nf, n, 3) m, middles of the cells
    share: Array  # (n,) of the sole's area; they sum to 1
    resting: BoolArray
    """(nf, n) the half of the sole to which a cell belongs is on the ground, as heel or toe moves
    with it.
    """
    # (n,) cells of the half that belongs to the heel; the others belong to the toes
    rear: BoolArray
    forward: Array  # (nf, 2) unit vectors from heel to tip, x and z of the laboratory

    def find_cells_off_plates(self, plates: Sequence[ForcePlate]) -> BoolArray:
        """Find the cells beside all of these plates. Plates that touch are one surface.

        Parameters
        ----------
        plates
            Force plates with corners.

        Returns
        -------
        (nf, n) array of bool
        """
        if not plates:
            return np.ones(self.cells.shape[:2], dtype=bool)
        away = compute_distance_outside(plates, self.cells.reshape(-1, 3)).reshape(
            self.cells.shape[:2]
        )
        return np.asarray(away > GAP_M)

    def sum_share(self, chosen: BoolArray) -> Array:
        """Sum the share (nf,) of the area of the sole in the chosen cells (nf, n)."""
        return chosen @ self.share

    def sum_half_shares(self, chosen: BoolArray) -> Array:
        """Sum the shares of heel half and toe half in chosen cells.

        A heel is a small part of a sole, and carries the whole body where it alone rests.

        Parameters
        ----------
        chosen
            (nf, n) cells.

        Returns
        -------
        (nf, 2) array
            Share of the heel half and of the toe half.
        """
        halves = np.stack([self.rear, ~self.rear], axis=1) * self.share[:, None]
        return chosen @ (halves / halves.sum(axis=0))

    def compute_offsets(self, point: Array) -> tuple[Array, Array]:
        """Compute the distances (nf, n) m along and across the foot from points to the cells."""
        offset = (self.cells - point[:, None])[:, :, [0, 2]]
        sideways = np.stack([-self.forward[:, 1], self.forward[:, 0]], axis=1)
        along, across = (
            np.abs(np.einsum("fnk,fk->fn", offset, axis)) for axis in (self.forward, sideways)
        )
        return along, across


def build_sole(feet: FootPoints, foot: int, frames: slice) -> SoleCells:
    """Build the cells of the sole of a foot.

    Parameters
    ----------
    feet
        Heels, toes and tips of both feet.
    foot
        0 right, 1 left.
    frames
        Frames to build.

    Returns
    -------
    SoleCells
    """
    heel, tip = feet.heel[frames, foot], feet.tip[frames, foot]
    line = (tip - heel)[:, [0, 2]]
    length = np.maximum(np.linalg.norm(line, axis=1), 1e-9)
    forward = line / length[:, None]
    part = (np.arange(CELLS_ALONG) + 0.5) / CELLS_ALONG
    width = feet.width * np.interp(part, *SOLE_SHAPE)
    aside = (np.arange(CELLS_ACROSS) + 0.5) / CELLS_ACROSS - 0.5
    begin = np.minimum(HEEL_RADIUS_M, 0.5 * length)
    ahead = begin[:, None] + (length - begin)[:, None] * part
    along, across = np.repeat(ahead, CELLS_ACROSS, axis=1), np.outer(width, aside).ravel()
    cells = np.empty((len(heel), CELLS_ALONG * CELLS_ACROSS, 3))
    cells[:, :, 0] = heel[:, None, 0] + along * forward[:, None, 0] - across * forward[:, None, 1]
    cells[:, :, 2] = heel[:, None, 2] + along * forward[:, None, 1] + across * forward[:, None, 0]
    cells[:, :, 1] = heel[:, None, 1] + along / length[:, None] * (tip - heel)[:, None, 1]
    area = np.repeat(np.interp(part, *SOLE_SHAPE), CELLS_ACROSS)
    rear = np.repeat(part < 0.5, CELLS_ACROSS)
    heel_rests, toe_rests = (
        speed[frames, foot] < RESTING_SPEED for speed in (feet.heel_speed, feet.toe_speed)
    )
    resting = np.where(rear, heel_rests[:, None], toe_rests[:, None])
    return SoleCells(
        cells=cells, share=area / area.sum(), resting=resting, rear=rear, forward=forward
    )


UNDER_FOOT_M = 0.15
"""m, largest distance of the centre of pressure from the heel-toe line of its foot."""
SEAT_ABOVE_M = 0.25
"""m above the lower heel from which a plate is no step: stairs rise by 0.2 m at most."""
MIN_ALTERNATIONS = 3
"""Alternating single stances on one plate, from which it is not merely a step from one foot to the
other."""
MIN_LOADING_S = 0.05
"""s: a shorter loading is a knock, not a step."""


@dataclass(frozen=True, kw_only=True)
class Loading:
    """One plate under load, assigned to one foot."""

    plate: ForcePlate
    foot: int  # 0 right, 1 left
    frames: slice
    point: Array  # (n, 3) m, centre of pressure at these frames
    load: Array  # (n,) N, vertical force at these frames


@dataclass(frozen=True, kw_only=True)
class FootContact(Loading):
    """Loading of a plate in a tracked motion."""

    wrench: Array  # (nf, 6) of the plate at all frames of the trial, not filtered
    label: str  # Plate and time, for messages

    def extract_wrench(self, frames: slice) -> Array:
        """Extract the wrench (n, 6) in some frames; zero outside of the loading."""
        out = np.zeros((frames.stop - frames.start, 6))
        first, last = max(self.frames.start, frames.start), min(self.frames.stop, frames.stop)
        out[first - frames.start : last - frames.start] = self.wrench[first:last]
        return out


def find_steps(
    plate: ForcePlate, wrench: Array, time: Array, feet: FootPoints, side: str | None
) -> tuple[list[FootContact], list[Finding]]:
    """Find the steps on one plate, and loadings that fit no foot.

    Parameters
    ----------
    plate
        Force plate.
    wrench
        (nf, 6) of the plate at the marker frames, not filtered.
    time
        (nf,) s.
    feet
        Heels and toes of both feet.
    side
        "r" or "l" where the study assigns the plate; None: found by the centre of pressure.

    Returns
    -------
    list of FootContact
    list of Finding
    """
    steps, findings = list[FootContact](), list[Finding]()
    height = get_surface_height(plate)
    for stretch in find_runs(wrench[:, 1] > LOADED_N):
        if measure_duration(time, stretch) < MIN_LOADING_S:
            continue
        if side:
            parts = [AssignedPart(frames=stretch, alone=stretch, foot=SIDES.index(side))]
        else:
            parts = assign_feet(wrench, stretch, time, feet, height)
        for part in parts:
            if part.foot is None:
                lowest = float(np.nanmin(feet.heel[stretch][..., 1]))
                seat = height > lowest + SEAT_ABOVE_M
                span = f"plate {plate.name}, {format_spans(time, [stretch])}"
                findings.append(_report_under_no_foot(plate, span, seat))
                continue
            steps.append(
                FootContact(
                    foot=part.foot,
                    frames=part.frames,
                    plate=plate,
                    wrench=wrench,
                    point=compute_centre_on_ground(wrench[part.frames], height),
                    load=wrench[part.frames, 1],
                    label=f"plate {plate.name}, {format_spans(time, [part.frames])}",
                )
            )
    return steps, findings


def get_surface_height(plate: ForcePlate) -> float:
    """Get the height (m) of the plane of the centre of pressure."""
    if plate.corners is not None and np.isfinite(plate.corners).all():
        return float(plate.corners[:, 1].mean())
    height = plate.point[np.nan_to_num(plate.force[:, 1]) > LOADED_N, 1]
    return float(np.nanmedian(height)) if np.isfinite(height).any() else 0.0


@dataclass(frozen=True, kw_only=True)
class AssignedPart:
    """Part of a loading that one foot carries."""

    frames: slice
    alone: slice
    """Frames in which this foot alone stands on the plate: all, unless both feet are on a belt."""
    foot: int | None  # 0 right, 1 left; None: neither foot is near


def assign_feet(
    wrench: Array, stretch: slice, time: Array, feet: FootPoints, height: float
) -> list[AssignedPart]:
    """Assign a loading of a plate to feet by its centre of pressure.

    Torques and checks use this assignment; the feet are those of the tracked model or of the
    markers.

    Parameters
    ----------
    wrench
        (nf, 6) of the plate at the marker frames, not filtered.
    stretch
        Frames of the loading.
    time
        (nf,) s.
    feet
        Heels and toes of both feet; NaN where not visible.
    height
        m, of the plate's surface.

    Returns
    -------
    list of AssignedPart
        In time. Several where two feet loaded the plate in succession, or a belt carries both.
    """
    away = _compute_distances_to_feet(wrench, stretch, feet, height)
    distances = _average_distances(away, wrench[stretch, 1])
    nearest = int(np.argmin(distances))
    foot = nearest if distances[nearest] < UNDER_FOOT_M else None
    stances = _find_single_stances(stretch, time, feet, away, foot)
    if stances:
        # Each foot carries the plate until the other one stands alone.
        begins = [stretch.start, *(alone.start for alone, _ in stances[1:])]
        ends = [*begins[1:], stretch.stop]
        return [
            AssignedPart(frames=slice(begin, end), alone=alone, foot=k)
            for begin, end, (alone, k) in zip(begins, ends, stances, strict=True)
        ]
    parts: Sequence[tuple[slice, int | None]] = [(stretch, foot)]
    if foot is not None:
        parts = _divide_loading(stretch, foot, time, feet, away)
    return [AssignedPart(frames=frames, alone=frames, foot=k) for frames, k in parts]


def measure_distances(wrench: Array, stretch: slice, feet: FootPoints, height: float) -> Array:
    """Measure how far the centre of pressure of a loading is from both feet, seen from above.

    Parameters
    ----------
    wrench
        (nf, 6) of the plate at the marker frames, not filtered.
    stretch
        Frames of the loading.
    feet
        Heels and toes of both feet; NaN where not visible.
    height
        m, of the plate's surface.

    Returns
    -------
    (2,) array
        m, mean distance from the heel-toe line, weighted by the load; infinite for a foot that is
        not visible in any of the frames.
    """
    away = _compute_distances_to_feet(wrench, stretch, feet, height)
    return _average_distances(away, wrench[stretch, 1])


def _average_distances(away: Array, load: Array) -> Array:
    """Average distances (n, 2) m by the load (n,) N; infinite for a foot that is never visible."""
    out = np.full(len(SIDES), np.inf)
    for foot, column in enumerate(away.T):
        visible = np.isfinite(column)
        if visible.any():
            out[foot] = np.average(column[visible], weights=load[visible])
    return out


def _find_single_stances(
    stretch: slice, time: Array, feet: FootPoints, away: Array, foot: int | None
) -> list[tuple[slice, int]]:
    """Find the frames of a loading in which one foot alone stands on the plate.

    On a belt under both feet a loading lasts for many steps, and its sum is the force of one foot
    only there. `away` (n, 2) m: distances of the centre of pressure from the feet; `foot`: the one
    that is near to the whole loading, if any. Empty for an ordinary step, or two feet so near to
    each other that one is under the whole loading.
    """
    resting = feet.resting
    # Alone: the foot rests, the other one does not, and the centre of pressure is under it.
    alone = (
        resting[stretch]
        & ~mark_near(resting, time)[stretch, ::-1]
        & (away < np.fmin(UNDER_FOOT_M, away[:, ::-1]))
    )
    # Stances of both feet in their order; successive ones of the same foot are one.
    stands = [(run, k) for k in range(len(SIDES)) for run in find_runs(alone[:, k])]
    out = list[tuple[slice, int]]()
    for run, k in sorted(stands, key=lambda found: found[0].start):
        frames = slice(stretch.start + run.start, stretch.start + run.stop)
        if out and out[-1][1] == k:
            out[-1] = slice(out[-1][0].start, frames.stop), k
        elif measure_duration(time, frames) >= MIN_LOADING_S:
            out.append((frames, k))
    fewest = 2 if foot is None else MIN_ALTERNATIONS
    return out if len(out) >= fewest else []


def _divide_loading(
    stretch: slice, foot: int, time: Array, feet: FootPoints, away: Array
) -> list[tuple[slice, int]]:
    """Divide a loading into the parts of both feet, if two feet made it.

    `away` (n, 2) m: distances of the centre of pressure from the feet.
    """
    other, resting = 1 - foot, feet.resting
    # Frames in which the assigned foot has left and the other one rests under the pressure.
    gone = ~mark_near(resting[:, foot], time)[stretch] & resting[stretch, other]
    nearer = find_runs(gone & (away[:, other] < np.minimum(away[:, foot], UNDER_FOOT_M)))
    taken = [run for run in nearer if measure_duration(time[stretch], run) >= MIN_LOADING_S]
    if not taken:
        return [(stretch, foot)]
    first, last = stretch.start + taken[0].start, stretch.start + taken[-1].stop
    # The other foot was on the plate first.
    if not resting[stretch, foot][: taken[0].start].any():
        return [(slice(stretch.start, last), other), (slice(last, stretch.stop), foot)]
    return [(slice(stretch.start, first), foot), (slice(first, stretch.stop), other)]


def _compute_distances_to_feet(
    wrench: Array, stretch: slice, feet: FootPoints, height: float
) -> Array:
    """Compute distances (n, 2) m of the centre of pressure from the heel-toe lines of the feet."""
    centre = compute_centre_on_ground(wrench[stretch], height)[:, None, [0, 2]]
    heel, toe = (points[stretch][..., [0, 2]] for points in (feet.heel, feet.toe))
    return compute_distance_to_line(centre, heel, toe)


def compute_distance_to_line(point: Array, a: Array, b: Array) -> Array:
    """Compute the distance of points from line segments.

    Parameters
    ----------
    point, a, b
        (..., k) m, points and ends of the line segments.

    Returns
    -------
    (...) array
        m.
    """
    along = b - a
    t = np.clip(
        np.sum((point - a) * along, axis=-1) / np.maximum(np.sum(along * along, axis=-1), 1e-12),
        0.0,
        1.0,
    )
    return np.asarray(np.linalg.norm(a + t[..., None] * along - point, axis=-1))


def _report_under_no_foot(plate: ForcePlate, span: str, seat: bool) -> Finding:
    """Report a loading that is under neither foot."""
    topic, code = "plate to foot", Code.UNDER_NO_FOOT
    if seat:
        found = (
            f"{span}: it is at least {100 * SEAT_ABOVE_M:.0f} cm above both feet, as a seat or a "
            "hand rest is"
        )
        return Finding(
            severity=Severity.INFO, topic=topic, found=f"{found}; left out of torques", code=code
        )
    cause = f"the load on plate {plate.name} is under neither foot"
    found = (
        f"{span}: its centre of pressure is further than {1e3 * UNDER_FOOT_M:.0f} mm from both "
        "feet; left out"
    )
    cure = (
        "check the position of the plate (corners), the axes of the forces, and that they belong "
        "to this trial"
    )
    return Finding(
        severity=Severity.WARNING, topic=topic, cause=cause, found=found, cure=cure, code=code
    )


def select_overlapping_steps(
    steps: Sequence[FootContact], foot: int, frames: slice
) -> list[FootContact]:
    """Select the steps of a foot that overlap some frames."""
    return [
        s
        for s in steps
        if s.foot == foot and s.frames.start < frames.stop and frames.start < s.frames.stop
    ]
