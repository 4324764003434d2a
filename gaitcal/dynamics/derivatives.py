"""Derivatives of the generalised forces by coordinates, velocities, accelerations and joint parameters.

Pinocchio's `computeRNEADerivatives` on the linkage in which the joint parameters of interest are joints, constant in
time; ground reactions stay fixed in the laboratory, so that for a variable j before i on the way to a foot

    d (J_i^T w) / d j = (J_j x J_i) . w,      [v_j; w_j] x [v_i; w_i] = [w_j x v_i + v_j x w_i; w_j x w_i],

and nothing otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from gaitcal.dynamics.inverse_dynamics import FEET
from gaitcal.model.build import build_linkage
from gaitcal.model.chain import Chain
from gaitcal.model.joint_parameters import JP_INDEX
from gaitcal.model.kinematics import forward, jacobian
from gaitcal.model.linkage import COORDINATES, REACTIONS
from gaitcal.model.parameters import Parameters

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ForceDerivatives:
    """Rows: the 27 coordinates, then the two knee reactions. N·m or N per m, rad, and their rates."""

    by_position: Array
    """(nf, 29, 27)."""
    by_velocity: Array
    """(nf, 29, 27)."""
    by_acceleration: Array
    """(nf, 29, 27)."""
    by_parameter: Array
    """(nf, 29, np), in the order of `free`."""
    free: tuple[str, ...]


def force_derivatives(
    parameters: Parameters, free: tuple[str, ...], q: Array, v: Array, a: Array, wrenches: Array
) -> ForceDerivatives:
    """Derivatives of `Dynamics.forces` at coordinates (nf, 27), their derivatives, and foot wrenches (nf, 2, 6)."""
    linkage = build_linkage(parameters, free, reactions=True)
    chain = Chain(free=free, reactions=True)
    free = chain.free
    rows = np.array([linkage.index(name) for name in (*COORDINATES, *REACTIONS)])
    moving = rows[: len(COORDINATES)]
    fixed = np.array([linkage.index(name) for name in free], dtype=np.intp)
    nv, nf = linkage.model.nv, len(q)
    state = np.zeros((3, nf, nv))
    for k, values in enumerate((q, v, a)):
        state[k][:, moving] = values
    state[0][:, fixed] = parameters.joint[[JP_INDEX[name] for name in free]]
    model, data = linkage.model, linkage.model.createData()
    by_q, by_v, by_a = np.empty((nf, 29, 27)), np.empty((nf, 29, 27)), np.empty((nf, 29, 27))
    by_p = np.empty((nf, 29, len(free)))
    for f in range(nf):
        dq, dv, da = pin.computeRNEADerivatives(model, data, state[0, f], state[1, f], state[2, f])
        full = np.triu(da) + np.triu(da, 1).T
        by_q[f], by_p[f] = dq[np.ix_(rows, moving)], dq[np.ix_(rows, fixed)]
        by_v[f], by_a[f] = dv[np.ix_(rows, moving)], full[np.ix_(rows, moving)]
    contact = _contact_derivatives(chain, linkage.coordinates, parameters, q, wrenches)
    by_q -= contact[:, :, :27]
    by_p -= contact[:, :, 27:]
    return ForceDerivatives(by_q, by_v, by_a, by_p, free)


def _contact_derivatives(
    chain: Chain, order: tuple[str, ...], parameters: Parameters, q: Array, wrenches: Array
) -> Array:
    """(nf, 29, 27 + np) derivative of sum_feet J^T w by coordinates and free joint parameters."""
    names = (*chain.coordinates, *chain.free)
    rank = np.array([order.index(name) for name in names])
    expanded = np.zeros((len(q), len(chain.coordinates)))
    expanded[:, [chain.coordinates.index(name) for name in COORDINATES]] = q
    constants = chain.constants(parameters.joint, parameters.zero_angles)
    columns = jacobian(chain, constants, forward(chain, constants, expanded)).transpose(2, 0, 1)
    out = np.zeros((len(q), len(names), len(names)))
    for foot, segment in enumerate(FEET):
        moved = np.flatnonzero(chain.support[:, chain.segments.index(segment)])
        before = rank[moved][None, :] < rank[moved][:, None]
        force, moment = wrenches[:, foot, :3], wrenches[:, foot, 3:]
        v, w = columns[:, moved, :3], columns[:, moved, 3:]
        # F . (w_j x v_i) = w_j . (v_i x F), and so on
        by_turn = np.cross(v, force[:, None]) + np.cross(w, moment[:, None])
        product = by_turn @ w.transpose(0, 2, 1) + np.cross(w, force[:, None]) @ v.transpose(0, 2, 1)
        out[np.ix_(np.arange(len(q)), moved, moved)] += product * before
    where = {name: k for k, name in enumerate(names)}
    rows = np.array([where[name] for name in (*COORDINATES, *REACTIONS)])
    by = np.array([where[name] for name in (*COORDINATES, *chain.free)])
    chosen: Array = out[np.ix_(np.arange(len(q)), rows, by)]
    return chosen
