"""Derivatives of the generalised forces and of the pelvis residual: by motion, joint and dynamic parameters.

Those of `rnea_slopes.py` on the linkage in which the joint parameters of interest are joints, constant in time. Ground
reactions stay fixed in the laboratory: for a variable j before i on the way to a foot the column J_i turns and moves
with j,

    d (J_i^T w) / d j = (J_j x J_i) . w,      [v_j; w_j] x [v_i; w_i] = [w_j x v_i + v_j x w_i; w_j x w_i],

and not otherwise. The pelvis residual rho = [F; T] (`inverse_dynamics.py`), which a fit to ground reactions minimises,
has  dT = A^-1 (d tau - dA T).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array, BoolArray, IntArray, cross
from gaitcal.dynamics.inverse_dynamics import FEET, FORCES, Dynamics, pelvis_axes, pelvis_residual, root_wrench
from gaitcal.dynamics.joint_moments import ORDER
from gaitcal.dynamics.rnea_slopes import StretchState, rnea_slopes
from gaitcal.model.chain import Chain, ChainConstants, chain_of
from gaitcal.model.kinematics import forward, jacobian, segment_poses
from gaitcal.model.linkage import COORDINATES
from gaitcal.model.parameters import Parameters

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
