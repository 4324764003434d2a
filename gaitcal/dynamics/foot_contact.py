"""Feet on the ground: when one rests, told by its motion and not by forces; its sole; and whose
foot loads a plate.

A heel or a toe that moves with the ground rests. A resting foot that no plate carries stands on the
floor: what the ground does to it is not known. Resting begins up to 40 ms after the true contact
and ends up to 90 ms before it (40 contacts on plates of nine people), so that so much around it is
unknown too. Where the file tells foot strikes and offs that agree with its own plates, they say it
to the frame.

The sole, seen from above, begins a little before the heel marker, which sits on the back of the
heel, and ends at the tip of the foot; it is as wide as Winter (2009) gives the foot, less at heel
and toes. Its cells count by their area.

A loading of a plate is of the foot under whose sole its centre of pressure lies; one that two feet
make one after the other is divided where the first has left the ground and the second rests. One
that lasts over steps, on a belt that carries both feet, is of each foot from where it stands alone
on.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.dynamics.measurement_errors import outside
from gaitcal.errors import Code, Finding, Severity
from gaitcal.io.force_plate import LOADED_N, compute_centre_on_ground
from gaitcal.io.labels import FootEvent, FootMoment, select_event_times
from gaitcal.io.recording import ForcePlate, find_runs, format_spans, measure_duration
from gaitcal.model.linkage import SIDES

RESTING = (
    0.4  # m/s: a heel or toe slower than this is down; in swing both move faster, also in slow gait
)
# m/s: what heels and toes of feet that roll over a floor, and still ones, may seem to move by
SLOWEST_BELT = 0.05
SLOWEST_SWING = 0.25  # m/s against the belt that a foot in swing exceeds, as in `gait/events.py`
SWINGING = 0.9  # Share of the moments of all points below the speed that some swing must exceed
# s by which resting and loading of a plate may differ at the beginning and end of one contact
EDGE = 0.08
LANDING, LEAVING = 0.05, 0.10
"""s before a foot on the floor rests, and after, in which it may be loaded already, or still."""
SAME_EVENT = 0.1  # s: an event this near to the beginning or end of a contact is of that contact
BELIEVED = 0.05
"""s by which an event may miss the loading of a plate; one that misses it by more, and none of the
file is used.
"""


@dataclass(frozen=True, kw_only=True)
class FootPoints:
    """Heel and toe of both feet, from the tracked model: order right, left."""

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
        """(nf, 2) the foot is down: its heel or its toe moves with the ground."""
        return np.minimum(self.heel_speed, self.toe_speed) < RESTING


def belts(points: Array, velocity: Array) -> Array:
    """(2, 3) m/s, how the ground moves under both feet: as one, unless their lowest points show two
    belts.

    `points`, `velocity`: (nf, 2 k, 3) of the right and the left foot in turn.
    """
    common = ground_velocity(points, velocity)
    out = np.tile(common, (len(SIDES), 1))
    whole = np.isfinite(points).all(axis=(1, 2)) & np.isfinite(velocity).all(axis=(1, 2))
    lowest = points[whole, :, 1].argmin(axis=1) if common.any() else np.zeros(0, dtype=int)
    if set(lowest % len(SIDES)) != set(range(len(SIDES))):
        return out
    under = velocity[whole, lowest]
    by_foot = np.array(
        [np.median(under[lowest % len(SIDES) == foot], axis=0) for foot in range(len(SIDES))]
    )
    return by_foot if np.linalg.norm(by_foot[0] - by_foot[1]) > 2.0 * SLOWEST_BELT else out


def ground_velocity(points: Array, velocity: Array) -> Array:
    """(3,) m/s, how the ground moves under feet with points and velocities (nf, n, 3): the median
    of the lowest one's.

    Zero on a floor, the belt's velocity on a treadmill. A belt slower than a resting foot is told
    by feet that go to and fro and get no further than it does: over a floor they get on, at several
    times the speed of a foot that rolls.
    """
    whole = np.isfinite(points).all(axis=(1, 2)) & np.isfinite(velocity).all(axis=(1, 2))
    if not whole.any():
        return np.zeros(3)
    lowest = points[whole, :, 1].argmin(axis=1)
    out: Array = np.median(velocity[whole, lowest], axis=0)
    speed = float(np.linalg.norm(out))
    if speed > RESTING:
        return out
    back = out / speed if speed > SLOWEST_BELT else np.zeros(3)
    onwards = -(velocity[whole] @ back)  # (nf, n) m/s, in the room
    swings = float(np.quantile(onwards, SWINGING)) + speed > SLOWEST_SWING
    stays = abs(float(onwards.mean())) < 0.5 * speed
    return out if swings and stays else np.zeros(3)


def near(marked: BoolArray, time: Array) -> BoolArray:
    """(nf,) or (nf, feet) frames within `EDGE` of a marked one, at `time` (nf,) s."""
    if marked.ndim > 1:
        return np.stack([near(column, time) for column in marked.T], axis=1)
    times = time[marked]
    if not len(times):
        return marked.copy()
    after = np.clip(np.searchsorted(times, time), min(1, len(times) - 1), len(times) - 1)
    gap = np.minimum(np.abs(time - times[after]), np.abs(time - times[np.maximum(after - 1, 0)]))
    return marked | (gap <= EDGE)


def on_the_floor(
    resting: BoolArray, loaded: BoolArray, time: Array, events: Sequence[FootEvent] = ()
) -> BoolArray:
    """(nf, 2) frames in which a foot may be on the ground where no plate carries it.

    `resting`, `loaded`: (nf, 2) the foot is down by its motion; a plate carries it.
    `time`: (nf,) s.
    `events`: of the file; used where they agree with the plates.
    """
    used = events if agree(events, loaded, time) else ()
    out = np.zeros_like(resting)
    for foot, side in enumerate(SIDES):
        strikes, offs = (
            np.array(select_event_times(used, side, moment))
            for moment in (FootMoment.STRIKE, FootMoment.OFF)
        )
        carried = near(loaded[:, foot], time)
        for run in find_runs(resting[:, foot] & ~carried):
            begin, end = float(time[run.start]), float(time[run.stop - 1])
            before, after = (
                time[: run.start][loaded[: run.start, foot]],
                time[run.stop :][loaded[run.stop :, foot]],
            )
            if run.start > 0:
                strike = _event_near(strikes, begin - SAME_EVENT, begin + BELIEVED, begin)
                at_earliest = begin - LANDING if strike is None else strike
                begin = float(before[-1]) if carried[run.start - 1] else at_earliest
            if run.stop < len(time):
                off = _event_near(offs, end - BELIEVED, end + SAME_EVENT, end)
                at_latest = end + LEAVING if off is None else off
                end = float(after[0]) if carried[run.stop] else at_latest
            inner = (time > begin) & (time < end)
            inner[run.start] |= run.start == 0
            inner[run.stop - 1] |= run.stop == len(time)
            out[:, foot] |= inner
    return out


def _event_near(times: Array, earliest: float, latest: float, contact: float) -> float | None:
    """s, the event of a file nearest to the beginning or end of a contact (s); None where none lies
    between.
    """
    close = times[(times >= earliest) & (times <= latest)]
    return float(close[np.abs(close - contact).argmin()]) if len(close) else None


def agree(events: Sequence[FootEvent], loaded: BoolArray, time: Array) -> bool:
    """Whether events are those of this walk: some are of loadings (nf, 2) of plates, and none
    misses its own.
    """
    gaps = []
    for foot, side in enumerate(SIDES):
        for run in find_runs(loaded[:, foot]):
            ends = {FootMoment.STRIKE: run.start > 0, FootMoment.OFF: run.stop < len(time)}
            for moment, inside in ends.items():
                at = time[run.start if moment is FootMoment.STRIKE else run.stop - 1]
                apart = (
                    [abs(t - at) for t in select_event_times(events, side, moment)]
                    if inside
                    else []
                )
                gaps += sorted(gap for gap in apart if gap < SAME_EVENT)[:1]
    return bool(gaps) and max(gaps) <= BELIEVED


FOOT_BREADTH = 0.055  # Of body height (Winter 2009)
HEEL_M = 0.015
"""From the middle of a marker on the back of the heel to where the sole meets the ground: half a
marker, and the rounding of the heel."""
SHAPE = ((0.0, 0.15, 0.35, 0.7, 0.9, 1.0), (0.4, 0.65, 0.65, 1.0, 0.85, 0.45))
"""How far from heel to tip, and how wide there, of the greatest width."""
LENGTHWISE, ACROSS = 15, 5  # Cells
# Plates no further apart than this touch, and what lies as near to a plate is on it: markers tell
# no less
GAP_M = 0.01


@dataclass(frozen=True, kw_only=True)
class SoleCells:
    """One foot in some frames."""

    cells: Array  # (nf, n, 3) m, middles of the cells
    share: Array  # (n,) of the sole's area; they sum to 1
    resting: BoolArray
    """(nf, n) the half of the sole to which a cell belongs is on the ground, as heel or toe moves
    with it.
    """
    rear: (
        BoolArray  # (n,) cells of the half that belongs to the heel; the others belong to the toes
    )
    forward: Array  # (nf, 2) unit vectors from heel to tip, x and z of the laboratory

    def beside(self, plates: Sequence[ForcePlate]) -> BoolArray:
        """(nf, n) cells beside all of these plates, which have corners; those that touch are one
        surface.
        """
        if not plates:
            return np.ones(self.cells.shape[:2], dtype=bool)
        away = outside(plates, self.cells.reshape(-1, 3)).reshape(self.cells.shape[:2])
        return np.asarray(away > GAP_M)

    def share_of(self, chosen: BoolArray) -> Array:
        """(nf,) share of the sole's area in the chosen cells (nf, n)."""
        return chosen @ self.share

    def share_of_halves(self, chosen: BoolArray) -> Array:
        """(nf, 2) share of the heel's half, and of the toes', in the chosen cells (nf, n).

        A heel is a small part of a sole, and bears the whole body where it alone rests.
        """
        halves = np.stack([self.rear, ~self.rear], axis=1) * self.share[:, None]
        return chosen @ (halves / halves.sum(axis=0))

    def offsets(self, point: Array) -> tuple[Array, Array]:
        """(nf, n) m along the foot and (nf, n) m across it, from points (nf, 3) to the cells, not
        negative.
        """
        apart = (self.cells - point[:, None])[:, :, [0, 2]]
        across = np.stack([-self.forward[:, 1], self.forward[:, 0]], axis=1)
        along, beside = (
            np.abs(np.einsum("fnk,fk->fn", apart, axis)) for axis in (self.forward, across)
        )
        return along, beside


