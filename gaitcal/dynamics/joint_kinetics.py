"""Joint powers, net joint moments as vectors, and their sensitivities to errors.

M is the net moment of the proximal segment on the distal one, about the joint centre, of all
structures that cross the joint. Three rotations of the linkage pass through that centre, about axes
a_k. Their generalised forces are

    tau_k = a_k . M,      so that      M = A^-1 tau,      with the a_k as rows of A.

All three are coordinates at the hip and the back. The knee adds its locked reaction and the locked
joint parameter of its rotation about the length; the ankle the two joint parameters of its hinge.
The components are m_i = e_i . M:

    proximal, distal    e_1, e_2, e_3 = z, x, y of that segment (x forward, y up, z right: Wu and
                        Cavanagh, J Biomech 28:1257-1261, 1995)
    joint coordinate    e_1 = z of the proximal segment, e_3 = y of the distal one,
    system
    e_2 = e_3 x e_1 / |e_3 x e_1|, the floating axis (Grood and Suntay, J Biomech
                        Eng 105:136-144, 1983)

The axes e_1 and e_3 are not at right angles to each other. m_i is the orthogonal projection ("motor
torque"), not the part of M along the axis (Desroches, Cheze and Dumas, J Biomech Eng 132:114503,
2010). For the effect of the frame see Schache and Baker, Gait Posture 25:440-452, 2007.

A small rotation p of the proximal segment and d of the distal one, at constant M, change m_i by
p . g_i + d . h_i,

    proximal   g_i = e_i x M;    distal   h_i = e_i x M;    joint   g_1 = e_1 x M,  h_3 = e_3 x M,
    g_2 = e_1 x (b x e_3),  h_2 = e_3 x (e_1 x b),   b = (M - m_2 e_2) / |e_3 x e_1|.

A variable x_j of the chain that rotates all segments after it about w_j also rotates a_k, if it
comes before rotation k, so that

    d m_i / d x_j = w_j . (g_i [j moves the proximal] + h_i [j moves the distal] - sum_k c_ik (a_k x
    M) [j before k])

besides c_i . d tau, with c_i = A^-T e_i.

Powers: P_k = tau_k v_k of a coordinate, and their sum of a joint. Positive power generates energy
(concentric), negative power absorbs it (eccentric). At joints whose axes meet in one point (hip,
back) and at hinges (knee, elbow) the sum is M . w, with w the angular velocity of the distal
segment relative to the proximal one. The axes of the two ankle hinges do not meet. The pelvis has
no joint.

Powers and moments are linear in the generalised forces f, y = L(q, v) f, so that

    d y = L d f + (dL/dq f) d q + (dL/dv f) d v + (dL/dp f) d p.

All changes of one error source are propagated together: a torque and its rate are correlated.
"""

from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

import numpy as np

from gaitcal.arrays import Array, BoolArray, cross, stretches
from gaitcal.display import Displayed
from gaitcal.dynamics.inverse_dynamics import FORCES, Dynamics
from gaitcal.errors import suggest_name
from gaitcal.model.coordinates import JOINT_TABLE, split_side
from gaitcal.model.kinematics import Kinematics
from gaitcal.model.linkage import COORDINATES, JOINTS, SIDES, Source, list_joint_segments
from gaitcal.model.parameters import JP_INDEX, Parameters
from gaitcal.model.subject_model import SubjectModel
from gaitcal.runtime import with_one_blas_thread
from gaitcal.tracking.motion import Motion

if TYPE_CHECKING:
    import pandas as pd

BLOCK = 500
"""Frames in one block, to bound memory."""


class MomentFrame(Enum):
    """Axes along which a joint moment is expressed. `label`: in files and on pages."""

    COORDINATES = (
        "coordinates",
        "about the axis of each coordinate of the model (generalised force)",
    )
    """About the axis of each coordinate."""
    PROXIMAL = ("proximal", "in the frame of the proximal segment (x forward, y up, z right; ISB)")
    """Along the axes of the proximal segment."""
    DISTAL = ("distal", "in the frame of the distal segment (x forward, y up, z right; ISB)")
    """Along the axes of the distal segment."""
    JCS = (
        "jcs",
        "orthogonal projection on the axes of the joint coordinate system (Grood and Suntay 1983): "
        "z of the "
        "proximal segment, the floating axis, y of the distal segment",
    )
    """Projected on the axes of the joint coordinate system."""

    def __init__(self, key: str, label: str) -> None:
        self.key, self.label = key, label


