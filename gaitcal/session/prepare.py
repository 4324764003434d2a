"""From a study's recordings to the least-squares problems that a calibration solves.

The bandwidth of a trial's motion: given by the settings, or chosen by its markers and its force plates.

Joint parameters take the cut-off that the markers ask for (`motion/bandwidth.py`). The motion of a walk over force
plates may take another one, which brings forces and motion together,

    f = argmin sum_t |F(t; f)|^2,       F the pelvis residual force,

over frames and plate forces that do not change with f: plates are filtered at 50 Hz here, whatever the settings say.
Filtered at f themselves, they would agree with the motion the better the less of either is left. The plates choose f
alone and take no further part in the motion, and their say is limited:

- F weighs the trunk and hardly sees a foot: they move f by half an octave at most.
- Where mass or model are wrong, or all markers shake together, F falls with f for ever: plates are asked only where
  half of the f found so would raise sum |F|^2.

One motion leaves the trial, the one that the torques are of.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from enum import Enum
from functools import cached_property

import numpy as np

from gaitcal.arrays import Array
from gaitcal.calibration.joint_calibration import JointSettings
from gaitcal.codes import Code
from gaitcal.dynamics.ground_reactions import GroundReactions, reactions_of_motion
from gaitcal.dynamics.inverse_dynamics import Dynamics
from gaitcal.errors import InputError
from gaitcal.findings import Finding, Severity
from gaitcal.io.axes import turn_to_progression
from gaitcal.io.filters import resample_wrench
from gaitcal.io.force_plate import LOADED_N
from gaitcal.io.recording import Recording
from gaitcal.io.still import still_window
from gaitcal.model.linkage import LEGS, LOWER_BODY, carrier_of, joint_segments
from gaitcal.model.outliers import without_strays
from gaitcal.model.parameters import Parameters
from gaitcal.model.subject_model import SubjectModel
from gaitcal.motion.bandwidth import DenseMotion, Smoothed, with_bandwidth
from gaitcal.motion.motion import Motion, motion_of
from gaitcal.motion.rigid import rigid_fit
from gaitcal.motion.soft_tissue import SoftTissue
from gaitcal.motion.spline import DEGREE, NODES_PER_SECOND, NodeRule, frame_rate
from gaitcal.motion.trial_problem import FEWEST_FRAMES, TrialProblem, trial_problem
from gaitcal.study.settings import AUTOMATIC, CalibrationSettings
from gaitcal.study.study_trial import Role, StudyTrial

PLATES_HZ = 50.0
"""Of the plates while they choose."""
JOINTS_HZ = 12.0
"""At least, while joint parameters are fitted: they ask for no accelerations, and a motion smoothed at the 2 Hz that
the markers of a slow isolated trial ask for gave knee axes 7.5 mm off where 2.5 were to be had (12 and 25 Hz alike)."""
ENDS_S = 0.1
"""s at either end that have no say, whatever f: accelerations there lean on one side only."""
FEWEST_LOADED = 20
"""Valid frames below which plates have no say."""
REACH = float(np.sqrt(2.0))
"""Factor by which plates may change the markers' cut-off."""
TOLD = 1.25
"""Plates tell f where sum |F|^2 is so much larger with half of it."""
AT_LIMIT = 0.99
"""Of the highest cut-off."""
SUFFERS, SUFFERS_M = 1.2, 3e-4
"""A fit suffers where its marker error is 1.2 times, and 0.3 mm above, that with the cut-off its markers ask for."""


class ChosenBy(Enum):
    """Who chose the bandwidth of a trial's motion."""

    MARKERS = "markers"
    PLATES = "plates"
    GIVEN = "given"


@dataclass(frozen=True, kw_only=True)
class Bandwidth:
    """The bandwidth of one trial."""

    motion_hz: float
    """Half of an oscillation at it is in the motion."""
    joints_hz: float
    """The same while joint parameters are fitted."""
    by: ChosenBy
    """Who chose `motion_hz`."""
    penalised: bool
    """False: the number of nodes alone limits the motion."""
    notes: tuple[str, ...] = ()
    findings: tuple[Finding, ...] = ()


