"""Under a robust loss, labels that jumped onto each other are put right before anything is fitted.

A loss alone cannot do it: three markers of a segment of which two are exchanged are a mirror image, and least squares
turns the segment round. The jump itself betrays them (`checks/exchanged.py`).
"""

from __future__ import annotations

from dataclasses import replace

from gaitcal.checks.evidence import TrialEvidence
from gaitcal.checks.exchanged import by_jumps
from gaitcal.model.subject_model import SubjectModel
from gaitcal.recording.intervals import runs, spans
from gaitcal.recording.recording import Recording
from gaitcal.study.study import Study


def mended(study: Study, model: SubjectModel) -> tuple[Study, tuple[str, ...]]:
    """The study with exchanged labels exchanged back in its moving trials, and what was done."""
    marker_set = study.marker_set.with_weights(study.weights)
    trials, told = [], []
    for trial in study.trials:
        if trial.role != "static":
            evidence = TrialEvidence(trial, marker_set, study.subject, study.settings, model)
            recording, notes = _mended(evidence)
            trial = replace(trial, recording=recording)
            told += [f"{trial.name}: {note}" for note in notes]
        trials.append(trial)
    return replace(study, trials=tuple(trials)), tuple(told)


def _mended(trial: TrialEvidence) -> tuple[Recording, tuple[str, ...]]:
    recording = trial.recording
    markers, notes = recording.markers.copy(), []
    for found in by_jumps(trial):
        a, b = trial.place[found.label], trial.place[found.other]
        markers[found.frames, a], markers[found.frames, b] = markers[found.frames, b], markers[found.frames, a]
        notes.append(
            f"'{found.label}' and '{found.other}' carried each other's label in {int(found.frames.sum())} frames, "
            f"{spans(recording.time, runs(found.frames))}; exchanged back"
        )
    return (replace(recording, markers=markers) if notes else recording), tuple(notes)
