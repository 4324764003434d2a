"""Monte Carlo study in the preset Trust: ranked lists of expected errors.

The page exists before any draw. Blocks of a study carry a mark, so that a later run replaces them.
Only the command of the study imports this module and its libraries.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import pandas as pd

from gaitcal.gait.moments import SIDE_WORDS, capitalise, describe_parameter
from gaitcal.model.linkage import SIDES
from gaitcal.montecarlo.draw import TORQUE_LABELS, TORQUES
from gaitcal.montecarlo.draw_statistics import compute_variance_shares, estimate_expected_errors
from gaitcal.montecarlo.draw_study import MonteCarloStudy
from gaitcal.montecarlo.protocol import ReactionFrame, Varied
from gaitcal.report.page.key_figures import KNEE_ADDUCTION
from gaitcal.report.page.plain_data import (
    Block,
    fold_blocks,
    format_name,
    format_number,
    make_cell,
    make_heading,
    make_table,
    make_text,
    pair_blocks,
)

PART: Final = "montecarlo"  # Mark of the blocks of a study
PRESET: Final = "trust"
FIXED: Final = ReactionFrame.LAB  # Ground reactions stay where force plates measure them
SHOWN_SIDE: Final = "l"  # As published
MOST_PARAMETERS: Final = 6  # That the ranked list names
SOURCE_WORDS: Final = {
    Varied.JP: "joint positions and axes",
    Varied.IP: "masses and inertia",
    Varied.NOISE: "markers",
}
SOURCES: Final = (Varied.JP, Varied.IP, Varied.NOISE)  # Those that are no sum of others
OPEN: Final = (
    "More draws are needed: not every mean and spread stays within 2 % over the last tenth of the "
    "draws "
    "(gaitcal montecarlo --until-converged)."
)
BESIDE: Final = (
    "Percentiles of all draws, signed means, the shares of every parameter, and the same with "
    "ground reactions that "
    "move with the foot of the disturbed model (the published study does not specify which it "
    "used): tables and figures of montecarlo/ in the folder of the result."
)
Levels = dict[tuple[Varied, str, str, str], list[dict[str, Any]]]
"""What was varied; torque or markers; ground-reaction frame (empty for markers); measure -> rows,
ordered by level.
"""


@dataclass(frozen=True, kw_only=True)
class ExpectedError:
    """Error due to one source, RMS over the trial in %BW·H."""

    varied: Varied
    level: float  # Per cent of the bounds
    beyond: bool  # The marker error is larger than at the highest level: the error is a lower limit
    average: float
    low: float  # 10 % of the draws are below
    high: float  # 10 % of the draws are above


def _make_expected_error(
    varied: Varied, level: float, row: Mapping[str, Any], beyond: bool = False
) -> ExpectedError:
    average, low, high = (float(row[key]) for key in ("average", "p10", "p90"))
    return ExpectedError(
        varied=varied, level=float(level), beyond=beyond, average=average, low=low, high=high
    )


def _group_by_level(statistics: pd.DataFrame) -> Levels:
    """Group the rows of each quantity with draws, ordered by level."""
    out: Levels = {}
    known = statistics[statistics["draws"] > 0].sort_values("level", kind="stable")
    for row in known.to_dict("records"):
        out.setdefault(
            (Varied(row["set"]), row["quantity"], row["grf"], row["measure"]), []
        ).append(row)
    return out


def collect_expected_errors(
    statistics: pd.DataFrame, marker_rms: float | None, side: str
) -> dict[str, tuple[ExpectedError, ...]]:
    """Collect torque -> its error sources, largest first, with ground reactions as measured.

    `marker_rms`: mm, selects the level of joints and markers; None: the highest level studied.
    """
    levels = _group_by_level(statistics)
    causes = (
        {}
        if marker_rms is None
        else {
            cause.varied: cause for cause in estimate_expected_errors(statistics, marker_rms, side)
        }
    )
    of_cause = {
        (varied, row["torque"], row["grf"]): _make_expected_error(
            varied, cause.level, row, cause.beyond
        )
        for varied, cause in causes.items()
        for row in cause.torques.to_dict("records")
    }
    out = {}
    for torque in (f"{name}_{side}" for name in TORQUES):
        found = []
        # Joints and noise at the person's marker error; masses, which move no marker, at the
        # highest level.
        for varied in SOURCES:
            if varied in causes:
                found.append(of_cause[varied, torque, FIXED.value])
            elif rows := levels.get((varied, torque, FIXED.value, "rms")):
                found.append(_make_expected_error(varied, rows[-1]["level"], rows[-1]))
        out[torque] = tuple(sorted(found, key=lambda e: -e.average))
    return out


def add_monte_carlo(
    data: Mapping[str, Any],
    study: MonteCarloStudy,
    *,
    marker_rms: float | None = None,
    contributions: pd.DataFrame | None = None,
) -> dict[str, Any]:
    """Add a study to page data, in place of an earlier one.

    Parameters
    ----------
    data
        Page data.
    study
        The Monte Carlo study.
    marker_rms
        mm, of pelvis and legs in the trial of the study; None: unknown.
    contributions
        From `variance_contributions`; None: omitted.

    Returns
    -------
    dict
        Page data.
    """
    sections = dict(data.get("sections", {}))
    kept = [block for block in sections.get(PRESET, []) if block.get("part") != PART]
    new = [
        {**block, "part": PART}
        for block in build_monte_carlo_blocks(study, marker_rms, contributions)
    ]
    first = next((k for k, block in enumerate(kept) if block["kind"] == "heading"), len(kept))
    return {**data, "sections": {**sections, PRESET: [*kept[:first], *new, *kept[first:]]}}


def build_monte_carlo_blocks(
    study: MonteCarloStudy,
    marker_rms: float | None = None,
    contributions: pd.DataFrame | None = None,
) -> list[Block]:
    """Build the blocks of a study, the knee adduction moment first."""
    return [
        make_heading("What errors of model and markers do to the moments"),
        *_explain_study(study),
        *_rank_sources(study, marker_rms),
        *([] if contributions is None else _build_contributions(contributions, SHOWN_SIDE)),
        make_text(BESIDE, "soft"),
    ]


def _explain_study(study: MonteCarloStudy) -> list[Block]:
    s = study.settings
    out = [
        make_text(
            f"A Monte Carlo study of trial {format_name(study.case.name)}: this person's model and "
            "markers disturbed at "
            f"random, {format_number(study.plan.draws, 0)} times for each cause and level, and the "
            "motion fitted again each "
            "time. At a level of 100 % joint positions are off by up to "
            f"{format_number(s.position_mm, 0)} mm, joint axes by "
            f"up to {format_number(s.orientation_deg, 0)} degrees, masses, mass centres and "
            "moments of inertia by up to "
            f"{format_number(s.inertial_percent, 0)} %, and markers by waves of up to "
            f"{format_number(s.noise_mm, 0)} mm. Errors are "
            "RMS over the trial, in percent of body weight times height (%BW·H) and in N·m/kg."
        )
    ]
    if not study.converged:
        out.append(make_text(OPEN, "warning"))
    if study.failed:
        left = f"{format_number(study.failed, 0)} of {format_number(len(study.draws), 0)} draws"
        out.append(
            make_text(f"{left} did not converge and are left out of every figure below.", "warning")
        )
    return [*out, *(make_text(f"{note}.", "soft") for note in study.notes)]


def _rank_sources(study: MonteCarloStudy, marker_rms: float | None) -> list[Block]:
    """Rank the sources of each moment by their expected error."""
    meaning = "Each source by itself, at the highest level of the study."
    if marker_rms is not None:
        meaning = (
            "The calibrated model meets the markers of pelvis and legs to "
            f"{format_number(marker_rms)} mm. Joints and marker "
            "noise are given at the level at which each of them alone would cause that error. "
            "Masses and inertia have no effect on marker errors and are given at the highest level "
            "of the study."
        )
    errors: dict[str, tuple[ExpectedError, ...]] = {}
    for side in SIDES:
        errors |= collect_expected_errors(study.statistics, marker_rms, side)
    lists: dict[str, list[Block]] = {}
    for name in TORQUES:
        of_sides = {side: errors[f"{name}_{side}"] for side in SIDES}
        if tables := [
            [_build_source_table(study, side, found)] for side, found in of_sides.items() if found
        ]:
            lists[name] = pair_blocks(tables)
    if not lists:
        return []
    out = [make_text(meaning)]
    if first := lists.pop(KNEE_ADDUCTION, None):
        title = f"Expected error of your {TORQUE_LABELS[KNEE_ADDUCTION]} moment, RMS over the trial"
        out += [make_heading(title, 4), *first]
    others = [
        b
        for name, blocks in lists.items()
        for b in (make_heading(capitalise(TORQUE_LABELS[name]), 4), *blocks)
    ]
    return [*out, fold_blocks("Expected error of the other moments", others)]


def _build_source_table(
    study: MonteCarloStudy, side: str, errors: tuple[ExpectedError, ...]
) -> Block:
    subject, s = study.case.subject, study.settings
    to_kg = subject.bwh / 100.0 / subject.mass
    rows = []
    for e in errors:
        share = e.level / 100.0
        size = {
            Varied.JP: f"up to {format_number(share * s.position_mm)} mm and "
            f"{format_number(share * s.orientation_deg)} deg",
            Varied.IP: f"up to {format_number(share * s.inertial_percent, 0)} %",
            Varied.NOISE: f"waves of up to {format_number(share * s.noise_mm)} mm",
        }[e.varied]
        beyond = ", and more than that" if e.beyond else ""
        rows.append(
            [
                make_cell(f"{SOURCE_WORDS[e.varied]}: {size}{beyond}"),
                format_number(e.average, 2),
                format_number(to_kg * e.average, 3),
                f"{format_number(e.low, 2)} to {format_number(e.high, 2)}",
            ]
        )
    head = [
        make_cell(capitalise(SIDE_WORDS[side]), side=side),
        "%BW·H",
        "N·m/kg",
        "10 to 90 %, %BW·H",
    ]
    return make_table(head, rows)


def _build_contributions(contributions: pd.DataFrame, side: str) -> list[Block]:
    """Build the shares of the main parameters in the variance of the knee adduction moment."""
    of_leg, groups = compute_variance_shares(contributions, FIXED, side)
    shares = pd.concat([of_leg.rename(index=describe_parameter), groups])[
        f"{KNEE_ADDUCTION}_{side}"
    ]
    first = shares.sort_values(ascending=False, kind="stable").head(MOST_PARAMETERS)
    return [
        make_heading(
            f"Which parameter matters for the {SIDE_WORDS[side]} {TORQUE_LABELS[KNEE_ADDUCTION]} "
            "moment",
            4,
        ),
        make_table(
            ["Parameter", "% of the variance"],
            [[make_cell(title), format_number(value, 0)] for title, value in first.items()],
        ),
    ]
