"""OpenSim model for the comparison of joint axes: bodies, joints, markers, leg geometry.

Files of OpenSim 3 have each joint inside its child body, those of OpenSim 4 a `JointSet` with
offset frames; both become the same `PeerJoint`. With P and C the offset frames in parent and child
body,

    X_parent_child(q) = P  Tr(translation(q)) R_1(q) R_2(q) R_3(q)  C^-1,

each amount a function of one coordinate, evaluated here without OpenSim. Its `SimmSpline` is the
cubic spline of Forsythe, Malcolm, Moler 1977 (chapter 4): at both ends its third derivative is that
of the cubic through the four points there; beyond the points it continues as a straight line.

`LegGeometry` has hip centre, knee, talocrural and subtalar axis of one leg, of our model and of a
peer's.

Joints of a peer may roll and slide: their axis is that of the whole displacement over the range of
walking. Such a displacement x -> R x + t is a rotation by theta about an axis n and a translation
along it (Chasles). n is the fixed direction of R; with t_p the part of t across n, a point of the
axis is

    c = (t_p + cot(theta / 2) n x t_p) / 2.

The centre of a joint is the point of its axis nearest to the origin of its joint frame at zero
coordinates; for a hinge it is that origin. Lengths, from centre to centre, need no common frame.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pinocchio as pin
from scipy.interpolate import make_interp_spline

from gaitcal.arrays import Array
from gaitcal.errors import Code, InputError
from gaitcal.export.opensim.osim_writer import list_joint_frames
from gaitcal.model.parameters import Parameters


@dataclass(frozen=True, kw_only=True)
class PeerCoordinate:
    """One coordinate."""

    name: str
    default: float  # rad or m
    low: float
    high: float
    locked: bool


@dataclass(frozen=True)
class PeerAxis:
    """One of up to six elementary motions of a joint."""

    rotates: bool
    axis: Array  # (3,) unit vector
    coordinate: str | None
    function: Function


@dataclass(frozen=True, kw_only=True)
class PeerJoint:
    """Joint between two bodies."""

    name: str
    kind: str  # Tag of the element: CustomJoint, PinJoint, ..
    parent: str
    child: str
    in_parent: pin.SE3
    in_child: pin.SE3
    coordinates: tuple[PeerCoordinate, ...]
    axes: tuple[PeerAxis, ...] | None
    """None for a kind of joint that is not understood; an error only where its motion is asked for.
    """


@dataclass(frozen=True)
class PeerModel:
    """Bodies, joints and markers of an OpenSim model."""

    source: str
    masses: dict[str, float]  # Body -> kg, in the order of the file
    joints: dict[str, PeerJoint]  # By child body
    markers: dict[str, tuple[str, Array]]  # Label -> body and position (3,) m in it

    def find_joint(self, coordinate: str) -> PeerJoint | None:
        """Find the joint that has a coordinate of this name; None without one."""
        for joint in self.joints.values():
            if any(c.name == coordinate for c in joint.coordinates):
                return joint
        return None

    def replace_joints(self, joints: Iterable[PeerJoint]) -> PeerModel:
        """Replace joints by others between the same bodies."""
        return replace(self, joints=self.joints | {joint.child: joint for joint in joints})

    def compute_joint_pose(self, joint: PeerJoint, values: Mapping[str, float]) -> pin.SE3:
        """Compute the pose of a joint's child in its parent.

        Parameters
        ----------
        joint : PeerJoint
            Joint of the model.
        values : mapping
            Coordinate -> rad (m). Others are zero, or at their default if locked.

        Returns
        -------
        pin.SE3
            m

        Raises
        ------
        InputError
            The kind of joint is not known.
        """
        if joint.axes is None:
            message = f"a {joint.kind} is not supported"
            raise InputError(
                message, source=self.source, field=f"joint {joint.name}", code=Code.OTHER_MODEL
            )
        used = {c.name: c.default if c.locked else 0.0 for c in joint.coordinates} | dict(values)
        # OpenSim translates first, then rotates.
        motion = pin.SE3.Identity()
        for axis in sorted(joint.axes, key=lambda a: a.rotates):
            value = 0.0 if axis.coordinate is None else used.get(axis.coordinate, 0.0)
            amount = axis.function(value)
            if axis.rotates:
                motion = motion * pin.SE3(pin.exp3(amount * axis.axis), np.zeros(3))
            else:
                motion = motion * pin.SE3(np.eye(3), amount * axis.axis)
        return joint.in_parent * motion * joint.in_child.inverse()

    def compute_body_pose(
        self, body: str, ancestor: str, values: Mapping[str, float] | None = None
    ) -> pin.SE3:
        """Compute the pose of a body in one of its ancestors.

        Parameters
        ----------
        body, ancestor : str
            Lower and upper body.
        values : mapping, optional
            Coordinate -> rad (m); others as in `compute_joint_pose`.

        Returns
        -------
        pin.SE3
            m

        Raises
        ------
        InputError
            The body is not below `ancestor`, or a joint in between is not supported.
        """
        pose = pin.SE3.Identity()
        for joint in reversed(self.list_joints_between(ancestor, body)):
            pose = self.compute_joint_pose(joint, values or {}) * pose
        return pose

    def is_below(self, body: str, ancestor: str) -> bool:
        """Check whether `ancestor` is the body itself or between it and the ground."""
        return None not in self._list_joints_up(body, ancestor)

    def list_joints_between(self, ancestor: str, body: str) -> list[PeerJoint]:
        """List the joints from a body down to one below it, in that order.

        Parameters
        ----------
        ancestor, body : str
            Upper and lower body.

        Returns
        -------
        list of PeerJoint

        Raises
        ------
        InputError
            The lower body is not below the upper one.
        """
        joints: list[PeerJoint] = []
        for joint in self._list_joints_up(body, ancestor):
            if joint is None:
                raise InputError(
                    f"body {body} is not below {ancestor}",
                    source=self.source,
                    code=Code.OTHER_MODEL,
                )
            joints.insert(0, joint)
        return joints

    def _list_joints_up(self, body: str, ancestor: str) -> list[PeerJoint | None]:
        """List the joints from a body up to an ancestor; None at the end if it is not below."""
        joints: list[PeerJoint | None] = []
        while body != ancestor:
            # A file may contain a circle: the number of joints is limited.
            joint = self.joints.get(body) if len(joints) <= len(self.joints) else None
            joints.append(joint)
            if joint is None:
                break
            body = joint.parent
        return joints


Function = Callable[[float], float]

_SPLINES = ("SimmSpline", "NaturalCubicSpline", "natCubicSpline", "GCVSpline")
_TAGS = (
    "Constant",
    "LinearFunction",
    "PolynomialFunction",
    "PiecewiseLinearFunction",
    "MultiplierFunction",
    *_SPLINES,
)


def read_numbers(
    element: ET.Element | None, tag: str, source: Path, *, count: int | None = None
) -> Array:
    """Read the numbers in a child of an element.

    Parameters
    ----------
    element : ET.Element or None
        Element.
    tag : str
        Tag of the child.
    source : Path
        File that error messages name.
    count : int, optional
        Required number; as many zeros where the child is missing.

    Returns
    -------
    (n,) Array

    Raises
    ------
    InputError
        Text is not a number, or not finite, or there are not `count` of them.
    """
    text = element.findtext(tag) if element is not None else None
    if text is None or not text.strip():
        return np.zeros(count or 0)
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError:
        message = f"found '{text.strip()[:60]}', expected numbers"
        raise InputError(message, source=source, field=tag, code=Code.OTHER_MODEL) from None
    if (count is not None and len(values) != count) or not np.isfinite(values).all():
        expected = "finite numbers" if count is None else f"{count} finite numbers"
        message = f"found '{text.strip()[:60]}', expected {expected}"
        raise InputError(message, source=source, field=tag, code=Code.OTHER_MODEL)
    return values


def read_function(holder: ET.Element, source: Path) -> Function | None:
    """Read the function inside a `TransformAxis` or `MultiplierFunction`, of either generation.

    Parameters
    ----------
    holder : ET.Element
        Element with the function.
    source : Path
        File that error messages name.

    Returns
    -------
    Function or None
        None for an unknown kind. Zero where there is no function: the default of OpenSim's
        `TransformAxis` (Constant(0), TransformAxis.cpp).
    """
    wrapped = holder.find("function")
    inside = holder if wrapped is None else wrapped
    element = next((e for e in inside if e.tag in _TAGS), None)
    if element is None:
        other = [e for e in inside if e.get("name") == "function" or inside is wrapped]
        return None if other else lambda _: 0.0
    return _parse_function(element, source)


def _parse_function(element: ET.Element, source: Path) -> Function | None:
    """Parse the element of a function."""
    if element.tag == "Constant":
        value = float(read_numbers(element, "value", source, count=1)[0])
        return lambda _: value
    if element.tag == "MultiplierFunction":
        inner = read_function(element, source)
        scale = (
            float(read_numbers(element, "scale", source, count=1)[0])
            if element.find("scale") is not None
            else 1.0
        )
        return None if inner is None else lambda x: scale * inner(x)
    if element.tag in ("LinearFunction", "PolynomialFunction"):
        coefficients = read_numbers(element, "coefficients", source)
        if not len(coefficients):
            raise InputError(
                "found no coefficients", source=source, field=element.tag, code=Code.OTHER_MODEL
            )
        return lambda x: float(np.polyval(coefficients, x))
    x, y = read_numbers(element, "x", source), read_numbers(element, "y", source)
    if len(x) != len(y) or len(x) < 2 or (np.diff(x) <= 0).any():
        message = "x must increase and have as many numbers as y"
        raise InputError(message, source=source, field=element.tag, code=Code.OTHER_MODEL)
    if element.tag == "PiecewiseLinearFunction" or len(x) < 4:
        return lambda value: float(np.interp(value, x, y))
    return _make_spline(x, y)


def _make_spline(x: Array, y: Array) -> Function:
    """Make OpenSim's cubic spline, continued as straight lines."""
    ends = [
        6.0 * _compute_third_difference(x[part], y[part])
        for part in (slice(None, 4), slice(-4, None))
    ]
    spline = make_interp_spline(x, y, k=3, bc_type=([(3, ends[0])], [(3, ends[1])]))
    slope = spline.derivative()

    def evaluate(value: float) -> float:
        inside = min(max(value, float(x[0])), float(x[-1]))
        return float(spline(inside) + slope(inside) * (value - inside))

    return evaluate


