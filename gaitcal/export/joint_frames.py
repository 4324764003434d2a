"""The linkage as other programs see it: segments, and between each two of them one joint with a frame in either.

Each joint of the linkage is a sequence of elementary motions (`gaitcal.model.linkage`): constants, then the
coordinates, then constants. With J the joint frame, the pose of the child in the parent is

    X_parent_child(q) = X_parent_J  M_1(q_1) ... M_n(q_n)  X_J_child,

X_parent_J and X_J_child holding the joint parameters and the ankles' zero angles. Coordinates keep sign and zero.

Rotations are written as three angles: body-fixed x-y-z in OpenSim, R = Rx(a) Ry(b) Rz(c). With a = atan2(-R_12, R_22)
taken off first, Rx(-a) R = Ry(b) Rz(c) gives b and c from well-conditioned pairs, so that the three angles bring R back
to rounding even where a and c are not unique.

Coordinates have ranges that living people stay within, for sliders and documentation; they contain those of Rajagopal
et al. (2016), whose names and signs they have. Nothing enforces them (OpenSim: unclamped; MuJoCo: unlimited), because a
calibrated linkage may pass them and must stay the same mechanical system.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from gaitcal.arrays import Array
from gaitcal.model.chain import axis_rotation
from gaitcal.model.coordinates import COORDINATE_TABLE, TRANSLATION_RANGES, split_side
from gaitcal.model.linkage import COORDINATES, JOINTS, Element, Joint, Source, is_translation, root_elements
from gaitcal.model.parameters import MASSIVE_SEGMENTS, Parameters, table
from gaitcal.model.subject_model import constant_motion

GROUND = "ground"
"""The laboratory: y up, x forward, z right."""


@dataclass(frozen=True, kw_only=True)
class JointFrames:
    """One joint: where it sits in its two segments, and how it moves."""

    name: str
    parent: str
    """A segment, or `ground`."""
    child: str
    in_parent: pin.SE3
    """X_parent_J, constant."""
    motions: tuple[Element, ...]
    """The coordinates in order from parent to child; each along or about an axis of the frame left by those before."""
    to_child: pin.SE3
    """X_J_child, constant."""

    @property
    def in_child(self) -> pin.SE3:
        """X_child_J: where the joint sits in its child."""
        return self.to_child.inverse()


@dataclass(frozen=True)
class SegmentInertia:
    """Mass, mass centre and principal moments, axes parallel to the segment's."""

    mass: float
    """kg; 0 for the talus."""
    centre: Array
    """(3,) m, in the segment frame."""
    moments: Array
    """(3,) kg m^2 about the mass centre."""


def joint_frames(parameters: Parameters) -> tuple[JointFrames, ...]:
    """All 14 joints, that of the pelvis in the laboratory first, each after the joint of its parent."""
    root = Joint("ground_pelvis", GROUND, "pelvis", root_elements("pelvis"))
    return tuple(frames_of(joint, parameters) for joint in (root, *JOINTS))


def frames_of(joint: Joint, parameters: Parameters) -> JointFrames:
    """One joint of the linkage: its constants before the first and after the last coordinate multiplied out."""
    moving = [i for i, e in enumerate(joint.elements) if e.source is Source.COORDINATE]
    first, last = moving[0], moving[-1] + 1
    in_parent, to_child = pin.SE3.Identity(), pin.SE3.Identity()
    for e in joint.elements[:first]:
        in_parent = in_parent * constant_motion(e, parameters)
    for e in joint.elements[last:]:
        to_child = to_child * constant_motion(e, parameters)
    return JointFrames(
        name=joint.name,
        parent=joint.parent,
        child=joint.child,
        in_parent=in_parent,
        motions=joint.elements[first:last],
        to_child=to_child,
    )


def axis_vector(element: Element) -> Array:
    """(3,) unit axis of a coordinate, with its sign."""
    axis = np.zeros(3)
    axis[element.axis] = element.sign
    return axis


def segment_inertia(parameters: Parameters, segment: str) -> SegmentInertia:
    """The inertia of one segment."""
    if segment not in MASSIVE_SEGMENTS:
        return SegmentInertia(0.0, np.zeros(3), np.zeros(3))
    row = table(parameters.inertial)[MASSIVE_SEGMENTS.index(segment)]
    return SegmentInertia(float(row[0]), row[1:4], row[4:7])


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


def _range(coordinate: str) -> tuple[float, float]:
    if is_translation(coordinate):
        return TRANSLATION_RANGES[coordinate]
    low, high = COORDINATE_TABLE[split_side(coordinate)[0]].usual
    return math.radians(low), math.radians(high)


COORDINATE_RANGES: dict[str, tuple[float, float]] = {name: _range(name) for name in COORDINATES}
"""Lowest and highest usual value of every coordinate, m or rad."""
