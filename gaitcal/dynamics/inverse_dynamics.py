"""Inverse dynamics: the generalised forces that the motion and the ground reactions ask for.

    tau = RNEA(q, v, a) - sum_feet J_foot^T w_foot

with w_foot the wrench of the ground on the foot and J_foot the spatial Jacobian, both about the laboratory origin, so
that the wrench needs no transformation to the foot. The six root rows are the pelvis residual: what no ground
reaction explains. Two locked joints report the knees' internal reaction moment about the knee frame's x axis.

The derivative by a coordinate or joint parameter j keeps the wrench fixed in the laboratory: for i after j the column
J_i turns and moves with j, d J_i / d j = J_j x J_i (the spatial cross product), and not otherwise.

Inverse dynamics of a tracked motion, for scripts: `gaitcal.inverse_dynamics(model, motion, forces)`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from gaitcal.errors import InputError
from gaitcal.model.build import LinkageModel, build_linkage
from gaitcal.model.chain import Chain
from gaitcal.model.inertial_parameters import MASSIVE_SEGMENTS, placed_dynamic_parameters
from gaitcal.model.kinematics import forward, jacobian
from gaitcal.model.linkage import COORDINATES, REACTIONS, is_translation
from gaitcal.model.parameters import Parameters
from gaitcal.model.subject_model import SubjectModel
from gaitcal.motion.motion import Motion

Array = NDArray[np.float64]

FEET: tuple[str, ...] = ("foot_r", "foot_l")
"""Order of the second axis of every array of foot wrenches."""


@dataclass(frozen=True)
class GeneralisedForces:
    """Generalised forces of one trial: internal, net of all structures crossing the joint, acting on the child."""

    tau: Array
    """(nf, 27) N·m (N for the three pelvis translations) in the order of `COORDINATES`."""
    knee_adduction: Array
    """(nf, 2) N·m, right and left: internal reaction moment of the thigh on the shank, adduction positive."""
    residual_force: Array
    """(nf, 3) N, laboratory axes."""
    residual_moment: Array
    """(nf, 3) N·m about the pelvis origin, laboratory axes."""


@dataclass(frozen=True)
class TorqueErrors:
    """Standard errors of the final generalised forces, from markers through joint parameters and motion, and IPs."""

    tau: Array
    """(nf, 27) N·m, N."""
    knee_adduction: Array
    """(nf, 2) N·m."""


def residual_rms(forces: GeneralisedForces, valid: NDArray[np.bool_]) -> tuple[float, float]:
    """RMS pelvis residual over valid frames and three components: force (N), torque about the pelvis (N·m)."""
    force = np.sqrt(np.mean(forces.residual_force[valid] ** 2))
    return float(force), float(np.sqrt(np.mean(forces.residual_moment[valid] ** 2)))


class Dynamics:
    """The linkage of one set of parameters, ready for inverse dynamics of any number of frames."""

    def __init__(self, parameters: Parameters) -> None:
        self.parameters = parameters
        self.linkage: LinkageModel = build_linkage(parameters, reactions=True)
        self.chain = Chain(reactions=True)
        self._constants = self.chain.constants(parameters.joint, parameters.zero_angles)
        self._data = self.linkage.model.createData()
        self._place = np.array([self.chain.coordinates.index(name) for name in COORDINATES])
        self._reaction = np.array([self.chain.coordinates.index(name) for name in REACTIONS])
        self._feet = [self.chain.segments.index(foot) for foot in FEET]

    def expand(self, values: Array) -> Array:
        """(nf, 29) with zeros for the locked reaction joints, from (nf, 27)."""
        out = np.zeros((len(values), len(self.chain.coordinates)))
        out[:, self._place] = values
        return out

    def forces(self, q: Array, v: Array, a: Array, wrenches: Array) -> GeneralisedForces:
        """Generalised forces for coordinates (nf, 27), their derivatives, and foot wrenches (nf, 2, 6).

        Wrenches are [force N; moment N·m about the laboratory origin] of the ground on the right and left foot.
        """
        q_all, v_all, a_all = self.expand(q), self.expand(v), self.expand(a)
        model, data, rnea = self.linkage.model, self._data, pin.rnea
        tau = np.empty_like(q_all)
        for f in range(len(q_all)):
            tau[f] = rnea(model, data, q_all[f], v_all[f], a_all[f])
        columns = jacobian(self.chain, self._constants, forward(self.chain, self._constants, q_all))
        for foot, segment in enumerate(self._feet):
            moved = np.flatnonzero(self.chain.support[:, segment])
            tau[:, moved] -= np.einsum("kif,fi->fk", columns[moved], wrenches[:, foot])
        axes, _, _ = pelvis_axes(q)
        moment = np.asarray(np.linalg.solve(axes, tau[:, 3:6, None])[:, :, 0], dtype=np.float64)
        return GeneralisedForces(tau[:, self._place], tau[:, self._reaction], tau[:, :3].copy(), moment)

    def root_regressor(self, q: Array, v: Array, a: Array) -> Array:
        """(nf, 6, 12, 10): force and moment about the pelvis origin per dynamic parameter of each massive segment.

        Contracted with `dynamic_parameters` it gives the root wrench without ground reactions, laboratory axes.
        """
        return root_regressor(self.linkage, self.expand(q), self.expand(v), self.expand(a))


def root_regressor(linkage: LinkageModel, q: Array, v: Array, a: Array) -> Array:
    """See `Dynamics.root_regressor`; q, v, a for all joints of `linkage`."""
    model, data = linkage.model, linkage.model.createData()
    at = [linkage.segment_joint[s] for s in MASSIVE_SEGMENTS]
    columns = np.concatenate([np.arange(10 * (j - 1), 10 * j) for j in at])
    rows = np.empty((len(q), 6, len(columns)))
    for f in range(len(q)):
        rows[f] = pin.computeJointTorqueRegressor(model, data, q[f], v[f], a[f])[:6, columns]
    axes, _, _ = pelvis_axes(q)
    rows[:, 3:] = np.linalg.solve(axes, rows[:, 3:])
    out = rows.reshape(len(q), 6, len(at), 10)
    for k, segment in enumerate(MASSIVE_SEGMENTS):
        place = linkage.segment_placement[segment]
        out[:, :, k] = out[:, :, k] @ placed_dynamic_parameters(place.rotation, place.translation)
    return out


def pelvis_axes(q: Array) -> tuple[Array, Array, Array]:
    """(nf, 3, 3) laboratory axes of tilt, list and rotation as rows; and their derivatives by tilt and by list."""
    ct, st, cl, sl = np.cos(q[:, 3]), np.sin(q[:, 3]), np.cos(q[:, 4]), np.sin(q[:, 4])
    zero, one = np.zeros(len(q)), np.ones(len(q))

    def rows(first: tuple[Array, ...], second: tuple[Array, ...], third: tuple[Array, ...]) -> Array:
        return np.stack([np.stack(row, axis=1) for row in (first, second, third)], axis=1)

    nothing = (zero, zero, zero)
    axes = rows((zero, zero, one), (ct, st, zero), (-st * cl, ct * cl, sl))
    by_tilt = rows(nothing, (-st, ct, zero), (-ct * cl, -st * cl, zero))
    by_list = rows(nothing, nothing, (st * sl, -ct * sl, cl))
    return axes, by_tilt, by_list


@dataclass(frozen=True)
class Moments:
    """Generalised forces of one trial: internal, net, positive along the coordinate of that name."""

    coordinates: tuple[str, ...]
    """The 27 names of the columns of `tau`."""
    time: Array
    """(nf,) s."""
    tau: Array
    """(nf, 27) N\u00b7m; N for the three pelvis translations."""
    knee_adduction: Array
    """(nf, 2) N\u00b7m, right and left: internal reaction moment about the knee frame's x axis, adduction positive."""
    residual_force: Array
    """(nf, 3) N, laboratory axes: what the ground reactions do not explain."""
    residual_moment: Array
    """(nf, 3) N\u00b7m about the pelvis origin, laboratory axes."""
    bwh: float
    """Body weight times height, N\u00b7m."""

    def percent_bwh(self, coordinate: str) -> Array:
        """(nf,) torque of a coordinate in percent of body weight times height.

        Raises
        ------
        ValueError
            The coordinate is a translation of the pelvis (a force), or none of the 27.
        """
        if is_translation(coordinate):
            raise ValueError(f"'{coordinate}' is a force, not a torque")
        return 100.0 * self.tau[:, self.coordinates.index(coordinate)] / self.bwh


