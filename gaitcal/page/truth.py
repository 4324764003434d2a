"""How near the truth, as the report shows it: of a person of whom it is known."""

from __future__ import annotations

from dataclasses import dataclass

from gaitcal.person.result import Calibration
from gaitcal.person.truth_errors import FeatureTruth
from gaitcal.person.truth_words import CurveRow, TruthSum, compared_trials, curve_rows, sums, truth_sentence


@dataclass(frozen=True, kw_only=True)
class NearTruth:
    """What the section is filled with."""

    sentence: str
    sums: tuple[TruthSum, ...]
    features: tuple[FeatureTruth, ...]
    curves: tuple[tuple[str, tuple[CurveRow, ...]], ...]
    """Trial and its rows."""


def near_truth(calibration: Calibration) -> NearTruth | None:
    """None where the study names no truth: the page has no such section then."""
    truth = calibration.truth
    if truth is None:
        return None
    return NearTruth(
        sentence=truth_sentence(truth),
        sums=sums(calibration, truth),
        features=truth.features,
        curves=tuple((name, curve_rows(calibration, truth, name)) for name in compared_trials(calibration, truth)),
    )
