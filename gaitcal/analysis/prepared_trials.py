"""The state of a calibration: one person's moving trials and models, stage by stage.

A `MovingTrial` is a trial of the study to which results are added: cleaned, rotated so that x is
forward, with its least-squares problems (`prepare_trial`), then with a motion and forces under the
feet for every model of the calibration (`track_trial`).
"""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from gaitcal.analysis.result import HeldOut, Stage, Uncertainty
from gaitcal.analysis.trial_bandwidth import Bandwidth, choose_bandwidth
from gaitcal.arrays import Array
from gaitcal.calibration import error_sources, inertial_calibration, joint_phases, joint_prior
from gaitcal.calibration.combined import CombinedFit
from gaitcal.calibration.soft_tissue_artefact import FoundTissue
from gaitcal.dynamics.ground_reactions import GroundReactions, compute_motion_reactions
from gaitcal.errors import Finding, InputError
from gaitcal.io.axes import rotate_to_progression
from gaitcal.io.recording import Recording, find_still_window
from gaitcal.model.linkage import LEGS, LOWER_BODY, find_base_segment, list_joint_segments
from gaitcal.model.parameters import (
    JOINT_PARAMETERS,
    JP_NAMES,
    ParameterKind,
    Parameters,
    list_isolated_parameters,
)
from gaitcal.model.subject_model import SubjectModel
from gaitcal.preprocess.preprocessed_study import PreprocessedStudy
from gaitcal.preprocess.static_disagreement import PossibleMove
from gaitcal.quality.force_diagnosis import ForceDiagnosis
from gaitcal.runtime import map_in_pairs
from gaitcal.study.normal_prior import JointPrior
from gaitcal.study.settings import CalibrationSettings, Protocol
from gaitcal.study.study_trial import Trial
from gaitcal.tracking import rigid, spline
from gaitcal.tracking.bandwidth import apply_bandwidth
from gaitcal.tracking.motion import Motion, track_motion
from gaitcal.tracking.soft_tissue import SoftTissue
from gaitcal.tracking.trial_problem import FEWEST_TRACKED_FRAMES, MotionProblem, build_trial_problem


@dataclass(frozen=True, kw_only=True)
class MovingTrial(Trial):
    """A moving trial with its least-squares problems, and their results so far.

    Its recording is rotated so that x is forward.
    """

    in_file_axes: Recording
    """The recording in the axes of its file."""
    bandwidth: Bandwidth
    whole_body_problem: MotionProblem
    """The whole body, with the bandwidth of the final motion."""
    reported_problem: MotionProblem
    """Problem of the reported marker errors: the segments of a functional trial's joint alone, or
    the whole body.
    """
    joint_fit_problem: MotionProblem
    """Problem of the joint fit: `reported_problem`, or pelvis and legs if all trials are
    fitted at once.
    """
    tissue: SoftTissue | None = None
    """Soft tissue artefact of the markers of `whole_body_problem`, for the error bars."""
    stages: Mapping[Stage, tuple[Parameters, Motion]] = field(default_factory=dict)
    """Every model so far, in order, each with the whole-body motion tracked with it; the nominal
    motion of a functional trial is of the segments of its joint."""
    reactions: GroundReactions | None = None
    """On the feet; None without force plates."""
    scores: error_sources.MarkerScores | None = None
    """Of the markers of a gait trial."""
    held_out: HeldOut | None = None

    def with_tissue(self, tissue: SoftTissue | None, found: FoundTissue) -> "MovingTrial":
        """Return the trial with soft tissue on the markers of the body.

        Parameters
        ----------
        tissue : SoftTissue or None
            The artefact of this trial.
        found : FoundTissue
            The fitted artefact, with constant displacements of markers.

        Returns
        -------
        MovingTrial
        """
        body = found.displace_markers(replace(self.whole_body_problem, tissue=tissue))
        if body.data.shift is None:
            return replace(self, tissue=tissue)
        shift = dict(zip(body.labels, body.data.shift, strict=True))

        def displace(problem: MotionProblem) -> MotionProblem:
            return problem.shift_markers(np.array([shift[label] for label in problem.labels]))

        return replace(
            self,
            tissue=tissue,
            whole_body_problem=displace(self.whole_body_problem),
            reported_problem=displace(self.reported_problem),
            joint_fit_problem=displace(self.joint_fit_problem),
        )

    @property
    def body_with_tissue(self) -> MotionProblem:
        """The whole body with the soft tissue artefact of its error bars."""
        return replace(self.whole_body_problem, tissue=self.tissue)

    @property
    def nominal(self) -> Motion:
        """The motion with the nominal model."""
        return self.stages[Stage.NOMINAL][1]

    @property
    def parameters(self) -> Parameters:
        """Of the last model."""
        return self._last[0]

    @property
    def motion(self) -> Motion:
        """Of the whole body, with the last model."""
        return self._last[1]

    @property
    def _last(self) -> tuple[Parameters, Motion]:
        return list(self.stages.values())[-1]

    def with_stage(self, stage: Stage, parameters: Parameters, motion: Motion) -> "MovingTrial":
        """Return the trial with one more model, and the motion tracked with it.

        Parameters
        ----------
        stage : Stage
            Which model.
        parameters : Parameters
            Its parameters.
        motion : Motion
            The motion of the whole body with them.

        Returns
        -------
        MovingTrial
        """
        return replace(self, stages={**self.stages, stage: (parameters, motion)})

    def with_marker_scores(self, uncertainty: Uncertainty) -> "MovingTrial":
        """Return the trial with the scores of its markers about the last model.

        Parameters
        ----------
        uncertainty : Uncertainty
            Errors of the joint parameters.

        Returns
        -------
        MovingTrial
            A functional trial is returned unchanged: nothing uses its scores.
        """
        if self.joint is not None:
            return self
        scores = error_sources.compute_marker_scores(
            self.body_with_tissue, self.motion.coefficients, self.parameters, uncertainty.joint
        )
        return replace(self, scores=scores)


