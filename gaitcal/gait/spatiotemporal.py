"""Where and when the feet are put down: speed, cadence, steps, stance and swing, stride by stride of each foot.

A stride of a foot goes from its strike at t0 to its next one at t1. With p(t) the horizontal place of its heel and o(t)
that of the other one, both against the ground (a treadmill's belt is taken off: p - v_belt t), t_o the other foot's
strike between, s the vector p(t1) - p(t0):

    stride length = |s|,   speed = |s| / (t1 - t0),   cadence = 120 / (t1 - t0)  (steps a minute, two steps a stride)
    step length   = (p(t1) - o(t_o)) . s / |s|,       step time = t1 - t_o
    step width    = distance of p(t1) from o(t_o) across s, positive where the right foot is right of the left one

The line of progression is that of each stride by itself (Huxham, Gong, Baker, Morris & Iansek, Gait & Posture 2006), so
that lengths and widths hold on straight walks, in turns, and for any direction in the room. The step of a stride is the
one that ends it: that of the leg that is named. Stance lasts from strike to off, swing from off to the next strike;
double support is the part of a stance in which the other foot is down, too, single support the rest of it. Percent are
of the stride.

Vicon's programs measure between the toe markers, which are further apart as toes point outwards: in five walks of a
hospital its step width is 55 to 80 mm larger than between heels (`tests/gait/test_spatiotemporal.py`).

A stride that turns (`gait/progression.py`) is measured along its own line, too, and left out of means. Feet that swing
and get no further than a decimetre have no lengths: they step on the spot, or on a belt that looks like a floor.

A stride that the recording cuts counts for what it shows: the stance of a last strike, the step to a first one (along
the other foot's stride, where that is whole). Nothing is told of a foot at a strike at which no marker shows it.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.dynamics.foot_contact import FootPoints
from gaitcal.gait.cycles import CYCLE_RANGE, FootEvents, between, is_stride, resample
from gaitcal.gait.event_clock import double_support
from gaitcal.gait.events import SIDES, TrialEvents
from gaitcal.gait.gait_event import EventSource
from gaitcal.gait.strides import turn_between

PER_STRIDE: Final = 120.0
"""Two steps, sixty seconds."""
LEAST_STRIDE: Final = 0.1
"""m: feet that swing and get no further step on the spot, or on a belt that nothing tells of."""
MEASURES: Final = {
    "speed": "m/s",
    "cadence": "steps/min",
    "stride_length": "m",
    "stride_time": "s",
    "step_length": "m",
    "step_width": "m",
    "step_time": "s",
    "stance": "s",
    "stance_percent": "%",
    "swing": "s",
    "swing_percent": "%",
    "first_double_support": "s",
    "first_double_support_percent": "%",
    "second_double_support": "s",
    "second_double_support_percent": "%",
    "double_support": "s",
    "double_support_percent": "%",
    "single_support": "s",
    "single_support_percent": "%",
}
"""Name -> unit, in the order of tables; `_percent` is of the stride."""


@dataclass(frozen=True, kw_only=True)
class Stride:
    """What one stride of one foot measures, or the part of it that the recording shows."""

    side: str
    """`r` or `l`."""
    number: int | None
    """From 1, as in `cycles.csv`; None where the recording holds only a part of it."""
    start: float | None
    """s, the strike that begins it; None where it is not recorded."""
    stop: float | None
    """s, the strike that ends it."""
    sources: tuple[EventSource, ...]
    """What told these strikes."""
    measures: Mapping[str, float]
    """Name of `MEASURES` -> value; what is not known is absent."""
    line: float | None = None
    """rad, direction of progression, to the left of the room's x axis; None where it is not known."""
    turn: float | None = None
    """deg to the left by which the pelvis turns from its begin to its end; None where it is not known."""
    on_the_spot: bool = False
    """The feet swing and get no further: without lengths and speed."""


