"""Ground reactions as a force at a point, for files and pictures.

A wrench (F, M) about the laboratory origin becomes a force at the point p and a moment T about p,

    T = M - p x F.

Where the foot is loaded, p is the centre of pressure in the ground plane y = 0, p = (M_z, 0, -M_x) / F_y, and only the
free moment T_y about the vertical remains. Where it is not, p stays where it was in the nearest loaded frame and T
takes what is left, so that the wrench is the same in every frame and no point jumps.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LOADED = 20.0
"""N, vertical: the usual threshold above which a centre of pressure means something."""


def point_and_torque(wrench: Array) -> tuple[Array, Array]:
    """Point of application (nf, 3), m, and moment about it (nf, 3), N·m, of wrenches (nf, 6) about the origin."""
    force, moment = wrench[:, :3], wrench[:, 3:]
    loaded = np.flatnonzero(np.abs(force[:, 1]) >= LOADED)
    point = np.zeros_like(force)
    if len(loaded):
        centre = np.zeros((len(loaded), 3))
        centre[:, 0] = moment[loaded, 2] / force[loaded, 1]
        centre[:, 2] = -moment[loaded, 0] / force[loaded, 1]
        frames = np.arange(len(force))
        after = np.clip(np.searchsorted(loaded, frames), 0, len(loaded) - 1)
        before = np.maximum(after - 1, 0)
        nearer_before = np.abs(loaded[before] - frames) < np.abs(loaded[after] - frames)
        point = centre[np.where(nearer_before, before, after)]
    return point, moment - np.cross(point, force)
