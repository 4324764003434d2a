"""Peaks of a curve over strides: each stride's own, then their mean and standard deviation.

A stride of which little is valid says nothing of its peak: it counts where at least `LEAST_VALID` of its percents are
valid. Of one stride alone the standard error of its peak stands for the deviation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from gaitcal.arrays import Array

LEAST_VALID: Final = 0.9
"""Part of a stride that must be valid: the peak of a curve that is not seen is not known."""


@dataclass(frozen=True, kw_only=True)
class StridePeaks:
    """The largest values of a curve in the strides of a leg."""

    mean: float
    """Over the strides that count; NaN where none does."""
    error: float
    """Standard deviation over them; of one alone, the standard error of its peak; NaN where it is not known."""
    count: int
    """Strides that count."""
    strides: int
    """All that were looked at."""


def stride_peaks(values: Array, errors: Array) -> StridePeaks:
    """Of the largest value of each stride.

    Parameters
    ----------
    values : (n, points) n strides; NaN where a value is not valid.
    errors : (n, points) standard errors; NaN where not known.
    """
    counting = np.flatnonzero(np.isfinite(values).mean(axis=1) >= LEAST_VALID)
    if not len(counting):
        return StridePeaks(mean=np.nan, error=np.nan, count=0, strides=len(values))
    places = np.nanargmax(values[counting], axis=1)
    peaks, own = values[counting, places], errors[counting, places]
    error = peaks.std(ddof=1) if len(peaks) > 1 else own[0]
    return StridePeaks(mean=float(peaks.mean()), error=float(error), count=len(counting), strides=len(values))
