"""Inverse dynamics of a tracked motion, for scripts: `gaitcal.inverse_dynamics(model, motion, forces)`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gaitcal.dynamics.inverse_dynamics import Dynamics
from gaitcal.errors import InputError
from gaitcal.model.linkage import COORDINATES, is_translation
from gaitcal.model.subject_model import SubjectModel
from gaitcal.motion.motion import Motion

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Moments:
    """Generalised forces of one trial: internal, net, positive along the coordinate of that name."""

    coordinates: tuple[str, ...]
    """The 27 names of the columns of `tau`."""
    time: Array
    """(nf,) s."""
    tau: Array
    """(nf, 27) N\u00b7m; N for the three pelvis translations."""
    knee_adduction: Array
    """(nf, 2) N\u00b7m, right and left: internal reaction moment about the knee frame's x axis, adduction positive."""
    residual_force: Array
    """(nf, 3) N, laboratory axes: what the ground reactions do not explain."""
    residual_moment: Array
    """(nf, 3) N\u00b7m about the pelvis origin, laboratory axes."""
    bwh: float
    """Body weight times height, N\u00b7m."""

    def percent_bwh(self, coordinate: str) -> Array:
        """(nf,) torque of a coordinate in percent of body weight times height.

        Raises
        ------
        ValueError
            The coordinate is a translation of the pelvis (a force), or none of the 27.
        """
        if is_translation(coordinate):
            raise ValueError(f"'{coordinate}' is a force, not a torque")
        return 100.0 * self.tau[:, self.coordinates.index(coordinate)] / self.bwh


def inverse_dynamics(model: SubjectModel, motion: Motion, forces: Array) -> Moments:
    """Joint torques of a whole-body motion.

    Parameters
    ----------
    model : the person's model; its parameters should be those the motion was tracked with.
    motion : from `gaitcal.track`, all 27 coordinates.
    forces : (nf, 2, 6) ground on right and left foot at the frames of the motion: force (N) and moment (N\u00b7m) about
        the laboratory origin, laboratory axes; zeros where a foot is in the air: the `wrench` that
        `gaitcal.ground_reactions` makes of a recording's plates.

    Raises
    ------
    InputError
        The forces are no array: force plates must be given to the feet first.
    ValueError
        The motion is of a part of the body only, or there is not one row of forces for every frame.
    """
    if motion.coordinates != COORDINATES:
        raise ValueError("inverse dynamics needs a motion of the whole body, with all 27 coordinates")
    if not isinstance(forces, np.ndarray):
        raise InputError(
            f"found {type(forces).__name__}; allowed: an array (frames, 2, 6) of the forces on right and left foot, as "
            "gaitcal.ground_reactions(model, motion, recording).wrench gives it for force plates",
            field="forces",
        )
    if forces.shape != (len(motion.time), 2, 6):
        raise ValueError(f"forces have shape {forces.shape}, expected ({len(motion.time)}, 2, 6)")
    found = Dynamics(model.parameters).forces(motion.q, motion.velocity, motion.acceleration, forces)
    return Moments(
        COORDINATES,
        motion.time,
        found.tau,
        found.knee_adduction,
        found.residual_force,
        found.residual_moment,
        model.subject.bwh,
    )
