"""Soft tissue sized by the task, as the published sizes have it, for tests that draw it."""

import numpy as np

from gaitcal.arrays import Array
from gaitcal.calibration.soft_tissue_artefact import SIZES
from gaitcal.tracking.soft_tissue import build_rigid_pattern


def marker_covariance(segment: str, local: Array) -> Array:
    """(3 nm, 3 nm) m^2 of one regressor over a task, for markers at `local` (nm, 3) m."""
    size = SIZES[segment.split("_")[0]]
    rigid = build_rigid_pattern(local - local.mean(axis=0)).reshape(-1, 6) * np.repeat(
        [size.shift, size.turn], 3
    )
    return np.asarray(rigid @ rigid.T + size.per_marker**2 * np.eye(len(rigid)))
