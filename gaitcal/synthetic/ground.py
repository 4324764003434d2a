"""What the ground does to each foot of a walking person whose total ground reaction is known.

The total wrench is what the motion asks for (root inverse dynamics), so that the true pelvis residual is zero. It is
divided between the feet in four steps, each exact:

1. The vertical load goes from foot to foot by a quintic ramp, in which the swinging foot has none.
2. Each foot's centre of pressure rolls from heel to toe (`feet.py`). The load on both has its centre where the motion
   wants it: the rest, some millimetres, is met by the ramp along the line between the feet, and by moving both centres
   across it.
3. The forces of both feet meet in one point above the middle of the body, as those of walking people do (Maus et al.
   2010, Nature Communications 1:70), so that the front foot brakes while the rear one drives.
4. The free moment is divided like the load: forces that meet above the centre add none to it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array
from gaitcal.dynamics.inverse_dynamics import FEET, Dynamics, pelvis_residual
from gaitcal.model.nominal import published_model
from gaitcal.model.parameters import Parameters
from gaitcal.runtime import with_one_blas_thread
from gaitcal.synthetic.feet import feet_of, right_share, rolled
from gaitcal.synthetic.motion import TrueMotion

MEETING_HEIGHT = 0.7
"""Of body height: where the lines of both forces meet."""


@dataclass(frozen=True)
class GroundOnFeet:
    """Ground reactions on the right and the left foot."""

    wrench: Array
    """(nf, 2, 6) N, N·m about the laboratory origin."""
    centre: Array
    """(nf, 2, 3) m, centre of pressure on the floor, y = 0; in swing where the foot struck last or will strike."""
    load_share: Array
    """(nf, 2) of the vertical force; they sum to 1."""


@with_one_blas_thread
def residual_free_wrench(parameters: Parameters, motion: TrueMotion) -> Array:
    """(nf, 2, 6) wrenches on right and left foot about the laboratory origin that leave no pelvis residual in gait."""
    return ground_on_feet(parameters, motion).wrench


@with_one_blas_thread
def ground_on_feet(parameters: Parameters, motion: TrueMotion) -> GroundOnFeet:
    """The ground reactions of a gait of a person with these parameters.

    Raises
    ------
    ValueError
        The motion is no gait.
    """
    if motion.phase is None:
        raise ValueError("only a gait has ground reactions: this motion has no phase")
    q, v, a = (motion.basis.evaluate(motion.nodes, k) for k in range(3))
    total = pelvis_residual(q, Dynamics(parameters).forces(q, v, a, np.zeros((len(q), 2, 6))))
    force, moment = total[:, :3], total[:, 3:] + np.cross(q[:, :3], total[:, :3])
    middle = _centre(force, moment)
    free = moment[:, 1] - np.cross(middle, force)[:, 1]
    share, centre = _loads(middle, feet_of(parameters, q).along(rolled(motion.phase))[0], right_share(motion.phase))
    return GroundOnFeet(_wrenches(force, free, middle, share, centre), centre, share)


def _centre(force: Array, moment: Array) -> Array:
    """(nf, 3) m, where on the floor a wrench about the laboratory origin has no tipping moment."""
    up = force[:, 1]
    return np.stack([moment[:, 2] / up, np.zeros(len(up)), -moment[:, 0] / up], axis=1)


def _loads(middle: Array, rolling: Array, right: Array) -> tuple[Array, Array]:
    """(nf, 2) shares of the load and (nf, 2, 3) m centres of pressure, whose weighted mean is `middle` (nf, 3)."""
    share = np.stack([right, 1.0 - right], axis=1)
    missed = middle - np.einsum("fk,fki->fi", share, rolling)
    apart = rolling[:, 0] - rolling[:, 1]
    both = 16.0 * (right * (1.0 - right)) ** 2  # 1 where the feet share alike, and 0, also in its rate, at the ends
    moved = both * np.einsum("fi,fi->f", missed, apart) / np.einsum("fi,fi->f", apart, apart)
    centre: Array = rolling + (missed - moved[:, None] * apart)[:, None]
    return share + np.stack([moved, -moved], axis=1), centre


def _wrenches(force: Array, free: Array, middle: Array, share: Array, centre: Array) -> Array:
    height = MEETING_HEIGHT * published_model().subject.height
    meeting = middle + height * force / force[:, 1:2]
    out = np.zeros((len(force), len(FEET), 6))
    for foot in range(len(FEET)):
        line = (meeting - centre[:, foot]) / height
        out[:, foot, :3] = (share[:, foot] * force[:, 1])[:, None] * line
        out[:, foot, 3:] = np.cross(centre[:, foot], out[:, foot, :3])
        out[:, foot, 4] += share[:, foot] * free
    return out
