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
"""

from __future__ import annotations

import numpy as np

from gaitcal.arrays import Array
from gaitcal.gait.cycles import GaitCycle
from gaitcal.io.still import runs
from gaitcal.model.subject_model import GRAVITY

STILL, NEAR, FAR = 0.05, 0.1, 0.5
"""Parts of the fastest rate, and of the range of heights."""
FALLING = 0.8
"""Of gravity, by which the pelvis accelerates downwards at the top of a jump, where it rests on nothing."""
LEAST_RANGE_M = 0.05
"""m: a pelvis goes up and down by as much in walking; less is no squat, rise or jump."""
TOGETHER_S = 0.1
"""s between the strikes of both feet of a jump at most; sprinters' steps last 0.2 s."""


def alternate(right: Array, left: Array) -> bool:
    """Whether feet strike in turn (s, of each foot), as of who walks, climbs or runs; not together, as in a jump."""
    if not len(right) or not len(left):
        return False
    apart = np.abs(right[:, None] - left)
    return float(np.median([*apart.min(axis=0), *apart.min(axis=1)])) > TOGETHER_S


def repetitions(time: Array, height: Array) -> tuple[GaitCycle, ...]:
    """The repetitions of a trial, in order of time.

    Parameters
    ----------
    time, height : (nf,) s, m: of the pelvis.
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
    return tuple(GaitCycle(float(time[a]), float(time[b]), None) for a, b in inner)
