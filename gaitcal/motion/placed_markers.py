"""Markers in their segments."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from gaitcal.arrays import Array, IntArray


@dataclass(frozen=True)
class PlacedMarkers:
    """Where markers sit in their segments, sorted by segment."""

    segment: IntArray
    """(nm,) index into the chain's segments, not decreasing."""
    local: Array
    """(nm, 3) m, position in the segment frame."""

    @cached_property
    def groups(self) -> list[tuple[int, slice]]:
        """Segments that carry markers, and which."""
        edges = np.flatnonzero(np.diff(self.segment)) + 1
        bounds = [0, *edges.tolist(), len(self.segment)]
        return [(int(self.segment[a]), slice(a, b)) for a, b in pairwise(bounds)] if len(self.segment) else []

    @cached_property
    def extended(self) -> Array:
        """(nm, 4) [l; 1]."""
        return np.concatenate([self.local, np.ones((len(self.local), 1))], axis=1)
