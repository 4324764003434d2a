"""Powers and moment vectors of all joints of a motion, and how errors of motion and forces move them.

Everything told here is linear in the generalised forces f, with coefficients that posture and rates give,

    y = L(q, v) f,      d y = L d f + (dL/dq f) d q + (dL/dv f) d v + (dL/dp f) d p,

so that the errors of torques (`calibration/torque_errors.py`) pass on to powers and moments, each source of error with
all that it moves at once: a torque and the rate beside it are not independent of each other.

Joint powers: what the structures that cross a joint do, net, in a second.

    P_k = tau_k v_k      of a coordinate: its generalised force times its rate,
    P   = sum_k P_k      of a joint: over its coordinates.

Positive: work is done on the segments (generated, concentric); negative: it is taken from them (absorbed, eccentric).
At joints whose axes meet in one point (hip, back) and at hinges (knee, elbow) the sum is the joint moment times the
angular velocity of the distal segment relative to the proximal one, M . w; the ankle holds both of its hinges, whose
axes do not meet. The pelvis has no joint: its residual is none of the body's.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.dynamics.inverse_dynamics import FORCES, Dynamics
from gaitcal.dynamics.joint_moments import (
    ALL_FORCES,
    COMPONENTS,
    HELD,
    NET_JOINTS,
    VECTOR_FRAMES,
    MomentFrame,
    moment_slopes,
)
from gaitcal.errors import nearest
from gaitcal.model.coordinates import JOINT_TABLE, split_side
from gaitcal.model.linkage import COORDINATES, JOINTS, Source
from gaitcal.model.parameters import Parameters
from gaitcal.model.subject_model import SubjectModel
from gaitcal.motion.motion import Motion
from gaitcal.runtime import with_one_blas_thread


def _joints() -> dict[str, tuple[str, ...]]:
    found: dict[str, tuple[str, ...]] = {}
    for joint in JOINTS:
        kind, side = split_side(joint.name)
        name = JOINT_TABLE[kind].power + (f"_{side}" if side else "")
        own = tuple(e.name for e in joint.elements if e.source is Source.COORDINATE)
        found[name] = (*found.get(name, ()), *own)
    return found


POWER_JOINTS: dict[str, tuple[str, ...]] = _joints()
"""Joint (`hip_r`, ..., `lumbar`, `shoulder_r`, `elbow_r`) -> its coordinates."""
POWERS: tuple[str, ...] = (*POWER_JOINTS, *(name for own in POWER_JOINTS.values() if len(own) > 1 for name in own))
"""Order of every array of powers: of each joint, then of each coordinate of those that have several."""
POWER_SUMS: Array = np.array(
    [[float(c == name or c in POWER_JOINTS.get(name, ())) for c in COORDINATES] for name in POWERS]
)
"""(np, nq) which coordinates' powers make each power."""
POWER_COORDINATES: dict[str, tuple[str, ...]] = {name: POWER_JOINTS.get(name, (name,)) for name in POWERS}


def power_name(name: str) -> str:
    """What a power is called in files: `hip_power_r` of `hip_r`, `hip_flexion_power_r` of `hip_flexion_r`."""
    sided = name[-2:] in ("_r", "_l")
    return f"{name[:-2]}_power{name[-2:]}" if sided else f"{name}_power"


def powers(tau: Array, velocity: Array) -> Array:
    """(nf, np) W, in the order of `POWERS`, from generalised forces and rates of the coordinates (nf, nq)."""
    out: Array = (tau * velocity) @ POWER_SUMS.T
    return out


BLOCK = 500
"""Frames at a time."""


