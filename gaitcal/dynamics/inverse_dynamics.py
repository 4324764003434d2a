"""Inverse dynamics by Pinocchio: generalised forces from motion and ground reactions.

    tau = M(q) a + h(q, v) + g(q) - sum_feet J_foot^T w_foot

is the recursive Newton-Euler algorithm, `pin.rnea`, with the wrenches of the ground on the feet as
external forces. Two locked joints report the internal reaction moment of the knees about the x axis
of the knee frame. The six root rows are the pelvis residual, which ground reactions do not explain:

    F = tau_(tx, ty, tz),   A(q) T = tau_(tilt, list, rotation).

The rows of A are the axes of the pelvis rotations in the laboratory, so that T is the moment about
the pelvis origin in laboratory axes. Without ground reactions tau is linear in the dynamic
parameters of the segments (m, m c, I about the segment origin). Their matrix is the regressor
(`pin.computeJointTorqueRegressor`). Pinocchio gives its columns for bodies in the frames of their
joints; those of segments follow by a constant matrix (`_build_parameter_transform`).
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from gaitcal.arrays import Array, BoolArray, IntArray, cross, stretches
from gaitcal.display import Displayed, describe_time
from gaitcal.errors import Code, InputError
from gaitcal.model import linkage
from gaitcal.model.chain import build_linkage
from gaitcal.model.kinematics import Kinematics
from gaitcal.model.parameters import MASSIVE_SEGMENTS, Parameters
from gaitcal.model.subject_model import SubjectModel
from gaitcal.runtime import with_one_blas_thread
from gaitcal.tracking.motion import Motion

if TYPE_CHECKING:
    import pandas as pd

FEET: tuple[str, ...] = ("foot_r", "foot_l")
"""Order of the second axis of every array of foot wrenches."""
FORCES: tuple[str, ...] = (*linkage.COORDINATES, *linkage.REACTIONS)
"""Order of the 29 generalised forces of a frame: the 27 coordinates, then the two knee reactions.
"""
BLOCK = 500
"""Frames in one block, to bound memory: trials on treadmills last for minutes."""


@dataclass(frozen=True, kw_only=True, repr=False)
class Moments(Displayed):
    """Generalised forces of one trial: internal and net, acting on the distal segment.

    They are net of all structures that cross the joint, and positive along the coordinate of that
    name.
    """

    coordinates: tuple[str, ...]
    """The 27 names of the columns of `tau`."""
    time: Array
    """(nf,) s."""
    tau: Array
    """(nf, nq) N·m; N for the three pelvis translations."""
    knee_adduction: Array
    """(nf, 2) N·m, right and left: internal reaction moment of the thigh on the shank about the
    knee frame's x axis, adduction positive."""
    residual_force: Array
    """(nf, 3) N, laboratory axes: the part that ground reactions do not explain."""
    residual_moment: Array
    """(nf, 3) N·m about the pelvis origin, laboratory axes."""
    bwh: float
    """Body weight times height, N·m."""

    def to_dataframe(self) -> "pd.DataFrame":
        """Return the moments as a table.

        Returns
        -------
        pandas.DataFrame
            With the columns of `moments/TRIAL.csv` that moments determine: `time` (s), then for
            every generalised force NAME (N·m; N of the pelvis translations) and `NAME_bwh` (percent
            of body weight times height; NaN of translations).
        """
        import pandas as pd

        values = dict(zip(FORCES, np.hstack([self.tau, self.knee_adduction]).T, strict=True))
        columns = {"time": self.time}
        for name in (*linkage.FILE_COORDINATES, *linkage.REACTIONS):
            columns[name] = values[name]
            share = np.nan if linkage.is_translation(name) else 100.0 / self.bwh
            columns[f"{name}_bwh"] = share * values[name]
        return pd.DataFrame(columns)

    def _description(self) -> tuple[str, list[tuple[str, str]]]:
        time, peaks = self.time, []
        for name in ("hip_flexion", "knee_angle", "ankle_angle"):
            both = [
                np.abs(self.tau[:, linkage.COORDINATES.index(f"{name}_{side}")]).max(initial=0.0)
                for side in "rl"
            ]
            peaks.append(
                (name, f"largest {both[0]:.1f} N·m right, {both[1]:.1f} N·m left, over all frames")
            )
        force, moment = (
            self.residual_rms(np.ones(len(time), dtype=bool)) if len(time) else (0.0, 0.0)
        )
        rate = float(1.0 / np.median(np.diff(time))) if len(time) > 1 else float("nan")
        rows = [
            ("time", describe_time(len(time), rate, float(np.ptp(time)) if len(time) else 0.0)),
            *peaks,
            ("pelvis residual", f"RMS {force:.1f} N, {moment:.1f} N·m over all frames"),
        ]
        return (
            f"Moments: {len(self.coordinates)} generalised forces and the knee adduction moments",
            rows,
        )

    def residual_rms(self, valid: BoolArray) -> tuple[float, float]:
        """Compute the RMS pelvis residual over valid frames and three components.

        Parameters
        ----------
        valid
            (nf,) frames to include.

        Returns
        -------
        tuple of float
            Force (N), and moment about the pelvis origin (N·m).
        """
        force, moment = (
            np.sqrt(np.mean(r[valid] ** 2)) for r in (self.residual_force, self.residual_moment)
        )
        return float(force), float(moment)


