"""Joint parameters of known joints, told in the segment frames of the static trial.

Frames are those in which the nominal model places its markers. A ball joint is a point in both segments. A hinge's
axis z in the segment above or below is Rx(front) Ry(trans) z; it is told at its point of lateral position zero in the
thigh, and at the same point of the shank. Talocrural and subtalar axis are told at their common perpendicular, from
which also come the talus's parameters: the distance of the two axes, and the angle by which they miss a right one. The
subtalar axis x in the foot is Ry(trans) Rz(sag) x.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gaitcal import Recording, SubjectModel
from gaitcal.arrays import Array
from scripts.validation.truth.people import IsolatedPerson
from scripts.validation.truth.rigid import Line, rigid_motion

DIRECTIONS = ("ant", "sup", "lat")


@dataclass(frozen=True)
class SegmentPose:
    """A segment frame in the laboratory of the static trial."""

    rotation: Array
    """(3, 3)."""
    origin: Array
    """(3,) m."""

    def point(self, point: Array) -> Array:
        """A point of the laboratory in the frame (m)."""
        out: Array = self.rotation.T @ (point - self.origin)
        return out

    def line(self, line: Line) -> Line:
        """A line of the laboratory in the frame."""
        return Line(self.point(line.point), self.rotation.T @ line.direction)


def static_frames(nominal: SubjectModel, static: Recording) -> dict[str, SegmentPose]:
    """Segment -> pose, of segments that carry three markers or more in the static trial."""
    seen = dict(zip(static.labels, np.nanmean(static.markers, axis=0), strict=True))
    frames = {}
    markers = nominal.markers
    placed = list(zip(markers.labels, markers.segments, markers.local, strict=True))
    for segment in dict.fromkeys(markers.segments):
        carried = [(label, local) for label, s, local in placed if s == segment and label in seen]
        if len(carried) >= 3:
            local, measured = np.array([x for _, x in carried]), np.array([seen[label] for label, _ in carried])
            rotation, origin = rigid_motion(local, measured[None])
            frames[segment] = SegmentPose(rotation[0], origin[0])
    return frames


def hip_parameters(frames: Mapping[str, SegmentPose], side: str, centre: Array) -> dict[str, float]:
    """The six of a hip (m) whose centre (3,) is known."""
    return {
        **point_parameters(f"hip_{side}.pelvis", frames["pelvis"].point(centre)),
        **point_parameters(f"hip_{side}.thigh", frames[f"thigh_{side}"].point(centre)),
    }


def leg_parameters(person: IsolatedPerson, frames: Mapping[str, SegmentPose], side: str) -> dict[str, float]:
    """The 27 joint parameters of a leg, m and rad."""
    thigh, shank, foot = (frames[f"{name}_{side}"] for name in ("thigh", "shank", "foot"))
    out = hip_parameters(frames, side, person.centres[f"hip_{side}"])
    above, below = thigh.line(person.proximal[f"knee_{side}"]), shank.line(person.distal[f"knee_{side}"])
    above, below = rightwards(above), rightwards(below)
    slide = -above.point[2] / above.direction[2]
    out |= point_parameters(f"knee_{side}.thigh", above.point + slide * above.direction, "ant sup")
    out |= point_parameters(f"knee_{side}.shank", below.point + slide * below.direction)
    out |= z_parameters(f"knee_{side}.thigh", above.direction) | z_parameters(f"knee_{side}.shank", below.direction)
    z = rightwards(shank.line(person.proximal[f"ankle_{side}"]))
    # the subtalar axis as the talus carries it, which at rest is where the shank has it
    x = forwards(shank.line(person.proximal[f"subtalar_{side}"]))
    on_z, on_x = common_perpendicular(z, x)
    up = np.cross(z.direction, x.direction)
    out |= point_parameters(f"talocrural_{side}.shank", on_z) | z_parameters(f"talocrural_{side}.shank", z.direction)
    out[f"subtalar_{side}.talus.sup"] = float((on_x - on_z) @ up / np.linalg.norm(up))
    out[f"subtalar_{side}.talus.trans"] = float(-np.arcsin(z.direction @ x.direction))
    line = forwards(foot.line(person.distal[f"subtalar_{side}"]))
    slide = (on_x - x.point) @ x.direction
    out |= point_parameters(f"subtalar_{side}.foot", line.point + slide * line.direction)
    return out | x_parameters(f"subtalar_{side}.foot", line.direction)


def rightwards(line: Line) -> Line:
    """The line with its direction towards +z."""
    return Line(line.point, line.direction * np.sign(line.direction[2]))


def forwards(line: Line) -> Line:
    """The line with its direction towards +x."""
    return Line(line.point, line.direction * np.sign(line.direction[0]))


def point_parameters(prefix: str, point: Array, which: str = "ant sup lat") -> dict[str, float]:
    """Coordinates of a point (m) by parameter."""
    return {f"{prefix}.{d}": float(point[DIRECTIONS.index(d)]) for d in which.split()}


def z_parameters(prefix: str, z: Array) -> dict[str, float]:
    """Angles (rad) of Rx(front) Ry(trans) whose z axis is given."""
    return {f"{prefix}.front": float(np.arctan2(-z[1], z[2])), f"{prefix}.trans": float(np.arcsin(z[0]))}


def x_parameters(prefix: str, x: Array) -> dict[str, float]:
    """Angles (rad) of Ry(trans) Rz(sag) whose x axis is given."""
    return {f"{prefix}.trans": float(np.arctan2(-x[2], x[0])), f"{prefix}.sag": float(np.arcsin(x[1]))}


def z_axis(front: float, trans: float) -> Array:
    """(3,) the z axis of Rx(front) Ry(trans)."""
    return np.array([np.sin(trans), -np.sin(front) * np.cos(trans), np.cos(front) * np.cos(trans)])


def x_axis(trans: float, sag: float) -> Array:
    """(3,) the x axis of Ry(trans) Rz(sag)."""
    return np.array([np.cos(trans) * np.cos(sag), np.sin(sag), -np.sin(trans) * np.cos(sag)])


def common_perpendicular(a: Line, b: Line) -> tuple[Array, Array]:
    """The nearest points of two lines to each other."""
    between, cosine = b.point - a.point, float(a.direction @ b.direction)
    matrix = np.array([[1.0, -cosine], [cosine, -1.0]])
    s, t = np.linalg.solve(matrix, np.array([a.direction @ between, b.direction @ between]))
    return a.point + s * a.direction, b.point + t * b.direction
