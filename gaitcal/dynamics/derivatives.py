"""Derivatives of the generalised forces and of the pelvis residual: by motion, joint and dynamic parameters.

Those of `rnea_slopes.py` on the linkage in which the joint parameters of interest are joints, constant in time. Ground
reactions stay fixed in the laboratory: for a variable j before i on the way to a foot the column J_i turns and moves
with j,

    d (J_i^T w) / d j = (J_j x J_i) . w,      [v_j; w_j] x [v_i; w_i] = [w_j x v_i + v_j x w_i; w_j x w_i],

and not otherwise. The pelvis residual rho = [F; T] (`inverse_dynamics.py`), which a fit to ground reactions minimises,
has  dT = A^-1 (d tau - dA T).

Derivatives of inverse dynamics (RNEA) for all frames of a stretch at once.

Motions [v; w] and wrenches [F; M] are about the laboratory origin, in its axes. With J_k the column of variable k, V
and A the velocity and acceleration (gravity as an acceleration upwards) of what comes before it, and sums over the
bodies that it moves,

    P_k = V x J_k,    Q_k = A x J_k + V x P_k,    I_k = sum I,    f_k = sum f,    f = I a + v x* I v,
    B_k = sum B,      B m = v x* I m - I (v x m) + m x* I v,

the derivatives of tau_i by variable j are (Singh, Russell and Wensing 2022, with B twice theirs), j after i or i itself

    by q:  J_i . (B_j P_j + I_j Q_j + J_j x* f_j)      by v:  J_i . (B_j J_j + 2 I_j P_j)      by a:  J_i . I_j J_j

and j before i

    by q:  J_i . (B_i P_j + I_i Q_j)                   by v:  J_i . (B_i J_j + 2 I_i P_j)      by a:  J_j . I_i J_i.

Pinocchio's `computeRNEADerivatives` gives the same frame by frame (tested), for all pairs of variables.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array, BoolArray, IntArray, cross
from gaitcal.dynamics.inverse_dynamics import FEET, FORCES, Dynamics, pelvis_axes, pelvis_residual, root_wrench
from gaitcal.dynamics.joint_moments import ORDER
from gaitcal.model.chain import Chain, ChainConstants, chain_of, forward, jacobian, segment_poses
from gaitcal.model.linkage import COORDINATES
from gaitcal.model.parameters import MASSIVE_SEGMENTS, Parameters, table
from gaitcal.model.subject_model import GRAVITY

SKEW = np.zeros((3, 3, 3))
"""SKEW[i, j, k] x_k is entry (i, j) of the matrix of x x."""
for _i in range(3):
    SKEW[_i, (_i + 1) % 3, (_i + 2) % 3], SKEW[_i, (_i + 2) % 3, (_i + 1) % 3] = -1.0, 1.0


UPWARDS = np.array([0.0, GRAVITY, 0.0, 0.0, 0.0, 0.0])
"""m/s^2, gravity as an acceleration of the ground."""


@dataclass(frozen=True, kw_only=True)
class StretchState:
    """A chain in some frames."""

    columns: Array
    """(nf, nq + np, 6) J."""
    axes: Array
    """(nf, ns, 3, 3) axes of the segments, one a row."""
    origins: Array
    """(nf, ns, 3) m."""
    velocity: Array
    """(nf, nq) of the coordinates."""
    acceleration: Array
    """(nf, nq)."""


@dataclass(frozen=True)
class RneaSlopes:
    """Derivatives of some generalised forces."""

    by_position: Array
    """(nf, n, k) by coordinates, then free joint parameters."""
    by_velocity: Array
    """(nf, n, c) by the coordinates among these."""
    by_acceleration: Array
    """(nf, n, c)."""


def rnea_slopes(
    chain: Chain, inertial: Array, state: StretchState, rows: IntArray, by: IntArray, pulls: Array, after: BoolArray
) -> RneaSlopes:
    """Of the generalised forces of the variables `rows` (n,) by the variables `by` (k,), coordinates first.

    Parameters
    ----------
    inertial : (ni,) inertial parameters.
    pulls : (nf, n, 6) more that a derivative by position has for variables before its row: pulls . J_j.
    after : (nq + np, nq + np) whether variable j is i or comes after it on the way to all that it moves, [i, j].
    """
    count = len(chain.coordinates)
    before, at_segment = _paths(chain)
    columns = state.columns
    moving = columns[:, :count]
    speed = moving * state.velocity[:, :, None]
    ahead = before @ speed
    turned = crossed(ahead, columns)
    gained = moving * state.acceleration[:, :, None] + turned[:, :count] * state.velocity[:, :, None]
    twice = crossed(before @ gained + UPWARDS, columns) + crossed(ahead, turned)
    matrices, forces = _bodies(chain, inertial, state, at_segment @ speed, at_segment @ gained + UPWARDS)
    by_q, by_v, carried, levers = (np.empty_like(columns) for _ in range(4))
    for own in range(len(matrices)):
        of = np.flatnonzero(chain.moved_set == own)
        n, matrix = len(of), matrices[own]
        given = np.concatenate([columns[:, of], turned[:, of], twice[:, of]], axis=1)
        made = given @ matrix.transpose(0, 2, 1)  # (nf, 3 n, 12): I and B of J, of P, of Q
        carried[:, of] = made[:, :n, :6]
        by_q[:, of] = made[:, n : 2 * n, 6:] + made[:, 2 * n :, :6] + on_force(columns[:, of], forces[own][:, None])
        by_v[:, of] = made[:, :n, 6:] + 2.0 * made[:, n : 2 * n, :6]
        levers[:, of] = columns[:, of] @ matrix[:, 6:]
    left, coordinates = columns[:, rows], by[by < count]
    behind = np.concatenate([levers[:, rows], carried[:, rows], pulls], axis=2)
    ahead_q = np.concatenate([turned[:, by], twice[:, by], columns[:, by]], axis=2)
    ahead_v = np.concatenate([columns[:, coordinates], 2.0 * turned[:, coordinates]], axis=2)
    later, earlier = after[rows][:, by], after[by][:, rows].T
    return RneaSlopes(
        _of_pairs(left, by_q[:, by], later, behind, ahead_q, earlier),
        _of_pairs(left, by_v[:, coordinates], later, behind[:, :, :12], ahead_v, earlier),
        _of_pairs(left, carried[:, coordinates], later, carried[:, rows], columns[:, coordinates], earlier),
    )


def _of_pairs(own: Array, after: Array, later: BoolArray, behind: Array, before: Array, earlier: BoolArray) -> Array:
    """(nf, n, k) own . after where `later`, behind . before where `earlier` only, else 0."""
    k = after.shape[1]
    out: Array = own @ after.transpose(0, 2, 1)
    out *= later[:, :k]
    out += (behind @ before.transpose(0, 2, 1)) * (earlier & ~later)[:, :k]
    return out


def _paths(chain: Chain) -> tuple[Array, Array]:
    """(nq + np, nq) 1 where a coordinate comes before a variable, and (ns, nq) 1 where it moves a segment."""
    count = len(chain.coordinates)
    frames = np.zeros((count + 1, count))
    """By frame, 1 for its own coordinate and those before it; the last is the ground."""
    for k, parent in enumerate(chain.parents):
        frames[k] = frames[parent]
        frames[k, k] = 1.0
    return frames[[*chain.parents, *chain.parameter_frame]], frames[chain.segment_frame]


def _bodies(
    chain: Chain, inertial: Array, state: StretchState, velocity: Array, acceleration: Array
) -> tuple[Array, Array]:
    """(n, nf, 12, 6) sums of I and B over each distinct set of segments, and (n, nf, 6) of f; V and A of all segments
    (nf, ns, 6).
    """
    places = [chain.segments.index(s) for s in MASSIVE_SEGMENTS]
    body = table(inertial)
    mass = body[:, 0, None, None]
    axes, origin, v, a = (
        np.ascontiguousarray(x[:, places].swapaxes(0, 1)) for x in (state.axes, state.origins, velocity, acceleration)
    )
    centre = origin + (body[:, None, None, 1:4] @ axes)[:, :, 0]
    shape = axes.swapaxes(2, 3) @ (body[:, None, 4:7, None] * axes)
    lever = skew(centre)
    both = np.zeros((*v.shape[:2], 12, 6))
    inertia, bias = both[:, :, :6], both[:, :, 6:]
    inertia[..., :3, :3] = mass[..., None] * np.eye(3)
    inertia[..., 3:, :3] = mass[..., None] * lever
    inertia[..., :3, 3:] = -inertia[..., 3:, :3]
    inertia[..., 3:, 3:] = shape - mass[..., None] * (lever @ lever)
    momentum = (inertia @ v[..., None])[..., 0]
    force = (inertia @ a[..., None])[..., 0] + on_force(v, momentum)
    moves = np.zeros_like(inertia)
    """The matrix of v x; that of v x* is its negative transpose."""
    moves[..., :3, :3] = moves[..., 3:, 3:] = skew(v[..., 3:])
    moves[..., :3, 3:] = skew(v[..., :3])
    turned = inertia @ moves
    np.negative(turned + turned.swapaxes(2, 3), out=bias)
    push = skew(momentum[..., :3])
    bias[..., :3, 3:] -= push
    bias[..., 3:, :3] -= push
    bias[..., 3:, 3:] -= skew(momentum[..., 3:])
    sums, nf = chain.moved_sets[:, places], len(state.columns)
    return (
        (sums @ both.reshape(len(both), -1)).reshape(-1, nf, 12, 6),
        (sums @ force.reshape(len(force), -1)).reshape(-1, nf, 6),
    )


def skew(x: Array) -> Array:
    """(..., 3, 3) matrices of x x, for (..., 3)."""
    out: Array = (x @ SKEW.reshape(9, 3).T).reshape(*x.shape, 3)
    return out


def crossed(a: Array, b: Array) -> Array:
    """(..., 6) a x b of motions [v; w]."""
    out = np.empty(np.broadcast_shapes(a.shape, b.shape))
    out[..., :3] = cross(a[..., 3:], b[..., :3]) + cross(a[..., :3], b[..., 3:])
    out[..., 3:] = cross(a[..., 3:], b[..., 3:])
    return out


def on_force(m: Array, f: Array) -> Array:
    """(..., 6) m x* f of motions [v; w] and wrenches [F; M]."""
    out = np.empty(np.broadcast_shapes(m.shape, f.shape))
    out[..., :3] = cross(m[..., 3:], f[..., :3])
    out[..., 3:] = cross(m[..., 3:], f[..., 3:]) + cross(m[..., :3], f[..., :3])
    return out


FRAMES_AT_ONCE = 128
"""Keeps the working set in the processor's cache."""


