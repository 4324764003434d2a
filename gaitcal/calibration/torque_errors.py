"""Standard errors of torques, frame by frame and source by source.

Every source of error c moves the joint parameters by d p_c and the motion by d N_c = n_c - S d p_c
(`error_sources.py`). The generalised forces follow by

    d tau_c = T n_c + G d p_c,
    T = (d tau/d q) B + (d tau/d v) B' + (d tau/d a) B'',    G = d tau/d p - T S.

Squares are summed over the coordinates and columns of each source. The inertial parameters add the
diagonal of (d tau/d IP) cov (d tau/d IP)^T, force plates and segments' axes the squares of
`dynamics/measurement_errors.py`. Powers and moment vectors are linear in the generalised forces
(`dynamics/joint_kinetics.py`). The effects of a source on forces, posture, rates and joint
parameters are added before squaring.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array, stretches
from gaitcal.calibration.error_sources import (
    ErrorSources,
    MotionSensitivity,
    compute_motion_sensitivity,
    sum_squares,
)
from gaitcal.calibration.inertial_calibration import InertialFit
from gaitcal.dynamics import derivatives, joint_kinetics, measurement_errors
from gaitcal.dynamics.inverse_dynamics import FORCES, Dynamics
from gaitcal.model.parameters import Parameters, compute_dynamic_jacobian
from gaitcal.runtime import LARGEST_BYTES
from gaitcal.tracking.trial_problem import MotionProblem

KINETICS = len(joint_kinetics.POWERS) + len(joint_kinetics.COMPONENTS) * len(
    joint_kinetics.VECTOR_FRAMES
)
"""Number of powers and components of moment vectors in a frame."""


class ForceErrors:
    """Errors of the generalised forces of one whole-body trial, of powers and of moment vectors.

    There are 27 generalised forces and two knee reactions. Errors are computed for some frames at a
    time.
    """

    def __init__(
        self,
        problem: MotionProblem,
        coefficients: Array,
        parameters: Parameters,
        wrenches: Array,
        joint: ErrorSources | None,
        inertial: Array | None = None,
        moves: MotionSensitivity | None = None,
        plates: measurement_errors.PlateErrors | None = None,
        axes: measurement_errors.AxisErrors | None = None,
    ) -> None:
        """Set up the errors of a trial.

        Parameters
        ----------
        problem : MotionProblem
            The whole-body trial.
        coefficients : (nn, 27) array
            Its motion, m and rad.
        parameters : Parameters
            Parameters of the linkage.
        wrenches : (nf, 2, 6) array
            Ground reactions on the feet, N and N·m.
        joint : ErrorSources or None
            Errors of the joint parameters; None if they were not calibrated.
        inertial : (84, n) array, optional
            R with covariance R R^T of the inertial parameters; None if they were not calibrated.
        moves : MotionSensitivity, optional
            Error sources of the motion, if available.
        plates : PlateErrors, optional
            Errors of the ground reactions; exact if not given.
        axes : AxisErrors, optional
            Errors of the directions of segments' axes; exact if not given.
        """
        self.problem, self.parameters, self.wrenches = problem, parameters, wrenches
        self.free: tuple[str, ...] = joint.names if joint else ()
        self.moves = moves or compute_motion_sensitivity(problem, coefficients, parameters, joint)
        self.inertial, self.axes, self.plates = inertial, axes, plates
        self._dynamics = Dynamics(parameters, joint_kinetics.HELD)
        self._opened = Dynamics(parameters, joint_kinetics.HELD, self.free)
        self._rates = measurement_errors.compute_wrench_rates(problem.basis.time, wrenches)
        self._state = [problem.basis.evaluate(coefficients, k) for k in range(3)]

    @property
    def parts(self) -> list[slice]:
        """Slices of frames whose arrays fit into memory together."""
        bytes_of_frame = 8 * KINETICS * self.moves.together.nodes.shape[1]
        return stretches(len(self.wrenches), max(LARGEST_BYTES // bytes_of_frame, 1))

    def compute_errors(self) -> measurement_errors.TorqueErrors:
        """Compute standard errors in all frames."""
        return join_variances([self.compute_variances(part) for part in self.parts])

    def compute_variances(self, part: slice) -> "Variances":
        """Compute variances of some frames.

        Parameters
        ----------
        part : slice
            The frames.

        Returns
        -------
        Variances
            Of forces by source, and of powers and moments by all sources.
        """
        dynamics, opened, wrenches = self._dynamics, self._opened, self.wrenches[part]
        q, v, a = (x[part] for x in self._state)
        placed, forces = opened.place(q), dynamics.compute_forces(q, v, a, wrenches)
        slopes = derivatives.differentiate_forces(
            opened, q, v, a, wrenches, joint_kinetics.ALL_FORCES
        )
        kinetic = joint_kinetics.differentiate_kinetics(placed, v, forces, self.free)
        through = kinetic.by_force
        by_state = np.concatenate(
            [
                through @ slopes.by_position + kinetic.by_position,
                through @ slopes.by_velocity + kinetic.by_velocity,
                through @ slopes.by_acceleration,
            ],
            axis=2,
        )
        by_parameter = through @ slopes.by_parameter + kinetic.by_parameter
        basis, count = self.problem.basis, len(FORCES)
        # powers and moments need the sum over all sources only, which fewer columns have
        torques = self.moves.by_source.propagate(
            basis, part, by_state[:, :count], by_parameter[:, :count]
        )
        kinetics = self.moves.together.propagate(
            basis, part, by_state[:, count:], by_parameter[:, count:]
        )
        found = Variances(
            self.moves.sum_by_source(torques), *self.moves.sum_all_and_trial(kinetics)
        )
        if self.inertial is not None:
            heavier = _propagate_inertial_errors(dynamics, self.parameters, self.inertial, q, v, a)
            found.add(measurement_errors.ErrorSource.INERTIA, sum_squares(through @ heavier))
        if self.plates is not None and self.plates.nonzero:
            plates = measurement_errors.compute_wrench_errors(
                wrenches, self._rates[part], self.plates
            )
            wrong = dynamics.compute_ground_forces(placed, plates)
            found.add(measurement_errors.ErrorSource.PLATES, sum_squares(through @ wrong))
        if self.axes is not None and self.axes.columns:
            moving, turns = (
                self._compute_rate_errors(self.axes, part),
                self.axes.compute_segment_rotations(q),
            )
            moved = kinetic.propagate_axis_errors(
                self.axes.compute_torque_sensitivities(q, forces), moving, turns
            )
            found.add(measurement_errors.ErrorSource.FRAMES, sum_squares(moved))
        return found

    def _compute_rate_errors(self, axes: measurement_errors.AxisErrors, part: slice) -> Array:
        """Compute errors (frames, 27, k) of rates by errors of the segments' axes.

        They are zero for coordinates that no marker moves with.
        """
        wide = slice(max(part.start - 1, 0), part.stop + 1)
        moves = axes.compute_rate_sensitivities(self._state[0][wide], self.problem.basis.time[wide])
        moves = moves[part.start - wide.start :][: part.stop - part.start]
        return np.where(self.problem.active[:, None], moves, 0.0)


@dataclass
class Variances:
    """Variances of forces at some frames, and of powers, moments (`differentiate_kinetics`)."""

    # (frames, 29) by source
    torques: dict[measurement_errors.ErrorSource, Array]
    kinetics: Array  # (frames, 91) of all sources together
    trial_markers: Array  # (frames, 91) of the markers of this trial

    def add(self, source: measurement_errors.ErrorSource, variance: Array) -> None:
        """Add the variance (frames, 120) of a further source."""
        self.torques[source] = variance[:, : len(FORCES)]
        self.kinetics += variance[:, len(FORCES) :]


def join_variances(parts: Sequence[Variances]) -> measurement_errors.TorqueErrors:
    """Join the variances of all frames to the errors of a trial.

    Parameters
    ----------
    parts : sequence of Variances
        Frames in order.

    Returns
    -------
    TorqueErrors
        Standard errors.
    """
    torques: dict[measurement_errors.ErrorSource, Array] = {}
    for source in parts[0].torques:
        torques[source] = np.concatenate([part.torques[source] for part in parts])
    kinetics = np.concatenate([part.kinetics for part in parts])
    trial_markers = np.concatenate([part.trial_markers for part in parts])
    return measurement_errors.TorqueErrors.from_sources(
        torques, joint_kinetics.build_kinetic_errors(kinetics, trial_markers)
    )


def _propagate_inertial_errors(
    dynamics: Dynamics, parameters: Parameters, spread: Array, q: Array, v: Array, a: Array
) -> Array:
    """Propagate the spread (84, n) of inertial parameters to generalised forces (nf, 35, n)."""
    slopes, sources = compute_dynamic_jacobian(parameters.inertial), spread.shape[1]
    by_source = slopes @ spread.reshape(
        len(slopes), 7, sources
    )  # (12, 10, n) change of the dynamic parameters
    regressor = dynamics.compute_regressor(q, v, a).reshape(len(q), -1, 10 * len(slopes))
    return regressor @ by_source.reshape(-1, sources)


def factor_inertial_covariance(fit: InertialFit) -> Array:
    """Factor the covariance of the inertial parameters: R (84, n) with covariance R R^T.

    Parameters
    ----------
    fit : InertialFit
        Fit of inertial parameters.

    Returns
    -------
    (84, n) array
        SI units.
    """
    values, vectors = np.linalg.eigh(fit.residual_jacobian.T @ fit.residual_jacobian)
    kept = values > 1e-12 * values[-1]
    return fit.jacobian @ (vectors[:, kept] / np.sqrt(values[kept]))
