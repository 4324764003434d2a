"""The knee alignment device (KAD) of a static trial: where the knee marker would be, and where the knee's axis points.

The device sits on the knee in place of the lateral marker. Its three markers are the ends of three rods of one length L
at right angles to each other, which meet where the marker would be; the rod of the first lies along the flexion axis.
So the three are L sqrt(2) apart, and with their mean c, the unit normal n of their plane and their mean distance d

    corner = c + n d / sqrt(6),      n towards the middle of the body.

(Vicon, Plug-in Gait reference guide; in static trials of two hospitals the corner lies within 0.1 mm of the knee marker
that Vicon's own program computed.)
"""

from __future__ import annotations

import numpy as np

from gaitcal.arrays import Array

EQUAL = 0.15
"""Share by which the distances between the three markers may differ from their mean: real devices are within 0.01, a
triangle of other markers is not equilateral."""
SIZE_M = (0.05, 0.25)
"""m, allowed distance between the three; the usual device has 0.134."""


def corner(axis: Array, second: Array, third: Array, middle: Array) -> Array:
    """(nf, 3) m, where the rods meet: markers (nf, 3) m, that on the axis first; `middle` (nf, 3) m, of the body."""
    a, b = second - axis, third - axis
    normal = np.cross(a, b)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = normal / np.where(length > 0, length, np.nan)
    mean = (axis + second + third) / 3.0
    inwards = np.sign(np.sum(normal * (middle - mean), axis=1, keepdims=True))
    distance = _distances(axis, second, third).mean(axis=1, keepdims=True)
    out: Array = mean + inwards * normal * distance / np.sqrt(6.0)
    return out


def is_device(axis: Array, second: Array, third: Array) -> bool:
    """Whether three markers (nf, 3) m, NaN where not seen, are as far from each other as those of a device."""
    distances = _distances(axis, second, third)
    distances = distances[np.isfinite(distances).all(axis=1)]
    if not len(distances):
        return False
    usual = np.median(distances, axis=0)
    mean = float(usual.mean())
    return bool(SIZE_M[0] <= mean <= SIZE_M[1] and np.abs(usual - mean).max() <= EQUAL * mean)


def _distances(a: Array, b: Array, c: Array) -> Array:
    """(nf, 3) m, between each two of three markers (nf, 3)."""
    return np.stack([np.linalg.norm(x - y, axis=1) for x, y in ((a, b), (a, c), (b, c))], axis=1)
