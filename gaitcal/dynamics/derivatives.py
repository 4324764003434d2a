"""Derivatives of the generalised forces and of the pelvis residual: by motion, joint and dynamic parameters.

The joint parameters of interest are joints of the linkage, constant in time. Ground reactions stay fixed in the
laboratory: for a variable j before i on the way to a foot the column J_i turns and moves with j,

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

from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array, BoolArray, IntArray, cross
from gaitcal.dynamics import inverse_dynamics
from gaitcal.model.chain import chain_of
from gaitcal.model.linkage import COORDINATES
from gaitcal.model.parameters import MASSIVE_SEGMENTS, Parameters, table

FRAMES_AT_ONCE = 128  # Keeps the working set in the processor's cache


@dataclass(frozen=True, kw_only=True)
class ForceDerivatives:
    """Of n generalised forces: the 29 in the order of `FORCES`, or some of them, then those of held joint parameters.

    N·m or N per m, rad, and their rates.
    """

    by_position: Array  # (nf, n, nq)
    by_velocity: Array  # (nf, n, nq)
    by_acceleration: Array  # (nf, n, nq)
    by_parameter: Array  # (nf, n, np), in the order of `free`
    free: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class RootResidual(ForceDerivatives):
    """Residual wrench at the pelvis, n = 6, N and N·m, with its derivatives."""

    value: Array  # (nf, 6)
    regressor: Array  # (nf, 6, 120) by the dynamic parameters of the 12 massive segments


def force_derivatives(
    parameters: Parameters,
    free: tuple[str, ...],
    q: Array,
    v: Array,
    a: Array,
    wrenches: Array,
    held: tuple[str, ...] = (),
    of: tuple[str, ...] = inverse_dynamics.FORCES,
) -> ForceDerivatives:
    """Derivatives of `Dynamics.forces` at coordinates (nf, nq), their derivatives, and foot wrenches (nf, 2, 6).

    `held`: joint parameters whose own generalised forces follow (`Dynamics`). `of`: those of the 29 that are wanted.
    """
    chain = chain_of(free=(*free, *(name for name in held if name not in free)), reactions=True)
    constants = chain.constants(parameters.joint, parameters.zero_angles)
    free = tuple(name for name in chain.free if name in free)
    index = {name: k for k, name in enumerate((*chain.coordinates, *chain.free))}
    rows, by = (np.array([index[name] for name in names]) for names in ((*of, *held), (*COORDINATES, *free)))
    parts = []
    for start in range(0, len(q), FRAMES_AT_ONCE):
        part = slice(start, start + FRAMES_AT_ONCE)
        placed = inverse_dynamics.PlacedLinkage(chain, constants, q[part])
        parts.append(_rnea_slopes(placed, parameters.inertial, v[part], a[part], wrenches[part], rows, by))
    by_q, by_v, by_a = (np.concatenate(slopes) for slopes in zip(*parts, strict=True))
    split = len(COORDINATES)
    return ForceDerivatives(
        by_position=by_q[:, :, :split],
        by_velocity=by_v,
        by_acceleration=by_a,
        by_parameter=by_q[:, :, split:],
        free=free,
    )


def root_residual(
    parameters: Parameters, free: tuple[str, ...], q: Array, v: Array, a: Array, wrenches: Array
) -> RootResidual:
    """Pelvis residual at coordinates (nf, nq), their derivatives, and foot wrenches (nf, 2, 6)."""
    dynamics = inverse_dynamics.Dynamics(parameters)
    value = inverse_dynamics.pelvis_residual(q, dynamics.forces(q, v, a, wrenches))
    slopes = force_derivatives(parameters, free, q, v, a, wrenches, of=inverse_dynamics.FORCES[:6])
    _, by_tilt, by_list = inverse_dynamics.pelvis_axes(q)
    by_position = slopes.by_position.copy()
    for k, turned in ((3, by_tilt), (4, by_list)):
        by_position[:, 3:, k] -= np.einsum("fij,fj->fi", turned, value[:, 3:])
    return RootResidual(
        value=value,
        by_position=inverse_dynamics.root_wrench(q, by_position),
        by_velocity=inverse_dynamics.root_wrench(q, slopes.by_velocity),
        by_acceleration=inverse_dynamics.root_wrench(q, slopes.by_acceleration),
        by_parameter=inverse_dynamics.root_wrench(q, slopes.by_parameter),
        free=slopes.free,
        regressor=dynamics.root_regressor(q, v, a).reshape(len(q), 6, -1),
    )


def _rnea_slopes(
    placed: inverse_dynamics.PlacedLinkage,
    inertial: Array,
    v: Array,
    a: Array,
    wrenches: Array,
    rows: IntArray,
    by: IntArray,
) -> tuple[Array, Array, Array]:
    """(nf, n, k) by position, and (nf, n, c) by velocity and acceleration: of the generalised forces of the variables
    `rows` (n,), by the variables `by` (k,), the c coordinates first.
    """
    chain, columns = placed.chain, placed.columns
    count = len(chain.coordinates)
    # whether variable j, [i, j], is i or comes after it on the way to all that it moves
    within = (chain.support[None] <= chain.support[:, None]).all(axis=2)
    after = np.asarray(within & (placed.rank[None] >= placed.rank[:, None]))
    before, at_segment = inverse_dynamics.paths(chain)
    moving, v, a = columns[:, :count], placed.whole(v), placed.whole(a)
    speed = moving * v[:, :, None]
    ahead = before @ speed
    turned = inverse_dynamics.crossed(ahead, columns)
    gained = moving * a[:, :, None] + turned[:, :count] * v[:, :, None]
    twice = inverse_dynamics.crossed(before @ gained + inverse_dynamics.UPWARDS, columns) + inverse_dynamics.crossed(
        ahead, turned
    )
    matrices, forces = _bodies(placed, inertial, at_segment @ speed, at_segment @ gained + inverse_dynamics.UPWARDS)
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
    behind = np.concatenate([levers[:, rows], carried[:, rows], _contact_pulls(placed, wrenches, rows)], axis=2)
    ahead_q = np.concatenate([turned[:, by], twice[:, by], columns[:, by]], axis=2)
    ahead_v = np.concatenate([columns[:, coordinates], 2.0 * turned[:, coordinates]], axis=2)
    later, earlier = after[rows][:, by], after[by][:, rows].T
    return (
        _of_pairs(left, by_q[:, by], later, behind, ahead_q, earlier),
        _of_pairs(left, by_v[:, coordinates], later, behind[:, :, :12], ahead_v, earlier),
        _of_pairs(left, carried[:, coordinates], later, carried[:, rows], columns[:, coordinates], earlier),
    )


def _contact_pulls(placed: inverse_dynamics.PlacedLinkage, wrenches: Array, rows: IntArray) -> Array:
    """(nf, n, 6) what, times J_j, is the derivative of -sum_feet J_i^T w by a variable j before i, for i of `rows`."""
    out = np.zeros((len(wrenches), len(rows), 6))
    for foot, segment in enumerate(inverse_dynamics.FEET):
        moving = np.flatnonzero(placed.moves(segment)[rows])
        force, moment = wrenches[:, None, foot, :3], wrenches[:, None, foot, 3:]
        v, w = placed.columns[:, rows[moving], :3], placed.columns[:, rows[moving], 3:]
        # F . (w_j x v_i) = w_j . (v_i x F), and so on
        out[:, moving, :3] -= cross(w, force)
        out[:, moving, 3:] -= cross(v, force) + cross(w, moment)
    return out


def _of_pairs(own: Array, after: Array, later: BoolArray, behind: Array, before: Array, earlier: BoolArray) -> Array:
    """(nf, n, k) own . after where `later`, behind . before where `earlier` only, else 0."""
    k = after.shape[1]
    out: Array = own @ after.transpose(0, 2, 1)
    out *= later[:, :k]
    out += (behind @ before.transpose(0, 2, 1)) * (earlier & ~later)[:, :k]
    return out


def _bodies(
    placed: inverse_dynamics.PlacedLinkage, inertial: Array, velocity: Array, acceleration: Array
) -> tuple[Array, Array]:
    """(n, nf, 12, 6) sums of I and B over each distinct set of segments, and (n, nf, 6) of f; V and A of all segments
    (nf, ns, 6).
    """
    places = [placed.chain.segments.index(s) for s in MASSIVE_SEGMENTS]
    body = table(inertial)
    mass = body[:, 0, None, None]
    axes, origin, v, a = (
        np.ascontiguousarray(x[:, places].swapaxes(0, 1)) for x in (*placed.segments, velocity, acceleration)
    )
    centre = origin + (body[:, None, None, 1:4] @ axes)[:, :, 0]
    shape = axes.swapaxes(2, 3) @ (body[:, None, 4:7, None] * axes)
    lever = inverse_dynamics.skew(centre)
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
    moves[..., :3, :3] = moves[..., 3:, 3:] = inverse_dynamics.skew(v[..., 3:])
    moves[..., :3, 3:] = inverse_dynamics.skew(v[..., :3])
    turned = inertia @ moves
    np.negative(turned + turned.swapaxes(2, 3), out=bias)
    push = inverse_dynamics.skew(momentum[..., :3])
    bias[..., :3, 3:] -= push
    bias[..., 3:, :3] -= push
    bias[..., 3:, 3:] -= inverse_dynamics.skew(momentum[..., 3:])
    sums, nf = placed.chain.moved_sets[:, places], len(velocity)
    return (
        (sums @ both.reshape(len(both), -1)).reshape(-1, nf, 12, 6),
        (sums @ force.reshape(len(force), -1)).reshape(-1, nf, 6),
    )


def on_force(m: Array, f: Array) -> Array:
    """(..., 6) m x* f of motions [v; w] and wrenches [F; M]."""
    out = np.empty(np.broadcast_shapes(m.shape, f.shape))
    out[..., :3] = cross(m[..., 3:], f[..., :3])
    out[..., 3:] = cross(m[..., 3:], f[..., 3:]) + cross(m[..., :3], f[..., :3])
    return out
