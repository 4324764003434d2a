"""Centres and axes of knee and ankle in the static posture (laboratory), from the best that the trial has.

In order of preference: the middle between the lateral and the medial marker; a knee alignment device, whose rod has the
direction of the knee's axis; neither, and then the direction comes from the segment above: the pelvis's z for the knee,
the knee's z turned outwards by the tibial torsion for the ankle. Without a medial marker the centre C lies h inwards of
the lateral marker M along z, where z is the part of that direction across the line from C to the joint above:

    C = M -+ h z(C),      h = width / 2 + radius of the marker,

the width as measured by hand, else h in proportion to height. For the knee this is the `chord` of Davis et al. 1991.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from gaitcal.arrays import Array
from gaitcal.model.chain import axis_rotation
from gaitcal.model.landmarks import StaticPosture
from gaitcal.model.linkage import SIDES
from gaitcal.model.subject_model import Subject

NOMINAL_HEIGHT = 1.70
"""m; joint widths below are the nominal subject's, between marker centres, and go with height."""
SIDE_WORDS = {"r": "right", "l": "left"}
WIDTH = {"knee": 0.1118, "ankle": 0.0852, "elbow": 0.080}
MARKER_DIAMETER_M = 0.014
"""m, of the markers of most clinics, where nothing tells."""
PLAUSIBLE_WIDTH = (0.5, 1.8)
"""Allowed measured width as a multiple of that in proportion to height; a width outside of it is a slip of the pen."""
TIBIAL_TORSION = np.deg2rad(5.0)
"""The malleolar line is turned outwards by this much against the epicondylar one."""
SETTLED, ROUNDS = 1e-15, 200
"""m or share of height by which a joint centre moves at most in the last round of a fixed-point iteration."""


def half_width(joint: str, height: float) -> float:
    """Distance (m) from a lateral marker's centre to the middle of the joint, for a person of this height (m)."""
    return 0.5 * WIDTH[joint] * height / NOMINAL_HEIGHT


@dataclass(frozen=True)
class JointWidths:
    """How far inwards of their lateral markers knees and ankles have their centres."""

    height: float
    """m."""
    measured: Mapping[tuple[str, str], float] = field(default_factory=dict)
    """(`knee` or `ankle`, side) -> m across the joint."""
    marker_diameter: float | None = None
    """m; None where nobody told."""
    asis_distance: float | None = None
    """m between the ASIS, measured by hand, for the hips (`hip_centre.py`); None where nobody told."""

    @classmethod
    def of(cls, subject: Subject) -> JointWidths:
        """Those of a person."""
        widths = {"knee": subject.knee_width, "ankle": subject.ankle_width}
        measured = {(joint, side): width for joint, by_side in widths.items() for side, width in by_side.items()}
        return cls(subject.height, measured, subject.marker_diameter, subject.asis_distance)

    @property
    def marker_radius(self) -> float:
        """M."""
        return 0.5 * (MARKER_DIAMETER_M if self.marker_diameter is None else self.marker_diameter)

    def is_measured(self, joint: str, side: str) -> bool:
        """Whether there is a measured width that a person can have."""
        width = self.measured.get((joint, side))
        low, high = PLAUSIBLE_WIDTH
        return width is not None and low <= width / (2.0 * half_width(joint, self.height)) <= high

    def inwards(self, joint: str, side: str) -> float:
        """m, from the lateral marker's centre to that of the joint."""
        if self.is_measured(joint, side):
            return 0.5 * self.measured[joint, side] + self.marker_radius
        return half_width(joint, self.height)


def joint_centre(
    posture: StaticPosture, joint: str, side: str, above: Array, z_above: Array, turn: float, widths: JointWidths
) -> tuple[Array, Array]:
    """Joint centre (3,) m, and the direction (3,) its segment's z is taken from, to the right.

    `above`: (3,) m, centre of the joint above; `z_above`: (3,) direction to fall back on, turned by `turn` rad.
    """
    lateral = posture.landmarks[f"{joint}_lat_{side}"]
    s = 1.0 if side == "r" else -1.0
    if posture.has(f"{joint}_med_{side}"):
        medial = posture.landmarks[f"{joint}_med_{side}"]
        return 0.5 * (lateral + medial), s * (lateral - medial)
    if posture.has(f"{joint}_axis_{side}"):
        z_above, turn = s * (posture.landmarks[f"{joint}_axis_{side}"] - lateral), 0.0
    inwards = s * widths.inwards(joint, side)
    centre, z = lateral, z_above
    for _ in range(ROUNDS):
        before = centre
        z = _across(above - centre, z_above) @ axis_rotation(1, turn)[:, 2]
        centre = lateral - inwards * z
        if np.abs(centre - before).max() <= SETTLED * widths.height:
            break
    return centre, z


def _across(y: Array, towards_z: Array) -> Array:
    """(3, 3) axes with this direction of y whose z is nearest to another direction."""
    y = y / np.linalg.norm(y)
    z = towards_z - (towards_z @ y) * y
    z = z / np.linalg.norm(z)
    return np.column_stack([np.cross(y, z), y, z])


def centre_notes(posture: StaticPosture, widths: JointWidths) -> list[str]:
    """How the centres and axes were found that no medial marker shows; a width that no person has."""
    notes: list[str] = []
    for joint in ("knee", "ankle"):
        sides = [side for side in SIDES if not posture.has(f"{joint}_med_{side}")]
        told = {side: (_place(joint, side, widths), _axis(posture, joint, side)) for side in sides}
        for words in dict.fromkeys(told.values()):
            same = [side for side in sides if told[side] == words]
            where = "both sides" if len(same) == 2 else SIDE_WORDS[same[0]]
            notes.append(f"{joint}, {where}: no medial marker; its centre is assumed {words[0]}, and {words[1]}")
    for (joint, side), width in widths.measured.items():
        if not widths.is_measured(joint, side):
            usual = 2e3 * half_width(joint, widths.height)
            notes.append(
                f"{joint}, {SIDE_WORDS[side]}: a width of {1e3 * width:.0f} mm is not used: found, that is, "
                f"{1e3 * width / usual:.1f} times the {usual:.0f} mm of a person of this height; allowed: "
                f"{PLAUSIBLE_WIDTH[0]:g} to {PLAUSIBLE_WIDTH[1]:g} times"
            )
    return notes


def _place(joint: str, side: str, widths: JointWidths) -> str:
    inwards = f"{1e3 * widths.inwards(joint, side):.1f} mm inwards of the lateral marker's"
    if not widths.is_measured(joint, side):
        return f"{inwards}, in proportion to height"
    assumed = "" if widths.marker_diameter is not None else " (assumed: nothing tells it)"
    width, diameter = 1e3 * widths.measured[joint, side], 2e3 * widths.marker_radius
    return f"{inwards}: half of the measured {width:.0f} mm and of the marker's {diameter:.0f} mm{assumed}"


def _axis(posture: StaticPosture, joint: str, side: str) -> str:
    if posture.has(f"{joint}_axis_{side}"):
        return "its axis is that of the knee alignment device, across the thigh"
    if joint == "knee":
        return "its axis is the pelvis's lateral direction across the thigh in the static posture"
    return f"a tibial torsion of {np.rad2deg(TIBIAL_TORSION):.0f} deg is assumed"