VECTOR_FRAMES = (MomentFrame.PROXIMAL, MomentFrame.DISTAL, MomentFrame.JCS)
"""Frames of moment vectors, in the order of every array of three frames."""


@dataclass(frozen=True, kw_only=True)
class NetJoint:
    """Two segments, and the three rotations through the centre of the joint between them."""

    name: str  # `hip_r`
    proximal: str
    distal: str
    # Coordinates, a reaction, joint parameters, in their order along the linkage
    turns: tuple[str, str, str]
    components: tuple[str, str, str]  # Names of the moments about z, x and y
    signs: tuple[float, float, float]
    """About z, x and y: in the sense of the coordinates, which mean the same on both sides."""


_LEG = {
    "hip": ("hip_flexion_{0} hip_adduction_{0} hip_rotation_{0}", "flexion adduction rotation"),
    "knee": ("knee_angle_{0} knee_adduction_{0} knee_{0}.shank.trans", "angle adduction rotation"),
    "ankle": (
        "talocrural_{0}.shank.front talocrural_{0}.shank.trans ankle_angle_{0}",
        "angle inversion rotation",
    ),
}
"""Joint -> its rotations in their order, and names of the moments about z, x and y."""
_BACK = ("lumbar_extension", "lumbar_bending", "lumbar_rotation")
_SIGNS = {e.name: e.sign for joint in JOINTS for e in joint.elements}


def _build_leg_joint(kind: str, side: str) -> NetJoint:
    segments, (turns, components) = list_joint_segments(f"{kind}_{side}"), _LEG[kind]
    first, second, third = turns.format(side).split()
    about_z, about_x, about_y = (f"{kind}_{component}_{side}" for component in components.split())
    across = 1.0 if side == "r" else -1.0
    return NetJoint(
        name=f"{kind}_{side}",
        proximal=segments[0],
        distal=segments[-1],
        turns=(first, second, third),
        components=(about_z, about_x, about_y),
        signs=(next(_SIGNS[t] for t in (first, second, third) if t in COORDINATES), across, across),
    )


NET_JOINTS = (
    *(_build_leg_joint(kind, side) for side in SIDES for kind in _LEG),
    NetJoint(
        name="lumbar",
        proximal="pelvis",
        distal="head_trunk",
        turns=_BACK,
        components=_BACK,
        signs=(1.0, 1.0, 1.0),
    ),
)
"""Legs, right and left, then the back: the order of every array of joint moments."""
HELD: tuple[str, ...] = tuple(
    name for joint in NET_JOINTS for name in joint.turns if name in JP_INDEX
)
"""Joint parameters among their rotations, as `Dynamics` takes them."""
# The 35 generalised forces that the moments follow from
ALL_FORCES: tuple[str, ...] = (*FORCES, *HELD)
COMPONENTS: tuple[str, ...] = tuple(name for joint in NET_JOINTS for name in joint.components)
"""Name of every component, joint by joint: `hip_flexion_r`, `knee_rotation_r`, `ankle_inversion_r`.
"""


def _group_power_joints() -> dict[str, tuple[str, ...]]:
    found: dict[str, tuple[str, ...]] = {}
    for joint in JOINTS:
        kind, side = split_side(joint.name)
        name = JOINT_TABLE[kind].power + (f"_{side}" if side else "")
        coordinates = tuple(e.name for e in joint.elements if e.source is Source.COORDINATE)
        found[name] = (*found.get(name, ()), *coordinates)
    return found


POWER_JOINTS: dict[str, tuple[str, ...]] = _group_power_joints()
"""Joint (`hip_r`, ..., `lumbar`, `shoulder_r`, `elbow_r`) -> its coordinates."""
POWERS: tuple[str, ...] = (
    *POWER_JOINTS,
    *(name for names in POWER_JOINTS.values() if len(names) > 1 for name in names),
)
"""Order of every array of powers: of each joint, then of each coordinate of those that have
several.
"""
POWER_COORDINATES: dict[str, tuple[str, ...]] = {
    name: POWER_JOINTS.get(name, (name,)) for name in POWERS
}
POWER_SUMS: Array = np.array(
    [np.isin(COORDINATES, names) for names in POWER_COORDINATES.values()], dtype=float
)
"""(np, nq) which coordinates' powers make each power."""


