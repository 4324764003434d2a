"""OpenSim model files of both generations (3.x, 4.x), read and edited without OpenSim.

A file is parsed once, with the positions of the tags of every element. Edits replace the numbers of
joints, bodies and points in the text; all other bytes stay. The frames of a joint in its two bodies
are `PhysicalOffsetFrame`s (OpenSim 4) or elements of the joint (OpenSim 3). Where there is no
frame, or no number in it, text is inserted.
"""

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

import numpy as np
import pinocchio as pin

from gaitcal.arrays import Array
from gaitcal.errors import Code, InputError
from gaitcal.export.opensim.osim_writer import (
    convert_from_body_fixed_xyz,
    convert_to_body_fixed_xyz,
    decode_name,
    format_numbers,
)
from gaitcal.export.opensim.peer_model import (
    PeerAxis,
    PeerCoordinate,
    PeerJoint,
    PeerModel,
    read_function,
    read_numbers,
)

_TAG = re.compile(rb"""<(?:[^<>"']|"[^"]*"|'[^']*')*>""")
_BLANK = re.compile(rb"\s*")
TAGS_3 = {
    "parent": ("location_in_parent", "orientation_in_parent"),
    "child": ("location", "orientation"),
}
"""Body -> elements with a joint's frame in it, in OpenSim 3."""
INERTIA_TAGS = ("inertia", *(f"inertia_{a}" for a in ("xx", "yy", "zz", "xy", "xz", "yz")))
"""Moments of inertia of a body, of OpenSim 4 and 3."""
TAGS_4 = ("translation", "orientation")
"""Elements of a frame in OpenSim 4."""


@dataclass(frozen=True)
class _Span:
    """Positions of an element in the bytes of its file."""

    start: int
    inside: int
    """After the first tag."""
    end: int
    """Before the last tag; equal to `inside` where the only tag closes itself."""

    def is_self_closing(self, content: bytes) -> bool:
        """Check whether the only tag of the element closes itself."""
        return content[self.inside - 2 : self.inside] == b"/>"


@dataclass(frozen=True)
class FramePlacement:
    """Frame of a joint in a body; None for what stays."""

    translation: Array | None  # (3,) m
    rotation: Array | None  # (3, 3)


@dataclass(frozen=True)
class BodyMass:
    """New mass, mass centre and inertia of a body."""

    mass: float  # kg
    centre: Array | None  # (3,) m, in the body; None: it stays
    inertia: float  # factor of the moments of inertia


