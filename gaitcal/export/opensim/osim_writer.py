r"""Linkage in the form of other programs, and the model as an OpenSim 4 document (`.osim`).

Each joint of the linkage is a sequence of elementary motions (`gaitcal.model.linkage`): constants,
then the coordinates, then constants. With J the joint frame, the pose of the child in the parent is

    X_parent_child(q) = X_parent_J  M_1(q_1) ... M_n(q_n)  X_J_child,

where X_parent_J and X_J_child contain the joint parameters and the zero angles of the ankles.
Coordinates keep sign and zero. In the document each joint is a `CustomJoint` between two
`PhysicalOffsetFrame`s. OpenSim first translates along axes of the parent's joint frame and then
rotates about three axes, each fixed in the frame after the rotation before: the order of our
elements. The talus has no mass, as in our model; it is between bodies with mass, so Simbody can
simulate forwards. Coordinates that are held at zero are `locked`.

Rotations are written as three angles, body-fixed x-y-z in OpenSim, R = Rx(a) Ry(b) Rz(c). With a =
atan2(-R_12, R_22) removed first, Rx(-a) R = Ry(b) Rz(c) gives b and c from well-conditioned pairs:
the three angles reproduce R up to rounding even where a and c are not unique.

Ranges of coordinates are for sliders and documentation. They contain the range of living people and
those of Rajagopal et al. (2016), whose names and signs they have. They are not enforced (OpenSim:
unclamped; MuJoCo: unlimited), because a calibrated linkage may exceed them and must stay the same
mechanical system.

Names of markers and subjects are encoded reversibly for every program that reads the files: OpenSim
refuses white space and `\ / * +` in names, and XML cannot contain control characters. These, and
characters with a meaning in XML or here (`< > & " ' %`), are written as `%XX`, one for each byte of
their UTF-8 form. No name is used as a path.
"""

import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin

from gaitcal.arrays import Array
from gaitcal.io.atomic import write_text_atomically
from gaitcal.model.chain import HALF_TURNS, LinkageModel, get_chain
from gaitcal.model.coordinates import COORDINATE_TABLE, TRANSLATION_RANGES, split_side
from gaitcal.model.linkage import (
    COORDINATES,
    JOINTS,
    SEGMENTS,
    Element,
    Joint,
    Source,
    is_translation,
    make_root_elements,
)
from gaitcal.model.parameters import MASSIVE_SEGMENTS, Parameters, view_as_table
from gaitcal.model.rotations import make_axis_rotation
from gaitcal.model.subject_model import GRAVITY, SubjectModel

GROUND = "ground"
"""Name of the laboratory's frame: x forward, y up, z right."""
DOCUMENT_VERSION = "40000"
"""Version of the oldest OpenSim 4; later ones read it unchanged."""

# ------------------------------------------------------------------------------ joints and segments


@dataclass(frozen=True, kw_only=True)
class JointFrames:
    """Frames of one joint in its two segments, and its motions."""

    name: str
    parent: str  # A segment, or `ground`
    child: str
    in_parent: pin.SE3  # X_parent_J, constant
    motions: tuple[Element, ...]
    """Coordinates in order from parent to child, each along or about an axis of the frame after the
    ones before.
    """
    to_child: pin.SE3  # X_J_child, constant

    @property
    def in_child(self) -> pin.SE3:
        """X_child_J: frame of the joint in its child."""
        return self.to_child.inverse()


@dataclass(frozen=True)
class SegmentInertia:
    """Mass, mass centre and principal moments, about axes parallel to those of the segment."""

    mass: float  # kg; 0 for the talus
    centre: Array  # (3,) m, in the segment frame
    moments: Array  # (3,) kg m^2 about the mass centre


