"""Segment frames and joint centres of pelvis and legs in the static posture (laboratory).

Every frame is x anterior, y superior, z to the right. With unit(a) = a / |a| and a - (a.y) y the part of a across y:

    pelvis   origin mid-ASIS; z = unit(R.ASIS - L.ASIS); y across z and the line to the sacrum; x = y x z
    thigh    origin hip centre; y = unit(HJC - KJC), KJC mid-epicondyles; z the epicondylar line across y
    shank    origin KJC; y = unit(KJC - AJC), AJC mid-malleoli; z the malleolar line across y
    foot     origin heel marker; x = unit(toe - heel); z = unit(x x y_shank); y = z x x      (OrthoTrak)

Knee and ankle without a medial marker: `model/knee_and_ankle.py`.

Hip centres are those of `hip_centre.py`; the lumbar one is the nominal subject's, scaled by the distance between the
two ASIS.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array, cross
from gaitcal.model.joint_centres import (
    TIBIAL_TORSION,
    HipCentre,
    JointWidths,
    PelvicWidth,
    centre_notes,
    given_hips,
    given_note,
    hip_centre,
    joint_centre,
    offer_note,
    regression_note,
)
from gaitcal.model.landmarks import StaticPosture
from gaitcal.model.linkage import SIDES

_NOMINAL_ASIS = 0.245
"""m, of the nominal subject."""
_NOMINAL_LUMBAR = (-0.095, 0.077, 0.0)
"""m in its pelvis frame: about the third lumbar vertebra, as in Anderson and Pandy 1999."""


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
    return Frame(np.column_stack([cross(y, z), y, z]), origin)


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


def lower_body(
    posture: StaticPosture, height: float, rule: HipCentre, *, widths: JointWidths | None = None
) -> LowerBody:
    """Frames and centres of pelvis and legs; `height` in m; `widths` as measured, else in proportion to it."""
    widths = widths or JointWidths(height)
    p = posture.landmarks
    pelvis = _pelvis(p["asis_r"], p["asis_l"], p["sacrum"])
    asis = float(np.linalg.norm(p["asis_r"] - p["asis_l"]))
    frames = {"pelvis": pelvis}
    centres = {"lumbar": pelvis.point(lumbar_joint(asis))}
    hips, notes = _hips(posture, pelvis, rule, PelvicWidth(asis, widths.asis_distance))
    notes.append("lumbar joint as in the nominal subject, scaled by the distance between the ASIS")
    for side in SIDES:
        hip = hips[side]
        knee, towards_z = joint_centre(posture, "knee", side, hip, pelvis.rotation[:, 2], 0.0, widths)
        thigh = frame_yz(hip, unit(hip - knee), towards_z)
        torsion = -sign(side) * TIBIAL_TORSION
        ankle, towards_z = joint_centre(posture, "ankle", side, knee, thigh.rotation[:, 2], torsion, widths)
        shank = frame_yz(knee, unit(knee - ankle), towards_z)
        frames |= {
            f"thigh_{side}": thigh,
            f"shank_{side}": shank,
            f"foot_{side}": _foot(p[f"heel_{side}"], p[f"toe_{side}"], shank),
        }
        centres |= {f"hjc_{side}": hip, f"kjc_{side}": knee, f"ajc_{side}": ankle}
    return LowerBody(frames, centres, (*notes, *centre_notes(posture, widths)))


def _hips(
    posture: StaticPosture, pelvis: Frame, rule: HipCentre, width: PelvicWidth
) -> tuple[Mapping[str, Array], list[str]]:
    """Side -> hip centre (3,) m in the laboratory, and where it is from."""
    depth = float(np.linalg.norm(pelvis.origin - posture.landmarks["sacrum"]))

    def by(regression: HipCentre) -> dict[str, Array]:
        return {side: pelvis.point(hip_centre(regression, width.of(regression), depth, side)) for side in SIDES}

    if rule is HipCentre.GIVEN:
        usual = by(HipCentre.HARRINGTON)
        return given_hips(posture, usual, width.markers), [given_note(posture, usual)]
    hips = by(rule)
    return hips, [regression_note(rule, width, depth), *offer_note(posture, hips)]


def lumbar_joint(asis_distance: float) -> Array:
    """(3,) m, lumbar joint in the pelvis frame: the nominal subject's, scaled alike in all directions by the ASIS."""
    return np.array(_NOMINAL_LUMBAR) * (asis_distance / _NOMINAL_ASIS)


def _pelvis(right: Array, left: Array, sacrum: Array) -> Frame:
    middle = 0.5 * (right + left)
    z = unit(right - left)
    y = unit(cross(z, middle - sacrum))
    return Frame(np.column_stack([cross(y, z), y, z]), middle)


def _foot(heel: Array, toe: Array, shank: Frame) -> Frame:
    x = unit(toe - heel)
    z = unit(cross(x, shank.rotation[:, 1]))
    return Frame(np.column_stack([x, cross(z, x), z]), heel)
