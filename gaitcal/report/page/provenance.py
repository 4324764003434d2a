"""Preset Provenance: recordings, phases, settings, versions and assumptions.

The page of further trials describes these trials, and repeats what the calibration's page contains
about joints and provenance.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath, PureWindowsPath
from typing import Any, Final

import numpy as np

from gaitcal.analysis.result import Calibration, TrialResult
from gaitcal.calibration.joint_phases import PhaseSummary
from gaitcal.gait.moments import describe_joint, describe_role, format_count
from gaitcal.report.page import plain_data

LONG_NOTE: Final = 300  # Characters of a note from which it is folded
HASHES: Final = "inputs_sha256"
NO_SETTINGS: Final = (
    "kind",
    "files",
    "sha256",
    HASHES,
)  # Entries of a manifest that are no settings
PHASES: Final = {
    "gait": "legs, from walking",
    "all joints": "all joints, over all trials at once",
    "inertial": "masses, mass centres and moments of inertia",
}
FILES: Final = (
    "Beside this page: parameters.csv (every parameter with its error), summary.json, "
    "manifest.json (settings, "
    "versions, SHA-256 of every file), cycles.csv and ensemble.csv (curves of each stride, and "
    "their means), "
    "spatiotemporal.csv, motion/, moments/, powers/, forces/, markers/ and marker_errors/ (each "
    "trial at each "
    "instant), model.osim, model.urdf, model.xml, model.toml. This page needs no network and can "
    "be archived as it is."
)
COPIED: Final = (
    "clinician",
    "joints",
    "provenance",
)  # Presets of the calibration's page that are repeated
EDITED: Final = (
    "The model, or another file of the result, was edited since: the description below may be "
    "outdated."
)
NOT_KNOWN: Final = (
    "The page of the calibration cannot be read: see its summary.json and manifest.json."
)


def build_provenance_blocks(
    calibration: Calibration, manifest: Mapping[str, object]
) -> list[plain_data.Block]:
    """Build the blocks of the whole result; `manifest`: versions, settings and input hashes."""
    settings = [
        [plain_data.make_cell(name), plain_data.make_cell(value)]
        for name, value in _flatten(
            {key: value for key, value in manifest.items() if key not in NO_SETTINGS}
        )
    ]
    return [
        *_build_recordings(calibration),
        *_build_assumptions(calibration),
        *_build_phases(calibration.phases),
        plain_data.make_heading("Versions and settings"),
        plain_data.make_table(["Name", plain_data.make_text_column("Value")], settings),
        *_build_hashes(manifest.get(HASHES)),
        plain_data.make_text(FILES, "soft"),
    ]


def _get_file_name(source: str) -> str:
    """Return the file name without folders, whose names may identify the subject."""
    return PureWindowsPath(PurePosixPath(source).name).name or source


def _build_recordings(calibration: Calibration) -> list[plain_data.Block]:
    head: list[plain_data.Cell] = [
        "Trial",
        plain_data.make_text_column("Used as"),
        plain_data.make_text_column("File"),
    ]
    head += ["Length", "Frames", "Rate", "Markers", "Visible", "Force plates"]
    rows: list[list[plain_data.Cell]] = []
    for trial in calibration.study.trials:
        recording = trial.recording
        visible = np.isfinite(recording.markers).all(axis=2)
        # Of all markers and frames.
        visible_percent = 100.0 * float(visible.mean()) if visible.size else 0.0
        rows.append(
            [
                plain_data.make_cell(plain_data.format_name(trial.name)),
                plain_data.make_cell(describe_role(trial.role, trial.joint)),
                plain_data.make_cell(plain_data.format_name(_get_file_name(recording.source))),
                f"{plain_data.format_number(float(recording.time[-1] - recording.time[0]), 2)} s",
                plain_data.format_number(len(recording.time), 0),
                f"{plain_data.format_number(recording.rate, 0)} Hz",
                str(len(recording.labels)),
                f"{plain_data.format_number(visible_percent)} %",
                str(len(recording.plates) or "none"),
            ]
        )
    subject = calibration.model.subject
    person = (
        f"Body mass {plain_data.format_number(subject.mass)} kg, height "
        f"{plain_data.format_number(subject.height, 3)} m, "
        f"anthropometric table {subject.sex or 'of women and men in the mean'}; "
        f"marker set {calibration.study.marker_set.name}."
    )
    return [
        plain_data.make_heading("What was recorded"),
        plain_data.make_text(person),
        plain_data.make_table(head, rows),
    ]


def _build_assumptions(calibration: Calibration) -> list[plain_data.Block]:
    out = [plain_data.make_heading("What was assumed")]
    if not calibration.notes:
        out.append(plain_data.make_text("Nothing beyond the study file."))
    # Notes of one trial begin with its name and are folded below it.
    prefixes = {trial.name: f"{trial.name}: " for trial in calibration.trials}
    out += _build_note_blocks(
        [note for note in calibration.notes if not note.startswith(tuple(prefixes.values()))]
    )
    for name, prefix in prefixes.items():
        if notes := [
            note.removeprefix(prefix) for note in calibration.notes if note.startswith(prefix)
        ]:
            out.append(
                plain_data.fold_blocks(
                    f"Trial {plain_data.format_name(name)}: {format_count(len(notes), 'note')}",
                    _build_note_blocks(notes),
                )
            )
    # Coordinates that no marker of the static trial moves with.
    if calibration.model.frozen:
        held = ", ".join(name.replace("_", " ") for name in calibration.model.frozen)
        out.append(
            plain_data.make_text(
                f"No marker determines {held}: the trunk is kept upright, arms hang down."
            )
        )
    return out


def _build_note_blocks(notes: Sequence[str]) -> list[plain_data.Block]:
    """Build a list of notes; long ones are folded below it."""
    short = [note for note in notes if len(note) <= LONG_NOTE]
    long = [
        plain_data.fold_blocks(f"{note[:120]}…", [plain_data.make_text(note)])
        for note in notes
        if len(note) > LONG_NOTE
    ]
    return [plain_data.make_list(short), *long] if short else [*long]


def _build_phases(phases: Sequence[PhaseSummary]) -> list[plain_data.Block]:
    if not phases:
        return [
            plain_data.make_heading("Phases of the calibration"),
            plain_data.make_text("No phase was run."),
        ]
    head: list[plain_data.Cell] = [
        "Phase",
        plain_data.make_text_column("Trials"),
        "Parameters",
        plain_data.make_text_column("Status"),
    ]
    rows: list[list[plain_data.Cell]] = []
    for phase in phases:
        title = PHASES.get(phase.name, phase.name)
        if phase.name.startswith("joint:"):
            title = (
                f"{describe_joint(phase.name.removeprefix('joint:'))}, from its functional trials"
            )
        rows.append(
            [
                plain_data.make_cell(title),
                plain_data.make_cell(
                    ", ".join(plain_data.format_name(trial) for trial in phase.trials)
                ),
                str(phase.parameters),
                plain_data.make_cell(phase.status, tone="good" if phase.converged else "look"),
            ]
        )
    return [plain_data.make_heading("Phases of the calibration"), plain_data.make_table(head, rows)]


def _build_hashes(inputs: object) -> list[plain_data.Block]:
    if not isinstance(inputs, Mapping) or not inputs:
        return []
    rows: list[list[plain_data.Cell]] = [
        [
            plain_data.make_cell(plain_data.format_name(_get_file_name(str(name)))),
            plain_data.make_cell(value),
        ]
        for name, value in inputs.items()
    ]
    return [
        plain_data.make_heading("Inputs"),
        plain_data.make_table(["File", plain_data.make_text_column("SHA-256")], rows),
    ]


def _flatten(manifest: Mapping[str, object], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Flatten nested tables to rows of dotted names and values."""
    for key, value in manifest.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            yield from _flatten(value, f"{name}.")
        elif isinstance(value, list | tuple):
            yield (
                name,
                ", ".join(plain_data.replace_control_characters(v) for v in value)
                or plain_data.MISSING,
            )
        else:
            yield name, plain_data.MISSING if value is None else str(value)


