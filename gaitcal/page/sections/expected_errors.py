"""The error of a joint moment to expect from each source of a Monte Carlo study, the largest first."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import pandas as pd

from gaitcal.montecarlo.settings import ReactionFrame, Varied
from gaitcal.montecarlo.statistics import expect, levels_of

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


def expected_errors(
    statistics: pd.DataFrame, torque: str, frame: ReactionFrame, marker_rms: float | None
) -> tuple[Expected, ...]:
    """Of one torque (`knee_adduction_l`); sources that the study did not disturb are left out.

    `marker_rms`: mm, where known joints and markers are as far off as would make it; else as far as was studied.
    """
    found = {} if marker_rms is None else _by_marker_error(statistics, torque, frame, marker_rms)
    out = [e for varied in SOURCES if (e := found.get(varied) or _highest(statistics, torque, frame, varied))]
    return tuple(sorted(out, key=lambda e: -e.average))


def _by_marker_error(
    statistics: pd.DataFrame, torque: str, frame: ReactionFrame, marker_rms: float
) -> dict[Varied, Expected]:
    out = {}
    for cause in expect(statistics, marker_rms, torque[-1]):
        of = cause.torques
        row = of[(of["torque"] == torque) & (of["grf"] == frame.value)].iloc[0]
        out[cause.varied] = Expected(
            varied=cause.varied,
            level=cause.level,
            beyond=cause.beyond,
            average=float(row["average"]),
            low=float(row["p10"]),
            high=float(row["p90"]),
        )
    return out


def _highest(statistics: pd.DataFrame, torque: str, frame: ReactionFrame, varied: Varied) -> Expected | None:
    rows = levels_of(statistics, varied, torque, frame)
    rows = rows[rows["draws"] > 0]
    if rows.empty:
        return None
    row = rows.iloc[-1]
    return Expected(
        varied=varied,
        level=float(row["level"]),
        beyond=False,
        average=float(row["average"]),
        low=float(row["p10"]),
        high=float(row["p90"]),
    )
