"""What one trial holds after reading, whatever file it came from.

Frames and units are settled once, on reading: metres, seconds, newtons, newton metres; y up, right-handed.
The turn about the vertical that brings x along the progression is a step of its own (`recording/axes.py`).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ForcePlate:
    """Ground reaction measured by one force plate, as it acts **on the body**.

    The wrench is the force at `point` plus the moment about `point`; where the plate is loaded, `point` is the
    centre of pressure and `moment` the free moment; elsewhere any fixed point with the full moment about it.
    """

    name: str
    """Plate number or name as the study file refers to it: "1", "2", ..."""
    time: Array
    """(ns,) s, on the same clock as the markers; may be denser than the marker frames."""
    force: Array
    """(ns, 3) N."""
    point: Array
    """(ns, 3) m."""
    moment: Array
    """(ns, 3) N·m about `point`."""
    corners: Array | None = None
    """(4, 3) m, or None where the file does not tell."""

    def wrench(self) -> Array:
        """(ns, 6) force and moment about the laboratory origin."""
        return np.hstack([self.force, self.moment + np.cross(self.point, self.force)])


@dataclass(frozen=True)
class Recording:
    """Markers and plate wrenches of one trial."""

    source: str
    """The file it was read from, for messages."""
    time: Array
    """(nf,) s, strictly increasing."""
    labels: tuple[str, ...]
    """Marker names, unique."""
    markers: Array
    """(nf, nm, 3) m; NaN where a marker was not seen."""
    plates: tuple[ForcePlate, ...] = ()
    notes: tuple[str, ...] = field(default=())
    """What was assumed, converted or left out on reading, one sentence each; shown in every output."""

    @property
    def rate(self) -> float:
        """Frames per second (median step)."""
        return float(1.0 / np.median(np.diff(self.time)))

    def with_notes(self, *notes: str) -> Recording:
        """The same recording with more notes."""
        return replace(self, notes=self.notes + notes)