def sole_of(feet: FootPoints, foot: int, frames: slice) -> SoleCells:
    """The sole of a foot (0 right, 1 left)."""
    heel, tip = feet.heel[frames, foot], feet.tip[frames, foot]
    line = (tip - heel)[:, [0, 2]]
    length = np.maximum(np.linalg.norm(line, axis=1), 1e-9)
    forward = line / length[:, None]
    part = (np.arange(LENGTHWISE) + 0.5) / LENGTHWISE
    width = feet.width * np.interp(part, *SHAPE)
    aside = (np.arange(ACROSS) + 0.5) / ACROSS - 0.5
    begin = np.minimum(HEEL_M, 0.5 * length)
    ahead = begin[:, None] + (length - begin)[:, None] * part
    along, across = np.repeat(ahead, ACROSS, axis=1), np.outer(width, aside).ravel()
    cells = np.empty((len(heel), LENGTHWISE * ACROSS, 3))
    cells[:, :, 0] = heel[:, None, 0] + along * forward[:, None, 0] - across * forward[:, None, 1]
    cells[:, :, 2] = heel[:, None, 2] + along * forward[:, None, 1] + across * forward[:, None, 0]
    cells[:, :, 1] = heel[:, None, 1] + along / length[:, None] * (tip - heel)[:, None, 1]
    area = np.repeat(np.interp(part, *SHAPE), ACROSS)
    rear = np.repeat(part < 0.5, ACROSS)
    heel_rests, toe_rests = (
        speed[frames, foot] < RESTING for speed in (feet.heel_speed, feet.toe_speed)
    )
    resting = np.where(rear, heel_rests[:, None], toe_rests[:, None])
    return SoleCells(
        cells=cells, share=area / area.sum(), resting=resting, rear=rear, forward=forward
    )


