"""Joint moments in numbers: extremes and the effect of the calibration; and descriptions of names.

Reports of gait laboratories contain the right hip's flexion, not `hip_flexion_r`. This module has
descriptions of coordinates, segments, joints and parameters. Names from the data (markers, trials)
stay as they are.
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
    """List all joint moments that the model moves.

    Parameters
    ----------
    model : SubjectModel
        Model; its frozen coordinates are left out.

    Returns
    -------
    list of str
        Coordinates and knee reactions; knee adduction follows knee flexion.
    """
    elements = (e for joint in JOINTS for e in list_joint_elements(joint, reactions=True))
    return [e.name for e in elements if e.name in FORCES and e.name not in model.frozen]


def get_moment(forces: Moments | TorqueErrors, name: str) -> Array:
    """Get one moment (nf,) N·m of generalised forces, or its standard error.

    Parameters
    ----------
    forces : Moments or TorqueErrors
        Generalised forces of a trial, or their standard errors.
    name : str
        Coordinate or knee reaction, with its side.

    Returns
    -------
    (nf,) Array
        N·m
    """
    if name in REACTIONS:
        return forces.knee_adduction[:, REACTIONS.index(name)]
    return forces.tau[:, COORDINATE_INDEX[name]]


def get_trial_marker_se(errors: TorqueErrors, name: str) -> Array | None:
    """Get the part of a moment's standard error that the markers of the trial make.

    Parameters
    ----------
    errors : TorqueErrors
        Standard errors of a trial.
    name : str
        Coordinate or knee reaction, with its side.

    Returns
    -------
    (nf,) Array or None
        N·m; None where it is not known.
    """
    variance = errors.by_source.get(ErrorSource.MOTION)
    return None if variance is None else np.sqrt(variance[:, FORCES.index(name)])


@dataclass(frozen=True)
class Extreme:
    """Largest value of a moment."""

    value: float  # N·m/kg
    error: float | None  # N·m/kg, standard error; None where not known
    bwh: float  # the value in % of body weight times height
    at: float  # % of the gait cycle, or s where curves are drawn over time


@dataclass(frozen=True, kw_only=True)
class MomentSummary:
    """Summary of one joint moment of one trial."""

    name: str
    """Coordinate or knee reaction: `hip_flexion_r`."""
    highest: Extreme | None
    """Over the valid frames of the stride that is drawn; None without any."""
    change: float
    """N·m/kg, RMS over all valid frames of the difference between calibrated and nominal model."""
    change_bwh: float
    """The change in % of body weight times height."""
    peak: float
    """N·m/kg, largest absolute value over all valid frames."""

    @property
    def side(self) -> str:
        """Side of the moment: `r`, `l` or empty."""
        return split_side(self.name)[1]

    @property
    def change_of_peak(self) -> float:
        """Change by the calibration in percent of the peak."""
        return 100.0 * self.change / self.peak if self.peak else 0.0


def summarise_moments(
    model: SubjectModel,
    layout: Layout,
    final: Moments,
    nominal: Moments,
    errors: TorqueErrors | None = None,
) -> tuple[MomentSummary, ...]:
    """Summarise all joint moments with valid frames, right and left side by side.

    Parameters
    ----------
    model : SubjectModel
        Calibrated model.
    layout : Layout
        Strides and valid frames; those of a leg are valid by its foot.
    final, nominal : Moments
        Moments with the calibrated and with the nominal model.
    errors : TorqueErrors, optional
        Standard errors of `final`.

    Returns
    -------
    tuple of MomentSummary
    """
    subject = model.subject
    to_bwh = 100.0 * subject.mass / subject.bwh
    names = list_moments(model)
    bases = list(dict.fromkeys(split_side(name)[0] for name in names))
    names.sort(key=lambda name: (bases.index(split_side(name)[0]), split_side(name)[1] == "l"))
    summaries = []
    for name in names:
        side, valid = split_side(name)[1], layout.get_valid_frames(get_leg(name))
        if not valid.any():
            continue
        moment, before = (get_moment(f, name) / subject.mass for f in (final, nominal))
        frames = np.flatnonzero(valid & layout.select_drawn_frames(side))
        highest = None
        if len(frames):
            frame = int(frames[moment[frames].argmax()])
            error = np.nan if errors is None else get_moment(errors, name)[frame] / subject.mass
            at = float(layout.time[frame])
            if layout.by_cycle:
                at = float(layout.select_main_cycle(side).compute_percent(at))
            value = float(moment[frame])
            known_error = float(error) if np.isfinite(error) else None
            highest = Extreme(value, known_error, to_bwh * value, at)
        change = float(np.sqrt(np.mean((moment - before)[valid] ** 2)))
        summaries.append(
            MomentSummary(
                name=name,
                highest=highest,
                change=change,
                change_bwh=to_bwh * change,
                peak=float(np.abs(moment[valid]).max()),
            )
        )
    return tuple(summaries)


_NAME = re.compile(r"[a-z_]+(\.[a-z]+){1,2}")
SIDE_WORDS = {**linkage.SIDE_WORDS, "": ""}


def describe_coordinate_side(name: str) -> str:
    """Describe a coordinate with its side: `hip_flexion_r` -> `Right hip flexion`."""
    return capitalise(_add_side(COORDINATE_TABLE[split_side(name)[0]].title, split_side(name)[1]))


def capitalise(text: str) -> str:
    """Make the first letter a capital one; all others stay."""
    return text[:1].upper() + text[1:]


def _add_side(word: str, side: str) -> str:
    """Add the side: `Hip` -> `right hip`; without a side the word stays."""
    return f"{SIDE_WORDS[side]} {word[:1].lower()}{word[1:]}" if side else word


def describe_segment(segment: str) -> str:
    """Describe a segment: `thigh_r` -> `right thigh`."""
    base, side = split_side(segment)
    return _add_side(
        SEGMENT_TABLE[base].title or base if base in SEGMENT_TABLE else base.replace("_", " "), side
    )


def describe_joint(joint: str) -> str:
    """Describe a joint: `knee_r` -> `right knee`; without a side, `Knee`."""
    base, side = split_side(joint)
    return _add_side(JOINT_TABLE[base].title if base in JOINT_TABLE else base.capitalize(), side)


_POSITIONS = ("forward", "up", "to the right")
_ORIENTATIONS = ("frontal tilt", "transverse rotation", "sagittal rotation")
_INERTIAL = {
    "mass": ("", "mass"),
    "com.ant": ("mass centre", "forward"),
    "com.sup": ("mass centre", "up"),
    "com.lat": ("mass centre", "to the right"),
    "moi.ant": ("moment of inertia about the", "forward axis"),
    "moi.sup": ("moment of inertia about the", "upward axis"),
    "moi.lat": ("moment of inertia about the", "sideways axis"),
}


def _describe_parameter_location(name: str) -> str:
    """Describe what a parameter belongs to: `hip_r.pelvis.ant` -> `hip centre in the pelvis`.

    `thigh_r.com.sup` gives `mass centre`; a mass gives an empty text.
    """
    if name in IP_INDEX:
        return _INERTIAL[name.split(".", 1)[1]][0]
    parameter = JOINT_PARAMETERS[JP_INDEX[name]]
    segment = describe_segment(split_side(parameter.segment)[0])
    return f"{JOINT_TABLE[split_side(parameter.joint)[0]].feature} in the {segment}"


def _describe_parameter_direction(name: str) -> str:
    """Describe the direction of a parameter: `hip_r.pelvis.ant` -> `forward`."""
    if name in IP_INDEX:
        return _INERTIAL[name.split(".", 1)[1]][1]
    parameter = JOINT_PARAMETERS[JP_INDEX[name]]
    labels = _POSITIONS if parameter.kind is ParameterKind.POSITION else _ORIENTATIONS
    return labels[parameter.axis]


def describe_parameter(name: str) -> str:
    """Describe a parameter: `hip_r.pelvis.ant` -> `hip centre in the pelvis, forward`."""
    between = " " if name in IP_INDEX else ", "
    location, direction = _describe_parameter_location(name), _describe_parameter_direction(name)
    return f"{location}{between}{direction}".strip()


def explain_parameters(text: str) -> str:
    """Explain the parameters that a text names.

    Parameters
    ----------
    text : str
        Message.

    Returns
    -------
    str
        Text with a description after each parameter: `hip_r.pelvis.ant (right hip centre ...)`.
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
    """Describe what a trial is for.

    Parameters
    ----------
    role : Role
        Role in the study.
    joint : str or None
        Joint of a functional trial (`hip_r`).

    Returns
    -------
    str
        `right hip alone`, `walking`.
    """
    if role is Role.STATIC:
        return "standing still"
    if joint:
        return f"{describe_joint(joint)} alone"
    return "any movement" if role is Role.MOTION else "walking"


def format_count(number: int, noun: str) -> str:
    """Format a number with its noun: `1 frame`, `3 frames`."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def format_list(texts: list[str]) -> str:
    """Join texts to a list: `a, b and c`."""
    if len(texts) < 2:
        return "".join(texts)
    return f"{', '.join(texts[:-1])} and {texts[-1]}"
