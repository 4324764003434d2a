"""Build the tables of a trial: coordinates, moments, powers, moment vectors, marker errors."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gaitcal.analysis.result import Loads, TrialResult
from gaitcal.arrays import Array, BoolArray
from gaitcal.dynamics import joint_kinetics
from gaitcal.dynamics.ground_reactions import GroundReactions
from gaitcal.gait.cycles import GaitCycle
from gaitcal.gait.moments import get_moment
from gaitcal.gait.spatiotemporal import Stride
from gaitcal.gait.strides import express_along_line
from gaitcal.model.linkage import FILE_COORDINATES, REACTIONS, is_translation
from gaitcal.tracking.motion import select_static_offsets

COORDINATE_HEADER = (
    "coordinates in degrees and m, _velocity per s, _acceleration per s^2; exact derivatives of "
    "the splines",
    "_se: standard error, from marker noise through joint parameters and motion (gait trials)",
)
"""Comment lines above the header of every file of coordinates."""


def format_relative_header(relative_to: Mapping[str, float]) -> tuple[str, ...]:
    """Format the comment lines of a file with relative joint angles.

    Parameters
    ----------
    relative_to
        Coordinate -> rad in the static posture.

    Returns
    -------
    tuple of str
        Two lines.
    """
    off = select_static_offsets(relative_to)
    static = ", ".join(f"{n} {np.rad2deg(off[n]):.2f}" for n in FILE_COORDINATES if n in off)
    return (
        "joint angles are relative: those of the static trial are subtracted; pelvis coordinates "
        "are not changed",
        f"static trial, deg: {static}",
    )


MOMENT_HEADER = (
    "generalised forces: internal and net (all structures that cross the joint), acting on the "
    "distal segment",
    "sign: positive drives the coordinate of that name in its positive direction; external moments "
    "have the other sign",
    "frame: about the axis of each coordinate; pelvis translations along the laboratory axes x "
    "forward, y up, z right",
    "knee_adduction: internal reaction moment of the thigh on the shank about the x axis of the "
    "knee frame",
    "units: N m (pelvis_tx, _ty, _tz: N); NAME_se standard error; NAME_bwh percent of body weight "
    "times height",
    "valid_r, valid_l: 1 where that foot is entirely on plates that carry no other foot, or in the "
    "air; only there use torques of that leg",
    "valid: 1 where both legs are valid and a plate carries the body; only there use torques of "
    "pelvis, trunk and arms",
)
"""Comment lines above the header of every moments file."""


def build_moment_table(loads: Loads) -> dict[str, NDArray[Any]]:
    """Build the columns of `moments/TRIAL.csv`.

    Parameters
    ----------
    loads
        Torques and ground reactions of a trial.

    Returns
    -------
    dict
        time, valid, valid_r, valid_l, then each force with its standard error and % of body weight
        times height.
    """
    final, unknown = loads.final, np.full(len(loads.final.time), np.nan)
    columns = _build_first_columns(final.time, loads.reactions)
    for name in (*FILE_COORDINATES, *REACTIONS):
        value = get_moment(final, name)
        columns[name] = value
        columns[f"{name}_se"] = unknown if loads.errors is None else get_moment(loads.errors, name)
        columns[f"{name}_bwh"] = unknown if is_translation(name) else 100.0 * value / final.bwh
    return columns


def build_marker_error_table(trial: TrialResult) -> dict[str, Array]:
    """Build the columns of `marker_errors/TRIAL.csv`.

    Parameters
    ----------
    trial
        One trial.

    Returns
    -------
    dict
        time, then per marker the distance (mm) of measured and model marker; NaN if not visible.
    """
    errors = trial.calibrated.errors
    columns = {"time": trial.calibrated.time}
    columns.update({label: 1e3 * errors.distance[:, k] for k, label in enumerate(errors.labels)})
    return columns


POWER_HEADER = (
    "joint powers: torque times angular velocity of each coordinate, of a joint the sum over its "
    "coordinates; net of",
    "all structures that cross the joint; positive: generated, negative: absorbed; ankle_power: "
    "both hinges together",
    "units: W; NAME_per_kg: W/kg; NAME_se: standard error, W, of torque and velocity together; "
    "empty where unknown",
    "valid_r, valid_l, valid: as of the torques (moments/): 1 where powers of that leg, and of "
    "trunk and arms, count",
)
"""Comment lines above the header of every file of powers."""
VECTOR_HEADER = (
    "net joint moments as vectors, N m: internal, on the distal segment, about the joint centre "
    "(ankle: talocrural)",
    *(f"NAME_{frame.key}: {frame.label}" for frame in joint_kinetics.VECTOR_FRAMES),
    "axes of: hip pelvis, thigh; knee thigh, shank; ankle shank, foot; lumbar pelvis, trunk. "
    "_angle, _flexion,",
    "_extension about z, _adduction, _inversion, _bending about x (floating axis), _rotation about "
    "y",
    "positive: flexion, adduction, inversion, dorsiflexion, internal rotation on both sides; trunk "
    "as coordinates",
    "_se: standard error; _se_stride: the part of it that differs from stride to stride; empty "
    "where unknown",
    "valid_r, valid_l, valid: as of the torques (moments/)",
)
"""Comment lines above the header of every file of moment vectors."""


def build_power_table(
    loads: Loads, kinetics: joint_kinetics.JointKinetics, mass: float
) -> dict[str, NDArray[Any]]:
    """Build the columns of `powers/TRIAL.csv`.

    Columns are time, valid, valid_r, valid_l, then each power (W), its standard error and W/kg;
    `mass` in kg.
    """
    errors = None if loads.errors is None else loads.errors.kinetics
    columns = _build_first_columns(kinetics.time, loads.reactions)
    for name in joint_kinetics.POWERS:
        value, column = (
            joint_kinetics.power_of(kinetics, name),
            joint_kinetics.name_power_column(name),
        )
        columns[column] = value
        columns[f"{column}_se"] = (
            np.full(len(value), np.nan) if errors is None else joint_kinetics.power_of(errors, name)
        )
        columns[f"{column}_per_kg"] = value / mass
    return columns


def build_vector_table(
    loads: Loads, kinetics: joint_kinetics.JointKinetics
) -> dict[str, NDArray[Any]]:
    """Build the columns of `moment_vectors/TRIAL.csv`.

    Columns are time, valid, valid_r, valid_l, then each component in each frame (N·m) with its
    standard errors.
    """
    errors = None if loads.errors is None else loads.errors.kinetics
    # Standard errors, and their part from the markers of this trial.
    known = {"_se": errors, "_se_stride": None if errors is None else errors.from_markers}
    # Columns exist in every file, so that tables of several trials can be joined.
    unknown = np.full(len(kinetics.time), np.nan)
    columns = _build_first_columns(kinetics.time, loads.reactions)
    for name in joint_kinetics.COMPONENTS:
        for frame in joint_kinetics.VECTOR_FRAMES:
            column = joint_kinetics.name_vector_column(name, frame)
            columns[column] = joint_kinetics.component_of(kinetics, name, frame)
            for ending, kinetics_of_errors in known.items():
                columns[column + ending] = (
                    unknown
                    if kinetics_of_errors is None
                    else joint_kinetics.component_of(kinetics_of_errors, name, frame)
                )
    return columns


def select_free_powers(frozen: tuple[str, ...]) -> Iterator[str]:
    """Select powers with at least one coordinate that is not held at zero."""
    return (
        name
        for name in joint_kinetics.POWERS
        if not set(joint_kinetics.POWER_COORDINATES[name]) <= set(frozen)
    )


def select_free_components(frozen: tuple[str, ...]) -> Iterator[str]:
    """Select moment components of joints with at least one coordinate that is not held at zero."""
    for joint in joint_kinetics.NET_JOINTS:
        if not set(joint_kinetics.POWER_COORDINATES[joint.name]) <= set(frozen):
            yield from joint.components


def _build_first_columns(time: Array, reactions: GroundReactions) -> dict[str, NDArray[Any]]:
    columns: dict[str, NDArray[Any]] = {"time": time, "valid": reactions.valid.astype(int)}
    return columns | {
        "valid_r": reactions.valid_r.astype(int),
        "valid_l": reactions.valid_l.astype(int),
    }


def express_pelvis_in_stride(
    trial: TrialResult, angles: Array, cycle: GaitCycle, stride: Stride | None
) -> Array:
    """Express pelvis angles relative to the line of progression of one stride.

    Parameters
    ----------
    trial
        One trial.
    angles
        (nf, 3) rad, `PELVIS_ANGLES` relative to the laboratory.
    cycle
        The stride or repetition.
    stride
        Its measures; None if nothing was measured.

    Returns
    -------
    (nf, 3) array
        Deg, over all frames of the trial.
    """
    return np.asarray(
        np.degrees(
            express_along_line(
                angles, find_stride_line(trial, cycle, stride), _find_inside(trial, cycle)
            )
        )
    )


def express_foot_in_stride(
    trial: TrialResult, side: str, cycle: GaitCycle, stride: Stride | None
) -> Array | None:
    """Express foot progression relative to the line of progression of one stride.

    Parameters
    ----------
    trial
        One trial.
    side
        `r` or `l`.
    cycle
        The stride or repetition.
    stride
        Its measures; None if nothing was measured.

    Returns
    -------
    (nf,) array or None
        Deg, over all frames of the trial; None if the axis of the foot is unknown.
    """
    feet, line = trial.foot_axes, find_stride_line(trial, cycle, stride)
    return (
        None
        if feet is None
        else np.degrees(feet.compute_progression(side, line, _find_inside(trial, cycle)))
    )


def _find_inside(trial: TrialResult, cycle: GaitCycle) -> BoolArray:
    return np.asarray((trial.body.time >= cycle.start) & (trial.body.time <= cycle.stop))


def find_stride_line(trial: TrialResult, cycle: GaitCycle, stride: Stride | None) -> float:
    """Find the line of progression of a stride, or of the nearest one in time.

    Rad to the left of the laboratory's x axis; 0 if no stride has a line.
    """
    if stride is not None and stride.line is not None:
        return stride.line
    middle = 0.5 * (cycle.start + cycle.stop)
    known = [
        (abs(0.5 * (s.start + s.stop) - middle), s.line)
        for s in trial.strides
        if s.line is not None and s.start is not None and s.stop is not None
    ]
    return min(known)[1] if known else 0.0