def _compute_third_difference(x: Array, y: Array) -> float:
    """Compute the third divided difference of four points."""
    for order in range(1, 4):
        y = np.diff(y) / (x[order:] - x[:-order])
    return float(y[0])


KNEE_SWEEP = math.radians(60.0)
"""Flexion of the knee in walking, over which a peer's axis is determined."""
ANKLE_SWEEP = math.radians(20.0)
"""The same of the ankle, to both sides."""
SUBTALAR_SWEEP = math.radians(10.0)
"""The same of the subtalar joint, to both sides."""


@dataclass(frozen=True, kw_only=True)
class LegGeometry:
    """Joints of one leg, each in the frames of the segments it connects; None where unknown."""

    hip_in_pelvis: Array | None  # (3,) m
    hip_in_thigh: Array | None  # (3,) m
    knee_in_thigh: Axis | None
    knee_in_shank: Axis | None
    ankle_in_shank: Axis | None  # The talocrural axis
    subtalar_in_foot: Axis | None
    thigh_length: float | None  # m
    shank_length: float | None  # m
    ankle_axes_distance: float | None  # m, between talocrural and subtalar axis


def measure_our_leg(parameters: Parameters, side: str) -> LegGeometry:
    """Measure the geometry of one leg of our linkage.

    Parameters
    ----------
    parameters : Parameters
        Joint parameters.
    side : {"r", "l"}
        Leg.

    Returns
    -------
    LegGeometry
        In our segment frames, m.
    """
    frames = {joint.name: joint for joint in list_joint_frames(parameters)}
    hip, knee, ankle, subtalar = (
        frames[f"{name}_{side}"] for name in ("hip", "knee", "talocrural", "subtalar")
    )
    hip_in_thigh = hip.in_child.translation
    knee_in_thigh, knee_in_shank = _get_axis(knee.in_parent, 2), _get_axis(knee.in_child, 2)
    ankle_in_shank = _get_axis(ankle.in_parent, 2)
    return LegGeometry(
        hip_in_pelvis=hip.in_parent.translation,
        hip_in_thigh=hip_in_thigh,
        knee_in_thigh=knee_in_thigh,
        knee_in_shank=knee_in_shank,
        ankle_in_shank=ankle_in_shank,
        subtalar_in_foot=_get_axis(subtalar.in_child, 0),
        thigh_length=_measure_distance(hip_in_thigh, knee_in_thigh.point),
        shank_length=_measure_distance(knee_in_shank.point, ankle_in_shank.point),
        # In the talus, whose frame is that of the talocrural joint.
        ankle_axes_distance=_measure_line_distance(
            _get_axis(subtalar.in_parent, 0), _get_axis(pin.SE3.Identity(), 2)
        ),
    )


