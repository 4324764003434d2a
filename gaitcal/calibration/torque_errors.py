"""Standard errors of torques, frame by frame.

Every marker coordinate c moves the joint parameters by d p_c and the motion by d N_c (`calibration/influence.py`), and
with them the generalised forces by

    d tau_c = (d tau/d q) B d N_c + (d tau/d v) B' d N_c + (d tau/d a) B'' d N_c + (d tau/d p) d p_c.

Squares sum over marker coordinates; the inertial parameters add the diagonal of (d tau/d IP) cov (d tau/d IP)^T.

What every marker coordinate moves: joint parameters by d p_c, and the motion of one trial by d N_c.

From `calibration/influence.py`. The coordinates themselves then move by B d N_c, frame by frame; squares sum over
marker coordinates to the variance that skin movement leaves in them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array
from gaitcal.calibration.inertial_calibration import InertialFit
from gaitcal.calibration.influence import Influence, trial_scores
from gaitcal.dynamics.derivatives import ForceDerivatives, force_derivatives
from gaitcal.dynamics.inverse_dynamics import Dynamics
from gaitcal.model.inertial_parameters import dynamic_jacobian
from gaitcal.model.linkage import COORDINATES, REACTIONS
from gaitcal.model.parameters import Parameters
from gaitcal.motion.spline import ORDER, basis_matrix
from gaitcal.motion.trial_problem import TrialProblem


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
    # only the nodes whose splines reach these frames: (their nodes, nq, nc)
    near = slice(int(basis.first[part.start]), int(basis.first[part.stop - 1]) + ORDER)
    by_node = moves.change(slice(near.start * nq, near.stop * nq)).reshape(near.stop - near.start, -1)
    out: Array = slopes.by_parameter @ moves.shift[: len(slopes.free)]
    for k, slope in enumerate((slopes.by_position, slopes.by_velocity, slopes.by_acceleration)):
        weights = basis_matrix(basis, k)[part, near]
        out += slope @ (weights @ by_node).reshape(part.stop - part.start, nq, -1)
    return out


def _inertial_variance(parameters: Parameters, spread: Array, q: Array, v: Array, a: Array) -> Array:
    """(nf, 29) variance from the inertial parameters."""
    slopes, sources = dynamic_jacobian(parameters.inertial), spread.shape[1]
    by_source = slopes @ spread.reshape(len(slopes), 7, sources)  # (12, 10, n) change of the dynamic parameters
    regressor = Dynamics(parameters).regressor(q, v, a).reshape(len(q), -1, 10 * len(slopes))
    out: Array = ((regressor @ by_source.reshape(-1, sources)) ** 2).sum(axis=2)
    return out


def inertial_square_root(fit: InertialFit) -> Array:
    """(84, n) R with covariance R R^T of the inertial parameters."""
    values, vectors = np.linalg.eigh(fit.residual_jacobian.T @ fit.residual_jacobian)
    kept = values > 1e-12 * values[-1]
    out: Array = fit.jacobian @ (vectors[:, kept] / np.sqrt(values[kept]))
    return out


BLOCK = 500
"""Frames at a time, whose changes by the marker coordinates of all trials are held at once."""


@dataclass(frozen=True)
class MarkerMoves:
    """What every marker coordinate moves; this trial's own come first, then those of other trials."""

    shift: Array
    """(np, nc) d p_c of the free joint parameters, then of the skin; all other sources of error are np columns with the
    same covariance."""
    nodes: Array
    """(nn * nq, own) of d N_c: what the own coordinates do by themselves."""
    sensitivity: Array
    """(nn * nq, np) - d N / d p."""

    def change(self, rows: slice) -> Array:
        """(rows, nc) d N_c of some rows of the nodes."""
        out = -self.sensitivity[rows] @ self.shift
        out[:, : self.nodes.shape[1]] += self.nodes[rows]
        return np.asarray(out, dtype=np.float64)


def marker_moves(problem: TrialProblem, nodes: Array, parameters: Parameters, joint: Influence | None) -> MarkerMoves:
    """Moves of one whole-body trial; `joint` is None where no joint parameters were calibrated."""
    opened = problem.with_free(joint.free if joint else ())
    scores = trial_scores(opened, parameters, nodes)
    shift = np.zeros((scores.sensitivity.shape[1], len(scores.clusters)))
    if joint is not None:
        errors = joint.parameters[[joint.free.index(name) for name in opened.unknowns]]
        place = {name: k for k, name in enumerate(scores.clusters)}
        own = np.array([name in place for name in joint.clusters], dtype=bool)
        shift[:, [place[name] for name in joint.clusters if name in place]] = errors[:, own]
        others = np.asarray(np.linalg.qr(errors[:, ~own].T, mode="r"))
        shift = np.hstack([shift, others.T])
    return MarkerMoves(shift, -scores.nodes, scores.sensitivity)


def coordinate_standard_errors(problem: TrialProblem, moves: MarkerMoves) -> Array:
    """(nf, nq) m, rad: standard errors of the coordinates of one whole-body trial."""
    basis, nq = problem.basis, len(problem.chain.coordinates)
    out = np.empty((len(basis.time), nq))
    weights = basis_matrix(basis, 0)
    for start in range(0, len(out), BLOCK):
        part = slice(start, min(start + BLOCK, len(out)))
        near = slice(int(basis.first[part.start]), int(basis.first[part.stop - 1]) + ORDER)
        by_node = moves.change(slice(near.start * nq, near.stop * nq)).reshape(near.stop - near.start, -1)
        change = (weights[part, near] @ by_node).reshape(part.stop - part.start, nq, -1)
        out[part] = np.sqrt((change**2).sum(axis=2))
    return out
