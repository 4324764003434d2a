"""The result of one trial, from its motions with every model: moments, standard errors, marker
errors.

A calibration assembles its own trials here, and `gaitcal dynamics` every further trial of the
calibrated person.

Ankle angles are counted from the static posture (`model/ankle_zero.py`). A fit turns the two axes
of an ankle, and with other axes the same posture has other coordinates: a walk would come out bent
by as much, whose feet nobody moved. So after every fit of joint parameters the zero angles z of the
two joints are moved by

    dz = q(static, fitted model) - q(static, nominal model)

in the direction of their coordinate, and every motion's coordinate by -dz: positions, torques and
markers are the same.
"""

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from gaitcal.analysis.fit_findings import diagnose_forces, is_trunk_unmeasured, trial_findings
from gaitcal.analysis.prepared_trials import (
    CalibrationState,
    MovingTrial,
    prepare_trial,
    standing_problem,
    tracked,
)
from gaitcal.analysis.result import Loads, Stage, TrialResult, Uncertainty
from gaitcal.arrays import Array
from gaitcal.calibration import error_sources, joint_phases, soft_tissue_artefact, torque_errors
from gaitcal.dynamics import ground_reactions, inverse_dynamics, joint_kinetics
from gaitcal.dynamics.expected_residual import estimate_expected_residual
from gaitcal.dynamics.measurement_errors import (
    EXACT_AXES,
    PALPATED_DEG,
    AxisErrors,
    PlateErrors,
    TorqueErrors,
)
from gaitcal.errors import Code, Finding, Severity
from gaitcal.gait.cycles import FootEvents
from gaitcal.gait.events import GaitEvents, activity_events, crouches, trial_events
from gaitcal.gait.moments import segment_words
from gaitcal.gait.spatiotemporal import stride_findings, stride_lines, strides_measured
from gaitcal.gait.strides import FootAxes, facing, foot_axes, out_of_plane, pelvis_angles
from gaitcal.io.recording import Recording
from gaitcal.model.linkage import (
    JOINTS,
    LOWER_BODY,
    SEGMENTS,
    SIDES,
    ZERO_ANGLES,
    Source,
    get_segment,
)
from gaitcal.model.parameters import Parameters, find_impossible_bodies
from gaitcal.model.subject_model import SubjectModel
from gaitcal.preprocess.static_disagreement import PossibleMove
from gaitcal.quality.force_diagnosis import beyond_expected
from gaitcal.runtime import with_one_blas_thread
from gaitcal.study.settings import CalibrationSettings
from gaitcal.study.study_trial import Role, Trial
from gaitcal.tracking.joint_floor import compute_joint_floor
from gaitcal.tracking.motion import Motion, compute_rigid_floor, track_motion
from gaitcal.tracking.rigid import FEWEST_MARKERS
from gaitcal.tracking.trial_problem import MotionProblem


def analyse(
    model: SubjectModel,
    trial: Trial,
    settings: CalibrationSettings,
    uncertainty: Uncertainty,
    moves: Mapping[str, PossibleMove],
) -> TrialResult:
    """Track one further trial of the whole body with a calibrated model and compute its torques.

    `model`: calibrated, as `gaitcal.load_model` returns it. `trial`: clean
    (`preprocess_trial`), markers named as in the model; with plates if torques are
    wanted. `settings`: of the calibration (splines, force filter and errors of force plates).
    `uncertainty`: of the calibration, for standard errors. `moves`: segment -> what its markers may
    have done since the static trial (`find_possible_moves_of_trial`).
    """
    prepared = prepare_trial(trial, model, settings)
    if uncertainty.joint is not None:
        found = uncertainty.tissue
        activity = trial.name if trial.role is Role.MOTION else ""
        kind = soft_tissue_artefact.choose_kind_for_trial(found, activity)
        tissue = soft_tissue_artefact.make_further_tissue(
            prepared.body,
            joint_phases.take_segments(prepared.joints, LOWER_BODY, model.nominal),
            model.nominal,
            uncertainty.joint.free,
            found,
            kind,
        )
        prepared = prepared.with_tissue(tissue, found)
    session = CalibrationState(
        model=model,
        settings=settings,
        parameters=model.parameters,
        trials=(prepared,),
        possible_moves={trial.name: moves},
        uncertainty=uncertainty,
    )
    session = replace(session, trials=(tracked(prepared, session, Stage.JP_IP),))
    session = replace(session, forces=diagnose_forces(session))
    result = trial_result(session.trials[0], session)
    return replace(result, doubts=(*result.doubts, *session.forces.findings))


