"""How many errors lie within their error bars of 68 and 95 %."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array

HALF_WIDTHS = (1.0, 1.96)
"""Of the intervals of 68 and 95 %, in standard errors."""


@dataclass(frozen=True)
class Bars:
    """How many standard errors were tried, and how many intervals of each kind held the truth."""

    count: int = 0
    within: tuple[int, int] = (0, 0)
    """Of 68 and of 95 %."""
    squares: float = 0.0
    """Sum of the squared standard errors, in the unit of the figure; those without count as zero."""

    def __add__(self, other: Bars) -> Bars:
        within = (self.within[0] + other.within[0], self.within[1] + other.within[1])
        return Bars(self.count + other.count, within, self.squares + other.squares)

    @property
    def shares(self) -> tuple[float, float]:
        return 100.0 * self.within[0] / self.count, 100.0 * self.within[1] / self.count

    @property
    def rms(self) -> float:
        return float(np.sqrt(self.squares / self.count))


def bars(errors: Array, standard_errors: Array) -> Bars:
    """Count them; an error without a standard error (NaN) is one whose interval has no width, and holds nothing."""
    errors, widths = np.ravel(errors), np.nan_to_num(np.ravel(standard_errors), nan=0.0)
    first, second = (int((np.abs(errors) < width * widths).sum()) for width in HALF_WIDTHS)
    return Bars(errors.size, (first, second), float((widths**2).sum()))


def shares(z: Array) -> tuple[float, float]:
    """% of errors in standard errors that lie within the intervals of 68 and 95 %."""
    first, second = (100.0 * float(np.mean(np.abs(z) < width)) for width in HALF_WIDTHS)
    return first, second


def coverage(z: Array) -> str:
    first, second = shares(z)
    return f"{first:.0f}% of {len(z)} inside 68 %, {second:.0f}% inside 95 %, RMS {rms(z):.2f} standard errors"


def rms(values: object) -> float:
    return float(np.sqrt(np.nanmean(np.square(np.asarray(values, dtype=float)))))
