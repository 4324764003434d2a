"""The error of a joint moment to expect from each source of a Monte Carlo study, the largest first."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import pandas as pd

from gaitcal.published.leg_torques import TORQUES
from gaitcal.published.settings import ReactionFrame, Varied
from gaitcal.published.statistics import CauseOfMarkerError, expect

SOURCE_WORDS: Final = {
    Varied.JP: "joint positions and axes",
    Varied.IP: "masses and inertia",
    Varied.BOTH: "joints, masses and inertia together",
    Varied.NOISE: "markers",
}
SOURCES: Final = (Varied.JP, Varied.IP, Varied.NOISE)
"""Those that are no sum of others."""


@dataclass(frozen=True, kw_only=True)
class Expected:
    """One source, RMS error over the trial in %BW·H."""

    varied: Varied
    level: float
    """Per cent of the bounds."""
    beyond: bool
    """The marker error is larger than at the highest level: the error is a lower limit."""
    average: float
    low: float
    """10 % of the draws are below."""
    high: float
    """10 % of the draws are above."""

    @property
    def words(self) -> str:
        """What is off."""
        return SOURCE_WORDS[self.varied]


Quantity = tuple[Varied, str, str, str]
"""What was varied; torque or markers; ground-reaction frame (empty for markers); measure."""


def levels_by_quantity(statistics: pd.DataFrame) -> dict[Quantity, list[dict[str, Any]]]:
    """The rows of each quantity with any draws, ordered by level."""
    out: dict[Quantity, list[dict[str, Any]]] = {}
    known = statistics[statistics["draws"] > 0].sort_values("level", kind="stable")
    for row in known.to_dict("records"):
        out.setdefault((Varied(row["set"]), row["quantity"], row["grf"], row["measure"]), []).append(row)
    return out


def expected_errors(
    statistics: pd.DataFrame, marker_rms: float | None, side: str
) -> dict[tuple[str, ReactionFrame], tuple[Expected, ...]]:
    """Torque (`knee_adduction_l`) of one leg and frame -> its sources; those that were not disturbed are left out.

    `marker_rms`: mm, where known joints and markers are as far off as would make it; else as far as was studied.
    """
    levels = levels_by_quantity(statistics)
    causes = {} if marker_rms is None else {c.varied: _of_cause(c) for c in expect(statistics, marker_rms, side)}
    out = {}
    for torque in (f"{name}_{side}" for name in TORQUES):
        for frame in ReactionFrame:
            found = []
            for varied in SOURCES:
                if varied in causes:
                    found.append(causes[varied][torque, frame.value])
                elif rows := levels.get((varied, torque, frame.value, "rms")):
                    found.append(_expected(varied, rows[-1]["level"], rows[-1]))
            out[torque, frame] = tuple(sorted(found, key=lambda e: -e.average))
    return out


def _of_cause(cause: CauseOfMarkerError) -> dict[tuple[str, str], Expected]:
    """Torque and frame -> its error if this cause alone has made the marker error."""
    return {
        (row["torque"], row["grf"]): _expected(cause.varied, cause.level, row, cause.beyond)
        for row in cause.torques.to_dict("records")
    }


def _expected(varied: Varied, level: float, row: Mapping[str, float], beyond: bool = False) -> Expected:
    return Expected(
        varied=varied,
        level=float(level),
        beyond=beyond,
        average=float(row["average"]),
        low=float(row["p10"]),
        high=float(row["p90"]),
    )
