"""Inverse dynamics: the generalised forces that the motion and the ground reactions ask for.

    tau = RNEA(q, v, a) - sum_feet J_foot^T w_foot

with w_foot the wrench of the ground on the foot and J_foot the spatial Jacobian, both about the laboratory origin, so
that the wrench needs no transformation to the foot. Two locked joints report the knees' internal reaction moment about
the knee frame's x axis. The six root rows are the pelvis residual, what no ground reaction explains:

    F = tau_(tx, ty, tz),   A(q) T = tau_(tilt, list, rotation),

A's rows being the axes of the pelvis rotations in the laboratory, so that T is the moment about the pelvis origin in
laboratory axes. Without ground reactions tau is linear in the dynamic parameters of the segments (m, m c, I about the
segment origin); their matrix is the regressor.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin

from gaitcal.arrays import Array, BoolArray, IntArray
from gaitcal.codes import Code
from gaitcal.errors import InputError
from gaitcal.model.chain import Chain, ChainConstants, chain_of, forward, jacobian, segment_poses
from gaitcal.model.linkage import COORDINATES, JOINTS, REACTIONS, is_translation, joint_elements, root_elements
from gaitcal.model.parameters import JP_INDEX, MASSIVE_SEGMENTS, Parameters, placed_dynamic_parameters
from gaitcal.model.subject_model import LinkageModel, SubjectModel, build_linkage
from gaitcal.motion.motion import Motion
from gaitcal.runtime import with_one_blas_thread

FEET: tuple[str, ...] = ("foot_r", "foot_l")
"""Order of the second axis of every array of foot wrenches."""
FORCES: tuple[str, ...] = (*COORDINATES, *REACTIONS)
"""Order of the 29 generalised forces of a frame: the 27 coordinates, then the two knee reactions."""
ORDER = tuple(
    e.name for part in (root_elements("pelvis"), *(joint_elements(j, reactions=True) for j in JOINTS)) for e in part
)
"""Every turn and slide of the linkage, each after what moves it."""
NOTHING_HELD: Mapping[str, float] = {}
"""No joint parameter as a joint."""


@dataclass(frozen=True, kw_only=True)
class Moments:
    """Generalised forces of one trial: internal, net of all structures crossing the joint, acting on the child.

    Positive along the coordinate of that name.
    """

    coordinates: tuple[str, ...]
    """The 27 names of the columns of `tau`."""
    time: Array
    """(nf,) s."""
    tau: Array
    """(nf, nq) N·m; N for the three pelvis translations."""
    knee_adduction: Array
    """(nf, 2) N·m, right and left: internal reaction moment of the thigh on the shank about the knee frame's x axis,
    adduction positive."""
    residual_force: Array
    """(nf, 3) N, laboratory axes: what the ground reactions do not explain."""
    residual_moment: Array
    """(nf, 3) N·m about the pelvis origin, laboratory axes."""
    bwh: float
    """Body weight times height, N·m."""

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

    def residual_rms(self, valid: BoolArray) -> tuple[float, float]:
        """RMS pelvis residual over valid frames and three components: force (N), torque about the pelvis (N·m)."""
        force, moment = (np.sqrt(np.mean(r[valid] ** 2)) for r in (self.residual_force, self.residual_moment))
        return float(force), float(moment)


class PlacedLinkage:
    """The chain with its locked reactions in some frames, in laboratory axes, the reactions at zero.

    `names`: its variables, coordinates before free joint parameters; `rank`: (n,) of each its place in `ORDER`.
    """

    def __init__(self, chain: Chain, constants: ChainConstants, q: Array) -> None:
        self.chain, self._constants = chain, constants
        self.names = (*chain.coordinates, *chain.free)
        self.rank = np.array([ORDER.index(name) for name in self.names])
        self._poses = forward(chain, constants, self.whole(q))

    def whole(self, values: Array) -> Array:
        """(nf, nc) by the coordinates of the chain, from (nf, nq); zero for the reactions."""
        out = np.zeros((len(values), len(self.chain.coordinates)))
        out[:, [self.chain.coordinates.index(name) for name in COORDINATES]] = values
        return out

    @cached_property
    def columns(self) -> Array:
        """(nf, n, 6) spatial velocity [v; w] about the laboratory origin per unit of each variable."""
        return np.ascontiguousarray(jacobian(self.chain, self._constants, self._poses).transpose(2, 0, 1))

    @cached_property
    def segments(self) -> tuple[Array, Array]:
        """(nf, ns, 3, 3) axes, one a row, and (nf, ns, 3) m origins of the segments."""
        axes, origins = segment_poses(self.chain, self._constants, self._poses)
        return np.ascontiguousarray(axes.transpose(3, 0, 1, 2)), np.ascontiguousarray(origins.transpose(2, 0, 1))

    def axis(self, name: str) -> Array:
        """(nf, 3) about which a variable turns what comes after it."""
        return self.columns[:, self.names.index(name), 3:]

    def frame(self, segment: str) -> Array:
        """(nf, 3, 3) axes of a segment, one a row."""
        return self.segments[0][:, self.chain.segments.index(segment)]

    def moves(self, segment: str) -> BoolArray:
        """(n,) which variables move a segment."""
        return np.asarray(self.chain.support[:, self.chain.segments.index(segment)] > 0)


class Dynamics:
    """The linkage of one set of parameters, ready for inverse dynamics of any number of frames.

    Joint parameters that are `held`, as rigid joints that stay where they are, report their generalised forces, too:
    after the 29, in their order.
    """

    def __init__(self, parameters: Parameters, held: tuple[str, ...] = ()) -> None:
        self.linkage = build_linkage(parameters, held, reactions=True)
        self._held = {name: float(parameters.joint[JP_INDEX[name]]) for name in held}
        self._chain = chain_of(free=held, reactions=True)
        self._constants = self._chain.constants(parameters.joint, parameters.zero_angles)
        self._data = self.linkage.model.createData()
        names = (*self._chain.coordinates, *self._chain.free)
        self._rows = np.array([self.linkage.index(name) for name in (*FORCES, *held)])
        self._chain_rows = np.array([names.index(name) for name in (*FORCES, *held)])

    def forces(self, q: Array, v: Array, a: Array, wrenches: Array) -> Array:
        """(nf, nt) generalised forces for coordinates (nf, nq), their derivatives, and foot wrenches (nf, 2, 6).

        Wrenches are [force N; moment N·m about the laboratory origin] of the ground on the right and left foot.
        """
        return self._unloaded(q, v, a) + self.of_ground(q, wrenches[..., None])[..., 0]

    def residual_force(self, q: Array, v: Array, a: Array, wrenches: Array) -> Array:
        """(nf, 3) N: the first three of `forces`, which need no place of the ground reactions."""
        return self._unloaded(q, v, a)[:, :3] - wrenches[:, :, :3].sum(axis=1)

    def _unloaded(self, q: Array, v: Array, a: Array) -> Array:
        state = (with_reactions(self.linkage, q, self._held), *(with_reactions(self.linkage, x) for x in (v, a)))
        return unloaded_forces(self.linkage, self._data, *state)[:, self._rows]

    def of_ground(self, q: Array, wrenches: Array) -> Array:
        """(nf, nt, k) the part -J_foot^T w of the generalised forces that foot wrenches (nf, 2, 6, k) make."""
        placed = PlacedLinkage(self._chain, self._constants, q)
        out = np.zeros((len(q), len(placed.names), wrenches.shape[3]))
        for foot, name in enumerate(FEET):
            moved = np.flatnonzero(placed.moves(name))
            out[:, moved] -= placed.columns[:, moved] @ wrenches[:, foot]
        return out[:, self._chain_rows]

    def regressor(self, q: Array, v: Array, a: Array) -> Array:
        """(nf, nt, 12, 10) generalised forces per dynamic parameter of each massive segment, without the ground's."""
        return in_segment_frames(self.linkage, joint_regressor(self.linkage, self._rows, q, v, a, held=self._held))

    def root_regressor(self, q: Array, v: Array, a: Array) -> Array:
        """(nf, 6, 12, 10): force and moment about the pelvis origin per dynamic parameter of each massive segment.

        Contracted with `dynamic_parameters` it gives the root wrench without ground reactions, laboratory axes.
        """
        rows = joint_regressor(self.linkage, self._rows[:6], q, v, a)
        return in_segment_frames(self.linkage, root_wrench(q, rows.reshape(len(q), 6, -1)).reshape(rows.shape))


