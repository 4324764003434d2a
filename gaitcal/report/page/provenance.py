"""Preset Provenance: what was recorded, how it was computed, with what, and what was assumed.

Further trials of a calibrated person tell it of themselves; what the calibration's own page tells
of joints and provenance is told again, as that of the calibration.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath, PureWindowsPath
from typing import Any, Final

import numpy as np

from gaitcal.analysis.result import Calibration, TrialResult
from gaitcal.calibration.joint_phases import Phase
from gaitcal.gait.moments import counted, joint_words, role_words
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
)  # Presets of the calibration's page that are told again
EDITED: Final = (
    "The model, or another file of the result, was edited since: what is told of it below may not "
    "hold."
)
NOT_KNOWN: Final = (
    "The page of the calibration cannot be read: its summary.json and manifest.json tell what was "
    "done."
)


def provenance_blocks(
    calibration: Calibration, manifest: Mapping[str, object]
) -> list[plain_data.Block]:
    """Of the whole result; `manifest`: versions, settings and hashes of the inputs."""
    settings = [
        [plain_data.cell(name), plain_data.cell(value)]
        for name, value in _flat(
            {key: value for key, value in manifest.items() if key not in NO_SETTINGS}
        )
    ]
    return [
        *_recordings(calibration),
        *_assumptions(calibration),
        *_phases(calibration.phases),
        plain_data.heading("Versions and settings"),
        plain_data.table(["Name", plain_data.words_column("Value")], settings),
        *_hashes(manifest.get(HASHES)),
        plain_data.text(FILES, "soft"),
    ]


def _file_name(source: str) -> str:
    """The name alone: a folder's name may say who the person is."""
    return PureWindowsPath(PurePosixPath(source).name).name or source


def _recordings(calibration: Calibration) -> list[plain_data.Block]:
    head: list[plain_data.Cell] = [
        "Trial",
        plain_data.words_column("Used as"),
        plain_data.words_column("File"),
    ]
    head += ["Length", "Frames", "Rate", "Markers", "Seen", "Force plates"]
    rows: list[list[plain_data.Cell]] = []
    for trial in calibration.study.trials:
        recording = trial.recording
        seen = np.isfinite(recording.markers).all(axis=2)
        rows.append(
            [
                plain_data.cell(plain_data.named(trial.name)),
                plain_data.cell(role_words(trial.role, trial.joint)),
                plain_data.cell(plain_data.named(_file_name(recording.source))),
                f"{plain_data.number(float(recording.time[-1] - recording.time[0]), 2)} s",
                plain_data.number(len(recording.time), 0),
                f"{plain_data.number(recording.rate, 0)} Hz",
                str(len(recording.labels)),
                f"{plain_data.number(100.0 * float(seen.mean()) if seen.size else 0.0)} %",
                str(len(recording.plates) or "none"),
            ]
        )
    subject = calibration.model.subject
    person = (
        f"Body mass {plain_data.number(subject.mass)} kg, height "
        f"{plain_data.number(subject.height, 3)} m, "
        f"anthropometric table {subject.sex or 'of women and men in the mean'}; "
        f"marker set {calibration.study.marker_set.name}."
    )
    return [
        plain_data.heading("What was recorded"),
        plain_data.text(person),
        plain_data.table(head, rows),
    ]


def _assumptions(calibration: Calibration) -> list[plain_data.Block]:
    out = [plain_data.heading("What was assumed")]
    if not calibration.notes:
        out.append(plain_data.text("Nothing beyond the study file."))
    prefixes = {trial.name: f"{trial.name}: " for trial in calibration.trials}
    out += note_blocks(
        [note for note in calibration.notes if not note.startswith(tuple(prefixes.values()))]
    )
    for name, prefix in prefixes.items():
        if notes := [
            note.removeprefix(prefix) for note in calibration.notes if note.startswith(prefix)
        ]:
            out.append(
                plain_data.fold(
                    f"Trial {plain_data.named(name)}: {counted(len(notes), 'note')}",
                    note_blocks(notes),
                )
            )
    if calibration.model.frozen:
        held = ", ".join(name.replace("_", " ") for name in calibration.model.frozen)
        out.append(
            plain_data.text(f"No marker shows {held}: the trunk stays upright, arms hang along it.")
        )
    return out


def note_blocks(notes: Sequence[str]) -> list[plain_data.Block]:
    """Notes as a list; long ones stand below it, folded away."""
    short = [note for note in notes if len(note) <= LONG_NOTE]
    long = [
        plain_data.fold(f"{note[:120]}…", [plain_data.text(note)])
        for note in notes
        if len(note) > LONG_NOTE
    ]
    return [plain_data.bullets(short), *long] if short else [*long]


