"""One trial of a study: read, its labels put into those of the marker set, cut to the time that the
study asks for.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np

from gaitcal.display import Displayed
from gaitcal.errors import Code, InputError
from gaitcal.io.csv_recordings import apply_corrected_events, find_event_tables
from gaitcal.io.force_plate import STANCE_S
from gaitcal.io.formats import read_recording
from gaitcal.io.opensim_files import find_loads_tables
from gaitcal.io.recording import Recording
from gaitcal.io.segment_poses import make_upright_posture
from gaitcal.model.marker_set import MarkerSet
from gaitcal.study.study_file import TrialTable

OTHER_UNIT_RATIO = 100.0
"""Least ratio of the durations of forces and markers that shows times in ms.

Laboratories crop markers to a tenth or a twentieth of the forces.
"""


class Role(str, Enum):
    """Role of a trial."""

    STATIC = "static"
    """Standing still."""
    JOINT = "joint"
    """One joint moved in isolation."""
    GAIT = "gait"
    """Walking."""
    MOTION = "motion"
    """Any other activity of the whole body."""


@dataclass(frozen=True, kw_only=True, repr=False)
class Trial(Displayed):
    """One trial of a study."""

    name: str
    role: Role
    joint: str | None = None
    """The joint of a functional trial (`role = "joint"`)."""
    recording: Recording
    """Labels as in the marker set; only the frames that the study asks for."""
    plates: Mapping[str, str] = field(default_factory=dict)
    """Plate name -> "r", "l" or "none", if the study or the file of the forces gives it."""
    filter_hz: float | str | None = None
    """Cut-off of the force filter of this trial, `none`, or None for that of the settings."""
    file_labels: tuple[str, ...] = ()
    """Labels as in the file."""
    files: Mapping[str, Path] = field(default_factory=dict)
    """`file`; where forces have another file, `forces`; where a person corrected events,
    `events`.
    """

    def _description(self) -> tuple[str, list[tuple[str, str]]]:
        file, rows = self.recording._description()
        return f"Trial {self.name} ({self.joint or self.role.value})", [("recording", file), *rows]

    def collect_fields(self) -> dict[str, Any]:
        """Collect the fields of a plain trial, for the constructor of a further subclass."""
        return {f.name: getattr(self, f.name) for f in fields(Trial)}


def read_trial(trial: TrialTable, rename: Mapping[str, str], marker_set: MarkerSet) -> Trial:
    """Read one trial of a study file with the labels of the marker set.

    Parameters
    ----------
    trial
        Table `[[trial]]` with absolute paths.
    rename
        Label in the file -> label in the marker set, before the aliases of the set.
    marker_set
        Marker set of the study.

    Returns
    -------
    Trial
        The trial, not cleaned.

    Raises
    ------
    InputError
        One line: file, field, value found, allowed values.
    """
    # Corrected events precede those of the recording.
    whole = apply_corrected_events(read_recording(trial.file, forces=trial.forces), trial.file)
    recording = marker_set.renamed(_rename_labels(whole, rename))
    known = [plate.name for plate in recording.plates]
    for name in trial.plates:
        if name not in known:
            message = f"found plate '{name}'; the recording has {', '.join(known) or 'none'}"
            raise _make_fault(message, trial.file, f"trial '{trial.name}'.plates")
    # The section that the study selects, with both ends.
    if trial.time is not None:
        time, (low, high) = recording.time, trial.time
        inside = (time >= low - 1e-9) & (time <= high + 1e-9)
        if inside.sum() < 2:
            message = (
                f"found [{low:g}, {high:g}]; the recording runs from {time[0]:g} to {time[-1]:g} s"
            )
            raise _make_fault(message, trial.file, f"trial '{trial.name}'.time")
        recording = recording.frames(inside)
    # Poses and key points need no standing trial: their posture is built from the segments.
    if trial.role == Role.STATIC.value:
        recording = make_upright_posture(recording)
    recording = _note_partial_forces(recording, trial)
    # All files whose content is used, for the hashes of the manifest.
    files = {"file": trial.file}
    if trial.forces is not None:
        files |= {"forces": trial.forces} | {
            f"table{k}": path for k, path in enumerate(find_loads_tables(trial.forces))
        }
    if recording.corrected:
        files["events"] = find_event_tables(trial.file)[0]
    return Trial(
        name=trial.name,
        role=Role(trial.role),
        joint=trial.joint,
        recording=recording,
        plates={**recording.feet, **trial.plates},
        filter_hz=trial.filter_hz,
        file_labels=whole.labels,
        files=files,
    )


def _make_fault(message: str, source: object, field: str) -> InputError:
    return InputError(message, source=source, field=field, code=Code.PART_OF_TRIAL)


def _rename_labels(recording: Recording, rename: Mapping[str, str]) -> Recording:
    labels = tuple(rename.get(label, label) for label in recording.labels)
    changed = [f"{old} -> {rename[old]}" for old in recording.labels if old in rename]
    # Renaming onto a label that exists already would merge two markers.
    doubled = sorted({label for label in labels if labels.count(label) > 1}) if changed else ()
    if doubled:
        message = f"found '{doubled[0]}' twice after renaming; a label names one marker"
        raise InputError(
            message, source=recording.source, field="markers.rename", code=Code.UNKNOWN_LABEL
        )
    renamed = replace(recording, labels=labels)
    return renamed.with_notes(f"markers renamed: {', '.join(changed)}") if changed else renamed


def _note_partial_forces(recording: Recording, trial: TrialTable) -> Recording:
    """Add a note if forces cover a part of the trial; InputError if less than a step."""
    if trial.role not in ("gait", "motion"):
        return recording
    time, source = recording.time, trial.forces or trial.file
    # Compare the times of plates and markers: s against ms, and forces of another trial.
    step, whole = float(np.median(np.diff(time))), float(np.ptp(time))
    for plate in recording.plates:
        lasts = float(np.ptp(plate.time))
        # A trial cut by `time` may be much shorter than its forces.
        if lasts > OTHER_UNIT_RATIO * whole and trial.time is None:
            message = (
                f"found forces that last {lasts:g} s and markers that last {whole:g} s; one of the "
                "two times is in "
            )
            raise _make_fault(
                message + "another unit (ms?); both must be in s", source, f"plate {plate.name}"
            )
        start, stop = max(plate.time[0], time[0]), min(plate.time[-1], time[-1])
        # Less than a step in common gives no torque.
        if stop - start < min(STANCE_S, whole - step):
            message = (
                f"found forces from {plate.time[0]:g} to {plate.time[-1]:g} s and markers from "
                f"{time[0]:g} to "
                f"{time[-1]:g} s; both must last for a step together: are these the forces of this "
                "trial?"
            )
            raise _make_fault(message, source, f"plate {plate.name}")
        if start > time[0] + step or stop < time[-1] - step:
            note = (
                f"Plate {plate.name}: forces from {start:.2f} to {stop:.2f} s only; no torques "
                "beyond."
            )
            recording = recording.with_notes(note)
    return recording
