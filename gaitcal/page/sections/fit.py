"""Preset Fit: how well the model follows the markers.

Further trials of a calibrated person: the lines on top, and what is known of the model that they were taken through.

What the calibration's own page tells of joints and provenance is told again, as that of the calibration; what speaks
of one recording stands with it, so that trials of several runs can be joined.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from gaitcal.gait.moments import role_words, segment_words
from gaitcal.model.linkage import LOWER_BODY, SEGMENTS
from gaitcal.model.subject_model import SubjectModel
from gaitcal.page.sections.blocks import (
    Block,
    Cell,
    Sections,
    bars,
    cards,
    cell,
    curves,
    fold,
    heading,
    named,
    number,
    number_rounded,
    pair,
    table,
    text,
    words_column,
)
from gaitcal.page.sections.provenance import Line, agreement_line, counting_line, note_blocks
from gaitcal.page.sections.summary import Answer, gait_numbers
from gaitcal.page.sections.trust import MarkerFit, TrialFit, file_name
from gaitcal.session.result import TrialResult
from gaitcal.session.trial_result import RmsErrors

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


COPIED: Final = ("clinician", "joints", "provenance")
"""Presets of the calibration's page that are told again."""
OF_CALIBRATION: Final = "Of the calibration, not of these trials:"
EDITED: Final = "The model, or another file of the result, was edited since: what is told of it below may not hold."
NOT_KNOWN: Final = "The page of the calibration cannot be read: its summary.json and manifest.json tell what was done."


@dataclass(frozen=True)
class Origin:
    """The calibration that further trials come after."""

    sheet: Mapping[str, Any]
    """Of its page; empty where it cannot be read."""
    edited: bool
    """One of its files is not as it was written."""


def further_lines(model: SubjectModel, trials: Sequence[TrialResult]) -> tuple[Line, ...]:
    """How these trials agree with the model, and what of their moments counts: below the line of the verdict."""
    walks = [walk for trial in trials if (walk := gait_numbers(model, trial)) is not None]
    return agreement_line(trials, walks), counting_line(model.subject.mass, walks)


def further_sections(origin: Origin) -> Sections:
    """Of the calibration, for the page of its further trials."""
    told = origin.sheet.get("sections")
    known = told if isinstance(told, Mapping) else {}
    sections: Sections = {preset: list(known.get(preset) or ()) for preset in COPIED}
    edited = [text(EDITED, "warning")] if origin.edited else []
    if joints := sections["joints"]:
        sections["joints"] = [*edited, text(OF_CALIBRATION, "soft"), *joints]
    whole = sections["provenance"]
    folded = [fold("Recordings, phases, settings and versions of the calibration", whole)] if whole else []
    sections["provenance"] = [*_model(origin), *edited, *folded]
    return {preset: blocks for preset, blocks in sections.items() if blocks}


def _model(origin: Origin) -> list[Block]:
    """Whose calibration, when, and how far it can be believed."""
    sheet = origin.sheet
    out = [heading("The model of these trials")]
    try:
        judgement, sentence = sheet["verdict"]["judgement"], sheet["verdict"]["sentence"]
        made = f"Calibrated on {sheet['made']} with {sheet['program']} from {_trials(sheet['trials'])}."
    except (KeyError, TypeError):
        return [*out, text(NOT_KNOWN, "warning")]
    return [*out, text(f"{made} It is not fitted anew to these trials. Its own verdict: {judgement}. {sentence}")]


def _trials(trials: Sequence[Mapping[str, Any]]) -> str:
    return ", ".join(named(trial["name"]) for trial in trials) or "no moving trial"


def recorded_blocks(trial: TrialResult) -> list[Block]:
    """What one further trial is made of."""
    recording = trial.recording
    time = trial.body.time
    words = (
        f"{role_words(trial.role, trial.joint).capitalize()}, from the file {named(file_name(recording.source))}: "
        f"{number(float(time[-1] - time[0]), 2)} s, {number(len(time), 0)} frames at {number(recording.rate, 0)} Hz, "
        f"{len(recording.labels)} markers, {_plates(len(recording.plates))}."
    )
    notes = [note.removeprefix(f"{trial.name}: ") for note in trial.notes]
    return [heading(f"Trial {named(trial.name)}"), text(words), *note_blocks(notes)]


def _plates(count: int) -> str:
    return f"{count} force plate{'' if count == 1 else 's'}" if count else "no force plates"
