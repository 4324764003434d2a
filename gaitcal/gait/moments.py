"""Joint moments in numbers, their peaks and how much calibration changed them; and words for what
the program names.

A gait laboratory reads the right hip's flexion for `hip_flexion_r`. Coordinates, segments, joints
and parameters have words here; names from the data (markers, trials) stay as they are.
"""

import re
from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array
from gaitcal.dynamics.ground_reactions import get_leg
from gaitcal.dynamics.inverse_dynamics import FORCES, Moments
from gaitcal.dynamics.measurement_errors import ErrorSource, TorqueErrors
from gaitcal.gait.strides import Layout
from gaitcal.model import linkage
from gaitcal.model.coordinates import COORDINATE_TABLE, JOINT_TABLE, split_side
from gaitcal.model.linkage import (
    COORDINATE_INDEX,
    JOINTS,
    REACTIONS,
    SEGMENT_TABLE,
    list_joint_elements,
)
from gaitcal.model.parameters import IP_INDEX, JOINT_PARAMETERS, JP_INDEX, ParameterKind
from gaitcal.model.subject_model import SubjectModel
from gaitcal.study.study_trial import Role


def list_moments(model: SubjectModel) -> list[str]:
    """All joint moments that the model moves, the knees' adduction reaction after their flexion."""
    elements = (e for joint in JOINTS for e in list_joint_elements(joint, reactions=True))
    return [e.name for e in elements if e.name in FORCES and e.name not in model.frozen]


def get_moment(forces: Moments | TorqueErrors, name: str) -> Array:
    """(nf,) N·m, one moment of generalised forces or of their standard errors."""
    if name in REACTIONS:
        return forces.knee_adduction[:, REACTIONS.index(name)]
    return forces.tau[:, COORDINATE_INDEX[name]]


def get_marker_error(errors: TorqueErrors, name: str) -> Array | None:
    """(nf,) N·m, the part of the standard error of one moment that the trial's own markers make;
    None: not known.
    """
    variance = errors.by_source.get(ErrorSource.MOTION)
    return None if variance is None else np.sqrt(variance[:, FORCES.index(name)])


@dataclass(frozen=True)
class Extreme:
    """The largest value of a moment."""

    value: float  # N·m/kg
    error: float | None  # N·m/kg, standard error
    bwh: float  # the value in % of body weight times height
    at: float  # % of the gait cycle, or s where the trial is drawn against time


@dataclass(frozen=True, kw_only=True)
class MomentSummary:
    """One joint moment of one trial."""

    name: str  # `hip_flexion_r`
    highest: (
        Extreme | None
    )  # over the valid frames of the stride that is drawn; None where there are none
    # N·m/kg, RMS over all valid frames of the difference between calibrated and nominal model
    change: float
    change_bwh: float  # the change in % of body weight times height
    peak: float  # N·m/kg, largest absolute value over all valid frames

    @property
    def side(self) -> str:
        """`r`, `l` or nothing."""
        return split_side(self.name)[1]

    @property
    def change_of_peak(self) -> float:
        """The change in percent of the peak."""
        return 100.0 * self.change / self.peak if self.peak else 0.0


def summarise_moments(
    model: SubjectModel,
    layout: Layout,
    final: Moments,
    nominal: Moments,
    errors: TorqueErrors | None = None,
) -> tuple[MomentSummary, ...]:
    """Of all joint moments with valid frames, right and left side by side; a leg's frames are valid
    by its own foot.

    `final` and `nominal`: with the calibrated and with the nominal model; `errors`: of `final`.
    """
    subject = model.subject
    to_bwh = 100.0 * subject.mass / subject.bwh
    names = list_moments(model)
    bases = list(dict.fromkeys(split_side(name)[0] for name in names))
    numbers = []
    for name in sorted(
        names, key=lambda n: (bases.index(split_side(n)[0]), split_side(n)[1] == "l")
    ):
        side, valid = split_side(name)[1], layout.get_valid_frames(get_leg(name))
        if not valid.any():
            continue
        moment, before = (get_moment(f, name) / subject.mass for f in (final, nominal))
        error = get_moment(errors, name) / subject.mass if errors else np.full(len(moment), np.nan)
        frames = np.flatnonzero(valid & layout.select_drawn_frames(side))
        highest = None
        if len(frames):
            frame = frames[moment[frames].argmax()]
            value, spread, time = (
                float(moment[frame]),
                float(error[frame]),
                float(layout.time[frame]),
            )
            at = (
                float(layout.select_main_cycle(side).compute_percent(time))
                if layout.by_cycle
                else time
            )
            highest = Extreme(value, spread if np.isfinite(spread) else None, to_bwh * value, at)
        change = float(np.sqrt(np.mean((moment - before)[valid] ** 2)))
        numbers.append(
            MomentSummary(
                name=name,
                highest=highest,
                change=change,
                change_bwh=to_bwh * change,
                peak=float(np.abs(moment[valid]).max()),
            )
        )
    return tuple(numbers)


