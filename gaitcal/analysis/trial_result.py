"""Assemble the result of one trial from its motions: moments, standard errors, marker errors.

A calibration assembles its trials here, and `gaitcal dynamics` every further trial of the
calibrated person.

Ankle angles are zeroed in the static posture (`model/ankle_zero.py`). A fit rotates the two axes of
an ankle, and with other axes the same posture has other coordinates: all ankle angles of a walk
would change although the feet did not move. So after every fit of joint parameters the zero angles
z of the two joints are moved by

    dz = q(static, fitted model) - q(static, nominal model)

in the direction of their coordinate, and the coordinate of every motion by -dz. Positions, torques
and markers stay the same.
"""

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from gaitcal.analysis.fit_findings import check_tracked_trial, diagnose_forces, is_trunk_unmeasured
from gaitcal.analysis.prepared_trials import (
    CalibrationState,
    MovingTrial,
    build_static_problem,
    prepare_trial,
    track_trial,
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
from gaitcal.gait.events import GaitEvents, find_activity_events, find_crouches, find_trial_events
from gaitcal.gait.moments import describe_segment
from gaitcal.gait.spatiotemporal import Stride, assign_stride_lines, check_strides, measure_strides
from gaitcal.gait.strides import (
    FootAxes,
    compute_facing,
    compute_foot_axes,
    get_pelvis_angles,
    measure_out_of_plane,
)
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
from gaitcal.quality.force_diagnosis import check_pelvis_residual
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
    possible_displacements: Mapping[str, PossibleMove],
) -> TrialResult:
    """Track one further trial of the whole body with a calibrated model and compute its torques.

    Parameters
    ----------
    model : SubjectModel
        Calibrated, as `gaitcal.load_model` returns it.
    trial : Trial
        Clean (`preprocess_trial`), markers named as in the model; with plates if torques are
        wanted.
    settings : CalibrationSettings
        Of the calibration: splines, force filter and errors of force plates.
    uncertainty : Uncertainty
        Of the calibration, for standard errors.
    possible_displacements : mapping
        Segment -> possible displacement of its markers since the static trial
        (`find_possible_moves_of_trial`).

    Returns
    -------
    TrialResult

    Raises
    ------
    InputError
        Too few markers or frames.
    """
    prepared = prepare_trial(trial, model, settings)
    if uncertainty.joint is not None:
        found = uncertainty.tissue
        activity = trial.name if trial.role is Role.MOTION else ""
        # Soft tissue moves alike in one kind of task: the calibration has estimated it for some
        # kinds.
        kind = soft_tissue_artefact.choose_kind_for_trial(found, activity)
        tissue = soft_tissue_artefact.make_further_tissue(
            prepared.whole_body_problem,
            joint_phases.take_segments(prepared.joint_fit_problem, LOWER_BODY, model.nominal),
            model.nominal,
            uncertainty.joint.names,
            found,
            kind,
        )
        prepared = prepared.with_tissue(tissue, found)
    state = CalibrationState(
        model=model,
        settings=settings,
        parameters=model.parameters,
        trials=(prepared,),
        possible_moves={trial.name: possible_displacements},
        uncertainty=uncertainty,
    )
    state = replace(state, trials=(track_trial(prepared, state, Stage.JP_IP),))
    state = replace(state, force_diagnosis=diagnose_forces(state))
    result = assemble_trial_result(state.trials[0], state)
    return replace(
        result, tracking_findings=(*result.tracking_findings, *state.force_diagnosis.findings)
    )


