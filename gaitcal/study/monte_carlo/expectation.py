"""From a person's marker distance to the torque errors to expect, read from the Monte Carlo distributions.

The published discussion does this by hand: a marker RMS of 4 mm corresponds to less than 25 % of the JP bounds, or to
50 % of the noise amplitude, and to the torque errors there. Between levels, and from nothing at level zero, straight
lines.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from gaitcal.study.monte_carlo.leg_torques import TORQUES
from gaitcal.study.monte_carlo.settings import ReactionFrame, Varied
from gaitcal.study.monte_carlo.statistics import levels_of

SHOWN = ("average", "p10", "p50", "p90")


@dataclass(frozen=True)
class CauseOfMarkerError:
    """What level of one cause alone would give the marker distance."""

    varied: Varied
    level: float
    """Per cent of the bounds; the highest level studied where `beyond`."""
    beyond: bool
    """The marker distance is larger than at the highest level: the torque errors are lower limits."""
    torques: pd.DataFrame
    """torque, grf, average, p10, p50, p90: RMS errors, %BW*H."""


def expect(table: pd.DataFrame, rms_mm: float, side: str = "l") -> tuple[CauseOfMarkerError, ...]:
    """JP and noise levels that correspond to a marker RMS (mm) of a leg, and the torque errors to expect there.

    Parameters
    ----------
    table : from `statistics`, with the sets `jp` or `noise` in it; a set that is not there is left out.
    side : whose markers and torques; left as published.
    """
    causes = (Varied.JP, Varied.NOISE)
    return tuple(_cause(table, varied, rms_mm, side) for varied in causes if (table["set"] == varied.value).any())


def _cause(table: pd.DataFrame, varied: Varied, rms_mm: float, side: str) -> CauseOfMarkerError:
    markers = levels_of(table, varied.value, f"markers_{side}")
    levels = np.concatenate([[0.0], markers["level"].to_numpy(dtype=float)])
    distance = np.maximum.accumulate(np.concatenate([[0.0], markers["average"].to_numpy()]))
    beyond = bool(rms_mm > distance[-1])
    level = float(np.interp(rms_mm, distance, levels))
    rows = []
    for frame in ReactionFrame:
        for torque in TORQUES:
            at = levels_of(table, varied.value, f"{torque}_{side}", frame.value)
            values = {c: float(np.interp(level, levels, [0.0, *at[c]])) for c in SHOWN}
            rows.append({"torque": f"{torque}_{side}", "grf": frame.value, **values})
    return CauseOfMarkerError(varied, level, beyond, pd.DataFrame(rows))