def name_power_column(name: str) -> str:
    """Name the column of a power: `hip_power_r` of `hip_r`."""
    sided = name[-2:] in ("_r", "_l")
    return f"{name[:-2]}_power{name[-2:]}" if sided else f"{name}_power"


def compute_powers(tau: Array, velocity: Array) -> Array:
    """Compute powers.

    Parameters
    ----------
    tau
        (nf, nq) generalised forces, N·m and N.
    velocity
        (nf, nq) rates of the coordinates, rad/s and m/s.

    Returns
    -------
    (nf, np) array
        W, in the order of `POWERS`.
    """
    return (tau * velocity) @ POWER_SUMS.T


@dataclass(frozen=True)
class KineticErrors:
    """Standard errors of powers and moment vectors."""

    power: Array
    """(nf, 28) W, in the order of `POWERS`."""
    moment: Array
    """(nf, 3, 21) N·m, by `VECTOR_FRAMES` and `COMPONENTS`."""
    from_markers: "KineticErrors | None" = None
    """Part caused by the noise of this trial's markers, which differs from stride to stride; None
    where it is not available."""

    def select(self, coordinates: BoolArray) -> "KineticErrors":
        """Set all errors to NaN that are not of the given coordinates (nq,) alone."""
        kept = {name for name, chosen in zip(COORDINATES, coordinates, strict=True) if chosen}
        joints = {joint for joint, names in POWER_JOINTS.items() if kept.issuperset(names)}
        powers = [kept.issuperset(POWER_COORDINATES[name]) for name in POWERS]
        moments = [joint.name in joints for joint in NET_JOINTS for _ in joint.components]
        part = None if self.from_markers is None else self.from_markers.select(coordinates)
        return KineticErrors(
            np.where(powers, self.power, np.nan), np.where(moments, self.moment, np.nan), part
        )


@dataclass(frozen=True, kw_only=True, repr=False)
class JointKinetics(Displayed):
    """Powers and net internal moments of the joints of one trial, acting on the distal segment."""

    time: Array
    """(nf,) s."""
    power: Array
    """(nf, 28) W, in the order of `POWERS`; positive where work is done on the segments."""
    moment: Array
    """(nf, 3, 21) N·m, by `VECTOR_FRAMES` and `COMPONENTS`; positive in the sense of the coordinate
    of that name: flexion, adduction, internal rotation, dorsiflexion, inversion on both sides."""

    def to_dataframe(self) -> "pd.DataFrame":
        """Return powers and moment vectors as a table.

        Returns
        -------
        pandas.DataFrame
            `time` (s), then the powers (W) with the names of `powers/TRIAL.csv` and the components
            of the moments (N·m) with those of `moment_vectors/TRIAL.csv`.
        """
        import pandas as pd

        columns = {"time": self.time}
        columns |= {name_power_column(name): power_of(self, name) for name in POWERS}
        for name in COMPONENTS:
            columns |= {
                name_vector_column(name, frame): component_of(self, name, frame)
                for frame in VECTOR_FRAMES
            }
        return pd.DataFrame(columns)

    def _description(self) -> tuple[str, list[tuple[str, str]]]:
        rows = []
        for joint in ("hip", "knee", "ankle"):
            peaks = [float(power_of(self, f"{joint}_{side}").max(initial=0.0)) for side in "rl"]
            rows.append(
                (
                    f"{joint} power",
                    f"largest {peaks[0]:.0f} W right, {peaks[1]:.0f} W left, over all frames",
                )
            )
        frames = ", ".join(frame.key for frame in VECTOR_FRAMES)
        rows.append(("moment vectors", f"{len(COMPONENTS)} components, in the axes: {frames}"))
        return f"Joint kinetics: {len(POWERS)} powers, {len(self.time)} frames", rows


def power_of(kinetics: JointKinetics | KineticErrors, name: str) -> Array:
    """Return the power of a joint or coordinate, or its standard error.

    Parameters
    ----------
    kinetics
        Powers, or their standard errors.
    name
        Joint (`hip_r`, `ankle_l`, `lumbar`) or coordinate (`hip_flexion_r`).

    Returns
    -------
    (nf,) array
        W.

    Raises
    ------
    ValueError
        There is none of that name.
    """
    return kinetics.power[:, _find_index(name, POWERS)]