def list_joint_frames(parameters: Parameters) -> tuple[JointFrames, ...]:
    """List all 14 joints of the Pinocchio model, each after the joint of its parent.

    Parameters
    ----------
    parameters : Parameters
        Joint parameters.

    Returns
    -------
    tuple of JointFrames
        The first is that of the pelvis in the laboratory.
    """
    root = Joint("ground_pelvis", GROUND, "pelvis", make_root_elements("pelvis"))
    body = get_chain().body(parameters)
    return tuple(_extract_joint_frames(body, joint) for joint in (root, *JOINTS))


def get_joint_frames(joint: Joint, parameters: Parameters) -> JointFrames:
    """Get one joint of the Pinocchio model."""
    return _extract_joint_frames(
        get_chain(joint.parent, (joint.parent, joint.child)).body(parameters), joint
    )


def _extract_joint_frames(body: LinkageModel, joint: Joint) -> JointFrames:
    """Extract one joint from the placements of a Pinocchio model."""
    moving = [i for i, e in enumerate(joint.elements) if e.source is Source.COORDINATE]
    motions = joint.elements[moving[0] : moving[-1] + 1]
    placements = dict(zip(body.chain.segments, body.segment_placement, strict=True))
    first = body.model.jointPlacements[body.index(motions[0].name) + 1]
    parent = placements.get(joint.parent, pin.SE3.Identity())
    return JointFrames(
        name=joint.name,
        parent=joint.parent,
        child=joint.child,
        in_parent=parent.inverse() * first * _undo_half_turn(motions[0]),
        motions=motions,
        to_child=_undo_half_turn(motions[-1]) * placements[joint.child],
    )


def _undo_half_turn(motion: Element) -> pin.SE3:
    """Undo the half turn by which the Pinocchio model reverses an axis."""
    return pin.SE3(np.eye(3) if motion.sign > 0 else HALF_TURNS[motion.axis], np.zeros(3))


def make_axis_vector(element: Element) -> Array:
    """Make the unit axis of a coordinate, with its sign.

    Parameters
    ----------
    element : Element
        Elementary motion of the linkage.

    Returns
    -------
    (3,) Array
    """
    axis = np.zeros(3)
    axis[element.axis] = element.sign
    return axis


def get_segment_inertia(parameters: Parameters, segment: str) -> SegmentInertia:
    """Get the inertia of one segment.

    Parameters
    ----------
    parameters : Parameters
        Inertial parameters.
    segment : str
        Segment; the talus has no mass.

    Returns
    -------
    SegmentInertia
    """
    if segment not in MASSIVE_SEGMENTS:
        return SegmentInertia(0.0, np.zeros(3), np.zeros(3))
    row = view_as_table(parameters.inertial)[MASSIVE_SEGMENTS.index(segment)]
    return SegmentInertia(float(row[0]), row[1:4], row[4:7])


def convert_to_body_fixed_xyz(rotation: Array) -> Array:
    """Convert a rotation to body-fixed x-y-z angles, as in OpenSim's `orientation`.

    Parameters
    ----------
    rotation : (3, 3) Array
        R = Rx(a) Ry(b) Rz(c).

    Returns
    -------
    (3,) Array
        rad, a, b, c.
    """
    a = np.arctan2(-rotation[1, 2], rotation[2, 2])
    # Ry(b) Rz(c), see the module.
    bc = make_axis_rotation(0, -float(a)) @ rotation
    return np.array([a, np.arctan2(bc[0, 2], bc[2, 2]), np.arctan2(bc[1, 0], bc[1, 1])])


def convert_to_space_fixed_xyz(rotation: Array) -> Array:
    """Convert a rotation to roll, pitch, yaw, as in URDF's `rpy`.

    Parameters
    ----------
    rotation : (3, 3) Array
        R = Rz(yaw) Ry(pitch) Rx(roll).

    Returns
    -------
    (3,) Array
        rad, roll, pitch, yaw.
    """
    return -convert_to_body_fixed_xyz(rotation.T)