def bandwidth_of(
    problem: TrialProblem, trial: StudyTrial, recording: Recording, model: SubjectModel, settings: CalibrationSettings
) -> Bandwidth:
    """The bandwidth of a trial.

    Parameters
    ----------
    problem : what its joint parameters are fitted by, with the nodes of the settings if these give any.
    trial, recording : as read, and turned so that x is forward.
    model : tracked with its nominal parameters, so that a calibration and further trials choose alike.
    """
    if settings.nodes is not None:
        return _given_nodes(problem)
    # Where a trial is too long to be looked at as a whole, a walk is where its plates are.
    loaded = _loaded(recording)
    motion = DenseMotion(problem, model.nominal, loaded if loaded.any() else None)
    markers = motion.by_markers()
    if settings.nodes_per_second is not None:
        chosen = _given_nodes(problem)
    elif settings.bandwidth_hz != AUTOMATIC:
        hz = float(settings.bandwidth_hz)
        note = f"motion smoothed at {hz:.1f} Hz (half amplitude), as the settings say"
        chosen = Bandwidth(motion_hz=hz, joints_hz=hz, by=ChosenBy.GIVEN, penalised=True, notes=(note,))
    else:
        plates = _by_plates(motion, markers, trial, recording, model) if recording.plates and not trial.joint else None
        chosen = _chosen(markers, plates, motion)
    return replace(chosen, findings=_suffering(trial.name, motion, chosen.motion_hz, markers))


def _given_nodes(problem: TrialProblem) -> Bandwidth:
    """That of splines of a given number of nodes: least squares passes half of 0.5 oscillations a span."""
    time = problem.basis.time
    hz = 0.5 * (problem.basis.nodes - DEGREE) / float(time[-1] - time[0])
    note = f"the motion passes half of {hz:.1f} Hz: {problem.basis.nodes} spline nodes, as the settings say"
    return Bandwidth(motion_hz=hz, joints_hz=hz, by=ChosenBy.GIVEN, penalised=False, notes=(note,))


def _chosen(markers: float, plates: float | None, motion: DenseMotion) -> Bandwidth:
    hz = markers if plates is None else plates
    by = ChosenBy.MARKERS if plates is None else ChosenBy.PLATES
    if plates is None:
        note = f"motion smoothed at {hz:.1f} Hz (half amplitude), which its markers ask for"
    else:
        note = (
            f"motion smoothed at {hz:.1f} Hz (half amplitude), where it and the force plates agree best; its markers "
            f"alone ask for {markers:.1f} Hz"
        )
    if hz > AT_LIMIT * motion.highest:
        note += f"; frames at {frame_rate(motion.problem.basis):.0f} Hz allow no more"
    joints = max(markers, hz, min(JOINTS_HZ, motion.highest))
    return Bandwidth(motion_hz=hz, joints_hz=joints, by=by, penalised=True, notes=(note,))


def _by_plates(
    dense: DenseMotion, markers: float, trial: StudyTrial, recording: Recording, model: SubjectModel
) -> float | None:
    """Hz: where motion and plates agree best; None where they do not tell."""
    basis = dense.problem.basis
    seen = motion_of(dense.problem, model.nominal, dense.at(markers).nodes)
    reactions = reactions_of_motion(model, model.nominal, seen, recording, trial.plates, PLATES_HZ)
    frames = reactions.valid & (basis.time >= basis.time[0] + ENDS_S) & (basis.time <= basis.time[-1] - ENDS_S)
    if frames.sum() < FEWEST_LOADED:
        return None
    dynamics, wrench = Dynamics(model.nominal), reactions.wrench[frames]

    def disagreement(smoothed: Smoothed) -> float:
        q, v, a = (basis.evaluate(smoothed.nodes, k)[frames] for k in range(3))
        return float((dynamics.residual_force(q, v, a, wrench) ** 2).sum())

    hz = dense.least(disagreement, markers / REACH, min(markers * REACH, dense.highest))
    told = disagreement(dense.at(0.5 * hz)) >= TOLD * disagreement(dense.at(hz))
    return hz if told else None


def _suffering(name: str, motion: DenseMotion, hz: float, markers: float) -> tuple[Finding, ...]:
    """Where the markers are met much worse than with the cut-off that they ask for."""
    here, best = motion.at(hz).rms, motion.at(markers).rms
    if here <= SUFFERS * best or here <= best + SUFFERS_M:
        return ()
    found = f"markers are met to about {1e3 * here:.1f} mm RMS with {hz:.1f} Hz, to {1e3 * best:.1f} mm with the "
    found += f"{markers:.1f} Hz that they ask for"
    cause, cure = "the motion is smoothed too much", 'set bandwidth_hz = "auto", and leave nodes out'
    return (
        Finding(
            severity=Severity.WARNING,
            topic="bandwidth",
            where=name,
            cause=cause,
            found=found,
            cure=cure,
            code=Code.SMOOTHED_TOO_MUCH,
        ),
    )


def _loaded(recording: Recording) -> Array:
    """(nf,) 1 in frames in which a plate carries somebody, else 0."""
    out = np.zeros(len(recording.time), dtype=bool)
    for plate in recording.plates:
        out |= np.nan_to_num(resample_wrench(plate, recording.time))[:, 1] > LOADED_N
    return out.astype(np.float64)


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
