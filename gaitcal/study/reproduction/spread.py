"""A figure over noise seeds: median and range, and where the published figure lies.

The published study drew its noise once. One draw can only be compared with the range of draws.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Spread:
    """A figure over the draws of the noise."""

    median: float
    low: float
    high: float
    draws: int

    def place(self, published: float) -> str:
        """`inside`, `below` or `above` the range."""
        if published < self.low:
            return "below"
        return "above" if published > self.high else "inside"

    def told(self, published: float | None = None) -> str:
        """In words, for the note of a row."""
        words = f"median of {self.draws} noise draws, range {self.low:.3g} to {self.high:.3g}"
        return words if published is None else f"{words}; published value {self.place(published)} the range"


def spread(values: Iterable[float]) -> Spread:
    """Median and range of at least one figure."""
    array = np.array(list(values), dtype=float)
    return Spread(float(np.median(array)), float(array.min()), float(array.max()), len(array))