def assemble_trial_result(trial: MovingTrial, state: CalibrationState) -> TrialResult:
    """Assemble the result of a tracked trial of a session.

    `state`: with models, errors and the force diagnosis.
    """
    motion_sensitivity = None
    if trial.joint is None:
        joint, coefficients = state.uncertainty.joint, trial.motion.coefficients
        # How the motion follows its markers and the joint parameters: all error bars of angles and
        # torques use it.
        motion_sensitivity = error_sources.compute_motion_sensitivity(
            trial.body_with_tissue, coefficients, trial.parameters, joint, trial.scores
        )
    deviations = estimate_axis_deviations(
        state.settings, state.model, state.possible_moves.get(trial.name)
    )
    axes = AxisErrors(trial.parameters, deviations)
    forces = _make_force_errors(trial, state, axes, motion_sensitivity)
    if forces is None:
        return _assemble_without_torque_errors(trial, state, axes, motion_sensitivity)
    # Variances are products of matrices, which let this thread compute the rest meanwhile.
    with ThreadPoolExecutor(1) as pool:
        parts = pool.map(with_one_blas_thread(forces.compute_variances), forces.parts)
        result = _assemble_without_torque_errors(trial, state, axes, motion_sensitivity)
    errors = torque_errors.join_variances(list(parts))
    return _with_torque_errors(result, errors, state.model.subject.weight)


def _assemble_without_torque_errors(
    trial: MovingTrial,
    state: CalibrationState,
    axes: AxisErrors,
    motion_sensitivity: error_sources.MotionSensitivity | None,
) -> TrialResult:
    """Assemble all of the result but the errors of torques."""
    whole_body_motion, final, subject = trial.motion, trial.parameters, state.model.subject
    events, strides = _detect_events(trial, state.model.with_parameters(final))
    # Feet and pelvis are measured against the direction of each stride.
    lines = assign_stride_lines(strides, whole_body_motion.time)
    long_axes, by_coordinate = compute_foot_axes(whole_body_motion, final, lines)
    variances, coordinate_errors, trial_errors = None, None, None
    if motion_sensitivity is not None:
        count = whole_body_motion.q.shape[1]
        # The columns after the coordinates are the directions of the feet.
        variances = error_sources.compute_coordinate_variances(
            trial.whole_body_problem, motion_sensitivity, by_coordinate
        )
        coordinate_errors = error_sources.compute_coordinate_errors(
            trial.whole_body_problem,
            motion_sensitivity,
            axes.compute_coordinate_errors(whole_body_motion.q),
            variances[0][:, :count],
        )
        trial_errors = np.sqrt(variances[1][:, :count])
    feet = None
    if not trial.joint:
        rotations = axes.compute_segment_rotations(whole_body_motion.q)
        feet = _estimate_foot_axes(long_axes, lines, variances, rotations)
    loads = _compute_loads(trial, subject.bwh)
    phase_parameters = joint_phases.get_parameters_for_trial(state.joint, trial.name, final)
    phase_motion, final_motion = whole_body_motion, whole_body_motion
    if trial.joint is not None:
        final_motion = track_motion(trial.reported_problem, final)
        phase_motion = (
            final_motion
            if phase_parameters is final
            else track_motion(trial.reported_problem, phase_parameters)
        )
    # The floor belongs to the motion that it is compared with.
    floor_parameters = final if trial.joint is None else phase_parameters
    return TrialResult(
        name=trial.name,
        role=trial.role,
        joint=trial.joint,
        recording=trial.recording,
        nominal=trial.nominal,
        calibrated=phase_motion,
        final=final_motion,
        floor=compute_rigid_floor(trial.reported_problem),
        joint_floor=compute_joint_floor(trial.reported_problem, floor_parameters, phase_motion.q),
        body=whole_body_motion,
        loads=loads,
        coordinate_errors=coordinate_errors,
        trial_coordinate_errors=trial_errors,
        foot_axes=feet,
        held_out=trial.held_out,
        bandwidth=trial.bandwidth,
        events=events,
        strides=strides,
        tracking_findings=(
            *check_tracked_trial(trial, loads, subject.weight),
            *check_strides(trial.name, strides),
            *_check_crouches(
                trial.name, whole_body_motion, events, activity=trial.role is Role.MOTION
            ),
        ),
    )