def trial_result(trial: MovingTrial, session: CalibrationState) -> TrialResult:
    """Assemble the result of a tracked trial of a session."""
    moves = None
    if trial.joint is None:
        joint, coefficients = session.uncertainty.joint, trial.motion.coefficients
        moves = error_sources.compute_motion_sensitivity(
            trial.with_skin, coefficients, trial.parameters, joint, trial.scores
        )
    deviations = axis_deviations(
        session.settings, session.model, session.possible_moves.get(trial.name)
    )
    axes = AxisErrors(trial.parameters, deviations)
    erring = _erring_forces(trial, session, axes, moves)
    if erring is None:
        return _without_torque_errors(trial, session, axes, moves)
    with ThreadPoolExecutor(1) as pool:  # products of matrices, which let this thread compute
        parts = pool.map(with_one_blas_thread(erring.compute_variances), erring.parts)
        result = _without_torque_errors(trial, session, axes, moves)
    return _with_torque_errors(
        result, torque_errors.join_variances(list(parts)), session.model.subject.weight
    )


def _without_torque_errors(
    trial: MovingTrial,
    session: CalibrationState,
    axes: AxisErrors,
    moves: error_sources.MotionSensitivity | None,
) -> TrialResult:
    """All but the errors of torques."""
    body, final, reactions, subject = (
        trial.motion,
        trial.parameters,
        trial.reactions,
        session.model.subject,
    )
    model = session.model.with_parameters(final)
    events = GaitEvents() if trial.joint else trial_events(model, body, reactions, trial.recording)
    events = activity_events(body, events) if trial.role is Role.MOTION else events
    feet = (
        ground_reactions.compute_foot_points(model, body, final)
        if ground_reactions.has_feet(model)
        else None
    )
    may_turn = (
        trial.joint or trial.role is Role.MOTION
    )  # nothing of an activity is left out because it is a turn
    faced = None if may_turn else facing(pelvis_angles(body))
    strides = strides_measured(
        events, body.time, feet, ground_reactions.find_unobserved_frames(body), faced
    )
    lines = stride_lines(strides, body.time)
    long_axes, by_coordinate = foot_axes(body, final, lines)
    variances = (
        None
        if moves is None
        else error_sources.compute_coordinate_variances(trial.body, moves, by_coordinate)
    )
    count = body.q.shape[1]
    loads = None
    if reactions is not None:
        moments = {
            stage: inverse_dynamics.compute_moments(p, motion, reactions.wrench, subject.bwh)
            for stage, (p, motion) in trial.stages.items()
        }
        loads = Loads(
            reactions, moments, None, joint_kinetics.compute_kinetics(final, body, reactions.wrench)
        )
    calibrated, last = body, body
    own = joint_phases.get_parameters_for_trial(session.joint, trial.name, final)
    if trial.joint is not None:
        last = track_motion(trial.fitted, final)
        calibrated = last if own is final else track_motion(trial.fitted, own)
    return TrialResult(
        name=trial.name,
        role=trial.role,
        joint=trial.joint,
        recording=trial.recording,
        nominal=trial.nominal,
        calibrated=calibrated,
        final=last,
        floor=compute_rigid_floor(trial.fitted),
        joint_floor=compute_joint_floor(
            trial.fitted, final if trial.joint is None else own, calibrated.q
        ),
        body=body,
        loads=loads,
        coordinate_errors=None
        if moves is None or variances is None
        else error_sources.compute_coordinate_errors(
            trial.body, moves, axes.compute_coordinate_errors(body.q), variances[0][:, :count]
        ),
        own_coordinate_errors=None if variances is None else np.sqrt(variances[1][:, :count]),
        foot_axes=None
        if trial.joint
        else _foot_axes(long_axes, lines, variances, axes.compute_segment_rotations(body.q)),
        held_out=trial.held_out,
        bandwidth=trial.bandwidth,
        events=events,
        strides=strides,
        doubts=(
            *trial_findings(trial, loads, subject.weight),
            *stride_findings(trial.name, strides),
            *_crouch_findings(trial.name, body, events, activity=trial.role is Role.MOTION),
        ),
    )


