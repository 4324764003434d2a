"""The folder of further trials (`gaitcal dynamics`): every run adds its trials to those that are there."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import cast

from gaitcal.export.names import safe_name
from gaitcal.files.atomic import also_at, atomic_directory
from gaitcal.files.ownership import MANIFEST, ResultKind, read_object
from gaitcal.files.package_data import package_version
from gaitcal.model.subject_model import SubjectModel
from gaitcal.person.result import TrialResult
from gaitcal.results.calibration import json_text, write_trial
from gaitcal.results.summary import Json, trial_summary

SUMMARY = "summary.json"


def write_trials(
    trials: Sequence[TrialResult],
    model: SubjectModel,
    model_file: Path,
    folder: Path,
    inputs: Sequence[Path],
    warnings: Sequence[str] = (),
) -> tuple[str, ...]:
    """Write further trials into `folder`, whole or not at all; those of earlier runs stay, but for the same names.

    Parameters
    ----------
    model_file : `model.toml`, whose hash tells later whether an earlier trial was made with this model.
    inputs : recordings and forces, which the folder must not hold.
    warnings : further ones, each beginning with `NAME: `.

    Returns
    -------
    Warnings on earlier trials that are kept and were made with another model.

    Raises
    ------
    InputError
        The folder cannot be written, or holds files that are not ours.
    """
    names = {trial.name for trial in trials}
    digest = hashlib.sha256(model_file.read_bytes()).hexdigest()
    bwh = model.subject.bwh
    with atomic_directory(folder, ResultKind.DYNAMICS, inputs) as out:
        for trial in trials:
            write_trial(trial, model, out)
        summary, manifest = read_object(folder / SUMMARY), read_object(folder / MANIFEST)
        made_with = _others(_table(manifest, "model_sha256"), names) | dict.fromkeys(sorted(names), digest)
        kept = _others(_table(summary, "trials"), names)
        stale = tuple(
            f"{name}: made by an earlier run with another model than {model_file.name} now is; run it again"
            for name in kept
            if made_with.get(name) != digest
        )
        told: dict[str, Json] = {
            "trials": {**kept, **{t.name: trial_summary(t, bwh) for t in trials}},
            "notes": [*_told(summary, "notes", kept), *(note for t in trials for note in t.notes)],
            "warnings": [
                *(w for w in _told(summary, "warnings", kept) if not w.endswith("; run it again")),
                *stale,
                *warnings,
                *(warning for t in trials for warning in t.warnings),
            ],
        }
        (out / SUMMARY).write_text(json_text(told), encoding="utf-8")
        made: dict[str, Json] = {
            "gaitcal": package_version("gaitcal"),
            "subject": model.subject.name,
            "model_sha256": made_with,
        }
        (out / MANIFEST).write_text(json_text(made), encoding="utf-8")
        stems = {*kept, *map(safe_name, kept)}
        for path in _trial_files(folder):
            if path.stem in stems:
                also_at(path, out / path.relative_to(folder))
    return stale


def _trial_files(folder: Path) -> list[Path]:
    """All files of trials, `motion/walk.mot` and the like."""
    return sorted(path for path in folder.glob("*/*") if path.is_file())


def _table(content: Mapping[str, object], key: str) -> dict[str, Json]:
    found = content.get(key)
    return cast(dict[str, Json], found) if isinstance(found, dict) else {}


def _others(table: Mapping[str, Json], names: set[str]) -> dict[str, Json]:
    return {name: value for name, value in table.items() if name not in names}


def _told(summary: Mapping[str, object], key: str, kept: Mapping[str, Json]) -> list[str]:
    """Earlier notes or warnings on the trials that are kept."""
    found = summary.get(key)
    lines = [line for line in found if isinstance(line, str)] if isinstance(found, list) else []
    return [line for line in lines if any(line.startswith(f"{name}: ") for name in kept)]