def _detect_events(
    trial: MovingTrial, model: SubjectModel
) -> tuple[GaitEvents, tuple[Stride, ...]]:
    """Detect foot events or repetitions of a trial, and measure its strides."""
    body, is_activity = trial.motion, trial.role is Role.MOTION
    events = GaitEvents()
    if not trial.joint:
        events = find_trial_events(model, body, trial.reactions, trial.recording)
    if is_activity:
        events = find_activity_events(body, events)
    feet = None
    if ground_reactions.has_feet(model):
        feet = ground_reactions.compute_foot_points(model, body, trial.parameters)
    # No stride of an activity is left out for a turn.
    direction = None if trial.joint or is_activity else compute_facing(get_pelvis_angles(body))
    unobserved = ground_reactions.find_unobserved_frames(body)
    return events, measure_strides(events, body.time, feet, unobserved, direction)


def _compute_loads(trial: MovingTrial, bwh: float) -> Loads | None:
    """Compute generalised forces of every stage; `bwh` in N·m; None without force plates."""
    reactions = trial.reactions
    if reactions is None:
        return None
    moments = {
        stage: inverse_dynamics.compute_moments(parameters, motion, reactions.wrench, bwh)
        for stage, (parameters, motion) in trial.stages.items()
    }
    kinetics = joint_kinetics.compute_kinetics(trial.parameters, trial.motion, reactions.wrench)
    return Loads(reactions, moments, None, kinetics)


def _check_crouches(
    trial: str, body: Motion, events: GaitEvents, *, activity: bool = False
) -> tuple[Finding, ...]:
    """Note squats and sitting down outside strides and repetitions."""
    height = body.q[:, body.coordinates.index("pelvis_ty")]
    repetitions = [(c.start, c.stop) for c in events.repeats]
    counted = list[FootEvents]()
    # Time that is counted already: repetitions, or strides of both feet.
    if repetitions:
        counted = [FootEvents(*np.transpose(repetitions))]
    elif events.events:
        counted = [events.select_foot(side) for side in SIDES]
    if not counted and not activity:
        return ()
    found = [span for span in find_crouches(body.time, height, counted) if span not in repetitions]
    if not found:
        return ()
    if events.events:
        cause = "not all of the trial is steps"
        why = "while no foot steps; only strides are counted"
    else:
        cause = "not all of the trial is repetitions"
        why = (
            "outside the repetitions: without rest at the same height before it, or by less than "
            "half of the others"
        )
    when = ", ".join(f"{start:.2f}-{stop:.2f}" for start, stop in found)
    return (
        Finding(
            severity=Severity.INFO,
            topic="strides",
            where=trial,
            cause=cause,
            found=f"{when} s: the pelvis goes down and up {why}",
            cure="to count squats, rises and jumps, add the file as a further trial with its time "
            'and role = "motion"',
            code=Code.NOT_ALL_STEPS,
        ),
    )


def _estimate_foot_axes(
    long_axes: Array,
    lines: Array,
    variances: tuple[Array, Array] | None,
    rotations: Mapping[str, Array],
) -> FootAxes:
    """Estimate directions of the feet with errors from markers and from the foot's axes.

    `long_axes`: (nf, 2, 3) unit vectors, right and left. `lines`: (nf, 2) rad, lines of
    progression. `variances`: rad^2, of the feet in the last columns: by all sources, and by the
    markers of the trial; None if unknown. `rotations`: segment -> (nf, k, 3) rad, standard
    deviations of its axes.
    """
    if variances is None:
        return FootAxes(long_axes)
    _, normals = measure_out_of_plane(long_axes, lines)
    of_feet = slice(-len(inverse_dynamics.FEET), None)
    variance, trial_variance = (both[:, of_feet].copy() for both in variances)
    for k, foot in enumerate(inverse_dynamics.FEET):
        if foot in rotations:
            # Only the part of a rotation about the vertical changes the horizontal direction.
            components = np.einsum("fki,fi->fk", rotations[foot], normals[:, k])
            variance[:, k] += np.square(components).sum(axis=1)
    return FootAxes(long_axes, np.sqrt(variance), np.sqrt(trial_variance))


