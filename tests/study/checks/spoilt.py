"""A sound synthetic study in memory, and ways to spoil one trial of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gaitcal.model.marker_set import load_marker_set
from gaitcal.model.subject_model import Subject
from gaitcal.recording import ForcePlate, Recording
from gaitcal.settings import CalibrationSettings
from gaitcal.study.checks import Finding, Severity, check_study
from gaitcal.study.person import Study, StudyTrial
from gaitcal.study.synthetic_motion import gait_motion, isolated_motion, static_motion
from tests.study.synthetic_studies import made_plates, made_recording

Array = NDArray[np.float64]
Change = Callable[[Recording], Recording]

GROUND = np.array([-10.0, -10.0])
CORNERS = np.array([[10.0, 0.0, -10.0], [-10.0, 0.0, -10.0], [-10.0, 0.0, 10.0], [10.0, 0.0, 10.0]])
"""A plate as large as the room: every centre of pressure lies on it."""


def sound_study() -> Study:
    """Standing, walking over two plates, a moving knee: nothing to find."""
    walk = gait_motion()
    plates = made_plates(walk)
    recordings = {
        "static": made_recording(static_motion(), static=True),
        "walk": replace(made_recording(walk), plates=plates),
        "knee_r": made_recording(isolated_motion("knee_r")),
    }
    trials = (
        StudyTrial("static", "static", None, recordings["static"], {}),
        StudyTrial("walk", "gait", None, recordings["walk"], {}),
        StudyTrial("knee_r", "joint", "knee_r", recordings["knee_r"], {}),
    )
    subject = Subject("synthetic", 69.4, 1.70, "male")
    return Study(subject, load_marker_set("published"), trials, CalibrationSettings(), {}, {})


def with_trial(study: Study, name: str, change: Change) -> Study:
    """The study with one recording changed."""
    trials = tuple(replace(t, recording=change(t.recording)) if t.name == name else t for t in study.trials)
    return replace(study, trials=trials)


def findings(study: Study, topic: str, severity: Severity | None = None) -> list[Finding]:
    """What the checks find about a topic."""
    found = [f for f in check_study(study) if f.topic == topic]
    return [f for f in found if severity is None or f.severity is severity]


def moved(label: str, change: Callable[[Array], Array]) -> Change:
    """The trajectory (nf, 3) of one marker changed."""

    def spoil(recording: Recording) -> Recording:
        markers = recording.markers.copy()
        at = recording.labels.index(label)
        markers[:, at] = change(markers[:, at].copy())
        return replace(recording, markers=markers)

    return spoil


def swapped(a: str, b: str, frames: slice = slice(None)) -> Change:
    """Two labels exchanged in some frames."""

    def spoil(recording: Recording) -> Recording:
        markers = recording.markers.copy()
        i, j = recording.labels.index(a), recording.labels.index(b)
        markers[frames, i], markers[frames, j] = recording.markers[frames, j], recording.markers[frames, i]
        return replace(recording, markers=markers)

    return spoil


def relabelled(old: str, new: str) -> Change:
    """One label spelt otherwise."""
    return lambda r: replace(r, labels=tuple(new if label == old else label for label in r.labels))


def plate(number: int, change: Callable[[ForcePlate], ForcePlate]) -> Change:
    """One force plate changed."""

    def spoil(recording: Recording) -> Recording:
        plates = tuple(change(p) if k == number else p for k, p in enumerate(recording.plates, start=1))
        return replace(recording, plates=plates)

    return spoil
