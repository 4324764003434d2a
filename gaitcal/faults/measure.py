"""One measure of a standing body against what people have: z = (m - mean) / sd, and J, the sum of all z^2."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Measure:
    """One measure of the landmarks, against what people have."""

    name: str
    """In words: `knee width, right`."""
    value: float
    """mm, or degrees."""
    mean: float
    sd: float
    landmarks: tuple[str, ...]
    """Which it depends on most."""
    unit: str = "mm"
    absolute: bool = False
    """A length against people of that height, and not right against left."""
    postural: bool = False
    """Depends on how the person stands."""

    @property
    def z(self) -> float:
        """Standard deviations from the mean."""
        return (self.value - self.mean) / self.sd

    @property
    def words(self) -> str:
        """What was measured, and what people have."""
        if self.absolute:
            low, high = self.mean - 3 * self.sd, self.mean + 3 * self.sd
            return f"{self.name} {self.value:.0f} {self.unit} (people of this height have {low:.0f} to {high:.0f})"
        return f"{self.name} {self.value:+.0f} {self.unit} (usual within {3 * self.sd:.0f})"


def cost(found: Sequence[Measure]) -> float:
    """J, the sum of squares of all z."""
    return float(sum(m.z**2 for m in found))
