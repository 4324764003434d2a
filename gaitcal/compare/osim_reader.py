"""Reading an OpenSim model of either generation (3.x, 4.x) into a `PeerModel`. No OpenSim is needed."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pinocchio as pin

from gaitcal.arrays import Array
from gaitcal.codes import Code
from gaitcal.compare.peer_model import (
    OtherModelError,
    PeerAxis,
    PeerCoordinate,
    PeerJoint,
    PeerModel,
    read_function,
    read_numbers,
)
from gaitcal.errors import InputError
from gaitcal.export.osim import from_body_fixed_xyz, original_name

_X, _Y, _Z = (np.eye(3)[i] for i in range(3))
_SIMPLE: dict[str, tuple[tuple[bool, Array], ...]] = {
    "WeldJoint": (),
    "PinJoint": ((True, _Z),),
    "SliderJoint": ((False, _X),),
    "UniversalJoint": ((True, _X), (True, _Y)),
    "GimbalJoint": ((True, _X), (True, _Y), (True, _Z)),
    "BallJoint": ((True, _X), (True, _Y), (True, _Z)),
    "PlanarJoint": ((True, _Z), (False, _X), (False, _Y)),
    "FreeJoint": ((True, _X), (True, _Y), (True, _Z), (False, _X), (False, _Y), (False, _Z)),
}
"""Kinds of joints whose axes are fixed, in the order of their coordinates."""


def read_osim(path: Path | str) -> PeerModel:
    """Bodies, joints and markers of an OpenSim model file.

    Raises
    ------
    InputError
        The file cannot be read, is no OpenSim model, or holds something that is not understood.
    """
    path = Path(path)
    try:
        root = ET.parse(path).getroot()
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", source=path, code=Code.UNREADABLE) from None
    except (ET.ParseError, ValueError, LookupError) as error:
        raise OtherModelError(f"is not well-formed XML: {error}", source=path) from None
    model = root.find("Model") if root.tag == "OpenSimDocument" else None
    if model is None:
        raise OtherModelError(
            f"found <{root.tag}>, expected <OpenSimDocument> with <Model>; a model file (.osim) is needed", source=path
        )
    masses: dict[str, float] = {}
    joints: dict[str, PeerJoint] = {}
    for body in model.findall("BodySet/objects/Body"):
        name = body.get("name", "")
        masses[name] = float(read_numbers(body, "mass", path, count=1)[0])
        for element in body.findall("Joint/*"):
            joints[name] = _joint(element, path, name)
    for element in model.findall("JointSet/objects/*"):
        joint = _joint(element, path)
        joints[joint.child] = joint
    masses.pop("ground", None)
    if not masses or not joints:
        raise OtherModelError("found no bodies or no joints", source=path)
    return PeerModel(str(path), masses, joints, _markers(model, path))


def _markers(model: ET.Element, path: Path) -> dict[str, tuple[str, Array]]:
    markers: dict[str, tuple[str, Array]] = {}
    for marker in model.findall("MarkerSet/objects/Marker"):
        frame = _named(marker, "socket_parent_frame") or marker.findtext("body") or ""
        body = frame.strip().rpartition("/")[2]
        markers[original_name(marker.get("name", ""))] = (body, read_numbers(marker, "location", path, count=3))
    return markers


def _joint(element: ET.Element, path: Path, child: str | None = None) -> PeerJoint:
    """A joint of OpenSim 4 with its frames; with `child` one of OpenSim 3, which stands inside that body."""
    frames = {f.get("name", ""): f for f in element.findall("frames/PhysicalOffsetFrame")}

    def end(socket: str) -> tuple[str, pin.SE3]:
        body = _named(element, socket).rpartition("/")[2]
        if body not in frames:
            return body, pin.SE3.Identity()
        owner = _named(frames[body], "socket_parent")
        return owner.rpartition("/")[2], _place(frames[body], "translation", "orientation", path)

    if child is None:
        (parent, in_parent), (child, in_child) = end("socket_parent_frame"), end("socket_child_frame")
    else:
        parent = (element.findtext("parent_body") or "").strip()
        in_parent = _place(element, "location_in_parent", "orientation_in_parent", path)
        in_child = _place(element, "location", "orientation", path)
    coordinates = tuple(_coordinate(c, path) for c in element.iter("Coordinate"))
    return PeerJoint(
        name=element.get("name", ""),
        kind=element.tag,
        parent=parent,
        child=child,
        in_parent=in_parent,
        in_child=in_child,
        coordinates=coordinates,
        axes=_axes(element, coordinates, path),
    )


def _named(element: ET.Element, socket: str) -> str:
    """What a socket is connected to; its element is spelt otherwise in the betas of OpenSim 4."""
    beta = f"{socket}_connectee_name"
    texts = ((element.findtext(tag) or "").strip() for tag in (socket, beta, beta.replace("socket_", "connector_", 1)))
    return next(filter(None, texts), "")


def _place(element: ET.Element, translation: str, orientation: str, path: Path) -> pin.SE3:
    angles = read_numbers(element, orientation, path, count=3)
    return pin.SE3(from_body_fixed_xyz(angles), read_numbers(element, translation, path, count=3))


def _axes(element: ET.Element, coordinates: tuple[PeerCoordinate, ...], path: Path) -> tuple[PeerAxis, ...] | None:
    if element.tag in _SIMPLE:
        kinds = _SIMPLE[element.tag]
        names = [c.name for c in coordinates] + [None] * len(kinds)
        return tuple(PeerAxis(turn, axis, names[i], float) for i, (turn, axis) in enumerate(kinds))
    if element.tag != "CustomJoint":
        return None
    axes = []
    for entry in element.findall("SpatialTransform/TransformAxis"):
        words = (entry.findtext("coordinates") or "").split()
        function = read_function(entry, path)
        if function is None or len(words) > 1:
            return None
        vector = read_numbers(entry, "axis", path, count=3) if (entry.findtext("axis") or "").strip() else _X
        length = float(np.linalg.norm(vector))
        if length == 0.0:
            raise OtherModelError("found an axis of length zero", source=path, field=element.get("name"))
        rotates = entry.get("name", "").startswith("rotation")
        axes.append(PeerAxis(rotates, vector / length, words[0] if words else None, function))
    return tuple(axes)


def _coordinate(element: ET.Element, path: Path) -> PeerCoordinate:
    low, high = read_numbers(element, "range", path, count=2)
    default = float(read_numbers(element, "default_value", path, count=1)[0])
    locked = (element.findtext("locked") or "").strip() == "true"
    return PeerCoordinate(
        name=element.get("name", ""), default=default, low=float(low), high=float(high), locked=locked
    )
