"""Inverse dynamics: the generalised forces that the motion and the ground reactions ask for.

    tau_k = J_k . sum_(bodies that k moves) f  -  sum_feet J_foot^T w_foot

with f the wrench that a body asks for, w_foot that of the ground on the foot, J_k and J_foot spatial velocities per
unit of a variable: all about the laboratory origin, so that no wrench needs a transformation to the foot. In the axes
of a body, about its origin o, with its acceleration a_o (gravity as an acceleration upwards), w and al = dw/dt,

    F = m a_o + al x (m c) + w x (w x (m c)),      M = (m c) x a_o + I al + w x I w.

Two locked joints report the knees' internal reaction moment about
the knee frame's x axis. The six root rows are the pelvis residual, what no ground reaction explains:

    F = tau_(tx, ty, tz),   A(q) T = tau_(tilt, list, rotation),

A's rows being the axes of the pelvis rotations in the laboratory, so that T is the moment about the pelvis origin in
laboratory axes. Without ground reactions tau is linear in the dynamic parameters of the segments (m, m c, I about the
segment origin); their matrix is the regressor. Pinocchio gives the same frame by frame (tested).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gaitcal.arrays import Array, BoolArray, IntArray, cross, stretches
from gaitcal.errors import Code, InputError
from gaitcal.model import linkage
from gaitcal.model.chain import Chain, ChainConstants, chain_of, forward, jacobian, segment_poses
from gaitcal.model.parameters import MASSIVE_SEGMENTS, Parameters, dynamic_parameters
from gaitcal.model.subject_model import GRAVITY, SubjectModel
from gaitcal.motion.motion import Motion
from gaitcal.runtime import with_one_blas_thread

FEET: tuple[str, ...] = ("foot_r", "foot_l")  # Order of the second axis of every array of foot wrenches
FORCES: tuple[str, ...] = (*linkage.COORDINATES, *linkage.REACTIONS)
"""Order of the 29 generalised forces of a frame: the 27 coordinates, then the two knee reactions."""
ORDER = tuple(
    e.name
    for part in (linkage.root_elements("pelvis"), *(linkage.joint_elements(j, reactions=True) for j in linkage.JOINTS))
    for e in part
)
"""Every turn and slide of the linkage, each after what moves it."""
SKEW = np.zeros((3, 3, 3))  # SKEW[i, j, k] x_k is entry (i, j) of the matrix of x x
for _i in range(3):
    SKEW[_i, (_i + 1) % 3, (_i + 2) % 3], SKEW[_i, (_i + 2) % 3, (_i + 1) % 3] = -1.0, 1.0
OF_INERTIA = np.zeros((3, 6, 3))
"""OF_INERTIA[i, j, k] x_k is entry (i, j) of I x by the six moments and products I (xx, xy, yy, xz, yz, zz)."""
for _n, (_i, _j) in enumerate(((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))):
    OF_INERTIA[_i, _n, _j] = OF_INERTIA[_j, _n, _i] = 1.0
BLOCK = 500  # Frames at a time: a treadmill's trial may last for minutes
UPWARDS = np.array([0.0, GRAVITY, 0.0, 0.0, 0.0, 0.0])  # m/s^2, gravity as an acceleration of the ground


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
        for k, name in enumerate(self.chain.coordinates):
            if name in linkage.COORDINATE_INDEX:
                out[:, k] = values[:, linkage.COORDINATE_INDEX[name]]
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

    def motions(self, v: Array, a: Array) -> tuple[Array, Array]:
        """(nf, ns, 6) velocity and acceleration of the segments about the laboratory origin, from (nf, nq)."""
        (before, at_segment), v, a = paths(self.chain), self.whole(v), self.whole(a)
        moving = self.columns[:, : v.shape[1]]
        speed = moving * v[:, :, None]
        gained = moving * a[:, :, None] + crossed(before[: v.shape[1]] @ speed, moving) * v[:, :, None]
        return at_segment @ speed, at_segment @ gained + UPWARDS

    @cached_property
    def bodies(self) -> tuple[list[int], list[int]]:
        """Of the massive segments that the chain has, places among `MASSIVE_SEGMENTS` and among its segments."""
        found = [(k, self.chain.segments.index(s)) for k, s in enumerate(MASSIVE_SEGMENTS) if s in self.chain.segments]
        return [k for k, _ in found], [s for _, s in found]

    def _of_bodies(self, v: Array, a: Array) -> tuple[Array, Array, Array]:
        """(nf, bodies, 3) each, in a body's axes: acceleration of its origin, angular velocity and acceleration."""
        axes, origin = (x[:, self.bodies[1]] for x in self.segments)
        velocity, gained = (x[:, self.bodies[1]] for x in self.motions(v, a))
        turn, turning = velocity[..., 3:], gained[..., 3:]
        pull = gained[..., :3] + cross(turning, origin) + cross(turn, velocity[..., :3] + cross(turn, origin))
        of_each = (axes @ np.stack([pull, turn, turning], axis=3)).transpose(3, 0, 1, 2)
        return of_each[0], of_each[1], of_each[2]

    def regressors(self, v: Array, a: Array) -> Array:
        """(nf, bodies, 6, 10) wrench [F; M] about its origin, in its axes, that each body asks for, per dynamic
        parameter; v and a (nf, nq).
        """
        pull, turn, turning = self._of_bodies(v, a)
        out, spin = np.zeros((*pull.shape[:2], 6, 10)), skew(turn)
        out[..., :3, 0] = pull
        out[..., :3, 1:4] = skew(turning) + spin @ spin
        out[..., 3:, 1:4] = -skew(pull)
        of_inertia, of_spin = ((OF_INERTIA @ x[..., None, :, None])[..., 0] for x in (turning, turn))
        out[..., 3:, 4:] = of_inertia + spin @ of_spin
        return out

    def unloaded_forces(self, dynamic: Array, v: Array, a: Array) -> Array:
        """(nf, n) what the motion asks for of every variable without ground reactions; v and a (nf, nq).

        `dynamic`: (12, 10) dynamic parameters of the massive segments.
        """
        own, (pull, turn, turning) = dynamic[self.bodies[0]], self._of_bodies(v, a)
        mass, first, inertia = own[:, :1], own[:, 1:4], own[:, [[4, 5, 7], [5, 6, 8], [7, 8, 9]]]
        axes, origin = (x[:, self.bodies[1]] for x in self.segments)
        force = mass * pull + cross(turning, first) + cross(turn, cross(turn, first))
        angular, rate = ((inertia @ x[..., None])[..., 0] for x in (turn, turning))
        moment = cross(first, pull) + rate + cross(turn, angular)
        force, moment = np.moveaxis(np.stack([force, moment], axis=2) @ axes, 2, 0)
        wrench = np.concatenate([force, moment + cross(origin, force)], axis=2)
        moved = np.ascontiguousarray(self.chain.support[:, self.bodies[1]], dtype=float)
        return np.asarray((self.columns * (moved @ wrench)).sum(axis=2))

    def regressor(self, rows: IntArray, v: Array, a: Array) -> Array:
        """(nf, nr, 12, 10) the variables `rows` of `unloaded_forces` per dynamic parameter of each massive segment."""
        axes, origin = (x[:, self.bodies[1]] for x in self.segments)
        columns = self.columns[:, None, rows]
        turn = columns[..., 3:] @ axes.swapaxes(2, 3)
        slide = (columns[..., :3] + cross(columns[..., 3:], origin[:, :, None])) @ axes.swapaxes(2, 3)
        moved = np.asarray(self.chain.support[rows][:, self.bodies[1]] > 0).T[:, :, None]
        out = np.zeros((len(columns), len(MASSIVE_SEGMENTS), len(rows), 10))
        out[:, self.bodies[0]] = (np.concatenate([slide, turn], axis=3) * moved) @ self.regressors(v, a)
        return out.swapaxes(1, 2)

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
        self.dynamic = dynamic_parameters(parameters.inertial)
        """(12, 10) of the massive segments: of bodies with any axes, if others are put here."""
        self._chain = chain_of(free=held, reactions=True)
        self._constants = self._chain.constants(parameters.joint, parameters.zero_angles)
        names = (*self._chain.coordinates, *self._chain.free)
        self._rows = np.array([names.index(name) for name in (*FORCES, *held)])

    def placed(self, q: Array) -> PlacedLinkage:
        """The linkage at coordinates (nf, nq)."""
        return PlacedLinkage(self._chain, self._constants, q)

    def forces(self, q: Array, v: Array, a: Array, wrenches: Array) -> Array:
        """(nf, nt) generalised forces for coordinates (nf, nq), their derivatives, and foot wrenches (nf, 2, 6).

        Wrenches are [force N; moment N·m about the laboratory origin] of the ground on the right and left foot.
        """
        parts = []
        for part in stretches(len(q), BLOCK) or [slice(0)]:
            placed = self.placed(q[part])
            unloaded = placed.unloaded_forces(self.dynamic, v[part], a[part])[:, self._rows]
            parts.append(unloaded + self._of_ground(placed, wrenches[part, ..., None])[..., 0])
        return np.concatenate(parts)

    def residual_force(self, q: Array, v: Array, a: Array, wrenches: Array) -> Array:
        """(nf, 3) N: the first three of `forces`, which need no place of the ground reactions."""
        return self.forces(q, v, a, np.zeros_like(wrenches))[:, :3] - wrenches[:, :, :3].sum(axis=1)

    def of_ground(self, q: Array, wrenches: Array) -> Array:
        """(nf, nt, k) the part -J_foot^T w of the generalised forces that foot wrenches (nf, 2, 6, k) make."""
        return self._of_ground(self.placed(q), wrenches)

    def _of_ground(self, placed: PlacedLinkage, wrenches: Array) -> Array:
        out = np.zeros((len(wrenches), len(placed.names), wrenches.shape[3]))
        for foot, name in enumerate(FEET):
            moved = np.flatnonzero(placed.moves(name))
            out[:, moved] -= placed.columns[:, moved] @ wrenches[:, foot]
        return out[:, self._rows]

    def regressor(self, q: Array, v: Array, a: Array) -> Array:
        """(nf, nt, 12, 10) generalised forces per dynamic parameter of each massive segment, without the ground's."""
        return self.placed(q).regressor(self._rows, v, a)

    def root_regressor(self, q: Array, v: Array, a: Array) -> Array:
        """(nf, 6, 12, 10): force and moment about the pelvis origin per dynamic parameter of each massive segment.

        Contracted with `dynamic_parameters` it gives the root wrench without ground reactions, laboratory axes.
        """
        rows = self.placed(q).regressor(self._rows[:6], v, a)
        return root_wrench(q, rows.reshape(len(q), 6, -1)).reshape(rows.shape)


