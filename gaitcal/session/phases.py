"""The fits that a calibration made, as a user is told of them."""

from __future__ import annotations

from gaitcal.calibration.combined import CombinedFit
from gaitcal.calibration.inertial_calibration import InertialFit
from gaitcal.calibration.joint_phases import JointCalibration, Phase


def phases_of(
    joint: JointCalibration | None, inertial: InertialFit | None, combined: CombinedFit | None, trials: tuple[str, ...]
) -> tuple[Phase, ...]:
    """The fits that were made, those of the joint parameters first; `trials` told of inertial parameters."""
    phases = list(joint.phases) if joint else []
    if inertial is not None:
        phases.append(
            Phase(
                name="inertial",
                trials=trials,
                parameters=len(inertial.names),
                iterations=inertial.iterations,
                seconds=inertial.seconds,
                converged=inertial.converged,
                message=inertial.message,
            )
        )
    if combined is not None and joint is not None and inertial is not None:
        text = "" if combined.converged else f"{combined.ending.value}; "
        text += f"marker sigma {1e3 * combined.marker_sigma:.2f} mm a coordinate, load share {combined.load_share:g}"
        phases.append(
            Phase(
                name="joint and inertial",
                trials=trials,
                parameters=len(joint.free) + len(inertial.names),
                iterations=combined.steps,
                seconds=combined.seconds,
                converged=combined.converged,
                message=text,
            )
        )
    return tuple(phases)
