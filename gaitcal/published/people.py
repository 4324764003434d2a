"""Two real people in place of the unpublished experimental trial: never the same person, shown beside it.

`subject01` (markers and ground reactions of a walk) and `uf3` (isolated trials of six joints and a walk, no ground
reactions), from the folder that GAITCAL_DATA names, through the same pipeline as any user's study.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gaitcal.calibration.inertial_calibration import LoadedMotion, equations_of, fit_published
from gaitcal.model.linkage import LOWER_BODY
from gaitcal.model.marker_set import load_marker_set
from gaitcal.model.parameters import is_physical, symmetric_set
from gaitcal.model.subject_model import Subject
from gaitcal.published.inertial_recovery import pelvis_width
from gaitcal.published.protocol import SIDE
from gaitcal.published.tables import RESIDUALS, SCALES, Cell, TableRow
from gaitcal.runtime import Progress, silent
from gaitcal.session.calibrate import calibrate
from gaitcal.session.result import Calibration, Loads, Stage, TrialResult
from gaitcal.study.settings import CalibrationSettings
from gaitcal.study.study import Study
from gaitcal.study.study_file import Joint, TrialTable
from gaitcal.study.study_trial import read_trial

STAGES = {Stage.NOMINAL: "anatomical", Stage.JP: "phase 1", Stage.JP_IP: "phase 2", Stage.COMBINED: "third step"}
"""In the words of the paper."""
NOTE = "another person than the published one, with this project's default settings"


@dataclass(frozen=True)
class _Person:
    subject: Subject
    marker_set: str
    trials: tuple[TrialTable, ...]
    """Files are told from the person's folder."""


_JOINTS: tuple[Joint, ...] = ("hip_r", "hip_l", "knee_r", "knee_l", "ankle_r", "ankle_l")
_PEOPLE = {
    "subject01": _Person(
        Subject("subject01", 72.6, 1.803, "male"),
        "gait2354",
        (
            TrialTable(name="static", role="static", file=Path("subject01_static.trc")),
            TrialTable(
                name="walk", role="gait", file=Path("subject01_walk1.trc"), forces=Path("subject01_walk1_grf.mot")
            ),
        ),
    ),
    "uf3": _Person(
        Subject("uf3", 68.17, 1.70, "male"),
        "rcnl",
        (
            TrialTable(name="static", role="static", file=Path("static.trc")),
            *(TrialTable(name=joint, role="joint", joint=joint, file=Path(f"{joint}.trc")) for joint in _JOINTS),
            TrialTable(name="gait", role="gait", file=Path("gait.trc")),
        ),
    ),
}


def people_rows(data: Path, progress: Progress = silent) -> list[TableRow]:
    """Rows for the people whose recordings are in the folder."""
    rows: list[TableRow] = []
    for name, person in _PEOPLE.items():
        if (data / name).is_dir():
            progress(f"{name}: calibration")
            calibration = calibrate(_study(data / name, person))
            rows += _marker_rows(name, calibration)
            if any(trial.forces for trial in person.trials):
                rows += _scale_rows(name, calibration)
                progress(f"{name}: third step")
                calibration = calibrate(_study(data / name, person, joint_step=True))
            rows += _residual_rows(name, calibration)
    return rows


def _study(folder: Path, person: _Person, **settings: object) -> Study:
    marker_set = load_marker_set(person.marker_set)
    trials = [
        trial.model_copy(update={"file": folder / trial.file, "forces": trial.forces and folder / trial.forces})
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


def _marker_rows(name: str, calibration: Calibration) -> Iterator[TableRow]:
    for trial in calibration.trials:
        if trial.joint is not None and not trial.joint.endswith(SIDE):
            continue
        column = "full leg" if trial.joint is None else trial.joint.split("_")[0]
        nominal, calibrated = (motion.errors.rms(*LOWER_BODY) for motion in (trial.nominal, trial.calibrated))
        if nominal is None or calibrated is None:
            continue
        for row, value, unit in (
            (f"{name}, anatomical: marker distance RMS", 1e3 * nominal, "mm"),
            (f"{name}, phase 1: marker distance RMS", 1e3 * calibrated, "mm"),
            (f"{name}: fall of marker distance", 100.0 * (1.0 - calibrated / nominal), "%"),
        ):
            yield Cell("I", row, column, unit).filled(None, value, NOTE, "markers of pelvis and legs")


def _residual_rows(name: str, calibration: Calibration) -> Iterator[TableRow]:
    for _, loads in _loaded(calibration):
        valid = loads.reactions.valid
        frames = f"{int(np.sum(valid))} of {len(valid)} frames"
        for stage, moments in loads.moments.items():
            for (column, unit, _), value in zip(RESIDUALS, moments.residual_rms(valid), strict=True):
                yield Cell("III", f"{name}, {STAGES[stage]}", column, unit).filled(None, value, NOTE, frames)


def _loaded(calibration: Calibration) -> list[tuple[TrialResult, Loads]]:
    """Trials with a frame whose ground reactions are valid."""
    return [(t, t.loads) for t in calibration.trials if t.loads is not None and t.loads.reactions.valid.any()]


def _scale_rows(name: str, calibration: Calibration) -> Iterator[TableRow]:
    """The published cost with each normalisation, with the joints and motions of phase 1."""
    nominal, motions = calibration.nominal, []
    for trial, loads in _loaded(calibration):
        body, forces = trial.body, loads.reactions
        state = {"q": body.q, "velocity": body.velocity, "acceleration": body.acceleration}
        motions.append(LoadedMotion(name=trial.name, **state, wrench=forces.wrench, valid=forces.valid))
    for scale, (_, words) in SCALES.items() if motions else ():
        parameters, width = calibration.model.parameters, pelvis_width(nominal)
        equations = equations_of(motions, parameters, nominal.subject, scale, width)
        fit = fit_published(equations, nominal.parameters.inertial, symmetric_set())
        possible = "" if is_physical(fit.inertial).all() else "some bodies could not exist"
        for (column, unit, _), value in zip(RESIDUALS, (fit.rms_force, fit.rms_moment), strict=True):
            cell = Cell("discussion", f"{name}, torque divided by {words}", column, unit)
            yield cell.filled(None, value, NOTE, possible, "published cost")
