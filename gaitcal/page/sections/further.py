"""Further trials of a calibrated person: the lines on top, and what is known of the model that they were taken through.

What the calibration's own page tells of joints and provenance is told again, as that of the calibration; what speaks
of one recording stands with it, so that trials of several runs can be joined.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from gaitcal.gait.words import role_words
from gaitcal.model.subject_model import SubjectModel
from gaitcal.page.sections.blocks import Block, Sections, fold, heading, named, number, text
from gaitcal.page.sections.gait_numbers import gait_numbers
from gaitcal.page.sections.lines import Line, agreement_line, counting_line
from gaitcal.page.sections.provenance import note_blocks
from gaitcal.page.sections.trial_rows import file_name
from gaitcal.session.result import TrialResult

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
