"""The result of one trial, from its motions with every model: moments, standard errors, marker errors.

A calibration assembles its own trials here, and `gaitcal dynamics` every further trial of the calibrated person.

The motions of all trials with the nominal and with the fitted joint parameters, and the forces under the feet.

What the fit figures of a trial are of: the motion of what was fitted, and the floors below its errors.

How near model markers come to measured ones: before, after, and the floors of rigid segments and of joints.

The coordinates that a model shows for the static posture, and ankle angles that stay counted from it.

Ankle angles are counted from the static posture (`model/ankle_zero.py`). A fit turns the two axes of an ankle, and with
other axes the same posture has other coordinates: a walk would come out bent by as much, whose feet nobody moved. So
after every fit of joint parameters the zero angles z of the two joints are moved by

    dz = q(static, fitted model) - q(static, nominal model)

in the direction of their coordinate, and every motion's coordinate by -dz: positions, torques and markers are the same.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from gaitcal.arrays import Array
from gaitcal.calibration.error_sources import (
    MotionSensitivity,
    TrialScores,
    coordinate_standard_errors,
    coordinate_variances,
    marker_moves,
    whole_body_scores,
)
from gaitcal.calibration.soft_tissue_artefact import tissue_of_walk
from gaitcal.calibration.torque_errors import ErringForces, joined
from gaitcal.dynamics.axis_errors import EXACT, PALPATED_DEG, AxisErrors, ErrorSource, TorqueErrors
from gaitcal.dynamics.expected_residual import expected_residual
from gaitcal.dynamics.foot_contact import FootPoints
from gaitcal.dynamics.ground_reactions import GroundReactions, foot_points, has_feet, unseen_frames
from gaitcal.dynamics.inverse_dynamics import moments_of
from gaitcal.dynamics.joint_kinetics import kinetics_of
from gaitcal.dynamics.plate_errors import PlateErrors
from gaitcal.faults.force_diagnosis import ForceDiagnosis, beyond_expected
from gaitcal.gait.events import TrialEvents, trial_events
from gaitcal.gait.moments import segment_words
from gaitcal.gait.spatiotemporal import strides_measured
from gaitcal.gait.strides import facing, pelvis_angles
from gaitcal.gait.symmetry import stride_findings
from gaitcal.io.recording import Recording
from gaitcal.model.linkage import JOINTS, LOWER_BODY, SEGMENTS, ZERO_ANGLES, Joint, Source
from gaitcal.model.parameters import Parameters, impossible_bodies
from gaitcal.model.subject_model import SubjectModel
from gaitcal.motion.joint_floor import JointFloor, joint_floor
from gaitcal.motion.motion import MarkerErrors, Motion, rigid_floor, tracked_motion
from gaitcal.motion.rigid import FEWEST_MARKERS
from gaitcal.motion.trial_problem import TrialProblem
from gaitcal.runtime import with_one_blas_thread
from gaitcal.session.joint_parameters import HeldOut
from gaitcal.session.prepare import PreparedTrial, measured_reactions, prepare_trial, standing_problem
from gaitcal.session.result import LoadedTrial, Stage, TrialResult, Uncertainty
from gaitcal.session.warnings import diagnose_forces, is_trunk_unmeasured, trial_findings
from gaitcal.study.settings import CalibrationSettings
from gaitcal.study.study_trial import Role, StudyTrial


@dataclass(frozen=True)
class FittedMotion:
    """Of the whole body in gait, of the segments of its joint in an isolated trial."""

    calibrated: Motion | None
    """With the parameters at the end of the trial's own phase; None in gait: the motion of the whole body."""
    final: Motion | None
    """With the last parameters."""
    floor: MarkerErrors
    """Of rigid segments."""
    joint_floor: JointFloor | None


def fitted_motion(trial: PreparedTrial, final: Parameters, fitted_with: Parameters, body: Motion) -> FittedMotion:
    """Track what was fitted in a trial, and see how near its markers any motion comes.

    Inertial parameters play no part.

    Parameters
    ----------
    final : parameters after all phases.
    fitted_with : those at the end of an isolated trial's own phase.
    body : whole-body motion with `final`.
    """
    floor = rigid_floor(trial.fitted)
    if trial.joint is None:
        return FittedMotion(None, None, floor, joint_floor(trial.fitted, final, body.q))
    last = tracked_motion(trial.fitted, final)
    calibrated = last if fitted_with is final else tracked_motion(trial.fitted, fitted_with)
    return FittedMotion(calibrated, last, floor, joint_floor(trial.fitted, fitted_with, calibrated.q))


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
            own_coordinate_errors=None
            if ErrorSource.MOTION not in variances
            else np.sqrt(variances[ErrorSource.MOTION]),
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
    moves: MotionSensitivity | None,
) -> ErringForces | None:
    """The final moments with what may be wrong; None for impossible bodies, whose mass matrix has no meaning."""
    if impossible_bodies(parameters.inertial):
        return None
    wrench, joint, inertial = reactions.wrench, uncertainty.joint, uncertainty.inertial
    return ErringForces(problem, motion.nodes, parameters, wrench, joint, inertial, moves, plates, axes)


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


@dataclass(frozen=True)
class Tracked:
    """By the name of the trial."""

    before: Mapping[str, Motion]
    """With the nominal model: the whole body in gait, the segments of its joint in an isolated trial."""
    motions: Mapping[str, Motion]
    """Of the whole body, with the fitted joint parameters."""
    reactions: Mapping[str, GroundReactions]
    """On the feet of these motions; of gait trials with force plates."""


