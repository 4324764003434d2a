"""Pelvis residuals against the limits that people use.

Hicks et al., Journal of Biomechanical Engineering 2015: a residual force under 5 % of the peak net external force, and
a residual moment under 1 % of the height of the mass centre times that force.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from gaitcal.dynamics.inverse_dynamics import Dynamics, GeneralisedForces, residual_rms
from gaitcal.model.parameters import Parameters
from gaitcal.person.result import LoadedTrial, TrialResult

Array = NDArray[np.float64]

FORCE_SHARE, MOMENT_SHARE = 0.05, 0.01
MOST_FRAMES = 50
"""Frames over which the height of the mass centre is averaged."""


@dataclass(frozen=True)
class Limits:
    """The limits for one trial, and what they rest on."""

    force: float
    """N."""
    moment: float
    """N·m."""
    peak_force: float
    """N, largest net external force over valid frames."""
    centre_height: float
    """m, mean height of the mass centre over the floor."""


@dataclass(frozen=True)
class Stage:
    """The residuals after one step of the calibration, over valid frames."""

    name: str
    force: Array
    """(nf,) N, magnitude."""
    moment: Array
    """(nf,) N·m, magnitude."""
    rms_force: float
    """N, over frames and components, as in `summary.json`."""
    rms_moment: float
    """N·m."""
    peak_force: float
    """N, largest magnitude."""
    peak_moment: float
    """N·m."""


STAGES = (
    ("nominal", "nominal model"),
    ("jp", "joint parameters calibrated"),
    ("jp_ip", "joint and inertial parameters calibrated"),
    ("joint_step", "all parameters refined together"),
)


def stages(loads: LoadedTrial) -> tuple[Stage, ...]:
    """Residuals of every step that was taken; empty where no frame is valid."""
    if not loads.reactions.valid.any():
        return ()
    found = ((words, getattr(loads, field)) for field, words in STAGES)
    return tuple(_stage(words, forces, loads.reactions.valid) for words, forces in found if forces is not None)


def _stage(name: str, forces: GeneralisedForces, valid: NDArray[np.bool_]) -> Stage:
    force, moment = (np.linalg.norm(r, axis=1) for r in (forces.residual_force, forces.residual_moment))
    rms_force, rms_moment = residual_rms(forces, valid)
    return Stage(name, force, moment, rms_force, rms_moment, float(force[valid].max()), float(moment[valid].max()))


def residual_limits(parameters: Parameters, trial: TrialResult, loads: LoadedTrial) -> Limits:
    """The limits of one trial with at least one valid frame."""
    valid = np.flatnonzero(loads.reactions.valid)
    net = np.linalg.norm(loads.reactions.wrench[valid].sum(axis=1)[:, :3], axis=1)
    peak = float(net.max())
    chosen = valid[:: max(1, len(valid) // MOST_FRAMES)]
    height = _mass_centre_height(parameters, trial.body.q[chosen]) - _floor(trial)
    return Limits(FORCE_SHARE * peak, MOMENT_SHARE * height * peak, peak, height)


def _mass_centre_height(parameters: Parameters, q: Array) -> float:
    dynamics = Dynamics(parameters)
    model = dynamics.linkage.model
    data = model.createData()
    return float(np.mean([pin.centerOfMass(model, data, row)[1] for row in dynamics.expand(q)]))


def _floor(trial: TrialResult) -> float:
    """m: the height of the plates, else 0."""
    corners = [plate.corners for plate in trial.recording.plates if plate.corners is not None]
    heights = [float(c[:, 1].mean()) for c in corners if np.isfinite(c).all()]
    return float(np.mean(heights)) if heights else 0.0
