"""One trial of a study: read, its labels put into those of the marker set, cut to the time that the study asks for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from pathlib import Path

import numpy as np

from gaitcal.codes import Code
from gaitcal.errors import InputError
from gaitcal.io.external_loads import loads_tables
from gaitcal.io.formats import read_recording
from gaitcal.io.recording import Recording
from gaitcal.model.marker_roles import MarkerSet
from gaitcal.study.study_file import Trial

OTHER_UNIT = 100.0
"""Forces that last so many times longer than whole markers have their time in ms: laboratories crop markers, to a tenth
or a twentieth of the forces."""


class Role(str, Enum):
    """What a trial is for."""

    STATIC = "static"
    """Standing still."""
    JOINT = "joint"
    """One joint moved in isolation."""
    GAIT = "gait"


@dataclass(frozen=True, kw_only=True)
class StudyTrial:
    """One trial of a study."""

    name: str
    role: Role
    joint: str | None = None
    """The joint of an isolated trial."""
    recording: Recording
    """Labels as in the marker set; only the frames that the study asks for."""
    plates: Mapping[str, str] = field(default_factory=dict)
    """Plate name -> "r", "l" or "none", where the study says so."""
    filter_hz: float | str | None = None
    """Cut-off of the force filter of this trial, `none`, or None: as in the settings."""
    file_labels: tuple[str, ...] = ()
    """Labels as in the file."""
    files: Mapping[str, Path] = field(default_factory=dict)
    """`file` and, where forces have one of their own, `forces`."""


def read_trial(trial: Trial, rename: Mapping[str, str], marker_set: MarkerSet) -> StudyTrial:
    """Read one trial of a study file, its labels put into those of the marker set.

    `rename`: label in the file -> label in the marker set, before the set's own aliases are looked up.

    Raises
    ------
    InputError
        One line: file, field, what was found, what is allowed.
    """
    recording = read_recording(trial.file, forces=trial.forces)
    file_labels = recording.labels
    recording = marker_set.renamed(_rename(recording, rename))
    for name in trial.plates:
        known = [plate.name for plate in recording.plates]
        if name not in known:
            raise InputError(
                f"found plate '{name}'; the recording has {', '.join(known) or 'none'}",
                source=trial.file,
                field=f"trial '{trial.name}'.plates",
                code=Code.PART_OF_TRIAL,
            )
    recording = _window(recording, trial)
    _check_forces_cover(recording, trial)
    return StudyTrial(
        name=trial.name,
        role=Role(trial.role),
        joint=trial.joint,
        recording=recording,
        plates={**recording.feet, **trial.plates},
        filter_hz=trial.filter_hz,
        file_labels=file_labels,
        files={"file": trial.file} | _forces_files(trial),
    )


def _forces_files(trial: Trial) -> dict[str, Path]:
    if trial.forces is None:
        return {}
    return {"forces": trial.forces} | {f"table{k}": path for k, path in enumerate(loads_tables(trial.forces))}


def _rename(recording: Recording, rename: Mapping[str, str]) -> Recording:
    if not rename:
        return recording
    labels = tuple(rename.get(label, label) for label in recording.labels)
    doubled = sorted({label for label in labels if labels.count(label) > 1})
    if doubled:
        raise InputError(
            f"found '{doubled[0]}' twice after renaming; a label names one marker",
            source=recording.source,
            field="markers.rename",
            code=Code.UNKNOWN_LABEL,
        )
    changed = [f"{old} -> {rename[old]}" for old in recording.labels if old in rename]
    return replace(recording, labels=labels).with_notes(
        *([f"markers renamed: {', '.join(changed)}"] if changed else [])
    )


def _window(recording: Recording, trial: Trial) -> Recording:
    if trial.time is None:
        return recording
    low, high = trial.time
    inside = (recording.time >= low - 1e-9) & (recording.time <= high + 1e-9)
    if inside.sum() < 2:
        raise InputError(
            f"found [{low:g}, {high:g}]; the recording runs from {recording.time[0]:g} to {recording.time[-1]:g} s",
            source=trial.file,
            field=f"trial '{trial.name}'.time",
            code=Code.PART_OF_TRIAL,
        )
    return recording.frames(inside)


def _check_forces_cover(recording: Recording, trial: Trial) -> None:
    if trial.role != "gait":
        return
    step = float(np.median(np.diff(recording.time)))
    whole = float(np.ptp(recording.time))
    for plate in recording.plates:
        lasts = float(np.ptp(plate.time))
        if lasts > OTHER_UNIT * whole and trial.time is None:
            raise InputError(
                f"found forces that last {lasts:g} s and markers that last {whole:g} s; one of the two times is in "
                "another unit (ms?); both must be in s",
                source=trial.forces or trial.file,
                field=f"plate {plate.name}",
                code=Code.PART_OF_TRIAL,
            )
        if plate.time[0] > recording.time[0] + step or plate.time[-1] < recording.time[-1] - step:
            raise InputError(
                f"found forces from {plate.time[0]:g} to {plate.time[-1]:g} s and markers from "
                f"{recording.time[0]:g} to {recording.time[-1]:g} s; forces must cover the markers: shorten the trial "
                "with time = [start, end]",
                source=trial.forces or trial.file,
                field=f"plate {plate.name}",
                code=Code.PART_OF_TRIAL,
            )