def tracked_trials(
    trials: Sequence[PreparedTrial], nominal: SubjectModel, parameters: Parameters, settings: CalibrationSettings
) -> Tracked:
    """Track all trials with both models."""

    def loaded(trial: PreparedTrial) -> tuple[Motion, GroundReactions | None]:
        motion = tracked_motion(trial.body, parameters)
        if trial.role is not Role.GAIT or not trial.recording.plates:
            return motion, None
        return motion, measured_reactions(trial, nominal, parameters, motion, settings)

    names = [trial.name for trial in trials]
    parts = [trial.fitted if trial.joint else trial.body for trial in trials]
    after = [loaded(trial) for trial in trials]
    before = [tracked_motion(part, nominal.parameters) for part in parts]
    return Tracked(
        before=dict(zip(names, before, strict=True)),
        motions={name: motion for name, (motion, _) in zip(names, after, strict=True)},
        reactions={name: r for name, (_, r) in zip(names, after, strict=True) if r is not None},
    )


@dataclass(frozen=True, kw_only=True)
class RmsErrors:
    """RMS distance (mm) between measured and model markers; None where there are no markers."""

    label: str
    nominal: float | None
    calibrated: float | None
    floor: float | None
    """Of rigid segments."""
    joint_floor: float | None = None
    """Of each joint by itself."""
    rigid: bool = True
    """False for one segment with fewer than three markers: whatever they do, it follows them nearly exactly."""

    @property
    def ratio(self) -> float | None:
        """Calibrated over floor; None where the floor says nothing of the person."""
        if self.calibrated is None or not self.floor or not self.rigid:
            return None
        return self.calibrated / self.floor

    @property
    def joint_ratio(self) -> float | None:
        """Calibrated over what each joint by itself reaches; None for segments in no joint, or of few markers."""
        if self.calibrated is None or not self.joint_floor or not self.rigid:
            return None
        return self.calibrated / self.joint_floor


def trial_fit(trial: TrialResult, *segments: str) -> RmsErrors:
    """Of one trial, over all its markers or those of some segments."""
    nominal, calibrated, floor = trial.rms_mm(*segments)
    rigid = len(segments) != 1 or int(trial.calibrated.errors.kept(*segments).sum()) >= FEWEST_MARKERS
    return RmsErrors(
        label=segment_words(segments[0]) if len(segments) == 1 else trial.name,
        nominal=nominal,
        calibrated=calibrated,
        floor=floor,
        joint_floor=trial.joint_floor_mm(*segments),
        rigid=rigid,
    )


def leg_fit(trial: TrialResult) -> RmsErrors:
    """Over the markers of pelvis and legs, whose joints the calibration moves."""
    return trial_fit(trial, *LOWER_BODY)


def segment_fits(trial: TrialResult, segments: tuple[str, ...] = SEGMENTS) -> list[RmsErrors]:
    """Of each of these segments that has markers in this trial."""
    return [trial_fit(trial, s) for s in segments if trial.calibrated.errors.kept(s).any()]


def static_angles(model: SubjectModel, parameters: Parameters, static: Recording) -> dict[str, float]:
    """Coordinate -> its value (m, rad) with which the model meets the still window of the static trial."""
    motion = tracked_motion(standing_problem(model, static), parameters)
    return dict(zip(motion.coordinates, map(float, motion.q.mean(axis=0)), strict=True))


@dataclass(frozen=True)
class Counted:
    """Fitted parameters, and from where their ankle angles are counted."""

    parameters: Parameters
    moved: Mapping[str, float]
    """Coordinate -> dz, rad, by which motions of the parameters as they were given read too much."""
    static: Mapping[str, float]
    """`static_angles` of the parameters."""


def counted_from_static(model: SubjectModel, parameters: Parameters, static: Recording) -> Counted:
    """Fitted parameters whose ankles have the nominal model's angles in the static posture, by other zero angles."""
    after, before = (static_angles(model, p, static) for p in (parameters, model.nominal))
    zero, moved = parameters.zero_angles.copy(), {}
    for joint in JOINTS:
        for name, coordinate, sign in _zeroed(joint):
            moved[coordinate] = after[coordinate] - before[coordinate]
            zero[ZERO_ANGLES.index(name)] += sign * moved[coordinate]
    here = after | {name: before[name] for name in moved}
    return Counted(replace(parameters, zero_angles=zero), moved, here)


def as_fitted(model: SubjectModel, parameters: Parameters, static: Recording) -> Counted:
    """The same where the ankles keep the zero of the nominal model: nothing moves."""
    return Counted(parameters, {}, static_angles(model, parameters, static))


def shifted(nodes: Array, coordinates: tuple[str, ...], moved: Mapping[str, float]) -> Array:
    """The nodes (nn, nq) of a motion after `counted_from_static`: B-splines sum to one, so they move as the angle."""
    out: Array = nodes - np.array([moved.get(name, 0.0) for name in coordinates])
    return out


def _zeroed(joint: Joint) -> list[tuple[str, str, float]]:
    """Zero angle, coordinate about the same axis and the sign of one against the other, of a joint that has one."""
    zeros = [e for e in joint.elements if e.source is Source.ZERO_ANGLE]
    turns = [e for e in joint.elements if e.source is Source.COORDINATE]
    return [(z.name, q.name, z.sign * q.sign) for z in zeros for q in turns if z.axis == q.axis]