# m: largest distance of the centre of pressure from the line heel-toe of the foot that it belongs
# to
UNDER_FOOT = 0.15
SEAT_ABOVE_M = (
    0.25  # A plate that lies higher above the lower heel is no step: stairs rise by 0.2 m at most
)
FEWEST_IN_TURN = 3
"""Times that feet stand on a plate in turn, from which nobody merely steps from one foot to the
other.
"""
SHORTEST = 0.05  # s: a shorter loading is a knock, not a step


@dataclass(frozen=True, kw_only=True)
class Loading:
    """One plate under load, given to one foot."""

    plate: ForcePlate
    foot: int  # 0 right, 1 left
    frames: slice
    point: Array  # (n, 3) m, centre of pressure at these frames
    load: Array  # (n,) N, vertical force at these frames


@dataclass(frozen=True, kw_only=True)
class FootContact(Loading):
    """A loading of the tracked motion."""

    wrench: Array  # (nf, 6) of the plate at all frames of the trial, not filtered
    words: str  # Plate and time, for messages

    def wrench_in(self, frames: slice) -> Array:
        """(n, 6) its wrench in some frames, zero outside of it."""
        out = np.zeros((frames.stop - frames.start, 6))
        first, last = max(self.frames.start, frames.start), min(self.frames.stop, frames.stop)
        out[first - frames.start : last - frames.start] = self.wrench[first:last]
        return out