@dataclass(frozen=True)
class KineticErrors:
    """Standard errors of powers and moment vectors."""

    power: Array
    """(nf, 28) W, in the order of `POWERS`."""
    moment: Array
    """(nf, 3, 21) N·m, by `VECTOR_FRAMES` and `COMPONENTS`."""
    own: KineticErrors | None = None
    """The part that the trial's own markers make, which differs from stride to stride; None where it is not known."""

    def only(self, coordinates: BoolArray) -> KineticErrors:
        """The same with NaN for all that is not made of some coordinates (nq,) alone."""
        kept = {name for name, chosen in zip(COORDINATES, coordinates, strict=True) if chosen}
        joints = {joint for joint, own in POWER_JOINTS.items() if kept.issuperset(own)}
        powers = [kept.issuperset(POWER_COORDINATES[name]) for name in POWERS]
        moments = [joint.name in joints for joint in NET_JOINTS for _ in joint.components]
        own = None if self.own is None else self.own.only(coordinates)
        return KineticErrors(np.where(powers, self.power, np.nan), np.where(moments, self.moment, np.nan), own)


@dataclass(frozen=True, kw_only=True)
class JointKinetics:
    """Powers and moment vectors of the joints of one trial: internal, net, acting on the distal segment."""

    time: Array
    """(nf,) s."""
    power: Array
    """(nf, 28) W, in the order of `POWERS`; positive where work is done on the segments."""
    moment: Array
    """(nf, 3, 21) N·m, by `VECTOR_FRAMES` and `COMPONENTS`; positive in the sense of the coordinate of that name:
    flexion, adduction, internal rotation, dorsiflexion, inversion on both sides."""


def power_of(kinetics: JointKinetics | KineticErrors, name: str) -> Array:
    """(nf,) W, or its standard error, of a joint (`hip_r`, `ankle_l`, `lumbar`) or coordinate (`hip_flexion_r`).

    Raises
    ------
    ValueError
        There is none of that name.
    """
    out: Array = kinetics.power[:, _place(name, POWERS)]
    return out


def component_of(kinetics: JointKinetics | KineticErrors, name: str, frame: MomentFrame) -> Array:
    """(nf,) N·m, or its standard error: a component (`knee_adduction_r`) along the axes of one of `VECTOR_FRAMES`.

    Raises
    ------
    ValueError
        There is no component of that name, or the frame is that of the coordinates (`Moments.tau` has those).
    """
    if frame not in VECTOR_FRAMES:
        raise ValueError(f"'{frame.key}' has no vectors; the torques of the coordinates are in Moments.tau")
    out: Array = kinetics.moment[:, VECTOR_FRAMES.index(frame), _place(name, COMPONENTS)]
    return out


def _place(name: str, names: tuple[str, ...]) -> int:
    if name not in names:
        raise ValueError(f"found '{name}'; allowed: {', '.join(names)}{nearest(name, names)}")
    return names.index(name)


def kinetics_of(parameters: Parameters, motion: Motion, wrenches: Array) -> JointKinetics:
    """Powers and moments of a whole-body motion under foot wrenches (nf, 2, 6)."""
    state = motion.q, motion.velocity, motion.acceleration
    power, moment = kinetic_values(parameters, *state, wrenches)
    return JointKinetics(time=motion.time, power=power, moment=moment)


def kinetic_values(parameters: Parameters, q: Array, v: Array, a: Array, wrenches: Array) -> tuple[Array, Array]:
    """(nf, 28) W and (nf, 3, 21) N·m at coordinates (nf, nq), their derivatives, and foot wrenches (nf, 2, 6)."""
    forces = Dynamics(parameters, HELD).forces(q, v, a, wrenches)
    moment = np.empty((len(q), len(VECTOR_FRAMES), len(COMPONENTS)))
    for start in range(0, len(q), BLOCK):
        part = slice(start, start + BLOCK)
        moment[part] = by_frame(moment_slopes(parameters, q[part], forces[part]).values)
    return powers(forces[:, : len(COORDINATES)], v), moment


@with_one_blas_thread
def joint_kinetics(model: SubjectModel, motion: Motion, forces: Array) -> JointKinetics:
    """Powers and moment vectors of the joints of a whole-body motion, as `inverse_dynamics` gives its torques.

    Parameters
    ----------
    model : the person's model; its parameters should be those the motion was tracked with.
    motion : from `gaitcal.track`, all coordinates.
    forces : (nf, 2, 6) ground on right and left foot: force (N) and moment (N·m) about the laboratory origin, as in
        `gaitcal.ground_reactions(...).wrench`. A leg's powers and moments count where that leg is valid.

    Raises
    ------
    ValueError
        The motion is of a part of the body only, or there is not one row of forces for every frame.
    """
    if motion.coordinates != COORDINATES:
        raise ValueError(f"joint kinetics need a motion of the whole body, with all {len(COORDINATES)} coordinates")
    if forces.shape != (len(motion.time), 2, 6):
        raise ValueError(f"forces have shape {forces.shape}, expected ({len(motion.time)}, 2, 6)")
    return kinetics_of(model.parameters, motion, forces)