def find_leg_bodies(peer: PeerModel, side: str) -> dict[str, str]:
    """Find the bodies of our segments of a leg.

    Parameters
    ----------
    peer : PeerModel
        Model.
    side : {"r", "l"}
        Leg.

    Returns
    -------
    dict
        `pelvis`, `thigh_r`, `shank_r`, `foot_r` -> body, as far as the model has them.
    """
    bodies: dict[str, str] = {}
    hip, knee = peer.find_joint(f"hip_flexion_{side}"), peer.find_joint(f"knee_angle_{side}")
    if hip is not None:
        bodies |= {"pelvis": hip.parent, f"thigh_{side}": hip.child}
    if knee is not None:
        bodies |= {f"thigh_{side}": knee.parent, f"shank_{side}": knee.child}
    foot = peer.find_joint(f"subtalar_angle_{side}") or peer.find_joint(f"ankle_angle_{side}")
    if foot is not None:
        bodies[f"foot_{side}"] = foot.child
    return bodies


def measure_peer_leg(peer: PeerModel, side: str, registration: dict[str, pin.SE3]) -> LegGeometry:
    """Measure the geometry of one leg of a peer's model.

    Parameters
    ----------
    peer : PeerModel
        Model.
    side : {"r", "l"}
        Leg.
    registration : dict
        Our segment -> pose of its body (`find_leg_bodies`) in our segment frame.

    Returns
    -------
    LegGeometry
        Positions and directions in a segment without registration are None.
    """
    bodies = find_leg_bodies(peer, side)
    thigh, shank, foot = (bodies.get(f"{name}_{side}") for name in ("thigh", "shank", "foot"))
    hip, knee = peer.find_joint(f"hip_flexion_{side}"), peer.find_joint(f"knee_angle_{side}")
    hip_pelvis = hip_thigh = None
    if hip is not None:
        hip_pelvis = (peer.compute_joint_pose(hip, {}) * hip.in_child).translation
        hip_thigh = hip.in_child.translation if hip.child == thigh else None
    knee_axis = None if knee is None else _find_knee_axis(peer, knee, f"knee_angle_{side}")
    knee_thigh = knee_shank = None
    if knee is not None and knee_axis is not None:
        knee_thigh = _centre_axis(peer, knee, knee_axis)
        knee_shank = knee_thigh.transform(peer.compute_joint_pose(knee, {}).inverse())
    ankle_shank = None if shank is None else _find_ankle_axis(peer, side, shank)
    subtalar_foot, axes_distance = _find_subtalar_axis(peer, side, shank, ankle_shank)
    thigh_length = shank_length = None
    if hip_thigh is not None and knee_thigh is not None:
        thigh_length = _measure_distance(hip_thigh, knee_thigh.point)
    if knee_shank is not None and ankle_shank is not None:
        shank_length = _measure_distance(knee_shank.point, ankle_shank.point)

    to_pelvis, to_foot = registration.get("pelvis"), registration.get(f"foot_{side}")
    to_thigh, to_shank = registration.get(f"thigh_{side}"), registration.get(f"shank_{side}")
    return LegGeometry(
        hip_in_pelvis=_transform_point(hip_pelvis, to_pelvis),
        hip_in_thigh=_transform_point(hip_thigh, to_thigh),
        knee_in_thigh=_transform_axis(knee_thigh, to_thigh, 2),
        knee_in_shank=_transform_axis(knee_shank, to_shank, 2),
        ankle_in_shank=_transform_axis(ankle_shank, to_shank, 2),
        subtalar_in_foot=_transform_axis(subtalar_foot, to_foot if foot is not None else None, 0),
        thigh_length=thigh_length,
        shank_length=shank_length,
        ankle_axes_distance=axes_distance,
    )


