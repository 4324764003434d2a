"""How large the pelvis residual of a trial may be: what its own errors let expect, and what only 1
in 1000 exceeds.

Of the residual's three components i (force, or moment), laboratory axes, over the valid frames f,

    RMS^2 = mean_i mean_f r_if^2
    V_i = S_i + A_i,     S_i = mean_f SE_if^2,     A_i = U_i^2 + mean_f B_if^2
    expected^2 = mean_i V_i,     limit^2 = expected^2 chi^2_n(1 - RARE) / n

SE is the error bar of the generalised forces of the pelvis (`calibration/torque_errors.py`). U is
what walks without a fault leave once inertial parameters have taken their part, as no body is made
of rigid segments. B is what the plates hold above the cut-off of the motion: the impact of a heel
is over before a smoothed motion can follow it. The error bar counts as one draw a component in a
whole trial, since masses, joints and skin are in error from its first frame to its last; the rest
forgets itself within `TAU`. With T the duration of the valid frames, a sum of squares is chi^2
distributed (Satterthwaite, Biometrics Bulletin 2:110-114, 1946) with

    n = (sum_i V_i)^2 / sum_i (S_i^2 + A_i^2 / max(1, T / TAU)).

What is asked of simulations (Hicks et al., Journal of Biomechanical Engineering 2015), a residual
force under 5 % of the peak net external force and a residual moment under 1 % of the height of the
mass centre times that force, are limits of a magnitude, for motions that were changed until they
agree with the forces. They are drawn beside its course; nothing is judged by them: plates have the
impact of a heel, and a smoothed motion does not.
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

BASELINE = np.array([0.030, 0.045, 0.015, 0.0060, 0.0020, 0.0080])
"""U of force (body weight) and moment (body weight times height) forward, up and to the right."""
TAU = 0.07
"""s, over which what clean walks leave forgets itself."""
RARE = 1e-3
"""Of all trials without a fault: those whose residual is beyond its limit."""
PELVIS = [
    linkage.COORDINATE_INDEX[f"pelvis_{name}"]
    for name in ("tx", "ty", "tz", "list", "rotation", "tilt")
]
"""Generalised forces whose errors are those of force and moment forward, up and to the right: the
pelvis leans little enough for its three axes to count as those of the laboratory."""
FORCE_SHARE, MOMENT_SHARE = 0.05, 0.01
"""Of the peak net external force; of that times the height of the mass centre."""
MOST_FRAMES = 50
"""Frames over which the height of the mass centre is averaged."""


@dataclass(frozen=True, kw_only=True)
class HeldResidual:
    """One RMS over valid frames and the three components, as in `summary.json`: N or N·m."""

    rms: float
    expected: float
    limit: float

    @property
    def within(self) -> bool:
        """Whether it is no larger than its limit."""
        return self.rms <= self.limit


@dataclass(frozen=True, kw_only=True)
class ExpectedResidual:
    """The pelvis residual of one trial against what its errors let expect."""

    force: HeldResidual
    moment: HeldResidual

    @property
    def within(self) -> bool:
        """Whether force and moment are."""
        return self.force.within and self.moment.within

    @property
    def share(self) -> float:
        """Of its limit, the larger one of both."""
        return max(self.force.rms / self.force.limit, self.moment.rms / self.moment.limit)


def expected_residual(
    moments: Moments,
    errors: TorqueErrors,
    reactions: GroundReactions,
    motion: Motion,
    weight: float,
) -> ExpectedResidual | None:
    """Of the final moments of a trial; None without a valid frame or a standard error. `weight`: of
    the body, N.
    """
    frames = reactions.valid & np.isfinite(errors.tau[:, PELVIS]).all(axis=1)
    if not frames.any():
        return None
    residual = np.hstack([moments.residual_force, moments.residual_moment])[frames]
    bar = (errors.tau[frames][:, PELVIS] ** 2).mean(axis=0)
    baseline = (BASELINE * np.repeat([weight, moments.bwh], 3)) ** 2
    other = baseline + (_faster(reactions, motion, frames) ** 2).mean(axis=0)
    draws = max(1.0, float(frames.sum()) * _step(motion.time) / TAU)
    squares = (residual**2).mean(axis=0)
    force, moment = (
        _held(squares[of], bar[of], other[of], draws) for of in (slice(0, 3), slice(3, 6))
    )
    return ExpectedResidual(force=force, moment=moment)


def _held(squares: Array, bar: Array, other: Array, draws: float) -> HeldResidual:
    """From mean squares (3,) of the residual, S, and A."""
    total = float((bar + other).sum())
    n = total**2 / float((bar**2 + other**2 / draws).sum())
    expected = float(np.sqrt(total / 3.0))
    return HeldResidual(
        rms=float(np.sqrt(squares.mean())),
        expected=expected,
        limit=expected * float(np.sqrt(chdtri(n, RARE) / n)),
    )


def _faster(reactions: GroundReactions, motion: Motion, frames: BoolArray) -> Array:
    """(k, 6) N, N·m about the pelvis: what all ground reactions together hold above the motion's
    cut-off.
    """
    total = np.nan_to_num(reactions.wrench.sum(axis=1))
    rate = 1.0 / _step(motion.time)
    if len(total) < 3 or not 0.0 < motion.cutoff_hz < 0.5 * rate:
        return np.zeros((int(frames.sum()), 6))
    fast = (total - filter_low_pass(total, rate, motion.cutoff_hz))[frames]
    pelvis = motion.q[frames, :3]
    return np.hstack([fast[:, :3], fast[:, 3:] - cross(pelvis, fast[:, :3])])


def _step(time: Array) -> float:
    """S between frames."""
    return float(np.median(np.diff(time))) if len(time) > 1 else TAU


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
    """Magnitudes of a residual in every frame, and its figures over the valid frames (nf,), of
    which there are some.
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


def residual_limits(
    parameters: Parameters, q: Array, reactions: GroundReactions, plates: Sequence[ForcePlate]
) -> ResidualLimits:
    """The limits of one trial with coordinates (nf, nq) and at least one valid frame."""
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