class Dynamics:
    """Linkage of one set of parameters, prepared for inverse dynamics of any number of frames.

    Parameters
    ----------
    parameters
        Joint and inertial parameters, SI units.
    held
        Joint parameters that report their generalised forces too, as locked joints; after the 29,
        in their order.
    free
        Joint parameters that `derivatives.py` differentiates by.
    segments
        Part of the body whose forces are needed, pelvis and both legs included; all unless given.
    bodies
        Segment -> inertia in its frame, instead of those of `parameters`.
    """

    def __init__(
        self,
        parameters: Parameters,
        held: tuple[str, ...] = (),
        free: tuple[str, ...] = (),
        *,
        segments: tuple[str, ...] = linkage.SEGMENTS,
        bodies: dict[str, pin.Inertia] | None = None,
    ) -> None:
        opened = (*free, *(name for name in held if name not in free))
        self.body = build_linkage(parameters, opened, segments=segments, reactions=True)
        if bodies is not None:
            self.body.set_inertias(bodies)
        chain = self.body.chain
        self.free = tuple(name for name in chain.free if name in free)
        self.forces_of = tuple(name for name in (*FORCES, *held) if name in chain.joints)
        """Names of the nt generalised forces."""
        self.rows = np.array([chain.joints.index(name) for name in self.forces_of], dtype=np.intp)
        """(nt,) entries of their joints."""
        self._columns = [linkage.COORDINATE_INDEX[name] for name in chain.coordinates]
        self.feet = [int(chain.segment_joint[chain.segments.index(foot)]) for foot in FEET]
        """Joints that carry the feet."""

    def place(self, q: Array) -> Kinematics:
        """Place the linkage at coordinates (nf, 27), with the Jacobian of all its variables."""
        return Kinematics(self.body, q[:, self._columns])

    def build_joint_states(self, q: Array, v: Array, a: Array) -> tuple[Array, Array, Array]:
        """Build configurations, velocities and accelerations of all joints.

        `q`, `v`, `a`: (nf, 27) coordinates and their derivatives, m and rad. Returns:
        configurations (nf, nq), velocities and accelerations (nf, nv) of the Pinocchio model.
        """
        at = self.body.chain.at_coordinates
        velocity, acceleration = (np.zeros((len(q), self.body.model.nv)) for _ in range(2))
        velocity[:, at], acceleration[:, at] = v[:, self._columns], a[:, self._columns]
        return self.body.fill_configurations(q[:, self._columns]), velocity, acceleration

    def compute_forces(self, q: Array, v: Array, a: Array, wrenches: Array | None = None) -> Array:
        """Compute generalised forces.

        Parameters
        ----------
        q, v, a
            (nf, 27) coordinates and their derivatives, m and rad.
        wrenches
            (nf, 2, 6) ground on the right and left foot: force (N) and moment (N·m) about the
            laboratory origin; none unless given.

        Returns
        -------
        (nf, nt) array
            N·m, N, in the order of `forces_of`.
        """
        parts = []
        for part in stretches(len(q), BLOCK) or [slice(0)]:
            states = self.build_joint_states(q[part], v[part], a[part])
            on_feet = (
                None if wrenches is None else self._express_in_joint_axes(q[part], wrenches[part])
            )
            parts.append(self._run_rnea(*states, on_feet))
        return np.concatenate(parts)[:, self.rows]

    def _run_rnea(self, q: Array, v: Array, a: Array, on_feet: Array | None) -> Array:
        """Run the Newton-Euler algorithm: (nf, nv) generalised forces of all joints.

        `on_feet`: (nf, 2, 6) in the axes of the joints of the feet, about their origins.
        """
        model = self.body.model
        external = pin.StdVec_Force([pin.Force.Zero() for _ in range(model.njoints)])
        feet, out = [external[joint] for joint in self.feet], np.empty_like(q)
        with self.body.chain.lend_work_space() as data:
            for k in range(len(q)):
                if on_feet is not None:
                    for foot, force in zip(feet, on_feet[k], strict=True):
                        foot.vector = force
                out[k] = pin.rnea(model, data, q[k], v[k], a[k], external)
        return out

    def _express_in_joint_axes(self, q: Array, wrenches: Array) -> Array:
        """Express foot wrenches (nf, 2, 6) in the axes and about the origins of the joints."""
        placed, out = (
            Kinematics(self.body, q[:, self._columns], columns=False),
            np.empty_like(wrenches),
        )
        for foot, name in enumerate(FEET):
            segment = self.body.chain.segments.index(name)
            *axes, origin = placed.segments_by_frame[:, segment].transpose(1, 0, 2)
            force, moment = wrenches[:, foot, :3], wrenches[:, foot, 3:]
            about = moment - cross(origin, force)
            local = [np.sum(vector * axis, axis=1) for vector in (force, about) for axis in axes]
            out[:, foot] = (
                np.stack(local, axis=1)
                @ self.body.segment_placement[segment].toDualActionMatrix().T
            )
        return out

    def compute_residual_force(self, q: Array, v: Array, a: Array, wrenches: Array) -> Array:
        """Compute the residual force; points of application of the ground's are not needed.

        Parameters
        ----------
        q, v, a
            (nf, 27) coordinates and their derivatives, m and rad.
        wrenches
            (nf, 2, 6) ground on the feet.

        Returns
        -------
        (nf, 3) array
            N, laboratory axes.
        """
        return self.compute_forces(q, v, a)[:, :3] - wrenches[:, :, :3].sum(axis=1)

    def compute_ground_forces(self, placed: Kinematics, wrenches: Array) -> Array:
        """Compute the part -J_foot^T w of the generalised forces.

        Parameters
        ----------
        placed
            Linkage in nf frames.
        wrenches
            (nf, 2, 6, k) foot wrenches, or errors of them.

        Returns
        -------
        (nf, nt, k) array
        """
        columns, variables = placed.columns_by_frame, placed.chain.variables
        out = np.zeros((len(wrenches), len(variables), wrenches.shape[3]))
        for foot, name in enumerate(FEET):
            moved = np.flatnonzero(placed.moves(name))
            out[:, moved] -= columns[:, moved] @ wrenches[:, foot]
        return out[:, [variables.index(name) for name in self.forces_of]]

    @cached_property
    def _to_joints(self) -> tuple[IntArray, Array]:
        """Joints (nb,) of the massive segments, and (nb, 10, 10) parameter transforms."""
        chain = self.body.chain
        if not set(MASSIVE_SEGMENTS) <= set(chain.segments):
            raise ValueError(
                "regressors are of the whole body: a part of it has no place for the other segments"
            )
        at = [chain.segments.index(s) for s in MASSIVE_SEGMENTS]
        moves = np.array([_build_parameter_transform(self.body.segment_placement[k]) for k in at])
        return self.body.chain.segment_joint[at] - 1, moves

    def compute_regressor(self, q: Array, v: Array, a: Array) -> Array:
        """Compute the generalised forces per dynamic parameter, without ground reactions.

        Parameters
        ----------
        q, v, a
            (nf, 27) coordinates and their derivatives, m and rad.

        Returns
        -------
        (nf, nt, 12, 10) array
            By massive segment and its ten parameters.
        """
        model = self.body.model
        joints, moves = self._to_joints
        states = self.build_joint_states(q, v, a)
        out = np.empty((len(q), len(self.rows), len(joints), 10))
        pick = np.ix_(self.rows, joints)
        with self.body.chain.lend_work_space() as data:
            for k, (q_k, v_k, a_k) in enumerate(zip(*states, strict=True)):
                found = pin.computeJointTorqueRegressor(model, data, q_k, v_k, a_k)
                out[k] = found.reshape(model.nv, model.nv, 10)[pick]
        for body, move in enumerate(moves):
            out[:, :, body] = out[:, :, body] @ move
        return out

    def compute_root_regressor(self, q: Array, v: Array, a: Array) -> Array:
        """Compute force and moment about the pelvis origin per dynamic parameter.

        Contracted with `dynamic_parameters` it is the root wrench without ground reactions.

        Parameters
        ----------
        q, v, a
            (nf, 27) coordinates and their derivatives, m and rad.

        Returns
        -------
        (nf, 6, 12, 10) array
            Laboratory axes; by massive segment and its ten parameters.
        """
        parts = stretches(len(q), BLOCK) or [slice(0)]
        rows = np.concatenate(
            [self.compute_regressor(q[part], v[part], a[part])[:, :6] for part in parts]
        )
        return compute_root_wrench(q, rows.reshape(len(q), 6, math.prod(rows.shape[2:]))).reshape(
            rows.shape
        )