def _find_ankle_axis(peer: PeerModel, side: str, shank: str) -> Axis | None:
    """Find the talocrural axis in the body of the shank."""
    name = f"ankle_angle_{side}"
    ankle = peer.find_joint(name)
    if ankle is None or not peer.is_below(ankle.parent, shank):
        return None
    axis = _find_swept_axis(peer, ankle, name, -ANKLE_SWEEP, ANKLE_SWEEP)
    if axis is None:
        return None
    to_shank = peer.compute_body_pose(ankle.parent, shank)
    return _centre_axis(peer, ankle, axis).transform(to_shank).direct_along(2)


def _find_subtalar_axis(
    peer: PeerModel, side: str, shank: str | None, ankle: Axis | None
) -> tuple[Axis | None, float | None]:
    """Find the subtalar axis in the foot, and its distance (m) from the talocrural axis."""
    name = f"subtalar_angle_{side}"
    subtalar = peer.find_joint(name)
    if subtalar is None:
        return None, None
    axis = _find_swept_axis(peer, subtalar, name, -SUBTALAR_SWEEP, SUBTALAR_SWEEP)
    if axis is None:
        return None, None
    to_foot = peer.compute_joint_pose(subtalar, {}).inverse()
    distance = None
    if ankle is not None and shank is not None and peer.is_below(subtalar.parent, shank):
        in_shank = axis.transform(peer.compute_body_pose(subtalar.parent, shank))
        distance = _measure_line_distance(ankle, in_shank)
    return axis.transform(to_foot).direct_along(0), distance


