"""The pelvis residual of walking trials, linear in the inertial parameters.

F and T, the root wrench that no ground reaction explains, are linear in the dynamic parameters phi(p) = (m, m c,
I_origin) of the bodies. The rows of all valid frames are compressed once by a QR factorisation of their regressor to at
most 121 rows, whose norm is that of the full residual exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.dynamics.inverse_dynamics import Dynamics
from gaitcal.model.inertial_parameters import dynamic_parameters
from gaitcal.model.parameters import Parameters
from gaitcal.model.subject_model import Subject


class TorqueScale(Enum):
    """Length L/BW by which residual torques are normalised (the three choices of the paper's discussion)."""

    BODY_HEIGHT = "bwh"
    PELVIS_WIDTH = "pelvis_width"
    MILLIMETRE = "1mm"


@dataclass(frozen=True, kw_only=True)
class RootEquations:
    """The root wrench of all valid frames, linear in the dynamic parameters, compressed."""

    factor: Array
    """(n, 120) rows of R."""
    target: Array
    """(n,) the ground reactions' part, Q^T w, in the same rows."""
    frames: int
    force_rows: Array
    """(n_f, 121) the same for force alone, unscaled (N), for reporting."""
    moment_rows: Array
    """(n_m, 121) the same for moment alone (N·m)."""

    def rms(self, inertial: Array) -> tuple[float, float]:
        """RMS residual force (N) and moment (N·m) over frames and the three components."""
        phi = np.append(dynamic_parameters(inertial).ravel(), 1.0)
        count = np.sqrt(3.0 * self.frames)
        force, moment = np.linalg.norm(self.force_rows @ phi), np.linalg.norm(self.moment_rows @ phi)
        return float(force / count), float(moment / count)


def root_equations(regressor: Array, ground: Array, weight: float, length: float) -> RootEquations:
    """Compress the root wrench of the valid frames.

    Parameters
    ----------
    regressor : (nf, 6, 12, 10) of `Dynamics.root_regressor`.
    ground : (nf, 6) what the ground reactions contribute, force and moment about the pelvis origin.
    weight : body weight, N.
    length : m, torques are divided by weight * length.
    """
    nf = len(regressor)
    rows = np.concatenate([regressor.reshape(nf, 6, -1), ground[:, :, None]], axis=2)
    width = rows.shape[2]
    force, moment = _compressed(rows[:, :3].reshape(3 * nf, width)), _compressed(rows[:, 3:].reshape(3 * nf, width))
    stacked = _compressed(np.vstack([force / weight, moment / (weight * length)]))
    return RootEquations(factor=stacked[:, :-1], target=stacked[:, -1], frames=nf, force_rows=force, moment_rows=moment)


def _compressed(rows: Array) -> Array:
    """Triangular rows with the same norm in every direction."""
    out: Array = np.linalg.qr(rows, mode="r")  # type: ignore[assignment]
    return out


@dataclass(frozen=True, kw_only=True)
class LoadedMotion:
    """A motion with ground reactions on the feet, for the frames that are valid."""

    name: str
    q: Array
    """(nf, 27) m, rad."""
    velocity: Array
    acceleration: Array
    wrench: Array
    """(nf, 2, 6) about the laboratory origin."""
    valid: BoolArray
    """(nf,)."""


def torque_length(subject: Subject, scale: TorqueScale, pelvis_width: float) -> float:
    """m, L of a torque scale; `pelvis_width` (m) is the distance between the hip centres."""
    return {
        TorqueScale.BODY_HEIGHT: subject.height,
        TorqueScale.PELVIS_WIDTH: pelvis_width,
        TorqueScale.MILLIMETRE: 1e-3,
    }[scale]


def equations_of(
    motions: Sequence[LoadedMotion], parameters: Parameters, subject: Subject, scale: TorqueScale, pelvis_width: float
) -> RootEquations:
    """The pelvis residual of all valid frames of all trials, linear in the dynamic parameters.

    `pelvis_width` (m): distance between the hip centres, for the torque scale of that name.
    """
    length = torque_length(subject, scale, pelvis_width)
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
