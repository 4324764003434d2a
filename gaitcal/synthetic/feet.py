"""The feet of the built-in person on the ground: when each stands, where its points are, and how its load rolls.

A foot strikes with the heel and leaves with the toes: the centre of pressure goes along the line from heel to toe
marker, quickly over the heel and slowly under the forefoot, as in walking people (Perry 1992). The left foot does
the same half a stride later.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.interpolate import PchipInterpolator

from gaitcal.arrays import Array
from gaitcal.dynamics.inverse_dynamics import FEET
from gaitcal.dynamics.plate_errors import FOOT_LENGTH
from gaitcal.model.chain import Chain, forward, jacobian, segment_poses
from gaitcal.model.linkage import SIDES
from gaitcal.model.nominal import published_model
from gaitcal.model.parameters import Parameters

STANCE = 0.62
"""Share of a stride in which a foot is on the ground; double support is 0.12 of it, twice."""
DOUBLE_SUPPORT = STANCE - 0.5
POINTS = ("Heel", "Toe.Tip", "Toe.Lat", "Toe.Med")
"""Markers of a foot; the second ends the line along which its load rolls, the last two are at the ball of the foot."""
_ROLL = ((0.0, 0.12, 0.3, 0.55, 0.8, 1.0), (0.10, 0.28, 0.42, 0.58, 0.72, 0.86))
"""Part of stance, and where the centre of pressure is then between the back of the heel and the tip of the foot."""
HEEL_RESTS, BALL_RESTS, SETTLING = (0.01, 0.35), (0.1, 0.54), 0.06
"""Phases of the foot's own stride between which heel and ball do not move, and the time to come to rest and leave."""


@dataclass(frozen=True)
class FeetOnGround:
    """Points of both feet of one linkage in some frames."""

    points: Array
    """(nf, 2, 4, 3) m, of the right and the left foot, in the order of `POINTS`."""
    slopes: Array
    """(nf, 2, 4, 3, nq) their derivatives by the coordinates."""

    def along(self, part: Array) -> tuple[Array, Array]:
        """Points on the floor (nf, 2, 3) m, at parts (nf, 2) of the way from heel to tip, and their derivatives."""
        share = (part * _tip_beyond_marker())[..., None]
        of = [(1.0 - share) * self.points[:, :, 0] + share * self.points[:, :, 1]]
        share = share[..., None]
        of.append((1.0 - share) * self.slopes[:, :, 0] + share * self.slopes[:, :, 1])
        for values in of:
            values[:, :, 1] = 0.0
        return of[0], of[1]


def feet_of(parameters: Parameters, q: Array) -> FeetOnGround:
    """Where the points of the feet are at coordinates (nf, nq)."""
    chain = Chain()
    constants = chain.constants(parameters.joint, parameters.zero_angles)
    poses = forward(chain, constants, q)
    axes, origins = segment_poses(chain, constants, poses)
    columns = jacobian(chain, constants, poses).transpose(2, 1, 0)  # (nf, 6, nq)
    points = np.empty((len(q), len(FEET), len(POINTS), 3))
    slopes = np.zeros((*points.shape, q.shape[1]))
    for foot, segment in enumerate(FEET):
        k = chain.segments.index(segment)
        moved = np.flatnonzero(chain.support[:, k])
        for n, local in enumerate(_local_points()[foot]):
            place = np.einsum("j,jif->fi", local, axes[k]) + origins[k].T
            turned = np.cross(columns[:, 3:, moved], place[:, :, None], axis=1)
            points[:, foot, n] = place
            slopes[:, foot, n][:, :, moved] = columns[:, :3, moved] + turned
    return FeetOnGround(points, slopes)


def stride_of(phase: Array) -> Array:
    """(nf, 2) phase of the right and the left foot's own stride, 0 to 1 from its strike on."""
    return np.stack([phase % 1.0, (phase - 0.5) % 1.0], axis=1)


def rolled(phase: Array) -> Array:
    """(nf, 2) part of the way from heel to tip to which the load of each foot has rolled; in swing it stays."""
    part: Array = PchipInterpolator(*_ROLL)(np.minimum(stride_of(phase) / STANCE, 1.0))
    return part


def right_share(phase: Array) -> Array:
    """(nf,) share of the right foot in the vertical load over the gait cycle (0: right heel strike)."""
    own = phase % 1.0
    rise, fall = _ramp(own / DOUBLE_SUPPORT), 1.0 - _ramp((own - 0.5) / DOUBLE_SUPPORT)
    return np.where(own < DOUBLE_SUPPORT, rise, np.where(own < 0.5, 1.0, np.where(own < STANCE, fall, 0.0)))


def resting(phase: Array) -> Array:
    """(nf, 2, 4) how much of the points of the feet stands still on the ground: 0 to 1, smooth in time."""
    own = stride_of(phase)
    heel, ball = (
        _ramp((own - begin) / SETTLING) * (1.0 - _ramp((own - end + SETTLING) / SETTLING))
        for begin, end in (HEEL_RESTS, BALL_RESTS)
    )
    out = np.zeros((len(phase), len(FEET), len(POINTS)))
    out[:, :, 0], out[:, :, 2], out[:, :, 3] = heel, ball, ball
    return out


@cache
def _local_points() -> Array:
    """(2, 4, 3) m, points of the right and the left foot in their segments: those of every built-in person."""
    markers = published_model().markers
    rows = [[markers.labels.index(f"{side.upper()}.{name}") for name in POINTS] for side in SIDES]
    out: Array = markers.local[rows]
    return out


@cache
def _tip_beyond_marker() -> float:
    """The length of a foot, as a part of the distance from its heel to its toe marker."""
    heel, toe = _local_points()[0, :2]
    marked = float(np.linalg.norm(toe - heel))
    return max(1.0, FOOT_LENGTH * published_model().subject.height / marked)


def _ramp(x: Array) -> Array:
    x = np.clip(x, 0.0, 1.0)
    out: Array = x**3 * (10.0 + x * (-15.0 + 6.0 * x))
    return out
