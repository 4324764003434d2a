"""Standard errors of torques, frame by frame and source by source.

Every source of error c, a marker coordinate or one of those of the joint parameters (`marker_moves.py`), moves
the joint parameters by d p_c and the motion by d N_c = n_c - S d p_c, with n_c what a coordinate of the trial's own
markers does to its nodes while joints are known, and S = -d N/d p. The generalised forces follow by

    d tau_c = T n_c + G d p_c,      T = (d tau/d q) B + (d tau/d v) B' + (d tau/d a) B'',    G = d tau/d p - T S.

Squares sum over the coordinates and columns of each source; the inertial parameters add the diagonal of
(d tau/d IP) cov (d tau/d IP)^T, force plates and segments' axes the squares of `dynamics/plate_errors.py` and
`dynamics/axis_errors.py`. Powers and moment vectors are linear in the generalised forces
(`dynamics/joint_kinetics.py`): what a source does to these, to posture, rates and joint parameters moves them together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gaitcal.arrays import Array, stretches
from gaitcal.calibration.error_sources import ErrorSources, MotionSensitivity, marker_moves, squares
from gaitcal.calibration.inertial_calibration import InertialFit
from gaitcal.dynamics.axis_errors import AxisErrors, ErrorSource, TorqueErrors
from gaitcal.dynamics.derivatives import force_derivatives
from gaitcal.dynamics.inverse_dynamics import FORCES, Dynamics
from gaitcal.dynamics.joint_kinetics import kinetic_errors, kinetic_slopes
from gaitcal.dynamics.joint_moments import HELD
from gaitcal.dynamics.plate_errors import PlateErrors, wrench_errors, wrench_rates
from gaitcal.model.linkage import COORDINATES
from gaitcal.model.parameters import Parameters, dynamic_jacobian
from gaitcal.motion.trial_problem import TrialProblem

BLOCK = 64
"""Frames at a time at most, whose changes by the marker coordinates of all trials are held at once."""


def torque_standard_errors(
    problem: TrialProblem,
    nodes: Array,
    parameters: Parameters,
    wrenches: Array,
    joint: ErrorSources | None,
    inertial: Array | None,
    moves: MotionSensitivity | None = None,
    plates: PlateErrors | None = None,
    axes: AxisErrors | None = None,
) -> TorqueErrors:
    """Standard errors of the 27 generalised forces and the two knee reactions of one whole-body trial, by source; and
    of the powers and moment vectors that follow.

    Parameters
    ----------
    problem, nodes : the whole-body trial and its motion.
    wrenches : (nf, 2, 6) ground reactions on the feet.
    joint : influence on the joint parameters; None where they were not calibrated.
    inertial : (84, n) R with covariance R R^T of the inertial parameters; None where they were not calibrated.
    moves : what the markers move, where it is known already.
    plates : how far the ground reactions are to be believed; exact unless given.
    axes : how far the directions of segments' axes are, with these parameters; exact unless given.
    """
    erring = ErringForces(
        problem=problem,
        nodes=nodes,
        parameters=parameters,
        wrenches=wrenches,
        free=joint.free if joint else (),
        moves=moves or marker_moves(problem, nodes, parameters, joint),
        inertial=inertial,
        plates=plates,
        axes=axes,
    )
    return joined([erring.variances(part) for part in erring.parts])


@dataclass(frozen=True, kw_only=True)
class ErringForces:
    """The generalised forces of one whole-body trial, and all that may be wrong with them.

    What `torque_standard_errors` says in one piece, said of some frames at a time.
    """

    problem: TrialProblem
    nodes: Array
    """(nn, 27) m, rad."""
    parameters: Parameters
    wrenches: Array
    """(nf, 2, 6) N, N·m."""
    free: tuple[str, ...]
    """The joint parameters that are not exact."""
    moves: MotionSensitivity
    inertial: Array | None = None
    """(84, n); None: exact, as are the following."""
    plates: PlateErrors | None = None
    axes: AxisErrors | None = None

    @property
    def parts(self) -> list[slice]:
        """All frames, some at a time."""
        return stretches(len(self.wrenches), BLOCK)

    @cached_property
    def _dynamics(self) -> Dynamics:
        return Dynamics(self.parameters, HELD)

    @cached_property
    def _rates(self) -> Array:
        return wrench_rates(self.problem.basis.time, self.wrenches)

    @cached_property
    def _state(self) -> tuple[Array, Array, Array]:
        q, v, a = (self.problem.basis.evaluate(self.nodes, k) for k in range(3))
        return q, v, a

    def variances(self, part: slice) -> Variances:
        """Of some frames."""
        dynamics, wrenches = self._dynamics, self.wrenches[part]
        q, v, a = (x[part] for x in self._state)
        slopes = force_derivatives(self.parameters, self.free, q, v, a, wrenches, HELD)
        told = kinetic_slopes(self.parameters, q, v, dynamics.forces(q, v, a, wrenches), self.free)
        through = told.by_force
        by_state = np.concatenate(
            [
                through @ slopes.by_position + told.by_position,
                through @ slopes.by_velocity + told.by_velocity,
                through @ slopes.by_acceleration,
            ],
            axis=2,
        )
        by_parameter = through @ slopes.by_parameter + told.by_parameter
        found = self._of_markers(part, by_state, by_parameter)
        if self.inertial is not None:
            heavier = _inertial_moves(dynamics, self.parameters, self.inertial, q, v, a)
            found.add(ErrorSource.INERTIA, squares(through @ heavier))
        if self.plates is not None and self.plates.any:
            wrong = dynamics.of_ground(q, wrench_errors(wrenches, self._rates[part], self.plates))
            found.add(ErrorSource.PLATES, squares(through @ wrong))
        if self.axes is not None and self.axes.columns:
            moving = _rate_moves(self.problem, self.axes, self._state[0], part)
            turns = self.axes.segment_turns(q)
            found.add(ErrorSource.FRAMES, squares(told.moved(self.axes.torque_moves(q, v, a, wrenches), moving, turns)))
        return found

    def _of_markers(self, part: slice, by_state: Array, by_parameter: Array) -> Variances:
        """What errors of the joint parameters and of the motion make."""
        moves = self.moves
        every = by_state @ moves.states(self.problem.basis, part, len(COORDINATES))
        count = moves.nodes.shape[1]
        every[:, :, count : count + by_parameter.shape[2]] += by_parameter
        torques, kinetics = (moves.variances(every[:, rows]) for rows in (slice(len(FORCES)), slice(len(FORCES), None)))
        return Variances(torques, np.asarray(sum(kinetics.values())), kinetics[ErrorSource.MOTION])


@dataclass
class Variances:
    """Of the forces of some frames, then of the powers and moments that follow (`kinetic_slopes`)."""

    torques: dict[ErrorSource, Array]
    """(frames, 29) by source."""
    kinetics: Array
    """(frames, 91) of all sources together."""
    own: Array
    """(frames, 91) of the trial's own markers."""

    def add(self, source: ErrorSource, variance: Array) -> None:
        """Count a further source, (frames, 120)."""
        self.torques[source] = variance[:, : len(FORCES)]
        self.kinetics += variance[:, len(FORCES) :]


