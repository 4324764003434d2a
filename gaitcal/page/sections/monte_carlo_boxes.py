"""Boxplots of a Monte Carlo study, as figures 3 and 4 of the published one, and which parameter matters."""

from __future__ import annotations

from typing import Any, Final

import pandas as pd

from gaitcal.gait.words import SIDE_WORDS, capitalised, parameter_words
from gaitcal.page.sections.blocks import Block, boxes, cell, fold, heading, number, number_rounded, table, text
from gaitcal.page.sections.expected_errors import SOURCE_WORDS, Quantity, levels_by_quantity
from gaitcal.published.leg_torques import TORQUE_WORDS, TORQUES
from gaitcal.published.settings import ReactionFrame, Varied
from gaitcal.published.study import MonteCarloStudy
from gaitcal.published.variance_shares import variance_shares

Levels = dict[Quantity, list[dict[str, Any]]]
FIRST: Final = "knee_adduction"
MOST: Final = 6
"""Parameters that the ranked list names."""
QUARTERS: Final = {"low": "p10", "q1": "p25", "median": "p50", "q3": "p75", "high": "p90"}
FRAMES: Final = {ReactionFrame.LAB: "", ReactionFrame.FOOT: ", ground reactions carried with the foot"}
MEASURES: Final = (
    (
        "rms",
        "Size of the moment errors",
        "RMS error of each moment, and marker distance, by cause and level; as figure 3 of the published study.",
    ),
    (
        "mean",
        "Direction of the moment errors",
        "Mean error with its sign, near zero where errors cancel over the trial; as figure 4 of the published study.",
    ),
)
READ: Final = "Boxes from 25 to 75 % of the draws with the median in them, lines from 10 to 90 %."


def box_blocks(study: MonteCarloStudy, side: str) -> list[Block]:
    """All distributions of one leg behind folds: size and direction, ground reactions fixed or with the foot."""
    leg, levels, out = f"{SIDE_WORDS[side]} leg", levels_by_quantity(study.statistics), []
    for frame, words in FRAMES.items():
        for measure, title, told in MEASURES:
            shown = [text(f"{told} {READ}", "soft"), *_boxes(levels, frame, measure, side)]
            out.append(fold(f"{title}, {leg}{words}", shown))
    return [fold("Boxplots of all draws", out)]


def _boxes(levels: Levels, frame: ReactionFrame, measure: str, side: str) -> list[Block]:
    out = []
    for name in TORQUES:
        if groups := _groups(levels, f"{name}_{side}", frame.value, measure):
            out.append(boxes("%BW·H", capitalised(TORQUE_WORDS[name]), groups))
    if groups := _groups(levels, f"markers_{side}", "", measure):
        out.append(boxes("mm", "Marker distance", groups))
    return out


def _groups(levels: Levels, quantity: str, frame: str, measure: str) -> list[dict[str, Any]]:
    groups = []
    for varied in Varied:
        shown = [
            {"label": f"{row['level']:g} %"} | {key: number_rounded(row[of]) for key, of in QUARTERS.items()}
            for row in levels.get((varied, quantity, frame, measure), ())
        ]
        if shown:
            groups.append({"label": capitalised(SOURCE_WORDS[varied]), "boxes": shown})
    return groups


def contribution_blocks(contributions: pd.DataFrame, side: str) -> list[Block]:
    """Share of each parameter in the variance of each moment's error, the most important first."""
    shares = _shares(contributions, ReactionFrame.LAB, side)
    ranked = shares[f"{FIRST}_{side}"].sort_values(ascending=False, kind="stable").head(MOST)
    rows = [[cell(words), number(value, 0)] for words, value in ranked.items()]
    out = [
        heading(f"Which parameter matters for the {SIDE_WORDS[side]} {TORQUE_WORDS[FIRST]} moment", 4),
        table(["Parameter", "% of the variance"], rows),
    ]
    head = [cell(f"% of the variance, {SIDE_WORDS[side]}", side=side), *(TORQUE_WORDS[name] for name in TORQUES)]
    every_moment = []
    for frame, words in ((ReactionFrame.LAB, "fixed in the laboratory"), (ReactionFrame.FOOT, "carried with the foot")):
        every = _shares(contributions, frame, side)
        cells = [[cell(name), *(number(row[f"{t}_{side}"], 0) for t in TORQUES)] for name, row in every.iterrows()]
        caption = (
            "Share of each parameter in the variance of each moment's error at 100 % of the bounds, linearised; ground "
            f"reactions {words}."
        )
        every_moment.append(table(head, cells, caption=caption))
    return [*out, fold("Which parameter matters for every moment", every_moment)]


def _shares(contributions: pd.DataFrame, frame: ReactionFrame, side: str) -> pd.DataFrame:
    """`variance_shares` as one table, parameters in words."""
    of_leg, groups = variance_shares(contributions, frame, side)
    return pd.concat([of_leg.rename(index=parameter_words), groups])
