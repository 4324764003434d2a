"""Derivatives of the generalised forces and of the pelvis residual: by motion, joint and dynamic
parameters.

The joint parameters of interest are joints of the linkage, constant in time, so that
`pin.computeRNEADerivatives` gives all derivatives, by coordinates, rates, accelerations and joint
parameters, of the generalised forces without ground reactions. Ground reactions stay fixed in the
laboratory: for a variable j before i on the way to a foot the column J_i rotates and moves with j,

    d (J_i^T w) / d j = (J_j x J_i) . w,      [v_j; w_j] x [v_i; w_i] = [w_j x v_i + v_j x w_i; w_j x w_i],

and not otherwise. The pelvis residual rho = [F; T] (`inverse_dynamics.py`), which a fit to ground
reactions minimises, has  dT = A^-1 (d tau - dA T).
"""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from gaitcal.arrays import Array, IntArray, cross
from gaitcal.dynamics import inverse_dynamics
from gaitcal.model.parameters import Parameters


@dataclass(frozen=True, kw_only=True)
class ForceDerivatives:
    """Of n generalised forces: the 29 in the order of `FORCES`, or some of them, then those of held
    joint parameters.

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
    """Derivatives of `Dynamics.forces` at coordinates (nf, nq), their derivatives, and foot
    wrenches (nf, 2, 6).

    `held`: joint parameters whose own generalised forces follow (`Dynamics`). `of`: those of the 29
    that are wanted.
    """
    dynamics = inverse_dynamics.Dynamics(parameters, held, free)
    return differentiate_forces(dynamics, q, v, a, wrenches, (*of, *held))


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


def differentiate_forces(
    dynamics: inverse_dynamics.Dynamics,
    q: Array,
    v: Array,
    a: Array,
    wrenches: Array,
    of: tuple[str, ...],
) -> ForceDerivatives:
    """Differentiate the generalised forces named `of` by coordinates, their derivatives and
    `dynamics.free`.

    Parameters
    ----------
    q, v, a : (nf, 27) coordinates and their derivatives, m and rad.
    wrenches : (nf, 2, 6) ground on the feet, N and N·m about the laboratory origin.
    """
    states = dynamics.joint_states(q, v, a)
    rows = np.array([dynamics.body.index(name) for name in of])
    by_parameter = np.array([dynamics.body.index(name) for name in dynamics.free], dtype=np.intp)
    model, nf = dynamics.body.model, len(wrenches)
    columns = dynamics.body.chain.at_coordinates
    both = np.concatenate([columns, by_parameter])
    by_q = np.empty((nf, len(rows), len(both)))
    by_v, by_a = (np.empty((nf, len(rows), len(columns))) for _ in range(2))
    jacobians = np.empty((nf, model.nv, 6))
    of_both, of_columns = np.ix_(rows, both), np.ix_(rows, columns)
    # Pinocchio fills in the upper half of the mass matrix alone
    upper = np.minimum(*of_columns), np.maximum(*of_columns)
    with dynamics.body.chain.lend_work_space() as data:
        for k, (q_k, v_k, a_k) in enumerate(zip(*states, strict=True)):
            dq, dv, da = pin.computeRNEADerivatives(model, data, q_k, v_k, a_k)
            by_q[k], by_v[k], by_a[k] = dq[of_both], dv[of_columns], da[upper]
            jacobians[k] = data.J.T
    by_q += _by_moved_contacts(dynamics, rows, both, jacobians, wrenches)
    return ForceDerivatives(
        by_position=by_q[:, :, : len(columns)],
        by_velocity=by_v,
        by_acceleration=by_a,
        by_parameter=by_q[:, :, len(columns) :],
        free=dynamics.free,
    )


def _by_moved_contacts(
    dynamics: inverse_dynamics.Dynamics,
    rows: IntArray,
    by: IntArray,
    jacobians: Array,
    wrenches: Array,
) -> Array:
    """(nf, n, k) derivatives of -sum_feet J_i^T w, wrenches fixed in the laboratory, by joints j
    before i.
    """
    after = dynamics.body.chain.after
    pulls = np.zeros((len(wrenches), len(rows), 6))
    for foot, joint in enumerate(dynamics.feet):
        moving = np.flatnonzero(after[joint - 1, rows])
        force, moment = wrenches[:, None, foot, :3], wrenches[:, None, foot, 3:]
        v, w = jacobians[:, rows[moving], :3], jacobians[:, rows[moving], 3:]
        # F . (w_j x v_i) = w_j . (v_i x F), and so on
        pulls[:, moving, :3] -= cross(w, force)
        pulls[:, moving, 3:] -= cross(v, force) + cross(w, moment)
    before = after[rows][:, by] & (rows[:, None] != by)
    return np.asarray((pulls @ jacobians[:, by].transpose(0, 2, 1)) * before)