def convert_from_body_fixed_xyz(angles: Array) -> Array:
    """Convert body-fixed x-y-z angles to a rotation.

    Parameters
    ----------
    angles : (3,) Array
        rad, a, b, c.

    Returns
    -------
    (3, 3) Array
        Rx(a) Ry(b) Rz(c).
    """
    a, b, c = (float(angle) for angle in angles)
    rotation: Array = make_axis_rotation(0, a) @ make_axis_rotation(1, b) @ make_axis_rotation(2, c)
    return rotation


def _get_range(coordinate: str) -> tuple[float, float]:
    """Get the usual range of a coordinate, m or rad."""
    if is_translation(coordinate):
        return TRANSLATION_RANGES[coordinate]
    low, high = COORDINATE_TABLE[split_side(coordinate)[0]].usual
    return math.radians(low), math.radians(high)


COORDINATE_RANGES = {name: _get_range(name) for name in COORDINATES}
"""Lowest and highest usual value of every coordinate, m or rad."""

# -------------------------------------------------------------------------- names, numbers and text

_ESCAPED = frozenset("\\/*+%<>&\"'")
_EMPTY = "%"


def encode_name(name: str) -> str:
    """Encode troublesome characters as `%XX`; never empty, and different names stay different.

    Parameters
    ----------
    name : str
        Name of a marker, subject or trial.

    Returns
    -------
    str
    """
    out = ""
    for character in name:
        if character.isprintable() and not character.isspace() and character not in _ESCAPED:
            out += character
        else:
            octets = character.encode("utf-8", errors="surrogatepass")
            out += "".join(f"%{byte:02X}" for byte in octets)
    return out or _EMPTY


def decode_name(name: str) -> str:
    """Decode a name that `encode_name` made; any other name stays."""
    return "" if name == _EMPTY else re.sub("(?:%[0-9A-F]{2})+", _unescape, name)


def _unescape(match: re.Match[str]) -> str:
    """Decode one row of bytes; bytes that are not UTF-8 stay."""
    try:
        return bytes.fromhex(match.group().replace("%", "")).decode("utf-8", errors="surrogatepass")
    except UnicodeDecodeError:
        return match.group()


def format_numbers(values: Iterable[float]) -> str:
    """Format numbers with blanks between, as many digits as needed, and no negative zeros."""
    return " ".join(repr(float(value) + 0.0) for value in values)


def strip_control_characters(text: str) -> str:
    """Replace characters that XML cannot contain by U+FFFD. Markup is escaped on writing."""
    return "".join(
        c if c.isprintable() or c in "\n\t" else "\N{REPLACEMENT CHARACTER}" for c in text
    )


def add_child(
    parent: ET.Element, tag: str, text: str | None = None, **attributes: str
) -> ET.Element:
    """Add a child element to `parent`."""
    element = ET.SubElement(parent, tag, attributes)
    element.text = text
    return element


