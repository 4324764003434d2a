"""Derivatives of the generalised forces and of the pelvis residual.

They are taken by coordinates, rates, accelerations, joint parameters and dynamic parameters. Free
joint parameters are joints of the linkage that are constant in time, so that
`pin.computeRNEADerivatives` gives all derivatives of the generalised forces without ground
reactions. Ground reactions stay fixed in the laboratory. For a variable j before i on the path to a
foot, the column J_i rotates and moves with j,

    d (J_i^T w) / d j = (J_j x J_i) . w,
    [v_j; w_j] x [v_i; w_i] = [w_j x v_i + v_j x w_i; w_j x w_i],

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
    """Derivatives of n generalised forces: those of `FORCES` or some, then of held joint
    parameters.

    Units: N·m or N per m, rad, and their rates.
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


def compute_force_derivatives(
    parameters: Parameters,
    free: tuple[str, ...],
    q: Array,
    v: Array,
    a: Array,
    wrenches: Array,
    held: tuple[str, ...] = (),
    names: tuple[str, ...] = inverse_dynamics.FORCES,
) -> ForceDerivatives:
    """Compute the derivatives of `Dynamics.compute_forces`.

    Parameters
    ----------
    parameters
        Joint and inertial parameters.
    free
        Joint parameters to differentiate by.
    q, v, a
        (nf, 27) coordinates and their derivatives, m and rad.
    wrenches
        (nf, 2, 6) ground on the feet, N and N·m about the laboratory origin.
    held
        Joint parameters whose generalised forces are differentiated too (`Dynamics`).
    names
        Those of the 29 generalised forces that are needed.

    Returns
    -------
    ForceDerivatives
    """
    dynamics = inverse_dynamics.Dynamics(parameters, held, free)
    return differentiate_forces(dynamics, q, v, a, wrenches, (*names, *held))


def compute_root_residual(
    parameters: Parameters, free: tuple[str, ...], q: Array, v: Array, a: Array, wrenches: Array
) -> RootResidual:
    """Compute the pelvis residual and its derivatives.

    Parameters
    ----------
    parameters
        Joint and inertial parameters.
    free
        Joint parameters to differentiate by.
    q, v, a
        (nf, 27) coordinates and their derivatives, m and rad.
    wrenches
        (nf, 2, 6) ground on the feet, N and N·m about the laboratory origin.

    Returns
    -------
    RootResidual
    """
    dynamics = inverse_dynamics.Dynamics(parameters)
    value = inverse_dynamics.compute_pelvis_residual(q, dynamics.compute_forces(q, v, a, wrenches))
    derivatives = compute_force_derivatives(
        parameters, free, q, v, a, wrenches, names=inverse_dynamics.FORCES[:6]
    )
    # The axes A depend on tilt and list: A dT = d tau - dA T.
    _, by_tilt, by_list = inverse_dynamics.compute_pelvis_axes(q)
    by_position = derivatives.by_position.copy()
    for k, axes_by_angle in ((3, by_tilt), (4, by_list)):
        by_position[:, 3:, k] -= np.einsum("fij,fj->fi", axes_by_angle, value[:, 3:])
    return RootResidual(
        value=value,
        by_position=inverse_dynamics.compute_root_wrench(q, by_position),
        by_velocity=inverse_dynamics.compute_root_wrench(q, derivatives.by_velocity),
        by_acceleration=inverse_dynamics.compute_root_wrench(q, derivatives.by_acceleration),
        by_parameter=inverse_dynamics.compute_root_wrench(q, derivatives.by_parameter),
        free=derivatives.free,
        regressor=dynamics.compute_root_regressor(q, v, a).reshape(len(q), 6, -1),
    )


def differentiate_forces(
    dynamics: inverse_dynamics.Dynamics,
    q: Array,
    v: Array,
    a: Array,
    wrenches: Array,
    names: tuple[str, ...],
) -> ForceDerivatives:
    """Differentiate generalised forces by coordinates, their derivatives and `dynamics.free`.

    Parameters
    ----------
    dynamics
        Linkage of one set of parameters.
    q, v, a
        (nf, 27) coordinates and their derivatives, m and rad.
    wrenches
        (nf, 2, 6) ground on the feet, N and N·m about the laboratory origin.
    names
        Generalised forces to differentiate.

    Returns
    -------
    ForceDerivatives
    """
    states = dynamics.build_joint_states(q, v, a)
    rows = np.array([dynamics.body.index(name) for name in names])
    by_parameter = np.array([dynamics.body.index(name) for name in dynamics.free], dtype=np.intp)
    model, nf = dynamics.body.model, len(wrenches)
    columns = dynamics.body.chain.at_coordinates
    both = np.concatenate([columns, by_parameter])
    by_q = np.empty((nf, len(rows), len(both)))
    by_v, by_a = (np.empty((nf, len(rows), len(columns))) for _ in range(2))
    jacobians = np.empty((nf, model.nv, 6))
    entries_q, entries_v = np.ix_(rows, both), np.ix_(rows, columns)
    # Pinocchio fills the upper half of the mass matrix only.
    upper = np.minimum(*entries_v), np.maximum(*entries_v)
    with dynamics.body.chain.lend_work_space() as data:
        for k, (q_k, v_k, a_k) in enumerate(zip(*states, strict=True)):
            dq, dv, da = pin.computeRNEADerivatives(model, data, q_k, v_k, a_k)
            by_q[k], by_v[k], by_a[k] = dq[entries_q], dv[entries_v], da[upper]
            jacobians[k] = data.J.T
    by_q += _differentiate_moved_contacts(dynamics, rows, both, jacobians, wrenches)
    return ForceDerivatives(
        by_position=by_q[:, :, : len(columns)],
        by_velocity=by_v,
        by_acceleration=by_a,
        by_parameter=by_q[:, :, len(columns) :],
        free=dynamics.free,
    )


def _differentiate_moved_contacts(
    dynamics: inverse_dynamics.Dynamics,
    rows: IntArray,
    by: IntArray,
    jacobians: Array,
    wrenches: Array,
) -> Array:
    """Differentiate -sum_feet J_i^T w by joints j before i: (nf, n, k).

    Wrenches are fixed in the laboratory.
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