@dataclass(frozen=True)
class OsimDocument:
    """Model file as it was read."""

    source: Path
    content: bytes
    model: ET.Element
    """Element `<Model>`."""
    _spans: dict[ET.Element, _Span] = field(repr=False)

    def find_joint(self, name: str) -> ET.Element:
        """Find the element of a joint."""
        return next(e for e in self.list_joints() if e.get("name", "") == name)

    def find_body(self, name: str) -> ET.Element:
        """Find the element of a body.

        `name`: name of a body of the model.
        """
        bodies = self.model.findall("BodySet/objects/Body")
        return next(e for e in bodies if e.get("name", "") == name)

    def list_frames(self, name: str) -> Iterator[tuple[str, pin.SE3, ET.Element]]:
        """List a body and the offset frames in it (OpenSim 4).

        Parameters
        ----------
        name : str
            Name of the body.

        Yields
        ------
        tuple
            Path from the body on, pose in the body (m), element.
        """
        waiting = [(name, pin.SE3.Identity(), self.find_body(name))]
        while waiting:
            path, pose, element = waiting.pop()
            yield path, pose, element
            # Frames in frames: the parent is the element itself, by name or by `..`.
            parents = ("..", path.rpartition("/")[2])
            for frame in element.findall("components/PhysicalOffsetFrame"):
                if _read_socket(frame, "socket_parent").rpartition("/")[2] in parents:
                    in_body = pose * _read_pose(frame, *TAGS_4, self.source)
                    waiting.append((f"{path}/{frame.get('name', '')}", in_body, frame))

    def read_mass_centre(self, name: str) -> Array:
        """Read the mass centre (3,) m of a body, in the body."""
        return read_numbers(self.find_body(name), "mass_center", self.source, count=3)

    def list_joints(self) -> Iterator[ET.Element]:
        """List all joints of a file of either generation."""
        yield from self.model.findall("BodySet/objects/Body/Joint/*")
        yield from self.model.findall("JointSet/objects/*")

    def list_attached_elements(self, joint: str) -> list[str]:
        """List elements that are fixed to a frame of this joint and move with it.

        Parameters
        ----------
        joint : str
            Name of the joint.

        Returns
        -------
        list of str
            Names of the elements.
        """
        elements = self.find_joint(joint).findall("frames/*")
        frames = tuple({f"{joint}/{frame.get('name')}" for frame in elements})
        out = []
        for element in self.model.iter():
            for child in element:
                is_socket = child.tag.startswith("socket_")
                if is_socket and (child.text or "").strip().endswith(frames):
                    out.append(element.get("name", element.tag))
        return out

    def apply_changes(
        self,
        places: Mapping[tuple[str, str], FramePlacement],
        weights: Mapping[str, BodyMass] | None = None,
        further: Iterable[tuple[ET.Element, Sequence[str], Sequence[Array]]] = (),
        meshes: Mapping[str, pin.SE3] | None = None,
    ) -> bytes:
        """Write the file with moved joints, new masses and moved attachments.

        Parameters
        ----------
        places : mapping
            (joint, `parent` or `child`) -> frame in that body.
        weights : mapping, optional
            Body -> mass, mass centre, inertia.
        further : iterable of tuple
            Elements, names of their children, and new numbers of these.
        meshes : mapping, optional
            Body -> rigid motion of its meshes, in the body.

        Returns
        -------
        bytes
            Content of the file; bytes that are not concerned stay.
        """
        edits = _Edits(self)
        for (name, end), place in places.items():
            edits.place_joint(self.find_joint(name), end, place)
        for body, weight in (weights or {}).items():
            edits.replace_mass(self.find_body(body), weight)
        for element, tags, values in further:
            edits.replace_numbers(element, tags, values)
        for body, motion in (meshes or {}).items():
            for _, frame, element in self.list_frames(body):
                edits.move_meshes(element, frame.actInv(motion * frame))
        return edits.apply()


