"""Standard errors of torques, frame by frame.

Every marker coordinate c moves the joint parameters by d p_c and the motion by d N_c (`calibration/influence.py`), and
with them the generalised forces by

    d tau_c = (d tau/d q) B d N_c + (d tau/d v) B' d N_c + (d tau/d a) B'' d N_c + (d tau/d p) d p_c.

Squares sum over marker coordinates; the inertial parameters add the diagonal of (d tau/d IP) cov (d tau/d IP)^T.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from gaitcal.calibration.inertial_calibration import InertialFit
from gaitcal.calibration.influence import Influence, basis_matrix
from gaitcal.calibration.marker_moves import BLOCK, MarkerMoves, marker_moves
from gaitcal.dynamics.derivatives import ForceDerivatives, force_derivatives
from gaitcal.dynamics.inverse_dynamics import Dynamics
from gaitcal.model.inertial_parameters import MASSIVE_SEGMENTS, dynamic_jacobian, placed_dynamic_parameters
from gaitcal.model.linkage import COORDINATES, REACTIONS
from gaitcal.model.parameters import Parameters
from gaitcal.motion.spline import ORDER
from gaitcal.motion.trial_problem import TrialProblem

Array = NDArray[np.float64]


def torque_standard_errors(
    problem: TrialProblem,
    nodes: Array,
    parameters: Parameters,
    wrenches: Array,
    joint: Influence | None,
    inertial: Array | None,
    moves: MarkerMoves | None = None,
) -> Array:
    """(nf, 29) standard errors of the 27 generalised forces and the two knee reactions of one whole-body trial.

    Parameters
    ----------
    problem, nodes : the whole-body trial and its motion.
    wrenches : (nf, 2, 6) ground reactions on the feet, taken as exact.
    joint : influence on the joint parameters; None where they were not calibrated.
    inertial : (84, n) R with covariance R R^T of the inertial parameters; None where they were not calibrated.
    moves : what the markers move, where it is known already.
    """
    basis = problem.basis
    q, v, a = (basis.evaluate(nodes, k) for k in range(3))
    free = joint.free if joint else ()
    moves = moves or marker_moves(problem, nodes, parameters, joint)
    variance = np.empty((len(q), len(COORDINATES) + len(REACTIONS)))
    for start in range(0, len(q), BLOCK):
        part = slice(start, min(start + BLOCK, len(q)))
        slopes = force_derivatives(parameters, free, q[part], v[part], a[part], wrenches[part])
        variance[part] = (_marker_part(problem, part, moves, slopes) ** 2).sum(axis=2)
        if inertial is not None:
            variance[part] += _inertial_variance(parameters, inertial, q[part], v[part], a[part])
    out: Array = np.sqrt(variance)
    return out


def _marker_part(problem: TrialProblem, part: slice, moves: MarkerMoves, slopes: ForceDerivatives) -> Array:
    """(frames of the part, 29, nc) d tau_c."""
    basis, nq = problem.basis, len(problem.chain.coordinates)
    near = slice(int(basis.first[part.start]), int(basis.first[part.stop - 1]) + ORDER)
    by_node = moves.change(slice(near.start * nq, near.stop * nq)).reshape(near.stop - near.start, -1)
    out: Array = slopes.by_parameter @ moves.shift
    for k, slope in enumerate((slopes.by_position, slopes.by_velocity, slopes.by_acceleration)):
        weights = basis_matrix(basis, k)[part, near]
        out += slope @ (weights @ by_node).reshape(part.stop - part.start, nq, -1)
    return out


def _inertial_variance(parameters: Parameters, spread: Array, q: Array, v: Array, a: Array) -> Array:
    """(nf, 29) variance from the inertial parameters."""
    dynamics = Dynamics(parameters)
    model, data = dynamics.linkage.model, dynamics.linkage.model.createData()
    rows = np.array([dynamics.linkage.index(name) for name in (*COORDINATES, *REACTIONS)])
    into = np.zeros((10 * (model.njoints - 1), 84))
    slopes = dynamic_jacobian(parameters.inertial)
    for k, segment in enumerate(MASSIVE_SEGMENTS):
        at = 10 * (dynamics.linkage.segment_joint[segment] - 1)
        place = dynamics.linkage.segment_placement[segment]
        moved = placed_dynamic_parameters(place.rotation, place.translation)
        into[at : at + 10, 7 * k : 7 * k + 7] = moved @ slopes[k]
    moved_by = into @ spread
    out = np.empty((len(q), len(rows)))
    q, v, a = (dynamics.expand(values) for values in (q, v, a))
    for f in range(len(q)):
        regressor = pin.computeJointTorqueRegressor(model, data, q[f], v[f], a[f])
        out[f] = ((regressor[rows] @ moved_by) ** 2).sum(axis=1)
    return out


def inertial_square_root(fit: InertialFit) -> Array:
    """(84, n) R with covariance R R^T of the inertial parameters."""
    values, vectors = np.linalg.eigh(fit.residual_jacobian.T @ fit.residual_jacobian)
    kept = values > 1e-12 * values[-1]
    out: Array = fit.jacobian @ (vectors[:, kept] / np.sqrt(values[kept]))
    return out