@dataclass(frozen=True)
class Origin:
    """The calibration on which further trials are based."""

    data: Mapping[str, Any]  # Of its page; empty where it cannot be read
    edited: bool  # One of its files is not as it was written


def build_further_sections(origin: Origin) -> plain_data.Sections:
    """Build the sections about the calibration, for the page of its further trials."""
    found = origin.data.get("sections")
    known = found if isinstance(found, Mapping) else {}
    sections: plain_data.Sections = {preset: list(known.get(preset) or ()) for preset in COPIED}
    edited = [plain_data.make_text(EDITED, "warning")] if origin.edited else []
    if joints := sections["joints"]:
        sections["joints"] = [
            *edited,
            plain_data.make_text("Of the calibration, not of these trials:", "soft"),
            *joints,
        ]
    provenance_blocks = sections["provenance"]
    folded = (
        [
            plain_data.fold_blocks(
                "Recordings, phases, settings and versions of the calibration", provenance_blocks
            )
        ]
        if provenance_blocks
        else []
    )
    sections["provenance"] = [*_describe_model(origin.data), *edited, *folded]
    return {preset: blocks for preset, blocks in sections.items() if blocks}


def _describe_model(data: Mapping[str, Any]) -> list[plain_data.Block]:
    """Describe the calibration: date, trials and verdict."""
    out = [plain_data.make_heading("The model of these trials")]
    try:
        judgement, sentence = data["verdict"]["judgement"], data["verdict"]["sentence"]
        trials = (
            ", ".join(plain_data.format_name(trial["name"]) for trial in data["trials"])
            or "no moving trial"
        )
        made = f"Calibrated on {data['made']} with {data['program']} from {trials}."
    except (KeyError, TypeError):
        return [*out, plain_data.make_text(NOT_KNOWN, "warning")]
    return [
        *out,
        plain_data.make_text(
            f"{made} It is not fitted again to these trials. Verdict on it: {judgement}. {sentence}"
        ),
    ]


def build_recording_blocks(trial: TrialResult) -> list[plain_data.Block]:
    """Build the description of the recording of one further trial."""
    recording, time = trial.recording, trial.body.time
    plates = (
        format_count(len(recording.plates), "force plate")
        if recording.plates
        else "no force plates"
    )
    description = (
        f"{describe_role(trial.role, trial.joint).capitalize()}, from the file "
        f"{plain_data.format_name(_get_file_name(recording.source))}: "
        f"{plain_data.format_number(float(time[-1] - time[0]), 2)} s, "
        f"{plain_data.format_number(len(time), 0)} frames at "
        f"{plain_data.format_number(recording.rate, 0)} Hz, {len(recording.labels)} markers, "
        f"{plates}."
    )
    notes = [note.removeprefix(f"{trial.name}: ") for note in trial.notes]
    return [
        plain_data.make_heading(f"Trial {plain_data.format_name(trial.name)}"),
        plain_data.make_text(description),
        *_build_note_blocks(notes),
    ]