def _get_axis(frame: pin.SE3, coordinate: int) -> Axis:
    """Get an axis of a joint's frame."""
    return Axis(frame.translation, frame.rotation[:, coordinate])


def _find_knee_axis(peer: PeerModel, knee: PeerJoint, coordinate: str) -> Axis | None:
    """Find the axis of flexion, the direction of the longer range, in the joint's parent."""
    c = next(c for c in knee.coordinates if c.name == coordinate)
    flexion = KNEE_SWEEP if c.high >= -c.low else -KNEE_SWEEP
    axis = _find_swept_axis(peer, knee, coordinate, 0.0, flexion)
    return None if axis is None else axis.direct_along(2)


def _find_swept_axis(
    peer: PeerModel, joint: PeerJoint, coordinate: str, start: float, end: float
) -> Axis | None:
    """Find the axis, in the joint's parent, of the motion between two values of a coordinate."""
    poses = (peer.compute_joint_pose(joint, {coordinate: amount}) for amount in (start, end))
    return find_displacement_axis(*poses)


def _centre_axis(peer: PeerModel, joint: PeerJoint, axis: Axis) -> Axis:
    """Take the centre of the joint as the point of its axis, in the joint's parent."""
    centre = (peer.compute_joint_pose(joint, {}) * joint.in_child).translation
    return Axis(axis.find_nearest(centre), axis.direction)