def joined(parts: Sequence[Variances]) -> TorqueErrors:
    """The errors of a trial from the variances of all its frames, part after part."""
    torques = {source: np.concatenate([part.torques[source] for part in parts]) for source in parts[0].torques}
    kinetics, own = (np.concatenate([getattr(part, name) for part in parts]) for name in ("kinetics", "own"))
    return TorqueErrors.of(torques, kinetic_errors(kinetics, own))


def _inertial_moves(dynamics: Dynamics, parameters: Parameters, spread: Array, q: Array, v: Array, a: Array) -> Array:
    """(nf, 35, n) what the columns of the spread (84, n) of the inertial parameters make of the generalised forces."""
    slopes, sources = dynamic_jacobian(parameters.inertial), spread.shape[1]
    by_source = slopes @ spread.reshape(len(slopes), 7, sources)  # (12, 10, n) change of the dynamic parameters
    regressor = dynamics.regressor(q, v, a).reshape(len(q), -1, 10 * len(slopes))
    out: Array = regressor @ by_source.reshape(-1, sources)
    return out


def _rate_moves(problem: TrialProblem, axes: AxisErrors, q: Array, part: slice) -> Array:
    """(frames, 27, k) what errors of the segments' axes make of rates; none of what no marker moves with."""
    wide = slice(max(part.start - 1, 0), part.stop + 1)
    moves = axes.rate_moves(q[wide], problem.basis.time[wide])[part.start - wide.start :][: part.stop - part.start]
    out: Array = np.where(problem.active[:, None], moves, 0.0)
    return out


def inertial_square_root(fit: InertialFit) -> Array:
    """(84, n) R with covariance R R^T of the inertial parameters."""
    values, vectors = np.linalg.eigh(fit.residual_jacobian.T @ fit.residual_jacobian)
    kept = values > 1e-12 * values[-1]
    out: Array = fit.jacobian @ (vectors[:, kept] / np.sqrt(values[kept]))
    return out
