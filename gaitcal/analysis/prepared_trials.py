"""A session: one person's moving trials and models, as far as the stages of a calibration have
come.

A `MovingTrial` is a trial of the study that grows: cleaned and turned so that x is forward, with
its least-squares problems (`prepared`), then with a motion and forces under the feet for every
model that is reached (`tracked`).
"""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace

import numpy as np

from gaitcal.analysis.result import HeldOut, Stage, Uncertainty
from gaitcal.analysis.trial_bandwidth import Bandwidth, bandwidth_of
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
from gaitcal.study.cohort_prior import JointPrior
from gaitcal.study.settings import CalibrationSettings, Protocol
from gaitcal.study.study_trial import Trial
from gaitcal.tracking import rigid, spline
from gaitcal.tracking.bandwidth import apply_bandwidth
from gaitcal.tracking.motion import Motion, track_motion
from gaitcal.tracking.soft_tissue import SoftTissue
from gaitcal.tracking.trial_problem import FEWEST_FRAMES, MotionProblem, build_trial_problem


@dataclass(frozen=True, kw_only=True)
class MovingTrial(Trial):
    """A moving trial with its least-squares problems, and what these have given so far.

    Its recording is turned so that x is forward.
    """

    in_file_axes: Recording  # The recording in the axes of its file
    bandwidth: Bandwidth
    body: MotionProblem  # The whole body, with the bandwidth of the motion that leaves the trial
    fitted: MotionProblem
    """What fit figures are about: the segments of an isolated trial's joint alone, or the whole
    body.
    """
    joints: MotionProblem
    """What joint parameters are fitted by: `fitted`, or pelvis and legs where all trials are fitted
    at once.
    """
    tissue: SoftTissue | None = (
        None  # The skin that moves on the markers of `body`: what error bars count
    )
    stages: Mapping[Stage, tuple[Parameters, Motion]] = field(default_factory=dict)
    """Every model that was reached, in order, each with the whole-body motion tracked with it; the
    nominal motion of an isolated trial is of the segments of its joint."""
    reactions: GroundReactions | None = None  # On the feet; None without force plates
    scores: error_sources.MarkerScores | None = None  # Of the markers of a gait trial
    held_out: HeldOut | None = None

    def with_tissue(self, tissue: SoftTissue | None, found: FoundTissue) -> "MovingTrial":
        """With the skin that moves on the markers of the body, which are where `found` has them."""
        body = found.displace_markers(replace(self.body, tissue=tissue))
        if body.data.shift is None:
            return replace(self, tissue=tissue)
        shift = dict(zip(body.labels, body.data.shift, strict=True))

        def displaced(problem: MotionProblem) -> MotionProblem:
            return problem.shift_markers(np.array([shift[label] for label in problem.labels]))

        return replace(
            self,
            tissue=tissue,
            body=displaced(self.body),
            fitted=displaced(self.fitted),
            joints=displaced(self.joints),
        )

    @property
    def with_skin(self) -> MotionProblem:
        """The whole body with the skin that its error bars count."""
        return replace(self.body, tissue=self.tissue)

    @property
    def nominal(self) -> Motion:
        """The motion with the nominal model."""
        return self.stages[Stage.NOMINAL][1]

    @property
    def parameters(self) -> Parameters:
        """Of the last model that was reached."""
        return self._last[0]

    @property
    def motion(self) -> Motion:
        """Of the whole body, with the last model that was reached."""
        return self._last[1]

    @property
    def _last(self) -> tuple[Parameters, Motion]:
        return list(self.stages.values())[-1]

    def reached(self, stage: Stage, parameters: Parameters, motion: Motion) -> "MovingTrial":
        """With one more model, and the motion tracked with it."""
        return replace(self, stages={**self.stages, stage: (parameters, motion)})

    def scored(self, uncertainty: Uncertainty) -> "MovingTrial":
        """With the scores of its markers about the last model; an isolated trial needs none."""
        if self.joint is not None:
            return self
        scores = error_sources.compute_marker_scores(
            self.with_skin, self.motion.coefficients, self.parameters, uncertainty.joint
        )
        return replace(self, scores=scores)