@dataclass(frozen=True, kw_only=True)
class ForceDerivatives:
    """Of n generalised forces: the 29 in the order of `FORCES`, or some of them, then those of held joint parameters.

    N·m or N per m, rad, and their rates.
    """

    by_position: Array
    """(nf, n, nq)."""
    by_velocity: Array
    """(nf, n, nq)."""
    by_acceleration: Array
    """(nf, n, nq)."""
    by_parameter: Array
    """(nf, n, np), in the order of `free`."""
    free: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class RootResidual:
    """Residual wrench at the pelvis and its derivatives, frame by frame; N and N·m."""

    value: Array
    """(nf, 6)."""
    by_position: Array
    """(nf, 6, nq)."""
    by_velocity: Array
    """(nf, 6, nq)."""
    by_acceleration: Array
    """(nf, 6, nq)."""
    by_parameter: Array
    """(nf, 6, np)."""
    free: tuple[str, ...]
    regressor: Array
    """(nf, 6, 120) by the dynamic parameters of the 12 massive segments."""


def force_derivatives(
    parameters: Parameters,
    free: tuple[str, ...],
    q: Array,
    v: Array,
    a: Array,
    wrenches: Array,
    held: tuple[str, ...] = (),
    of: tuple[str, ...] = FORCES,
) -> ForceDerivatives:
    """Derivatives of `Dynamics.forces` at coordinates (nf, nq), their derivatives, and foot wrenches (nf, 2, 6).

    `held`: joint parameters whose own generalised forces follow (`Dynamics`). `of`: those of the 29 that are wanted.
    """
    opened = (*free, *(name for name in held if name not in free))
    chain = chain_of(free=opened, reactions=True)
    free = tuple(name for name in chain.free if name in free)
    names = (*chain.coordinates, *chain.free)
    place = {name: k for k, name in enumerate(names)}
    moving = [place[name] for name in COORDINATES]
    rows = np.array([place[name] for name in (*of, *held)])
    by = np.array([place[name] for name in (*COORDINATES, *free)])
    after = _after(chain, names)
    constants = chain.constants(parameters.joint, parameters.zero_angles)
    found = []
    for start in range(0, len(q), FRAMES_AT_ONCE):
        part = slice(start, start + FRAMES_AT_ONCE)
        state = np.zeros((3, len(q[part]), len(chain.coordinates)))
        for k, values in enumerate((q, v, a)):
            state[k][:, moving] = values[part]
        placed = _placed(chain, constants, *state)
        contact = _contact_pulls(chain, placed.columns, wrenches[part], rows)
        found.append(rnea_slopes(chain, parameters.inertial, placed, rows, by, contact, after))
    by_q = np.concatenate([part.by_position for part in found])
    return ForceDerivatives(
        by_position=by_q[:, :, : len(COORDINATES)],
        by_velocity=np.concatenate([part.by_velocity for part in found]),
        by_acceleration=np.concatenate([part.by_acceleration for part in found]),
        by_parameter=by_q[:, :, len(COORDINATES) :],
        free=free,
    )


