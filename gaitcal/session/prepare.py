"""From a study's recordings to the least-squares problems that a calibration solves."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from gaitcal.arrays import Array
from gaitcal.calibration.joint_calibration import JointSettings
from gaitcal.dynamics.ground_contact import GroundReactions
from gaitcal.dynamics.ground_reactions import reactions_of_motion
from gaitcal.errors import InputError
from gaitcal.io.axes import turn_to_progression
from gaitcal.io.recording import Recording
from gaitcal.io.still import still_window
from gaitcal.model.linkage import LEGS, LOWER_BODY, carrier_of, joint_segments
from gaitcal.model.parameters import Parameters
from gaitcal.model.strays import without_strays
from gaitcal.model.subject_model import SubjectModel
from gaitcal.motion.bandwidth import with_bandwidth
from gaitcal.motion.motion import Motion
from gaitcal.motion.node_rule import NODES_PER_SECOND, NodeRule
from gaitcal.motion.rigid import rigid_fit
from gaitcal.motion.soft_tissue import SoftTissue
from gaitcal.motion.trial_problem import FEWEST_FRAMES, TrialProblem, trial_problem
from gaitcal.session.trial_bandwidth import Bandwidth, bandwidth_of
from gaitcal.study.settings import CalibrationSettings
from gaitcal.study.study_trial import Role, StudyTrial


@dataclass(frozen=True, kw_only=True)
class PreparedTrial:
    """A moving trial, turned so that x is forward, and its least-squares problems: the whole body and parts of it."""

    trial: StudyTrial
    recording: Recording
    model: SubjectModel
    rule: NodeRule
    bandwidth: Bandwidth
    body: TrialProblem
    """The whole body, with the bandwidth of the motion that leaves the trial."""
    reweighted: tuple[TrialProblem, TrialProblem] | None = None
    """`fitted` and `legs` where they carry other weights than those of the markers."""
    tissue: SoftTissue | None = None
    """The skin that moves on the markers of `body`: what error bars count."""

    @property
    def name(self) -> str:
        """Name of the trial."""
        return self.trial.name

    @property
    def role(self) -> Role:
        """What the trial is for: one joint, or gait."""
        return self.trial.role

    @property
    def joint(self) -> str | None:
        """The joint of an isolated trial."""
        return self.trial.joint

    @cached_property
    def fitted(self) -> TrialProblem:
        """What fit figures are about: the segments of an isolated trial's joint alone, or the whole body."""
        if self.reweighted is not None:
            return self.reweighted[0]
        if self.joint is None:
            of_markers = self.bandwidth.joints_hz
            same = of_markers == self.bandwidth.motion_hz
            return self.body if same else with_bandwidth(self.body, self.model.nominal, of_markers)
        return self._part(joint_segments(self.joint)[0], joint_segments(self.joint))

    @cached_property
    def legs(self) -> TrialProblem:
        """Pelvis and the leg that moves, or both legs for gait."""
        if self.reweighted is not None:
            return self.reweighted[1]
        legs = LOWER_BODY[1:] if self.joint is None else LEGS[self.joint[-1]]
        try:
            return self._part("pelvis", ("pelvis", *legs))
        except InputError:
            if self.joint is None:
                raise
            return self.fitted

    @property
    def with_skin(self) -> TrialProblem:
        """The whole body with the skin that its error bars count."""
        return replace(self.body, tissue=self.tissue)

    def with_problems(self, body: TrialProblem, fitted: TrialProblem, legs: TrialProblem) -> PreparedTrial:
        """The same trial with other weights in its problems."""
        return replace(self, body=body, reweighted=(fitted, legs))

    def _part(self, root: str, segments: tuple[str, ...]) -> TrialProblem:
        part = trial_problem(
            self.name, self.model, self.recording, self.rule, root=root, segments=segments, isolated=self.joint
        )
        return _smoothed(part, self.model, self.bandwidth, self.bandwidth.joints_hz)