def inverse_dynamics(model: SubjectModel, motion: Motion, forces: Array) -> Moments:
    """Joint torques of a whole-body motion.

    Parameters
    ----------
    model : the person's model; its parameters should be those the motion was tracked with.
    motion : from `gaitcal.track`, all 27 coordinates.
    forces : (nf, 2, 6) ground on right and left foot at the frames of the motion: force (N) and moment (N\u00b7m) about
        the laboratory origin, laboratory axes; zeros where a foot is in the air: the `wrench` that
        `gaitcal.ground_reactions` makes of a recording's plates.

    Raises
    ------
    InputError
        The forces are no array: force plates must be given to the feet first.
    ValueError
        The motion is of a part of the body only, or there is not one row of forces for every frame.
    """
    if motion.coordinates != COORDINATES:
        raise ValueError("inverse dynamics needs a motion of the whole body, with all 27 coordinates")
    if not isinstance(forces, np.ndarray):
        raise InputError(
            f"found {type(forces).__name__}; allowed: an array (frames, 2, 6) of the forces on right and left foot, as "
            "gaitcal.ground_reactions(model, motion, recording).wrench gives it for force plates",
            field="forces",
        )
    if forces.shape != (len(motion.time), 2, 6):
        raise ValueError(f"forces have shape {forces.shape}, expected ({len(motion.time)}, 2, 6)")
    found = Dynamics(model.parameters).forces(motion.q, motion.velocity, motion.acceleration, forces)
    return Moments(
        COORDINATES,
        motion.time,
        found.tau,
        found.knee_adduction,
        found.residual_force,
        found.residual_moment,
        model.subject.bwh,
    )