def with_reactions(linkage: LinkageModel, values: Array, held: Mapping[str, float] = NOTHING_HELD) -> Array:
    """(nf, nt) in the order of the linkage, with zeros for the locked reaction joints, from (nf, nq).

    `held`: joint parameter -> m, rad, of those that the linkage has as joints.
    """
    out = np.zeros((len(values), linkage.model.nv))
    out[:, [linkage.index(name) for name in COORDINATES]] = values
    for name, value in held.items():
        out[:, linkage.index(name)] = value
    return out


def unloaded_forces(linkage: LinkageModel, data: pin.Data, q: Array, v: Array, a: Array) -> Array:
    """(nf, nv) RNEA frame by frame: what the motion asks for without ground reactions; q, v, a (nf, nv)."""
    model, rnea = linkage.model, pin.rnea
    tau = np.empty_like(q)
    for f in range(len(q)):
        tau[f] = rnea(model, data, q[f], v[f], a[f])
    return tau


def joint_regressor(
    linkage: LinkageModel, rows: IntArray, q: Array, v: Array, a: Array, *, held: Mapping[str, float] = NOTHING_HELD
) -> Array:
    """(nf, nr, 12, 10) some rows of RNEA per dynamic parameter of each massive segment, from coordinates (nf, nq).

    Parameters are those in the frame of the joint that carries the segment, as Pinocchio has them: a block of ten
    columns for each of its joints.
    """
    model, data = linkage.model, linkage.model.createData()
    columns = np.array([10 * (linkage.segment_joint[s] - 1) + k for s in MASSIVE_SEGMENTS for k in range(10)])
    chosen = np.ix_(rows, columns)
    q, v, a = with_reactions(linkage, q, held), with_reactions(linkage, v), with_reactions(linkage, a)
    out = np.empty((len(q), len(rows), len(columns)))
    for f in range(len(q)):
        out[f] = pin.computeJointTorqueRegressor(model, data, q[f], v[f], a[f])[chosen]
    return out.reshape(len(q), len(rows), len(MASSIVE_SEGMENTS), 10)


