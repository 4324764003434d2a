"""Elementary rotations, and the angles of a base segment."""

import numpy as np

from gaitcal.arrays import Array


def make_axis_rotation(axis: int, angle: float) -> Array:
    """Make the right-handed rotation about a coordinate axis.

    Parameters
    ----------
    axis : int
        0, 1 or 2.
    angle : float
        rad.

    Returns
    -------
    (3, 3) array
        The rotation.
    """
    c, s = np.cos(angle), np.sin(angle)
    a, b = (axis + 1) % 3, (axis + 2) % 3
    rotation = np.eye(3)
    rotation[a, a] = rotation[b, b] = c
    rotation[a, b], rotation[b, a] = -s, s
    return rotation


def compute_root_angles(r: Array) -> Array:
    """Compute tilt, list and rotation a, b, c of rotations Rz(a) Rx(b) Ry(c).

    Parameters
    ----------
    r : (..., 3, 3) array
        Rotations.

    Returns
    -------
    (..., 3) array
        Angles, rad.
    """
    angles = (
        np.arctan2(-r[..., 0, 1], r[..., 1, 1]),
        np.arcsin(np.clip(r[..., 2, 1], -1.0, 1.0)),
        np.arctan2(-r[..., 2, 0], r[..., 2, 2]),
    )
    return np.stack(angles, axis=-1)
