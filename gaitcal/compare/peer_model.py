"""An OpenSim model as far as comparing joint axes needs it: bodies, joints, markers; read from the XML alone.

Files of OpenSim 3 keep each joint inside its child body, those of OpenSim 4 in a `JointSet` with offset frames; both
come out as the same `PeerJoint`. With P and C the offset frames in parent and child body,

    X_parent_child(q) = P  Tr(translation(q)) R_1(q) R_2(q) R_3(q)  C^-1,

each amount a function of one coordinate, evaluated here without OpenSim. Its `SimmSpline` is the cubic spline of
Forsythe, Malcolm, Moler 1977 (chapter 4): at either end its third derivative is that of the cubic through the four
points there; beyond the points it goes on as a straight line.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
from scipy.interpolate import make_interp_spline

from gaitcal.arrays import Array
from gaitcal.codes import Code
from gaitcal.errors import InputError


@dataclass(frozen=True, kw_only=True)
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


@dataclass(frozen=True, kw_only=True)
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
        return next((j for j in self.joints.values() if any(c.name == coordinate for c in j.coordinates)), None)

    def joint_pose(self, joint: PeerJoint, values: Mapping[str, float]) -> pin.SE3:
        """Pose of the child in the parent; coordinates not in `values` are zero, or at their default if locked."""
        if joint.axes is None:
            raise InputError(
                f"a {joint.kind} is not understood",
                source=self.source,
                field=f"joint {joint.name}",
                code=Code.OTHER_MODEL,
            )
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
        pose = pin.SE3.Identity()
        for joint in self._way_up(body, ancestor):
            if joint is None:
                raise InputError(f"body {body} does not hang on {ancestor}", source=self.source, code=Code.OTHER_MODEL)
            pose = self.joint_pose(joint, {}) * pose
        return pose

    def is_below(self, body: str, ancestor: str) -> bool:
        """Whether `ancestor` is the body itself or on its way to the ground."""
        return None not in self._way_up(body, ancestor)

    def _way_up(self, body: str, ancestor: str) -> list[PeerJoint | None]:
        """The joints from a body up to one of its ancestors; None at the end where it does not hang on that one."""
        joints: list[PeerJoint | None] = []
        while body != ancestor:
            joint = self.joints.get(body) if len(joints) <= len(self.joints) else None  # a file may hold a circle
            joints.append(joint)
            if joint is None:
                break
            body = joint.parent
        return joints


Function = Callable[[float], float]

_SPLINES = ("SimmSpline", "NaturalCubicSpline", "natCubicSpline", "GCVSpline")
_TAGS = ("Constant", "LinearFunction", "PolynomialFunction", "PiecewiseLinearFunction", "MultiplierFunction", *_SPLINES)


def read_numbers(element: ET.Element | None, tag: str, source: Path, *, count: int | None = None) -> Array:
    """The numbers in the child `tag`; zeros (`count`) where it is absent; InputError where they are not numbers."""
    text = element.findtext(tag) if element is not None else None
    if text is None or not text.strip():
        return np.zeros(count or 0)
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError:
        raise InputError(
            f"found '{text.strip()[:60]}', expected numbers", source=source, field=tag, code=Code.OTHER_MODEL
        ) from None
    if (count is not None and len(values) != count) or not np.isfinite(values).all():
        expected = "finite numbers" if count is None else f"{count} finite numbers"
        raise InputError(
            f"found '{text.strip()[:60]}', expected {expected}", source=source, field=tag, code=Code.OTHER_MODEL
        )
    return values


def read_function(holder: ET.Element, source: Path) -> Function | None:
    """The function inside `holder` (a `TransformAxis` or a `MultiplierFunction`), of either generation of files.

    Where there is none, zero: the default of OpenSim's own `TransformAxis` (Constant(0), TransformAxis.cpp). None for a
    function of a kind that is not understood.
    """
    wrapped = holder.find("function")
    inside = holder if wrapped is None else wrapped
    element = next((e for e in inside if e.tag in _TAGS), None)
    if element is None:
        other = [e for e in inside if e.get("name") == "function" or inside is wrapped]
        return None if other else lambda _: 0.0
    return _function(element, source)


def _function(element: ET.Element, source: Path) -> Function | None:
    if element.tag == "Constant":
        value = float(read_numbers(element, "value", source, count=1)[0])
        return lambda _: value
    if element.tag == "MultiplierFunction":
        inner = read_function(element, source)
        scale = float(read_numbers(element, "scale", source, count=1)[0]) if element.find("scale") is not None else 1.0
        return None if inner is None else lambda x: scale * inner(x)
    if element.tag in ("LinearFunction", "PolynomialFunction"):
        coefficients = read_numbers(element, "coefficients", source)
        if not len(coefficients):
            raise InputError("found no coefficients", source=source, field=element.tag, code=Code.OTHER_MODEL)
        return lambda x: float(np.polyval(coefficients, x))
    x, y = read_numbers(element, "x", source), read_numbers(element, "y", source)
    if len(x) != len(y) or len(x) < 2 or (np.diff(x) <= 0).any():
        raise InputError(
            "x must increase and have as many numbers as y", source=source, field=element.tag, code=Code.OTHER_MODEL
        )
    if element.tag == "PiecewiseLinearFunction" or len(x) < 4:
        return lambda value: float(np.interp(value, x, y))
    return _spline(x, y)


def _spline(x: Array, y: Array) -> Function:
    ends = [6.0 * _third_difference(x[part], y[part]) for part in (slice(None, 4), slice(-4, None))]
    spline = make_interp_spline(x, y, k=3, bc_type=([(3, ends[0])], [(3, ends[1])]))
    slope = spline.derivative()

    def evaluate(value: float) -> float:
        inside = min(max(value, float(x[0])), float(x[-1]))
        return float(spline(inside) + slope(inside) * (value - inside))

    return evaluate


def _third_difference(x: Array, y: Array) -> float:
    for order in range(1, 4):
        y = np.diff(y) / (x[order:] - x[:-order])
    return float(y[0])