def estimate_axis_deviations(
    settings: CalibrationSettings,
    model: SubjectModel,
    possible_displacements: Mapping[str, PossibleMove] | None = None,
) -> Mapping[str, tuple[float, float, float]]:
    """Estimate by how much the axes of segments may deviate from the anatomical ones.

    Parameters
    ----------
    settings : CalibrationSettings
        With `segment_axes`: zero if `exact`.
    model : SubjectModel
        Its `noise` scales the deviations of palpated landmarks.
    possible_displacements : mapping, optional
        Segment of one side -> possible displacement of its markers in a trial.

    Returns
    -------
    mapping
        Segment -> standard deviations, deg, about its x, y and z axis; of both sides together, and
        of a single side if it is in `possible_displacements`.
    """
    if settings.segment_axes == "exact":
        return EXACT_AXES
    scale = 1.0 if model.noise is None else model.noise.joints
    out = {
        segment: (scale * x, scale * y, scale * z) for segment, (x, y, z) in PALPATED_DEG.items()
    }
    for segment, move in (possible_displacements or {}).items():
        # deg: palpation and a possible displacement of the markers are independent.
        x, y, z = np.hypot(out[get_segment(segment).name], np.rad2deg(move.rotation)).tolist()
        out[segment] = x, y, z
    return out


def _with_torque_errors(result: TrialResult, errors: TorqueErrors, weight: float) -> TrialResult:
    """Return the result with torque errors, and findings on the pelvis residual; `weight` in N."""
    if result.loads is None:
        return result
    body, reactions = result.body, result.loads.reactions
    expected = estimate_expected_residual(result.loads.final, errors, reactions, body, weight)
    beyond = (
        ()
        if expected is None
        else check_pelvis_residual(result.name, expected, not is_trunk_unmeasured(body))
    )
    loads = replace(result.loads, errors=errors, expected=expected)
    return replace(result, loads=loads, tracking_findings=(*result.tracking_findings, *beyond))


def _make_force_errors(
    trial: MovingTrial,
    state: CalibrationState,
    axes: AxisErrors,
    motion_sensitivity: error_sources.MotionSensitivity | None,
) -> torque_errors.ForceErrors | None:
    """Set up the errors of the final moments.

    None without forces, and for impossible bodies, whose mass matrix has no meaning.
    """
    if trial.reactions is None or find_impossible_bodies(trial.parameters.inertial):
        return None
    plates = PlateErrors.from_table(state.settings.plate_error)
    return torque_errors.ForceErrors(
        trial.whole_body_problem,
        trial.motion.coefficients,
        trial.parameters,
        trial.reactions.wrench,
        state.uncertainty.joint,
        state.uncertainty.inertial,
        motion_sensitivity,
        plates.add(state.force_diagnosis.possible.get(trial.name)),
        axes,
    )


@dataclass(frozen=True, kw_only=True)
class RmsErrors:
    """RMS distance (mm) between measured and model markers; None without markers."""

    label: str
    nominal: float | None
    calibrated: float | None
    floor: float | None
    """Of rigid segments."""
    joint_floor: float | None = None
    """Of each joint by itself."""
    rigid: bool = True
    """False for one segment with fewer than three markers: it can follow them almost exactly."""

    @property
    def ratio(self) -> float | None:
        """Calibrated over floor; None if the floor is no reference."""
        if self.calibrated is None or not self.floor or not self.rigid:
            return None
        return self.calibrated / self.floor

    @property
    def joint_ratio(self) -> float | None:
        """Calibrated over joint floor; None for segments in no joint, or with few markers."""
        if self.calibrated is None or not self.joint_floor or not self.rigid:
            return None
        return self.calibrated / self.joint_floor


