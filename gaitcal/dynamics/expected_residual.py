"""Expected size of the pelvis residual of a trial, and the limit that 1 in 1000 trials exceeds.

For the three components i of the residual (force, or moment), laboratory axes, over valid frames f,

    RMS^2 = mean_i mean_f r_if^2
    V_i = S_i + A_i,     S_i = mean_f SE_if^2,     A_i = U_i^2 + mean_f B_if^2
    expected^2 = mean_i V_i,     limit^2 = expected^2 chi^2_n(1 - FALSE_ALARM_RATE) / n

SE is the standard error of the generalised forces of the pelvis (`calibration/torque_errors.py`). U
is the residual of walks without a fault after inertial parameters have been fitted, as bodies are
not rigid. B is the part of the plates' forces above the cut-off of the motion: the impact of a heel
is over before a smoothed motion can follow it. The standard error counts as one draw for each
component in a whole trial, since errors of masses, joints and soft tissue last from its first frame
to its last. The rest is uncorrelated after `CORRELATION_S`. With T the duration of the valid
frames, a sum of squares is chi^2 distributed (Satterthwaite, Biometrics Bulletin 2:110-114, 1946)
with

    n = (sum_i V_i)^2 / sum_i (S_i^2 + A_i^2 / max(1, T / CORRELATION_S)).

Hicks et al. (Journal of Biomechanical Engineering 2015) ask of simulations a residual force below
5 % of the peak net external force, and a residual moment below 1 % of the height of the mass centre
times that force. These limits hold for motions that were adjusted to the forces. They are drawn
beside the residual and do not enter the verdict.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy.special import chdtri

from gaitcal.arrays import Array, BoolArray, cross
from gaitcal.dynamics.ground_reactions import GroundReactions
from gaitcal.dynamics.inverse_dynamics import Moments
from gaitcal.dynamics.measurement_errors import TorqueErrors
from gaitcal.io.force_plate import filter_low_pass
from gaitcal.io.recording import ForcePlate
from gaitcal.model import chain, linkage
from gaitcal.model.parameters import Parameters
from gaitcal.tracking.motion import Motion

BASELINE_RESIDUAL = np.array([0.030, 0.045, 0.015, 0.0060, 0.0020, 0.0080])
"""U of force (share of body weight) and moment (share of body weight times height): forward, up, to
the right."""
CORRELATION_S = 0.07
"""s, correlation time of the residual of walks without a fault."""
FALSE_ALARM_RATE = 1e-3
"""Share of trials without a fault whose residual exceeds its limit."""
PELVIS = [
    linkage.COORDINATE_INDEX[f"pelvis_{name}"]
    for name in ("tx", "ty", "tz", "list", "rotation", "tilt")
]
"""Columns of the generalised forces whose errors are those of force and moment forward, up and to
the right. The pelvis leans little enough for its axes to be taken as those of the laboratory."""
FORCE_SHARE, MOMENT_SHARE = 0.05, 0.01
"""Limits: share of the peak net external force; of that force times the height of the mass centre.
"""
MOST_FRAMES = 50
"""Frames over which the height of the mass centre is averaged."""


@dataclass(frozen=True, kw_only=True)
class ComparedResidual:
    """RMS over valid frames and the three components, as in `summary.json`: N or N·m."""

    rms: float
    expected: float
    limit: float

    @property
    def within(self) -> bool:
        """Whether it is no larger than its limit."""
        return self.rms <= self.limit


@dataclass(frozen=True, kw_only=True)
class ExpectedResidual:
    """Pelvis residual of one trial, compared with its expected size."""

    force: ComparedResidual
    moment: ComparedResidual

    @property
    def within(self) -> bool:
        """Whether force and moment are within their limits."""
        return self.force.within and self.moment.within

    @property
    def share(self) -> float:
        """Ratio to the limit, the larger one of force and moment."""
        return max(self.force.rms / self.force.limit, self.moment.rms / self.moment.limit)


def estimate_expected_residual(
    moments: Moments,
    errors: TorqueErrors,
    reactions: GroundReactions,
    motion: Motion,
    weight: float,
) -> ExpectedResidual | None:
    """Estimate the expected pelvis residual of the final moments of a trial.

    Parameters
    ----------
    moments
        Generalised forces of the trial.
    errors
        Their standard errors.
    reactions
        Ground reactions with their valid frames.
    motion
        Tracked motion.
    weight
        N, of the body.

    Returns
    -------
    ExpectedResidual or None
        None without a valid frame with standard errors.
    """
    frames = reactions.valid & np.isfinite(errors.tau[:, PELVIS]).all(axis=1)
    if not frames.any():
        return None
    # Mean squares of the residual and of its expected parts: S (`bar`), and U and B (`other`).
    residual = np.hstack([moments.residual_force, moments.residual_moment])[frames]
    bar = (errors.tau[frames][:, PELVIS] ** 2).mean(axis=0)
    baseline = (BASELINE_RESIDUAL * np.repeat([weight, moments.bwh], 3)) ** 2
    other = baseline + (_compute_fast_forces(reactions, motion, frames) ** 2).mean(axis=0)
    draws = max(1.0, float(frames.sum()) * _compute_time_step(motion.time) / CORRELATION_S)
    squares = (residual**2).mean(axis=0)
    force, moment = (
        _compare_residual(squares[rows], bar[rows], other[rows], draws)
        for rows in (slice(0, 3), slice(3, 6))
    )
    return ExpectedResidual(force=force, moment=moment)


def _compare_residual(squares: Array, bar: Array, other: Array, draws: float) -> ComparedResidual:
    """Compare mean squares (3,) of the residual with S (`bar`) and A (`other`)."""
    # Degrees of freedom n (Satterthwaite): S counts as one draw, A as `draws`.
    total = float((bar + other).sum())
    n = total**2 / float((bar**2 + other**2 / draws).sum())
    expected = float(np.sqrt(total / 3.0))
    return ComparedResidual(
        rms=float(np.sqrt(squares.mean())),
        expected=expected,
        limit=expected * float(np.sqrt(chdtri(n, FALSE_ALARM_RATE) / n)),
    )


def _compute_fast_forces(reactions: GroundReactions, motion: Motion, frames: BoolArray) -> Array:
    """Compute the total ground reaction above the cut-off of the motion.

    Returns (k, 6) N, N·m about the pelvis.
    """
    total = np.nan_to_num(reactions.wrench.sum(axis=1))
    rate = 1.0 / _compute_time_step(motion.time)
    if len(total) < 3 or not 0.0 < motion.cutoff_hz < 0.5 * rate:
        return np.zeros((int(frames.sum()), 6))
    fast = (total - filter_low_pass(total, rate, motion.cutoff_hz))[frames]
    pelvis = motion.q[frames, :3]
    return np.hstack([fast[:, :3], fast[:, 3:] - cross(pelvis, fast[:, :3])])


def _compute_time_step(time: Array) -> float:
    """Compute the time between frames, s."""
    return float(np.median(np.diff(time))) if len(time) > 1 else CORRELATION_S


@dataclass(frozen=True)
class ResidualLimits:
    """Published limits for one trial, and the figures that they are made of."""

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
    """Magnitudes of the pelvis residual with one model."""

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


def compute_residual_magnitudes(
    name: str, moments: Moments, valid: BoolArray
) -> ResidualMagnitudes:
    """Compute the magnitudes of a residual.

    Parameters
    ----------
    name
        Description of the model.
    moments
        Generalised forces of the trial.
    valid
        (nf,) frames for the RMS and the peaks, at least one.

    Returns
    -------
    ResidualMagnitudes
    """
    force, moment = (
        np.linalg.norm(r, axis=1) for r in (moments.residual_force, moments.residual_moment)
    )
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


def compute_residual_limits(
    parameters: Parameters, q: Array, reactions: GroundReactions, plates: Sequence[ForcePlate]
) -> ResidualLimits:
    """Compute the published limits for one trial.

    Parameters
    ----------
    parameters
        Parameters of the model.
    q
        (nf, nq) coordinates, m and rad.
    reactions
        Ground reactions, with at least one valid frame.
    plates
        Force plates; the floor is the mean height of their corners.

    Returns
    -------
    ResidualLimits
    """
    valid = np.flatnonzero(reactions.valid)
    net = np.linalg.norm(reactions.wrench[valid].sum(axis=1)[:, :3], axis=1)
    peak = float(net.max())
    chosen = valid[:: max(1, len(valid) // MOST_FRAMES)]
    model = chain.build_model(parameters)
    data = model.createData()
    centre = float(np.mean([pin.centerOfMass(model, data, row)[1] for row in q[chosen]]))
    corners = [plate.corners for plate in plates if plate.corners is not None]
    floors = [float(c[:, 1].mean()) for c in corners if np.isfinite(c).all()]
    height = centre - (float(np.mean(floors)) if floors else 0.0)
    return ResidualLimits(FORCE_SHARE * peak, MOMENT_SHARE * height * peak, peak, height)