def prepare_trial(trial: StudyTrial, model: SubjectModel, settings: CalibrationSettings) -> PreparedTrial:
    """Turn a trial so that x is forward, find its bandwidth and set up its problems."""
    on_body, _ = without_strays(trial.recording, dict(zip(model.markers.labels, model.markers.segments, strict=True)))
    recording = turn_to_progression(on_body, forward_direction(model, on_body))
    rule = node_rule(settings)
    body = trial_problem(trial.name, model, recording, rule, carrier=carrier_of(trial.joint), isolated=trial.joint)
    if body.guessed:
        recording = recording.with_notes(
            f"markers do not determine {', '.join(body.guessed)}: what is known of walking does, as uncertain as that "
            "is (a trunk stays upright in the laboratory, arms hang along it)"
        )
    fitted = body
    if trial.joint is not None:
        root, *_ = segments = joint_segments(trial.joint)
        fitted = trial_problem(trial.name, model, recording, rule, root=root, segments=segments, isolated=trial.joint)
    if body.held:
        told = (
            f"The pelvis is not seen: {carrier_of(trial.joint)} carries the body, {', '.join(body.held)} held at zero."
        )
        recording = recording.with_notes(told)
    bandwidth = bandwidth_of(fitted, trial, recording, model, settings)
    body = _smoothed(body, model, bandwidth, bandwidth.motion_hz)
    return PreparedTrial(trial=trial, recording=recording, model=model, rule=rule, bandwidth=bandwidth, body=body)


def node_rule(settings: CalibrationSettings) -> NodeRule:
    """Nodes of a trial whose bandwidth they alone limit, and before it is known."""
    return NodeRule(settings.nodes_per_second or NODES_PER_SECOND, settings.nodes)


def _smoothed(problem: TrialProblem, model: SubjectModel, bandwidth: Bandwidth, hz: float) -> TrialProblem:
    return with_bandwidth(problem, model.nominal, hz) if bandwidth.penalised else problem


def forward_direction(model: SubjectModel, recording: Recording) -> Array | None:
    """(3,) where the pelvis faces, from its markers in all frames; None where they are never seen together."""
    column = {label: i for i, label in enumerate(recording.labels)}
    pelvis = [
        i
        for i, (label, segment) in enumerate(zip(model.markers.labels, model.markers.segments, strict=True))
        if segment == "pelvis" and label in column
    ]
    if len(pelvis) < 3:
        return None
    measured = recording.markers[:, [column[model.markers.labels[i]] for i in pelvis]].transpose(1, 2, 0)
    seen = np.asarray(np.isfinite(measured).all(axis=1))
    fit = rigid_fit(model.markers.local[pelvis], np.where(seen[:, None], measured, 0.0), seen.astype(float))
    if not fit.determined.any():
        return None
    out: Array = fit.rotation[fit.determined][:, :, 0].mean(axis=0)
    return out


def standing_problem(model: SubjectModel, static: Recording) -> TrialProblem:
    """The mean posture of the still window of the static trial, where every marker is in its place, as a trial."""
    still = still_window(static, model.markers.labels).frames
    # in one order of memory, so that a file and its conversion give the same bits
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a marker that this trial lost stays lost
        mean = np.nanmean(np.ascontiguousarray(static.markers[still]), axis=0)
    posture = np.repeat(mean[None], FEWEST_FRAMES, axis=0)
    window = replace(static, time=np.arange(FEWEST_FRAMES) / 100.0, markers=posture)
    return trial_problem("static", model, window, NodeRule())


def joint_bounds(settings: CalibrationSettings) -> JointSettings:
    """How far joint parameters may move, in SI units."""
    return JointSettings(
        position_bound=1e-3 * settings.position_bound_mm, orientation_bound=np.deg2rad(settings.orientation_bound_deg)
    )


def measured_reactions(
    trial: PreparedTrial, model: SubjectModel, parameters: Parameters, motion: Motion, settings: CalibrationSettings
) -> GroundReactions:
    """Ground reactions on the feet at the frames of a whole-body motion."""
    hz = force_cutoff(trial.trial, motion, settings)
    return reactions_of_motion(model, parameters, motion, trial.recording, trial.trial.plates, hz)


def force_cutoff(trial: StudyTrial, motion: Motion, settings: CalibrationSettings) -> float | None:
    """Hz of the force filter of a trial; None for none."""
    chosen = settings.force_filter_hz if trial.filter_hz is None else trial.filter_hz
    if chosen == "none":
        return None
    return motion.cutoff_hz if chosen == "matched" else float(chosen)
