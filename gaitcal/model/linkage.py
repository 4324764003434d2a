"""The linkage: segments, coordinates, joint parameters, and the elementary motions that make each
joint.

Reinbolt 2003 and Reinbolt et al. 2007; frames x anterior, y superior, z right; s = +1 right, -1
left; A = Rx(front) Ry(trans), B = Ry(trans) Rz(sag); Tr a translation, R a right-handed rotation:

    hip         Tr(pelvis) Rz(flexion) R(s x)(adduction) R(s y)(rotation) Tr(-thigh)
    knee        Tr(thigh) A_thigh Rz(-flexion) [Tr(shank) A_shank]^-1
    talocrural  Tr(shank) A_shank Rz(dorsiflexion + zero)              (the talus frame)
    subtalar    Tr(0, sup, 0) Ry(trans) R(s x)(inversion) Rx(zero) [Tr(foot) B_foot]^-1
    back        as hip
    shoulder    Tr(trunk) A_trunk Rz(flexion) R(s x)(adduction) [Tr(arm) B_arm]^-1
    elbow       as knee

The tables `_LEG`, `_BACK` and `_ARM` define the joints and `_SEGMENTS` the segments. Order of
segments and coordinates, zero angles and the catalogue of joint parameters (`parameters.py`) are
read from them. A joint parameter enters in exactly one element of one joint, and so does a
coordinate. Names of coordinates and joints are in `coordinates.py`.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import Enum
from typing import TypeAlias

SIDES = ("r", "l")
SIDE_WORDS = {"r": "right", "l": "left"}
OTHER_SIDE = {"r": "l", "l": "r"}


@dataclass(frozen=True, kw_only=True)
class Segment:
    """A kind of segment; both sides are alike."""

    name: str  # without the side: `upper_arm`
    short: str = ""  # as joint parameters name it, where that is another name: `upperarm`
    title: str = ""  # name for people if it differs: `head and trunk`
    paired: bool = True  # there is one of each side
    # markers can sit on it, and so soft tissue between them and the bone
    markers: bool = True
    # a segment of a leg without whose markers there are no joint torques of that leg
    needed: bool = False
    parts: tuple[str, ...] = ()
    """Rows of `models/de_leva_1996.json` in it, from which it has its inertia; none: it is
    massless.
    """
    # its parts follow one another along x from its origin, as those of feet; else along -y
    forward: bool = False
    palpated: tuple[float, float, float] | None = None
    """deg, standard deviations of the rotation of its axes about x, y and z by errors of palpated
    landmarks (`dynamics/measurement_errors.py`). None: no landmarks, and no error."""
    free_centre: tuple[str, ...] = ()
    """Coordinates of its mass centre that the symmetric set of inertial parameters frees (Reinbolt
    et al. 2007).
    """


# fmt: off
_SEGMENTS = (
    Segment(name="pelvis", paired=False, parts=("LowerTrunk",), palpated=(2.0, 2.0, 4.5),
        free_centre=("com.ant", "com.sup")),
    # thigh: 13 mm of the hip centre over 400 mm; epicondyles 112 mm apart
    Segment(name="thigh", needed=True, parts=("Thigh",), palpated=(2.0, 4.5, 2.0),
        free_centre=("com.sup",)),
    # shank: middles of epicondyles and of malleoli 400 mm apart; malleoli 85 mm
    Segment(name="shank", needed=True, parts=("Shank2",), palpated=(1.0, 5.5, 1.0),
        free_centre=("com.sup",)),
    Segment(name="talus", markers=False),
    # foot: z across the shank; heel and toe 190 mm apart
    Segment(name="foot", needed=True, parts=("Foot",), forward=True, palpated=(1.0, 2.5, 2.5),
        free_centre=("com.ant",)),
    # head_trunk: the lumbar joint and the acromia, 450 mm above and 350 mm apart
    Segment(name="head_trunk", short="trunk", title="head and trunk", paired=False,
        parts=("MiddleTrunk", "UpperTrunk", "Head2"), palpated=(2.0, 1.5, 2.0),
        free_centre=("com.sup",)),
    # upper_arm: 280 mm; elbows 80 mm wide
    Segment(name="upper_arm", short="upperarm", title="upper arm", parts=("UpperArm",),
        palpated=(2.0, 6.0, 2.0), free_centre=("com.sup",)),
    Segment(name="forearm_hand", short="forearm", title="forearm and hand",
        parts=("Forearm", "Hand"), palpated=(2.0, 6.0, 2.0), free_centre=("com.sup",)),
)
# fmt: on
# name without its side -> row
SEGMENT_TABLE: dict[str, Segment] = {row.name: row for row in _SEGMENTS}
_OF_SHORT = {row.short or row.name: row for row in _SEGMENTS}


class Source(Enum):
    """Quantity that gives the amount of an elementary motion."""

    COORDINATE = "coordinate"
    JOINT_PARAMETER = "joint parameter"
    ZERO_ANGLE = "zero angle"


@dataclass(frozen=True, kw_only=True)
class Element:
    """One elementary motion: a translation along, or a rotation about, one axis by sign * value."""

    rotates: bool
    # 0, 1, 2: x, y, z of the frame that the elements before have moved
    axis: int
    sign: float
    source: Source
    name: str  # of the coordinate, joint parameter or zero angle


@dataclass(frozen=True)
class Joint:
    """The motion of `child` relative to `parent`: a sequence of elements from parent to child."""

    name: str
    parent: str
    child: str
    elements: tuple[Element, ...]


# Joint, parent, child, joint parameters in the parent, motions, joint parameters in the child. A
# joint parameter is a translation along x y z (`ant sup lat`) or a rotation about them (`front
# trans sag`); those in the child enter reversed. A motion is an axis and a coordinate, `s` where it
# is mirrored on the left; `zero` is a zero angle.
_Row: TypeAlias = tuple[str, str, str, str, str, str]
_LEG: tuple[_Row, ...] = (
    (
        "hip",
        "pelvis",
        "thigh",
        "ant sup lat",
        "z hip_flexion, sx hip_adduction, sy hip_rotation",
        "ant sup lat",
    ),
    ("knee", "thigh", "shank", "ant sup front trans", "-z knee_angle", "trans front ant sup lat"),
    ("talocrural", "shank", "talus", "ant sup lat front trans", "z ankle_angle, z zero", ""),
    (
        "subtalar",
        "talus",
        "foot",
        "sup trans",
        "sx subtalar_angle, x zero",
        "sag trans ant sup lat",
    ),
)
_LUMBAR = "z lumbar_extension, x lumbar_bending, y lumbar_rotation"
_BACK: tuple[_Row, ...] = (("back", "pelvis", "trunk", "ant sup lat", _LUMBAR, "ant sup lat"),)
_ARM: tuple[_Row, ...] = (
    (
        "shoulder",
        "trunk",
        "upperarm",
        "ant sup lat front trans",
        "z arm_flex, sx arm_add",
        "sag trans ant sup lat",
    ),
    (
        "elbow",
        "upperarm",
        "forearm",
        "ant sup front trans",
        "z elbow_flex",
        "trans front ant sup lat",
    ),
)

_TRANSLATIONS, _ROTATIONS = ("ant", "sup", "lat"), ("front", "trans", "sag")


def add_side(segment: str, side: str) -> str:
    """Add the side to a segment: `thigh` -> `thigh_r`; a segment without sides stays."""
    return f"{segment}_{side}" if SEGMENT_TABLE[segment].paired else segment


def _make_joint(row: _Row, side: str) -> Joint:
    """Make the joint of a table row on one side (`r`, `l`), or in the middle (``)."""
    kind, parent, child, in_parent, motions, in_child = row

    def sided(name: str) -> str:
        return f"{name}_{side}" if side else name

    def parameters(place: str, directions: str, sign: float) -> Iterator[Element]:
        for direction in directions.split():
            rotates = direction in _ROTATIONS
            yield Element(
                rotates=rotates,
                axis=(_ROTATIONS if rotates else _TRANSLATIONS).index(direction),
                sign=sign,
                source=Source.JOINT_PARAMETER,
                name=f"{sided(kind)}.{place}.{direction}",
            )

    def motion(text: str) -> Element:
        axis, name = text.split()
        zero = name == "zero"
        return Element(
            rotates=True,
            axis="xyz".index(axis[-1]),
            sign=-1.0 if axis[0] == "-" or (axis[0] == "s" and side == "l") else 1.0,
            source=Source.ZERO_ANGLE if zero else Source.COORDINATE,
            name=f"{sided(kind)}.zero" if zero else sided(name),
        )

    before, after = parameters(parent, in_parent, 1.0), parameters(child, in_child, -1.0)
    elements = (*before, *map(motion, motions.split(", ")), *after)
    above, below = (add_side(_OF_SHORT[short].name, side) for short in (parent, child))
    return Joint(sided(kind), above, below, elements)


JOINTS: tuple[Joint, ...] = (
    *(_make_joint(row, side) for side in SIDES for row in _LEG),
    *(_make_joint(row, "") for row in _BACK),
    *(_make_joint(row, side) for side in SIDES for row in _ARM),
)
"""All joints, each after the joint of its parent."""

JOINT_OF_CHILD: dict[str, Joint] = {joint.child: joint for joint in JOINTS}

SEGMENTS: tuple[str, ...] = ("pelvis", *JOINT_OF_CHILD)  # all segments, each after its parent


def get_segment(segment: str) -> Segment:
    """Get the table row of a segment: `thigh_r` -> that of `thigh`."""
    return SEGMENT_TABLE[segment if segment in SEGMENT_TABLE else segment[:-2]]


MARKED_SEGMENTS: tuple[str, ...] = tuple(s for s in SEGMENTS if get_segment(s).markers)
"""Those on which markers can sit."""
LOWER_BODY: tuple[str, ...] = SEGMENTS[: SEGMENTS.index("head_trunk")]  # pelvis and legs


def _list_leg_segments(side: str) -> tuple[str, ...]:
    """List the segments of the leg of a side."""
    return tuple(segment for segment in LOWER_BODY if segment.endswith(f"_{side}"))


LEGS: dict[str, tuple[str, ...]] = {side: _list_leg_segments(side) for side in SIDES}
"""Side -> segments of that leg, each after its parent."""
LEG_JOINTS: tuple[str, ...] = tuple(
    row[0] for row in _LEG
)  # joints of a leg from hip to foot, without the side
NEEDED_JOINTS: tuple[str, ...] = LEG_JOINTS[
    : 1 + max(k for k, row in enumerate(_LEG) if _OF_SHORT[row[2]].needed)
]
"""Those on the way to a segment that needs markers."""
FOLLOWED_SEGMENT: dict[str, str] = {
    j.child: j.parent for j in JOINTS if j.name[:-2] in LEG_JOINTS[len(NEEDED_JOINTS) :]
}
"""Segment of a leg distal to those -> the segment that it follows if it has no markers."""
LEG_SEGMENTS: tuple[str, ...] = tuple(
    f"{row.name}_{side}" for side in SIDES for row in _SEGMENTS if row.needed
)
"""Without markers on these there are no joint torques of a leg."""

ZERO_ANGLES: tuple[str, ...] = tuple(
    e.name for j in JOINTS for e in j.elements if e.source is Source.ZERO_ANGLE
)
"""Constants, not JPs: they make zero ankle coordinates the posture with the foot at right angles to
the shank.
"""

ROOT_SUFFIXES = ("tx", "ty", "tz", "tilt", "list", "rotation")


def make_root_elements(root: str) -> tuple[Element, ...]:
    """Make the six coordinates of a base segment that is free in the laboratory.

    Parameters
    ----------
    root : str
        The base segment.

    Returns
    -------
    tuple of Element
        In the order Tr(tx, ty, tz) Rz(tilt) Rx(list) Ry(rotation).
    """
    motions = ((False, 0), (False, 1), (False, 2), (True, 2), (True, 0), (True, 1))
    return tuple(
        Element(
            rotates=rotates, axis=axis, sign=1.0, source=Source.COORDINATE, name=f"{root}_{suffix}"
        )
        for (rotates, axis), suffix in zip(motions, ROOT_SUFFIXES, strict=True)
    )


def list_joints_above(segment: str) -> tuple[Joint, ...]:
    """List the joints between the pelvis and a segment.

    Parameters
    ----------
    segment : str
        Name with its side.

    Returns
    -------
    tuple of Joint
        Proximal first; empty for the pelvis.
    """
    joint = JOINT_OF_CHILD.get(segment)
    return () if joint is None else (*list_joints_above(joint.parent), joint)


def list_joint_coordinates(segments: Iterable[str]) -> tuple[str, ...]:
    """List the coordinates of the joints whose children are these segments.

    Parameters
    ----------
    segments : iterable of str
        Segments other than the pelvis.

    Returns
    -------
    tuple of str
        Names in the order of the segments.
    """
    elements = [e for segment in segments for e in JOINT_OF_CHILD[segment].elements]
    return tuple(e.name for e in elements if e.source is Source.COORDINATE)


def list_coordinates(root: str, segments: tuple[str, ...]) -> tuple[str, ...]:
    """List the coordinates of a part of the linkage.

    `root`: base segment, free in the laboratory. `segments`: segments of the part. Returns: the six
    coordinates of the base, then those of the joints in the part.
    """
    moved = [joint.child for joint in JOINTS if joint.child in segments and joint.child != root]
    return (*(e.name for e in make_root_elements(root)), *list_joint_coordinates(moved))


COORDINATES: tuple[str, ...] = list_coordinates("pelvis", SEGMENTS)
"""The coordinates in the order of every (nf, nq) array; m for the three translations, rad
otherwise.
"""

PELVIS_ANGLES: tuple[str, ...] = COORDINATES[3:6]
"""Tilt, list and rotation of the pelvis: about z, x and y, each moved by those before it."""
LUMBAR: tuple[str, ...] = list_joint_coordinates(["head_trunk"])
"""Extension, bending and rotation of the lumbar joint, likewise."""

COORDINATE_INDEX: dict[str, int] = {name: i for i, name in enumerate(COORDINATES)}

FILE_COORDINATES: tuple[str, ...] = (*COORDINATES[3:6], *COORDINATES[:3], *COORDINATES[6:])
"""The same in the order of written files: rotations of the pelvis first, as in OpenSim."""


def is_translation(coordinate: str) -> bool:
    """Return whether a coordinate is a length (m) rather than an angle (rad)."""
    return coordinate.endswith(("_tx", "_ty", "_tz"))


REACTIONS: tuple[str, ...] = tuple(f"knee_adduction_{side}" for side in SIDES)
"""Locked joints whose generalised force is the internal reaction moment about the knee frame's x
axis (shank side).
"""


def list_joint_elements(joint: Joint, *, reactions: bool = False) -> tuple[Element, ...]:
    """List the elementary motions of a joint, from parent to child.

    Parameters
    ----------
    joint : Joint
        A joint of the linkage.
    reactions : bool
        Whether a knee has its locked reaction joint after the flexion.

    Returns
    -------
    tuple of Element
        In the order in which they move.
    """
    if not reactions or not joint.name.startswith("knee"):
        return joint.elements
    side = joint.name[-1]
    sign = 1.0 if side == "r" else -1.0
    reaction = Element(
        rotates=True, axis=0, sign=sign, source=Source.COORDINATE, name=f"knee_adduction_{side}"
    )
    after = next(i for i, e in enumerate(joint.elements) if e.source is Source.COORDINATE) + 1
    return (*joint.elements[:after], reaction, *joint.elements[after:])


def _list_secondary_motions(side: str) -> tuple[Element, ...]:
    """List the secondary motions of the knee of a side."""
    rows = (("ant", False, 0), ("sup", False, 1), ("front", True, 0), ("trans", True, 1))
    return tuple(
        Element(
            rotates=rotates,
            axis=axis,
            sign=1.0,
            source=Source.COORDINATE,
            name=f"knee_{side}.secondary.{name}",
        )
        for name, rotates, axis in rows
    )


SECONDARY: dict[str, tuple[Element, ...]] = {
    f"knee_angle_{side}": _list_secondary_motions(side) for side in SIDES
}
"""Coordinate -> secondary motions of its joint: translations along x and y, then rotations about
them, in the axes of the knee before flexion. They accompany flexion and are not in the linkage.
Their amounts are given in m and rad (`tracking/soft_tissue.py`); no model has coordinates of them.
"""
SECONDARY_NAMES = frozenset(element.name for motions in SECONDARY.values() for element in motions)
BENDS = ("^2", "^3")
"""Suffixes of variables: parts of a secondary motion proportional to the square and to the cube of
the coordinate."""
SECONDARY_VARIABLES: dict[str, tuple[str, str, int]] = {
    element.name + bend: (coordinate, element.name, k)
    for coordinate, motions in SECONDARY.items()
    for element in motions
    for k, bend in enumerate(BENDS)
}
"""Variable of a secondary motion -> its coordinate, its motion, and its index in `BENDS`."""


ISOLATED_JOINTS: tuple[str, ...] = ("hip_r", "knee_r", "ankle_r", "hip_l", "knee_l", "ankle_l")
"""What an isolated trial may move; the ankle is the talocrural and the subtalar joint together."""


def list_moved_joints(isolated: str) -> tuple[Joint, ...]:
    """List the joints that a functional trial moves.

    Parameters
    ----------
    isolated : str
        `hip_r`, `knee_r`, `ankle_r` (or `_l`).

    Returns
    -------
    tuple of Joint
        Proximal first.
    """
    name, side = isolated.split("_")
    names = [
        f"{joint}_{side}" for joint in (("talocrural", "subtalar") if name == "ankle" else (name,))
    ]
    return tuple(joint for joint in JOINTS if joint.name in names)


def find_base_segment(isolated: str | None) -> str:
    """Find the base segment of a functional trial without the pelvis; empty for gait."""
    return list_joint_segments(isolated)[0] if isolated else ""


def list_joint_segments(isolated: str) -> tuple[str, ...]:
    """List the segments that the joints of a functional trial connect.

    Parameters
    ----------
    isolated : str
        `hip_r`, `knee_r`, `ankle_r` (or `_l`).

    Returns
    -------
    tuple of str
        Proximal first.
    """
    joints = list_moved_joints(isolated)
    return (joints[0].parent, *(joint.child for joint in joints))