def strides_measured(
    events: TrialEvents,
    time: Array,
    feet: FootPoints | None,
    unseen: Mapping[str, BoolArray] | None = None,
    faced: Array | None = None,
) -> tuple[Stride, ...]:
    """Of every stride of both feet: right, then left, in order of time.

    Parameters
    ----------
    events : of the trial.
    time : (nf,) s.
    feet : heels on the laboratory's axes, and how the ground moves; None where the model has none: times alone.
    unseen : `foot_r`, `foot_l` -> (nf,) frames in which no marker shows the foot.
    faced : (nf,) rad, where the pelvis points (`gait/progression.py`); None: whether a stride turns is not known.
    """
    of_feet = {side: events.of(side) for side in SIDES}
    heels = _heels(time, feet, unseen or {})
    out: list[Stride] = []
    for side, other in (("r", "l"), ("l", "r")):
        number = 0
        for start, stop in _spans(of_feet[side], of_feet[other]):
            whole = start is not None and stop is not None
            number += whole
            struck = None if stop is None else _step_before(of_feet[side], of_feet[other], start, stop)
            measures = _times(of_feet[side], of_feet[other], start, stop, struck)
            period = _period(of_feet[other], start, stop, struck)
            along = None
            if heels is not None and stop is not None and period is not None:
                along = heels.between(side if start is not None else other, *period)
                measures |= _lengths(heels, side, start, stop, struck, along)
            spot = along is not None and float(np.linalg.norm(along)) < LEAST_STRIDE
            known = [t for t in (start, stop) if t is not None]
            if measures:
                out.append(
                    Stride(
                        side=side,
                        number=number if whole else None,
                        start=start,
                        stop=stop,
                        sources=_sources(of_feet[side], known),
                        measures={name: measures[name] for name in MEASURES if name in measures},
                        line=_direction(along),
                        turn=None if faced is None or period is None else turn_between(time, faced, *period),
                        on_the_spot=spot,
                    )
                )
    return tuple(out)


def _spans(foot: FootEvents, other: FootEvents) -> list[tuple[float | None, float | None]]:
    """From each strike to the next, from before the first and to after the last; apart where it is no stride."""
    strikes: list[float] = foot.strikes.tolist()
    if not strikes:
        return []
    out: list[tuple[float | None, float | None]] = [(None, strikes[0])]
    for start, stop in itertools.pairwise(strikes):
        out += [(start, stop)] if is_stride(start, stop, foot, other) else [(start, None), (None, stop)]
    return [*out, (strikes[-1], None)]


def _sources(foot: FootEvents, strikes: Sequence[float]) -> tuple[EventSource, ...]:
    if len(foot.sources) != len(foot.strikes):
        return ()
    return tuple(s for t, s in zip(foot.strikes.tolist(), foot.sources, strict=True) if t in strikes)


def _times(
    own: FootEvents, other: FootEvents, start: float | None, stop: float | None, struck: float | None
) -> dict[str, float]:
    """What events alone tell; `struck`: when the other foot began the step that ends the stride."""
    out: dict[str, float] = {}
    off = _off(own, other, start, stop)
    if stop is not None and struck is not None:
        out["step_time"] = stop - struck
    if start is not None and off is not None:
        out["stance"] = off - start
        out |= double_support(other, start, off)
    if stop is not None and off is not None:
        out["swing"] = stop - off
    if start is not None and stop is not None:
        whole = stop - start
        out |= {"stride_time": whole, "cadence": PER_STRIDE / whole}
        for name in [n for n in out if f"{n}_percent" in MEASURES]:
            out[f"{name}_percent"] = 100.0 * out[name] / whole
    return out