@dataclass
class _Edits:
    """Replacements of stretches of bytes that do not overlap."""

    document: OsimDocument
    found: list[tuple[int, int, bytes]] = field(default_factory=list)
    new_frames: dict[ET.Element, list[str]] = field(default_factory=dict)

    def place_joint(self, joint: ET.Element, end: str, place: FramePlacement) -> None:
        """Replace the frame of a joint in one body; insert one where it has none."""
        angles = None if place.rotation is None else convert_to_body_fixed_xyz(place.rotation)
        values = (place.translation, angles)
        # OpenSim 3: the joint contains the numbers.
        if joint.find("location_in_parent") is not None or joint.find("parent_body") is not None:
            self.replace_numbers(joint, TAGS_3[end], values)
            return
        socket = find_socket(joint, f"socket_{end}_frame")
        connected = "" if socket is None else (socket.text or "").strip()
        connected_name = connected.rpartition("/")[2]
        frames = joint.findall("frames/*")
        frame = next((f for f in frames if f.get("name") == connected_name), None)
        if frame is not None:
            self.replace_numbers(frame, TAGS_4, values)
        elif socket is not None:
            # The joint is connected to the body itself: insert a frame in between.
            name = f"{connected_name}_{end}_offset"
            span = self.document._spans[socket]
            self.found.append((span.inside, span.end, name.encode()))
            body = connected if connected.startswith("/") else f"/bodyset/{connected}"
            inside = f"<socket_parent>{body}</socket_parent>"
            for tag, numbers in zip(TAGS_4, values, strict=True):
                if numbers is not None:
                    inside += f"<{tag}>{format_numbers(numbers)}</{tag}>"
            frame_text = f'<PhysicalOffsetFrame name="{name}">{inside}</PhysicalOffsetFrame>'
            self.new_frames.setdefault(joint, []).append(frame_text)

    def replace_mass(self, body: ET.Element, weight: BodyMass) -> None:
        """Replace mass and mass centre, and scale the moments of inertia."""
        source = self.document.source
        self.replace_numbers(
            body, ("mass", "mass_center"), (np.array([weight.mass]), weight.centre)
        )
        for tag in INERTIA_TAGS:
            if body.find(tag) is not None and weight.inertia != 1.0:
                self.replace_numbers(
                    body, (tag,), (weight.inertia * read_numbers(body, tag, source),)
                )

    def move_meshes(self, body: ET.Element, pose: pin.SE3) -> None:
        """Move the meshes of a body or of an offset frame in it.

        In OpenSim 4 they go into a further frame, in OpenSim 3 they get another transform.
        """
        content, spans = self.document.content, self.document._spans
        # OpenSim 3: angles and translation in one element.
        for mesh in body.findall("VisibleObject/GeometrySet/objects/DisplayGeometry"):
            old = read_numbers(mesh, "transform", self.document.source, count=6)
            new = pose * pin.SE3(convert_from_body_fixed_xyz(old[:3]), old[3:])
            transform = np.concatenate([convert_to_body_fixed_xyz(new.rotation), new.translation])
            self.replace_numbers(mesh, ("transform",), (transform,))
        geometry = body.find("attached_geometry")
        if geometry is None or not len(geometry):
            return
        # OpenSim 4: a new frame takes over the element with the meshes.
        span, holder = spans[geometry], body.find("components")
        text = f'<PhysicalOffsetFrame name="{body.get("name")}_meshes">'
        text += "<socket_parent>..</socket_parent>"
        numbers = (pose.translation, convert_to_body_fixed_xyz(pose.rotation))
        for tag, values in zip(TAGS_4, numbers, strict=True):
            text += f"<{tag}>{format_numbers(values)}</{tag}>"
        end = content.index(b">", span.end) + 1
        frame = b"".join([text.encode(), content[span.start : end], b"</PhysicalOffsetFrame>"])
        if holder is None or spans[holder].is_self_closing(content):
            frame = b"<components>" + frame + b"</components>"
        if holder is not None:
            outer = spans[holder]
            start = outer.start if outer.is_self_closing(content) else outer.inside
            self.found.append((start, outer.inside, frame))
            frame = b""
        self.found.append((span.start, end, frame))

    def replace_numbers(
        self, holder: ET.Element, tags: Sequence[str], all_values: Sequence[Array | None]
    ) -> None:
        """Replace the numbers in children of an element; insert missing children."""
        for tag, values in zip(tags, all_values, strict=True):
            if values is None:
                continue
            element, content = holder.find(tag), self.document.content
            span = self.document._spans[holder if element is None else element]
            text = format_numbers(values)
            whole = f"<{tag}>{text}</{tag}>".encode()
            if element is None:
                # After the first tag of its holder, with the same indentation as what follows.
                blank = _BLANK.match(content, span.inside)
                lead = blank.group() if blank else b""
                self.found.append((span.inside, span.inside, lead + whole))
            elif span.is_self_closing(content):
                self.found.append((span.start, span.inside, whole))
            else:
                self.found.append((span.inside, span.end, text.encode()))

    def apply(self) -> bytes:
        """Apply all replacements."""
        content, spans = self.document.content, self.document._spans
        for joint, frames in self.new_frames.items():
            text, holder = "".join(frames), joint.find("frames")
            whole = f"<frames>{text}</frames>".encode()
            if holder is None:
                inside = spans[joint].inside
                self.found.append((inside, inside, whole))
            elif spans[holder].is_self_closing(content):
                self.found.append((spans[holder].start, spans[holder].inside, whole))
            else:
                self.found.append((spans[holder].inside, spans[holder].inside, text.encode()))
        parts, last = list[bytes](), 0
        for start, end, replacement in sorted(self.found, key=lambda e: e[:2]):
            parts += [content[last:start], replacement]
            last = end
        return b"".join([*parts, content[last:]])


def find_socket(element: ET.Element, socket: str) -> ET.Element | None:
    """Find the element that names what a socket is connected to.

    Betas of OpenSim 4 spell it differently.

    Parameters
    ----------
    element : ET.Element
        Element with the socket.
    socket : str
        Name of the socket: `socket_parent_frame`.

    Returns
    -------
    ET.Element or None
    """
    beta = f"{socket}_connectee_name"
    for tag in (socket, beta, beta.replace("socket_", "connector_", 1)):
        found = element.find(tag)
        if found is not None and (found.text or "").strip():
            return found
    return None