def _build_parameter_transform(placement: pin.SE3) -> Array:
    """Build the matrix (10, 10) that transforms dynamic parameters of a body to another frame.

    Parameters
    ----------
    placement
        Pose of the body's frame in the other frame.

    Notes
    -----
    Pinocchio transforms ten bodies with independent parameters; their parameters give the matrix.
    """
    unit = np.eye(3)
    bodies = [pin.Inertia(1.0, np.zeros(3), unit)]
    bodies += [pin.Inertia(1.0, axis, unit) for axis in unit]
    for i in range(3):
        for j in range(i + 1):
            both = 0.25 * (np.outer(unit[i], unit[j]) + np.outer(unit[j], unit[i]))
            bodies.append(pin.Inertia(1.0, np.zeros(3), unit + both))
    before = np.array([body.toDynamicParameters() for body in bodies])
    after = np.array([placement.act(body).toDynamicParameters() for body in bodies])
    return np.asarray(np.linalg.solve(before, after).T)


def compute_root_wrench(q: Array, rows: Array) -> Array:
    """Compute [F; T] of the pelvis from the six root rows.

    Parameters
    ----------
    q
        (nf, 27) coordinates, m and rad.
    rows
        (nf, 6, k) generalised forces of the pelvis.

    Returns
    -------
    (nf, 6, k) array
        Laboratory axes, T about the pelvis origin.
    """
    axes, _, _ = compute_pelvis_axes(q)
    return np.concatenate([rows[:, :3], np.linalg.solve(axes, rows[:, 3:])], axis=1)


