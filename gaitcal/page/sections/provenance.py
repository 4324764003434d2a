"""Preset Provenance: what was recorded, how it was computed, with what, and what was assumed."""

from __future__ import annotations

import platform
from collections.abc import Iterator, Mapping, Sequence
from typing import Final

from gaitcal.gait.words import counted
from gaitcal.io.package_data import package_version
from gaitcal.page.sections.blocks import (
    MISSING,
    Block,
    Cell,
    bullets,
    cell,
    fold,
    heading,
    named,
    number,
    table,
    text,
    visible,
    words_column,
)
from gaitcal.page.sections.trial_rows import file_name, phase_words, trial_facts
from gaitcal.session.result import Calibration

LIBRARIES: Final = ("pin", "numpy", "scipy")
LONG_NOTE: Final = 300
"""Characters of a note from which it is folded."""
HASHES: Final = "inputs_sha256"
OF_FILES: Final = ("kind", "files", "sha256", HASHES)
"""Entries of a manifest that are no settings."""
NOISE: Final = (
    "Noise: the marker error that would say as little of the joint parameters, if every frame of every marker were "
    "independent of all others. Skin movement repeats itself, so it is larger than the residuals; what was known "
    "before a phase, of people and by earlier trials, is weighed against it. How long each phase took: summary.json."
)
FILES: Final = (
    "Beside this page: parameters.csv (every parameter with its error), summary.json, manifest.json (settings, "
    "versions, SHA-256 of every file), cycles.csv and ensemble.csv (curves of each stride, and their means), "
    "spatiotemporal.csv, motion/, moments/, powers/, forces/, markers/ and marker_errors/ (each trial at each "
    "instant), model.osim, model.urdf, model.xml, model.toml. This page needs no network and can be archived as it is."
)


def provenance_blocks(calibration: Calibration, manifest: Mapping[str, object] | None) -> list[Block]:
    """Of the whole result."""
    made = dict(manifest) if manifest is not None else default_manifest(calibration)
    return [
        *_recordings(calibration),
        *_assumptions(calibration),
        *_phases(calibration),
        *_settings(made),
        *_hashes(made),
        text(FILES, "soft"),
    ]


def default_manifest(calibration: Calibration) -> dict[str, object]:
    """Versions, settings and hashes as far as the calibration knows them."""
    study = calibration.study
    return {
        "gaitcal": package_version("gaitcal"),
        "versions": {"python": platform.python_version()} | {name: package_version(name) for name in LIBRARIES},
        "marker_set": study.marker_set.name,
        "settings": study.settings.model_dump(mode="json"),
        HASHES: dict(study.inputs),
    }


def _recordings(calibration: Calibration) -> list[Block]:
    head: list[Cell] = [
        "Trial",
        words_column("Used as"),
        words_column("File"),
        "Length",
        "Frames",
        "Rate",
        "Markers",
        "Seen",
        "Force plates",
    ]
    rows: list[list[Cell]] = [
        [
            cell(named(facts.name)),
            cell(facts.role),
            cell(named(facts.file)),
            f"{number(facts.seconds, 2)} s",
            number(facts.frames, 0),
            f"{number(facts.rate, 0)} Hz",
            str(facts.markers),
            f"{number(facts.seen)} %",
            str(facts.plates or "none"),
        ]
        for facts in trial_facts(calibration)
    ]
    subject = calibration.model.subject
    person = (
        f"Body mass {number(subject.mass)} kg, height {number(subject.height, 3)} m, anthropometric table "
        f"{subject.sex}; marker set {calibration.study.marker_set.name}."
    )
    return [heading("What was recorded"), text(person), table(head, rows)]


def _assumptions(calibration: Calibration) -> list[Block]:
    out = [heading("What was assumed")]
    if not calibration.notes:
        out.append(text("Nothing beyond the study file."))
    of_trials = {trial.name: f"{trial.name}: " for trial in calibration.trials}
    every = [note for note in calibration.notes if not note.startswith(tuple(of_trials.values()))]
    out += note_blocks(every)
    for name, begin in of_trials.items():
        if own := [note.removeprefix(begin) for note in calibration.notes if note.startswith(begin)]:
            out.append(fold(f"Trial {named(name)}: {counted(len(own), 'note')}", note_blocks(own)))
    if calibration.model.frozen:
        held = ", ".join(name.replace("_", " ") for name in calibration.model.frozen)
        out.append(text(f"No marker shows {held}: the trunk stays upright, arms hang along it."))
    return out


def note_blocks(notes: Sequence[str]) -> list[Block]:
    """Notes as a list; long ones stand below it, folded away."""
    short = [note for note in notes if len(note) <= LONG_NOTE]
    long = [fold(f"{note[:120]}…", [text(note)]) for note in notes if len(note) > LONG_NOTE]
    return [bullets(short), *long] if short else [*long]


def _phases(calibration: Calibration) -> list[Block]:
    if not calibration.phases:
        return [heading("Phases of the calibration"), text("No phase was run.")]
    head: list[Cell] = [
        "Phase",
        words_column("Trials"),
        "Parameters",
        "Iterations",
        "Noise",
        words_column("Status"),
        words_column("Why it ended"),
    ]
    rows: list[list[Cell]] = [
        [
            cell(phase_words(phase)),
            cell(", ".join(named(trial) for trial in phase.trials)),
            str(phase.parameters),
            str(phase.iterations),
            "" if phase.marker_noise is None else f"{number(1e3 * phase.marker_noise)} mm",
            cell(phase.status, tone="good" if phase.converged else "look"),
            cell(phase.message),
        ]
        for phase in calibration.phases
    ]
    return [heading("Phases of the calibration"), table(head, rows), text(NOISE, "soft")]


def _settings(manifest: Mapping[str, object]) -> list[Block]:
    rows = [[cell(name), cell(value)] for name, value in flat({k: v for k, v in manifest.items() if k not in OF_FILES})]
    return [heading("Versions and settings"), table(["Name", words_column("Value")], rows)]


def _hashes(manifest: Mapping[str, object]) -> list[Block]:
    inputs = manifest.get(HASHES)
    if not isinstance(inputs, Mapping) or not inputs:
        return []
    rows: list[list[Cell]] = [[cell(named(file_name(str(name)))), cell(value)] for name, value in inputs.items()]
    return [heading("Inputs"), table(["File", words_column("SHA-256")], rows)]


def flat(manifest: Mapping[str, object], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Nested tables as rows of dotted names and values."""
    for key, value in manifest.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            yield from flat(value, f"{name}.")
        elif isinstance(value, list | tuple):
            yield name, ", ".join(visible(v) for v in value) or MISSING
        else:
            yield name, MISSING if value is None else str(value)
