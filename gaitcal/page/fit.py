"""Preset Fit: how well the model follows the markers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gaitcal.gait.moments import listed, role_words, segment_words
from gaitcal.motion.motion import MarkerErrors
from gaitcal.page.plain_data import Block, Cell, beside, cell, curves, heading, named, number, table, text, words_column
from gaitcal.session.result import Calibration, TrialResult
from gaitcal.session.trial_result import RmsErrors, leg_fit, segment_fits, trial_fit

FLOORS = (
    "A marker error is the distance between where a marker was measured and where the model puts it. The rigid-segment "
    "floor is the error that is left when every segment follows its own markers alone, without any joints: skin and "
    "loose markers make it, and no linkage of rigid segments can come below it. The joint floor is what is left when "
    "every joint follows the markers of its own segments alone, placed as suits this one trial: what lies between the "
    "two floors no place of a joint can mend, what lies above the joint floor another place, or other markers, may. A "
    "marker of several joints counts with their mean."
)
FIT_HEAD: tuple[Cell, ...] = ("Nominal", "Calibrated", "Rigid floor", "Ratio", "Joint floor", "Ratio")

ELSEWHERE = (
    "Fit of each segment and marker: below, of the chosen trial. Every marker at each instant: marker_errors/ "
    "in the folder of the result."
)
ISOLATED = (
    "Fitted with the segments of that joint only, so that no other joint has a say. “Calibrated” is right "
    "after these trials; the final model may differ where walking has moved the joint again."
)
LITTLE_WEIGHT = 0.5
"""Part of the largest weight."""
SHOWN_CHANGE_M = 5e-5
"""Half of what the page shows."""
MARKERS_SHOWN = 6
"""With the largest errors; the rest is folded away."""


def fit_blocks(calibration: Calibration) -> list[Block]:
    """Of the whole result: the floors, and every trial in one table."""
    rows = []
    for trial in calibration.trials:
        largest = trial.calibrated.errors.largest()
        rows.append(
            [
                cell(named(trial.name), unit=role_words(trial.role, trial.joint)),
                *_fit_cells(trial_fit(trial)),
                number(1e3 * largest[0] if largest else None),
                cell(named(largest[1] if largest else ""), align="text"),
            ]
        )
    if not rows:
        return [text("This study has no moving trial: nothing was fitted.")]
    head: list[Cell] = ["Trial", *FIT_HEAD, "Largest", words_column("at marker")]
    caption = (
        "RMS marker error in mm, over all markers; ratios of calibrated to either floor, and the largest single error."
    )
    return [
        heading("How well the model follows the markers"),
        text(FLOORS),
        table(head, rows, caption=caption),
        text(ELSEWHERE, "soft"),
    ]


def _fit_cells(fit: RmsErrors) -> list[Cell]:
    """Nominal, calibrated, both floors, and the ratios to them."""
    return [
        number(fit.nominal),
        number(fit.calibrated),
        number(fit.floor),
        number(fit.ratio, 2),
        number(fit.joint_floor),
        number(fit.joint_ratio, 2),
    ]


def trial_fit_blocks(trial: TrialResult) -> list[Block]:
    """Of one trial: segments, markers, and the error over time."""
    segments, whole = segment_fits(trial), trial_fit(trial)
    rows = [[cell(segment.label), *_fit_cells(segment)] for segment in segments]
    sums = [[cell("all markers"), *_fit_cells(whole)]]
    if trial.joint is None:
        sums.insert(0, [cell("pelvis and legs"), *_fit_cells(leg_fit(trial))])
    calibrated, final = trial.calibrated.errors.rms(), trial.final.errors.rms()
    if calibrated is not None and final is not None and abs(final - calibrated) >= SHOWN_CHANGE_M:
        sums.append([cell("with the final model"), *_fit_cells(replace(whole, calibrated=1e3 * final))])
    total = range(len(rows), len(rows) + len(sums))
    left: list[Block] = [table(["Segment, RMS in mm", *FIT_HEAD], [*rows, *sums], total=total)]
    if few := listed([fit.label for fit in segments if not fit.rigid]):
        words = (
            f"No ratio for {few}: with fewer than three markers a segment can follow them nearly exactly, so that "
            "its floor says nothing."
        )
        left.append(text(words, "soft"))
    markers = marker_fits(trial)
    right = [_marker_table(markers[:MARKERS_SHOWN])]
    if len(markers) > MARKERS_SHOWN:
        note = f"The {MARKERS_SHOWN} markers with the largest error, of {len(markers)}"
        right.append(text(f"{note}; those with little weight come last.", "soft"))
    out: list[Block] = [heading(f"Trial {named(trial.name)}, {role_words(trial.role, trial.joint)}: marker errors")]
    if trial.joint is not None:
        out.append(text(ISOLATED, "soft"))
    out.append(curves(["marker_error"]))
    out += beside([left, right])
    if len(markers) > MARKERS_SHOWN:
        out.append(_marker_table(markers, f"All {len(markers)} markers of this trial"))
    return out


@dataclass(frozen=True, kw_only=True)
class MarkerFit:
    """How one marker is met, mm; None where it was not seen."""

    label: str
    segment: str
    weight: float
    nominal: float | None  # RMS
    calibrated: float | None  # RMS
    floor: float | None
    largest: float | None  # Largest distance with the calibrated model


def marker_fits(trial: TrialResult) -> list[MarkerFit]:
    """Largest error first, those with little weight last."""
    errors = trial.calibrated.errors
    nominal, calibrated, floor = map(_rms_by_label, (trial.nominal.errors, errors, trial.floor))
    heaviest = float(errors.weight.max(initial=0.0))
    rows = [
        MarkerFit(
            label=label,
            segment=segment_words(errors.segments[k]),
            weight=float(errors.weight[k]),
            nominal=nominal.get(label),
            calibrated=calibrated.get(label),
            floor=floor.get(label),
            largest=1e3 * float(np.nanmax(errors.distance[:, k])) if label in calibrated else None,
        )
        for k, label in enumerate(errors.labels)
    ]
    return sorted(rows, key=lambda m: (m.weight <= LITTLE_WEIGHT * heaviest, -(m.calibrated or 0.0)))


def _rms_by_label(errors: MarkerErrors) -> dict[str, float]:
    return {
        label: 1e3 * float(np.sqrt(np.nanmean(column**2)))
        for label, column in zip(errors.labels, errors.distance.T, strict=True)
        if np.isfinite(column).any()
    }


def _marker_table(markers: Sequence[MarkerFit], folded: str = "") -> Block:
    def words(marker: MarkerFit) -> str:
        if marker.weight <= 0.0:
            return f"{marker.segment}, no weight"
        return marker.segment if marker.weight >= 0.995 else f"{marker.segment}, weight {number(marker.weight, 2)}"

    rows = [
        [cell(named(m.label), unit=words(m)), *map(number, (m.nominal, m.calibrated, m.floor, m.largest))]
        for m in markers
    ]
    return table(["Marker, RMS in mm", "Nominal", "Calibrated", "Floor", "Largest"], rows, fold=folded)
