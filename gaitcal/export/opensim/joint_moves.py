"""Displacements of a model's joints, and of what is fixed to the bones between them.

A bone between two joints, whose centres a, b in the body have moved to a', b', takes along what is
fixed to it by the affine map

    x' = m' + R (I + (k - 1) u u^T) (x - m)
    m = (a + b) / 2,    u = (b - a) / |b - a|,    k = |b' - a'| / |b - a|,

with R the smallest rotation from b - a to b' - a'. The bone is stretched along u as scaling would
do, and keeps its thickness. Such bones are the pelvis (between its hips), thighs and shanks. Muscle
points, contact spheres and frames of other joints in the bone follow the map. Wraps and meshes are
translated and rotated, and keep their size. All locations of a point that moves with a coordinate
are translated as their mean is. Markers stay, because they determine the position of the body;
so do mass centres.
"""

import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from itertools import product

import numpy as np
import pinocchio as pin

from gaitcal.arrays import Array
from gaitcal.errors import Code, InputError
from gaitcal.export.opensim import osim_correspondence, osim_reader, osim_writer
from gaitcal.export.opensim.peer_model import PeerModel, read_numbers

UNMOVED_M, UNMOVED_RAD = 1e-7, 1e-7
"""Rounding of the solvers: with smaller changes the bytes of the file stay."""


class MoveOutcome(Enum):
    """Outcome of the transfer of a joint."""

    MOVED = "moved"
    UNDETERMINED = "not moved: the recordings hardly determine it"
    ABSENT = "the model has no such joint"


@dataclass(frozen=True, kw_only=True)
class JointEnd:
    """Position of a joint in one of its bodies, and its change."""

    body: str
    centre: Array
    """(3,) m, in the body, before."""
    frame: pin.SE3
    """Pose of the joint's frame in the body, after."""
    displacement: Array
    """(3,) m, in the body's axes: of the centre, of a hinge across its axis."""
    rotation: float
    """rad, of a hinge's axis; of a ball joint's frame."""
    errors: tuple[float, float]
    """m and rad, standard errors of the centre (of a hinge across its axis) and of the direction of
    a hinge's axis, all directions together, by joint parameters and registration. NaN where
    unknown.
    """
    changed: bool
    """Whether the file is changed here."""
    landmarks: float
    """m, displacement by the landmarks of the static trial alone; NaN in a body without a segment
    of ours.
    """

    @property
    def moved(self) -> float:
        """Length of the displacement, m."""
        return float(np.linalg.norm(self.displacement))


@dataclass(frozen=True, kw_only=True)
class JointMove:
    """Outcome of the transfer of one joint."""

    joint: str
    """Our name: `hip_r`, ..."""
    theirs: str
    """Name in the model; empty where it has no such joint."""
    outcome: MoveOutcome
    error_ratio: float
    """Standard error of its parameters relative to that before any trial; the larger one of
    positions and directions.
    """
    standing: Mapping[str, float]
    """Coordinate of the model -> rad (m) as the person stands, before and after."""
    rolling: tuple[float, float] = (0.0, 0.0)
    """m and rad, remaining error of the standing bones: the joint rolls, or cannot move so."""
    parent: JointEnd | None = None
    child: JointEnd | None = None


@dataclass(frozen=True, kw_only=True)
class Bone:
    """Affine map of a bone between two joints, in the axes of its body."""

    middle_before: Array  # (3,) m, middle between its joints: m of the module
    middle_after: Array  # (3,) m: m'
    rotation: Array  # (3, 3): R
    direction: Array  # (3,) unit vector from joint to joint, before: u
    stretch: float  # k

    def map_point(self, x: Array) -> Array:
        """Map a point of the bone to its new position.

        Parameters
        ----------
        x : (3,) Array
            m, in the body.

        Returns
        -------
        (3,) Array
            m, x' of the module.
        """
        from_middle = x - self.middle_before
        long = self.direction * float(self.direction @ from_middle)
        out: Array = self.middle_after + self.rotation @ (from_middle + (self.stretch - 1.0) * long)
        return out

    def express_in(self, frame: pin.SE3) -> "Bone":
        """Express the map in the axes of a frame in the body.

        `frame`: pose of the frame in the body, m.
        """
        to_frame = frame.rotation.T
        was, now = frame.actInv(self.middle_before), frame.actInv(self.middle_after)
        return replace(
            self,
            middle_before=was,
            middle_after=now,
            rotation=to_frame @ self.rotation @ to_frame.T,
            direction=to_frame @ self.direction,
        )

    @property
    def rigid(self) -> pin.SE3:
        """Rigid part of the map, without the stretch."""
        return pin.SE3(self.rotation, self.middle_after - self.rotation @ self.middle_before)