@dataclass(frozen=True, kw_only=True)
class CalibrationState:
    """What the stages of a calibration hand on."""

    # The person: nominal in a calibration, calibrated where further trials are analysed
    model: SubjectModel
    settings: CalibrationSettings
    parameters: Parameters  # Of the last model that was reached
    trials: tuple[MovingTrial, ...]
    static: Recording | None = (
        None  # The static trial, completed; None where further trials are analysed
    )
    prior: JointPrior = field(
        default_factory=lambda: joint_prior.make_study_prior({})
    )  # Of anatomy, study and cohort
    checked: tuple[Finding, ...] = ()  # What the checks found before anything was fitted
    possible_moves: Mapping[str, Mapping[str, PossibleMove]] = field(default_factory=dict)
    """Trial -> segment -> what its markers may have done since the static trial."""
    findings: tuple[Finding, ...] = ()  # What robust losses left out
    joint: joint_phases.JointCalibration | None = (
        None  # None where the settings leave joint parameters alone
    )
    static_angles: Mapping[str, float] = field(default_factory=dict)
    """Coordinate -> m, rad: with which the last model meets the static posture."""
    forces: ForceDiagnosis = field(default_factory=ForceDiagnosis)
    inertial: inertial_calibration.InertialFit | None = None
    combined: CombinedFit | None = None
    uncertainty: Uncertainty = field(default_factory=lambda: Uncertainty(None, None))

    @property
    def walks(self) -> tuple[MovingTrial, ...]:
        """The trials of the whole body: walks and other activities."""
        return tuple(trial for trial in self.trials if trial.joint is None)


def session_of(of: PreprocessedStudy, checked: Sequence[Finding] = ()) -> CalibrationState:
    """The moving trials of a preprocessed study, with their problems for its nominal model; InputError where
    there is none.
    """
    study, model, trials = of.study, of.nominal, []
    for evidence in of.moving:
        trials.append(prepare_trial(evidence.trial, model, study.settings))
    prior, moves = (
        joint_prior.make_study_prior(study.settings.joint_prior, study.joint_prior, model.noise),
        of.find_possible_moves(),
    )
    return CalibrationState(
        model=model,
        settings=study.settings,
        parameters=model.parameters,
        trials=tuple(trials),
        static=of.completed.static,
        prior=replace(prior.widen(study.loosened), doubted=_doubted(moves, study.moving)),
        possible_moves=moves,
        checked=tuple(checked),
    )


def _doubted(
    moves: Mapping[str, Mapping[str, PossibleMove]], trials: Sequence[Trial]
) -> dict[str, float]:
    """Joint parameter -> m, rad by which it may be wrong if markers moved in any trial that shows
    its joint.
    """
    out = dict[str, float]()
    for trial in trials:
        shown = JP_NAMES if trial.joint is None else list_isolated_parameters(trial.joint)
        for p in JOINT_PARAMETERS:
            move = moves.get(trial.name, {}).get(p.segment)
            if move is not None and p.name in shown:
                by = (
                    move.shift if p.kind is ParameterKind.POSITION else float(move.rotation[p.axis])
                )
                out[p.name] = max(by, out.get(p.name, 0.0))
    return out


def fits_legs_together(settings: CalibrationSettings) -> bool:
    """Whether the joint parameters of all trials are fitted at once, by pelvis and legs."""
    return (
        settings.jp
        and settings.decided_by is Protocol.PUBLISHED
        and settings.mode == "simultaneous"
    )