def _crouch_findings(
    trial: str, body: Motion, events: GaitEvents, *, activity: bool = False
) -> tuple[Finding, ...]:
    """That somebody squats or sits down in no stride or repetition."""
    height = body.q[:, body.coordinates.index("pelvis_ty")]
    spans = [(c.start, c.stop) for c in events.repeats]
    told = (
        [FootEvents(*np.transpose(spans))]
        if spans
        else [events.of(side) for side in SIDES]
        if events.events
        else []
    )
    found = (
        [span for span in crouches(body.time, height, told) if span not in spans]
        if told or activity
        else []
    )
    if not found:
        return ()
    cause, why = "not all of the trial is steps", "while no foot steps; strides alone are counted"
    if not events.events:
        cause = "not all of the trial is repetitions"
        why = (
            "in no repetition: from no rest or one at another height, or by less than half as far "
            "as elsewhere"
        )
    when = ", ".join(f"{start:.2f}-{stop:.2f}" for start, stop in found)
    return (
        Finding(
            severity=Severity.INFO,
            topic="strides",
            where=trial,
            cause=cause,
            found=f"{when} s: the pelvis goes down and up {why}",
            cure="squats, rises and jumps count in trials of their own: the file again, with time "
            'and role = "motion"',
            code=Code.NOT_ALL_STEPS,
        ),
    )


def _foot_axes(
    long_axes: Array,
    lines: Array,
    variances: tuple[Array, Array] | None,
    turned: Mapping[str, Array],
) -> FootAxes:
    """With errors: what markers leave, and by how much the foot's own axes may point elsewhere.

    `long_axes`: (nf, 2, 3). `lines`: (nf, 2) rad. `variances`: rad^2, of the feet in the last
    columns, by all sources and by own markers; None: not known. `turned`: segment -> (nf, k, 3)
    rad.
    """
    if variances is None:
        return FootAxes(long_axes)
    _, about = out_of_plane(long_axes, lines)
    variance, own = (of[:, -len(inverse_dynamics.FEET) :].copy() for of in variances)
    for k, foot in enumerate(inverse_dynamics.FEET):
        if foot in turned:
            variance[:, k] += np.square(np.einsum("fki,fi->fk", turned[foot], about[:, k])).sum(
                axis=1
            )
    return FootAxes(long_axes, np.sqrt(variance), np.sqrt(own))


def axis_deviations(
    settings: CalibrationSettings,
    model: SubjectModel,
    moves: Mapping[str, PossibleMove] | None = None,
) -> Mapping[str, tuple[float, float, float]]:
    """Segment -> deg, how far its axes may point elsewhere; of one side, with what its markers may
    have done (`moves`) in a trial.
    """
    if settings.segment_axes == "exact":
        return EXACT_AXES
    by = 1.0 if model.noise is None else model.noise.joints
    out = {segment: (by * x, by * y, by * z) for segment, (x, y, z) in PALPATED_DEG.items()}
    for segment, move in (moves or {}).items():
        x, y, z = np.hypot(out[get_segment(segment).name], np.rad2deg(move.rotation)).tolist()
        out[segment] = x, y, z
    return out


def _with_torque_errors(result: TrialResult, errors: TorqueErrors, weight: float) -> TrialResult:
    """The result with its errors of torques, and with what they say of its pelvis residual.
    `weight`: N.
    """
    if result.loads is None:
        return result
    body, reactions = result.body, result.loads.reactions
    expected = estimate_expected_residual(result.loads.final, errors, reactions, body, weight)
    beyond = (
        ()
        if expected is None
        else beyond_expected(result.name, expected, not is_trunk_unmeasured(body))
    )
    loads = replace(result.loads, errors=errors, expected=expected)
    return replace(result, loads=loads, doubts=(*result.doubts, *beyond))


