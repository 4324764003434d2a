"""Stretches of frames in which something holds, and how they are told."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gaitcal.arrays import Array, BoolArray


def runs(marked: BoolArray, shortest: int = 1) -> list[slice]:
    """Stretches of at least `shortest` marked frames."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], marked, [False]]).astype(np.int8)))
    return [slice(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a >= shortest]


def duration(time: Array, stretch: slice) -> float:
    """Time (s) from the first to the last frame of a stretch."""
    return float(time[stretch.stop - 1] - time[stretch.start])


def spans(time: Array, stretches: Sequence[slice], most: int = 3) -> str:
    """Stretches of frames as times, `0.42-0.58, 1.10-1.12 s`."""
    named = [f"{time[s.start]:.2f}-{time[s.stop - 1]:.2f}" for s in stretches[:most]]
    more = f" and {len(stretches) - most} more" if len(stretches) > most else ""
    return ", ".join(named) + f" s{more}"