def in_segment_frames(linkage: LinkageModel, regressor: Array) -> Array:
    """(..., 12, 10) `joint_regressor` by the parameters that each segment has in its own frame."""
    out = np.empty_like(regressor)
    for k, segment in enumerate(MASSIVE_SEGMENTS):
        place = linkage.segment_placement[segment]
        out[..., k, :] = regressor[..., k, :] @ placed_dynamic_parameters(place.rotation, place.translation)
    return out


def root_wrench(q: Array, rows: Array) -> Array:
    """(nf, 6, k) [F; T] of the pelvis in laboratory axes, T about its origin, from the six root rows (nf, 6, k)."""
    axes, _, _ = pelvis_axes(q)
    return np.concatenate([rows[:, :3], np.linalg.solve(axes, rows[:, 3:])], axis=1)


def pelvis_residual(q: Array, forces: Array) -> Array:
    """(nf, 6) [F; T] that the ground reactions do not explain, from generalised forces (nf, nt)."""
    return root_wrench(q, forces[:, :6, None])[:, :, 0]


def pelvis_axes(q: Array) -> tuple[Array, Array, Array]:
    """(nf, 3, 3) laboratory axes of tilt, list and rotation as rows; and their derivatives by tilt and by list."""
    ct, st, cl, sl = np.cos(q[:, 3]), np.sin(q[:, 3]), np.cos(q[:, 4]), np.sin(q[:, 4])
    zero, one = np.zeros(len(q)), np.ones(len(q))

    def rows(*axes: tuple[Array, Array, Array]) -> Array:
        return np.stack([np.stack(axis, axis=1) for axis in axes], axis=1)

    nothing = (zero, zero, zero)
    axes = rows((zero, zero, one), (ct, st, zero), (-st * cl, ct * cl, sl))
    by_tilt = rows(nothing, (-st, ct, zero), (-ct * cl, -st * cl, zero))
    by_list = rows(nothing, nothing, (st * sl, -ct * sl, cl))
    return axes, by_tilt, by_list


def moments_of(parameters: Parameters, motion: Motion, wrenches: Array, bwh: float) -> Moments:
    """Generalised forces of a whole-body motion under foot wrenches (nf, 2, 6); `bwh` in N·m."""
    forces = Dynamics(parameters).forces(motion.q, motion.velocity, motion.acceleration, wrenches)
    residual = pelvis_residual(motion.q, forces)
    return Moments(
        coordinates=COORDINATES,
        time=motion.time,
        tau=forces[:, : len(COORDINATES)],
        knee_adduction=forces[:, len(COORDINATES) :],
        residual_force=residual[:, :3],
        residual_moment=residual[:, 3:],
        bwh=bwh,
    )


@with_one_blas_thread
def inverse_dynamics(model: SubjectModel, motion: Motion, forces: Array) -> Moments:
    """Joint torques of a whole-body motion.

    Parameters
    ----------
    model : the person's model; its parameters should be those the motion was tracked with.
    motion : from `gaitcal.track`, all coordinates.
    forces : (nf, 2, 6) ground on right and left foot at the frames of the motion: force (N) and moment (N·m) about
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
        raise ValueError(f"inverse dynamics needs a motion of the whole body, with all {len(COORDINATES)} coordinates")
    if not isinstance(forces, np.ndarray):
        raise InputError(
            f"found {type(forces).__name__}; allowed: an array (frames, 2, 6) of the forces on right and left foot, as "
            "gaitcal.ground_reactions(model, motion, recording).wrench gives it for force plates",
            field="forces",
            code=Code.ARGUMENT,
        )
    if forces.shape != (len(motion.time), 2, 6):
        raise ValueError(f"forces have shape {forces.shape}, expected ({len(motion.time)}, 2, 6)")
    return moments_of(model.parameters, motion, forces, model.subject.bwh)
