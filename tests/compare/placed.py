"""What markers put on anew do, written out by hand."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gaitcal.compare.parameter_differences import placement

HIPS = ("hip_r.pelvis.ant", "hip_r.thigh.ant")


def placed_anew(names: Sequence[str]) -> NDArray[np.float64]:
    """(n, n) Q: each parameter by itself, but for the two views of the hip, which move by the same."""
    out = np.diag(placement(names) ** 2)
    one, other = (names.index(name) for name in HIPS)
    out[one, other] = out[other, one] = out[one, one]
    return out