def _off(own: FootEvents, other: FootEvents, start: float | None, stop: float | None) -> float | None:
    """The off of a stride: the first one after its start; the last one before its stop, where the start is unknown.

    None where a strike is missing beside it: two strikes of the other foot between.
    """
    low = start if start is not None else float(stop or 0.0) - CYCLE_RANGE[1]
    high = stop if stop is not None else low + CYCLE_RANGE[1]
    earlier, later = own.strikes[own.strikes < high], own.strikes[own.strikes > low]
    cut_before, cut_after = start is None and len(earlier), stop is None and len(later)
    low, high = max(low, float(earlier[-1])) if cut_before else low, min(high, float(later[0])) if cut_after else high
    found = between(own.toe_offs, low, high)
    if not len(found) or ((cut_before or cut_after) and len(found) < 2 and len(between(other.strikes, low, high)) > 1):
        return None
    off = float(found[0] if start is not None else found[-1])
    phase = between(other.strikes, start, off) if start is not None else between(other.strikes, off, high)
    return None if len(phase) > 1 else off


def _step_before(own: FootEvents, other: FootEvents, start: float | None, stop: float) -> float | None:
    """s, the other foot's strike from which a foot steps to its own one at `stop`."""
    before = other.strikes[(other.strikes < stop) & (other.strikes > stop - CYCLE_RANGE[1])]
    if start is not None:
        before = before[before > start]
    earlier = own.strikes[own.strikes < stop]
    if len(earlier):  # not across a strike of its own
        before = before[before > earlier[-1]]
    return float(before[-1]) if len(before) else None


@dataclass(frozen=True)
class _Heels:
    """Side -> (nf, 2) m, forward and to the right against the ground; NaN where no marker shows the foot."""

    time: Array
    places: Mapping[str, Array]

    def at(self, side: str, when: float) -> Array:
        out: Array = resample(self.time, self.places[side], np.array([when]))[0]
        return out

    def between(self, side: str, start: float, stop: float) -> Array:
        out: Array = self.at(side, stop) - self.at(side, start)
        return out


def _heels(time: Array, feet: FootPoints | None, unseen: Mapping[str, BoolArray]) -> _Heels | None:
    if feet is None:
        return None
    places = {}
    for foot, side in enumerate(SIDES):
        against_ground = feet.heel[:, foot] - (time - time[0])[:, None] * feet.ground
        lost = unseen.get(f"foot_{side}", np.zeros(len(time), dtype=bool))
        places[side] = np.where(lost[:, None], np.nan, against_ground[:, [0, 2]])
    return _Heels(time, places)


def _period(
    other: FootEvents, start: float | None, stop: float | None, struck: float | None
) -> tuple[float, float] | None:
    """A whole stride (s): that of the foot, else that of the other one in which it steps; None where neither is."""
    if start is not None and stop is not None:
        return start, stop
    if stop is None or struck is None:
        return None
    ahead = other.strikes[(other.strikes > stop) & (other.strikes <= struck + CYCLE_RANGE[1])]
    return (struck, float(ahead[0])) if len(ahead) else None


def _direction(along: Array | None) -> float | None:
    """Rad, to the left of the room's x axis; None of a stride that is not seen, or gets no further."""
    if along is None or not float(np.linalg.norm(along)) >= LEAST_STRIDE:
        return None
    return float(np.arctan2(-along[1], along[0]))


def _lengths(
    heels: _Heels, side: str, start: float | None, stop: float, struck: float | None, along: Array
) -> dict[str, float]:
    """Lengths, width and speed of a stride `along` (2,) m that ends at `stop`, its step beginning where the other foot
    `struck`; nothing where it gets no further.
    """
    out: dict[str, float] = {}
    length = float(np.linalg.norm(along))
    if not length >= LEAST_STRIDE:
        return out
    if start is not None:
        out |= {"stride_length": length, "speed": length / (stop - start)}
    if struck is not None:
        opposite = next(s for s in SIDES if s != side)
        step, forward = heels.at(side, stop) - heels.at(opposite, struck), along / length
        right = np.array([-forward[1], forward[0]])
        out["step_length"] = float(step @ forward)
        out["step_width"] = float(step @ right) * (1.0 if side == "r" else -1.0)
    return {name: value for name, value in out.items() if np.isfinite(value)}
