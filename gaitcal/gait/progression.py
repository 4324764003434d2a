"""The line along which a stride goes, how far the body turns in it, and the pelvis against that line.

The line is that from the foot's strike to its next one (`gait/spatiotemporal.py`), pointed to where the pelvis faces,
so that walking backwards is no turn. With its direction theta about the vertical, and R the pelvis in the laboratory,

    Ry(-theta) R = Rz(tilt) Rx(list) Ry(rotation)

are the angles of the pelvis against a laboratory that is turned into the line: the same for any direction in the room.
Because the rotation comes last, tilt and list change, too: a forward tilt in the room is a list of who walks across.
A stride turns by what the pelvis faces otherwise at its end than at its beginning, where gait itself is the same.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from gaitcal.arrays import Array, BoolArray
from gaitcal.motion.motion import Motion

PELVIS_ANGLES: Final = ("pelvis_tilt", "pelvis_list", "pelvis_rotation")
"""About z, x and y, each moved by those before it."""
TURNING: Final = 15.0
"""deg: who turns by more within a stride does not walk straight. From strike to strike of straight walks the pelvis
faces the same to 6 deg (27 strides of eight people)."""
AXES: Final = "ZXY"


def pelvis_angles(motion: Motion) -> Array:
    """(nf, 3) rad, `PELVIS_ANGLES` against the room."""
    out: Array = motion.q[:, [motion.coordinates.index(name) for name in PELVIS_ANGLES]]
    return out


def facing(angles: Array) -> Array:
    """(nf,) rad, unwrapped: where the pelvis points, to the left of the room's x axis.

    `angles`: (nf, 3) rad, `PELVIS_ANGLES`.
    """
    forward = Rotation.from_euler(AXES, angles).as_matrix()[:, :, 0]
    out: Array = np.unwrap(np.arctan2(-forward[:, 2], forward[:, 0]))
    return out


def turn_between(time: Array, faced: Array, start: float, stop: float) -> float:
    """Deg to the left, by which `faced` (nf,) rad turns from `start` to `stop` (s)."""
    begin, end = np.interp([start, stop], time, faced)
    return float(np.degrees(end - begin))


def turns(turn: float | None) -> bool:
    """Whether a stride that turns by so much (deg) is no straight one; one of which it is not known counts as such."""
    return turn is not None and abs(turn) > TURNING


def along_line(angles: Array, line: float, inside: BoolArray) -> Array:
    """(nf, 3) rad, `PELVIS_ANGLES` against a line of progression; NaN where an angle is not known.

    Parameters
    ----------
    angles : (nf, 3) rad, against the room.
    line : rad, direction of progression, to the left of the room's x axis.
    inside : (nf,) frames of the stride; the line is turned about where the pelvis faces backwards in them.
    """
    known = np.isfinite(angles).all(axis=1)
    out = np.full(angles.shape, np.nan)
    if not known.any():
        return out
    within = facing(angles[known])[inside[known]]
    if len(within) and np.cos(float(np.mean(within)) - line) < 0.0:
        line += np.pi
    turned = Rotation.from_euler("y", -line) * Rotation.from_euler(AXES, angles[known])
    out[known] = np.unwrap(turned.as_euler(AXES), axis=0)
    return out
