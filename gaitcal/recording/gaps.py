"""How completely each marker was seen. Gaps are told, weighed with zero later, and never filled."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from gaitcal.recording.recording import Recording, seen_mask


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
    found = []
    for index, label in enumerate(recording.labels):
        frames = np.flatnonzero(seen[:, index])
        if len(frames) == 0:
            longest = float(time[-1] - time[0])
        else:
            between = [float(time[b] - time[a]) for a, b in pairwise(frames) if b - a > 1]
            ends = [float(time[frames[0]] - time[0]), float(time[-1] - time[frames[-1]])]
            longest = max(between + ends)
        found.append(MarkerGaps(label, float(len(frames) / len(time)), longest))
    return tuple(found)
