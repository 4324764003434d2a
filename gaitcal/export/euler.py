"""Rotations as the three angles that OpenSim and URDF write.

Body-fixed x-y-z: R = Rx(a) Ry(b) Rz(c). With a = atan2(-R_12, R_22) taken off first, Rx(-a) R = Ry(b) Rz(c) gives b
and c from well-conditioned pairs, so the three angles bring R back to rounding even where a and c are not unique.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gaitcal.model.chain import axis_rotation

Array = NDArray[np.float64]


def body_fixed_xyz(rotation: Array) -> Array:
    """(3,) rad: a, b, c of R = Rx(a) Ry(b) Rz(c), as in OpenSim's `orientation`."""
    a = np.arctan2(-rotation[1, 2], rotation[2, 2])
    rest = axis_rotation(0, -float(a)) @ rotation
    return np.array([a, np.arctan2(rest[0, 2], rest[2, 2]), np.arctan2(rest[1, 0], rest[1, 1])])


def space_fixed_xyz(rotation: Array) -> Array:
    """(3,) rad: roll, pitch, yaw of R = Rz(yaw) Ry(pitch) Rx(roll), as in URDF's `rpy`."""
    return -body_fixed_xyz(rotation.T)


def from_body_fixed_xyz(angles: Array) -> Array:
    """(3, 3) rotation Rx(a) Ry(b) Rz(c)."""
    a, b, c = (float(angle) for angle in angles)
    rotation: Array = axis_rotation(0, a) @ axis_rotation(1, b) @ axis_rotation(2, c)
    return rotation
