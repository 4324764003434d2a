"""Spatiotemporal measures of two sessions: means over strides, and how far they differ.

Strikes are known to a frame or so, heels to some millimetres: strides vary by at least `LEAST`, however alike a few of
them happen to be.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd

from gaitcal.arrays import Array
from gaitcal.compare.difference import Difference
from gaitcal.compare.difference_error import Spread, spread_of, stride_part
from gaitcal.compare.session import Session
from gaitcal.gait.progression import TURNING
from gaitcal.gait.spatiotemporal import MEASURES

LEAST = {"s": 0.010, "%": 1.0, "m": 0.005, "m/s": 0.01, "steps/min": 1.0}
"""Unit -> standard deviation of a stride by the events and markers alone: 10 ms are a frame at 100 Hz."""


def measure_differences(a: Session, b: Session) -> Iterator[Difference]:
    """Every measure of each leg that both sessions have."""
    sets = [_values(session.measures) for session in (a, b)]
    for (side, name), of_a in sets[0].items():
        of_b = sets[1].get((side, name))
        if of_b is None:
            continue
        unit, other_leg = MEASURES[name], ("l" if side == "r" else "r", name)
        beside = [values[other_leg][:, None] for values in sets if other_leg in values]
        spread = spread_of([of_a[:, None], of_b[:, None]], beside)
        floored = Spread(variance=np.maximum(spread.variance, LEAST[unit] ** 2), freedom=spread.freedom)
        yield Difference(
            kind="spatiotemporal",
            side=side,
            name=name,
            measure="mean",
            unit=unit,
            a=float(of_a.mean()),
            b=float(of_b.mean()),
            se_strides=float(np.sqrt(stride_part(floored, np.array([len(of_a)]), np.array([len(of_b)])))[0]),
            se_shared=0.0,
            strides_a=len(of_a),
            strides_b=len(of_b),
        )


def _values(table: pd.DataFrame) -> dict[tuple[str, str], Array]:
    """Side and measure -> the values of its strides that count."""
    counting = (table["valid"] == 1.0) & table["value"].notna() & ~(table["turn"].abs() > TURNING)
    rows = table[counting & table["variable"].isin(list(MEASURES))]
    grouped = rows.groupby(["side", "variable"], sort=False)["value"]
    return {(str(side), str(name)): values.to_numpy(dtype=np.float64) for (side, name), values in grouped}
