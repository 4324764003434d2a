"""Angles of the pelvis against the line of progression of one stride, as tables and page have them."""

from __future__ import annotations

import numpy as np

from gaitcal.arrays import Array
from gaitcal.gait.cycles import GaitCycle
from gaitcal.gait.progression import along_line
from gaitcal.gait.spatiotemporal import Stride
from gaitcal.session.result import TrialResult


def pelvis_in_stride(trial: TrialResult, angles: Array, cycle: GaitCycle, stride: Stride | None) -> Array:
    """(nf, 3) deg, `PELVIS_ANGLES` over all frames of the trial, against the line of this stride.

    `angles`: (nf, 3) rad, against the room; `stride`: what was measured of the cycle, None where nothing was.
    """
    inside = (trial.body.time >= cycle.start) & (trial.body.time <= cycle.stop)
    return np.asarray(np.degrees(along_line(angles, stride_line(trial, cycle, stride), inside)))


def stride_line(trial: TrialResult, cycle: GaitCycle, stride: Stride | None) -> float:
    """Rad: of the stride, else of the one nearest to it in time; 0, the room's x axis, where none is known."""
    if stride is not None and stride.line is not None:
        return stride.line
    middle = 0.5 * (cycle.start + cycle.stop)
    known = [
        (abs(0.5 * (s.start + s.stop) - middle), s.line)
        for s in trial.strides
        if s.line is not None and s.start is not None and s.stop is not None
    ]
    return min(known)[1] if known else 0.0
