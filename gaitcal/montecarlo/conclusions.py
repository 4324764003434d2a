"""The published conclusions, put to the test with our own numbers, for either frame of the ground reactions.

All compare mean RMS torque errors of one leg at the highest level studied (%BW*H). Limits are ours, except where the
paper names one. Fewer than `FEWEST` draws are not judged, nor is a difference that chance alone could bring about.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from gaitcal.montecarlo.leg_torques import TORQUES
from gaitcal.montecarlo.settings import MonteCarloSettings, ReactionFrame, Varied
from gaitcal.montecarlo.statistics import FEWEST, levels_of

Array = NDArray[np.float64]

IP_LIMIT = 0.25
"""%BW*H: the paper's own limit for inertial parameters at +-10 %; that of marker noise too, which the paper calls small
without a number."""
INTERACTION_LIMIT = 0.15
"""Relative difference of JP + IP and what both alone add up to that would be called an interaction."""
SAMPLING = 3.0
"""Standard errors of the averages within which chance lies. Where they are wider than `INTERACTION_LIMIT`, the draws
cannot tell an interaction from chance."""
TORQUE_WORDS = {
    "hip_flexion": "hip flexion",
    "hip_adduction": "hip adduction",
    "hip_rotation": "hip rotation",
    "knee_angle": "knee flexion",
    "knee_adduction": "knee adduction",
    "ankle_angle": "ankle dorsiflexion",
    "subtalar_angle": "subtalar inversion",
}


@dataclass(frozen=True)
class PublishedFigure:
    """A figure that the paper gives in prose."""

    varied: Varied
    torque: str
    inertial_percent: float
    value: float
    """%BW*H, mean RMS at 100 %."""


PUBLISHED = (
    PublishedFigure(Varied.JP, "hip_flexion", 10.0, 4.14),
    PublishedFigure(Varied.JP, "hip_adduction", 10.0, 1.06),
    PublishedFigure(Varied.JP, "knee_angle", 10.0, 0.92),
    PublishedFigure(Varied.IP, "hip_flexion", 50.0, 0.31),
)


@dataclass(frozen=True)
class Conclusion:
    """One claim, whether it holds here, and why."""

    claim: str
    frame: ReactionFrame
    holds: bool | None
    """None where the draws are too few to judge."""
    numbers: str
    """A sentence with the figures behind it."""
    draws: int
    """Draws that the smallest of its sets has, failed ones left out."""

    @property
    def verdict(self) -> str:
        """In words."""
        if self.holds is None:
            return f"not judged: {self.draws} draws"
        return "holds" if self.holds else "does not hold"


def beside(
    table: pd.DataFrame, figure: PublishedFigure, settings: MonteCarloSettings, side: str = "l"
) -> dict[ReactionFrame, float]:
    """Our mean RMS (%BW*H) for a published figure, in either frame; empty where the study did not look at it."""
    if figure.varied is Varied.IP and settings.inertial_percent != figure.inertial_percent:
        return {}
    found = {f: levels_of(table, figure.varied.value, f"{figure.torque}_{side}", f.value) for f in ReactionFrame}
    at_full = {frame: rows.loc[rows["level"] == 100, "average"] for frame, rows in found.items()}
    return {frame: float(rows.iloc[0]) for frame, rows in at_full.items() if len(rows)}


def conclusions(table: pd.DataFrame, side: str = "l") -> tuple[Conclusion, ...]:
    """The claims that the sets in `table` (from `statistics`) allow to test, both ground-reaction frames."""
    return tuple(found for frame in ReactionFrame for found in _of_frame(table, frame, side))


def top_errors(table: pd.DataFrame, varied: Varied, frame: ReactionFrame, side: str = "l") -> Array | None:
    """(7,) mean RMS errors (%BW*H) at the highest level, in the order of `TORQUES`; None where the set is absent."""
    found = [levels_of(table, varied.value, f"{torque}_{side}", frame.value) for torque in TORQUES]
    if any(rows.empty for rows in found):
        return None
    return np.array([float(rows["average"].iloc[-1]) for rows in found])


def _draws(table: pd.DataFrame, sets: Iterable[Varied], frame: ReactionFrame, side: str) -> int:
    """Draws behind the averages at the highest level, of the set that has the fewest."""
    last = (levels_of(table, varied.value, f"{TORQUES[0]}_{side}", frame.value).iloc[-1] for varied in sets)
    return min(int(row["draws"]) for row in last)


def _relative_error(table: pd.DataFrame, varied: Varied, frame: ReactionFrame, side: str) -> Array:
    """(7,) standard errors of the averages at the highest level, relative to them."""
    rows = [levels_of(table, varied.value, f"{torque}_{side}", frame.value).iloc[-1] for torque in TORQUES]
    return np.array([row["sd"] / row["average"] / np.sqrt(max(row["draws"], 1)) for row in rows])


def _of_frame(table: pd.DataFrame, frame: ReactionFrame, side: str) -> list[Conclusion]:
    jp, ip, both, noise = (top_errors(table, varied, frame, side) for varied in Varied)
    out: list[Conclusion] = []

    def conclude(
        claim: str, sets: tuple[Varied, ...], holds: np.bool_, numbers: str, *, told_apart: bool = True
    ) -> None:
        draws = _draws(table, sets, frame, side)
        judged = draws >= FEWEST and told_apart
        out.append(Conclusion(claim, frame, bool(holds) if judged else None, numbers, draws))

    if jp is not None and ip is not None:
        numbers = f"JP / IP, torque by torque: {_range(jp / ip)}; mean over torques {jp.mean():.3f} and {ip.mean():.3f}"
        conclude("joint parameters dominate", (Varied.JP, Varied.IP), (jp > ip).all(), numbers + " %BW*H")
    if ip is not None:
        numbers = f"largest IP error {ip.max():.3f} %BW*H ({_name(ip.argmax())}), limit {IP_LIMIT}{_moved(table, side)}"
        conclude("inertial parameters matter little", (Varied.IP,), ip.max() < IP_LIMIT, numbers)
    if jp is not None and both is not None and ip is not None:
        apart = both / np.hypot(jp, ip) - 1.0
        chance = SAMPLING * np.hypot(
            *(_relative_error(table, varied, frame, side) for varied in (Varied.JP, Varied.BOTH))
        )
        numbers = (
            f"JP + IP against JP: {_range(both / jp)}; against the root of the sum of squares, as without "
            f"interaction: {_range(1.0 + apart)}, limit {1 - INTERACTION_LIMIT:g} to {1 + INTERACTION_LIMIT:g}, chance "
            f"{chance.max():.2f}"
        )
        little = (np.abs(apart) < INTERACTION_LIMIT).all()
        sure = bool((chance < INTERACTION_LIMIT).all())
        conclude("no interaction", (Varied.JP, Varied.IP, Varied.BOTH), little, numbers, told_apart=sure)
    if jp is not None and noise is not None:
        numbers = (
            f"noise / JP: {_range(noise / jp)}; largest noise error {noise.max():.3f} %BW*H "
            f"({_name(noise.argmax())}), limit {IP_LIMIT}"
        )
        little = (noise < jp).all() & (noise.max() < IP_LIMIT)
        conclude("marker noise matters little", (Varied.JP, Varied.NOISE), little, numbers)
    return out


def _moved(table: pd.DataFrame, side: str) -> str:
    markers = levels_of(table, Varied.IP.value, f"markers_{side}")
    return f"; markers move {markers['average'].iloc[-1]:.3g} mm" if len(markers) else ""


def _range(values: Array) -> str:
    low, high = int(np.argmin(values)), int(np.argmax(values))
    return f"{values[low]:.2f} ({_name(low)}) to {values[high]:.2f} ({_name(high)})"


def _name(torque: np.intp | int) -> str:
    return TORQUE_WORDS[TORQUES[int(torque)]]
