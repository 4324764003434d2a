"""How many spline nodes a trial gets where no penalty smooths it, and what passes such a spline."""

from __future__ import annotations

from dataclasses import dataclass

from gaitcal.arrays import Array
from gaitcal.motion.spline import MINIMUM_NODES

NODES_PER_SECOND = 20.0
"""Knot spans per second of a trial that no penalty smooths: a quintic spline with spans h passes frequencies up to
about 0.48 / h (see `cutoff`).
"""
FRAMES_PER_SPAN = 3.0
"""Least number of frames for one span; slow cameras get longer spans."""


@dataclass(frozen=True)
class NodeRule:
    """How many spline nodes a trial gets."""

    per_second: float = NODES_PER_SECOND
    fixed: int | None = None
    """A fixed number of nodes a coordinate (20 in the published protocol), whatever the length."""

    def nodes(self, time: Array) -> int:
        """Number of nodes for frames at `time` (s)."""
        if self.fixed is not None:
            return self.fixed
        spans = min(float(time[-1] - time[0]) * self.per_second, len(time) / FRAMES_PER_SPAN)
        return max(round(spans), 1) + MINIMUM_NODES - 1


def cutoff(time: Array, nodes: int) -> float:
    """Hz at which a least-squares quintic spline passes 71 % (-3 dB) of an oscillation.

    For spans h the amplitude kept at frequency f is 1 / (1 + sum_k (f h / (f h + k))^12), k = -1, 1, -2, ...
    (Unser, Aldroubi and Eden 1993): 0.4816 / h.
    """
    return 0.4816 * (nodes - MINIMUM_NODES + 1) / float(time[-1] - time[0])