def compute_pelvis_residual(q: Array, forces: Array) -> Array:
    """Compute the pelvis residual (nf, 6) [F; T] from generalised forces (nf, nt)."""
    return compute_root_wrench(q, forces[:, :6, None])[:, :, 0]


def compute_pelvis_axes(q: Array) -> tuple[Array, Array, Array]:
    """Compute the axes of tilt, list and rotation, and their derivatives by tilt and by list.

    Returns: (nf, 3, 3) laboratory axes, an axis in each row, and (nf, 3, 3) their two derivatives.
    """
    ct, st, cl, sl = np.cos(q[:, 3]), np.sin(q[:, 3]), np.cos(q[:, 4]), np.sin(q[:, 4])
    zero, one = np.zeros(len(q)), np.ones(len(q))

    def rows(*axes: tuple[Array, Array, Array]) -> Array:
        return np.stack([np.stack(axis, axis=1) for axis in axes], axis=1)

    nothing = (zero, zero, zero)
    axes = rows((zero, zero, one), (ct, st, zero), (-st * cl, ct * cl, sl))
    by_tilt = rows(nothing, (-st, ct, zero), (-ct * cl, -st * cl, zero))
    by_list = rows(nothing, nothing, (st * sl, -ct * sl, cl))
    return axes, by_tilt, by_list


