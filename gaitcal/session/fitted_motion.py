"""What the fit figures of a trial are of: the motion of what was fitted, and the floors below its errors."""

from __future__ import annotations

from dataclasses import dataclass

from gaitcal.model.parameters import Parameters
from gaitcal.motion.joint_floor import JointFloor, joint_floor
from gaitcal.motion.motion import MarkerErrors, Motion, rigid_floor, tracked_motion
from gaitcal.session.prepare import PreparedTrial


@dataclass(frozen=True)
class FittedMotion:
    """Of the whole body in gait, of the segments of its joint in an isolated trial."""

    calibrated: Motion | None
    """With the parameters at the end of the trial's own phase; None in gait: the motion of the whole body."""
    final: Motion | None
    """With the last parameters."""
    floor: MarkerErrors
    """Of rigid segments."""
    joint_floor: JointFloor | None


def fitted_motion(trial: PreparedTrial, final: Parameters, fitted_with: Parameters, body: Motion) -> FittedMotion:
    """Track what was fitted in a trial, and see how near its markers any motion comes.

    Inertial parameters play no part.

    Parameters
    ----------
    final : parameters after all phases.
    fitted_with : those at the end of an isolated trial's own phase.
    body : whole-body motion with `final`.
    """
    floor = rigid_floor(trial.fitted)
    if trial.joint is None:
        return FittedMotion(None, None, floor, joint_floor(trial.fitted, final, body.q))
    last = tracked_motion(trial.fitted, final)
    calibrated = last if fitted_with is final else tracked_motion(trial.fitted, fitted_with)
    return FittedMotion(calibrated, last, floor, joint_floor(trial.fitted, fitted_with, calibrated.q))
