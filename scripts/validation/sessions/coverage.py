"""How many differences lie within their error bars."""

from __future__ import annotations

import numpy as np

from gaitcal.arrays import Array


def coverage(z: Array) -> str:
    """Of differences in standard errors: the part within error bars of 68 and 95 %."""
    within = [float(np.mean(np.abs(z) < limit)) for limit in (1.0, 1.96)]
    rms = np.sqrt(np.mean(z**2))
    return f"{within[0]:.0%} of {len(z)} inside 68 %, {within[1]:.0%} inside 95 %, RMS {rms:.2f} standard errors"