def summarise_trial_fit(trial: TrialResult, *segments: str) -> RmsErrors:
    """Summarise the marker errors of one trial.

    Parameters
    ----------
    trial : TrialResult
        The trial.
    *segments : str
        Segments whose markers are used; all if none is given.

    Returns
    -------
    RmsErrors
    """
    nominal, calibrated, floor = trial.compute_rms_mm(*segments)
    # With one or two markers the segment follows them nearly exactly: its floor is zero.
    is_rigid = (
        len(segments) != 1
        or int(trial.calibrated.errors.select_observed(*segments).sum()) >= FEWEST_MARKERS
    )
    return RmsErrors(
        label=describe_segment(segments[0]) if len(segments) == 1 else trial.name,
        nominal=nominal,
        calibrated=calibrated,
        floor=floor,
        joint_floor=trial.compute_joint_floor_mm(*segments),
        rigid=is_rigid,
    )


def summarise_leg_fit(trial: TrialResult) -> RmsErrors:
    """Summarise the errors of the markers of pelvis and legs, whose joints are calibrated."""
    return summarise_trial_fit(trial, *LOWER_BODY)


def summarise_segment_fits(trial: TrialResult) -> list[RmsErrors]:
    """Summarise the marker errors of each segment that has markers in this trial."""
    errors = trial.calibrated.errors
    return [summarise_trial_fit(trial, s) for s in SEGMENTS if errors.select_observed(s).any()]


def compute_static_angles(
    model: SubjectModel, parameters: Parameters, static: Recording
) -> dict[str, float]:
    """Compute the coordinates of the model in the still window of the static trial.

    Returns: coordinate -> m, rad.
    """
    return _compute_mean_coordinates(build_static_problem(model, static), parameters)


def _compute_mean_coordinates(posture: MotionProblem, parameters: Parameters) -> dict[str, float]:
    """Compute coordinate -> mean (m, rad) of the motion that fits the markers best."""
    motion = track_motion(posture, parameters)
    return dict(zip(motion.coordinates, map(float, motion.q.mean(axis=0)), strict=True))


@dataclass(frozen=True)
class AnkleZeroCorrection:
    """Parameters after zeroing the ankle angles in the static posture."""

    parameters: Parameters
    offsets: Mapping[str, float]
    """Coordinate -> dz, rad, to subtract from motions of the parameters before the correction."""
    static_angles: Mapping[str, float]
    """Coordinate -> m, rad, of the corrected parameters in the static posture."""


def zero_ankle_angles(
    model: SubjectModel, parameters: Parameters, static: Recording
) -> AnkleZeroCorrection:
    """Move the zero angles of the ankles so that the static posture keeps its nominal angles."""
    posture = build_static_problem(model, static)
    after, before = (_compute_mean_coordinates(posture, p) for p in (parameters, model.nominal))
    zero, offsets = parameters.zero_angles.copy(), {}
    for joint in JOINTS:
        coordinates = {e.axis: e for e in joint.elements if e.source is Source.COORDINATE}
        for e in joint.elements:
            # A zero angle about the axis of a coordinate shifts that coordinate.
            if e.source is Source.ZERO_ANGLE and e.axis in coordinates:
                coordinate = coordinates[e.axis]
                offset = after[coordinate.name] - before[coordinate.name]
                offsets[coordinate.name] = offset
                zero[ZERO_ANGLES.index(e.name)] += e.sign * coordinate.sign * offset
    corrected = after | {name: before[name] for name in offsets}
    return AnkleZeroCorrection(replace(parameters, zero_angles=zero), offsets, corrected)


def shift_coefficients(
    coefficients: Array, coordinates: tuple[str, ...], offsets: Mapping[str, float]
) -> Array:
    """Subtract offsets from the spline coefficients of a motion.

    B-splines sum to one, so coefficients shift as the coordinate does.

    Parameters
    ----------
    coefficients : (nn, nq) array
        Control points, m and rad.
    coordinates : tuple of str
        Name of each column.
    offsets : mapping
        Coordinate -> m, rad; zero if missing.

    Returns
    -------
    (nn, nq) array
    """
    out: Array = coefficients - np.array([offsets.get(name, 0.0) for name in coordinates])
    return out
