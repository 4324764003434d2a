"""The Monte Carlo study of a person in the preset Trust: ranked lists of expected errors, percentiles behind a fold.

The page is made before any draw: blocks of a study carry a
mark, so that a study that goes on replaces its own. Only its command reads this module, and with it the libraries of a
study.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import pandas as pd

from gaitcal.gait.moments import SIDE_WORDS, capitalised, parameter_words
from gaitcal.model.linkage import SIDES
from gaitcal.page.plain_data import Block, Cell, beside, cell, fold, heading, named, number, table, text
from gaitcal.page.summary import KNEE_ADDUCTION
from gaitcal.published.draw import TORQUE_WORDS, TORQUES
from gaitcal.published.protocol import ReactionFrame, Varied
from gaitcal.published.statistics import expect, variance_shares
from gaitcal.published.study import MonteCarloStudy

PART: Final = "montecarlo"
"""Mark of the blocks of a study."""
PRESET: Final = "trust"
SHOWN_SIDE: Final = "l"
"""As published."""
MOST_PARAMETERS: Final = 6
"""That the ranked list names."""
SOURCE_WORDS: Final = {
    Varied.JP: "joint positions and axes",
    Varied.IP: "masses and inertia",
    Varied.BOTH: "joints, masses and inertia together",
    Varied.NOISE: "markers",
}
SOURCES: Final = (Varied.JP, Varied.IP, Varied.NOISE)
"""Those that are no sum of others."""
PERCENTILES: Final = {"10 %": "p10", "25 %": "p25", "Median": "p50", "75 %": "p75", "90 %": "p90"}
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
CARRIED: Final = (
    "Ground reactions fixed in the laboratory, as above, stay where force plates measure them; carried with the "
    "foot, they move where a disturbed model puts the foot. The published study does not say which it used."
)
OPEN: Final = (
    "More draws are needed: not every mean and spread stays within 2 % over the last tenth of the draws "
    "(gaitcal montecarlo --until-converged)."
)
Levels = dict[tuple[Varied, str, str, str], list[dict[str, Any]]]
"""What was varied; torque or markers; ground-reaction frame (empty for markers); measure -> rows, ordered by level."""


@dataclass(frozen=True, kw_only=True)
class ExpectedError:
    """From one source, RMS over the trial in %BW·H."""

    varied: Varied
    level: float  # Per cent of the bounds
    beyond: bool  # The marker error is larger than at the highest level: the error is a lower limit
    average: float
    low: float  # 10 % of the draws are below
    high: float  # 10 % of the draws are above


def _expected(varied: Varied, level: float, row: Mapping[str, Any], beyond: bool = False) -> ExpectedError:
    average, low, high = (float(row[key]) for key in ("average", "p10", "p90"))
    return ExpectedError(varied=varied, level=float(level), beyond=beyond, average=average, low=low, high=high)


def _levels(statistics: pd.DataFrame) -> Levels:
    """The rows of each quantity with any draws."""
    out: Levels = {}
    known = statistics[statistics["draws"] > 0].sort_values("level", kind="stable")
    for row in known.to_dict("records"):
        out.setdefault((Varied(row["set"]), row["quantity"], row["grf"], row["measure"]), []).append(row)
    return out


def expected_errors(
    statistics: pd.DataFrame, marker_rms: float | None, side: str
) -> dict[tuple[str, ReactionFrame], tuple[ExpectedError, ...]]:
    """Torque (`knee_adduction_l`) of one leg and frame -> its sources, largest first, without undisturbed ones.

    `marker_rms`: mm, where known joints and markers are as far off as would make it; else as far as was studied.
    """
    levels = _levels(statistics)
    causes = {} if marker_rms is None else {cause.varied: cause for cause in expect(statistics, marker_rms, side)}
    of_cause = {
        (varied, row["torque"], row["grf"]): _expected(varied, cause.level, row, cause.beyond)
        for varied, cause in causes.items()
        for row in cause.torques.to_dict("records")
    }
    out = {}
    for torque in (f"{name}_{side}" for name in TORQUES):
        for frame in ReactionFrame:
            found = []
            for varied in SOURCES:
                if varied in causes:
                    found.append(of_cause[varied, torque, frame.value])
                elif rows := levels.get((varied, torque, frame.value, "rms")):
                    found.append(_expected(varied, rows[-1]["level"], rows[-1]))
            out[torque, frame] = tuple(sorted(found, key=lambda e: -e.average))
    return out


def with_monte_carlo(
    data: Mapping[str, Any],
    study: MonteCarloStudy,
    *,
    marker_rms: float | None = None,
    contributions: pd.DataFrame | None = None,
) -> dict[str, Any]:
    """The page's data with a study in it, in the place of an earlier one.

    Parameters
    ----------
    marker_rms : mm, of pelvis and legs in the trial of the study, to be read in torque errors; None: not known.
    contributions : from `variance_contributions`: which parameter matters; None leaves that out.
    """
    sections = dict(data.get("sections", {}))
    kept = [block for block in sections.get(PRESET, []) if block.get("part") != PART]
    new = [{**block, "part": PART} for block in monte_carlo_blocks(study, marker_rms, contributions)]
    first = next((k for k, block in enumerate(kept) if block["kind"] == "heading"), len(kept))
    return {**data, "sections": {**sections, PRESET: [*kept[:first], *new, *kept[first:]]}}


def monte_carlo_blocks(
    study: MonteCarloStudy, marker_rms: float | None = None, contributions: pd.DataFrame | None = None
) -> list[Block]:
    """What a study says, the knee's adduction moment first."""
    return [
        heading("What errors of model and markers do to the moments"),
        *_explained(study),
        *_ranked(study, marker_rms),
        *([] if contributions is None else _contributions(contributions, SHOWN_SIDE)),
        _distributions(study, SHOWN_SIDE),
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
        out.append(text(OPEN, "warning"))
    if study.failed:
        left = f"{number(study.failed, 0)} of {number(len(study.draws), 0)} draws"
        out.append(text(f"{left} did not converge and are left out of every figure below.", "warning"))
    return [*out, *(text(f"{note}.", "soft") for note in study.notes)]


def _ranked(study: MonteCarloStudy, marker_rms: float | None) -> list[Block]:
    """For each moment its sources, the largest expected error first."""
    meaning = "Each source by itself, at the highest level of the study."
    if marker_rms is not None:
        meaning = (
            f"The calibrated model meets the markers of pelvis and legs to {number(marker_rms)} mm. Joints and marker "
            "noise stand here at the level at which each by itself would have made that error, masses and inertia, "
            "which no marker error tells of, at the highest level of the study."
        )
    errors: dict[tuple[str, ReactionFrame], tuple[ExpectedError, ...]] = {}
    for side in SIDES:
        errors |= expected_errors(study.statistics, marker_rms, side)
    lists: dict[ReactionFrame, dict[str, list[Block]]] = {}
    for frame in ReactionFrame:
        lists[frame] = {}
        for name in TORQUES:
            of_sides = {side: errors[f"{name}_{side}", frame] for side in SIDES}
            if tables := [[_source_table(study, side, found)] for side, found in of_sides.items() if found]:
                lists[frame][name] = beside(tables)
    fixed = lists[ReactionFrame.LAB]
    if not fixed:
        return []
    out = [text(meaning)]
    if first := fixed.pop(KNEE_ADDUCTION, None):
        title = f"Expected error of your {TORQUE_WORDS[KNEE_ADDUCTION]} moment, RMS over the trial"
        out += [heading(title, 4), *first]
    out.append(fold("Expected error of the other moments", _titled(fixed)))
    title = "The same with the ground reactions carried along with the foot"
    return [*out, fold(title, [text(CARRIED, "soft"), *_titled(lists[ReactionFrame.FOOT])])]


def _titled(lists: Mapping[str, list[Block]]) -> list[Block]:
    return [b for name, blocks in lists.items() for b in (heading(capitalised(TORQUE_WORDS[name]), 4), *blocks)]


def _source_table(study: MonteCarloStudy, side: str, errors: tuple[ExpectedError, ...]) -> Block:
    subject, s = study.case.subject, study.settings
    to_kg = subject.bwh / 100.0 / subject.mass
    rows = []
    for e in errors:
        share = e.level / 100.0
        size = {
            Varied.JP: f"up to {number(share * s.position_mm)} mm and {number(share * s.orientation_deg)} deg",
            Varied.IP: f"up to {number(share * s.inertial_percent, 0)} %",
            Varied.NOISE: f"waves of up to {number(share * s.noise_mm)} mm",
        }[e.varied]
        beyond = ", and more than that" if e.beyond else ""
        rows.append(
            [
                cell(f"{SOURCE_WORDS[e.varied]}: {size}{beyond}"),
                number(e.average, 2),
                number(to_kg * e.average, 3),
                f"{number(e.low, 2)} to {number(e.high, 2)}",
            ]
        )
    head = [cell(capitalised(SIDE_WORDS[side]), side=side), "%BW·H", "N·m/kg", "10 to 90 %, %BW·H"]
    return table(head, rows)


def _contributions(contributions: pd.DataFrame, side: str) -> list[Block]:
    """Share of each parameter in the variance of each moment's error, the most important first."""
    shares = {frame: _shares(contributions, frame, side) for frame in ReactionFrame}
    first = shares[ReactionFrame.LAB][f"{KNEE_ADDUCTION}_{side}"].sort_values(ascending=False, kind="stable")
    rows = [[cell(words), number(value, 0)] for words, value in first.head(MOST_PARAMETERS).items()]
    head = [cell(f"% of the variance, {SIDE_WORDS[side]}", side=side), *(TORQUE_WORDS[name] for name in TORQUES)]
    every = []
    for frame, words in ((ReactionFrame.LAB, "fixed in the laboratory"), (ReactionFrame.FOOT, "carried with the foot")):
        caption = (
            "Share of each parameter in the variance of each moment's error at 100 % of the bounds, linearised; ground "
            f"reactions {words}."
        )
        cells = [
            [cell(name), *(number(row[f"{torque}_{side}"], 0) for torque in TORQUES)]
            for name, row in shares[frame].iterrows()
        ]
        every.append(table(head, cells, caption=caption))
    return [
        heading(f"Which parameter matters for the {SIDE_WORDS[side]} {TORQUE_WORDS[KNEE_ADDUCTION]} moment", 4),
        table(["Parameter", "% of the variance"], rows),
        fold("Which parameter matters for every moment", every),
    ]


def _shares(contributions: pd.DataFrame, frame: ReactionFrame, side: str) -> pd.DataFrame:
    """`variance_shares` as one table, parameters in words."""
    of_leg, groups = variance_shares(contributions, frame, side)
    return pd.concat([of_leg.rename(index=parameter_words), groups])


def _distributions(study: MonteCarloStudy, side: str) -> Block:
    """All distributions of one leg behind folds: size and direction, ground reactions fixed or with the foot."""
    leg, levels, out = f"{SIDE_WORDS[side]} leg", _levels(study.statistics), []
    quantities = [(f"{name}_{side}", "%BW·H", capitalised(TORQUE_WORDS[name])) for name in TORQUES]
    for frame, words in FRAMES.items():
        for measure, title, meaning in MEASURES:
            shown = [text(meaning, "soft")]
            for quantity, unit, name in quantities:
                shown += _percentiles(levels, quantity, frame.value, measure, unit, name)
            shown += _percentiles(levels, f"markers_{side}", "", measure, "mm", "Marker distance")
            out.append(fold(f"{title}, {leg}{words}", shown))
    return fold("Percentiles of all draws", out)


def _percentiles(levels: Levels, quantity: str, frame: str, measure: str, unit: str, title: str) -> list[Block]:
    """Of one quantity: a row for each cause and level; nothing where there are no draws."""
    rows: list[list[Cell]] = [
        [
            f"{capitalised(SOURCE_WORDS[varied])}, {row['level']:g} %",
            *(number(row[of], 2) for of in PERCENTILES.values()),
        ]
        for varied in Varied
        for row in levels.get((varied, quantity, frame, measure), ())
    ]
    return [table([f"{title}, {unit}", *PERCENTILES], rows)] if rows else []