def _placed(chain: Chain, constants: ChainConstants, q: Array, v: Array, a: Array) -> StretchState:
    """The chain at its own coordinates (nf, nq) and their derivatives."""
    poses = forward(chain, constants, q)
    axes, origins = segment_poses(chain, constants, poses)
    return StretchState(
        columns=np.ascontiguousarray(jacobian(chain, constants, poses).transpose(2, 0, 1)),
        axes=np.ascontiguousarray(axes.transpose(3, 0, 1, 2)),
        origins=np.ascontiguousarray(origins.transpose(2, 0, 1)),
        velocity=v,
        acceleration=a,
    )


def _after(chain: Chain, names: tuple[str, ...]) -> BoolArray:
    """(nq + np, nq + np) whether variable j, [i, j], is i or comes after it on the way to all that it moves."""
    rank = np.array([ORDER.index(name) for name in names])
    within = (chain.support[None] <= chain.support[:, None]).all(axis=2)
    return np.asarray(within & (rank[None] >= rank[:, None]))


def _contact_pulls(chain: Chain, columns: Array, wrenches: Array, rows: IntArray) -> Array:
    """(nf, n, 6) what, times J_j, is the derivative of -sum_feet J_i^T w by a variable j before i, for i of `rows`."""
    out = np.zeros((len(columns), len(rows), 6))
    for foot, segment in enumerate(FEET):
        own = np.flatnonzero(chain.support[rows, chain.segments.index(segment)])
        force, moment = wrenches[:, None, foot, :3], wrenches[:, None, foot, 3:]
        v, w = columns[:, rows[own], :3], columns[:, rows[own], 3:]
        # F . (w_j x v_i) = w_j . (v_i x F), and so on
        out[:, own, :3] -= cross(w, force)
        out[:, own, 3:] -= cross(v, force) + cross(w, moment)
    return out


def root_residual(
    parameters: Parameters, free: tuple[str, ...], q: Array, v: Array, a: Array, wrenches: Array
) -> RootResidual:
    """Pelvis residual at coordinates (nf, nq), their derivatives, and foot wrenches (nf, 2, 6)."""
    dynamics = Dynamics(parameters)
    value = pelvis_residual(q, dynamics.forces(q, v, a, wrenches))
    slopes = force_derivatives(parameters, free, q, v, a, wrenches, of=FORCES[:6])
    _, by_tilt, by_list = pelvis_axes(q)
    by_position = slopes.by_position.copy()
    for k, turned in ((3, by_tilt), (4, by_list)):
        by_position[:, 3:, k] -= np.einsum("fij,fj->fi", turned, value[:, 3:])
    return RootResidual(
        value=value,
        by_position=root_wrench(q, by_position),
        by_velocity=root_wrench(q, slopes.by_velocity),
        by_acceleration=root_wrench(q, slopes.by_acceleration),
        by_parameter=root_wrench(q, slopes.by_parameter),
        free=slopes.free,
        regressor=dynamics.root_regressor(q, v, a).reshape(len(q), 6, -1),
    )