_NAME = re.compile(r"[a-z_]+(\.[a-z]+){1,2}")
SIDE_WORDS = {**linkage.SIDE_WORDS, "": ""}


def describe_coordinate_side(name: str) -> str:
    """`hip_flexion_r` -> `Right hip flexion`."""
    return capitalise(_add_side(COORDINATE_TABLE[split_side(name)[0]].title, split_side(name)[1]))


def capitalise(text: str) -> str:
    """The text with a capital first letter, all others as they are."""
    return text[:1].upper() + text[1:]


def _add_side(word: str, side: str) -> str:
    """`Hip` -> `right hip`; without a side the word as it is."""
    return f"{SIDE_WORDS[side]} {word[:1].lower()}{word[1:]}" if side else word


def describe_segment(segment: str) -> str:
    """`thigh_r` -> `right thigh`."""
    base, side = split_side(segment)
    return _add_side(
        SEGMENT_TABLE[base].title or base if base in SEGMENT_TABLE else base.replace("_", " "), side
    )


def describe_joint(joint: str) -> str:
    """`knee_r` -> `right knee`; without a side, `Knee`."""
    base, side = split_side(joint)
    return _add_side(JOINT_TABLE[base].title if base in JOINT_TABLE else base.capitalize(), side)


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


def describe_parameter_location(name: str) -> str:
    """`hip_r.pelvis.ant` -> `hip centre in the pelvis`; `thigh_r.com.sup` -> `mass centre`; nothing
    for a mass.
    """
    if name in IP_INDEX:
        return _INERTIAL[name.split(".", 1)[1]][0]
    parameter = JOINT_PARAMETERS[JP_INDEX[name]]
    place = describe_segment(split_side(parameter.segment)[0])
    return f"{JOINT_TABLE[split_side(parameter.joint)[0]].feature} in the {place}"


def describe_parameter_direction(name: str) -> str:
    """`hip_r.pelvis.ant` -> `forward`; `thigh_r.com.sup` -> `up`."""
    if name in IP_INDEX:
        return _INERTIAL[name.split(".", 1)[1]][1]
    parameter = JOINT_PARAMETERS[JP_INDEX[name]]
    return (_POSITIONS if parameter.kind is ParameterKind.POSITION else _ORIENTATIONS)[
        parameter.axis
    ]


def describe_parameter(name: str) -> str:
    """`hip_r.pelvis.ant` -> `hip centre in the pelvis, forward`; `thigh_r.com.sup` -> `mass centre
    up`.
    """
    between = " " if name in IP_INDEX else ", "
    return (
        f"{describe_parameter_location(name)}{between}{describe_parameter_direction(name)}".strip()
    )


def explain_parameters(text: str) -> str:
    """A message with every parameter's name followed by what it means: `hip_r.pelvis.ant (right hip
    centre ...)`.
    """

    def explain(match: re.Match[str]) -> str:
        name = match[0]
        part = name.split(".")[0]
        if name in JP_INDEX:
            return f"{name} ({_add_side(describe_parameter(name), split_side(part)[1])})"
        if name in IP_INDEX:
            return f"{name} ({describe_segment(part)}: {describe_parameter(name)})"
        return name

    return _NAME.sub(explain, text)


def describe_role(role: Role, joint: str | None) -> str:
    """What a trial is for: `right hip alone`, `walking`."""
    if role is Role.STATIC:
        return "standing still"
    return (
        f"{describe_joint(joint)} alone"
        if joint
        else "any movement"
        if role is Role.MOTION
        else "walking"
    )


def format_count(number: int, noun: str) -> str:
    """`1 frame`, `3 frames`."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def format_list(words: list[str]) -> str:
    """`a, b and c`."""
    return (
        words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}" if words else ""
    )
