"""How large pelvis residuals are, and what is asked of simulations.

Hicks et al., Journal of Biomechanical Engineering 2015: a residual force under 5 % of the peak net external force, and
a residual moment under 1 % of the height of the mass centre times that force.

An RMS of a residual is one over valid frames and the three components everywhere (`Moments.residual_rms`). The limits
are those of a magnitude, for motions that were changed until they agree with the forces; they are drawn beside its
course, and nothing is judged by them, as few walks lie within as they are measured: plates have the impact of a heel,
and a smoothed motion does not. What is judged: `expected_residual.py`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from gaitcal.arrays import Array, BoolArray
from gaitcal.dynamics.ground_contact import GroundReactions
from gaitcal.dynamics.inverse_dynamics import Moments
from gaitcal.io.recording import ForcePlate
from gaitcal.model.build import build_linkage
from gaitcal.model.parameters import Parameters

FORCE_SHARE, MOMENT_SHARE = 0.05, 0.01
MOST_FRAMES = 50
"""Frames over which the height of the mass centre is averaged."""


@dataclass(frozen=True)
class ResidualLimits:
    """The limits for one trial, and what they rest on."""

    force: float
    """N."""
    moment: float
    """N·m."""
    peak_force: float
    """N, largest net external force over valid frames."""
    centre_height: float
    """m, mean height of the mass centre over the floor."""


@dataclass(frozen=True, kw_only=True)
class ResidualMagnitudes:
    """How large the pelvis residual is with one model, to be held against the limits."""

    name: str
    """Which model, in words."""
    force: Array
    """(nf,) N, magnitude, in all frames."""
    moment: Array
    """(nf,) N·m, magnitude, in all frames."""
    rms_force: float
    """N, over valid frames and components, as in `summary.json`."""
    rms_moment: float
    """N·m."""
    peak_force: float
    """N, largest magnitude over valid frames."""
    peak_moment: float
    """N·m."""


def residual_magnitudes(name: str, moments: Moments, valid: BoolArray) -> ResidualMagnitudes:
    """Magnitudes of a residual in every frame, and its figures over the valid frames (nf,), of which there are some."""
    force, moment = (np.linalg.norm(r, axis=1) for r in (moments.residual_force, moments.residual_moment))
    rms_force, rms_moment = moments.residual_rms(valid)
    return ResidualMagnitudes(
        name=name,
        force=force,
        moment=moment,
        rms_force=rms_force,
        rms_moment=rms_moment,
        peak_force=float(force[valid].max()),
        peak_moment=float(moment[valid].max()),
    )


def residual_limits(
    parameters: Parameters, q: Array, reactions: GroundReactions, plates: Sequence[ForcePlate]
) -> ResidualLimits:
    """The limits of one trial with coordinates (nf, nq) and at least one valid frame."""
    valid = np.flatnonzero(reactions.valid)
    net = np.linalg.norm(reactions.wrench[valid].sum(axis=1)[:, :3], axis=1)
    peak = float(net.max())
    chosen = valid[:: max(1, len(valid) // MOST_FRAMES)]
    height = _mass_centre_height(parameters, q[chosen]) - _floor(plates)
    return ResidualLimits(FORCE_SHARE * peak, MOMENT_SHARE * height * peak, peak, height)


def _mass_centre_height(parameters: Parameters, q: Array) -> float:
    model = build_linkage(parameters).model
    data = model.createData()
    return float(np.mean([pin.centerOfMass(model, data, row)[1] for row in q]))


def _floor(plates: Sequence[ForcePlate]) -> float:
    """m: the height of the plates, else 0."""
    corners = [plate.corners for plate in plates if plate.corners is not None]
    heights = [float(c[:, 1].mean()) for c in corners if np.isfinite(c).all()]
    return float(np.mean(heights)) if heights else 0.0