def component_of(kinetics: JointKinetics | KineticErrors, name: str, frame: MomentFrame) -> Array:
    """Return a component of a joint moment, or its standard error.

    Parameters
    ----------
    kinetics
        Moments, or their standard errors.
    name
        Component, for example `knee_adduction_r`.
    frame
        One of `VECTOR_FRAMES`.

    Returns
    -------
    (nf,) array
        N·m.

    Raises
    ------
    ValueError
        There is no component of that name, or the frame is that of the coordinates (`Moments.tau`
        has those).
    """
    if frame not in VECTOR_FRAMES:
        raise ValueError(
            f"'{frame.key}' has no vectors; the torques of the coordinates are in Moments.tau"
        )
    return kinetics.moment[:, VECTOR_FRAMES.index(frame), _find_index(name, COMPONENTS)]


def name_vector_column(name: str, frame: MomentFrame) -> str:
    """Name the column of a moment component in a frame: `knee_adduction_r_proximal`."""
    return f"{name}_{frame.key}"


def _find_index(name: str, names: tuple[str, ...]) -> int:
    """Find the index of a name; ValueError with the names that exist."""
    if name not in names:
        raise ValueError(f"found '{name}'; allowed: {', '.join(names)}{suggest_name(name, names)}")
    return names.index(name)


def compute_kinetics(parameters: Parameters, motion: Motion, wrenches: Array) -> JointKinetics:
    """Compute powers and moments of a whole-body motion.

    Parameters
    ----------
    parameters
        Joint and inertial parameters.
    motion
        Motion with all coordinates.
    wrenches
        (nf, 2, 6) ground on the feet, N and N·m about the laboratory origin.

    Returns
    -------
    JointKinetics
    """
    state = motion.q, motion.velocity, motion.acceleration
    power, moment = compute_kinetic_values(parameters, *state, wrenches)
    return JointKinetics(time=motion.time, power=power, moment=moment)


def compute_kinetic_values(
    parameters: Parameters, q: Array, v: Array, a: Array, wrenches: Array
) -> tuple[Array, Array]:
    """Compute powers and moments.

    `q`, `v`, `a`: (nf, 27) coordinates and their derivatives, m and rad. `wrenches`: (nf, 2, 6)
    ground on the feet, N and N·m about the laboratory origin. Returns: (nf, 28) W, in the order of
    `POWERS`; (nf, 3, 21) N·m, by `VECTOR_FRAMES` and `COMPONENTS`.
    """
    dynamics = Dynamics(parameters, HELD)
    forces = dynamics.compute_forces(q, v, a, wrenches)
    parts = [
        differentiate_moments(dynamics.place(q[part]), forces[part]).values
        for part in stretches(len(q), BLOCK)
    ]
    return compute_powers(forces[:, : len(COORDINATES)], v), _arrange_by_frame(
        np.concatenate(parts)
    )


@with_one_blas_thread
def joint_kinetics(model: SubjectModel, motion: Motion, forces: Array) -> JointKinetics:
    """Compute powers and moment vectors of the joints of a whole-body motion.

    Parameters
    ----------
    model
        The person's model; its parameters should be those the motion was tracked with.
    motion
        From `gaitcal.track`, all coordinates.
    forces
        (nf, 2, 6) ground on right and left foot: force (N) and moment (N·m) about the laboratory
        origin, as in `gaitcal.ground_reactions(...).wrench`. Powers and moments of a leg are
        meaningful where that leg is valid.

    Returns
    -------
    JointKinetics

    Raises
    ------
    ValueError
        The motion is of a part of the body only, or the shape of `forces` does not fit the motion.
    """
    if motion.coordinates != COORDINATES:
        raise ValueError(
            f"joint kinetics need a motion of the whole body, with all {len(COORDINATES)} "
            "coordinates"
        )
    if forces.shape != (len(motion.time), 2, 6):
        raise ValueError(f"forces have shape {forces.shape}, expected ({len(motion.time)}, 2, 6)")
    return compute_kinetics(model.parameters, motion, forces)


