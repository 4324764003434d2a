"""Stretches of frames in which something holds, as slices and as words; the gaps of each marker."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.io.recording import Recording, seen_mask


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


@dataclass(frozen=True)
class MarkerGaps:
    """The gaps of one marker."""

    label: str
    seen: float
    """Share of the frames in which it was seen, 0 to 1."""
    longest_gap: float
    """s from the last frame before to the first frame after the longest gap; at an end of the trial, to that end."""


def marker_gaps(recording: Recording) -> tuple[MarkerGaps, ...]:
    """One entry for each marker, in the order of the labels."""
    seen = seen_mask(recording.markers)
    time = recording.time
    gaps = []
    for index, label in enumerate(recording.labels):
        frames = np.flatnonzero(seen[:, index])
        if len(frames) == 0:
            longest = float(time[-1] - time[0])
        else:
            last = np.flatnonzero(np.diff(frames) > 1)
            between = (time[frames[last + 1]] - time[frames[last]]).max(initial=0.0)
            longest = float(max(between, time[frames[0]] - time[0], time[-1] - time[frames[-1]]))
        gaps.append(MarkerGaps(label, float(len(frames) / len(time)), longest))
    return tuple(gaps)