def prepare_trial(trial: Trial, model: SubjectModel, settings: CalibrationSettings) -> MovingTrial:
    """Turn a cleaned trial so that x is forward, find its bandwidth and set up its problems."""
    recording = rotate_to_progression(trial.recording, forward_direction(model, trial.recording))
    rule = spline.NodeRule(settings.nodes_per_second or spline.NODES_PER_SECOND, settings.nodes)
    joint = trial.joint

    def part(segments: Sequence[str]) -> MotionProblem:
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
        trial.name, model, recording, rule, carrier=find_base_segment(joint), isolated=joint
    )
    if body.guessed:
        recording = recording.with_notes(
            f"markers do not determine {', '.join(body.guessed)}: what is known of walking does, "
            "as uncertain as that "
            "is (a trunk stays upright in the laboratory, arms hang along it)"
        )
    if body.held:
        held = (
            f"The pelvis is not seen: {find_base_segment(joint)} carries the body, {', '.join(body.held)} "
            "held at zero."
        )
        recording = recording.with_notes(held)
    alone = body if joint is None else part(list_joint_segments(joint))
    turned = replace(trial, recording=recording)
    bandwidth = bandwidth_of(alone, turned, model, settings)

    def smoothed(problem: MotionProblem, hz: float) -> MotionProblem:
        return apply_bandwidth(problem, model.nominal, hz) if bandwidth.penalised else problem

    body = smoothed(body, bandwidth.motion_hz)
    same = joint is None and bandwidth.joints_hz == bandwidth.motion_hz
    fitted = joints = (
        body if same else smoothed(body if joint is None else alone, bandwidth.joints_hz)
    )
    if fits_legs_together(settings):
        legs = LOWER_BODY[1:] if joint is None else LEGS[joint[-1]]
        try:
            joints = smoothed(part(("pelvis", *legs)), bandwidth.joints_hz)
        except InputError:  # the pelvis is not seen in an isolated trial
            if joint is None:
                raise
    read = {f.name: getattr(turned, f.name) for f in fields(Trial)} | {
        "in_file_axes": trial.recording
    }
    return MovingTrial(**read, bandwidth=bandwidth, body=body, fitted=fitted, joints=joints)


def forward_direction(model: SubjectModel, recording: Recording) -> Array | None:
    """(3,) where the pelvis faces, from its markers in all frames; None where they are never seen
    together.
    """
    fit = rigid.fit_segment(model.markers, "pelvis", recording)
    return None if fit is None else np.asarray(fit.rotation[fit.determined][:, :, 0].mean(axis=0))


def standing_problem(model: SubjectModel, static: Recording) -> MotionProblem:
    """The mean posture of the still window of the static trial, where every marker is in its place,
    as a trial.
    """
    still = find_still_window(static, model.markers.labels).frames
    # in one order of memory, so that a file and its conversion give the same bits
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a marker that this trial lost stays lost
        mean = np.nanmean(np.ascontiguousarray(static.markers[still]), axis=0)
    posture = np.repeat(mean[None], FEWEST_FRAMES, axis=0)
    window = replace(static, time=np.arange(FEWEST_FRAMES) / 100.0, markers=posture)
    return build_trial_problem("static", model, window, spline.NodeRule())


def tracked(trial: MovingTrial, session: CalibrationState, stage: Stage) -> MovingTrial:
    """A trial tracked with the nominal and the last model of its session, which is of `stage`, and
    its forces.
    """
    model, parameters = session.model, session.parameters
    part = trial.body if trial.joint is None else trial.fitted
    trial = trial.reached(
        Stage.NOMINAL, model.nominal, track_motion(part.shift_markers(None), model.nominal)
    )
    if trial.joint is not None and stage is Stage.NOMINAL:
        stage = Stage.JP  # the whole body beside the segments of the joint
    if stage is not Stage.NOMINAL:
        trial = trial.reached(stage, parameters, track_motion(trial.body, parameters))
    if trial.joint is None and trial.recording.plates:
        reactions = measured_reactions(trial, model, parameters, trial.motion, session.settings)
        trial = replace(trial, reactions=reactions)
    return trial.scored(session.uncertainty)


def measured_reactions(
    trial: Trial,
    model: SubjectModel,
    parameters: Parameters,
    motion: Motion,
    settings: CalibrationSettings,
) -> GroundReactions:
    """Ground reactions on the feet at the frames of a whole-body motion."""
    hz = force_cutoff(trial, motion, settings)
    return compute_motion_reactions(model, parameters, motion, trial.recording, trial.plates, hz)


def force_cutoff(trial: Trial, motion: Motion, settings: CalibrationSettings) -> float | None:
    """Hz of the force filter of a trial; None for none."""
    chosen = settings.force_filter_hz if trial.filter_hz is None else trial.filter_hz
    if chosen == "none":
        return None
    return motion.cutoff_hz if chosen == "matched" else float(chosen)