@dataclass(frozen=True, kw_only=True)
class CalibrationState:
    """State that one stage of a calibration hands on to the next."""

    model: SubjectModel
    """The person: nominal in a calibration, calibrated if further trials are analysed."""
    settings: CalibrationSettings
    parameters: Parameters
    """Of the last model."""
    trials: tuple[MovingTrial, ...]
    static: Recording | None = None
    """The static trial, completed; None if further trials are analysed."""
    prior: JointPrior = field(default_factory=lambda: joint_prior.combine_joint_priors({}))
    """Of anatomy, study and cohort."""
    checked: tuple[Finding, ...] = ()
    """Findings of the checks before the fits."""
    possible_moves: Mapping[str, Mapping[str, PossibleMove]] = field(default_factory=dict)
    """Trial -> segment -> possible displacement of its markers since the static trial."""
    findings: tuple[Finding, ...] = ()
    """Outliers of robust losses, and functional trials that were left out."""
    joint: joint_phases.JointCalibration | None = None
    """None if the settings keep the joints."""
    static_angles: Mapping[str, float] = field(default_factory=dict)
    """Coordinate -> m, rad, of the last model in the static posture."""
    force_diagnosis: ForceDiagnosis = field(default_factory=ForceDiagnosis)
    inertial: inertial_calibration.InertialFit | None = None
    combined: CombinedFit | None = None
    uncertainty: Uncertainty = field(default_factory=lambda: Uncertainty(None, None))

    @property
    def walks(self) -> tuple[MovingTrial, ...]:
        """The trials of the whole body: walks and other activities."""
        return tuple(trial for trial in self.trials if trial.joint is None)


def prepare_calibration(
    preprocessed: PreprocessedStudy, checked: Sequence[Finding] = ()
) -> CalibrationState:
    """Pose the tracking problems of the moving trials for the nominal model.

    Parameters
    ----------
    preprocessed : PreprocessedStudy
        From `preprocess_study`.
    checked : sequence of Finding
        Findings of the checks.

    Returns
    -------
    CalibrationState
        Before any fit.

    Raises
    ------
    InputError
        The static trial gives no nominal model, or a trial has too few markers.
    """
    study, model = preprocessed.study, preprocessed.nominal
    trials = map_in_pairs(
        lambda evidence: prepare_trial(evidence.trial, model, study.settings), preprocessed.moving
    )
    prior = joint_prior.combine_joint_priors(
        study.settings.joint_prior, study.joint_prior, model.noise
    )
    possible_moves = preprocessed.find_possible_moves()
    possible_errors = _collect_possible_errors(possible_moves, study.moving)
    return CalibrationState(
        model=model,
        settings=study.settings,
        parameters=model.parameters,
        trials=tuple(trials),
        static=preprocessed.completed.static,
        prior=replace(prior.widen(study.loosened), doubted=possible_errors),
        possible_moves=possible_moves,
        checked=tuple(checked),
    )