def write_xml(root: ET.Element, path: Path | str) -> None:
    """Write an indented UTF-8 document, completely or not at all.

    Parameters
    ----------
    root : ET.Element
        Root of the document.
    path : Path or str
        File to write.
    """
    ET.indent(root)
    text = ET.tostring(root, encoding="unicode")
    write_text_atomically(path, f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n')


# ------------------------------------------------------------------------------------- the document


def write_osim(model: SubjectModel, path: Path | str) -> None:
    """Write the model for OpenSim 4.0 or newer: m, kg, rad; y up; the same coordinates q as ours.

    Parameters
    ----------
    model : SubjectModel
        Model; names of markers and of the subject are written by `encode_name`.
    path : Path or str
        File to write (.osim).
    """
    document = ET.Element("OpenSimDocument", Version=DOCUMENT_VERSION)
    top = add_child(document, "Model", name=encode_name(model.subject.name))
    add_child(top, "Ground", name=GROUND)
    add_child(top, "gravity", format_numbers((0.0, -GRAVITY, 0.0)))
    add_child(
        top, "credits", strip_control_characters(" ".join(("Written by gaitcal.", *model.notes)))
    )
    add_child(top, "length_units", "meters")
    add_child(top, "force_units", "N")
    bodies = add_child(add_child(top, "BodySet", name="bodyset"), "objects")
    for segment in SEGMENTS:
        inertia = get_segment_inertia(model.parameters, segment)
        body = add_child(bodies, "Body", name=segment)
        add_child(body, "mass", format_numbers([inertia.mass]))
        add_child(body, "mass_center", format_numbers(inertia.centre))
        add_child(body, "inertia", format_numbers([*inertia.moments, 0.0, 0.0, 0.0]))
    joints = add_child(add_child(top, "JointSet", name="jointset"), "objects")
    for joint in list_joint_frames(model.parameters):
        _add_joint(joints, joint, model.locked)
    objects = add_child(add_child(top, "MarkerSet", name="markerset"), "objects")
    markers = model.markers
    for label, segment, local in zip(markers.labels, markers.segments, markers.local, strict=True):
        marker = add_child(objects, "Marker", name=encode_name(label))
        add_child(marker, "socket_parent_frame", f"/bodyset/{segment}")
        add_child(marker, "location", format_numbers(local))
        add_child(marker, "fixed", "true")
    write_xml(document, path)


def _add_joint(joints: ET.Element, frames: JointFrames, frozen: tuple[str, ...]) -> None:
    """Add a joint with its coordinates, offset frames and transform."""
    joint = add_child(joints, "CustomJoint", name=frames.name)
    in_parent, in_child = f"{frames.parent}_offset", f"{frames.child}_offset"
    add_child(joint, "socket_parent_frame", in_parent)
    add_child(joint, "socket_child_frame", in_child)
    # OpenSim lists rotations before translations.
    coordinates = add_child(joint, "coordinates")
    for motion in sorted(frames.motions, key=lambda m: not m.rotates):
        coordinate = add_child(coordinates, "Coordinate", name=motion.name)
        add_child(coordinate, "default_value", "0")
        add_child(coordinate, "default_speed_value", "0")
        add_child(coordinate, "range", format_numbers(COORDINATE_RANGES[motion.name]))
        add_child(coordinate, "clamped", "false")
        add_child(coordinate, "locked", "true" if motion.name in frozen else "false")
    offsets = add_child(joint, "frames")
    ground = "/ground" if frames.parent == GROUND else f"/bodyset/{frames.parent}"
    for name, parent, place in (
        (in_parent, ground, frames.in_parent),
        (in_child, f"/bodyset/{frames.child}", frames.in_child),
    ):
        frame = add_child(offsets, "PhysicalOffsetFrame", name=name)
        add_child(frame, "socket_parent", parent)
        add_child(frame, "translation", format_numbers(place.translation))
        add_child(frame, "orientation", format_numbers(convert_to_body_fixed_xyz(place.rotation)))
    transform = add_child(joint, "SpatialTransform")
    _add_axes(transform, "rotation", [m for m in frames.motions if m.rotates])
    _add_axes(transform, "translation", [m for m in frames.motions if not m.rotates])


def _add_axes(transform: ET.Element, kind: str, motions: list[Element]) -> None:
    """Add three axes of the transform: those of the coordinates, then the remaining, fixed ones."""
    used = {motion.axis for motion in motions}
    idle = [axis for axis in range(3) if axis not in used]
    for number in range(3):
        axis = add_child(transform, "TransformAxis", name=f"{kind}{number + 1}")
        if number < len(motions):
            add_child(axis, "coordinates", motions[number].name)
            add_child(axis, "axis", format_numbers(make_axis_vector(motions[number])))
            add_child(add_child(axis, "LinearFunction", name="function"), "coefficients", "1 0")
        else:
            add_child(axis, "coordinates")
            add_child(axis, "axis", format_numbers(np.eye(3)[idle[number - len(motions)]]))
            add_child(add_child(axis, "Constant", name="function"), "value", "0")
