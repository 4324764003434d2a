"""An OpenSim model as far as comparing joint axes needs it: bodies, joints, markers; read from the XML alone.

Files of OpenSim 3 keep each joint inside its child body, those of OpenSim 4 in a `JointSet` with offset frames; both
come out as the same `PeerJoint`. With P and C the offset frames in parent and child body,

    X_parent_child(q) = P  Tr(translation(q)) R_1(q) R_2(q) R_3(q)  C^-1.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from gaitcal.errors import InputError
from gaitcal.export.peer_functions import Function

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PeerCoordinate:
    """One coordinate."""

    name: str
    default: float
    """rad or m."""
    low: float
    high: float
    locked: bool


@dataclass(frozen=True)
class PeerAxis:
    """One of up to six elementary motions of a joint."""

    rotates: bool
    axis: Array
    """(3,) unit vector."""
    coordinate: str | None
    function: Function


@dataclass(frozen=True)
class PeerJoint:
    """A joint between two bodies."""

    name: str
    kind: str
    """Tag of the element: CustomJoint, PinJoint, ..."""
    parent: str
    child: str
    in_parent: pin.SE3
    in_child: pin.SE3
    coordinates: tuple[PeerCoordinate, ...]
    axes: tuple[PeerAxis, ...] | None
    """None for a kind of joint that is not understood; an error only where its motion is asked for."""


@dataclass(frozen=True)
class PeerModel:
    """What was read."""

    source: str
    masses: dict[str, float]
    """Body -> kg, in the order of the file."""
    joints: dict[str, PeerJoint]
    """By child body."""
    markers: dict[str, tuple[str, Array]]
    """Label -> body and position (3,) m in it."""

    def joint_of(self, coordinate: str) -> PeerJoint | None:
        """The joint that has a coordinate of this name."""
        found = (j for j in self.joints.values() if any(c.name == coordinate for c in j.coordinates))
        return next(found, None)

    def joint_pose(self, joint: PeerJoint, values: Mapping[str, float]) -> pin.SE3:
        """Pose of the child in the parent; coordinates not in `values` are zero, or at their default if locked."""
        if joint.axes is None:
            raise InputError(f"a {joint.kind} is not understood", source=self.source, field=f"joint {joint.name}")
        used = {c.name: c.default if c.locked else 0.0 for c in joint.coordinates} | dict(values)
        motion = pin.SE3.Identity()
        for axis in sorted(joint.axes, key=lambda a: a.rotates):
            amount = axis.function(used.get(axis.coordinate, 0.0) if axis.coordinate is not None else 0.0)
            if axis.rotates:
                motion = motion * pin.SE3(pin.exp3(amount * axis.axis), np.zeros(3))
            else:
                motion = motion * pin.SE3(np.eye(3), amount * axis.axis)
        return joint.in_parent * motion * joint.in_child.inverse()

    def body_pose(self, body: str, ancestor: str) -> pin.SE3:
        """Pose of a body in the frame of one of its ancestors, all coordinates zero (locked ones at their default)."""
        pose, at, steps = pin.SE3.Identity(), body, 0
        while at != ancestor:
            joint = self.joints.get(at)
            if joint is None or steps > len(self.joints):
                raise InputError(f"body {body} does not hang on {ancestor}", source=self.source)
            pose, at, steps = self.joint_pose(joint, {}) * pose, joint.parent, steps + 1
        return pose

    def is_below(self, body: str, ancestor: str) -> bool:
        """Whether `ancestor` is the body itself or on its way to the ground."""
        at, steps = body, 0
        while at != ancestor and at in self.joints and steps <= len(self.joints):
            at, steps = self.joints[at].parent, steps + 1
        return at == ancestor
