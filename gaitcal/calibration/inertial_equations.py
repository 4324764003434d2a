"""Inertial parameters of a person from gait trials: from motions and ground reactions to `inertial_calibration`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gaitcal.calibration.inertial_calibration import RootEquations, TorqueScale, root_equations
from gaitcal.dynamics.inverse_dynamics import Dynamics
from gaitcal.model.parameters import Parameters
from gaitcal.model.subject_model import Subject

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LoadedMotion:
    """A motion with ground reactions on the feet, for the frames that are valid."""

    name: str
    q: Array
    """(nf, 27) m, rad."""
    velocity: Array
    acceleration: Array
    wrench: Array
    """(nf, 2, 6) about the laboratory origin."""
    valid: NDArray[np.bool_]
    """(nf,)."""


def equations_of(
    motions: Sequence[LoadedMotion],
    parameters: Parameters,
    subject: Subject,
    scale: TorqueScale,
    pelvis_width: float,
) -> RootEquations:
    """The pelvis residual of all valid frames of all trials, linear in the dynamic parameters.

    `pelvis_width` (m): distance between the hip centres, for the torque scale of that name.
    """
    length = {
        TorqueScale.BODY_HEIGHT: subject.height,
        TorqueScale.PELVIS_WIDTH: pelvis_width,
        TorqueScale.MILLIMETRE: 1e-3,
    }[scale]
    dynamics = Dynamics(parameters)
    regressors, grounds = [], []
    for motion in motions:
        at = motion.valid
        q = motion.q[at]
        regressors.append(dynamics.root_regressor(q, motion.velocity[at], motion.acceleration[at]))
        total = motion.wrench[at].sum(axis=1)
        about_pelvis = total[:, 3:] - np.cross(q[:, :3], total[:, :3])
        grounds.append(-np.hstack([total[:, :3], about_pelvis]))
    return root_equations(np.concatenate(regressors), np.concatenate(grounds), subject.weight, length)
