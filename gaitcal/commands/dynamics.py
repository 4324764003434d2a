"""`gaitcal dynamics`."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from gaitcal.atomic import atomic_directory
from gaitcal.commands.console import Talk, print_trials
from gaitcal.errors import InputError
from gaitcal.model.model_file import load_model
from gaitcal.model.subject_model import SubjectModel
from gaitcal.output import load_uncertainty, write_trial, write_trials_summary
from gaitcal.recording import read_recording
from gaitcal.settings import CalibrationSettings
from gaitcal.study.further import analyse
from gaitcal.study.person import StudyTrial


def run(result: Path, trials: list[Path], forces: Path | None, out: Path | None, *, quiet: bool, verbose: bool) -> None:
    """Take further trials through the model of a result folder."""
    talk = Talk(quiet=quiet, verbose=verbose)
    if forces is not None and len(trials) != 1:
        raise InputError(f"found {len(trials)} trials; allowed: one, whose ground reactions it names", field="--forces")
    names = [path.stem for path in trials]
    if len(set(names)) != len(names):
        raise InputError("found two trials with one name; a trial's name is its file's, without the ending")
    model = load_model(result / "model.toml")
    settings = _settings(result)
    spread = load_uncertainty(result / "uncertainty.npz")
    done = []
    with talk.working() as step:
        for path in trials:
            step(f"{path.name}: tracking and inverse dynamics")
            recording = read_recording(path, forces=forces)
            _check_markers(model, recording.labels, path)
            trial = StudyTrial(path.stem, "gait", None, recording, {})
            done.append(analyse(model, trial, settings, spread))
        folder = out or result / "dynamics"
        with atomic_directory(folder) as target:
            for trial_result in done:
                write_trial(trial_result, model, target)
            write_trials_summary(done, model, target)
    print_trials(talk, done)
    talk.line(f"results: {folder}")


def _settings(result: Path) -> CalibrationSettings:
    path = result / "manifest.json"
    try:
        content = json.loads(path.read_text(encoding="utf-8"))["settings"]
    except (OSError, ValueError, KeyError, TypeError):
        raise InputError("no result of 'gaitcal calibrate': its manifest.json cannot be read", source=result) from None
    known: Mapping[str, object] = {k: v for k, v in content.items() if k in CalibrationSettings.model_fields}
    return CalibrationSettings.model_validate(known)


def _check_markers(model: SubjectModel, labels: tuple[str, ...], path: Path) -> None:
    shared = np.isin(model.markers.labels, labels).sum()
    if not shared:
        raise InputError(
            f"found none of the model's {len(model.markers.labels)} markers, such as {model.markers.labels[0]}",
            source=path,
            field="markers",
        )
