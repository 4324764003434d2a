"""How far a fault of the forces moves the torques of the legs.

    d tau = -J_foot^T (w_foot - w'_foot),      w' the wrench of the ground without the fault

over the frames of the evidence, each plate on the foot that stands at that time.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gaitcal.arrays import Array
from gaitcal.dynamics.inverse_dynamics import FEET, FORCES, Dynamics
from gaitcal.faults.force_evidence import ForceEvidence
from gaitcal.faults.force_fits import ForceFit
from gaitcal.model.coordinates import LEG_COORDINATES, split_side

LEGS = [k for k, name in enumerate(FORCES) if split_side(name)[0] in LEG_COORDINATES]
HOLDS = 0.01
"""Of body weight times height: what the error bars of leg torques hold with 95 %."""


def torque_change(trials: Sequence[ForceEvidence], fit: ForceFit) -> tuple[str, float]:
    """The torque that the fault moves most, and by how much: RMS, as a share of body weight times height."""
    worst, most = "", 0.0
    for trial in trials:
        change = trial.wrenches - fit.cause.undo(trial, fit.x).wrenches
        size = np.sqrt((_of_feet(trial, change) ** 2).mean(axis=0)) / trial.bwh
        if size.max() > most:
            worst, most = FORCES[LEGS[int(size.argmax())]], float(size.max())
    return worst, most


def _of_feet(trial: ForceEvidence, change: Array) -> Array:
    """(k, torques of the legs) N·m, from changes of plates' wrenches (plates, k, 6)."""
    on_feet = np.stack([(change * (trial.feet == foot)[:, :, None]).sum(axis=0) for foot in range(len(FEET))], axis=1)
    moved: Array = Dynamics(trial.parameters).of_ground(trial.q, on_feet[..., None])[:, LEGS, 0]
    return moved
