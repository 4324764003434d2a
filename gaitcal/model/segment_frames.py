"""Segment frames and joint centres of pelvis, legs and trunk in the static posture (laboratory).

Every frame is x anterior, y superior, z to the right. With unit(a) = a / |a| and a - (a.y) y the part of a across y:

    pelvis   origin mid-ASIS; z = unit(R.ASIS - L.ASIS); y across z and the line to the sacrum; x = y x z
    thigh    origin hip centre; y = unit(HJC - KJC), KJC mid-epicondyles; z the epicondylar line across y
    shank    origin KJC; y = unit(KJC - AJC), AJC mid-malleoli; z the malleolar line across y
    foot     origin heel marker; x = unit(toe - heel); z = unit(x x y_shank); y = z x x      (OrthoTrak)
    trunk    origin lumbar joint; y = unit(mid-shoulder - lumbar); z the line of the acromia across y

Without a medial marker the joint centre lies half a joint width inwards of the lateral one along that z, which is the
pelvis's z across y for the knee, and the knee's z turned outwards by the tibial torsion for the ankle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gaitcal.model.chain import axis_rotation
from gaitcal.model.landmarks import HipCentre, StaticPosture, hip_centre, lumbar_joint
from gaitcal.model.linkage import SIDES

Array = NDArray[np.float64]

NOMINAL_HEIGHT = 1.70
"""m; joint widths below are the nominal subject's, between marker centres, and go with height."""
WIDTH = {"knee": 0.1118, "ankle": 0.0852, "elbow": 0.080}
TIBIAL_TORSION = np.deg2rad(5.0)
"""The malleolar line is turned outwards by this much against the epicondylar one."""
SHOULDER_BELOW_ACROMION = 0.17
"""Of the distance between the acromia, along the trunk: Rab, Petuskey and Bagley, Gait & Posture 15 (2002)."""
_SETTLED = 1e-15
_ROUNDS = 200


@dataclass(frozen=True)
class Frame:
    """A segment frame in the laboratory."""

    rotation: Array
    """(3, 3), columns the axes."""
    origin: Array
    """(3,) m."""

    def local(self, point: Array) -> Array:
        """Coordinates (3,) of a point of the laboratory."""
        return self.rotation.T @ (point - self.origin)

    def point(self, local: Array) -> Array:
        """The point of the laboratory with these coordinates."""
        return self.origin + self.rotation @ local


def unit(a: Array) -> Array:
    """A vector's direction."""
    return a / np.linalg.norm(a)


def across(a: Array, y: Array) -> Array:
    """Direction of the part of `a` at right angles to the unit vector `y`."""
    return unit(a - (a @ y) * y)


def frame_yz(origin: Array, y: Array, towards_z: Array) -> Frame:
    """The frame with this y whose z is nearest to a direction."""
    z = across(towards_z, y)
    return Frame(np.column_stack([np.cross(y, z), y, z]), origin)


def half_width(joint: str, height: float) -> float:
    """Distance (m) from a lateral marker's centre to the middle of the joint, for a person of this height (m)."""
    return 0.5 * WIDTH[joint] * height / NOMINAL_HEIGHT


def sign(side: str) -> float:
    """+1 right, -1 left."""
    return 1.0 if side == "r" else -1.0


@dataclass(frozen=True)
class LowerBody:
    """Frames and joint centres of pelvis and legs."""

    frames: dict[str, Frame]
    """Segment -> frame; no talus."""
    centres: dict[str, Array]
    """`hjc_r kjc_r ajc_r` (and `_l`), `lumbar`: (3,) m in the laboratory."""
    notes: tuple[str, ...]