def _erring_forces(
    trial: MovingTrial,
    session: CalibrationState,
    axes: AxisErrors,
    moves: error_sources.MotionSensitivity | None,
) -> torque_errors.ForceErrors | None:
    """The final moments with what may be wrong; None without forces, and for impossible bodies,
    whose mass matrix has no meaning.
    """
    if trial.reactions is None or find_impossible_bodies(trial.parameters.inertial):
        return None
    return torque_errors.ForceErrors(
        trial.body,
        trial.motion.coefficients,
        trial.parameters,
        trial.reactions.wrench,
        session.uncertainty.joint,
        session.uncertainty.inertial,
        moves,
        PlateErrors.from_table(session.settings.plate_error).add(
            session.forces.possible.get(trial.name)
        ),
        axes,
    )


@dataclass(frozen=True, kw_only=True)
class RmsErrors:
    """RMS distance (mm) between measured and model markers; None where there are no markers."""

    label: str
    nominal: float | None
    calibrated: float | None
    floor: float | None  # Of rigid segments
    joint_floor: float | None = None  # Of each joint by itself
    rigid: bool = True
    """False for one segment with fewer than three markers: whatever they do, it follows them nearly
    exactly.
    """

    @property
    def ratio(self) -> float | None:
        """Calibrated over floor; None where the floor says nothing of the person."""
        if self.calibrated is None or not self.floor or not self.rigid:
            return None
        return self.calibrated / self.floor

    @property
    def joint_ratio(self) -> float | None:
        """Calibrated over what each joint by itself reaches; None for segments in no joint, or of
        few markers.
        """
        if self.calibrated is None or not self.joint_floor or not self.rigid:
            return None
        return self.calibrated / self.joint_floor


def trial_fit(trial: TrialResult, *segments: str) -> RmsErrors:
    """Of one trial, over all its markers or those of some segments."""
    nominal, calibrated, floor = trial.rms_mm(*segments)
    rigid = (
        len(segments) != 1
        or int(trial.calibrated.errors.select_observed(*segments).sum()) >= FEWEST_MARKERS
    )
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


def segment_fits(trial: TrialResult) -> list[RmsErrors]:
    """Of each segment that has markers in this trial."""
    return [
        trial_fit(trial, s) for s in SEGMENTS if trial.calibrated.errors.select_observed(s).any()
    ]


def static_angles(
    model: SubjectModel, parameters: Parameters, static: Recording
) -> dict[str, float]:
    """Coordinate -> its value (m, rad) with which the model meets the still window of the static
    trial.
    """
    return _mean_coordinates(standing_problem(model, static), parameters)


def _mean_coordinates(standing: MotionProblem, parameters: Parameters) -> dict[str, float]:
    """Coordinate -> mean (m, rad) of the motion that meets the markers best."""
    motion = track_motion(standing, parameters)
    return dict(zip(motion.coordinates, map(float, motion.q.mean(axis=0)), strict=True))


@dataclass(frozen=True)
class Counted:
    """Fitted parameters, and from where their ankle angles are counted."""

    parameters: Parameters
    moved: Mapping[str, float]
    """Coordinate -> dz, rad, by which motions of the parameters as they were given read too much.
    """
    static: Mapping[str, float]  # `static_angles` of the parameters


def counted_from_static(model: SubjectModel, parameters: Parameters, static: Recording) -> Counted:
    """Fitted parameters whose ankles have the nominal model's angles in the static posture, by
    other zero angles.
    """
    standing = standing_problem(model, static)
    after, before = (_mean_coordinates(standing, p) for p in (parameters, model.nominal))
    zero, moved = parameters.zero_angles.copy(), {}
    for joint in JOINTS:
        turns = {e.axis: e for e in joint.elements if e.source is Source.COORDINATE}
        for e in joint.elements:
            if e.source is Source.ZERO_ANGLE and (turn := turns.get(e.axis)) is not None:
                moved[turn.name] = after[turn.name] - before[turn.name]
                zero[ZERO_ANGLES.index(e.name)] += e.sign * turn.sign * moved[turn.name]
    here = after | {name: before[name] for name in moved}
    return Counted(replace(parameters, zero_angles=zero), moved, here)


def shifted(coefficients: Array, coordinates: tuple[str, ...], moved: Mapping[str, float]) -> Array:
    """Coefficients (nn, nq) of a motion after `counted_from_static`: B-splines sum to one, they
    move as the angle.
    """
    out: Array = coefficients - np.array([moved.get(name, 0.0) for name in coordinates])
    return out
