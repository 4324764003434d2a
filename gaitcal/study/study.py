"""A study: one person's recordings, read and checked, ready to be calibrated."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import partial
from pathlib import Path

import numpy as np

from gaitcal.errors import InputError, nearest
from gaitcal.files.snapshot import Snapshot, sha256_of
from gaitcal.model.marker_set import MarkerSet, load_marker_set
from gaitcal.model.nominal import AnkleZero, HipCentre, nominal_model
from gaitcal.model.subject_model import Subject, SubjectModel
from gaitcal.model.worn_markers import complete_static, worn
from gaitcal.recording import read_recording
from gaitcal.recording.external_loads import loads_tables
from gaitcal.recording.recording import Recording
from gaitcal.study.borrowed_trunk import model_with_trunk
from gaitcal.study.settings import CalibrationSettings
from gaitcal.study.static_markers import completed_static
from gaitcal.study.study_file import StudyFile, Trial, load_study_file
from gaitcal.study.subject import subject_of

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


@dataclass(frozen=True, kw_only=True)
class Study:
    """Who, which markers mean what, which trials, and how to calibrate."""

    subject: Subject
    """The person."""
    marker_set: MarkerSet
    """Which marker is which landmark, and which segment it follows."""
    trials: tuple[StudyTrial, ...]
    """The static trials and all others, in the order of the study file."""
    settings: CalibrationSettings
    """The study file's table `[calibration]`, defaults filled in."""
    weights: Mapping[str, float]
    """Marker label -> weight, where the study overrides the marker set."""
    inputs: Mapping[str, str]
    """File -> SHA-256 of every input."""
    source: str = "study"
    """The study file, for messages."""
    files: tuple[Path, ...] = ()
    """Paths of every input: a result must not take their place."""
    rename: Mapping[str, str] = field(default_factory=dict)
    """Label in the files -> label in the marker set."""

    @classmethod
    def load(cls, path: Path | str) -> Study:
        """Read a study file and all its recordings.

        Raises
        ------
        InputError
            One line: file, field, what was found, what is allowed.
        """
        path = Path(path)
        of_study = sha256_of(path)
        file = load_study_file(path)
        before = {f: sha256_of(f) for f in input_files(file, path)} | {path: of_study}
        marker_set = load_marker_set(file.markers.set)
        study = cls.assemble(
            file, marker_set, tuple(read_trial(t, file.markers.rename, marker_set) for t in file.trials), path
        )
        for name, f in _file_words(study.files, path.parent).items():
            if study.inputs[name] != before[f]:
                raise InputError(f"'{name}' changed while the study was read; run again", source=path)
        return study

    @classmethod
    def assemble(cls, file: StudyFile, marker_set: MarkerSet, trials: tuple[StudyTrial, ...], path: Path) -> Study:
        """A study from its file at `path` and its trials, read by `read_trial`; InputError for labels nobody has."""
        files = input_files(file, path)
        _check_weights(file, marker_set, path)
        marker_set, trials = _worn(marker_set, trials)
        _check_renamed(file, trials, path)
        return cls(
            subject=subject_of(
                file.subject, [t.recording for t in sorted(trials, key=lambda t: t.role is not Role.STATIC)]
            ),
            marker_set=marker_set,
            trials=trials,
            settings=file.calibration,
            weights=dict(file.markers.weights),
            inputs={name: sha256_of(f) or "" for name, f in _file_words(files, path.parent).items()},
            source=str(path),
            files=files,
            rename=dict(file.markers.rename),
        )

    @property
    def static(self) -> StudyTrial:
        """The static trial that the model is made of: the first."""
        return next(trial for trial in self.trials if trial.role is Role.STATIC)

    @property
    def further_statics(self) -> tuple[StudyTrial, ...]:
        """Static trials that only have to agree with the first."""
        return tuple(trial for trial in self.trials if trial.role is Role.STATIC)[1:]

    @property
    def moving(self) -> tuple[StudyTrial, ...]:
        """All trials in which the person moves."""
        return tuple(trial for trial in self.trials if trial.role is not Role.STATIC)

    @property
    def as_read(self) -> Snapshot:
        """The inputs as they were when they were read."""
        folder = Path(self.source).parent
        files = _file_words(self.files, folder)
        return Snapshot(folder, {str(f.resolve()): self.inputs[name] for name, f in files.items()})

    def input_names(self, trial: StudyTrial) -> dict[str, str]:
        """The files of a trial (`file`, `forces`), as `inputs` names them."""
        words = {f: name for name, f in _file_words(self.files, Path(self.source).parent).items()}
        return {kind: words[f] for kind, f in trial.files.items() if f in words}

    def changed_inputs(self) -> tuple[str, ...]:
        """Inputs that are no longer what was read, as `inputs` names them."""
        files = _file_words(self.files, Path(self.source).parent)
        return tuple(name for name, f in files.items() if self.inputs.get(name) != sha256_of(f))


