"""What the draws of a study say: distributions, whether there are enough of them, and what a marker error may mean.

Convergence (method, section 6): over the last 10 % of the draws the running mean and the running coefficient of
variation, CV = 100 SD / mean, stay within 2 % of their final values, for every torque's RMS error.

A person's marker distance is turned into the torque errors to expect (`expect`) as the published discussion does by
hand: a marker RMS of 4 mm corresponds to less than 25 % of the JP bounds, or to 50 % of the noise amplitude, and to the
torque errors there. Between levels, and from nothing at level zero, straight lines.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from gaitcal.arrays import Array
from gaitcal.model.linkage import SIDES
from gaitcal.published.draw import MEASURES, marker_column, torque_column
from gaitcal.published.leg_torques import LEG_TORQUES, TORQUES
from gaitcal.published.settings import ReactionFrame, Varied

PERCENTILES = (10, 25, 50, 75, 90)
TOLERANCE_PERCENT = 2.0
LAST_PART = 0.1
FEWEST = 20
"""Draws below which nothing is claimed: neither convergence nor a conclusion."""
EXPECTED = ("average", "p10", "p50", "p90")
"""Columns of `statistics` that are told of the errors to expect."""


def settling(values: Array) -> tuple[float, float]:
    """How far the running mean and CV of `values` (n,) are, over the last tenth, from their final values, per cent.

    In the order of the draws; NaN for too few.
    """
    n = len(values)
    if n < FEWEST:
        return np.nan, np.nan
    scale = float(np.abs(values).max()) or 1.0
    x, count = values / scale, np.arange(1, n + 1)
    mean = np.cumsum(x) / count
    spread = np.sqrt(np.maximum(np.cumsum(x * x) / count - mean**2, 0.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        cv = np.where(mean != 0.0, spread / mean, 0.0)
        last = slice(int(np.ceil(n * (1.0 - LAST_PART))) - 1, None)
        apart = [100.0 * np.abs(run[last] - run[-1]).max() / abs(run[-1]) if run[-1] else 0.0 for run in (mean, cv)]
    return float(apart[0]), float(apart[1])


def statistics(draws: pd.DataFrame) -> pd.DataFrame:
    """One row per set, level, quantity, ground-reaction frame and measure.

    `quantity` is a torque (`hip_flexion_l`; %BW*H) or the markers of a leg (`markers_l`; mm); `measure` is `rms`,
    `mean` (signed, over the frames of a draw) or `abs_mean`. Failed draws are counted in `failed` and left out of the
    distribution. `mean_settles`, `cv_settles` (per cent) are given for `rms`; see `settling`.
    """
    rows = [
        {"set": varied, "level": level, **row}
        for (varied, level), cell in draws.groupby(["set", "level"], sort=False)
        for row in _cell(cell)
    ]
    return pd.DataFrame(rows)


def _cell(cell: pd.DataFrame) -> list[dict[str, object]]:
    good = cell[cell["failure"] == ""]
    failed = len(cell) - len(good)
    rows = []
    for frame in ReactionFrame:
        for torque in LEG_TORQUES:
            for measure in (*MEASURES, "abs_mean"):
                values = good[torque_column(torque, frame, measure.removeprefix("abs_"))].to_numpy()
                rows.append({"quantity": torque, "grf": frame.value, **_distribution(measure, "%BW*H", values, failed)})
    for side in SIDES:
        for measure in MEASURES:
            values = good[marker_column(side, measure)].to_numpy()
            rows.append({"quantity": f"markers_{side}", "grf": "", **_distribution(measure, "mm", values, failed)})
    return rows


def _distribution(measure: str, unit: str, values: Array, failed: int) -> dict[str, object]:
    shown = np.abs(values) if measure == "abs_mean" else values
    row: dict[str, object] = {
        "measure": measure,
        "unit": unit,
        "draws": len(values),
        "failed": failed,
        "average": shown.mean() if len(shown) else np.nan,
        "sd": shown.std() if len(shown) else np.nan,
    }
    points = np.percentile(shown, PERCENTILES) if len(shown) else np.full(len(PERCENTILES), np.nan)
    row |= {f"p{p}": value for p, value in zip(PERCENTILES, points, strict=True)}
    if measure == "rms":
        row |= dict(zip(("mean_settles", "cv_settles"), settling(values), strict=True))
    return row


def unconverged(table: pd.DataFrame) -> pd.DataFrame:
    """Rows of `statistics` whose torque RMS does not meet the published criterion (or has too few draws to tell)."""
    torques = table[(table["measure"] == "rms") & table["grf"].ne("")]
    met = (torques["mean_settles"] <= TOLERANCE_PERCENT) & (torques["cv_settles"] <= TOLERANCE_PERCENT)
    return torques[~met]


def left_out(table: pd.DataFrame) -> pd.DataFrame:
    """Columns `set`, `level`, `draws` (in the distributions), `failed`: cells with draws that did not converge."""
    cells: pd.DataFrame = table[["set", "level", "draws", "failed"]].drop_duplicates(ignore_index=True)
    return cells[cells["failed"] > 0]


def levels_of(
    table: pd.DataFrame, varied: Varied, quantity: str, frame: ReactionFrame | None = None, measure: str = "rms"
) -> pd.DataFrame:
    """The rows of one quantity of a set, ordered by level; markers have no frame."""
    wanted = {"set": varied.value, "quantity": quantity, "grf": frame.value if frame else "", "measure": measure}
    return table[(table[list(wanted)] == list(wanted.values())).all(axis=1)].sort_values("level")


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
    markers = levels_of(table, varied, f"markers_{side}")
    levels = np.concatenate([[0.0], markers["level"].to_numpy(dtype=float)])
    distance = np.maximum.accumulate(np.concatenate([[0.0], markers["average"].to_numpy()]))
    beyond = bool(rms_mm > distance[-1])
    level = float(np.interp(rms_mm, distance, levels))
    rows = []
    for frame in ReactionFrame:
        for torque in TORQUES:
            errors = levels_of(table, varied, f"{torque}_{side}", frame)
            values = {c: float(np.interp(level, levels, [0.0, *errors[c]])) for c in EXPECTED}
            rows.append({"torque": f"{torque}_{side}", "grf": frame.value, **values})
    return CauseOfMarkerError(varied, level, beyond, pd.DataFrame(rows))