def _collect_possible_errors(
    possible_moves: Mapping[str, Mapping[str, PossibleMove]], trials: Sequence[Trial]
) -> dict[str, float]:
    """Collect joint parameter -> m or rad by which it is wrong if markers moved in any trial.

    Only trials that determine the joint are considered; the largest value counts.
    """
    out = dict[str, float]()
    for trial in trials:
        names = JP_NAMES if trial.joint is None else list_isolated_parameters(trial.joint)
        for p in JOINT_PARAMETERS:
            move = possible_moves.get(trial.name, {}).get(p.segment)
            if move is None or p.name not in names:
                continue
            # Displaced markers take joint centres along by the shift (m) and axes by the rotation
            # (rad).
            size = move.shift if p.kind is ParameterKind.POSITION else float(move.rotation[p.axis])
            out[p.name] = max(size, out.get(p.name, 0.0))
    return out


def fits_legs_together(settings: CalibrationSettings) -> bool:
    """Return whether the joint parameters of all trials are fitted at once, by pelvis and legs."""
    return (
        settings.jp
        and settings.decided_by is Protocol.PUBLISHED
        and settings.mode == "simultaneous"
    )


def prepare_trial(trial: Trial, model: SubjectModel, settings: CalibrationSettings) -> MovingTrial:
    """Rotate a cleaned trial so that x is forward, choose its bandwidth and set up its problems.

    Parameters
    ----------
    trial : Trial
        A moving trial, cleaned, in the axes of its file.
    model : SubjectModel
        The person; its nominal parameters smooth the problems.
    settings : CalibrationSettings
        Of the study.

    Returns
    -------
    MovingTrial
        Without motions.

    Raises
    ------
    InputError
        Too few markers or frames.
    """
    # Coordinates of the pelvis and the prior of the trunk assume that x is forward.
    direction = estimate_forward_direction(model, trial.recording)
    recording = rotate_to_progression(trial.recording, direction)
    rule = spline.ControlPointRule(
        settings.nodes_per_second or spline.NODES_PER_SECOND, settings.nodes
    )
    joint = trial.joint

    def build_part(segments: Sequence[str]) -> MotionProblem:
        return build_trial_problem(
            trial.name,
            model,
            recording,
            rule,
            root=segments[0],
            segments=tuple(segments),
            isolated=joint,
        )

    body = build_trial_problem(
        trial.name,
        model,
        recording,
        rule,
        fallback_base_segment=find_base_segment(joint),
        isolated=joint,
    )
    recording = recording.with_notes(*_describe_assumptions(body, joint))
    # In a functional trial the other segments may lack markers: its joint is tracked by itself.
    alone = body if joint is None else build_part(list_joint_segments(joint))
    rotated = replace(trial, recording=recording)
    bandwidth = choose_bandwidth(alone, rotated, model, settings)

    def smooth(problem: MotionProblem, hz: float) -> MotionProblem:
        return apply_bandwidth(problem, model.nominal, hz) if bandwidth.penalised else problem

    body = smooth(body, bandwidth.motion_hz)
    # A walk whose joints and motion have one bandwidth needs one problem only.
    is_same = joint is None and bandwidth.joints_hz == bandwidth.motion_hz
    fitted = body if is_same else smooth(body if joint is None else alone, bandwidth.joints_hz)
    joints = fitted
    if fits_legs_together(settings):
        legs = LOWER_BODY[1:] if joint is None else LEGS[joint[-1]]
        try:
            joints = smooth(build_part(("pelvis", *legs)), bandwidth.joints_hz)
        except InputError:
            # A functional trial without pelvis markers is fitted by its joint alone.
            if joint is None:
                raise
    return MovingTrial(
        **rotated.collect_fields(),
        in_file_axes=trial.recording,
        bandwidth=bandwidth,
        whole_body_problem=body,
        reported_problem=fitted,
        joint_fit_problem=joints,
    )


def _describe_assumptions(body: MotionProblem, joint: str | None) -> list[str]:
    """Describe which coordinates of a whole-body problem a prior or zero determines."""
    notes = []
    if body.guessed:
        notes.append(
            f"markers do not determine {', '.join(body.guessed)}: a prior on walking does (trunk "
            "upright in the laboratory, arms hanging along it), with its standard deviation"
        )
    if body.held:
        notes.append(
            f"the pelvis has too few markers: {find_base_segment(joint)} is the base segment, "
            f"{', '.join(body.held)} held at zero"
        )
    return notes


