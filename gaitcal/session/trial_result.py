"""The result of one trial, from its motions with every model: moments, standard errors, marker errors.

A calibration assembles its own trials here, and `gaitcal dynamics` every further trial of the calibrated person.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from gaitcal.calibration.influence import TrialScores
from gaitcal.calibration.marker_moves import (
    MarkerMoves,
    coordinate_standard_errors,
    coordinate_variances,
    marker_moves,
    whole_body_scores,
)
from gaitcal.calibration.task_tissue import tissue_of_walk
from gaitcal.calibration.torque_errors import ErringForces, joined
from gaitcal.dynamics.axis_errors import EXACT, PALPATED_DEG, AxisErrors
from gaitcal.dynamics.expected_residual import expected_residual
from gaitcal.dynamics.foot_contact import FootPoints
from gaitcal.dynamics.ground_contact import GroundReactions
from gaitcal.dynamics.ground_reactions import foot_points, has_feet, unseen_frames
from gaitcal.dynamics.inverse_dynamics import moments_of
from gaitcal.dynamics.joint_kinetics import kinetics_of
from gaitcal.dynamics.plate_errors import PlateErrors
from gaitcal.dynamics.torque_sources import Source, TorqueErrors
from gaitcal.faults.force_diagnosis import ForceDiagnosis, beyond_expected
from gaitcal.gait.events import TrialEvents, trial_events
from gaitcal.gait.progression import facing, pelvis_angles
from gaitcal.gait.spatiotemporal import strides_measured
from gaitcal.gait.symmetry import stride_findings
from gaitcal.model.inertial_parameters import impossible_bodies
from gaitcal.model.parameters import Parameters
from gaitcal.model.subject_model import SubjectModel
from gaitcal.motion.motion import Motion, tracked_motion
from gaitcal.motion.trial_problem import TrialProblem
from gaitcal.runtime import with_one_blas_thread
from gaitcal.session.fitted_motion import FittedMotion, fitted_motion
from gaitcal.session.force_faults import diagnose_forces
from gaitcal.session.hold_out import HeldOut
from gaitcal.session.prepare import PreparedTrial, measured_reactions, prepare_trial
from gaitcal.session.result import LoadedTrial, Stage, TrialResult, Uncertainty
from gaitcal.session.trial_findings import trial_findings
from gaitcal.session.unmeasured import is_trunk_unmeasured
from gaitcal.study.settings import CalibrationSettings
from gaitcal.study.study_trial import StudyTrial


def trial_result(
    trial: PreparedTrial,
    stages: Mapping[Stage, tuple[Parameters, Motion]],
    body: Motion,
    *,
    fitted: FittedMotion,
    scores: TrialScores | None,
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
    fitted : the motion of what was fitted.
    scores : of the markers of a gait trial (`whole_body_scores`); an isolated one needs none.
    reactions : None without force plates.
    uncertainty : of the last model.
    plates : how far the ground reactions are to be believed.
    axes : standard deviations of where the segments' axes point, deg (`dynamics/axis_errors.py`).
    model : of the person, for weight, height, and where heels and toes are.
    """
    subject = model.subject
    final, _ = stages[max(stages, key=list(Stage).index)]
    turned = AxisErrors(final, axes)
    moves = None if trial.joint else marker_moves(trial.with_skin, body.nodes, final, uncertainty.joint, scores)
    erring = None
    if reactions is not None:
        erring = _erring_forces(trial.body, body, final, reactions, uncertainty, plates, turned, moves)

    def told() -> TrialResult:
        """All but the errors of torques."""
        variances = {} if moves is None else coordinate_variances(trial.body, moves)
        events = _events(trial, model.with_parameters(final), body, reactions)
        feet = _feet(model.with_parameters(final), body)
        faced = None if trial.joint else facing(pelvis_angles(body))
        strides = strides_measured(events, body.time, feet, unseen_frames(body), faced)
        loads = None
        if reactions is not None:
            moments = {
                stage: moments_of(p, motion, reactions.wrench, subject.bwh) for stage, (p, motion) in stages.items()
            }
            loads = LoadedTrial(reactions, moments, None, kinetics_of(final, body, reactions.wrench))
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
            calibrated=fitted.calibrated or body,
            final=fitted.final or body,
            floor=fitted.floor,
            joint_floor=fitted.joint_floor,
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

    if erring is None:
        return told()
    with ThreadPoolExecutor() as pool:  # products of large matrices, which let other threads compute meanwhile
        parts = list(pool.map(with_one_blas_thread(erring.variances), erring.parts))
    return _held(told(), joined(parts), subject.weight)


def _held(result: TrialResult, errors: TorqueErrors, weight: float) -> TrialResult:
    """The result with its errors of torques, and with what they say of its pelvis residual. `weight`: N."""
    if result.loads is None:
        return result
    body, reactions = result.body, result.loads.reactions
    expected = expected_residual(result.loads.final, errors, reactions, body, weight)
    beyond = () if expected is None else beyond_expected(result.name, expected, not is_trunk_unmeasured(body))
    loads = replace(result.loads, errors=errors, expected=expected)
    return replace(result, loads=loads, doubts=(*result.doubts, *beyond))


def _events(trial: PreparedTrial, model: SubjectModel, body: Motion, reactions: GroundReactions | None) -> TrialEvents:
    """Of a gait trial; an isolated one has none."""
    return TrialEvents() if trial.joint else trial_events(model, body, reactions, trial.recording)


def _feet(model: SubjectModel, body: Motion) -> FootPoints | None:
    """Heels and toes of a motion; None where the model does not know them."""
    return foot_points(model, body, model.parameters) if has_feet(model) else None


def _erring_forces(
    problem: TrialProblem,
    motion: Motion,
    parameters: Parameters,
    reactions: GroundReactions,
    uncertainty: Uncertainty,
    plates: PlateErrors,
    axes: AxisErrors,
    moves: MarkerMoves | None,
) -> ErringForces | None:
    """The final moments with what may be wrong; None for impossible bodies, whose mass matrix has no meaning."""
    if impossible_bodies(parameters.inertial):
        return None
    return ErringForces(
        problem=problem,
        nodes=motion.nodes,
        parameters=parameters,
        wrenches=reactions.wrench,
        free=uncertainty.joint.free if uncertainty.joint else (),
        moves=moves or marker_moves(problem, motion.nodes, parameters, uncertainty.joint),
        inertial=uncertainty.inertial,
        plates=plates,
        axes=axes,
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
    if uncertainty.joint is not None:
        tissue = tissue_of_walk(prepared.body, model.nominal, uncertainty.joint.free)
        prepared = replace(prepared, tissue=tissue)
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
        fitted=fitted_motion(prepared, model.parameters, model.parameters, motion),
        scores=whole_body_scores(prepared.with_skin, motion.nodes, model.parameters, uncertainty.joint),
        reactions=reactions,
        uncertainty=uncertainty,
        plates=PlateErrors.of(settings.plate_error),
        axes=axis_deviations(settings),
        model=model,
    )
    return replace(result, doubts=(*result.doubts, *diagnosis.findings))
