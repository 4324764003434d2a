"""Gait cycles: from one foot strike to the next of the same foot, and signals brought to 0 to 100 % of one.

    percent(t) = 100 (t - t_strike) / (t_next strike - t_strike)

Strikes and toe-offs come from `gait/events.py`, each with its source. A cycle inside which events show that a strike
is missing is none.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.gait.gait_event import EventSource
from gaitcal.io.intervals import runs

SHORTEST_PHASE = 0.1
"""s: a shorter contact, or a shorter swing, is a flicker of the threshold."""
CYCLE_RANGE = (0.4, 4.0)
"""s: from running to very slow pathological gait; anything else is no stride."""
POINTS = 101
"""0, 1, ..., 100 %."""


@dataclass(frozen=True)
class FootEvents:
    """When one foot meets and leaves the ground, s, increasing."""

    strikes: Array
    toe_offs: Array
    sources: tuple[EventSource, ...] = ()
    """Of each strike."""


@dataclass(frozen=True)
class GaitCycle:
    """One stride of one foot."""

    start: float
    """s, foot strike."""
    stop: float
    """s, next strike of the same foot."""
    toe_off: float | None
    """s, end of stance; None where it is not known."""
    sources: tuple[EventSource, ...] = ()
    """Of its first and of its second strike."""

    def percent(self, time: Array | float) -> Array:
        """Percent of the cycle at `time` (s)."""
        out: Array = 100.0 * (np.asarray(time) - self.start) / (self.stop - self.start)
        return out

    @property
    def stance(self) -> float | None:
        """Percent at which stance ends."""
        return None if self.toe_off is None else float(self.percent(self.toe_off))


def is_stride(start: float, stop: float, own: FootEvents, other: FootEvents | None = None) -> bool:
    """Whether a foot makes one stride from its strike at `start` (s) to the next one that is known, at `stop`.

    Two offs of its own between them, or two strikes of the other foot, and a strike of its own is missing there.
    """
    long_enough = CYCLE_RANGE[0] <= stop - start <= CYCLE_RANGE[1]
    theirs = np.array([]) if other is None else other.strikes
    return long_enough and len(between(own.toe_offs, start, stop)) < 2 and len(between(theirs, start, stop)) < 2


def between(times: Array, start: float, stop: float) -> Array:
    """Those of `times` (s) after `start` and before `stop`."""
    out: Array = times[(times > start) & (times < stop)]
    return out


def gait_cycles(events: FootEvents, other: FootEvents | None = None) -> tuple[GaitCycle, ...]:
    """All complete cycles of one foot, in time order; `other`: of the other foot, which shows missing strikes, too."""
    cycles = []
    for k, (start, stop) in enumerate(itertools.pairwise(events.strikes.tolist())):
        if is_stride(start, stop, events, other):
            off = between(events.toe_offs, start, stop)
            cycles.append(GaitCycle(start, stop, float(off[0]) if len(off) else None, events.sources[k : k + 2]))
    return tuple(cycles)


def stances(events: FootEvents, time: Array) -> tuple[tuple[float, float], ...]:
    """Stretches (s) from a strike to the next toe-off, also those that begin before or end after the trial."""
    changes = sorted([(t, True) for t in events.strikes.tolist()] + [(t, False) for t in events.toe_offs.tolist()])
    if not changes:
        return ()
    out, begin = [], None if changes[0][1] else float(time[0])
    for t, down in changes:
        if down and begin is None:
            begin = t
        elif not down and begin is not None:
            out.append((begin, t))
            begin = None
    return (*out, (begin, float(time[-1]))) if begin is not None else tuple(out)


def steady(time: Array, state: BoolArray) -> BoolArray:
    """`state` (nf,) without flickers: short gaps are closed, then short stretches dropped."""
    out = state.copy()
    for value in (False, True):
        for run in runs(out == value):
            inner = run.start > 0 and run.stop < len(time)
            if inner and time[run.stop] - time[run.start] < SHORTEST_PHASE:
                out[run] = not value
    return out


def normalise(time: Array, values: Array, cycle: GaitCycle, points: int = POINTS) -> Array:
    """(points, ...) `values` (nf, ...) at equal steps of the cycle, linear between frames.

    A NaN stays a gap: every point between a frame that is NaN and its neighbours is NaN.
    """
    return resample(time, values, np.linspace(cycle.start, cycle.stop, points))


def usable(time: Array, valid: BoolArray, cycle: GaitCycle) -> BoolArray:
    """(101,) percents of the cycle at which a signal that is valid in some frames (nf,) is so."""
    return np.isfinite(normalise(time, np.where(valid, 1.0, np.nan), cycle))


def resample(time: Array, values: Array, at: Array) -> Array:
    """(len(at), ...) `values` (nf, ...) at the times `at`, linear; NaN in gaps and outside."""
    right = np.clip(np.searchsorted(time, at), 1, len(time) - 1)
    left = right - 1
    part = (at - time[left]) / (time[right] - time[left])
    before, after = values[left], values[right]
    share = np.broadcast_to(part.reshape(-1, *([1] * (values.ndim - 1))), before.shape)
    mixed = before + share * (after - before)
    out: Array = np.where(share == 0.0, before, np.where(share == 1.0, after, mixed))
    out[(at < time[0]) | (at > time[-1])] = np.nan
    return out


def best_cycle(cycles: Sequence[GaitCycle], time: Array, valid: BoolArray) -> GaitCycle:
    """The cycle with the largest share of valid frames; the first of equals."""
    return max(cycles, key=lambda c: float(valid[(time >= c.start) & (time <= c.stop)].mean()))
