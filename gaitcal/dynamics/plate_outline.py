"""Tip of the foot, and distances of points from the outlines of force plates."""

from collections.abc import Sequence

import numpy as np

from gaitcal.arrays import Array
from gaitcal.io.force_plate import OUTSIDE_M
from gaitcal.io.recording import ForcePlate

FOOT_LENGTH = 0.152
"""Share of body height (Winter 2009) from the heel marker to the tip of the foot, which is at least
at the toe marker."""
MAX_OUTSIDE_SHARE = 0.1
"""Share of the load with its centre of pressure outside the corners, above which the corners are
not used.
"""


def compute_foot_tip(heel: Array, toe: Array, height: float) -> Array:
    """Compute the tip of the foot, on the line from heel to toe marker.

    Parameters
    ----------
    heel, toe
        (..., 3) m, markers.
    height
        m, of the person.

    Returns
    -------
    (..., 3) array
        m.
    """
    along = toe - heel
    length = np.maximum(np.linalg.norm(along, axis=-1, keepdims=True), 1e-9)
    return heel + along / length * np.maximum(length, FOOT_LENGTH * height)


def compute_depth_inside(corners: Array, point: Array) -> Array:
    """Compute the distance (n,) m of points (n, 3) inside the outline of corners (4, 3).

    Horizontal; negative outside.
    """
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


def compute_share_outside(plate: ForcePlate, corners: Array, load: float) -> tuple[float, float]:
    """Compute the share of the load whose centre of pressure is outside the corners.

    Parameters
    ----------
    plate
        Force plate.
    corners
        (4, 3) m.
    load
        N, vertical force from which a frame counts.

    Returns
    -------
    tuple of float
        Share, and largest distance outside, m.
    """
    pressed = np.nan_to_num(plate.force[:, 1]) > load
    if not pressed.any():
        return 0.0, 0.0
    away = -compute_depth_inside(corners, plate.point[pressed])
    return float(np.average(away > OUTSIDE_M, weights=plate.force[pressed, 1])), float(away.max())


def has_known_outline(plate: ForcePlate, load: float) -> bool:
    """Check that a plate has corners, and that its centre of pressure stays within them."""
    return (
        plate.corners is not None
        and compute_share_outside(plate, plate.corners, load)[0] <= MAX_OUTSIDE_SHARE
    )


def compute_distance_outside(plates: Sequence[ForcePlate], point: Array) -> Array:
    """Compute the distance (n,) m of points (n, 3) from the nearest of these plates.

    Not positive on one of them.
    """
    depths = [
        compute_depth_inside(plate.corners, point) for plate in plates if plate.corners is not None
    ]
    return -np.max(depths, axis=0)
