"""Derivatives of the generalised forces and of the pelvis residual: by motion, joint and dynamic parameters.

Pinocchio's `computeRNEADerivatives` on the linkage in which the joint parameters of interest are joints, constant in
time. Ground reactions stay fixed in the laboratory: for a variable j before i on the way to a foot the column J_i turns
and moves with j,

    d (J_i^T w) / d j = (J_j x J_i) . w,      [v_j; w_j] x [v_i; w_i] = [w_j x v_i + v_j x w_i; w_j x w_i],

and not otherwise. The pelvis residual rho = [F; T] (`inverse_dynamics.py`), which a fit to ground reactions minimises,
has  dT = A^-1 (d tau - dA T).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from gaitcal.arrays import Array, cross
from gaitcal.dynamics.inverse_dynamics import FEET, FORCES, Dynamics, pelvis_axes, pelvis_residual, root_wrench
from gaitcal.model.build import build_linkage
from gaitcal.model.chain import Chain
from gaitcal.model.joint_parameters import JP_INDEX
from gaitcal.model.kinematics import forward, jacobian
from gaitcal.model.linkage import COORDINATES
from gaitcal.model.parameters import Parameters


@dataclass(frozen=True, kw_only=True)
class ForceDerivatives:
    """Of the 29 generalised forces, in the order of `FORCES`, then of joint parameters that are held. N·m or N per m,
    rad, and their rates.
    """

    by_position: Array
    """(nf, 29, 27)."""
    by_velocity: Array
    """(nf, 29, 27)."""
    by_acceleration: Array
    """(nf, 29, 27)."""
    by_parameter: Array
    """(nf, 29, np), in the order of `free`."""
    free: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class RootResidual:
    """Residual wrench at the pelvis and its derivatives, frame by frame; N and N·m."""

    value: Array
    """(nf, 6)."""
    by_position: Array
    """(nf, 6, 27)."""
    by_velocity: Array
    """(nf, 6, 27)."""
    by_acceleration: Array
    """(nf, 6, 27)."""
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
) -> ForceDerivatives:
    """Derivatives of `Dynamics.forces` at coordinates (nf, 27), their derivatives, and foot wrenches (nf, 2, 6).

    `held`: joint parameters whose own generalised forces follow the 29 (`Dynamics`).
    """
    opened = (*free, *(name for name in held if name not in free))
    linkage = build_linkage(parameters, opened, reactions=True)
    chain = Chain(free=opened, reactions=True)
    free = tuple(name for name in chain.free if name in free)
    names = (*FORCES, *held)
    rows = np.array([linkage.index(name) for name in names])
    moving = rows[: len(COORDINATES)]
    fixed = np.array([linkage.index(name) for name in free], dtype=np.intp)
    constant = [linkage.index(name) for name in chain.free]
    nv, nf = linkage.model.nv, len(q)
    state = np.zeros((3, nf, nv))
    for k, values in enumerate((q, v, a)):
        state[k][:, moving] = values
    state[0][:, constant] = parameters.joint[[JP_INDEX[name] for name in chain.free]]
    model, data = linkage.model, linkage.model.createData()
    by_q, by_v, by_a = (np.empty((nf, len(rows), len(COORDINATES))) for _ in range(3))
    by_p = np.empty((nf, len(rows), len(free)))
    places, held_places = np.ix_(rows, moving), np.ix_(rows, fixed)
    upper = np.minimum(*places), np.maximum(*places)  # Pinocchio fills the upper half of the mass matrix alone
    for f in range(nf):
        dq, dv, da = pin.computeRNEADerivatives(model, data, state[0, f], state[1, f], state[2, f])
        by_q[f], by_p[f] = dq[places], dq[held_places]
        by_v[f], by_a[f] = dv[places], da[upper]
    contact = _contact_derivatives(chain, linkage.coordinates, parameters, q, wrenches, names, free)
    by_q -= contact[:, :, :27]
    by_p -= contact[:, :, 27:]
    return ForceDerivatives(by_position=by_q, by_velocity=by_v, by_acceleration=by_a, by_parameter=by_p, free=free)


def _contact_derivatives(
    chain: Chain,
    order: tuple[str, ...],
    parameters: Parameters,
    q: Array,
    wrenches: Array,
    forces: tuple[str, ...],
    free: tuple[str, ...],
) -> Array:
    """(nf, 29, 27 + np) derivative of sum_feet J^T w, of some forces, by coordinates and `free` joint parameters."""
    names = (*chain.coordinates, *chain.free)
    place = {name: k for k, name in enumerate(names)}
    rank = np.array([order.index(name) for name in names])  # along the linkage: who comes before whom
    with_reactions = np.zeros((len(q), len(chain.coordinates)))
    with_reactions[:, [place[name] for name in COORDINATES]] = q
    constants = chain.constants(parameters.joint, parameters.zero_angles)
    columns = jacobian(chain, constants, forward(chain, constants, with_reactions)).transpose(2, 0, 1)
    out = np.zeros((len(q), len(names), len(names)))
    for foot, segment in enumerate(FEET):
        moved = np.flatnonzero(chain.support[:, chain.segments.index(segment)])
        before = rank[moved][None, :] < rank[moved][:, None]
        force, moment = wrenches[:, foot, :3], wrenches[:, foot, 3:]
        v, w = columns[:, moved, :3], columns[:, moved, 3:]
        # F . (w_j x v_i) = w_j . (v_i x F), and so on
        by_turn = cross(v, force[:, None]) + cross(w, moment[:, None])
        product = by_turn @ w.transpose(0, 2, 1) + cross(w, force[:, None]) @ v.transpose(0, 2, 1)
        out[np.ix_(np.arange(len(q)), moved, moved)] += product * before
    rows = np.array([place[name] for name in forces])
    by = np.array([place[name] for name in (*COORDINATES, *free)])
    chosen: Array = out[np.ix_(np.arange(len(q)), rows, by)]
    return chosen


def root_residual(
    parameters: Parameters, free: tuple[str, ...], q: Array, v: Array, a: Array, wrenches: Array
) -> RootResidual:
    """Pelvis residual at coordinates (nf, 27), their derivatives, and foot wrenches (nf, 2, 6)."""
    dynamics = Dynamics(parameters)
    value = pelvis_residual(q, dynamics.forces(q, v, a, wrenches))
    slopes = force_derivatives(parameters, free, q, v, a, wrenches)
    _, by_tilt, by_list = pelvis_axes(q)
    by_position = slopes.by_position[:, :6].copy()
    for k, turned in ((3, by_tilt), (4, by_list)):
        by_position[:, 3:, k] -= np.einsum("fij,fj->fi", turned, value[:, 3:])
    return RootResidual(
        value=value,
        by_position=root_wrench(q, by_position),
        by_velocity=root_wrench(q, slopes.by_velocity[:, :6]),
        by_acceleration=root_wrench(q, slopes.by_acceleration[:, :6]),
        by_parameter=root_wrench(q, slopes.by_parameter[:, :6]),
        free=slopes.free,
        regressor=dynamics.root_regressor(q, v, a).reshape(len(q), 6, 120),
    )