def compute_moments(parameters: Parameters, motion: Motion, wrenches: Array, bwh: float) -> Moments:
    """Compute the generalised forces of a whole-body motion.

    Parameters
    ----------
    parameters
        Parameters of the model.
    motion
        Motion with all coordinates.
    wrenches
        (nf, 2, 6) ground on the feet, N and N·m about the laboratory origin.
    bwh
        N·m, body weight times height.

    Returns
    -------
    Moments
    """
    forces = Dynamics(parameters).compute_forces(
        motion.q, motion.velocity, motion.acceleration, wrenches
    )
    residual = compute_pelvis_residual(motion.q, forces)
    return Moments(
        coordinates=linkage.COORDINATES,
        time=motion.time,
        tau=forces[:, : len(linkage.COORDINATES)],
        knee_adduction=forces[:, len(linkage.COORDINATES) :],
        residual_force=residual[:, :3],
        residual_moment=residual[:, 3:],
        bwh=bwh,
    )


@with_one_blas_thread
def inverse_dynamics(model: SubjectModel, motion: Motion, forces: Array) -> Moments:
    """Compute the joint torques of a whole-body motion.

    Parameters
    ----------
    model
        The person's model; its parameters should be those the motion was tracked with.
    motion
        From `gaitcal.track`, all coordinates.
    forces
        (nf, 2, 6) ground on right and left foot at the frames of the motion: force (N) and moment
        (N·m) about the laboratory origin, laboratory axes; zeros where a foot is in the air.
        `gaitcal.ground_reactions` computes them as `wrench` from the plates of a recording.

    Returns
    -------
    Moments

    Raises
    ------
    InputError
        `forces` is no array: force plates must be assigned to the feet first.
    ValueError
        The motion is of a part of the body only, or the shape of `forces` does not fit the motion.
    """
    if motion.coordinates != linkage.COORDINATES:
        message = (
            "inverse dynamics needs a motion of the whole body, with all "
            f"{len(linkage.COORDINATES)} coordinates"
        )
        raise ValueError(message)
    if not isinstance(forces, np.ndarray):
        raise InputError(
            f"found {type(forces).__name__}; allowed: an array (frames, 2, 6) of the forces on "
            "right and left foot, as "
            "gaitcal.ground_reactions(model, motion, recording).wrench gives it for force plates",
            field="forces",
            code=Code.ARGUMENT,
        )
    if forces.shape != (len(motion.time), 2, 6):
        raise ValueError(f"forces have shape {forces.shape}, expected ({len(motion.time)}, 2, 6)")
    return compute_moments(model.parameters, motion, forces, model.subject.bwh)
