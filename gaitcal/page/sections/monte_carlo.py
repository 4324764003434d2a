"""The Monte Carlo study of a person in the preset Trust: ranked lists of expected errors, boxplots behind a fold.

The page is made before any draw. Blocks of a study carry a mark, so that a study that goes on replaces its own.

Boxplots of a Monte Carlo study, as figures 3 and 4 of the published one, and which parameter matters.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import pandas as pd

from gaitcal.gait.moments import SIDE_WORDS, capitalised, parameter_words
from gaitcal.model.linkage import SIDES
from gaitcal.page.sections.blocks import (
    Block,
    boxes,
    cell,
    fold,
    heading,
    named,
    number,
    number_rounded,
    pair,
    table,
    text,
    visible,
)
from gaitcal.page.sections.error_bars import SOURCE_WORDS, Expected, Quantity, expected_errors, levels_by_quantity
from gaitcal.published.draw import TORQUE_WORDS, TORQUES
from gaitcal.published.protocol import ReactionFrame, Varied
from gaitcal.published.statistics import variance_shares
from gaitcal.published.study import MonteCarloStudy

Levels = dict[Quantity, list[dict[str, Any]]]
MONTE_CARLO_BOXES_FIRST: Final = "knee_adduction"
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


PART: Final = "montecarlo"
"""Mark of the blocks of a study."""
PRESET: Final = "trust"
FIRST: Final = "knee_adduction"
SHOWN_SIDE: Final = "l"
"""Of boxplots, as published."""


def with_monte_carlo(
    sheet: Mapping[str, Any],
    study: MonteCarloStudy,
    *,
    marker_rms: float | None = None,
    contributions: pd.DataFrame | None = None,
) -> dict[str, Any]:
    """The sheet with a study in it, in the place of an earlier one.

    Parameters
    ----------
    marker_rms : mm, of pelvis and legs in the trial of the study, to be read in torque errors; None: not known.
    contributions : from `variance_contributions`: which parameter matters; None leaves that out.
    """
    sections = dict(sheet.get("sections", {}))
    kept = [block for block in sections.get(PRESET, []) if block.get("part") != PART]
    new = [{**block, "part": PART} for block in monte_carlo_blocks(study, marker_rms, contributions)]
    first = next((k for k, block in enumerate(kept) if block["kind"] == "heading"), len(kept))
    return {**sheet, "sections": {**sections, PRESET: [*kept[:first], *new, *kept[first:]]}}


def monte_carlo_blocks(
    study: MonteCarloStudy, marker_rms: float | None = None, contributions: pd.DataFrame | None = None
) -> list[Block]:
    """What a study says, the knee's adduction moment first."""
    return [
        heading("What errors of model and markers do to the moments"),
        *_explained(study),
        *_ranked(study, marker_rms),
        *([] if contributions is None else contribution_blocks(contributions, SHOWN_SIDE)),
        *box_blocks(study, SHOWN_SIDE),
    ]


def _explained(study: MonteCarloStudy) -> list[Block]:
    s = study.settings
    out = [
        text(
            f"A Monte Carlo study of trial {named(study.case.name)}: this person's model and markers disturbed at "
            f"random, {number(study.plan.draws, 0)} times for each cause and level, and the motion fitted again each "
            f"time. At a level of 100 % joint positions are off by up to {number(s.position_mm, 0)} mm, joint axes by "
            f"up to {number(s.orientation_deg, 0)} degrees, masses, mass centres and moments of inertia by up to "
            f"{number(s.inertial_percent, 0)} %, and markers by waves of up to {number(s.noise_mm, 0)} mm. Errors are "
            "RMS over the trial, in percent of body weight times height (%BW·H) and in N·m/kg."
        )
    ]
    if not study.converged:
        out.append(
            text(
                "More draws are needed: not every mean and spread stays within 2 % over the last tenth of the draws "
                "(gaitcal montecarlo --until-converged).",
                "warning",
            )
        )
    if study.failed:
        left = f"{number(study.failed, 0)} of {number(len(study.draws), 0)} draws"
        out.append(text(f"{left} did not converge and are left out of every figure below.", "warning"))
    return [*out, *(text(f"{note}.", "soft") for note in study.notes)]


def _ranked(study: MonteCarloStudy, marker_rms: float | None) -> list[Block]:
    """For each moment its sources, the largest expected error first."""
    if marker_rms is None:
        meaning = "Each source by itself, at the highest level of the study."
    else:
        meaning = (
            f"The calibrated model meets the markers of pelvis and legs to {number(marker_rms)} mm. Joints and marker "
            "noise stand here at the level at which each by itself would have made that error, masses and inertia, "
            "which no marker error tells of, at the highest level of the study."
        )
    sides = {side: expected_errors(study.statistics, marker_rms, side) for side in SIDES}
    frames = {frame: _lists(study, sides, frame) for frame in ReactionFrame}
    found = frames[ReactionFrame.LAB]
    if not found:
        return []
    out = [text(meaning)]
    if first := found.pop(FIRST, None):
        out += [heading(f"Expected error of your {TORQUE_WORDS[FIRST]} moment, RMS over the trial", 4), *first]
    out.append(fold("Expected error of the other moments", _titled(found)))
    carried = text(
        "Ground reactions fixed in the laboratory, as above, stay where force plates measure them; carried with the "
        "foot, they move where a disturbed model puts the foot. The published study does not say which it used.",
        "soft",
    )
    title = "The same with the ground reactions carried along with the foot"
    return [*out, fold(title, [carried, *_titled(frames[ReactionFrame.FOOT])])]


def _titled(lists: Mapping[str, list[Block]]) -> list[Block]:
    return [b for name, blocks in lists.items() for b in (heading(capitalised(TORQUE_WORDS[name]), 4), *blocks)]


def _lists(
    study: MonteCarloStudy,
    sides: Mapping[str, Mapping[tuple[str, ReactionFrame], tuple[Expected, ...]]],
    frame: ReactionFrame,
) -> dict[str, list[Block]]:
    """Torque without its side -> right beside left."""
    out = {}
    for name in TORQUES:
        of_sides = {side: errors[f"{name}_{side}", frame] for side, errors in sides.items()}
        tables = [[_list(study, side, found)] for side, found in of_sides.items() if found]
        if tables:
            out[name] = [pair(*tables)] if len(tables) == 2 else tables[0]
    return out


def _list(study: MonteCarloStudy, side: str, errors: tuple[Expected, ...]) -> Block:
    subject = study.case.subject
    to_kg = subject.bwh / 100.0 / subject.mass
    rows = [
        [
            cell(_source(study, e)),
            number(e.average, 2),
            number(to_kg * e.average, 3),
            f"{number(e.low, 2)} to {number(e.high, 2)}",
        ]
        for e in errors
    ]
    head = [cell(capitalised(SIDE_WORDS[side]), side=side), "%BW·H", "N·m/kg", "10 to 90 %, %BW·H"]
    return table(head, rows)


def _source(study: MonteCarloStudy, e: Expected) -> str:
    s = study.settings
    share = e.level / 100.0
    size = {
        Varied.JP: f"up to {number(share * s.position_mm)} mm and {number(share * s.orientation_deg)} deg",
        Varied.IP: f"up to {number(share * s.inertial_percent, 0)} %",
        Varied.NOISE: f"waves of up to {number(share * s.noise_mm)} mm",
    }[e.varied]
    beyond = ", and more than that" if e.beyond else ""
    return visible(f"{e.words}: {size}{beyond}")
