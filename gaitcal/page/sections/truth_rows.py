"""How near the truth, as the report shows it: of a person of whom it is known."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from gaitcal.model.coordinates import coordinate_words, split_side
from gaitcal.session.result import Calibration
from gaitcal.session.truth_errors import CurveTruth, FeatureTruth
from gaitcal.session.truth_words import (
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
    angles = {name: _sided(_curves(row.angle for row in rows)) for name, rows in trials.items()}
    moments = {name: _sided(_curves(row.moment for row in rows)) for name, rows in trials.items()}
    return NearTruth(
        sentence=truth_sentence(truth),
        settings=settings_sentence(calibration),
        turning=turning_sentence(calibration),
        not_compared=not_compared_sentence(truth),
        sums=sums(calibration, truth),
        joints=_sided((f"{f.words}, {f.unit}", f.side, _of_feature(f)) for f in truth.features),
        angles=tuple((name, _frames(trials[name]), rows) for name, rows in angles.items() if rows),
        moments=tuple((name, rows) for name, rows in moments.items() if rows),
    )


def _frames(rows: Iterable[CurveRow]) -> str:
    """`all 415 frames`, or those that the truth has."""
    counts = {(int(row.angle.compared.sum()), len(row.angle.compared)) for row in rows if row.angle is not None}
    some, every = min(counts)
    return f"all {every} frames" if some == every else f"{some} of {every} frames, those of the true curves"


def _sided(found: Iterable[tuple[str, str, Errors]]) -> tuple[SidedRow, ...]:
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