def read_document(path: Path | str) -> OsimDocument:
    """Read an OpenSim model file for editing.

    Parameters
    ----------
    path : Path or str
        Model file (.osim).

    Returns
    -------
    OsimDocument

    Raises
    ------
    InputError
        The file cannot be read or is no OpenSim model.
    """
    path = Path(path)

    def make_error(message: str, code: Code = Code.OTHER_MODEL) -> InputError:
        return InputError(message, source=path, code=code)

    try:
        content = path.read_bytes()
    except OSError as error:
        raise make_error(f"cannot be read: {error.strerror}", Code.UNREADABLE) from None
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise make_error("found UTF-16 text; save the file as UTF-8", Code.NOT_TEXT)
    try:
        root, spans = _parse(content)
    except (expat.ExpatError, ValueError, LookupError) as error:
        raise make_error(f"is not well-formed XML: {error}") from None
    model = root.find("Model") if root.tag == "OpenSimDocument" else None
    if model is None:
        raise make_error(
            f"found <{root.tag}>, expected <OpenSimDocument> with <Model>; a model file (.osim) is "
            "needed"
        )
    return OsimDocument(path, content, model, spans)


def _parse(content: bytes) -> tuple[ET.Element, dict[ET.Element, _Span]]:
    """Parse the content: the root element, and the position of every element."""
    parser, builder = expat.ParserCreate(), ET.TreeBuilder()
    parser.buffer_text = True
    spans: dict[ET.Element, _Span] = {}
    # The file is edited as bytes, so that everything that is not changed stays as it is: the
    # position of every element is needed.
    opened: list[tuple[ET.Element, int, int]] = []

    def open_element(tag: str, attributes: dict[str, str]) -> None:
        at = parser.CurrentByteIndex
        whole = _TAG.match(content, at)
        if whole is None:
            raise ValueError("a tag could not be found again")
        opened.append((builder.start(tag, attributes), at, whole.end()))

    def close_element(tag: str) -> None:
        builder.end(tag)
        element, at, inside = opened.pop()
        # A tag that closes itself ends where its content would begin.
        alone = content[inside - 2 : inside] == b"/>"
        spans[element] = _Span(at, inside, inside if alone else parser.CurrentByteIndex)

    parser.StartElementHandler, parser.EndElementHandler = open_element, close_element
    parser.CharacterDataHandler = builder.data
    parser.Parse(content, True)
    return builder.close(), spans


# -------------------------------------------------------------------- bodies, joints and markers

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
    """Read bodies, joints and markers of an OpenSim model file.

    Parameters
    ----------
    path : Path or str
        Model file (.osim).

    Returns
    -------
    PeerModel

    Raises
    ------
    InputError
        The file cannot be read, is no OpenSim model, or contains something unknown.
    """
    return build_peer_model(read_document(path))


def build_peer_model(document: OsimDocument) -> PeerModel:
    """Build bodies, joints and markers from a document.

    Parameters
    ----------
    document : OsimDocument
        Model file as it was read.

    Returns
    -------
    PeerModel

    Raises
    ------
    InputError
        The document contains something unknown.
    """
    model, path = document.model, document.source
    masses: dict[str, float] = {}
    joints: dict[str, PeerJoint] = {}
    for body in model.findall("BodySet/objects/Body"):
        name = body.get("name", "")
        masses[name] = float(read_numbers(body, "mass", path, count=1)[0])
        for element in body.findall("Joint/*"):
            joints[name] = _read_joint(element, path, name)
    # OpenSim 4 lists joints by themselves, OpenSim 3 within the child body.
    for element in model.findall("JointSet/objects/*"):
        joint = _read_joint(element, path)
        joints[joint.child] = joint
    for joint in joints.values():
        missing = {joint.parent, joint.child} - masses.keys() - {"ground"}
        if missing:
            message = f"found no body {', '.join(sorted(missing))}, which it joins"
            raise InputError(
                message, source=path, field=f"joint {joint.name}", code=Code.OTHER_MODEL
            )
    masses.pop("ground", None)
    if not masses or not joints:
        raise InputError("found no bodies or no joints", source=path, code=Code.OTHER_MODEL)
    return PeerModel(str(path), masses, joints, _read_markers(document, masses))


