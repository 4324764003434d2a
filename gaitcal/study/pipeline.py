"""The main job: from a study to a calibrated person.

nominal model (static trial) -> motions -> joint parameters -> inertial parameters -> generalised forces
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gaitcal.calibration.inertial_calibration import InertialFit, TorqueScale, fit_consistent, fit_published
from gaitcal.calibration.inertial_phase import LoadedMotion, equations_of
from gaitcal.calibration.joint_calibration import JointSettings
from gaitcal.calibration.joint_phases import (
    JointCalibration,
    JointTrial,
    Phase,
    calibrate_sequentially,
    calibrate_simultaneously,
)
from gaitcal.dynamics.ground_contact import FootPoints, GroundReactions, ground_reactions_on_feet
from gaitcal.dynamics.inverse_dynamics import FEET, Dynamics, GeneralisedForces
from gaitcal.model.chain import Chain
from gaitcal.model.inertial_parameters import full_set, symmetric_set
from gaitcal.model.kinematics import forward, segment_poses
from gaitcal.model.linkage import SEGMENTS, joint_segments
from gaitcal.model.nominal import HipCentre, nominal_model
from gaitcal.model.parameters import Parameters
from gaitcal.model.subject_model import SubjectModel
from gaitcal.motion.motion import Motion, motion_of, rigid_floor
from gaitcal.motion.rigid import rigid_fit
from gaitcal.motion.start import starting_nodes
from gaitcal.motion.track import track_nodes
from gaitcal.motion.trial_data import NodeRule, cutoff, trial_problem
from gaitcal.motion.trial_problem import TrialProblem
from gaitcal.recording import turn_to_progression
from gaitcal.recording.recording import Recording
from gaitcal.settings import CalibrationSettings
from gaitcal.study.person import Study, StudyTrial
from gaitcal.study.result import Calibration, LoadedTrial, TrialResult

Array = NDArray[np.float64]
Progress = Callable[[str], None]

SIDES = {"both": ("r", "l"), "right": ("r",), "left": ("l",)}


@dataclass(frozen=True)
class _Prepared:
    """A moving trial on its way through the pipeline."""

    trial: StudyTrial
    recording: Recording
    fitted: TrialProblem
    """What the calibration fits: the joint's own segments, or the whole body."""
    body: TrialProblem
    nominal: Motion


def calibrate(study: Study, progress: Progress | None = None) -> Calibration:
    """Fit a person's joint and inertial parameters and compute the joint torques of every gait trial.

    Parameters
    ----------
    study : from `Study.load`.
    progress : called with a line of text at the beginning of each phase.
    """
    say = progress or (lambda text: None)
    settings = study.settings
    say("nominal model from the static trial")
    nominal = nominal_of(study)
    say("tracking with the nominal model")
    prepared = [_prepare(trial, nominal, settings) for trial in study.moving]
    joint, parameters = _joint_parameters(prepared, nominal, settings, say)
    say("tracking with the calibrated joint parameters")
    after_jp = {p.trial.name: _track(p.body, parameters) for p in prepared}
    reactions = {
        p.trial.name: _reactions(p, nominal, parameters, after_jp[p.trial.name], settings)
        for p in prepared
        if p.trial.role == "gait" and p.recording.plates
    }
    inertial = _inertial_parameters(prepared, nominal, parameters, after_jp, reactions, settings, say)
    final = parameters if inertial is None else parameters.with_inertial(inertial.inertial)
    say("inverse dynamics")
    results = tuple(
        _result(p, nominal, parameters, final, after_jp[p.trial.name], reactions.get(p.trial.name)) for p in prepared
    )
    phases = (joint.phases if joint else ()) + ((_inertial_phase(inertial, reactions),) if inertial else ())
    notes = nominal.notes + tuple(f"{p.trial.name}: {note}" for p in prepared for note in p.recording.notes)
    notes += tuple(f"{name}: {note}" for name, r in reactions.items() for note in r.notes)
    return Calibration(
        study,
        nominal,
        nominal.with_parameters(final),
        results,
        phases,
        joint,
        inertial,
        notes,
        (joint.warnings if joint else ()) + _reaction_warnings(reactions),
    )


