"""Strikes and offs of a foot from its motion alone: when the slower of its two ends comes to rest, and when it leaves.

    s(t) = min(|v_heel|, |v_toe|)        against the ground, so that a treadmill's belt counts as the floor
    a swing is a peak p of s;  off: s rises through OFF p before it;  strike: s falls through STRIKE p after it

The speed of heel and toe (Ghoussayni, Stevens, Durham & Ewins, Gait & Posture 2004), with thresholds that follow how
fast this swing is (Bruening & Ridge, Gait & Posture 2014, took the walking speed), holds for any direction of walking,
in turns and from one step to the next. The slower end is the one on the ground, so that a foot which lands on its toes
is seen, too. Where the heel is furthest in front of the pelvis (Zeni, Richards & Higginson 2008) it still travels at
the pelvis' own speed: 20 to 60 ms before the contact.

Both thresholds lie where vertical forces pass 20 N, as the median of laboratories has it
(`python -m scripts.validation events`).
A foot that drags slides on before and after its contact: the strike then comes late, and the off early.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from gaitcal.arrays import Array, BoolArray

STRIKE: Final = 0.10
"""Of the swing's peak."""
OFF: Final = 0.25
"""Of the swing's peak."""
SLOWEST_SWING: Final = 0.25
"""m/s: a foot that is never faster does not swing."""
SMALLEST_SWING: Final = 0.12
"""Of the trial's fastest swing: a lower peak is a shuffle on the spot."""
DIP: Final = 0.7
"""Of the peak, by which the speed falls on both sides of a swing: less is a dip within one swing."""
LEAST_TRAVEL: Final = 0.1
"""m that the slower end of the foot travels in a swing: less is no step."""


def swing_events(time: Array, slower: Array, strike: float = STRIKE, off: float = OFF) -> tuple[Array, Array]:
    """Strikes and offs (s, increasing) of one foot, between frames by a straight line.

    Parameters
    ----------
    time : (nf,) s.
    slower : (nf,) m/s, speed of heel or toe against the ground, whichever is the slower.
    strike, off : thresholds, as parts of a swing's peak.
    """
    if len(time) < 3 or not np.isfinite(slower).all():
        return np.array([]), np.array([])
    padded = np.concatenate([[0.0], slower, [0.0]])
    least = max(SLOWEST_SWING, SMALLEST_SWING * float(slower.max()))
    peaks = np.array([k - 1 for k in _peaks(padded, least) if _alone(padded, int(k))], dtype=np.int64)
    inner = [float(slower[k]) for k in peaks if 0 < k < len(time) - 1]
    strikes, offs = [], []
    for k in peaks:
        # A swing that the trial cuts has its peak outside: the others tell how fast it was.
        cut = k in (0, len(time) - 1)
        peak = max(float(slower[k]), float(np.median(inner))) if cut and inner else float(slower[k])
        begin, end = _below(slower, int(k), off * peak, -1), _below(slower, int(k), strike * peak, 1)
        path = slower[slice((begin or 0), (len(time) if end is None else end + 1))]
        if not cut and float(path.sum()) * float(np.median(np.diff(time))) < LEAST_TRAVEL:
            continue
        if end is not None:
            strikes.append(_crossing(time, slower, end - 1, strike * peak))
        if begin is not None:
            offs.append(_crossing(time, slower, begin, off * peak))
    return np.unique(strikes), np.unique(offs)


def _peaks(values: Array, least: float) -> Array:
    """Samples of at least that height that are higher than those beside them; of a flat top the middle one."""
    turns = np.flatnonzero(np.diff(values))  # the last sample of each flat stretch, whose length is mostly one
    starts = np.concatenate([[0], turns + 1])
    ends = np.concatenate([turns, [len(values) - 1]])
    height = values[starts]
    top = np.zeros(len(height), dtype=bool)
    top[1:-1] = (height[1:-1] > height[:-2]) & (height[1:-1] > height[2:])
    out: Array = ((starts + ends) // 2)[top & (height >= least)]
    return out


def _alone(speed: Array, peak: int) -> bool:
    """Whether no higher peak follows or precedes before the speed has fallen by `DIP`; of equals, the first counts."""
    low = (1.0 - DIP) * speed[peak]
    before = speed[:peak][::-1]
    after = speed[peak + 1 :]
    higher_before = _first(before >= speed[peak])
    higher_after = _first(after > speed[peak])
    return _first(before < low) < higher_before and _first(after < low) < higher_after


def _first(marked: BoolArray) -> int:
    """The first marked entry; the length where there is none."""
    return int(np.argmax(marked)) if marked.any() else len(marked)


def _below(speed: Array, start: int, threshold: float, step: int) -> int | None:
    """The first frame after `start`, forwards or backwards, that is slower than the threshold; None without one."""
    along = speed[start:] if step > 0 else speed[start::-1]
    k = _first(along < threshold)
    return None if k in (0, len(along)) else start + step * k


def _crossing(time: Array, speed: Array, before: int, threshold: float) -> float:
    """When the speed passes the threshold, between the frame `before` and the next one."""
    a, b = float(speed[before]), float(speed[before + 1])
    part = 0.0 if a == b else float(np.clip((threshold - a) / (b - a), 0.0, 1.0))
    return float(time[before] + part * (time[before + 1] - time[before]))
