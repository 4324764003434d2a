"""What the program's names mean in words that a gait laboratory uses. Data names (markers, trials) are not in here."""

from __future__ import annotations

import re
from dataclasses import dataclass

from gaitcal.model.inertial_parameters import IP_INDEX
from gaitcal.model.joint_parameters import JOINT_PARAMETERS, JP_INDEX, Kind
from gaitcal.study.study import Role

_NAME = re.compile(r"[a-z_]+(\.[a-z]+){1,2}")
SIDE_WORDS = {"r": "right", "l": "left", "": ""}


@dataclass(frozen=True)
class CoordinateWords:
    """How a coordinate, and the generalised force that drives it, are called."""

    title: str
    """Without the side: `Hip flexion`."""
    angle: str
    """What a positive angle means: `flexion`."""
    moment: str
    """What a positive internal moment does: `flexor`."""


_COORDINATES = {
    "pelvis_tilt": CoordinateWords("Pelvis tilt", "posterior", "posterior"),
    "pelvis_list": CoordinateWords("Pelvis list", "right side down", "right side down"),
    "pelvis_rotation": CoordinateWords("Pelvis rotation", "turned left", "to the left"),
    "hip_flexion": CoordinateWords("Hip flexion", "flexion", "flexor"),
    "hip_adduction": CoordinateWords("Hip adduction", "adduction", "adductor"),
    "hip_rotation": CoordinateWords("Hip rotation", "internal", "internal rotator"),
    "knee_angle": CoordinateWords("Knee flexion", "flexion", "flexor"),
    "knee_adduction": CoordinateWords("Knee adduction", "adduction", "adductor"),
    "ankle_angle": CoordinateWords("Ankle dorsiflexion", "dorsiflexion", "dorsiflexor"),
    "subtalar_angle": CoordinateWords("Subtalar inversion", "inversion", "invertor"),
    "lumbar_extension": CoordinateWords("Lumbar extension", "extension", "extensor"),
    "lumbar_bending": CoordinateWords("Lumbar bending", "to the right", "to the right"),
    "lumbar_rotation": CoordinateWords("Lumbar rotation", "to the left", "to the left"),
    "arm_flex": CoordinateWords("Shoulder flexion", "flexion", "flexor"),
    "arm_add": CoordinateWords("Shoulder adduction", "adduction", "adductor"),
    "elbow_flex": CoordinateWords("Elbow flexion", "flexion", "flexor"),
}


def split_side(name: str) -> tuple[str, str]:
    """`hip_flexion_r` -> (`hip_flexion`, `r`); `lumbar_bending` -> (`lumbar_bending`, ``)."""
    return (name[:-2], name[-1]) if name.endswith(("_r", "_l")) else (name, "")


def coordinate_words(name: str) -> CoordinateWords:
    """Words for a coordinate with or without its side."""
    base = split_side(name)[0]
    return _COORDINATES.get(base, CoordinateWords(base.replace("_", " "), "positive", "positive"))


def coordinate_title(name: str) -> str:
    """`hip_flexion_r` -> `Right hip flexion`."""
    side = split_side(name)[1]
    title = coordinate_words(name).title
    return f"{SIDE_WORDS[side].capitalize()} {title[0].lower()}{title[1:]}" if side else title


_SEGMENTS = {
    "pelvis": "pelvis",
    "head_trunk": "head and trunk",
    "thigh": "thigh",
    "shank": "shank",
    "talus": "talus",
    "foot": "foot",
    "upper_arm": "upper arm",
    "forearm_hand": "forearm and hand",
}


def segment_words(segment: str) -> str:
    """`thigh_r` -> `right thigh`."""
    base, side = split_side(segment)
    word = _SEGMENTS.get(base, base.replace("_", " "))
    return f"{SIDE_WORDS[side]} {word}" if side else word


