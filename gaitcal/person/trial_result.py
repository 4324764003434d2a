"""The result of one trial, from its motions with every model: moments, standard errors, marker errors.

A calibration assembles its own trials here, and `gaitcal dynamics` every further trial of the calibrated person.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from gaitcal.calibration.torque_errors import (
    MarkerMoves,
    coordinate_standard_errors,
    coordinate_variances,
    marker_moves,
    torque_standard_errors,
)
from gaitcal.cores import all_of
from gaitcal.dynamics.axis_errors import EXACT, PALPATED_DEG, AxisErrors
from gaitcal.dynamics.foot_contact import FootPoints
from gaitcal.dynamics.ground_contact import GroundReactions
from gaitcal.dynamics.ground_reactions import foot_points, has_feet, unseen_frames
from gaitcal.dynamics.inverse_dynamics import moments_of
from gaitcal.dynamics.joint_kinetics import kinetics_of
from gaitcal.dynamics.plate_errors import PlateErrors
from gaitcal.dynamics.torque_sources import Source, TorqueErrors
from gaitcal.gait.events import TrialEvents, trial_events
from gaitcal.gait.progression import facing, pelvis_angles
from gaitcal.gait.spatiotemporal import strides_measured
from gaitcal.gait.symmetry import stride_findings
from gaitcal.model.inertial_parameters import impossible_bodies
from gaitcal.model.parameters import Parameters
from gaitcal.model.subject_model import SubjectModel
from gaitcal.motion.joint_floor import JointFloor, joint_floor
from gaitcal.motion.motion import MarkerErrors, Motion, rigid_floor, tracked_motion
from gaitcal.motion.trial_problem import TrialProblem
from gaitcal.person.force_faults import diagnose_forces
from gaitcal.person.hold_out import HeldOut
from gaitcal.person.prepare import PreparedTrial, measured_reactions, prepare_trial
from gaitcal.person.result import LoadedTrial, Stage, TrialResult, Uncertainty
from gaitcal.person.trial_findings import trial_findings
from gaitcal.study.settings import CalibrationSettings
from gaitcal.study.study_trial import StudyTrial
from gaitcal.verdict.force_diagnosis import ForceDiagnosis


def trial_result(
    trial: PreparedTrial,
    stages: Mapping[Stage, tuple[Parameters, Motion]],
    body: Motion,
    *,
    fitted_with: Parameters,
    reactions: GroundReactions | None,
    uncertainty: Uncertainty,
    plates: PlateErrors,
    axes: Mapping[str, tuple[float, float, float]],
    model: SubjectModel,
    held_out: HeldOut | None = None,
) -> TrialResult:
    """Assemble the result of a tracked trial.

    Parameters
    ----------
    stages : the models that were reached, in their order, each with the motion that its moments are of.
    body : whole-body motion with the last of them.
    fitted_with : the parameters at the end of an isolated trial's own phase.
    reactions : None without force plates.
    uncertainty : of the last model.
    plates : how far the ground reactions are to be believed.
    axes : standard deviations of where the segments' axes point, deg (`dynamics/axis_errors.py`).
    model : of the person, for weight, height, and where heels and toes are.
    """
    subject = model.subject
    final, _ = stages[max(stages, key=list(Stage).index)]
    reached = final if trial.joint is None else fitted_with
    turned = AxisErrors(final, axes)

    def fitted() -> tuple[Motion, Motion, MarkerErrors, JointFloor | None]:
        """Motions of what was fitted, as calibrated and at the end, and the floors below them."""
        calibrated = last = body
        if trial.joint is not None:
            last = tracked_motion(trial.fitted, final)
            calibrated = last if fitted_with is final else tracked_motion(trial.fitted, fitted_with)
        return calibrated, last, rigid_floor(trial.fitted), joint_floor(trial.fitted, reached, calibrated.q)

    def moved() -> MarkerMoves | None:
        return None if trial.joint else marker_moves(trial.with_skin, body.nodes, final, uncertainty.joint)

    moves, (calibrated, last, floor, floor_of_joints) = all_of(moved, fitted)
    variances = {} if moves is None else coordinate_variances(trial.body, moves)
    events = _events(trial, model.with_parameters(final), body, reactions)
    feet = _feet(model.with_parameters(final), body)
    faced = None if trial.joint else facing(pelvis_angles(body))
    strides = strides_measured(events, body.time, feet, unseen_frames(body), faced)
    loads = None
    if reactions is not None:
        moments = {stage: moments_of(p, motion, reactions.wrench, subject.bwh) for stage, (p, motion) in stages.items()}
        errors = _torque_errors(trial.body, body, final, reactions, uncertainty, plates, turned, moves)
        loads = LoadedTrial(reactions, moments, errors, kinetics_of(final, body, reactions.wrench))
    doubts = trial_findings(
        trial.body,
        final,
        body,
        stages[Stage.NOMINAL][1],
        subject.weight,
        None if loads is None else loads.final,
        None if loads is None else loads.reactions,
    )
    return TrialResult(
        name=trial.name,
        role=trial.role,
        joint=trial.joint,
        recording=trial.recording,
        nominal=stages[Stage.NOMINAL][1],
        calibrated=calibrated,
        final=last,
        floor=floor,
        joint_floor=floor_of_joints,
        body=body,
        loads=loads,
        coordinate_errors=None
        if moves is None
        else coordinate_standard_errors(trial.body, moves, turned.coordinate_errors(body.q), variances),
        own_coordinate_errors=None if Source.MOTION not in variances else np.sqrt(variances[Source.MOTION]),
        held_out=held_out,
        bandwidth=trial.bandwidth,
        events=events,
        strides=strides,
        doubts=(*doubts, *stride_findings(trial.name, strides)),
    )


def _events(trial: PreparedTrial, model: SubjectModel, body: Motion, reactions: GroundReactions | None) -> TrialEvents:
    """Of a gait trial; an isolated one has none."""
    return TrialEvents() if trial.joint else trial_events(model, body, reactions, trial.recording)


def _feet(model: SubjectModel, body: Motion) -> FootPoints | None:
    """Heels and toes of a motion; None where the model does not know them."""
    return foot_points(model, body, model.parameters) if has_feet(model) else None


def _torque_errors(
    problem: TrialProblem,
    motion: Motion,
    parameters: Parameters,
    reactions: GroundReactions,
    uncertainty: Uncertainty,
    plates: PlateErrors,
    axes: AxisErrors,
    moves: MarkerMoves | None,
) -> TorqueErrors | None:
    """Standard errors of the final moments; None for impossible bodies, whose mass matrix has no meaning."""
    if impossible_bodies(parameters.inertial):
        return None
    return torque_standard_errors(
        problem,
        motion.nodes,
        parameters,
        reactions.wrench,
        uncertainty.joint,
        uncertainty.inertial,
        moves,
        plates,
        axes,
    )


def axis_deviations(settings: CalibrationSettings) -> Mapping[str, tuple[float, float, float]]:
    """Segment -> deg, how far its axes may point elsewhere."""
    return EXACT if settings.segment_axes == "exact" else PALPATED_DEG


def analyse(
    model: SubjectModel, trial: StudyTrial, settings: CalibrationSettings, uncertainty: Uncertainty
) -> TrialResult:
    """Track one further gait trial with a calibrated model and compute its torques.

    Parameters
    ----------
    model : calibrated, as `gaitcal.load_model` returns it.
    trial : markers named as in the model; with force plates if torques are wanted.
    settings : of the calibration (splines, force filter and errors of force plates).
    uncertainty : of the calibration, for standard errors.
    """
    prepared = prepare_trial(trial, model, settings)
    nominal = tracked_motion(prepared.body, model.nominal)
    motion = tracked_motion(prepared.body, model.parameters)
    reactions, diagnosis = None, ForceDiagnosis()
    if prepared.recording.plates:
        reactions = measured_reactions(prepared, model, model.parameters, motion, settings)
        diagnosis = diagnose_forces([prepared], model, model.parameters, {trial.name: motion}, {trial.name: reactions})
    result = trial_result(
        prepared,
        {Stage.NOMINAL: (model.nominal, nominal), Stage.JP_IP: (model.parameters, motion)},
        motion,
        fitted_with=model.parameters,
        reactions=reactions,
        uncertainty=uncertainty,
        plates=PlateErrors.of(settings.plate_error),
        axes=axis_deviations(settings),
        model=model,
    )
    return replace(result, doubts=(*result.doubts, *diagnosis.findings))