def _worn(marker_set: MarkerSet, trials: tuple[StudyTrial, ...]) -> tuple[MarkerSet, tuple[StudyTrial, ...]]:
    """The marker set as the first static trial shows it worn, and the trials, the static ones completed."""
    whole = tuple(
        replace(t, recording=complete_static(t.recording, marker_set)) if t.role is Role.STATIC else t for t in trials
    )
    static = next((trial for trial in whole if trial.role is Role.STATIC), None)
    if static is None:
        return marker_set, whole
    elsewhere = {label for trial in whole for label in trial.recording.labels}
    return worn(marker_set, static.recording, elsewhere), whole


def input_files(file: StudyFile, path: Path) -> tuple[Path, ...]:
    """The study file at `path`, its recordings and forces, and a marker set of one's own."""
    forces = (f for trial in file.trials if trial.forces for f in (trial.forces, *loads_tables(trial.forces)))
    marker_set = [file.markers.set_path] if file.markers.set_path else []
    return (path, *(trial.file for trial in file.trials), *forces, *marker_set)


def _file_words(files: Iterable[Path], folder: Path) -> dict[str, Path]:
    """Files by the names that the manifest gives them: below the study's folder from there, elsewhere by their own.

    Where two elsewhere have one name, the second has as much of its path before it as tells them apart; no more of it
    belongs in a result that may be given away.
    """
    out: dict[str, Path] = {}
    for file in dict.fromkeys(files):
        whole = file.resolve()
        try:
            name = whole.relative_to(folder.resolve()).as_posix()
        except ValueError:
            names = ("/".join(whole.parts[-k:]) for k in range(1, len(whole.parts) + 1))
            name = next((n for n in names if n not in out), str(whole))
        out.setdefault(name, file)
    return out


def _check_weights(study: StudyFile, marker_set: MarkerSet, path: Path) -> None:
    known = set(marker_set.labels)
    for label in study.markers.weights:
        if label not in known:
            raise InputError(
                f"found a weight for '{label}', which the marker set does not know{nearest(label, known)}",
                source=path,
                field="markers.weights",
            )


def _check_renamed(study: StudyFile, trials: tuple[StudyTrial, ...], path: Path) -> None:
    """A label to be renamed may be worn in some trials only, but not in none."""
    worn = {label for trial in trials for label in trial.file_labels}
    for old, new in study.markers.rename.items():
        if old not in worn:
            raise InputError(
                f"found '{old}' -> '{new}', but no trial has a marker '{old}'{nearest(old, worn)}",
                source=path,
                field="markers.rename",
            )


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
            )
        if plate.time[0] > recording.time[0] + step or plate.time[-1] < recording.time[-1] - step:
            raise InputError(
                f"found forces from {plate.time[0]:g} to {plate.time[-1]:g} s and markers from "
                f"{recording.time[0]:g} to {recording.time[-1]:g} s; forces must cover the markers: shorten the trial "
                "with time = [start, end]",
                source=trial.forces or trial.file,
                field=f"plate {plate.name}",
            )


def nominal_of(study: Study) -> SubjectModel:
    """The nominal model of a study: its static trial, marker set and anthropometry; where the static trial lacks the
    markers of the trunk, the walks place them.
    """
    completed = completed_static(study)
    model_of = partial(
        nominal_model,
        marker_set=study.marker_set,
        subject=study.subject,
        hip_centre=HipCentre(study.settings.hip_rule),
        ankle_zero=AnkleZero(study.settings.ankle_rule),
        weights=study.weights,
    )
    walks = [trial.recording for trial in study.trials if trial.role is Role.GAIT]
    try:
        return model_with_trunk(model_of, completed.static, study.marker_set, walks)
    except InputError as fault:
        raise InputError(f"{fault}{completed.why_not(str(fault))}") from fault
