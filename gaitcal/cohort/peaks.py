"""Largest and smallest value and range of mean curves over a stride, by leg, with standard errors.

Of the mean over valid strides (`gait/ensemble.py`), where at least `LEAST_VALID` of its percents are valid; moments and
powers by body mass. The standard error is that of the mean at that percent; of a range, whose ends are far apart in the
stride, it is taken as if their errors were independent: se = sqrt(se_max^2 + se_min^2).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from gaitcal.arrays import Array
from gaitcal.cohort.columns import ANGLES, UNITS
from gaitcal.gait.stride_peaks import LEAST_VALID
from gaitcal.model.linkage import SIDES
from gaitcal.results.table_file import read_csv


def peaks(ensemble: Path, mass: float) -> dict[str, float]:
    """Column -> value, of `ensemble.csv`; nothing of what is not known. `mass`: kg."""
    try:
        table, _ = read_csv(ensemble)
    except (OSError, pd.errors.EmptyDataError):
        return {}
    table = table[table["variable"].isin(UNITS) & table["side"].isin(SIDES)]
    curves = {name: pd.to_numeric(table[name], errors="coerce").to_numpy(np.float64) for name in ("mean", "se")}
    out: dict[str, float] = {}
    for (variable, side), rows in table.groupby(["variable", "side"], sort=False).indices.items():
        scale = 1.0 if variable in ANGLES else 1.0 / mass
        for peak, (value, error) in _peaks(scale * curves["mean"][rows], scale * curves["se"][rows]).items():
            out[f"{variable}_{peak}_{side}"] = value
            out[f"{variable}_{peak}_se_{side}"] = error
    return out


def _peaks(mean: Array, error: Array) -> dict[str, tuple[float, float]]:
    """Of one curve (101,): value and standard error of each kind."""
    if np.isfinite(mean).mean() < LEAST_VALID:
        return {}
    high, low = int(np.nanargmax(mean)), int(np.nanargmin(mean))
    return {
        "max": (float(mean[high]), float(error[high])),
        "min": (float(mean[low]), float(error[low])),
        "range": (float(mean[high] - mean[low]), float(np.hypot(error[high], error[low]))),
    }
