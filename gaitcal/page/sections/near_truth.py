"""How near the truth: of a made-up person, of whom it is known."""

from __future__ import annotations

from collections.abc import Sequence

from gaitcal.page.sections.blocks import Block, Cell, cell, fold, heading, named, number, table, text
from gaitcal.page.sections.truth_rows import Errors, NearTruth, SidedRow
from gaitcal.session.truth_words import TruthSum


def near_truth_blocks(near: NearTruth | None) -> list[Block]:
    """Nothing where the study names no truth."""
    if near is None:
        return []
    out = [
        heading("How near the truth"),
        text(
            "This person is made up, so that what a calibration should find is known: the study file names it. What "
            "pictures, tables and curves call truth is that; nothing of it was used to calibrate. "
            f"{near.settings} {near.sentence}"
        ),
        table(
            ["RMS error", "Over", "Nominal", "Calibrated", "Truth within ±1.96 SE"], [_sum(row) for row in near.sums]
        ),
    ]
    if near.turning:
        out.append(text(near.turning, "soft"))
    if near.not_compared:
        out.append(text(near.not_compared))
    if near.joints:
        explained = text(
            "Distance (mm) or angle (deg) from the true centre or axis; the place of an axis is where it crosses the "
            "segment from side to side. Within: for how many of its parameters the truth lies within ±1.96 standard "
            "errors. “Farther”: calibration led away from the truth.",
            "soft",
        )
        out += [heading("Joint centres and axes of the legs", 4), explained, _sided("Centre or axis", near.joints)]
    for trial, frames, rows in near.angles:
        words = f"RMS error over {frames}, deg, and in how many of them the truth lies within ±1.96 standard errors."
        out.append(
            fold(f"Joint angles of the legs, trial {named(trial)}", [text(words, "soft"), _sided("Angle, deg", rows)])
        )
    for trial, moments in near.moments:
        words = (
            "RMS error over the valid frames, N·m, and in how many of them the truth lies within ±1.96 standard errors."
        )
        title = f"Joint moments of the legs, trial {named(trial)}"
        out.append(fold(title, [text(words, "soft"), _sided("Moment, N·m", moments)]))
    files = "Every parameter and curve: folder truth of the result; “truth” in summary.json."
    return [*out, text(files, "soft")]


def _sum(row: TruthSum) -> list[Cell]:
    share = number(None) if row.share is None else f"{number(100.0 * row.share, 0)} %"
    return [
        cell(row.words, unit=row.unit),
        row.over,
        number(row.nominal, 2),
        _fitted(row.fitted, row.farther, 2),
        share,
    ]


def _fitted(value: float, farther: bool, digits: int = 1) -> Cell:
    return cell(f"farther: {number(value, digits)}", tone="look") if farther else number(value, digits)


def _sided(title: str, rows: Sequence[SidedRow]) -> Block:
    sides = [(side, words) for side, words in (("r", "Right"), ("l", "Left"))]
    head: list[Cell] = [title]
    for side, words in sides:
        head += [cell(f"{words}: nominal", side=side), cell("calibrated", side=side), cell("within", side=side)]
    return table(head, [[cell(row.words), *_errors(row.right), *_errors(row.left)] for row in rows])


def _errors(errors: Errors | None) -> list[Cell]:
    if errors is None:
        return [number(None)] * 3
    return [number(errors.nominal), _fitted(errors.fitted, errors.farther), errors.within]
