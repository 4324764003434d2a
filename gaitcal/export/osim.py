r"""The model as an OpenSim 4 document (`.osim`).

Ground and 14 bodies named as our segments; each joint a `CustomJoint` between two `PhysicalOffsetFrame`s that stand
where the joint parameters say; the 27 coordinates with our names, signs and zeros; the markers as `MarkerSet`.
OpenSim's `CustomJoint` first translates along axes of the parent's joint frame and then turns about three axes, each
fixed in the frame left by the turn before: the order of our elements.

Inverse kinematics and inverse dynamics need nothing more. The talus has no mass, as in our model; it lies between
bodies with mass, so Simbody can simulate forwards, too. Coordinates that are held at zero are `locked`.

Names, numbers and text as they stand in the exported files.

Names of markers and subjects are data, and are made fit for every program that reads the files, reversibly: OpenSim
refuses white space and `\ / * +` in names; XML cannot hold control characters at all. Such characters, and those that
mean something in XML or here (`< > & " ' %`), are written as `%XX`, one per byte of their UTF-8 form. Everything else
is kept, so that an ordinary label such as `R.ASIS` or `Hüfte` is the same in the model and in the marker file. No name
is ever used as a path.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from pathlib import Path

import pinocchio as pin

from gaitcal.export.joint_frames import (
    COORDINATE_RANGES,
    GROUND,
    JointFrames,
    axis_vector,
    body_fixed_xyz,
    joint_frames,
    segment_inertia,
)
from gaitcal.io.atomic import atomic_text
from gaitcal.model.linkage import SEGMENTS, Element
from gaitcal.model.subject_model import GRAVITY, MarkerPlacement, SubjectModel

INDENT = "  "
_ESCAPED = frozenset("\\/*+%<>&\"'")
_EMPTY = "%"


def safe_name(name: str) -> str:
    """`name` with every troublesome character as `%XX`; never empty; different names stay different."""
    if not name:
        return _EMPTY
    return "".join(c if _is_plain(c) else _escape(c) for c in name)


def original_name(name: str) -> str:
    """The name that `safe_name` was given; a name that it cannot have written comes back as it is."""
    if name == _EMPTY:
        return ""
    return re.sub("(?:%[0-9A-F]{2})+", _unescape, name)


def _is_plain(character: str) -> bool:
    return character.isprintable() and not character.isspace() and character not in _ESCAPED


def _escape(character: str) -> str:
    return "".join(f"%{byte:02X}" for byte in character.encode("utf-8", errors="surrogatepass"))


def _unescape(match: re.Match[str]) -> str:
    try:
        return bytes.fromhex(match.group().replace("%", "")).decode("utf-8", errors="surrogatepass")
    except UnicodeDecodeError:
        return match.group()


def numbers(values: Iterable[float]) -> str:
    """Numbers separated by blanks, each with as many digits as bring it back exactly; no negative zeros."""
    return " ".join(repr(float(value) + 0.0) for value in values)


def plain_text(text: str) -> str:
    """`text` without the characters that XML cannot hold: they become U+FFFD. Markup is escaped on writing."""
    return "".join(c if c.isprintable() or c in "\n\t" else "\N{REPLACEMENT CHARACTER}" for c in text)


def child(parent: ET.Element, tag: str, text: str | None = None, **attributes: str) -> ET.Element:
    """A new child element of `parent`."""
    element = ET.SubElement(parent, tag, attributes)
    element.text = text
    return element


def write_xml(root: ET.Element, path: Path | str) -> None:
    """Write an indented UTF-8 document, whole or not at all."""
    ET.indent(root, INDENT)
    text = ET.tostring(root, encoding="unicode")
    atomic_text(path, f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n')


DOCUMENT_VERSION = "40000"
"""Of the oldest OpenSim 4; later versions read it unchanged."""

_UNIT_AXES = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def write_osim(model: SubjectModel, path: Path | str) -> None:
    """Write `model` for OpenSim 4.0 or newer: m, kg, rad; y up; same coordinates q as ours.

    Names of markers and of the subject are written by `safe_name`.
    """
    document = ET.Element("OpenSimDocument", Version=DOCUMENT_VERSION)
    top = child(document, "Model", name=safe_name(model.subject.name))
    child(top, "Ground", name=GROUND)
    child(top, "gravity", numbers((0.0, -GRAVITY, 0.0)))
    child(top, "credits", plain_text(" ".join(("Written by gaitcal.", *model.notes))))
    child(top, "length_units", "meters")
    child(top, "force_units", "N")
    bodies = child(child(top, "BodySet", name="bodyset"), "objects")
    for segment in SEGMENTS:
        _add_body(bodies, model, segment)
    joints = child(child(top, "JointSet", name="jointset"), "objects")
    for joint in joint_frames(model.parameters):
        _add_joint(joints, joint, model.locked)
    _add_markers(child(child(top, "MarkerSet", name="markerset"), "objects"), model.markers)
    write_xml(document, path)


def _add_body(bodies: ET.Element, model: SubjectModel, segment: str) -> None:
    inertia = segment_inertia(model.parameters, segment)
    body = child(bodies, "Body", name=segment)
    child(body, "mass", numbers([inertia.mass]))
    child(body, "mass_center", numbers(inertia.centre))
    child(body, "inertia", numbers([*inertia.moments, 0.0, 0.0, 0.0]))


def _add_joint(joints: ET.Element, frames: JointFrames, frozen: tuple[str, ...]) -> None:
    joint = child(joints, "CustomJoint", name=frames.name)
    in_parent, in_child = f"{frames.parent}_offset", f"{frames.child}_offset"
    child(joint, "socket_parent_frame", in_parent)
    child(joint, "socket_child_frame", in_child)
    coordinates = child(joint, "coordinates")
    for motion in sorted(frames.motions, key=lambda m: not m.rotates):
        coordinate = child(coordinates, "Coordinate", name=motion.name)
        child(coordinate, "default_value", "0")
        child(coordinate, "default_speed_value", "0")
        child(coordinate, "range", numbers(COORDINATE_RANGES[motion.name]))
        child(coordinate, "clamped", "false")
        child(coordinate, "locked", "true" if motion.name in frozen else "false")
    offsets = child(joint, "frames")
    ground = "/ground" if frames.parent == GROUND else f"/bodyset/{frames.parent}"
    _add_offset(offsets, in_parent, ground, frames.in_parent)
    _add_offset(offsets, in_child, f"/bodyset/{frames.child}", frames.in_child)
    transform = child(joint, "SpatialTransform")
    _add_axes(transform, "rotation", [m for m in frames.motions if m.rotates])
    _add_axes(transform, "translation", [m for m in frames.motions if not m.rotates])


def _add_offset(offsets: ET.Element, name: str, parent: str, place: pin.SE3) -> None:
    frame = child(offsets, "PhysicalOffsetFrame", name=name)
    child(frame, "socket_parent", parent)
    child(frame, "translation", numbers(place.translation))
    child(frame, "orientation", numbers(body_fixed_xyz(place.rotation)))


def _add_axes(transform: ET.Element, kind: str, motions: list[Element]) -> None:
    """Three axes of the transform: those of the coordinates, then the axes left over, which do not move."""
    taken = {m.axis for m in motions}
    idle = [axis for axis in range(3) if axis not in taken]
    for number in range(3):
        axis = child(transform, "TransformAxis", name=f"{kind}{number + 1}")
        if number < len(motions):
            motion = motions[number]
            child(axis, "coordinates", motion.name)
            child(axis, "axis", numbers(axis_vector(motion)))
            child(child(axis, "LinearFunction", name="function"), "coefficients", "1 0")
        else:
            child(axis, "coordinates")
            child(axis, "axis", numbers(_UNIT_AXES[idle[number - len(motions)]]))
            child(child(axis, "Constant", name="function"), "value", "0")


def _add_markers(objects: ET.Element, markers: MarkerPlacement) -> None:
    for label, segment, local in zip(markers.labels, markers.segments, markers.local, strict=True):
        marker = child(objects, "Marker", name=safe_name(label))
        child(marker, "socket_parent_frame", f"/bodyset/{segment}")
        child(marker, "location", numbers(local))
        child(marker, "fixed", "true")