def find_moved_bones(
    moves: Sequence[JointMove], peer: PeerModel, legs: Sequence[osim_correspondence.LegJoint]
) -> dict[str, Bone]:
    """Find the bodies between two of our joints, at least one of which moved.

    Parameters
    ----------
    moves : sequence of JointMove
        Outcome of each joint.
    peer : PeerModel
        Model as it was read.
    legs : sequence of LegJoint
        Joints of the model that correspond to ours.

    Returns
    -------
    dict
        Body -> its map.
    """
    # Body -> centre of each of its joints, before and after.
    ends: dict[str, list[tuple[Array, Array]]] = {}
    for move, leg in product(moves, legs):
        if leg.ours != move.joint:
            continue
        joint = leg.theirs
        at_rest = (peer.compute_joint_pose(joint, move.standing) * joint.in_child).translation
        for body, centre, end in (
            (joint.parent, at_rest, move.parent),
            (joint.child, joint.in_child.translation, move.child),
        ):
            found = (centre, centre) if end is None else (end.centre, end.centre + end.displacement)
            ends.setdefault(body, []).append(found)
    out = {}
    for body, pair in ends.items():
        if len(pair) != 2 or all(np.linalg.norm(now - was) < UNMOVED_M for was, now in pair):
            continue
        (a, a_now), (b, b_now) = pair
        before, after = b - a, b_now - a_now
        length = float(np.linalg.norm(before))
        if length < SHORTEST:
            continue
        out[body] = Bone(
            middle_before=0.5 * (a + b),
            middle_after=0.5 * (a_now + b_now),
            rotation=pin.Quaternion.FromTwoVectors(before, after).toRotationMatrix(),
            direction=before / length,
            stretch=float(np.linalg.norm(after)) / length,
        )
    return out


SHORTEST = 0.1
"""m: joints that are nearer, as those of a talus, have no bone between them to be stretched."""

Change = tuple[ET.Element, tuple[str, ...], tuple[Array, ...]]
"""Element, names of its children, their new numbers."""


def move_attachments(
    document: osim_reader.OsimDocument, bones: Mapping[str, Bone]
) -> Iterator[Change]:
    """Move points and wraps that are fixed to bones; markers stay.

    Parameters
    ----------
    document : OsimDocument
        Model file as it was read.
    bones : mapping
        Body -> its map.

    Yields
    ------
    Change
        Element, names of its children, and their new numbers.

    Raises
    ------
    InputError
        A point moves by a function of an unknown kind.
    """
    source, bone_at = document.source, _map_frames(document, bones)
    for element in document.model.iter() if bones else ():
        bone = bone_at.get(_find_parent_path(element))
        if bone is None or element.tag == "Marker":
            continue
        # In OpenSim 3, moving points have a location as well.
        if element.find("location") is not None:
            location = read_numbers(element, "location", source, count=3)
            yield element, ("location",), (bone.map_point(location),)
        if element.tag == "MovingPathPoint":
            yield from _move_path_point(element, bone, document)
    for body in bones:
        for path, _, frame in document.list_frames(body):
            bone, tags = bone_at[path], ("translation", "xyz_body_rotation")
            for wrap in frame.findall("WrapObjectSet/objects/*"):
                origin, angles = (read_numbers(wrap, tag, source, count=3) for tag in tags)
                rotation = bone.rotation @ osim_writer.convert_from_body_fixed_xyz(angles)
                new_angles = osim_writer.convert_to_body_fixed_xyz(rotation)
                yield wrap, tags, (bone.map_point(origin), new_angles)


def _map_frames(document: osim_reader.OsimDocument, bones: Mapping[str, Bone]) -> dict[str, Bone]:
    """Map the path of each body and offset frame to the bone's map in the axes of that frame."""
    return {
        path: bone.express_in(pose)
        for body, bone in bones.items()
        for path, pose, _ in document.list_frames(body)
    }


def _find_parent_path(element: ET.Element) -> str:
    """Find the path, from a body on, of the frame an element is fixed to; empty without one."""
    found = (
        osim_reader.find_socket(element, tag) for tag in ("socket_parent_frame", "socket_frame")
    )
    named = next((e for e in (*found, element.find("body")) if e is not None), None)
    text = "" if named is None else (named.text or "").strip()
    return text.rpartition("bodyset/")[2].rpartition("../")[2]


