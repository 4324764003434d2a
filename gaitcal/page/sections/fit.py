"""Preset Fit: how well the model follows the markers."""

from __future__ import annotations

from collections.abc import Sequence

from gaitcal.gait.words import segment_words
from gaitcal.model.linkage import LOWER_BODY, SEGMENTS
from gaitcal.page.sections.answers import Answer
from gaitcal.page.sections.blocks import (
    Block,
    Cell,
    bars,
    cards,
    cell,
    curves,
    heading,
    named,
    number,
    number_rounded,
    pair,
    table,
    text,
    words_column,
)
from gaitcal.page.sections.trial_rows import MarkerFit, TrialFit
from gaitcal.session.marker_fit import RmsErrors

FLOORS = (
    "A marker error is the distance between where a marker was measured and where the model puts it. The rigid-segment "
    "floor is the error that is left when every segment follows its own markers alone, without any joints: skin and "
    "loose markers make it, and no linkage of rigid segments can come below it. The joint floor is what is left when "
    "every joint follows the markers of its own segments alone, placed as suits this one trial: what lies between the "
    "two floors no place of a joint can mend, what lies above the joint floor another place, or other markers, may. A "
    "marker of several joints counts with their mean."
)
FIT_HEAD: tuple[Cell, ...] = ("Nominal", "Calibrated", "Rigid floor", "Ratio", "Joint floor", "Ratio")
PARTS = ("rigid-segment floor", "up to the joint floor", "above the joint floor")
BARS = (
    "RMS marker error of pelvis and legs with the calibrated model, in parts: no model of rigid segments can take away "
    "the first, no place of a joint the second; the third another place of the joint, or other markers, may."
)
NOTHING = "This study has no moving trial: nothing was fitted."


def fit_blocks(answers: Sequence[Answer], fits: Sequence[TrialFit]) -> list[Block]:
    """Of the whole result: the answers, the floors, and every trial in one table."""
    out = [_cards(answers)] if answers else []
    if not fits:
        return [*out, text(NOTHING)]
    rows = [
        [
            cell(named(fit.name), unit=fit.role),
            *fit_cells(fit.whole),
            number(fit.largest),
            cell(named(fit.largest_marker), align="text"),
        ]
        for fit in fits
    ]
    caption = (
        "RMS marker error in mm, over all markers; ratios of calibrated to either floor, and the largest single error."
    )
    return [
        *out,
        heading("How well the model follows the markers"),
        text(FLOORS),
        table(["Trial", *FIT_HEAD, "Largest", words_column("at marker")], rows, caption=caption),
        text(
            "Fit of each segment and marker: below, of the chosen trial. Every marker at each instant: marker_errors/ "
            "in the folder of the result.",
            "soft",
        ),
    ]


def _cards(answers: Sequence[Answer]) -> Block:
    return cards(
        {
            "question": answer.question,
            "value": answer.value,
            "verdict": answer.verdict,
            "tone": answer.tone,
            "text": f"Trial {named(answer.trial)}. {answer.text}" if answer.trial else answer.text,
        }
        for answer in answers
    )


def fit_cells(fit: RmsErrors) -> list[Cell]:
    """Nominal, calibrated, both floors, and the ratios to them."""
    return [
        number(fit.nominal),
        number(fit.calibrated),
        number(fit.floor),
        number(fit.ratio, 2),
        number(fit.joint_floor),
        number(fit.joint_ratio, 2),
    ]


def trial_fit_blocks(fit: TrialFit) -> list[Block]:
    """Of one trial: segments, markers, and the error over time."""
    rows = [[cell(segment.label), *fit_cells(segment)] for segment in fit.segments]
    first = len(rows)
    if not fit.joint:
        rows.append([cell("pelvis and legs"), *fit_cells(fit.legs)])
    rows.append([cell("all markers"), *fit_cells(fit.whole)])
    if fit.final:
        rows.append([cell("with the final model"), *fit_cells(fit.final)])
    segments: list[Block] = [table(["Segment, RMS in mm", *FIT_HEAD], rows, total=range(first, len(rows)))]
    if fit.few:
        few = (
            f"No ratio for {fit.few}: with fewer than three markers a segment can follow them nearly exactly, so that "
            "its floor says nothing."
        )
        segments.append(text(few, "soft"))
    shown, every = len(fit.worst), len(fit.markers)
    markers = [_marker_table(fit.worst)]
    if every > shown:
        note = f"The {shown} markers with the largest error, of {every}; those with little weight come last."
        markers.append(text(note, "soft"))
    out: list[Block] = [heading(f"Trial {named(fit.name)}, {fit.role}: marker errors")]
    if fit.joint:
        alone = (
            "Fitted with the segments of that joint only, so that no other joint has a say. “Calibrated” is right "
            "after these trials; the final model may differ where walking has moved the joint again."
        )
        out.append(text(alone, "soft"))
    out.append(curves(["marker_error"]))
    if shares := [_bar(segment) for segment in fit.segments if _is_shown(segment, fit)]:
        out += [text(BARS, "soft"), bars("mm", shares)]
    out.append(pair(segments, markers))
    if every > shown:
        out.append(_marker_table(fit.markers, f"All {every} markers of this trial"))
    return out


def _is_shown(segment: RmsErrors, fit: TrialFit) -> bool:
    """Segments of pelvis and legs, of which every part of the bar is known."""
    arms = [segment_words(s) for s in SEGMENTS if s not in LOWER_BODY]
    known = segment.rigid and None not in (segment.calibrated, segment.floor, segment.joint_floor)
    return known and (fit.joint is not None or segment.label not in arms)


def _bar(segment: RmsErrors) -> dict[str, object]:
    """As long as the calibrated error; from the left what skin makes, what joints ask for, and what is left."""
    total = segment.calibrated or 0.0
    rigid = min(segment.floor or 0.0, total)
    joint = min(max(segment.joint_floor or 0.0, rigid), total)
    parts = zip(PARTS, (rigid, joint - rigid, total - joint), strict=True)
    return {
        "label": segment.label,
        "total": number_rounded(total),
        "parts": [{"name": name, "value": number_rounded(value)} for name, value in parts],
    }


def _marker_table(markers: Sequence[MarkerFit], folded: str = "") -> Block:
    rows = [
        [
            cell(named(marker.label), unit=_marker_words(marker)),
            number(marker.nominal),
            number(marker.calibrated),
            number(marker.floor),
            number(marker.largest),
        ]
        for marker in markers
    ]
    return table(["Marker, RMS in mm", "Nominal", "Calibrated", "Floor", "Largest"], rows, fold=folded)


def _marker_words(marker: MarkerFit) -> str:
    if marker.weight <= 0.0:
        return f"{marker.segment}, no weight"
    return marker.segment if marker.weight >= 0.995 else f"{marker.segment}, weight {number(marker.weight, 2)}"