def lower_body(posture: StaticPosture, height: float, rule: HipCentre) -> LowerBody:
    """Frames and centres of pelvis and legs; `height` in m."""
    p = posture.landmarks
    pelvis = _pelvis(p["asis_r"], p["asis_l"], p["sacrum"])
    asis = float(np.linalg.norm(p["asis_r"] - p["asis_l"]))
    frames = {"pelvis": pelvis}
    centres = {"lumbar": pelvis.point(lumbar_joint(asis))}
    notes = [
        f"hip centres by the {rule.value.capitalize()} regression from {1e3 * asis:.0f} mm between the ASIS",
        "lumbar joint as in the nominal subject, scaled by the distance between the ASIS",
    ]
    for side in SIDES:
        hip = pelvis.point(hip_centre(rule, asis, side))
        knee, towards_z = _joint(posture, "knee", side, hip, pelvis.rotation[:, 2], 0.0, height)
        thigh = frame_yz(hip, unit(hip - knee), towards_z)
        torsion = -sign(side) * TIBIAL_TORSION
        ankle, towards_z = _joint(posture, "ankle", side, knee, thigh.rotation[:, 2], torsion, height)
        shank = frame_yz(knee, unit(knee - ankle), towards_z)
        frames |= {
            f"thigh_{side}": thigh,
            f"shank_{side}": shank,
            f"foot_{side}": _foot(p[f"heel_{side}"], p[f"toe_{side}"], shank),
        }
        centres |= {f"hjc_{side}": hip, f"kjc_{side}": knee, f"ajc_{side}": ankle}
    return LowerBody(frames, centres, (*notes, *_width_notes(posture, height)))


def _pelvis(right: Array, left: Array, sacrum: Array) -> Frame:
    middle = 0.5 * (right + left)
    z = unit(right - left)
    y = unit(np.cross(z, middle - sacrum))
    return Frame(np.column_stack([np.cross(y, z), y, z]), middle)


def _joint(
    posture: StaticPosture, joint: str, side: str, above: Array, z_above: Array, turn: float, height: float
) -> tuple[Array, Array]:
    """Joint centre, and the direction its segment's z is taken from."""
    lateral = posture.landmarks[f"{joint}_lat_{side}"]
    s = sign(side)
    if posture.has(f"{joint}_med_{side}"):
        medial = posture.landmarks[f"{joint}_med_{side}"]
        return 0.5 * (lateral + medial), s * (lateral - medial)
    inwards = s * half_width(joint, height)
    centre, z = lateral, z_above
    for _ in range(_ROUNDS):
        before = centre
        y = unit(above - centre)
        plain = frame_yz(centre, y, z_above).rotation
        z = plain @ axis_rotation(1, turn)[:, 2]
        centre = lateral - inwards * z
        if np.abs(centre - before).max() <= _SETTLED * height:
            break
    return centre, z


def _foot(heel: Array, toe: Array, shank: Frame) -> Frame:
    x = unit(toe - heel)
    z = unit(np.cross(x, shank.rotation[:, 1]))
    return Frame(np.column_stack([x, np.cross(z, x), z]), heel)


def _width_notes(posture: StaticPosture, height: float) -> list[str]:
    notes = []
    for joint in ("knee", "ankle"):
        sides = [side for side in SIDES if not posture.has(f"{joint}_med_{side}")]
        if not sides:
            continue
        where = "both sides" if len(sides) == 2 else {"r": "right", "l": "left"}[sides[0]]
        axis = (
            "its axis is the pelvis's lateral direction across the thigh in the static posture"
            if joint == "knee"
            else f"a tibial torsion of {np.rad2deg(TIBIAL_TORSION):.0f} deg is assumed"
        )
        notes.append(
            f"{joint}, {where}: no medial marker; its centre is assumed {1e3 * half_width(joint, height):.1f} mm "
            f"inwards of the lateral marker's, in proportion to height, and {axis}"
        )
    return notes


def trunk(posture: StaticPosture, lumbar: Array) -> tuple[Frame, dict[str, Array]]:
    """Frame of head and trunk, and the shoulder centres `sjc_r`, `sjc_l`, from the acromia."""
    right, left = posture.landmarks["acromion_r"], posture.landmarks["acromion_l"]
    y = unit(0.5 * (right + left) - lumbar)
    down = -SHOULDER_BELOW_ACROMION * float(np.linalg.norm(right - left)) * y
    return frame_yz(lumbar, y, right - left), {"sjc_r": right + down, "sjc_l": left + down}
