"""Mean curves of a person over the stride as the page of a cohort takes them: small whole numbers, as text.

Of each variable and leg the mean over its valid straight strides (`gait/ensemble.py`) at every second percent, moments
and powers by body mass, as 16-bit integers in steps of a size that is the same for everybody: people can be packed one
by one. Three bytes are four letters of base64, and a person's bytes are divisible by three, so that people's texts one
behind the other are the text of all.
"""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from gaitcal.arrays import Array
from gaitcal.gait.cycles import Kind, kind_of
from gaitcal.model.linkage import SIDES
from gaitcal.results.table_file import read_csv

EVERY: Final = 2
"""% of the stride between two points."""
POINTS: Final = 100 // EVERY + 1
GAP: Final = -32768
STEPS: Final = {Kind.ANGLE: 0.01, Kind.MOMENT: 0.0005, Kind.POWER: 0.002}
"""What one of the whole numbers is: deg, N m/kg, W/kg."""
VARIABLES: Final = (
    *("hip_flexion", "hip_flexion_moment", "hip_power", "hip_adduction", "hip_adduction_moment", "hip_rotation"),
    *("knee_angle", "knee_angle_moment", "knee_power", "knee_adduction_moment"),
    *("ankle_angle", "ankle_angle_moment", "ankle_power"),
)
"""Of `cycles.csv`, in the order of the packed curves; right before left."""
SHAPE: Final = (len(VARIABLES), len(SIDES), POINTS)


def mean_curves(ensemble: Path, mass: float) -> str:
    """Base64 of the curves of `ensemble.csv`, little-endian integers of `SHAPE`; empty where there is none.

    Parameters
    ----------
    mass : kg.
    """
    try:
        table, _ = read_csv(ensemble)
    except (OSError, pd.errors.EmptyDataError):
        return ""
    packed = np.full(SHAPE, GAP, dtype="<i2")
    table = table[table["variable"].isin(VARIABLES) & table["side"].isin(SIDES)]
    values = pd.to_numeric(table["mean"], errors="coerce").to_numpy(np.float64)
    percent = pd.to_numeric(table["percent"], errors="coerce").to_numpy(np.float64)
    for (variable, side), rows in table.groupby(["variable", "side"], sort=False).indices.items():
        kind = kind_of(variable)
        mean = values[rows] / (1.0 if kind is Kind.ANGLE else mass)
        packed[VARIABLES.index(variable), SIDES.index(side)] = _whole(percent[rows], mean, STEPS[kind])
    if (packed == GAP).all():
        return ""
    return base64.b64encode(packed.tobytes()).decode("ascii")


def no_curves() -> str:
    """The curves of somebody who has none."""
    return base64.b64encode(np.full(SHAPE, GAP, dtype="<i2").tobytes()).decode("ascii")


def _whole(percent: Array, mean: Array, step: float) -> Array:
    out = np.full(POINTS, GAP, dtype="<i2")
    here = np.isfinite(mean) & (percent % EVERY == 0)
    limit = -GAP - 1
    out[(percent[here] / EVERY).astype(int)] = np.clip(np.rint(mean[here] / step), -limit, limit)
    return out
