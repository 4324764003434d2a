"""Compute rows of the published tables for people with recordings, with this project's settings."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed

from gaitcal.analysis.calibrate import calibrate
from gaitcal.analysis.result import Calibration, Loads, Stage
from gaitcal.model.linkage import LOWER_BODY
from gaitcal.model.marker_set import load_marker_set
from gaitcal.model.subject_model import Subject
from gaitcal.montecarlo import protocol
from gaitcal.reproduction.printed_tables import RESIDUALS, TableRow
from gaitcal.runtime import Progress, silent, with_one_blas_thread
from gaitcal.study.settings import CalibrationSettings
from gaitcal.study.study import Study
from gaitcal.study.study_file import Joint, TrialTable
from gaitcal.study.study_trial import read_trial

STAGES = {
    Stage.NOMINAL: "anatomical",
    Stage.JP: "phase 1",
    Stage.JP_IP: "phase 2",
    Stage.COMBINED: "third step",
}
"""Stage -> its name in the paper."""
NOTE = "another person than the published one, with this project's default settings"


@dataclass(frozen=True)
class _Person:
    """A person with recordings."""

    subject: Subject
    marker_set: str
    trials: tuple[TrialTable, ...]
    """Files are relative to the person's folder."""


_JOINTS: tuple[Joint, ...] = ("hip_r", "hip_l", "knee_r", "knee_l", "ankle_r", "ankle_l")
_PEOPLE = {
    "subject01": _Person(
        Subject("subject01", 72.6, 1.803, "male"),
        "gait2354",
        (
            TrialTable(name="static", role="static", file=Path("subject01_static.trc")),
            TrialTable(
                name="walk",
                role="gait",
                file=Path("subject01_walk1.trc"),
                forces=Path("subject01_walk1_grf.mot"),
            ),
        ),
    ),
    "uf3": _Person(
        Subject("uf3", 68.17, 1.70, "male"),
        "rcnl",
        (
            TrialTable(name="static", role="static", file=Path("static.trc")),
            *(
                TrialTable(name=joint, role="joint", joint=joint, file=Path(f"{joint}.trc"))
                for joint in _JOINTS
            ),
            TrialTable(name="gait", role="gait", file=Path("gait.trc")),
        ),
    ),
}


def compute_people_rows(data: Path, jobs: int = -1, progress: Progress = silent) -> list[TableRow]:
    """Compute the rows of all people with recordings in a folder, each person in a process.

    Parameters
    ----------
    data : Path
        With a folder for each person (`subject01`, `uf3`).
    jobs : int
        Number of processes; -1: one for every core.
    progress : callable
        Called with a line of text at the beginning of each person.

    Returns
    -------
    list of TableRow
        Without published figures: of other people.
    """
    names = [name for name in _PEOPLE if (data / name).is_dir()]
    for name in names:
        progress(f"{name}: calibration and third step")
    compute = delayed(_compute_person_rows)
    found = Parallel(n_jobs=jobs)(compute(name, data / name) for name in names)
    return [row for rows in found for row in rows]


@with_one_blas_thread
def _compute_person_rows(name: str, folder: Path) -> list[TableRow]:
    """Compute the rows of one person."""
    person = _PEOPLE[name]
    calibration = calibrate(_read_study(folder, person))
    rows = list(_list_marker_rows(name, calibration))
    if any(trial.forces for trial in person.trials):
        calibration = calibrate(_read_study(folder, person, joint_step=True))
    return [*rows, *_list_residual_rows(name, calibration)]


def _read_study(folder: Path, person: _Person, **settings: object) -> Study:
    """Read the recordings of a person as a study with these settings."""
    marker_set = load_marker_set(person.marker_set)
    trials = [
        trial.model_copy(
            update={"file": folder / trial.file, "forces": trial.forces and folder / trial.forces}
        )
        for trial in person.trials
    ]
    return Study(
        subject=person.subject,
        marker_set=marker_set,
        trials=tuple(read_trial(trial, {}, marker_set) for trial in trials),
        settings=CalibrationSettings.model_validate(settings),
        weights={},
        inputs={},
        source=str(folder),
    )


def _list_marker_rows(name: str, calibration: Calibration) -> Iterator[TableRow]:
    """List the rows of Table I."""
    for trial in calibration.trials:
        if trial.joint is not None and not trial.joint.endswith(protocol.SIDE):
            continue
        # Columns of Table I are the three joints and the whole leg.
        column = "full leg" if trial.joint is None else trial.joint.split("_")[0]
        nominal, calibrated = (
            motion.errors.rms(*LOWER_BODY) for motion in (trial.nominal, trial.calibrated)
        )
        if nominal is None or calibrated is None:
            continue
        for row, value, unit in (
            (f"{name}, anatomical: marker distance RMS", 1e3 * nominal, "mm"),
            (f"{name}, phase 1: marker distance RMS", 1e3 * calibrated, "mm"),
            (f"{name}: fall of marker distance", 100.0 * (1.0 - calibrated / nominal), "%"),
        ):
            cell = TableRow("I", row, column, unit)
            yield cell.fill(None, value, NOTE, "markers of pelvis and legs")


def _list_residual_rows(name: str, calibration: Calibration) -> Iterator[TableRow]:
    """List the rows of Table III."""
    for loads in _list_loads(calibration):
        valid = loads.reactions.valid
        frames = f"{int(np.sum(valid))} of {len(valid)} frames"
        for stage, moments in loads.moments.items():
            residuals = moments.residual_rms(valid)
            for (column, unit, _), value in zip(RESIDUALS, residuals, strict=True):
                cell = TableRow("III", f"{name}, {STAGES[stage]}", column, unit)
                yield cell.fill(None, value, NOTE, frames)


def _list_loads(calibration: Calibration) -> list[Loads]:
    """List the loads of trials with a frame of valid ground reactions."""
    return [
        t.loads for t in calibration.trials if t.loads is not None and t.loads.reactions.valid.any()
    ]
