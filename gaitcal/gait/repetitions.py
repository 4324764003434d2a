"""Repetitions of an activity that is no gait, from the height of the pelvis and the feet's events.

Strides are what an activity repeats where one foot strikes after the other, whatever speed, slope or flight there is.
Else it repeats what the pelvis does between two rests: with its height h(t) and rate h'(t),

    still     |h'| < `STILL` of its largest value, or h' changes sign
    rest      still, and within `NEAR` of the range of h of the height of the first still frame
    repetition   from a rest to the next, where h leaves it by more than `FAR` of the range between them.

So one squat is from standing to standing, one sit-to-stand from sitting to sitting where the person sits first, one
jump from standing to standing with the flight in it. Who ends elsewhere (stands up once, drops from a box) repeats
nothing: that is one repetition, from the first rest to where the pelvis comes to stay. A pelvis that keeps its height
has none.

The phases of a repetition are what the pelvis does while feet stand, and flight. Each stretch on the ground parts at
its lowest or highest h, where that is beyond both its ends by more than `NEAR` of the range:

    lowering, rising   h falls, rises               (squat: descent and ascent; sit-to-stand: rising, then sitting down)
    push-off           h rises, and flight follows
    flight             h'' < -`FALLING` g; from the last foot off to the first strike where plates or feet tell these
    landing            h falls, and flight was before
"""

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.gait.cycles import FootEvents, GaitCycle
from gaitcal.io.still import runs
from gaitcal.model.subject_model import GRAVITY

STILL, NEAR, FAR = 0.05, 0.1, 0.5
"""Parts of the fastest rate, and of the range of heights."""
FALLING = 0.8
"""Of gravity, by which the pelvis accelerates downwards at the top of a jump, where it rests on nothing."""
LEAST_RANGE_M = 0.05
"""m: a pelvis goes up and down by as much in walking; less is no squat, rise or jump."""
CROUCH_M = 0.12
"""m that a pelvis goes down and up while no foot strikes or leaves: who walks or runs, by less than 0.1."""
SHORTEST_FLIGHT_S = 0.1
"""s that the pelvis falls: a hop of 12 mm."""
TOGETHER_S = 0.1
"""s between the pelvis' fall and the feet's events in a jump, and between the strikes of both feet of one, at most;
sprinters' steps last 0.2 s."""


def alternate(right: FootEvents, left: FootEvents) -> bool:
    """Whether feet strike and leave in turn, as of who walks, climbs or runs; not together, as in a jump, of which a
    strike may be late in markers that slide.
    """
    if not len(right.strikes) or not len(left.strikes):
        return False
    both = ((right.strikes, left.strikes), (right.toe_offs, left.toe_offs))
    apart = [np.abs(a[:, None] - b) for a, b in both if len(a) and len(b)]
    return float(np.median(np.concatenate([[*d.min(axis=0), *d.min(axis=1)] for d in apart]))) > TOGETHER_S


def repetitions(time: Array, height: Array, feet: Sequence[FootEvents] = ()) -> tuple[GaitCycle, ...]:
    """The repetitions of a trial with their phases, in order of time.

    `time`, `height`: (nf,) s, m: of the pelvis.
    `feet`: events of both.
    """
    reach = float(np.ptp(height))
    if reach < LEAST_RANGE_M:
        return ()
    rate = np.gradient(height, time)
    falls = np.gradient(rate, time) < -FALLING * GRAVITY
    turns = np.append(rate[1:] * rate[:-1] < 0.0, False)  # of who goes on at once there may be no slow frame
    still = np.flatnonzero(((np.abs(rate) < STILL * np.abs(rate).max()) | turns) & ~falls)
    if not len(still):
        return ()
    level = height[still[0]]
    away = np.abs(height - level)
    rests = np.zeros(len(time), dtype=bool)
    rests[still] = away[still] < NEAR * reach
    spans = [(run.start - 1, run.stop) for run in runs(~rests) if away[run].max() > FAR * reach]
    inner = [(a, b) for a, b in spans if a >= 0 and b < len(time)]
    if not inner and spans and 0 <= spans[0][0] < still[-1]:
        there = runs(np.abs(height - height[still[-1]]) < NEAR * reach)[-1]
        inner = [(spans[0][0], there.start)]
    flights = list(_flights(time, falls, feet))
    return tuple(
        GaitCycle(start, stop, None, parts=tuple(_phases(time, height, (start, stop), flights, NEAR * reach)))
        for start, stop in ((float(time[a]), float(time[b])) for a, b in inner)
    )


def crouches(time: Array, height: Array, feet: Sequence[FootEvents]) -> list[tuple[float, float]]:
    """From which event of the `feet` to which (s) the pelvis goes down and up further than in any step, among steps."""
    moments = [float(time[0]), *(t for foot in feet for t in (*foot.strikes, *foot.toe_offs)), float(time[-1])]
    out = []
    for start, stop in pairwise(sorted(moments)):
        inner = height[(time >= start) & (time <= stop)]
        if len(inner) and min(inner[0], inner[-1]) - inner.min() > CROUCH_M:
            out.append((start, stop))
    return out


def _flights(time: Array, falls: BoolArray, feet: Sequence[FootEvents]) -> Iterator[tuple[float, float]]:
    """Take-off and landing (s) of each flight."""
    for run in runs(falls):
        begin, end = float(time[run.start]), float(time[run.stop - 1])
        if end - begin >= SHORTEST_FLIGHT_S:
            offs = [t for foot in feet for t in foot.toe_offs.tolist() if abs(t - begin) < TOGETHER_S]
            strikes = [t for foot in feet for t in foot.strikes.tolist() if abs(t - end) < TOGETHER_S]
            yield max(offs, default=begin), min(strikes, default=end)


def _phases(
    time: Array, height: Array, ends: tuple[float, float], flights: Sequence[tuple[float, float]], least: float
) -> Iterator[tuple[str, float]]:
    """Name and end (s) of each phase between the `ends` of a repetition; `least`: m, of a turning point."""
    inner = [flight for flight in flights if ends[0] < flight[0] and flight[1] < ends[1]]
    moments = [ends[0], *(t for flight in inner for t in flight), ends[1]]
    for k, (start, stop) in enumerate(pairwise(moments)):
        if k % 2:
            yield "flight", stop
            continue
        frames = np.flatnonzero((time >= start) & (time <= stop))
        h = height[frames]
        over, under = h.max() - max(h[0], h[-1]), min(h[0], h[-1]) - h.min()
        turn = [int(h.argmax() if over > under else h.argmin())] if max(over, under) > least else []
        for a, b in pairwise([0, *turn, len(h) - 1]):
            is_last = b == len(h) - 1
            rising = "push-off" if is_last and k < len(moments) - 2 else "rising"
            lowering = "landing" if a == 0 and k else "lowering"
            yield rising if h[b] > h[a] else lowering, stop if is_last else float(time[frames[b]])
