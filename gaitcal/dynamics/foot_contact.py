"""When a foot is on the ground, told by its motion and by the events of the file, and not by forces.

A heel or a toe that moves with the ground rests. A resting foot that no plate carries stands on the floor: what the
ground does to it is not known. Resting begins up to 40 ms after the true contact and ends up to 90 ms before it (40
contacts on plates of nine people), so that so much around it is unknown too. Where the file tells foot strikes and offs
that agree with its own plates, they say it to the frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.io.intervals import runs
from gaitcal.io.metadata import FootEvent, FootMoment
from gaitcal.model.linkage import SIDES

RESTING = 0.4
"""m/s: a heel or toe slower than this is down; in swing both move faster, also in slow gait."""
SLOWEST_BELT = 0.05
"""m/s: what heels and toes of feet that roll over a floor, and still ones, may seem to move by."""
SLOWEST_SWING = 0.25
"""m/s against the belt that a foot in swing exceeds, as in `gait/swing.py`."""
SWINGING = 0.9
"""Share of the moments of all points below the speed that some swing must exceed."""
EDGE = 0.08
"""s by which resting and loading of a plate may differ at the beginning and end of one contact."""
LANDING, LEAVING = 0.05, 0.10
"""s before a foot on the floor rests, and after, in which it may be loaded already, or still."""
SAME_EVENT = 0.1
"""s: an event this near to the beginning or end of a contact is of that contact."""
BELIEVED = 0.05
"""s by which an event may miss the loading of a plate; one that misses it by more, and none of the file is used."""


@dataclass(frozen=True, kw_only=True)
class FootPoints:
    """Heel and toe of both feet, from the tracked model: order right, left."""

    heel: Array
    """(nf, 2, 3) m."""
    toe: Array
    """(nf, 2, 3) m."""
    tip: Array
    """(nf, 2, 3) m, the foremost point of the sole."""
    heel_speed: Array
    """(nf, 2) m/s, against the ground."""
    toe_speed: Array
    """(nf, 2) m/s, against the ground."""
    width: float = 0.0
    """m, of the sole where it is widest; 0: not known, a line from heel to tip."""
    ground: Array = field(default_factory=lambda: np.zeros(3))
    """(3,) m/s, how the ground moves: zero on a floor, the belt's velocity on a treadmill."""

    @property
    def resting(self) -> BoolArray:
        """(nf, 2) the foot is down: its heel or its toe moves with the ground."""
        out: BoolArray = np.minimum(self.heel_speed, self.toe_speed) < RESTING
        return out


def ground_velocity(points: Array, velocity: Array) -> Array:
    """(3,) m/s, how the ground moves under feet with points and velocities (nf, n, 3): the median of the lowest one's.

    Zero on a floor, the belt's velocity on a treadmill. A belt slower than a resting foot is told by feet that go to
    and fro and get no further than it does: over a floor they get on, at several times the speed of a foot that rolls.
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
    out: BoolArray = marked | (gap <= EDGE)
    return out


def on_the_floor(resting: BoolArray, loaded: BoolArray, time: Array, events: Sequence[FootEvent] = ()) -> BoolArray:
    """(nf, 2) frames in which a foot may be on the ground where no plate carries it.

    Parameters
    ----------
    resting, loaded : (nf, 2) the foot is down by its motion; a plate carries it.
    time : (nf,) s.
    events : of the file; used where they agree with the plates.
    """
    told = events if agree(events, loaded, time) else ()
    out = np.zeros_like(resting)
    for foot, side in enumerate(SIDES):
        strikes, offs = (_times(told, side, moment) for moment in (FootMoment.STRIKE, FootMoment.OFF))
        carried = near(loaded[:, foot], time)
        for run in runs(resting[:, foot] & ~carried):
            begin, end = float(time[run.start]), float(time[run.stop - 1])
            before, after = time[: run.start][loaded[: run.start, foot]], time[run.stop :][loaded[run.stop :, foot]]
            if run.start > 0:
                begin = float(before[-1]) if carried[run.start - 1] else _strike(strikes, begin)
            if run.stop < len(time):
                end = float(after[0]) if carried[run.stop] else _off(offs, end)
            inner = (time > begin) & (time < end)
            inner[run.start] |= run.start == 0
            inner[run.stop - 1] |= run.stop == len(time)
            out[:, foot] |= inner
    return out


def _strike(strikes: Array, resting: float) -> float:
    """s, when a foot that rests from `resting` (s) on struck the floor, by the file's strikes or at the earliest."""
    close = strikes[(strikes >= resting - SAME_EVENT) & (strikes <= resting + BELIEVED)]
    return float(close[np.abs(close - resting).argmin()]) if len(close) else resting - LANDING


def _off(offs: Array, resting: float) -> float:
    """s, when a foot that rests up to `resting` (s) left the floor, by the file's offs or at the latest."""
    close = offs[(offs >= resting - BELIEVED) & (offs <= resting + SAME_EVENT)]
    return float(close[np.abs(close - resting).argmin()]) if len(close) else resting + LEAVING


def agree(events: Sequence[FootEvent], loaded: BoolArray, time: Array) -> bool:
    """Whether events are those of this walk: some are of loadings (nf, 2) of plates, and none misses its own."""
    gaps = []
    for foot, side in enumerate(SIDES):
        for run in runs(loaded[:, foot]):
            ends = {FootMoment.STRIKE: run.start > 0, FootMoment.OFF: run.stop < len(time)}
            for moment, inside in ends.items():
                at = time[run.start if moment is FootMoment.STRIKE else run.stop - 1]
                all_of_them = _times(events, side, moment)
                if inside and len(all_of_them):
                    gap = float(np.abs(all_of_them - at).min())
                    gaps += [gap] if gap < SAME_EVENT else []
    return bool(gaps) and max(gaps) <= BELIEVED


def _times(events: Sequence[FootEvent], side: str, moment: FootMoment) -> Array:
    return np.array([e.time for e in events if e.side == side and e.moment is moment])