def _measure_distance(a: Array, b: Array) -> float:
    """Measure the distance (m) of two points."""
    return float(np.linalg.norm(a - b))


def _transform_point(point: Array | None, pose: pin.SE3 | None) -> Array | None:
    """Transform a point; None stays."""
    return None if point is None or pose is None else np.asarray(pose.act(point))


def _transform_axis(axis: Axis | None, pose: pin.SE3 | None, positive: int) -> Axis | None:
    """Transform an axis, directed along coordinate `positive`; None stays."""
    return None if axis is None or pose is None else axis.transform(pose).direct_along(positive)


@dataclass(frozen=True)
class Axis:
    """Directed line."""

    point: Array  # (3,) m, on the line
    direction: Array  # (3,) unit vector

    def transform(self, pose: pin.SE3) -> Axis:
        """Express the line in the frame in which `pose` is given."""
        return Axis(pose.act(self.point), pose.rotation @ self.direction)

    def find_nearest(self, point: Array) -> Array:
        """Find the point of the line that is nearest to a point.

        Parameters
        ----------
        point : (3,) Array
            m

        Returns
        -------
        (3,) Array
            m
        """
        nearest: Array = self.point + self.direction * float(self.direction @ (point - self.point))
        return nearest

    def measure_distance(self, point: Array) -> float:
        """Measure the distance (m) of a point (3,) m from the line."""
        return float(np.linalg.norm(self.find_nearest(point) - point))

    def find_crossing(self, axis: int) -> Array:
        """Find the point where the line crosses the plane on which one coordinate is zero.

        Parameters
        ----------
        axis : int
            Index of the coordinate.

        Returns
        -------
        (3,) Array
            m
        """
        crossing: Array = self.point - self.direction * (self.point[axis] / self.direction[axis])
        return crossing

    def direct_along(self, axis: int) -> Axis:
        """Direct the line so that coordinate `axis` of its direction is positive."""
        return Axis(self.point, self.direction if self.direction[axis] >= 0.0 else -self.direction)


SMALLEST_ROTATION = 1e-6
"""rad: a displacement with less rotation has no axis."""


def find_displacement_axis(start: pin.SE3, end: pin.SE3) -> Axis | None:
    """Find the axis of the displacement from one pose to another.

    Parameters
    ----------
    start, end : pin.SE3
        Poses in one frame.

    Returns
    -------
    Axis or None
        In the frame of the poses; None without a rotation.
    """
    step = end * start.inverse()
    rotation = pin.log3(step.rotation)
    angle = float(np.linalg.norm(rotation))
    if angle < SMALLEST_ROTATION:
        return None
    # Axis n and point c of the module.
    n = rotation / angle
    across = step.translation - n * float(n @ step.translation)
    return Axis(0.5 * (across + np.cross(n, across) / np.tan(0.5 * angle)), n)


def _measure_line_distance(a: Axis, b: Axis) -> float:
    """Measure the shortest distance of two lines.

    `a`, `b`: lines in one frame, m. Returns: m.
    """
    normal = np.cross(a.direction, b.direction)
    size = float(np.linalg.norm(normal))
    # Parallel lines have no common normal.
    if size < 1e-9:
        return a.measure_distance(b.point)
    return abs(float(normal @ (b.point - a.point))) / size
