"""The linkage: 14 segments, 27 coordinates, and the chain of elementary motions that makes each joint.

Reinbolt 2003 and Reinbolt et al. 2007; frames x anterior, y superior, z right; s = +1 right, -1 left;
A = Rx(front) Ry(trans), B = Ry(trans) Rz(sag); Tr a translation, R a right-handed rotation:

    hip         Tr(pelvis) Rz(flexion) R(s x)(adduction) R(s y)(rotation) Tr(-thigh)
    knee        Tr(thigh) A_thigh Rz(-flexion) [Tr(shank) A_shank]^-1
    talocrural  Tr(shank) A_shank Rz(dorsiflexion + zero)              (the talus frame)
    subtalar    Tr(0, sup, 0) Ry(trans) R(s x)(inversion) Rx(zero) [Tr(foot) B_foot]^-1
    back        as hip; shoulder  Tr(trunk) A_trunk Rz(flexion) R(s x)(adduction) [Tr(arm) B_arm]^-1; elbow as knee

Every joint is a sequence of `Element`s. A joint parameter enters in exactly one of them, a coordinate in exactly
one of them: that is the whole model, and whoever needs a derivative reads it from the sequence.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from gaitcal.model.joint_parameters import SIDES

SEGMENTS: tuple[str, ...] = (
    "pelvis",
    *(f"{s}_{side}" for side in SIDES for s in ("thigh", "shank", "talus", "foot")),
    "head_trunk",
    *(f"{s}_{side}" for side in SIDES for s in ("upper_arm", "forearm_hand")),
)
"""The 14 segments, each after its parent."""

LOWER_BODY: tuple[str, ...] = SEGMENTS[: SEGMENTS.index("head_trunk")]
"""Pelvis and legs."""

ZERO_ANGLES: tuple[str, ...] = tuple(f"{j}_{side}.zero" for side in SIDES for j in ("talocrural", "subtalar"))
"""Four constants, not JPs: they make zero ankle coordinates the posture with the foot at right angles to the shank."""

ROOT_SUFFIXES = ("tx", "ty", "tz", "tilt", "list", "rotation")


class Source(Enum):
    """Where the amount of an elementary motion comes from."""

    COORDINATE = "coordinate"
    JOINT_PARAMETER = "joint parameter"
    ZERO_ANGLE = "zero angle"


@dataclass(frozen=True)
class Element:
    """One elementary motion: a translation along, or a rotation about, one axis by sign * value."""

    rotates: bool
    axis: int
    sign: float
    source: Source
    name: str
    """Of the coordinate, joint parameter or zero angle."""


@dataclass(frozen=True)
class Joint:
    """The motion of `child` relative to `parent`, as a sequence of elements from parent to child."""

    name: str
    parent: str
    child: str
    elements: tuple[Element, ...]


_AXES = {"ant": 0, "sup": 1, "lat": 2, "front": 0, "trans": 1, "sag": 2}


def _parameters(joint: str, place: str, directions: str, sign: float = 1.0) -> list[Element]:
    return [
        Element(d in ("front", "trans", "sag"), _AXES[d], sign, Source.JOINT_PARAMETER, f"{joint}.{place}.{d}")
        for d in directions.split()
    ]


def _turn(axis: int, sign: float, name: str) -> Element:
    return Element(True, axis, sign, Source.COORDINATE, name)


def _zero(axis: int, name: str) -> Element:
    return Element(True, axis, 1.0, Source.ZERO_ANGLE, name)


def _leg(side: str) -> list[Joint]:
    s = 1.0 if side == "r" else -1.0
    thigh, shank, talus, foot = (f"{n}_{side}" for n in ("thigh", "shank", "talus", "foot"))
    hip, knee, talocrural, subtalar = (f"{n}_{side}" for n in ("hip", "knee", "talocrural", "subtalar"))
    return [
        Joint(
            hip,
            "pelvis",
            thigh,
            (
                *_parameters(hip, "pelvis", "ant sup lat"),
                _turn(2, 1.0, f"hip_flexion_{side}"),
                _turn(0, s, f"hip_adduction_{side}"),
                _turn(1, s, f"hip_rotation_{side}"),
                *_parameters(hip, "thigh", "ant sup lat", -1.0),
            ),
        ),
        Joint(
            knee,
            thigh,
            shank,
            (
                *_parameters(knee, "thigh", "ant sup front trans"),
                _turn(2, -1.0, f"knee_angle_{side}"),
                *_parameters(knee, "shank", "trans front ant sup lat", -1.0),
            ),
        ),
        Joint(
            talocrural,
            shank,
            talus,
            (
                *_parameters(talocrural, "shank", "ant sup lat front trans"),
                _turn(2, 1.0, f"ankle_angle_{side}"),
                _zero(2, f"talocrural_{side}.zero"),
            ),
        ),
        Joint(
            subtalar,
            talus,
            foot,
            (
                *_parameters(subtalar, "talus", "sup trans"),
                _turn(0, s, f"subtalar_angle_{side}"),
                _zero(0, f"subtalar_{side}.zero"),
                *_parameters(subtalar, "foot", "sag trans ant sup lat", -1.0),
            ),
        ),
    ]


def _back() -> Joint:
    return Joint(
        "back",
        "pelvis",
        "head_trunk",
        (
            *_parameters("back", "pelvis", "ant sup lat"),
            _turn(2, 1.0, "lumbar_extension"),
            _turn(0, 1.0, "lumbar_bending"),
            _turn(1, 1.0, "lumbar_rotation"),
            *_parameters("back", "trunk", "ant sup lat", -1.0),
        ),
    )


def _arm(side: str) -> list[Joint]:
    s = 1.0 if side == "r" else -1.0
    shoulder, elbow = f"shoulder_{side}", f"elbow_{side}"
    return [
        Joint(
            shoulder,
            "head_trunk",
            f"upper_arm_{side}",
            (
                *_parameters(shoulder, "trunk", "ant sup lat front trans"),
                _turn(2, 1.0, f"arm_flex_{side}"),
                _turn(0, s, f"arm_add_{side}"),
                *_parameters(shoulder, "upperarm", "sag trans ant sup lat", -1.0),
            ),
        ),
        Joint(
            elbow,
            f"upper_arm_{side}",
            f"forearm_hand_{side}",
            (
                *_parameters(elbow, "upperarm", "ant sup front trans"),
                _turn(2, 1.0, f"elbow_flex_{side}"),
                *_parameters(elbow, "forearm", "trans front ant sup lat", -1.0),
            ),
        ),
    ]


JOINTS: tuple[Joint, ...] = (*_leg("r"), *_leg("l"), _back(), *_arm("r"), *_arm("l"))
"""The 13 joints, each after the joint of its parent."""

JOINT_OF_CHILD: dict[str, Joint] = {joint.child: joint for joint in JOINTS}


def root_elements(root: str) -> tuple[Element, ...]:
    """Six coordinates of a root segment in the laboratory: Tr(tx, ty, tz) Rz(tilt) Rx(list) Ry(rotation)."""
    motions = ((False, 0), (False, 1), (False, 2), (True, 2), (True, 0), (True, 1))
    return tuple(
        Element(rotates, axis, 1.0, Source.COORDINATE, f"{root}_{suffix}")
        for (rotates, axis), suffix in zip(motions, ROOT_SUFFIXES, strict=True)
    )


def coordinates_of(root: str, segments: tuple[str, ...]) -> tuple[str, ...]:
    """Coordinates of the part of the linkage made of `segments` with `root` free in the laboratory."""
    names = [e.name for e in root_elements(root)]
    for joint in JOINTS:
        if joint.child in segments and joint.child != root:
            names += [e.name for e in joint.elements if e.source is Source.COORDINATE]
    return tuple(names)


COORDINATES: tuple[str, ...] = coordinates_of("pelvis", SEGMENTS)
"""The 27 coordinates in the order of every (nf, 27) array; m for the three translations, rad otherwise."""

COORDINATE_INDEX: dict[str, int] = {name: i for i, name in enumerate(COORDINATES)}

FILE_COORDINATES: tuple[str, ...] = (*COORDINATES[3:6], *COORDINATES[:3], *COORDINATES[6:])
"""The same 27 in the order of written files: rotations of the pelvis first, as in OpenSim."""


def is_translation(coordinate: str) -> bool:
    """Whether a coordinate is a length (m) rather than an angle (rad)."""
    return coordinate.endswith(("_tx", "_ty", "_tz"))


def joint_segments(joint: str) -> tuple[str, ...]:
    """The segments that an isolated trial of `hip_r`, `knee_r`, `ankle_r` (or `_l`) moves, proximal first."""
    name, side = joint.split("_")
    return {
        "hip": ("pelvis", f"thigh_{side}"),
        "knee": (f"thigh_{side}", f"shank_{side}"),
        "ankle": (f"shank_{side}", f"talus_{side}", f"foot_{side}"),
    }[name]


REACTIONS: tuple[str, ...] = tuple(f"knee_adduction_{side}" for side in SIDES)
"""Locked joints whose generalised force is the internal reaction moment about the knee frame's x axis (shank side)."""


def joint_elements(joint: Joint, *, reactions: bool = False) -> tuple[Element, ...]:
    """The elements of a joint; with `reactions`, a knee also has its locked reaction joint after the flexion."""
    if not reactions or not joint.name.startswith("knee"):
        return joint.elements
    side = joint.name[-1]
    reaction = Element(True, 0, 1.0 if side == "r" else -1.0, Source.COORDINATE, f"knee_adduction_{side}")
    at = next(i for i, e in enumerate(joint.elements) if e.source is Source.COORDINATE) + 1
    return (*joint.elements[:at], reaction, *joint.elements[at:])


ISOLATED_JOINTS: tuple[str, ...] = ("hip_r", "knee_r", "ankle_r", "hip_l", "knee_l", "ankle_l")

LEG_SEGMENTS = tuple(f"{part}_{side}" for side in ("r", "l") for part in ("thigh", "shank", "foot"))
"""Without markers on these there are no joint torques of a leg."""
