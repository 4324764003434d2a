"""Standard errors of torques, frame by frame and source by source.

Every source of error c moves the joint parameters by d p_c and the motion by d N_c = n_c - S d p_c
(`error_sources.py`). The generalised forces follow by

    d tau_c = T n_c + G d p_c,      T = (d tau/d q) B + (d tau/d v) B' + (d tau/d a) B'',    G = d tau/d p - T S.

Squares sum over the coordinates and columns of each source; the inertial parameters add the
diagonal of (d tau/d IP) cov (d tau/d IP)^T, force plates and segments' axes the squares of
`dynamics/measurement_errors.py` and `dynamics/measurement_errors.py`. Powers and moment vectors are
linear in the generalised forces (`dynamics/joint_kinetics.py`): what a source does to these, to
posture, rates and joint parameters moves them together.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array, stretches
from gaitcal.calibration.error_sources import ErrorSources, MotionSensitivity, marker_moves, squares
from gaitcal.calibration.inertial_calibration import InertialFit
from gaitcal.dynamics import derivatives, joint_kinetics, measurement_errors
from gaitcal.dynamics.inverse_dynamics import FORCES, Dynamics
from gaitcal.model.parameters import Parameters, dynamic_jacobian
from gaitcal.runtime import LARGEST_BYTES
from gaitcal.tracking.trial_problem import MotionProblem

KINETICS = len(joint_kinetics.POWERS) + len(joint_kinetics.COMPONENTS) * len(
    joint_kinetics.VECTOR_FRAMES
)
"""Powers and components of moment vectors of a frame."""


class ErringForces:
    """The 27 generalised forces and two knee reactions of one whole-body trial, the powers and
    moment vectors that follow, and all that may be wrong with them; told of some frames at a time.
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
        """Set up.

        `problem`, `coefficients`: the whole-body trial and its motion, (nn, 27) m, rad. `wrenches`:
        (nf, 2, 6) N, N·m, ground reactions on the feet. `joint`: errors of the joint parameters;
        None where they were not calibrated. `inertial`: (84, n) R with covariance R R^T of the
        inertial parameters; None where they were not calibrated. `moves`: what the markers move,
        where it is known already. `plates`: how far the ground reactions are to be believed; exact
        unless given. `axes`: how far the directions of segments' axes are, with these parameters;
        exact unless given.
        """
        self.problem, self.parameters, self.wrenches = problem, parameters, wrenches
        self.free: tuple[str, ...] = joint.free if joint else ()
        self.moves = moves or marker_moves(problem, coefficients, parameters, joint)
        self.inertial, self.axes, self.plates = inertial, axes, plates
        self._dynamics = Dynamics(parameters, joint_kinetics.HELD)
        self._opened = Dynamics(parameters, joint_kinetics.HELD, self.free)
        self._rates = measurement_errors.compute_wrench_rates(problem.basis.time, wrenches)
        self._state = [problem.basis.evaluate(coefficients, k) for k in range(3)]

    @property
    def parts(self) -> list[slice]:
        """All frames, some at a time: what sources make of them stays in arrays whose memory is
        kept.
        """
        bytes_of_frame = 8 * KINETICS * self.moves.together.nodes.shape[1]
        return stretches(len(self.wrenches), max(LARGEST_BYTES // bytes_of_frame, 1))

    def errors(self) -> measurement_errors.TorqueErrors:
        """Standard errors in all frames."""
        return joined([self.variances(part) for part in self.parts])

    def variances(self, part: slice) -> "Variances":
        """Of some frames."""
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
        torques = self.moves.by_source.through(
            basis, part, by_state[:, :count], by_parameter[:, :count]
        )
        kinetics = self.moves.together.through(
            basis, part, by_state[:, count:], by_parameter[:, count:]
        )
        found = Variances(self.moves.variances(torques), *self.moves.whole_and_own(kinetics))
        if self.inertial is not None:
            heavier = _inertial_moves(dynamics, self.parameters, self.inertial, q, v, a)
            found.add(measurement_errors.ErrorSource.INERTIA, squares(through @ heavier))
        if self.plates is not None and self.plates.nonzero:
            plates = measurement_errors.compute_wrench_errors(
                wrenches, self._rates[part], self.plates
            )
            wrong = dynamics.compute_ground_forces(placed, plates)
            found.add(measurement_errors.ErrorSource.PLATES, squares(through @ wrong))
        if self.axes is not None and self.axes.columns:
            moving, turns = (
                self._rate_moves(self.axes, part),
                self.axes.compute_segment_rotations(q),
            )
            moved = kinetic.propagate_axis_errors(
                self.axes.compute_torque_sensitivities(q, forces), moving, turns
            )
            found.add(measurement_errors.ErrorSource.FRAMES, squares(moved))
        return found

    def _rate_moves(self, axes: measurement_errors.AxisErrors, part: slice) -> Array:
        """(frames, 27, k) what errors of the segments' axes make of rates; none of what no marker
        moves with.
        """
        wide = slice(max(part.start - 1, 0), part.stop + 1)
        moves = axes.compute_rate_sensitivities(self._state[0][wide], self.problem.basis.time[wide])
        moves = moves[part.start - wide.start :][: part.stop - part.start]
        return np.where(self.problem.active[:, None], moves, 0.0)


@dataclass
class Variances:
    """Of the forces of some frames, then of the powers and moments that follow (`differentiate_kinetics`)."""

    torques: dict[measurement_errors.ErrorSource, Array]  # (frames, 29) by source
    kinetics: Array  # (frames, 91) of all sources together
    own: Array  # (frames, 91) of the trial's own markers

    def add(self, source: measurement_errors.ErrorSource, variance: Array) -> None:
        """Count a further source, (frames, 120)."""
        self.torques[source] = variance[:, : len(FORCES)]
        self.kinetics += variance[:, len(FORCES) :]


def joined(parts: Sequence[Variances]) -> measurement_errors.TorqueErrors:
    """The errors of a trial from the variances of all its frames, part after part."""
    torques = {
        source: np.concatenate([part.torques[source] for part in parts])
        for source in parts[0].torques
    }
    kinetics, own = (
        np.concatenate([getattr(part, name) for part in parts]) for name in ("kinetics", "own")
    )
    return measurement_errors.TorqueErrors.from_sources(
        torques, joint_kinetics.build_kinetic_errors(kinetics, own)
    )


def _inertial_moves(
    dynamics: Dynamics, parameters: Parameters, spread: Array, q: Array, v: Array, a: Array
) -> Array:
    """(nf, 35, n) what the columns of the spread (84, n) of the inertial parameters make of the
    generalised forces.
    """
    slopes, sources = dynamic_jacobian(parameters.inertial), spread.shape[1]
    by_source = slopes @ spread.reshape(
        len(slopes), 7, sources
    )  # (12, 10, n) change of the dynamic parameters
    regressor = dynamics.compute_regressor(q, v, a).reshape(len(q), -1, 10 * len(slopes))
    return regressor @ by_source.reshape(-1, sources)


def inertial_square_root(fit: InertialFit) -> Array:
    """(84, n) R with covariance R R^T of the inertial parameters."""
    values, vectors = np.linalg.eigh(fit.residual_jacobian.T @ fit.residual_jacobian)
    kept = values > 1e-12 * values[-1]
    return fit.jacobian @ (vectors[:, kept] / np.sqrt(values[kept]))