def by_frame(values: Array) -> Array:
    """(nf, 3, 21) from (nf, 63) rows that run over joint, frame, component."""
    joints = values.reshape(len(values), -1, len(VECTOR_FRAMES), 3)
    out: Array = joints.transpose(0, 2, 1, 3).reshape(len(values), len(VECTOR_FRAMES), -1)
    return out


@dataclass(frozen=True)
class KineticSlopes:
    """How the 29 generalised forces, the 28 powers and the 63 components of moments depend on what they are made of.

    Rows run over these quantities.
    """

    by_force: Array
    """(nf, 120, 35) L, per generalised force (`ALL_FORCES`)."""
    by_position: Array
    """(nf, 120, nq), generalised forces staying; so are the following."""
    by_velocity: Array
    """(nf, 120, nq)."""
    by_parameter: Array
    """(nf, 120, np) per free joint parameter."""
    by_turn: dict[str, Array]
    """Segment -> (nf, 63, 3), of the moments per turn of that segment's axes."""

    def moved(self, forces: Array, velocity: Array, turns: dict[str, Array]) -> Array:
        """(nf, 120, k) what errors in the direction of segments' axes make, in k columns.

        They move the generalised forces by `forces` (nf, nt, k), rates by `velocity` (nf, nq, k), and turn segments by
        `turns` (nf, k, 3), rad, bodies and joints staying where they are.
        """
        own = len(FORCES) + len(POWERS)
        out = np.zeros((forces.shape[0], self.by_force.shape[1], forces.shape[2]))
        # moments stay where they are in the laboratory: of the forces only torques and powers are made
        out[:, :own] = self.by_force[:, :own, : len(FORCES)] @ forces + self.by_velocity[:, :own] @ velocity
        for segment, turn in turns.items():
            if segment in self.by_turn:
                out[:, own:] += self.by_turn[segment] @ turn.transpose(0, 2, 1)
        return out


def kinetic_slopes(
    parameters: Parameters, q: Array, v: Array, forces: Array, free: tuple[str, ...] = ()
) -> KineticSlopes:
    """At coordinates and rates (nf, nq), with generalised forces (nf, 35); `free` are joint parameters to derive by."""
    moments = moment_slopes(parameters, q, forces, free)
    nf, torques, coordinates = len(q), len(FORCES), len(COORDINATES)
    rows = torques + len(POWERS) + moments.values.shape[1]
    of_power, of_moment = slice(torques, torques + len(POWERS)), slice(torques + len(POWERS), rows)
    by_force, by_position, by_velocity, by_parameter = (
        np.zeros((nf, rows, width))
        for width in (len(ALL_FORCES), coordinates, coordinates, moments.by_parameter.shape[2])
    )
    by_force[:, range(torques), range(torques)] = 1.0
    by_force[:, of_power, :coordinates] = POWER_SUMS * v[:, None]
    by_velocity[:, of_power] = POWER_SUMS * forces[:, None, :coordinates]
    by_force[:, of_moment], by_position[:, of_moment] = moments.by_force, moments.by_position
    by_parameter[:, of_moment] = moments.by_parameter
    return KineticSlopes(by_force, by_position, by_velocity, by_parameter, moments.by_turn)


def kinetic_errors(variance: Array, own: Array | None = None) -> KineticErrors:
    """From the variances (nf, 91) of powers and moment vectors; `own`: the part of the trial's own markers."""
    errors, part = np.sqrt(variance), None if own is None else kinetic_errors(own)
    return KineticErrors(errors[:, : len(POWERS)], by_frame(errors[:, len(POWERS) :]), part)
