"""The knee alignment device (KAD) of a static trial: where the knee marker would be, and where the knee's axis points.

The device sits on the knee in place of the lateral marker. Its three markers are the ends of three rods of one length L
at right angles to each other, which meet where the marker would be; the rod of the first lies along the flexion axis.
So the three are L sqrt(2) apart, and with their mean c, the unit normal n of their plane and their mean distance d

    corner = c + n d / sqrt(6),      n towards the other knee.

The rods stand at 55 deg to n: it points inwards along the line between the two ASIS as far as the knee's axis does. The
way to the middle of the pelvis would not do, as it is mostly vertical.

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


def corner(
    axis: Array, second: Array, third: Array, inwards: Array | None = None, modelled: Array | None = None
) -> Array | None:
    """(nf, 3) m, where the rods meet: markers (nf, 3) m, that on the axis first; None where nothing tells its side.

    Which side of the three is the same in all frames: the device is rigid.

    Parameters
    ----------
    inwards : (nf, 3) some length, towards the other knee; None: not known.
    modelled : (nf, 3) m, where another program has the corner, which is believed about the side.
    """
    a, b = second - axis, third - axis
    normal = np.cross(a, b)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = normal / np.where(length > 0, length, np.nan)
    mean = (axis + second + third) / 3.0
    distance = _distances(axis, second, third).mean(axis=1, keepdims=True)
    for towards in (None if modelled is None else modelled - mean, inwards):
        if towards is not None:
            along = np.sum(normal * towards, axis=1)
            if np.isfinite(along).any():
                out: Array = mean + np.sign(np.nanmedian(along)) * normal * distance / np.sqrt(6.0)
                return out
    return None


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
