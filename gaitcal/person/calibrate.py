"""The main job: from a study to a calibrated person.

nominal model (static trial) -> motions -> joint parameters -> inertial parameters -> generalised forces
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gaitcal.calibration.combined import CombinedFit, CombinedSettings, CombinedTrial, combined_fit
from gaitcal.calibration.inertial_calibration import InertialFit, fit_consistent, fit_published
from gaitcal.calibration.inertial_equations import LoadedMotion, TorqueScale, equations_of
from gaitcal.calibration.joint_phases import (
    JointCalibration,
    Phase,
)
from gaitcal.calibration.torque_errors import (
    MarkerMoves,
    coordinate_standard_errors,
    marker_moves,
    torque_standard_errors,
)
from gaitcal.dynamics.ground_contact import GroundReactions
from gaitcal.dynamics.inverse_dynamics import Dynamics, GeneralisedForces, TorqueErrors
from gaitcal.model.inertial_parameters import full_set, impossible_bodies, symmetric_set
from gaitcal.model.parameters import Parameters
from gaitcal.model.subject_model import SubjectModel
from gaitcal.motion.motion import Motion, motion_of, rigid_floor
from gaitcal.motion.start import starting_nodes
from gaitcal.motion.track import track_nodes
from gaitcal.motion.trial_problem import TrialProblem
from gaitcal.person.joint_parameters import joint_stage, parameters_for
from gaitcal.person.prepare import PreparedTrial, measured_reactions
from gaitcal.person.result import Calibration, LoadedTrial, TrialResult
from gaitcal.person.uncertainty import Uncertainty, uncertainty_of
from gaitcal.person.warnings import disagreements, large_residuals
from gaitcal.runtime import Progress, silent, with_one_blas_thread
from gaitcal.study.settings import CalibrationSettings
from gaitcal.study.study import Study, nominal_of


@with_one_blas_thread
def calibrate(study: Study, progress: Progress = silent, *, leave_out: bool = False) -> Calibration:
    """Fit a person's joint and inertial parameters and compute the joint torques of every gait trial.

    Parameters
    ----------
    study : from `Study.load`.
    progress : called with a line of text at the beginning of each step.
    leave_out : find the held-out error too (`person/hold_out.py`), which takes four more fits of the joint parameters.

    Raises
    ------
    InputError
        The recordings do not allow it: landmarks missing in the static trial, too few markers of a segment, forces
        that fit no foot. A phase that stops early is no error: see `Calibration.converged` and `phases`.
    """
    settings = study.settings
    progress("nominal model from the static trial")
    nominal = nominal_of(study)
    stage = joint_stage(study, nominal, progress, leave_out=leave_out)
    trials, joint, parameters = list(stage.trials), stage.joint, stage.parameters
    progress("tracking with the nominal model")
    before = {t.name: track_problem(t.fitted, nominal.parameters) for t in trials}
    progress("tracking with the calibrated joint parameters")
    after_jp = {t.name: track_problem(t.body, parameters) for t in trials}
    reactions = {
        t.name: measured_reactions(t, nominal, parameters, after_jp[t.name], settings)
        for t in trials
        if t.role == "gait" and t.recording.plates
    }
    inertial = _inertial_parameters(nominal, parameters, after_jp, reactions, settings, progress)
    after_ip = parameters if inertial is None else parameters.with_inertial(inertial.inertial)
    third = _third_step(trials, nominal, after_ip, joint, inertial, after_jp, reactions, settings, progress)
    final = after_ip if third is None else third.parameters
    motions = after_jp if third is None else _third_motions(trials, third, final)
    progress("standard errors and inverse dynamics")
    spread = uncertainty_of(joint, inertial)
    results = []
    for t in trials:
        loads, moves = None, None
        if t.joint is None:
            moves = marker_moves(t.body, motions[t.name].nodes, final, spread.joint)
        if t.name in reactions:
            r = reactions[t.name]
            loads = LoadedTrial(
                r,
                forces_of(nominal.parameters, before[t.name], r),
                forces_of(parameters, after_jp[t.name], r) if joint else None,
                forces_of(after_ip, after_jp[t.name], r) if inertial else None,
                forces_of(final, motions[t.name], r) if third else None,
                torque_errors_of(t.body, motions[t.name], final, r, spread, moves),
            )
        own = parameters_for(joint, t.name, final)
        calibrated = motions[t.name] if t.joint is None else track_problem(t.fitted, own)
        last = calibrated if t.joint is None else track_problem(t.fitted, final)
        floor = rigid_floor(t.fitted)
        results.append(
            TrialResult(
                t.name,
                t.role,
                t.joint,
                t.recording,
                before[t.name],
                calibrated,
                last,
                floor,
                motions[t.name],
                loads,
                None if moves is None else coordinate_standard_errors(t.body, moves),
                stage.held_out.get(t.name),
            )
        )
    phases = _phases(joint, inertial, third, reactions)
    done = _calibration(study, nominal, final, tuple(results), phases, joint, inertial, spread)
    return replace(done, warnings=(*stage.warnings, *done.warnings))


def track_problem(problem: TrialProblem, parameters: Parameters) -> Motion:
    """Track one trial from rigid fits."""
    constants = problem.constants(parameters)
    start = starting_nodes(problem.chain, constants, problem.data, problem.basis)
    tracked = track_nodes(problem, constants, start)
    return motion_of(problem, parameters, tracked.nodes, converged=tracked.converged)


def forces_of(parameters: Parameters, motion: Motion, reactions: GroundReactions) -> GeneralisedForces:
    """Generalised forces of a whole-body motion."""
    return Dynamics(parameters).forces(motion.q, motion.velocity, motion.acceleration, reactions.wrench)


def torque_errors_of(
    body: TrialProblem,
    motion: Motion,
    parameters: Parameters,
    reactions: GroundReactions,
    spread: Uncertainty,
    moves: MarkerMoves | None,
) -> TorqueErrors | None:
    """Standard errors of `forces_of`; None for impossible bodies, whose mass matrix has no meaning."""
    if impossible_bodies(parameters.inertial):
        return None
    errors = torque_standard_errors(
        body, motion.nodes, parameters, reactions.wrench, spread.joint, spread.inertial, moves
    )
    return TorqueErrors(errors[:, :27], errors[:, 27:])


def _inertial_parameters(
    nominal: SubjectModel,
    parameters: Parameters,
    motions: dict[str, Motion],
    reactions: dict[str, GroundReactions],
    settings: CalibrationSettings,
    progress: Progress,
) -> InertialFit | None:
    loaded = [
        LoadedMotion(name=name, q=m.q, velocity=m.velocity, acceleration=m.acceleration, wrench=r.wrench, valid=r.valid)
        for name, m, r in ((name, motions[name], r) for name, r in reactions.items() if r.valid.any())
    ]
    if settings.ip == "none" or not loaded:
        return None
    progress("inertial parameters")
    width = float(np.linalg.norm(nominal.landmarks["hjc_r"][1] - nominal.landmarks["hjc_l"][1]))
    scale = TorqueScale(settings.torque_scale)
    equations = equations_of(loaded, parameters, nominal.subject, scale, width)
    which = symmetric_set() if settings.ip_set == "symmetric" else full_set()
    fit = fit_consistent if settings.ip == "consistent" else fit_published
    return fit(equations, parameters.inertial, which)


def _third_step(
    trials: list[PreparedTrial],
    nominal: SubjectModel,
    parameters: Parameters,
    joint: JointCalibration | None,
    inertial: InertialFit | None,
    motions: dict[str, Motion],
    reactions: dict[str, GroundReactions],
    settings: CalibrationSettings,
    progress: Progress,
) -> CombinedFit | None:
    if not settings.joint_step or joint is None or inertial is None or impossible_bodies(parameters.inertial):
        return None
    progress("joint and inertial parameters together")
    steps = []
    for t in trials:
        r = reactions.get(t.name)
        used = None if r is None or not r.valid.any() else r
        steps.append(
            CombinedTrial(
                t.body,
                motions[t.name].nodes,
                None if used is None else used.wrench,
                None if used is None else used.valid,
            )
        )
    which = symmetric_set() if settings.ip_set == "symmetric" else full_set()
    chosen = CombinedSettings(load_share=settings.joint_step_load_share)
    return combined_fit(steps, parameters, joint.free, which, nominal.subject, chosen)


def _third_motions(trials: list[PreparedTrial], third: CombinedFit, final: Parameters) -> dict[str, Motion]:
    return {
        t.name: motion_of(t.body, final, nodes, converged=third.converged)
        for t, nodes in zip(trials, third.nodes, strict=True)
    }


def _phases(
    joint: JointCalibration | None,
    inertial: InertialFit | None,
    third: CombinedFit | None,
    reactions: dict[str, GroundReactions],
) -> tuple[Phase, ...]:
    phases = list(joint.phases) if joint else []
    used = tuple(name for name, r in reactions.items() if r.valid.any())
    if inertial:
        phases.append(
            Phase(
                name="inertial",
                trials=used,
                parameters=len(inertial.names),
                iterations=inertial.iterations,
                seconds=inertial.seconds,
                converged=inertial.converged,
                message=inertial.message,
            )
        )
    if third and joint and inertial:
        text = "" if third.converged else f"{third.ending.value}; "
        text += f"marker sigma {1e3 * third.marker_sigma:.2f} mm a coordinate, load share {third.load_share:g}"
        count = len(joint.free) + len(inertial.names)
        phases.append(
            Phase(
                name="joint and inertial",
                trials=used,
                parameters=count,
                iterations=third.steps,
                seconds=third.seconds,
                converged=third.converged,
                message=text,
            )
        )
    return tuple(phases)


def _calibration(
    study: Study,
    nominal: SubjectModel,
    final: Parameters,
    results: tuple[TrialResult, ...],
    phases: tuple[Phase, ...],
    joint: JointCalibration | None,
    inertial: InertialFit | None,
    spread: Uncertainty,
) -> Calibration:
    notes = list(nominal.notes)
    notes += [note for t in results for note in t.notes]
    warnings = list(joint.warnings) if joint else []
    warnings += [warning for t in results for warning in t.warnings]
    loads = [t.loads for t in results if t.loads is not None]
    if loads and not any(load.reactions.valid.any() for load in loads):
        warnings.append("inertial parameters keep their nominal values: no trial has a valid frame")
    if bodies := impossible_bodies(final.inertial):
        left_out = "; the third step needs possible ones and was left out" if study.settings.joint_step else ""
        warnings.append(
            f"no real body has the inertial parameters found for {', '.join(bodies)}; ip = 'consistent' keeps every "
            f"body possible; torques have no standard errors then, and model.xml is not written{left_out}"
        )
    warnings += disagreements(results, study.settings.mode)
    warnings += large_residuals(results, final)
    return Calibration(
        study,
        nominal,
        replace(nominal, parameters=final, notes=tuple(notes)),
        results,
        phases,
        joint,
        inertial,
        spread,
        joint.unidentifiable if joint else (),
        tuple(notes),
        tuple(warnings),
    )
