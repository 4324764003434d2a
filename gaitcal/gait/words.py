"""What the program's names mean in words that a gait laboratory uses: `hip_flexion_r` is the right hip's flexion.

Coordinates, segments, joints and parameters have words here; names from the data (markers, trials) stay as they are.
"""

from __future__ import annotations

import re

from gaitcal.model.coordinates import COORDINATE_TABLE, JOINT_TABLE, split_side
from gaitcal.model.inertial_parameters import IP_INDEX
from gaitcal.model.joint_parameters import JOINT_PARAMETERS, JP_INDEX, Kind
from gaitcal.model.linkage import SEGMENT_TABLE
from gaitcal.study.study_trial import Role

_NAME = re.compile(r"[a-z_]+(\.[a-z]+){1,2}")
SIDE_WORDS = {"r": "right", "l": "left", "": ""}


def coordinate_title(name: str) -> str:
    """`hip_flexion_r` -> `Right hip flexion`."""
    return capitalised(_with_side(COORDINATE_TABLE[split_side(name)[0]].title, split_side(name)[1]))


def capitalised(text: str) -> str:
    """The text with a capital first letter, all others as they are."""
    return text[:1].upper() + text[1:]


def _with_side(word: str, side: str) -> str:
    """`Hip` -> `right hip`; without a side the word as it is."""
    return f"{SIDE_WORDS[side]} {word[:1].lower()}{word[1:]}" if side else word


def segment_words(segment: str) -> str:
    """`thigh_r` -> `right thigh`."""
    base, side = split_side(segment)
    return _with_side(SEGMENT_TABLE[base].words or base if base in SEGMENT_TABLE else base.replace("_", " "), side)


def joint_words(joint: str) -> str:
    """`knee_r` -> `right knee`; without a side, `Knee`."""
    base, side = split_side(joint)
    return _with_side(JOINT_TABLE[base].words if base in JOINT_TABLE else base.capitalize(), side)


_POSITIONS = ("forward", "up", "to the right")
_ORIENTATIONS = ("frontal tilt", "transverse turn", "sagittal turn")
_INERTIAL = {
    "mass": ("", "mass"),
    "com.ant": ("mass centre", "forward"),
    "com.sup": ("mass centre", "up"),
    "com.lat": ("mass centre", "to the right"),
    "moi.ant": ("moment of inertia about the", "forward axis"),
    "moi.sup": ("moment of inertia about the", "upward axis"),
    "moi.lat": ("moment of inertia about the", "sideways axis"),
}


def parameter_place(name: str) -> str:
    """`hip_r.pelvis.ant` -> `hip centre in the pelvis`; `thigh_r.com.sup` -> `mass centre`; nothing for a mass."""
    if name in IP_INDEX:
        return _INERTIAL[name.split(".", 1)[1]][0]
    parameter = JOINT_PARAMETERS[JP_INDEX[name]]
    feature = JOINT_TABLE[split_side(parameter.joint)[0]].feature
    return f"{feature} in the {segment_words(split_side(parameter.segment)[0])}"


def parameter_direction(name: str) -> str:
    """`hip_r.pelvis.ant` -> `forward`; `thigh_r.com.sup` -> `up`."""
    if name in IP_INDEX:
        return _INERTIAL[name.split(".", 1)[1]][1]
    parameter = JOINT_PARAMETERS[JP_INDEX[name]]
    return (_POSITIONS if parameter.kind is Kind.POSITION else _ORIENTATIONS)[parameter.axis]


def parameter_words(name: str) -> str:
    """`hip_r.pelvis.ant` -> `hip centre in the pelvis, forward`; `thigh_r.com.sup` -> `mass centre up`."""
    between = " " if name in IP_INDEX else ", "
    return f"{parameter_place(name)}{between}{parameter_direction(name)}".strip()


def explained(text: str) -> str:
    """A message with every parameter's name followed by what it means: `hip_r.pelvis.ant (right hip centre ...)`."""

    def explain(match: re.Match[str]) -> str:
        name = match[0]
        part = name.split(".")[0]
        if name in JP_INDEX:
            return f"{name} ({_with_side(parameter_words(name), split_side(part)[1])})"
        if name in IP_INDEX:
            return f"{name} ({segment_words(part)}: {parameter_words(name)})"
        return name

    return _NAME.sub(explain, text)


def role_words(role: Role, joint: str | None) -> str:
    """What a trial is for: `right hip alone`, `walking`."""
    if role is Role.STATIC:
        return "standing still"
    return f"{joint_words(joint)} alone" if joint else "walking"


def counted(number: int, noun: str) -> str:
    """`1 frame`, `3 frames`."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def listed(words: list[str]) -> str:
    """`a, b and c`."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}" if words else ""
