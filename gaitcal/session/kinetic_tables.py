"""The tables of joint powers and of moment vectors of a trial, as `powers/TRIAL.csv` and `moment_vectors/TRIAL.csv`."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gaitcal.arrays import Array
from gaitcal.dynamics.ground_contact import GroundReactions
from gaitcal.dynamics.joint_kinetics import JointKinetics, component_of, power_of
from gaitcal.dynamics.joint_moments import COMPONENTS, NET_JOINTS, VECTOR_FRAMES, MomentFrame
from gaitcal.dynamics.powers import POWER_COORDINATES, POWERS, power_name
from gaitcal.session.result import LoadedTrial

POWER_HEADER = (
    "joint powers: torque times angular velocity of each coordinate, of a joint the sum over its coordinates; net of",
    "all structures that cross the joint; positive: generated, negative: absorbed; ankle_power: both hinges together",
    "units: W; NAME_per_kg: W/kg; NAME_se: standard error, W, of torque and velocity together; empty where unknown",
    "valid_r, valid_l, valid: as of the torques (moments/): 1 where powers of that leg, and of trunk and arms, count",
)
"""Comment lines above the header of every file of powers."""
VECTOR_HEADER = (
    "net joint moments as vectors, N m: internal, on the distal segment, about the joint centre (ankle: talocrural)",
    *(f"NAME_{frame.key}: {frame.words}" for frame in VECTOR_FRAMES),
    "axes of: hip pelvis, thigh; knee thigh, shank; ankle shank, foot; lumbar pelvis, trunk. _angle, _flexion,",
    "_extension about z, _adduction, _inversion, _bending about x (floating axis), _rotation about y",
    "positive: flexion, adduction, inversion, dorsiflexion, internal rotation on both sides; trunk as coordinates",
    "_se: standard error; _se_stride: the part of it that differs from stride to stride; empty where unknown",
    "valid_r, valid_l, valid: as of the torques (moments/)",
)
"""Comment lines above the header of every file of moment vectors."""


def power_table(loads: LoadedTrial, kinetics: JointKinetics, mass: float) -> dict[str, NDArray[Any]]:
    """time, valid, valid_r, valid_l, then per power its value (W), standard error and W/kg; `mass` in kg."""
    errors = None if loads.errors is None else loads.errors.kinetics
    columns = _first(kinetics.time, loads.reactions)
    for name in POWERS:
        value, column = power_of(kinetics, name), power_name(name)
        columns[column] = value
        columns[f"{column}_se"] = np.full(len(value), np.nan) if errors is None else power_of(errors, name)
        columns[f"{column}_per_kg"] = value / mass
    return columns


def vector_table(loads: LoadedTrial, kinetics: JointKinetics) -> dict[str, NDArray[Any]]:
    """time, valid, valid_r, valid_l, then per component and frame its value (N·m) and standard errors."""
    errors = None if loads.errors is None else loads.errors.kinetics
    known = {"_se": errors, "_se_stride": None if errors is None else errors.own}
    unknown = np.full(len(kinetics.time), np.nan)
    columns = _first(kinetics.time, loads.reactions)
    for name in COMPONENTS:
        for frame in VECTOR_FRAMES:
            value, column = component_of(kinetics, name, frame), vector_column(name, frame)
            columns[column] = value
            for ending, of in known.items():
                columns[column + ending] = unknown if of is None else component_of(of, name, frame)
    return columns


def vector_column(name: str, frame: MomentFrame) -> str:
    """`knee_adduction_r_proximal`."""
    return f"{name}_{frame.key}"


def told_powers(frozen: tuple[str, ...]) -> Iterator[str]:
    """Powers that say something: not all of their coordinates are held at zero."""
    return (name for name in POWERS if not set(POWER_COORDINATES[name]) <= set(frozen))


def told_components(frozen: tuple[str, ...]) -> Iterator[str]:
    """Components of moments between segments that markers show: the joint's coordinates are not all held at zero."""
    for joint in NET_JOINTS:
        if not set(POWER_COORDINATES[joint.name]) <= set(frozen):
            yield from joint.components


def _first(time: Array, reactions: GroundReactions) -> dict[str, NDArray[Any]]:
    columns: dict[str, NDArray[Any]] = {"time": time, "valid": reactions.valid.astype(int)}
    return columns | {"valid_r": reactions.valid_r.astype(int), "valid_l": reactions.valid_l.astype(int)}