def estimate_forward_direction(model: SubjectModel, recording: Recording) -> Array | None:
    """Estimate the mean forward direction of the pelvis from its markers.

    Parameters
    ----------
    model : SubjectModel
        With the markers of the pelvis.
    recording : Recording
        A trial, in the axes of its file.

    Returns
    -------
    (3,) array or None
        Mean of the pelvis' x axis over the frames that determine its pose, in the axes of the
        recording; None if there is no such frame.
    """
    fit = rigid.fit_segment(model.markers, "pelvis", recording)
    return None if fit is None else np.asarray(fit.rotation[fit.determined][:, :, 0].mean(axis=0))


def build_static_problem(model: SubjectModel, static: Recording) -> MotionProblem:
    """Build the tracking problem of the mean posture in the still window of the static trial.

    Parameters
    ----------
    model : SubjectModel
        The person.
    static : Recording
        The static trial, completed.

    Returns
    -------
    MotionProblem
        A short trial in which every marker keeps its mean position.
    """
    still = find_still_window(static, model.markers.labels).frames
    with warnings.catch_warnings():
        # A marker without positions in the window has none in the mean.
        warnings.simplefilter("ignore", RuntimeWarning)
        # One order of memory, so that a file and its conversion give the same bits.
        mean = np.nanmean(np.ascontiguousarray(static.markers[still]), axis=0)
    posture = np.repeat(mean[None], FEWEST_TRACKED_FRAMES, axis=0)
    window = replace(static, time=np.arange(FEWEST_TRACKED_FRAMES) / 100.0, markers=posture)
    return build_trial_problem("static", model, window, spline.ControlPointRule())


def track_trial(trial: MovingTrial, state: CalibrationState, stage: Stage) -> MovingTrial:
    """Track a trial with the nominal and the last model and compute its ground reactions.

    Parameters
    ----------
    trial : MovingTrial
        From `prepare_trial`.
    state : CalibrationState
        With the nominal and the last model.
    stage : Stage
        Of the last model.

    Returns
    -------
    MovingTrial
        With motions, ground reactions (whole body on force plates) and marker scores.
    """
    model, parameters = state.model, state.parameters
    part = trial.whole_body_problem if trial.joint is None else trial.reported_problem
    # The nominal motion is the one before any fit, so without soft tissue.
    nominal = track_motion(part.shift_markers(None), model.nominal)
    trial = trial.with_stage(Stage.NOMINAL, model.nominal, nominal)
    if trial.joint is not None and stage is Stage.NOMINAL:
        # The nominal motion of a functional trial has the segments of its joint alone: the whole
        # body is a further stage.
        stage = Stage.JP
    if stage is not Stage.NOMINAL:
        trial = trial.with_stage(
            stage, parameters, track_motion(trial.whole_body_problem, parameters)
        )
    if trial.joint is None and trial.recording.plates:
        reactions = compute_trial_reactions(trial, model, parameters, trial.motion, state.settings)
        trial = replace(trial, reactions=reactions)
    return trial.with_marker_scores(state.uncertainty)


def compute_trial_reactions(
    trial: Trial,
    model: SubjectModel,
    parameters: Parameters,
    motion: Motion,
    settings: CalibrationSettings,
) -> GroundReactions:
    """Compute the ground reactions on the feet at the frames of a whole-body motion.

    `trial`: with force plates, rotated as the motion.
    """
    hz = choose_force_cutoff(trial, motion, settings)
    return compute_motion_reactions(model, parameters, motion, trial.recording, trial.plates, hz)


def choose_force_cutoff(
    trial: Trial, motion: Motion, settings: CalibrationSettings
) -> float | None:
    """Choose the cut-off frequency of the force filter of a trial.

    `trial`: its `filter_hz` takes precedence over the settings. `motion`: with its cut-off, which
    `matched` forces share. `settings`: with `force_filter_hz`. Returns: Hz; None for no filter.
    """
    chosen = settings.force_filter_hz if trial.filter_hz is None else trial.filter_hz
    if chosen == "none":
        return None
    return motion.cutoff_hz if chosen == "matched" else float(chosen)