def _move_path_point(
    element: ET.Element, bone: Bone, document: osim_reader.OsimDocument
) -> Iterator[Change]:
    """Translate all locations of a point that moves with a coordinate as their mean."""
    found = []
    for axis in "xyz":
        function = element.find(f"{axis}_location")
        holder, tag = None, ""
        # Numbers of a spline, or of a constant.
        if function is not None:
            for tag in ("y", "value"):
                holder = function.find(f".//{tag}/..")
                if holder is not None:
                    break
        if function is None or holder is None:
            message = (
                f"found {axis}_location of another kind, allowed: a spline or a constant (or "
                "--attachments stay)"
            )
            raise InputError(
                message, source=document.source, field=element.get("name"), code=Code.OTHER_MODEL
            )
        scale = next((float(e.text or 1.0) for e in function.iter("scale")), 1.0)
        found.append((holder, tag, read_numbers(holder, tag, document.source), scale))
    mean = np.array([scale * numbers.mean() for _, _, numbers, scale in found])
    displacement = bone.map_point(mean) - mean
    for (holder, tag, numbers, scale), step in zip(found, displacement, strict=True):
        yield holder, (tag,), (numbers + step / scale,)


@dataclass(frozen=True, kw_only=True)
class MovedPoints:
    """Points of one muscle that moved with their bones."""

    muscle: str
    points: int
    farthest: float  # m


def summarise_muscle_points(
    document: osim_reader.OsimDocument, bones: Mapping[str, Bone]
) -> tuple[MovedPoints, ...]:
    """Summarise the moved points of each muscle, the one with the farthest first.

    Parameters
    ----------
    document : OsimDocument
        Model file as it was read.
    bones : mapping
        Body -> its map.

    Returns
    -------
    tuple of MovedPoints
    """
    out, bone_at = [], _map_frames(document, bones)
    for force in document.model.findall("ForceSet/objects/*") if bones else ():
        moves = []
        for point in force.iter():
            bone = bone_at.get(_find_parent_path(point))
            if bone is not None and point.find("location") is not None:
                location = read_numbers(point, "location", document.source, count=3)
                moves.append(float(np.linalg.norm(bone.map_point(location) - location)))
        if moves:
            out.append(
                MovedPoints(muscle=force.get("name", ""), points=len(moves), farthest=max(moves))
            )
    return tuple(sorted(out, key=lambda m: -m.farthest))


JOINTS_HEADER = (
    "joint,theirs,verdict,standard_error_left,in,body,shift_x_mm,shift_y_mm,shift_z_mm,moved_mm,"
    "moved_se_mm,turned_deg,turned_se_deg,standing_mm,standing_deg,landmarks_mm"
)


def format_joints_csv(moves: Sequence[JointMove]) -> str:
    """Format a CSV file with a row for both ends of each joint; unknown figures are empty.

    Parameters
    ----------
    moves : sequence of JointMove
        Outcome of each joint.

    Returns
    -------
    str
        Columns `JOINTS_HEADER`.
    """
    lines = [JOINTS_HEADER]
    for move in moves:
        known = f"{move.error_ratio:.3f}" if np.isfinite(move.error_ratio) else ""
        start = f'{move.joint},"{move.theirs}",{move.outcome.name.lower()},{known}'
        for name, end in (("parent", move.parent), ("child", move.child)):
            if end is None:
                continue
            numbers = (
                *(1e3 * end.displacement),
                1e3 * end.moved,
                1e3 * end.errors[0],
                np.degrees(end.rotation),
                np.degrees(end.errors[1]),
                1e3 * move.rolling[0],
                np.degrees(move.rolling[1]),
                1e3 * end.landmarks,
            )
            cells = ",".join(f"{x:.4f}" if np.isfinite(x) else "" for x in numbers)
            lines.append(f'{start},{name},"{end.body}",{cells}')
        if move.parent is None:
            lines.append(start + "," * (JOINTS_HEADER.count(",") - start.count(",")))
    return "\n".join(lines) + "\n"


def format_moved_points_csv(points: Sequence[MovedPoints]) -> str:
    """Format a CSV file with a row for each muscle.

    Parameters
    ----------
    points : sequence of MovedPoints
        Moved points of each muscle.

    Returns
    -------
    str
        Columns `MOVED_POINTS_HEADER`.
    """
    rows = [f'"{m.muscle}",{m.points},{1e3 * m.farthest:.4f}' for m in points]
    return "\n".join([MOVED_POINTS_HEADER, *rows]) + "\n"


MOVED_POINTS_HEADER = "muscle,points,farthest_mm"
