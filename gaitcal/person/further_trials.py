"""Further trials of a calibrated person: tracked, and taken to torques with their standard errors."""

from __future__ import annotations

from gaitcal.calibration.torque_errors import coordinate_standard_errors, marker_moves
from gaitcal.model.subject_model import SubjectModel
from gaitcal.motion.motion import rigid_floor
from gaitcal.person.calibrate import forces_of, torque_errors_of, track_problem
from gaitcal.person.prepare import measured_reactions, prepare_trial
from gaitcal.person.result import LoadedTrial, TrialResult
from gaitcal.person.uncertainty import Uncertainty
from gaitcal.study.settings import CalibrationSettings
from gaitcal.study.study import StudyTrial


def analyse(model: SubjectModel, trial: StudyTrial, settings: CalibrationSettings, spread: Uncertainty) -> TrialResult:
    """Track one further gait trial with a calibrated model and compute its torques.

    Parameters
    ----------
    model : calibrated, as `gaitcal.load_model` returns it.
    trial : markers named as in the model; with force plates if torques are wanted.
    settings : of the calibration (splines and force filter).
    spread : uncertainty of the calibration, for standard errors.
    """
    prepared = prepare_trial(trial, model, settings)
    nominal = track_problem(prepared.body, model.nominal)
    motion = track_problem(prepared.body, model.parameters)
    loads = None
    moves = marker_moves(prepared.body, motion.nodes, model.parameters, spread.joint)
    if prepared.recording.plates:
        r = measured_reactions(prepared, model, model.parameters, motion, settings)
        loads = LoadedTrial(
            r,
            forces_of(model.nominal, nominal, r),
            None,
            forces_of(model.parameters, motion, r),
            None,
            torque_errors_of(prepared.body, motion, model.parameters, r, spread, moves),
        )
    return TrialResult(
        trial.name,
        trial.role,
        None,
        prepared.recording,
        nominal,
        motion,
        motion,
        rigid_floor(prepared.body),
        motion,
        loads,
        coordinate_standard_errors(prepared.body, moves),
    )