@dataclass(frozen=True)
class MomentJacobian:
    """Moments of all joints and their derivatives.

    Rows run over joint, frame (`VECTOR_FRAMES`), component.
    """

    values: Array  # (nf, 63) N·m
    # (nf, 63, 35) per generalised force (`ALL_FORCES`), posture and joint parameters staying
    by_force: Array
    by_position: Array  # (nf, 63, nq) per coordinate, generalised forces staying
    # (nf, 63, np) per free joint parameter, generalised forces staying; in the order of the chain
    by_parameter: Array
    by_turn: dict[str, Array]
    """Segment -> (nf, 63, 3) per rotation of its axes in the laboratory (rad), bodies and joints
    staying.
    """


def differentiate_moments(
    placed: Kinematics, forces: Array, free: tuple[str, ...] = ()
) -> MomentJacobian:
    """Differentiate the moments of all joints.

    `placed`: linkage in nf frames, with the joint parameters `HELD` and `free` free. `forces`: (nf,
    35) generalised forces, in the order of `ALL_FORCES`. `free`: joint parameters to differentiate
    by.
    """
    nf, width = len(forces), 3 * len(VECTOR_FRAMES)
    rows = width * len(NET_JOINTS)
    # Position along the linkage: joints are numbered from the base segment outwards.
    rank = placed.chain.at_variables
    by = (*COORDINATES, *(n for n in placed.chain.free if n in free))
    wanted = np.array([placed.chain.variables.index(n) for n in by])
    values, by_force = np.empty((nf, rows)), np.zeros((nf, rows, len(ALL_FORCES)))
    by_variable = np.zeros((nf, rows, len(wanted)))
    by_turn = {
        segment: np.zeros((nf, rows, 3))
        for joint in NET_JOINTS
        for segment in (joint.proximal, joint.distal)
    }
    for j, joint in enumerate(NET_JOINTS):
        # Moment of the joint from three generalised forces; axes: (nf, 3, 3), an axis in each row.
        axes = np.stack([placed.axis(name) for name in joint.turns], axis=1)
        columns = [ALL_FORCES.index(name) for name in joint.turns]
        moment = np.asarray(
            np.linalg.solve(axes, forces[:, columns, None])[:, :, 0], dtype=np.float64
        )
        e, g, h = _compute_components(
            placed.frame(joint.proximal), placed.frame(joint.distal), moment
        )
        # Components in the sense of the coordinates, on both sides.
        signs = np.tile(joint.signs, len(VECTOR_FRAMES))[:, None]
        e, g, h = (signs * x for x in (e, g, h))
        at = slice(width * j, width * (j + 1))
        values[:, at] = (e @ moment[:, :, None])[:, :, 0]
        # Derivatives by generalised forces: c_i in each row.
        share = np.linalg.solve(axes.transpose(0, 2, 1), e.transpose(0, 2, 1)).transpose(0, 2, 1)
        by_force[:, at, columns] = share
        by_turn[joint.proximal][:, at] += g
        by_turn[joint.distal][:, at] += h
        # Variables that move the distal segment include those that move the proximal one.
        above = np.flatnonzero(placed.moves(joint.distal)[wanted])
        cols = wanted[above]
        # Angular velocities by these variables, (nf, 3, variables).
        turning = placed.columns_by_frame[:, cols, 3:].transpose(0, 2, 1)
        found = (g @ turning) * placed.moves(joint.proximal)[cols] + h @ turning
        # Axes of the joint that come after a variable rotate with it.
        for k, name in enumerate(joint.turns):
            lever = share[:, :, k, None] * cross(axes[:, k], moment)[:, None]
            found -= (lever @ turning) * (rank[cols] < rank[placed.chain.variables.index(name)])
        by_variable[:, at][:, :, above] = found
    split = len(COORDINATES)
    return MomentJacobian(
        values, by_force, by_variable[:, :, :split], by_variable[:, :, split:], by_turn
    )


