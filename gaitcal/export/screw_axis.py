"""Axes as lines, and the axis of a motion between two poses.

A displacement x -> R x + t is a turn by theta about an axis n and a slide along it (Chasles). n is the fixed
direction of R; with t_p the part of t across n, a point of the axis is

    c = (t_p + cot(theta / 2) n x t_p) / 2.

For a hinge this is the hinge; for a joint that rolls and slides, the axis of its whole motion between the two poses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Axis:
    """A directed line."""

    point: Array
    """(3,) m, on the line."""
    direction: Array
    """(3,) unit vector."""

    def moved(self, pose: pin.SE3) -> Axis:
        """The same line in the frame in which `pose` is given."""
        return Axis(pose.act(self.point), pose.rotation @ self.direction)

    def nearest(self, point: Array) -> Array:
        """(3,) m: the point of the line nearest to `point`."""
        nearest: Array = self.point + self.direction * float(self.direction @ (point - self.point))
        return nearest

    def distance(self, point: Array) -> float:
        """Distance of a point from the line, m."""
        return float(np.linalg.norm(self.nearest(point) - point))

    def crossing(self, axis: int) -> Array:
        """(3,) m: where the line crosses the plane on which coordinate `axis` is zero."""
        crossing: Array = self.point - self.direction * (self.point[axis] / self.direction[axis])
        return crossing

    def pointing(self, axis: int) -> Axis:
        """The line directed so that coordinate `axis` of its direction is positive."""
        return Axis(self.point, self.direction if self.direction[axis] >= 0.0 else -self.direction)


SMALLEST_TURN = 1e-6
"""rad; a displacement that turns less has no axis worth the name."""


def displacement_axis(start: pin.SE3, end: pin.SE3) -> Axis | None:
    """Axis of the displacement from one pose to another, in the frame in which both are given; None without a turn."""
    step = end * start.inverse()
    turn = pin.log3(step.rotation)
    angle = float(np.linalg.norm(turn))
    if angle < SMALLEST_TURN:
        return None
    n = turn / angle
    across = step.translation - n * float(n @ step.translation)
    return Axis(0.5 * (across + np.cross(n, across) / np.tan(0.5 * angle)), n)


def line_distance(a: Axis, b: Axis) -> float:
    """Shortest distance of two lines, m."""
    normal = np.cross(a.direction, b.direction)
    size = float(np.linalg.norm(normal))
    if size < 1e-9:
        return a.distance(b.point)
    return abs(float(normal @ (b.point - a.point))) / size
