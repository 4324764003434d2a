"""Feet beside their force plate: a part of the ground reaction that no plate measures.

Told by geometry alone, never by the forces: where an end of a foot rests on the floor, outside the outlines of all
plates that carry the foot, the measured force is only a part of the true one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gaitcal.arrays import Array
from gaitcal.io.force_plate import OUTSIDE_M
from gaitcal.io.recording import ForcePlate

FOOT_LENGTH = 0.152
"""Of body height (Winter 2009): the tip of the foot lies this far before the heel marker, or at the toe marker."""
OUTSIDE_SHARE = 0.1
"""Of the load, with its centre of pressure outside the corners, above which the corners are not believed."""


def foot_tip(heel: Array, toe: Array, height: float) -> Array:
    """(..., 3) m, the tip of the foot of a person of this height (m), on the line from heel to toe marker (..., 3)."""
    along = toe - heel
    length = np.maximum(np.linalg.norm(along, axis=-1, keepdims=True), 1e-9)
    out: Array = heel + along / length * np.maximum(length, FOOT_LENGTH * height)
    return out


def inside(corners: Array, point: Array) -> Array:
    """(n,) m, how far points (n, 3) lie inside the horizontal outline of corners (4, 3); negative outside."""
    outline = corners[:, [0, 2]]
    middle = outline.mean(axis=0)
    nearest = np.full(len(point), np.inf)
    for a, b in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        along = (b - a) / np.linalg.norm(b - a)
        normal = np.array([-along[1], along[0]])
        if normal @ (middle - a) < 0:
            normal = -normal
        nearest = np.minimum(nearest, (point[:, [0, 2]] - a) @ normal)
    return nearest


def share_outside(plate: ForcePlate, corners: Array, load: float) -> tuple[float, float]:
    """Share of the load (where over `load` N) whose centre of pressure is outside the corners; farthest, m."""
    pressed = np.nan_to_num(plate.force[:, 1]) > load
    if not pressed.any():
        return 0.0, 0.0
    away = -inside(corners, plate.point[pressed])
    return float(np.average(away > OUTSIDE_M, weights=plate.force[pressed, 1])), float(away.max())


def outline_known(plate: ForcePlate, load: float) -> bool:
    """Whether a plate has corners, and its own centre of pressure keeps to them."""
    return plate.corners is not None and share_outside(plate, plate.corners, load)[0] <= OUTSIDE_SHARE


def outside(plates: Sequence[ForcePlate], point: Array) -> Array:
    """(n,) m, how far points (n, 3) lie outside every one of these plates; not positive on one of them."""
    depths = [inside(plate.corners, point) for plate in plates if plate.corners is not None]
    out: Array = -np.max(depths, axis=0)
    return out