def steps_on(
    plate: ForcePlate, wrench: Array, time: Array, feet: FootPoints, side: str | None
) -> tuple[list[FootContact], list[Finding]]:
    """The steps on one plate, and loadings that fit no foot.

    `wrench`: (nf, 6) of the plate at the frames, not filtered.
    `side`: "r" or "l" where the study says whose plate it is; None: found.
    """
    steps, findings = list[FootContact](), list[Finding]()
    height = surface_height(plate)
    for stretch in find_runs(wrench[:, 1] > LOADED_N):
        if measure_duration(time, stretch) < SHORTEST:
            continue
        foot = SIDES.index(side) if side else foot_under(wrench, stretch, feet)
        alone = [] if side else taken_in_turn(wrench, stretch, time, feet)
        if alone:  # each until the other foot stands alone
            ends = [*(frames.start for frames, _ in alone[1:]), stretch.stop]
            begins = [stretch.start, *ends[:-1]]
            parts = [(slice(a, b), of) for a, b, (_, of) in zip(begins, ends, alone, strict=True)]
        elif foot is None:
            lowest = float(np.nanmin(feet.heel[stretch][..., 1]))
            seat = height > lowest + SEAT_ABOVE_M
            findings.append(
                _under_neither(plate, f"plate {plate.name}, {format_spans(time, [stretch])}", seat)
            )
            continue
        else:
            parts = [(stretch, foot)] if side else _divided(wrench, stretch, foot, time, feet)
        for frames, of in parts:
            steps.append(
                FootContact(
                    foot=of,
                    frames=frames,
                    plate=plate,
                    wrench=wrench,
                    point=compute_centre_on_ground(wrench[frames], height),
                    load=wrench[frames, 1],
                    words=f"plate {plate.name}, {format_spans(time, [frames])}",
                )
            )
    return steps, findings


def surface_height(plate: ForcePlate) -> float:
    """m, of the plane in which the centre of pressure lies."""
    if plate.corners is not None and np.isfinite(plate.corners).all():
        return float(plate.corners[:, 1].mean())
    height = plate.point[np.nan_to_num(plate.force[:, 1]) > LOADED_N, 1]
    return float(np.nanmedian(height)) if np.isfinite(height).any() else 0.0


def foot_under(wrench: Array, stretch: slice, feet: FootPoints) -> int | None:
    """The foot whose heel-toe line is nearest to the centre of pressure, weighed by the load; None:
    far from both.
    """
    distances = [
        np.average(_away(wrench, stretch, feet, k), weights=wrench[stretch, 1])
        for k in range(len(SIDES))
    ]
    best = int(np.argmin(distances))
    return best if distances[best] < UNDER_FOOT else None


