"""Arrays as text for a page: base64 of small integers or of 32-bit floats; `scripts/1_unpack.js` reads them back."""

from __future__ import annotations

import base64
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

GAP: Final = -32768
"""Where a packed length has no value."""
FULL: Final = 32767
"""Largest integer of a packed length."""


def floats(values: NDArray[Any]) -> str:
    """As 32-bit floats, little-endian."""
    return base64_of(values.astype("<f4"))


def lengths(values: NDArray[Any]) -> dict[str, Any]:
    """Values as 16-bit integers: value = low + step * (integer + 32767); gaps and infinities as `GAP`."""
    known = np.isfinite(values)
    low = float(values[known].min()) if known.any() else 0.0
    high = float(values[known].max()) if known.any() else 0.0
    step = max(high - low, 1e-9) / (2 * FULL)
    packed = np.full(values.shape, GAP, dtype="<i2")
    packed[known] = np.rint((values[known].astype(float) - low) / step) - FULL
    return {"low": low, "step": step, "data": base64_of(packed)}


def base64_of(values: NDArray[Any]) -> str:
    """The bytes of an array, row by row."""
    return base64.b64encode(np.ascontiguousarray(values).tobytes()).decode("ascii")
