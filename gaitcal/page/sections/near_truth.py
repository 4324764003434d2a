"""How near the truth: of a made-up person, of whom it is known.

How near the truth, as the report shows it: of a person of whom it is known.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from gaitcal.model.coordinates import coordinate_words, split_side
from gaitcal.page.sections.blocks import Block, Cell, cell, fold, heading, named, number, table, text
from gaitcal.session.result import Calibration
from gaitcal.session.truth_comparison import (
    CurveRow,
    TruthSum,
    compared_trials,
    curve_rows,
    not_compared_sentence,
    settings_sentence,
    sums,
    truth_sentence,
    turning_sentence,
)
from gaitcal.session.truth_errors import CurveTruth, FeatureTruth


@dataclass(frozen=True, kw_only=True)
class Errors:
    """RMS error, distance or angle, and how often the truth lies within 1.96 standard errors."""

    nominal: float
    fitted: float
    within: str
    """`2 of 3`, `98 %`; a dash without standard errors."""

    @property
    def farther(self) -> bool:
        """Calibration led away from the truth, by as much as the table shows."""
        return round(self.fitted, 1) > round(self.nominal, 1)


@dataclass(frozen=True)
class SidedRow:
    """One line of a table: both sides of the body."""

    words: str
    right: Errors | None
    left: Errors | None


@dataclass(frozen=True, kw_only=True)
class NearTruth:
    """What the section is filled with."""

    sentence: str
    settings: str
    """With which knowledge it was calibrated."""
    turning: str
    """Of segments whose turn about their own line no marker shows; may be empty."""
    not_compared: str
    """May be empty."""
    sums: tuple[TruthSum, ...]
    joints: tuple[SidedRow, ...]
    """Centres and axes, mm or deg."""
    angles: tuple[tuple[str, str, tuple[SidedRow, ...]], ...]
    """Trial, of which frames, and its rows, deg."""
    moments: tuple[tuple[str, tuple[SidedRow, ...]], ...]
    """Trial and its rows, N·m."""


def near_truth(calibration: Calibration) -> NearTruth | None:
    """None where the study names no truth: the page has no such section then."""
    truth = calibration.truth
    if truth is None:
        return None
    trials = {name: curve_rows(calibration, truth, name) for name in compared_trials(calibration, truth)}
    angles = {name: _sided_rows(_curves(row.angle for row in rows)) for name, rows in trials.items()}
    moments = {name: _sided_rows(_curves(row.moment for row in rows)) for name, rows in trials.items()}
    return NearTruth(
        sentence=truth_sentence(truth),
        settings=settings_sentence(calibration),
        turning=turning_sentence(calibration),
        not_compared=not_compared_sentence(truth),
        sums=sums(calibration, truth),
        joints=_sided_rows((f"{f.words}, {f.unit}", f.side, _of_feature(f)) for f in truth.features),
        angles=tuple((name, _frames(trials[name]), rows) for name, rows in angles.items() if rows),
        moments=tuple((name, rows) for name, rows in moments.items() if rows),
    )


def _frames(rows: Iterable[CurveRow]) -> str:
    """`all 415 frames`, or those that the truth has."""
    counts = {(int(row.angle.compared.sum()), len(row.angle.compared)) for row in rows if row.angle is not None}
    some, every = min(counts)
    return f"all {every} frames" if some == every else f"{some} of {every} frames, those of the true curves"


def _sided_rows(found: Iterable[tuple[str, str, Errors]]) -> tuple[SidedRow, ...]:
    """Rows of (words, side, errors), each side in its place."""
    rows: dict[str, dict[str, Errors]] = {}
    for words, side, errors in found:
        rows.setdefault(words, {})[side] = errors
    return tuple(SidedRow(words, sides.get("r"), sides.get("l")) for words, sides in rows.items())


def _curves(curves: Iterable[CurveTruth | None]) -> Iterable[tuple[str, str, Errors]]:
    for curve in curves:
        if curve is not None and curve.rms is not None and curve.nominal_rms is not None:
            share = curve.share_within
            within = "–" if share is None else f"{100 * share:.0f} %"
            errors = Errors(nominal=curve.nominal_rms, fitted=curve.rms, within=within)
            yield coordinate_words(curve.name).title, split_side(curve.name)[1], errors


def _of_feature(feature: FeatureTruth) -> Errors:
    within = f"{sum(feature.within)} of {len(feature.within)}" if feature.within else "–"
    return Errors(nominal=feature.nominal, fitted=feature.fitted, within=within)


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
