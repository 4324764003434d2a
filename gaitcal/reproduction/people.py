"""Two real people in place of the unpublished experimental trial: never the same person, shown beside it.

`subject01` (markers and ground reactions of a walk) and `uf3` (isolated trials of six joints and a walk, no ground
reactions), from the folder that GAITCAL_DATA names, through the same pipeline as any user's study.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gaitcal.calibration.inertial_calibration import fit_published
from gaitcal.calibration.inertial_equations import LoadedMotion, equations_of
from gaitcal.model.inertial_parameters import is_physical, symmetric_set
from gaitcal.model.linkage import LOWER_BODY
from gaitcal.model.marker_set import load_marker_set
from gaitcal.model.subject_model import Subject
from gaitcal.person.calibrate import calibrate
from gaitcal.person.result import Calibration, Stage
from gaitcal.recording import read_recording
from gaitcal.reproduction.inertial_tables import COLUMNS, SCALES
from gaitcal.reproduction.published import PROBLEMS, SIDE
from gaitcal.reproduction.rows import TableRow
from gaitcal.runtime import Progress, silent
from gaitcal.study.settings import CalibrationSettings
from gaitcal.study.study import Role, Study, StudyTrial

STAGES = {
    Stage.NOMINAL: "anatomical",
    Stage.JP: "phase 1",
    Stage.JP_IP: "phase 2",
    Stage.COMBINED: "third step",
}
"""In the words of the paper."""
NOTE = "another person than the published one, with this project's default settings"


@dataclass(frozen=True)
class _Person:
    subject: Subject
    marker_set: str
    trials: tuple[tuple[str, Role, str | None, str, str | None], ...]
    """Name, role, joint, file, file of ground reactions."""


_JOINTS = tuple(f"{joint}_{side}" for joint in PROBLEMS[:3] for side in ("r", "l"))
_PEOPLE = {
    "subject01": _Person(
        Subject("subject01", 72.6, 1.803, "male"),
        "gait2354",
        (
            ("static", Role.STATIC, None, "subject01_static.trc", None),
            ("walk", Role.GAIT, None, "subject01_walk1.trc", "subject01_walk1_grf.mot"),
        ),
    ),
    "uf3": _Person(
        Subject("uf3", 68.17, 1.70, "male"),
        "rcnl",
        (
            ("static", Role.STATIC, None, "static.trc", None),
            *((joint, Role.JOINT, joint, f"{joint}.trc", None) for joint in _JOINTS),
            ("gait", Role.GAIT, None, "gait.trc", None),
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
            if any(t[4] for t in person.trials):
                rows += _scale_rows(name, calibration)
                progress(f"{name}: third step")
                calibration = calibrate(_study(data / name, person, joint_step=True))
            rows += _residual_rows(name, calibration)
    return rows


def _study(folder: Path, person: _Person, **settings: object) -> Study:
    marker_set = load_marker_set(person.marker_set)
    trials = []
    for name, role, joint, file, forces in person.trials:
        recording = read_recording(folder / file, forces=folder / forces if forces else None)
        trials.append(StudyTrial(name=name, role=role, joint=joint, recording=marker_set.renamed(recording)))
    return Study(
        subject=person.subject,
        marker_set=marker_set,
        trials=tuple(trials),
        settings=CalibrationSettings.model_validate(settings),
        weights={},
        inputs={},
        source=str(folder),
    )


def _marker_rows(name: str, calibration: Calibration) -> list[TableRow]:
    rows: list[TableRow] = []
    for trial in calibration.trials:
        if trial.joint is not None and not trial.joint.endswith(SIDE):
            continue
        column = "full leg" if trial.joint is None else trial.joint.split("_")[0]
        nominal, calibrated = (motion.errors.rms(*LOWER_BODY) for motion in (trial.nominal, trial.calibrated))
        if nominal is None or calibrated is None:
            continue
        note = f"{NOTE}; markers of pelvis and legs"
        for words, value in (("anatomical", nominal), ("phase 1", calibrated)):
            row = f"{name}, {words}: marker distance RMS"
            rows.append(TableRow("I", row, column, None, 1e3 * value, "mm", note))
        fall = 100.0 * (1.0 - calibrated / nominal)
        rows.append(TableRow("I", f"{name}: fall of marker distance", column, None, fall, "%", note))
    return rows


def _residual_rows(name: str, calibration: Calibration) -> list[TableRow]:
    rows: list[TableRow] = []
    for trial in calibration.trials:
        loads = trial.loads
        if loads is None or not loads.reactions.valid.any():
            continue
        valid = loads.reactions.valid
        note = f"{NOTE}; {int(np.sum(valid))} of {len(valid)} frames"
        for stage, moments in loads.moments.items():
            row = f"{name}, {STAGES[stage]}"
            for (column, unit, _), value in zip(COLUMNS[:2], moments.residual_rms(valid), strict=True):
                rows.append(TableRow("III", row, column, None, value, unit, note))
    return rows


def _scale_rows(name: str, calibration: Calibration) -> list[TableRow]:
    """The published cost with each normalisation, with the joints and motions of phase 1."""
    nominal, parameters = calibration.nominal, calibration.model.parameters
    motions = [
        LoadedMotion(
            name=t.name,
            q=t.body.q,
            velocity=t.body.velocity,
            acceleration=t.body.acceleration,
            wrench=r.wrench,
            valid=r.valid,
        )
        for t in calibration.trials
        if t.loads is not None and (r := t.loads.reactions).valid.any()
    ]
    if not motions:
        return []
    hips = [nominal.landmarks[f"hjc_{side}"][1] for side in ("r", "l")]
    rows: list[TableRow] = []
    for scale, (_, words) in SCALES.items():
        width = float(np.linalg.norm(hips[0] - hips[1]))
        equations = equations_of(motions, parameters, nominal.subject, scale, width)
        fit = fit_published(equations, nominal.parameters.inertial, symmetric_set())
        note = NOTE if is_physical(fit.inertial).all() else f"{NOTE}; some bodies could not exist"
        for (column, unit, _), value in zip(COLUMNS[:2], (fit.rms_force, fit.rms_moment), strict=True):
            row = f"{name}, torque divided by {words}"
            rows.append(TableRow("discussion", row, column, None, value, unit, f"{note}; published cost"))
    return rows