_JOINTS = {
    "hip": "Hip",
    "knee": "Knee",
    "talocrural": "Ankle (talocrural)",
    "subtalar": "Subtalar",
    "ankle": "Ankle",
    "back": "Lumbar joint",
    "shoulder": "Shoulder",
    "elbow": "Elbow",
}


def joint_words(joint: str) -> str:
    """`knee_r` -> `right knee`; without a side, `Knee`."""
    base, side = split_side(joint)
    word = _JOINTS.get(base, base.replace("_", " "))
    return f"{SIDE_WORDS[side]} {word[0].lower()}{word[1:]}" if side else word


_FEATURES = {
    "hip": "hip centre",
    "knee": "knee axis",
    "talocrural": "ankle axis",
    "subtalar": "subtalar axis",
    "back": "lumbar joint centre",
    "shoulder": "shoulder joint",
    "elbow": "elbow axis",
}
_POSITIONS = ("forward", "up", "to the right")
_ORIENTATIONS = ("frontal tilt", "transverse turn", "sagittal turn")


def parameter_place(name: str) -> str:
    """`hip_r.pelvis.ant` -> `hip centre in the pelvis`, without the side."""
    parameter = JOINT_PARAMETERS[JP_INDEX[name]]
    return f"{_FEATURES[split_side(parameter.joint)[0]]} in the {_SEGMENTS[split_side(parameter.segment)[0]]}"


def parameter_direction(name: str) -> str:
    """`hip_r.pelvis.ant` -> `forward`."""
    parameter = JOINT_PARAMETERS[JP_INDEX[name]]
    return (_POSITIONS if parameter.kind is Kind.POSITION else _ORIENTATIONS)[parameter.axis]


def parameter_words(name: str) -> str:
    """`hip_r.pelvis.ant` -> `hip centre in the pelvis, forward`, without the side."""
    return f"{parameter_place(name)}, {parameter_direction(name)}"


def explained(text: str) -> str:
    """A message with every parameter's name followed by what it means: `hip_r.pelvis.ant (right hip centre ...)`."""

    def explain(match: re.Match[str]) -> str:
        name = match[0]
        if name in JP_INDEX:
            side = SIDE_WORDS[split_side(name.split(".")[0])[1]]
            return f"{name} ({f'{side} ' if side else ''}{parameter_words(name)})"
        if name in IP_INDEX:
            return f"{name} ({segment_words(name.split('.')[0])}: {inertial_words(name)})"
        return name

    return _NAME.sub(explain, text)


_INERTIAL = {
    "mass": ("", "mass"),
    "com.ant": ("mass centre", "forward"),
    "com.sup": ("mass centre", "up"),
    "com.lat": ("mass centre", "to the right"),
    "moi.ant": ("moment of inertia about the", "forward axis"),
    "moi.sup": ("moment of inertia about the", "upward axis"),
    "moi.lat": ("moment of inertia about the", "sideways axis"),
}


def inertial_place(name: str) -> str:
    """`thigh_r.com.sup` -> `mass centre`; nothing for a mass."""
    return _INERTIAL[name.split(".", 1)[1]][0]


def inertial_direction(name: str) -> str:
    """`thigh_r.com.sup` -> `up`."""
    return _INERTIAL[name.split(".", 1)[1]][1]


def inertial_words(name: str) -> str:
    """`thigh_r.com.sup` -> `mass centre up`, without the segment."""
    return f"{inertial_place(name)} {inertial_direction(name)}".strip()


def role_words(role: Role, joint: str | None) -> str:
    """What a trial is for: `right hip alone`, `walking`."""
    if role is Role.STATIC:
        return "standing still"
    return f"{joint_words(joint)} alone" if joint else "walking"


def counted(number: int, noun: str, plural: str | None = None) -> str:
    """`1 frame`, `3 frames`."""
    return f"{number} {noun if number == 1 else plural or noun + 's'}"


def listed(words: list[str]) -> str:
    """`a, b and c`."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}" if words else ""
