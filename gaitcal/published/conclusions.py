"""The published conclusions, put to the test with our own numbers, for either frame of the ground reactions.

All compare mean RMS torque errors of one leg at the highest level studied (%BW*H). Limits are ours, except where the
paper names one. Fewer than `FEWEST` draws are not judged, nor is a difference that chance alone could bring about.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from gaitcal.arrays import Array
from gaitcal.published.leg_torques import TORQUE_WORDS, TORQUES
from gaitcal.published.settings import MonteCarloSettings, ReactionFrame, Varied
from gaitcal.published.statistics import FEWEST, levels_of

IP_LIMIT = 0.25
"""%BW*H: the paper's own limit for inertial parameters at +-10 %; that of marker noise too, which the paper calls small
without a number."""
INTERACTION_LIMIT = 0.15
"""Relative difference of JP + IP and what both alone add up to that would be called an interaction."""
SAMPLING = 3.0
"""Standard errors of the averages within which chance lies. Where they are wider than `INTERACTION_LIMIT`, the draws
cannot tell an interaction from chance."""


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


@dataclass(frozen=True, kw_only=True)
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
    levels = {frame: levels_of(table, figure.varied, f"{figure.torque}_{side}", frame) for frame in ReactionFrame}
    at_full = {frame: rows.loc[rows["level"] == 100, "average"] for frame, rows in levels.items()}
    return {frame: float(rows.iloc[0]) for frame, rows in at_full.items() if len(rows)}


def conclusions(table: pd.DataFrame, side: str = "l") -> tuple[Conclusion, ...]:
    """The claims that the sets in `table` (from `statistics`) allow to test, both ground-reaction frames."""
    return tuple(conclusion for frame in ReactionFrame for conclusion in _of_frame(table, frame, side))


def top_errors(table: pd.DataFrame, varied: Varied, frame: ReactionFrame, side: str = "l") -> Array | None:
    """(7,) mean RMS errors (%BW*H) at the highest level, in the order of `TORQUES`; None where the set is absent."""
    rows = _top_rows(table, varied, frame, side)
    return rows["average"].to_numpy(dtype=float) if len(rows) == len(TORQUES) else None


def _top_rows(table: pd.DataFrame, varied: Varied, frame: ReactionFrame, side: str) -> pd.DataFrame:
    """Statistics of the torques of a leg at the highest level, in the order of `TORQUES`."""
    return pd.concat([levels_of(table, varied, f"{torque}_{side}", frame).tail(1) for torque in TORQUES])


def _relative_error(rows: pd.DataFrame) -> Array:
    """(7,) standard errors of averages, relative to them."""
    out: Array = (rows["sd"] / rows["average"] / np.sqrt(rows["draws"].clip(lower=1))).to_numpy()
    return out


def _of_frame(table: pd.DataFrame, frame: ReactionFrame, side: str) -> list[Conclusion]:
    jp, ip, both, noise = (top_errors(table, varied, frame, side) for varied in Varied)
    out: list[Conclusion] = []

    def conclude(
        claim: str, sets: tuple[Varied, ...], holds: np.bool_, numbers: str, *, told_apart: bool = True
    ) -> None:
        draws = min(int(_top_rows(table, varied, frame, side)["draws"].iloc[0]) for varied in sets)
        verdict = bool(holds) if draws >= FEWEST and told_apart else None
        out.append(Conclusion(claim=claim, frame=frame, holds=verdict, numbers=numbers, draws=draws))

    if jp is not None and ip is not None:
        numbers = f"JP / IP, torque by torque: {_range(jp / ip)}; mean over torques {jp.mean():.3f} and {ip.mean():.3f}"
        conclude("joint parameters dominate", (Varied.JP, Varied.IP), (jp > ip).all(), numbers + " %BW*H")
    if ip is not None:
        numbers = f"largest IP error {ip.max():.3f} %BW*H ({_name(ip.argmax())}), limit {IP_LIMIT}{_moved(table, side)}"
        conclude("inertial parameters matter little", (Varied.IP,), ip.max() < IP_LIMIT, numbers)
    if jp is not None and both is not None and ip is not None:
        apart = both / np.hypot(jp, ip) - 1.0
        tops = (_top_rows(table, varied, frame, side) for varied in (Varied.JP, Varied.BOTH))
        chance = SAMPLING * np.hypot(*map(_relative_error, tops))
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
    markers = levels_of(table, Varied.IP, f"markers_{side}")
    return f"; markers move {markers['average'].iloc[-1]:.3g} mm" if len(markers) else ""


def _range(values: Array) -> str:
    low, high = int(np.argmin(values)), int(np.argmax(values))
    return f"{values[low]:.2f} ({_name(low)}) to {values[high]:.2f} ({_name(high)})"


def _name(torque: np.intp | int) -> str:
    return TORQUE_WORDS[TORQUES[int(torque)]]