def paths(chain: Chain) -> tuple[Array, Array]:
    """(nq + np, nq) 1 where a coordinate comes before a variable, and (ns, nq) 1 where it moves a segment."""
    count = len(chain.coordinates)
    frames = np.zeros((count + 1, count))
    """By frame, 1 for its own coordinate and those before it; the last is the ground."""
    for k, parent in enumerate(chain.parents):
        frames[k] = frames[parent]
        frames[k, k] = 1.0
    return frames[[*chain.parents, *chain.parameter_frame]], frames[chain.segment_frame]


def skew(x: Array) -> Array:
    """(..., 3, 3) matrices of x x, for (..., 3)."""
    return (x @ SKEW.reshape(9, 3).T).reshape(*x.shape, 3)


def crossed(a: Array, b: Array) -> Array:
    """(..., 6) a x b of motions [v; w]."""
    out = np.empty(np.broadcast_shapes(a.shape, b.shape))
    out[..., :3] = cross(a[..., 3:], b[..., :3]) + cross(a[..., :3], b[..., 3:])
    out[..., 3:] = cross(a[..., 3:], b[..., 3:])
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
    if motion.coordinates != linkage.COORDINATES:
        message = f"inverse dynamics needs a motion of the whole body, with all {len(linkage.COORDINATES)} coordinates"
        raise ValueError(message)
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