def _read_markers(document: OsimDocument, bodies: Iterable[str]) -> dict[str, tuple[str, Array]]:
    """Read label -> body and position (3,) m in it."""
    markers: dict[str, tuple[str, Array]] = {}
    offset = {
        path: (body, pose)
        for body in bodies
        for path, pose, _ in document.list_frames(body)
        if path != body
    }
    for marker in document.model.findall("MarkerSet/objects/Marker"):
        frame = (
            _read_socket(marker, "socket_parent_frame") or marker.findtext("body") or ""
        ).strip()
        in_body = (frame.rpartition("/")[2], pin.SE3.Identity())
        body, pose = offset.get(frame.rpartition("bodyset/")[2], in_body)
        location = read_numbers(marker, "location", document.source, count=3)
        markers[decode_name(marker.get("name", ""))] = (body, pose.act(location))
    return markers


def _read_joint(element: ET.Element, path: Path, child: str | None = None) -> PeerJoint:
    """Read a joint of OpenSim 4, or with `child` one of OpenSim 3, inside that body."""
    frames = {f.get("name", ""): f for f in element.findall("frames/PhysicalOffsetFrame")}

    def read_end(socket: str) -> tuple[str, pin.SE3]:
        body = _read_socket(element, socket).rpartition("/")[2]
        if body not in frames:
            return body, pin.SE3.Identity()
        owner = _read_socket(frames[body], "socket_parent")
        return owner.rpartition("/")[2], _read_pose(
            frames[body], "translation", "orientation", path
        )

    if child is None:
        (parent, in_parent), (child, in_child) = (
            read_end("socket_parent_frame"),
            read_end("socket_child_frame"),
        )
    else:
        parent = (element.findtext("parent_body") or "").strip()
        in_parent = _read_pose(element, "location_in_parent", "orientation_in_parent", path)
        in_child = _read_pose(element, "location", "orientation", path)
    coordinates = tuple(_read_coordinate(c, path) for c in element.iter("Coordinate"))
    return PeerJoint(
        name=element.get("name", ""),
        kind=element.tag,
        parent=parent,
        child=child,
        in_parent=in_parent,
        in_child=in_child,
        coordinates=coordinates,
        axes=_read_axes(element, coordinates, path),
    )


def _read_socket(element: ET.Element, socket: str) -> str:
    """Read the path that a socket is connected to; empty without one."""
    found = find_socket(element, socket)
    return "" if found is None else (found.text or "").strip()


def _read_pose(element: ET.Element, translation: str, orientation: str, path: Path) -> pin.SE3:
    """Read a pose from the elements of a translation and of body-fixed x-y-z angles."""
    angles = read_numbers(element, orientation, path, count=3)
    return pin.SE3(
        convert_from_body_fixed_xyz(angles), read_numbers(element, translation, path, count=3)
    )


def _read_axes(
    element: ET.Element, coordinates: tuple[PeerCoordinate, ...], path: Path
) -> tuple[PeerAxis, ...] | None:
    """Read the elementary motions of a joint; None for a kind of joint that is not known."""
    if element.tag in _SIMPLE:
        kinds = _SIMPLE[element.tag]
        names = [c.name for c in coordinates] + [None] * len(kinds)
        return tuple(
            PeerAxis(rotates, axis, names[i], float) for i, (rotates, axis) in enumerate(kinds)
        )
    if element.tag != "CustomJoint":
        return None
    axes = []
    for entry in element.findall("SpatialTransform/TransformAxis"):
        names_of_axis = (entry.findtext("coordinates") or "").split()
        function = read_function(entry, path)
        if function is None or len(names_of_axis) > 1:
            return None
        vector = _X
        if (entry.findtext("axis") or "").strip():
            vector = read_numbers(entry, "axis", path, count=3)
        length = float(np.linalg.norm(vector))
        if length == 0.0:
            message = "found an axis of length zero"
            raise InputError(message, source=path, field=element.get("name"), code=Code.OTHER_MODEL)
        # rotation1 to rotation3, then translation1 to translation3.
        rotates = entry.get("name", "").startswith("rotation")
        coordinate = names_of_axis[0] if names_of_axis else None
        axes.append(PeerAxis(rotates, vector / length, coordinate, function))
    return tuple(axes)


def _read_coordinate(element: ET.Element, path: Path) -> PeerCoordinate:
    """Read a coordinate with its range."""
    low, high = read_numbers(element, "range", path, count=2)
    default = float(read_numbers(element, "default_value", path, count=1)[0])
    locked = (element.findtext("locked") or "").strip() == "true"
    return PeerCoordinate(
        name=element.get("name", ""),
        default=default,
        low=float(low),
        high=float(high),
        locked=locked,
    )