def nominal_of(study: Study) -> SubjectModel:
    """The nominal model of a study: its static trial, marker set and anthropometry."""
    return nominal_model(
        study.static.recording,
        study.marker_set,
        study.subject,
        hip_centre=HipCentre(study.settings.hip_centre),
        weights=study.weights,
    )


def node_rule(settings: CalibrationSettings) -> NodeRule:
    """How many spline nodes the settings ask for."""
    return NodeRule(settings.nodes_per_second, settings.nodes)


def forward_direction(model: SubjectModel, recording: Recording) -> Array | None:
    """(3,) where the pelvis faces, from its markers in all frames; None where they are never seen together."""
    at = {label: i for i, label in enumerate(recording.labels)}
    own = [
        i
        for i, (name, segment) in enumerate(zip(model.markers.labels, model.markers.segments, strict=True))
        if segment == "pelvis" and name in at
    ]
    measured = recording.markers[:, [at[model.markers.labels[i]] for i in own]].transpose(1, 2, 0)
    seen = np.isfinite(measured).all(axis=1)
    if len(own) < 3 or not seen.all(axis=0).any():
        return None
    fit = rigid_fit(model.markers.local[own], np.where(seen[:, None], measured, 0.0), seen.astype(float))
    out: Array = fit.rotation[fit.determined][:, :, 0].mean(axis=0)
    return out


def _prepare(trial: StudyTrial, model: SubjectModel, settings: CalibrationSettings) -> _Prepared:
    recording = turn_to_progression(trial.recording, forward_direction(model, trial.recording))
    rule = node_rule(settings)
    body = replace(trial_problem(trial.name, model, recording, rule), name=trial.name)
    fitted = body
    if trial.joint is not None:
        segments = joint_segments(trial.joint)
        fitted = trial_problem(trial.name, model, recording, rule, root=segments[0], segments=segments)
    return _Prepared(trial, recording, fitted, body, _track(fitted, model.parameters))


def _track(problem: TrialProblem, parameters: Parameters) -> Motion:
    constants = problem.constants(parameters)
    start = starting_nodes(problem.chain, constants, problem.data, problem.basis)
    tracked = track_nodes(problem, constants, start)
    return motion_of(problem, parameters, tracked.nodes, converged=tracked.converged)


def _joint_parameters(
    prepared: list[_Prepared], nominal: SubjectModel, settings: CalibrationSettings, say: Progress
) -> tuple[JointCalibration | None, Parameters]:
    if not settings.jp:
        return None, nominal.parameters
    say("joint parameters")
    trials = [JointTrial(p.fitted, p.trial.joint) for p in prepared]
    run = calibrate_sequentially if settings.mode == "sequential" else calibrate_simultaneously
    calibration = run(trials, nominal.parameters, joint_settings(settings), SIDES[settings.legs])
    return calibration, calibration.parameters


def joint_settings(settings: CalibrationSettings) -> JointSettings:
    """Bounds and priors in SI units."""
    weak = settings.prior == "weak"
    return JointSettings(
        position_bound=1e-3 * settings.position_bound_mm,
        orientation_bound=np.deg2rad(settings.orientation_bound_deg),
        prior_position=0.010 if weak else np.inf,
        prior_orientation=np.deg2rad(10.0) if weak else np.inf,
    )


def foot_points(model: SubjectModel, motion: Motion, parameters: Parameters) -> FootPoints:
    """Heel and toe of both feet over a whole-body motion."""
    chain = Chain("pelvis", SEGMENTS)
    constants = chain.constants(parameters.joint, parameters.zero_angles)
    axes, origins = segment_poses(chain, constants, forward(chain, constants, motion.q))
    points = {}
    for end in ("heel", "toe"):
        both = []
        for foot in FEET:
            at = chain.segments.index(foot)
            local = model.landmarks[f"{end}_{foot[-1]}"][1]
            both.append(np.einsum("j,jif->fi", local, axes[at]) + origins[at].T)
        points[end] = np.stack(both, axis=1)
    speed = {k: np.linalg.norm(np.gradient(p, motion.time, axis=0), axis=2) for k, p in points.items()}
    return FootPoints(points["heel"], points["toe"], speed["heel"], speed["toe"])