def _phases(phases: Sequence[Phase]) -> list[plain_data.Block]:
    if not phases:
        return [
            plain_data.heading("Phases of the calibration"),
            plain_data.text("No phase was run."),
        ]
    head: list[plain_data.Cell] = [
        "Phase",
        plain_data.words_column("Trials"),
        "Parameters",
        plain_data.words_column("Status"),
    ]
    rows: list[list[plain_data.Cell]] = []
    for phase in phases:
        words = PHASES.get(phase.name, phase.name)
        if phase.name.startswith("joint:"):
            words = f"{joint_words(phase.name.removeprefix('joint:'))}, from its own trials"
        rows.append(
            [
                plain_data.cell(words),
                plain_data.cell(", ".join(plain_data.named(trial) for trial in phase.trials)),
                str(phase.parameters),
                plain_data.cell(phase.status, tone="good" if phase.converged else "look"),
            ]
        )
    return [plain_data.heading("Phases of the calibration"), plain_data.table(head, rows)]


def _hashes(inputs: object) -> list[plain_data.Block]:
    if not isinstance(inputs, Mapping) or not inputs:
        return []
    rows: list[list[plain_data.Cell]] = [
        [plain_data.cell(plain_data.named(_file_name(str(name)))), plain_data.cell(value)]
        for name, value in inputs.items()
    ]
    return [
        plain_data.heading("Inputs"),
        plain_data.table(["File", plain_data.words_column("SHA-256")], rows),
    ]


def _flat(manifest: Mapping[str, object], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Nested tables as rows of dotted names and values."""
    for key, value in manifest.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            yield from _flat(value, f"{name}.")
        elif isinstance(value, list | tuple):
            yield name, ", ".join(plain_data.visible(v) for v in value) or plain_data.MISSING
        else:
            yield name, plain_data.MISSING if value is None else str(value)


@dataclass(frozen=True)
class Origin:
    """The calibration that further trials come after."""

    data: Mapping[str, Any]  # Of its page; empty where it cannot be read
    edited: bool  # One of its files is not as it was written


def further_sections(origin: Origin) -> plain_data.Sections:
    """Of the calibration, for the page of its further trials."""
    found = origin.data.get("sections")
    known = found if isinstance(found, Mapping) else {}
    sections: plain_data.Sections = {preset: list(known.get(preset) or ()) for preset in COPIED}
    edited = [plain_data.text(EDITED, "warning")] if origin.edited else []
    if joints := sections["joints"]:
        sections["joints"] = [
            *edited,
            plain_data.text("Of the calibration, not of these trials:", "soft"),
            *joints,
        ]
    whole = sections["provenance"]
    folded = (
        [plain_data.fold("Recordings, phases, settings and versions of the calibration", whole)]
        if whole
        else []
    )
    sections["provenance"] = [*_model(origin.data), *edited, *folded]
    return {preset: blocks for preset, blocks in sections.items() if blocks}


def _model(data: Mapping[str, Any]) -> list[plain_data.Block]:
    """Whose calibration, when, and how far it can be believed."""
    out = [plain_data.heading("The model of these trials")]
    try:
        judgement, sentence = data["verdict"]["judgement"], data["verdict"]["sentence"]
        trials = (
            ", ".join(plain_data.named(trial["name"]) for trial in data["trials"])
            or "no moving trial"
        )
        made = f"Calibrated on {data['made']} with {data['program']} from {trials}."
    except (KeyError, TypeError):
        return [*out, plain_data.text(NOT_KNOWN, "warning")]
    return [
        *out,
        plain_data.text(
            f"{made} It is not fitted anew to these trials. Its own verdict: {judgement}. "
            f"{sentence}"
        ),
    ]


def recorded_blocks(trial: TrialResult) -> list[plain_data.Block]:
    """What one further trial is made of."""
    recording, time = trial.recording, trial.body.time
    plates = (
        counted(len(recording.plates), "force plate") if recording.plates else "no force plates"
    )
    words = (
        f"{role_words(trial.role, trial.joint).capitalize()}, from the file "
        f"{plain_data.named(_file_name(recording.source))}: "
        f"{plain_data.number(float(time[-1] - time[0]), 2)} s, "
        f"{plain_data.number(len(time), 0)} frames at {plain_data.number(recording.rate, 0)} Hz, "
        f"{len(recording.labels)} markers, {plates}."
    )
    notes = [note.removeprefix(f"{trial.name}: ") for note in trial.notes]
    return [
        plain_data.heading(f"Trial {plain_data.named(trial.name)}"),
        plain_data.text(words),
        *note_blocks(notes),
    ]