def _compute_components(
    proximal: Array, distal: Array, moment: Array
) -> tuple[Array, Array, Array]:
    """Compute e_i of the three frames, g_i and h_i, (nf, 9, 3) each.

    `proximal`, `distal`: (nf, 3, 3) segment axes, one in each row. `moment`: (nf, 3) M, N·m.
    """
    order = [2, 0, 1]
    e, still = [proximal[:, order], distal[:, order]], np.zeros_like(proximal)
    across = moment[:, None]
    first, third = proximal[:, 2], distal[:, 1]
    normal = cross(third, first)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    floating = normal / length
    e.append(np.stack([first, floating, third], axis=1))
    b = (moment - (moment * floating).sum(axis=1, keepdims=True) * floating) / length
    nothing = np.zeros_like(moment)
    g = [cross(e[0], across), still]
    g.append(np.stack([cross(first, moment), cross(first, cross(b, third)), nothing], axis=1))
    h = [still, cross(e[1], across)]
    h.append(np.stack([nothing, cross(third, cross(first, b)), cross(third, moment)], axis=1))
    return np.concatenate(e, axis=1), np.concatenate(g, axis=1), np.concatenate(h, axis=1)


@dataclass(frozen=True)
class KineticJacobian:
    """Derivatives of the 29 generalised forces, the 28 powers and the 63 moment components.

    Rows run over these quantities.
    """

    by_force: Array  # (nf, 120, 35) L, per generalised force (`ALL_FORCES`)
    by_position: Array  # (nf, 120, nq), generalised forces staying; so are the following
    by_velocity: Array  # (nf, 120, nq)
    by_parameter: Array  # (nf, 120, np) per free joint parameter
    # Segment -> (nf, 63, 3), of the moments per rotation of that segment's axes
    by_turn: dict[str, Array]

    def propagate_axis_errors(
        self, forces: Array, velocity: Array, rotations: dict[str, Array]
    ) -> Array:
        """Propagate errors of the directions of segment axes.

        Bodies and joints keep their positions.

        Parameters
        ----------
        forces
            (nf, nt, k) changes of the generalised forces, in k columns.
        velocity
            (nf, nq, k) changes of the rates.
        rotations
            Segment -> (nf, k, 3) rad, rotations of its axes in the laboratory.

        Returns
        -------
        (nf, 120, k) array
        """
        count = len(FORCES) + len(POWERS)
        out = np.zeros((forces.shape[0], self.by_force.shape[1], forces.shape[2]))
        # The moments are fixed in the laboratory: `forces` change torques and powers only.
        out[:, :count] = (
            self.by_force[:, :count, : len(FORCES)] @ forces
            + self.by_velocity[:, :count] @ velocity
        )
        for segment, rotation in rotations.items():
            if segment in self.by_turn:
                out[:, count:] += self.by_turn[segment] @ rotation.transpose(0, 2, 1)
        return out


def differentiate_kinetics(
    placed: Kinematics, v: Array, forces: Array, free: tuple[str, ...] = ()
) -> KineticJacobian:
    """Differentiate generalised forces, powers and moments.

    Parameters
    ----------
    placed
        Linkage in nf frames, with the joint parameters `HELD` and `free` free.
    v
        (nf, nq) rates of the coordinates.
    forces
        (nf, 35) generalised forces, in the order of `ALL_FORCES`.
    free
        Joint parameters to differentiate by.

    Returns
    -------
    KineticJacobian
    """
    moments = differentiate_moments(placed, forces, free)
    nf, torques, coordinates = len(v), len(FORCES), len(COORDINATES)
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
    return KineticJacobian(by_force, by_position, by_velocity, by_parameter, moments.by_turn)


def build_kinetic_errors(variance: Array, from_markers: Array | None = None) -> KineticErrors:
    """Build standard errors from variances.

    Parameters
    ----------
    variance
        (nf, 91) W^2 and (N·m)^2, of powers and moment components.
    from_markers
        (nf, 91) part caused by the noise of this trial's markers.

    Returns
    -------
    KineticErrors
    """
    errors = np.sqrt(variance)
    part = None if from_markers is None else build_kinetic_errors(from_markers)
    return KineticErrors(
        errors[:, : len(POWERS)], _arrange_by_frame(errors[:, len(POWERS) :]), part
    )


def _arrange_by_frame(values: Array) -> Array:
    """Arrange rows (nf, 63) over joint, frame, component as (nf, 3, 21)."""
    joints = values.reshape(len(values), -1, len(VECTOR_FRAMES), 3)
    return joints.transpose(0, 2, 1, 3).reshape(len(values), len(VECTOR_FRAMES), -1)