def taken_in_turn(
    wrench: Array, stretch: slice, time: Array, feet: FootPoints
) -> list[tuple[slice, int]]:
    """Frames in which one foot alone stands under a loading, and which; none where it is a step or
    two of feet so near to each other that one of them is under all of it.

    On a belt that carries both feet a loading lasts for many steps, and its sum tells of a foot
    only there.
    """
    resting, away = (
        feet.resting,
        np.stack([_away(wrench, stretch, feet, k) for k in range(len(SIDES))], axis=1),
    )
    alone = (
        resting[stretch]
        & ~near(resting, time)[stretch, ::-1]
        & (away < np.fmin(UNDER_FOOT, away[:, ::-1]))
    )
    stands = [(run, foot) for foot in range(len(SIDES)) for run in find_runs(alone[:, foot])]
    out = list[tuple[slice, int]]()
    for run, foot in sorted(stands, key=lambda found: found[0].start):
        frames = slice(stretch.start + run.start, stretch.start + run.stop)
        if out and out[-1][1] == foot:
            out[-1] = slice(out[-1][0].start, frames.stop), foot
        elif measure_duration(time, frames) >= SHORTEST:
            out.append((frames, foot))
    fewest = 2 if foot_under(wrench, stretch, feet) is None else FEWEST_IN_TURN
    return out if len(out) >= fewest else []


def _divided(
    wrench: Array, stretch: slice, foot: int, time: Array, feet: FootPoints
) -> list[tuple[slice, int]]:
    """The stretch, or its two parts, each with the foot that made it."""
    other, resting = 1 - foot, feet.resting
    gone = ~near(resting[:, foot], time)[stretch] & resting[stretch, other]
    away, mine = (_away(wrench, stretch, feet, k) for k in (other, foot))
    nearer = find_runs(gone & (away < np.minimum(mine, UNDER_FOOT)))
    taken = [run for run in nearer if measure_duration(time[stretch], run) >= SHORTEST]
    if not taken:
        return [(stretch, foot)]
    first, last = stretch.start + taken[0].start, stretch.start + taken[-1].stop
    if not resting[stretch, foot][: taken[0].start].any():  # the other foot was there first
        return [(slice(stretch.start, last), other), (slice(last, stretch.stop), foot)]
    return [(slice(stretch.start, first), foot), (slice(first, stretch.stop), other)]


def _away(wrench: Array, stretch: slice, feet: FootPoints, foot: int) -> Array:
    """(n,) m from the centre of pressure to the line heel-toe of a foot."""
    centre = compute_centre_on_ground(wrench[stretch])[:, [0, 2]]
    return distance_to_line(
        centre, feet.heel[stretch, foot][:, [0, 2]], feet.toe[stretch, foot][:, [0, 2]]
    )


def distance_to_line(point: Array, a: Array, b: Array) -> Array:
    """(...) m, from points (..., k) to the stretches from a to b (..., k)."""
    along = b - a
    t = np.clip(
        np.sum((point - a) * along, axis=-1) / np.maximum(np.sum(along * along, axis=-1), 1e-12),
        0.0,
        1.0,
    )
    return np.asarray(np.linalg.norm(a + t[..., None] * along - point, axis=-1))


def _under_neither(plate: ForcePlate, span: str, seat: bool) -> Finding:
    topic, code = "plate to foot", Code.UNDER_NO_FOOT
    if seat:
        found = (
            f"{span}: it lies {100 * SEAT_ABOVE_M:.0f} cm and more above both feet: a seat, or a "
            "rest of the hands"
        )
        return Finding(
            severity=Severity.INFO, topic=topic, found=f"{found}; left out of torques", code=code
        )
    cause = f"the load on plate {plate.name} is under neither foot"
    found = (
        f"{span}: its centre of pressure is further than {1e3 * UNDER_FOOT:.0f} mm from both feet; "
        "left out"
    )
    cure = (
        "check the position of the plate (corners), the axes of the forces, and that they belong "
        "to this trial"
    )
    return Finding(
        severity=Severity.WARNING, topic=topic, cause=cause, found=found, cure=cure, code=code
    )


def meeting(steps: Sequence[FootContact], foot: int, frames: slice) -> list[FootContact]:
    """The steps of a foot that last in some of these frames."""
    return [
        s
        for s in steps
        if s.foot == foot and s.frames.start < frames.stop and frames.start < s.frames.stop
    ]
