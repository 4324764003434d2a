"""The arrays of this project, by what they hold. Shapes and units stand beside each field and in
each docstring.
"""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
"""Real numbers."""
BoolArray = NDArray[np.bool_]
"""Yes or no."""
IntArray = NDArray[np.intp]
"""Numbers of frames, markers, ...: indices."""


def compute_rms(values: Array, axis: int | None = None) -> Array:
    """Compute the root mean square of the finite values: the one of all marker residuals.

    Parameters
    ----------
    values
        Any shape and unit; NaN where there is none, as a distance of a marker that is not visible.
    axis
        Axis over which is averaged; all unless given.

    Returns
    -------
    Array
        In the unit of `values`; NaN where no value is finite.
    """
    finite = np.isfinite(values)
    sums = (np.where(finite, values, 0.0) ** 2).sum(axis=axis)
    counts = finite.sum(axis=axis)
    means = np.divide(sums, counts, out=np.full(np.shape(counts), np.nan), where=counts > 0)
    return np.asarray(np.sqrt(means))


def cross(a: Array, b: Array) -> Array:
    """(..., 3) a x b of vectors (..., 3): what `np.cross` gives, which on few vectors is busy with
    the axes' order.
    """
    out = np.empty(np.broadcast_shapes(a.shape, b.shape))
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        out[..., i] = a[..., j] * b[..., k]
        out[..., i] -= a[..., k] * b[..., j]
    return out


def stretches(count: int, most: int) -> list[slice]:
    """`count` frames in stretches of nearly equal length, the fewest of at most `most` frames."""
    parts = -(-count // most)
    return [
        slice(start, stop)
        for start, stop in pairwise(count * k // max(parts, 1) for k in range(parts + 1))
    ]