def force_cutoff(trial: StudyTrial, motion: Motion, settings: CalibrationSettings) -> float | None:
    """Hz of the force filter of a trial; None for none."""
    chosen = settings.force_filter_hz if trial.filter_hz is None else trial.filter_hz
    if chosen == "none":
        return None
    return cutoff(motion.time, motion.basis.nodes) if chosen == "matched" else float(chosen)


def _reactions(
    p: _Prepared, model: SubjectModel, parameters: Parameters, motion: Motion, settings: CalibrationSettings
) -> GroundReactions:
    hz = force_cutoff(p.trial, motion, settings)
    feet = foot_points(model, motion, parameters)
    found = ground_reactions_on_feet(
        p.recording.plates, motion.time, feet, cutoff=hz, assigned=dict(p.trial.plates)
    )
    how = "forces not filtered" if hz is None else f"forces low-pass filtered at {hz:.1f} Hz (zero lag, 4th order)"
    return replace(found, notes=(*found.notes, how))


def _loaded(name: str, motion: Motion, reactions: GroundReactions) -> LoadedMotion:
    return LoadedMotion(
        name, motion.q, motion.velocity, motion.acceleration, reactions.wrench, reactions.valid
    )


def _inertial_parameters(
    prepared: list[_Prepared],
    nominal: SubjectModel,
    parameters: Parameters,
    motions: dict[str, Motion],
    reactions: dict[str, GroundReactions],
    settings: CalibrationSettings,
    say: Progress,
) -> InertialFit | None:
    loaded = [_loaded(name, motions[name], r) for name, r in reactions.items() if r.valid.any()]
    if settings.ip == "none" or not loaded:
        return None
    say("inertial parameters")
    hips = nominal.landmarks["hjc_r"][1] - nominal.landmarks["hjc_l"][1]
    equations = equations_of(
        loaded, parameters, nominal.subject, TorqueScale(settings.torque_scale), float(np.linalg.norm(hips))
    )
    which = symmetric_set() if settings.ip_set == "symmetric" else full_set()
    fit = fit_consistent if settings.ip == "consistent" else fit_published
    return fit(equations, parameters.inertial, which)


def _inertial_phase(fit: InertialFit, reactions: dict[str, GroundReactions]) -> Phase:
    used = tuple(name for name, r in reactions.items() if r.valid.any())
    return Phase("inertial", used, len(fit.names), fit.iterations, fit.seconds, fit.converged, fit.message)


def _reaction_warnings(reactions: dict[str, GroundReactions]) -> tuple[str, ...]:
    return tuple(
        f"{name}: no frame has every foot on the ground on a force plate; no torques and no inertial calibration"
        for name, r in reactions.items()
        if not r.valid.any()
    )


def _result(
    p: _Prepared,
    nominal: SubjectModel,
    after_jp: Parameters,
    final: Parameters,
    body: Motion,
    reactions: GroundReactions | None,
) -> TrialResult:
    calibrated = body if p.trial.joint is None else _track(p.fitted, final)
    loads = None
    if reactions is not None:
        loads = LoadedTrial(
            reactions,
            forces_of(nominal.parameters, p.nominal, reactions),
            forces_of(after_jp, body, reactions),
            None if final is after_jp else forces_of(final, body, reactions),
            None,
        )
    return TrialResult(
        p.trial.name, p.trial.role, p.trial.joint, p.recording, p.nominal, calibrated, rigid_floor(p.fitted), body, loads
    )


def forces_of(parameters: Parameters, motion: Motion, reactions: GroundReactions) -> GeneralisedForces:
    """Generalised forces of a whole-body motion."""
    return Dynamics(parameters).forces(motion.q, motion.velocity, motion.acceleration, reactions.wrench)
