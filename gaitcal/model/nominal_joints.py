"""The nominal joint parameters of one person from segment frames in the static posture.

Positions are the coordinates of the joint centre in the two segments that the joint connects, but for the subtalar one.
A hinge (knee, elbow) lies along the proximal segment's z axis through the joint centre: A_proximal = 1, and with its
direction a in the distal frame, A_distal = Rx(front) Ry(trans) has trans = asin(a_x), front = atan2(-a_y, a_z).

Ankle. With A = Rx(front) the talocrural axis in the shank, B = Ry(trans) Rz(sag) the subtalar one in the foot and R
the static orientation of the foot in the shank, the chain A Rz(alpha) Ry(t) Rx(beta) B^-1 = R gives

    M = A^T R B:   t = -asin(M_zx) = talus.trans,   alpha = atan2(M_yx, M_xx),   beta = atan2(M_zy, M_zz).

The zero angles are alpha - delta and beta, delta the dorsiflexion of the static posture (`ankle_zero.py`): zero ankle
angle is the foot at right angles to the shank. The subtalar point of the foot closes the chain. So the static foot
pose is met exactly, whatever the person's feet are.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array
from gaitcal.model.chain import axis_rotation
from gaitcal.model.coordinates import JOINT_TABLE, split_side
from gaitcal.model.linkage import JOINTS, SIDES, ZERO_ANGLES
from gaitcal.model.parameters import JOINT_PARAMETERS, JP_INDEX, Kind
from gaitcal.model.segment_frames import Frame, sign

TALOCRURAL_FRONT = np.deg2rad(7.3)
"""90 - 82.7 deg, Inman 1976."""
SUBTALAR_TRANS, SUBTALAR_SAG = np.deg2rad(23.0), np.deg2rad(42.0)
"""Inman 1976."""
SUBTALAR_BELOW = 0.010
"""m below the talocrural axis, along the talus's y."""
_ROUNDING = 1e-13
"""m or rad: below it a coordinate is zero by construction, and is told as zero."""


CENTRE_OF: dict[str, str] = {
    joint.name: centre + (f"_{side}" if side else "")
    for joint in JOINTS
    for kind, side in (split_side(joint.name),)
    if (centre := JOINT_TABLE[kind].centre)
}
"""Joint -> landmark that is its centre."""


@dataclass(frozen=True)
class ArmJoints:
    """What the arms' frames alone do not tell of their joints."""

    shoulder_turn: dict[str, float]
    """Side -> `shoulder.upperarm.trans`, rad."""
    elbow_axis: dict[str, Array]
    """Side -> (3,) direction in the laboratory of the elbow's axis as the forearm has it."""


def nominal_joint_parameters(
    frames: dict[str, Frame], centres: dict[str, Array], arms: ArmJoints, dorsiflexion: Mapping[str, float]
) -> tuple[Array, Array]:
    """Joint parameters (np,) and zero angles (nz,), m and rad.

    Parameters
    ----------
    frames : all segments but the tali.
    centres : `lumbar`, and for each side `hjc kjc ajc sjc ejc`, (3,) m in the laboratory.
    arms : turn of the shoulders, axes of the elbows.
    dorsiflexion : side -> rad, ankle angle of the static posture.
    """
    joint, zero = np.zeros(len(JP_INDEX)), np.zeros(len(ZERO_ANGLES))
    for i, p in enumerate(JOINT_PARAMETERS):
        if p.kind is Kind.POSITION and p.joint in CENTRE_OF:
            joint[i] = frames[p.segment].local(centres[CENTRE_OF[p.joint]])[p.axis]

    def hinge(prefix: str, segment: str, axis: Array) -> None:
        a = frames[segment].rotation.T @ axis
        joint[JP_INDEX[f"{prefix}.front"]] = np.arctan2(-a[1], a[2])
        joint[JP_INDEX[f"{prefix}.trans"]] = np.arcsin(np.clip(a[0], -1.0, 1.0))

    for side in SIDES:
        hinge(f"knee_{side}.shank", f"shank_{side}", frames[f"thigh_{side}"].rotation[:, 2])
        joint[JP_INDEX[f"shoulder_{side}.upperarm.trans"]] = arms.shoulder_turn[side]
        hinge(f"elbow_{side}.forearm", f"forearm_hand_{side}", arms.elbow_axis[side])
        shank, foot = frames[f"shank_{side}"], frames[f"foot_{side}"]
        _ankle(joint, zero, side, shank, foot, centres[f"ajc_{side}"], dorsiflexion[side])
    joint[np.abs(joint) < _ROUNDING] = 0.0
    return joint, zero


def _ankle(joint: Array, zero: Array, side: str, shank: Frame, foot: Frame, centre: Array, dorsiflexion: float) -> None:
    """Fill in both joints of one ankle, whose talocrural `centre` is (3,) m in the laboratory."""
    s = sign(side)
    a = axis_rotation(0, s * TALOCRURAL_FRONT)
    b = axis_rotation(1, s * SUBTALAR_TRANS) @ axis_rotation(2, SUBTALAR_SAG)
    static = shank.rotation.T @ foot.rotation
    m = a.T @ static @ b
    talus_trans = -float(np.arcsin(np.clip(m[2, 0], -1.0, 1.0)))
    alpha, beta = np.arctan2(m[1, 0], m[0, 0]), np.arctan2(m[2, 1], m[2, 2])
    talus = shank.rotation @ a @ axis_rotation(2, float(alpha))
    subtalar = foot.local(centre - SUBTALAR_BELOW * talus[:, 1])
    values = {
        f"talocrural_{side}.shank.front": s * TALOCRURAL_FRONT,
        f"subtalar_{side}.talus.trans": talus_trans,
        f"subtalar_{side}.talus.sup": -SUBTALAR_BELOW,
        f"subtalar_{side}.foot.trans": s * SUBTALAR_TRANS,
        f"subtalar_{side}.foot.sag": SUBTALAR_SAG,
        f"subtalar_{side}.foot.ant": subtalar[0],
        f"subtalar_{side}.foot.sup": subtalar[1],
        f"subtalar_{side}.foot.lat": subtalar[2],
    }
    for name, value in values.items():
        joint[JP_INDEX[name]] = value
    zero[ZERO_ANGLES.index(f"talocrural_{side}.zero")] = alpha - dorsiflexion
    zero[ZERO_ANGLES.index(f"subtalar_{side}.zero")] = beta
