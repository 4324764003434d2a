"""The main job: from a study to a calibrated person.

nominal model (static trial) -> motions -> joint parameters -> inertial parameters -> generalised forces

The fits that a calibration made, as a user is told of them.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from gaitcal.arrays import Array
from gaitcal.calibration.combined import CombinedFit, CombinedSettings, CombinedTrial, combined_fit
from gaitcal.calibration.error_sources import ErrorSources, TrialScores, nominal_influence, whole_body_scores
from gaitcal.calibration.inertial_calibration import (
    InertialFit,
    LoadedMotion,
    TorqueScale,
    equations_of,
    fit_published,
    torque_length,
)
from gaitcal.calibration.inertial_chart import ConsistentSettings, LogChart
from gaitcal.calibration.inertial_evidence import fit_by_evidence, spread_of_the_rest, stay_nominal, unmeasured_stay
from gaitcal.calibration.joint_phases import JointCalibration, Phase, parameters_for
from gaitcal.calibration.residual_noise import LoadedProblem, PlateNoise, residual_noise
from gaitcal.calibration.torque_errors import inertial_square_root
from gaitcal.dynamics.ground_contact import GroundReactions
from gaitcal.dynamics.plate_errors import PlateErrors
from gaitcal.faults.study import check_study
from gaitcal.faults.verdict import judge, stopping, without_consequences
from gaitcal.findings import Finding, Severity, note_of
from gaitcal.model.anthropometry import child_spread
from gaitcal.model.parameters import InertialSet, Parameters, full_set, impossible_bodies, symmetric_set
from gaitcal.model.subject_model import Subject, SubjectModel
from gaitcal.motion.motion import Motion, motion_of
from gaitcal.runtime import Progress, silent, with_one_blas_thread
from gaitcal.session.joint_parameters import joint_stage
from gaitcal.session.prepare import PreparedTrial
from gaitcal.session.result import Calibration, Stage, Uncertainty, withdrawn
from gaitcal.session.trial_result import (
    FittedMotion,
    as_fitted,
    axis_deviations,
    counted_from_static,
    fitted_motion,
    shifted,
    tracked_trials,
    trial_result,
)
from gaitcal.session.truth_comparison import with_truth
from gaitcal.session.warnings import (
    calibration_findings,
    diagnose_forces,
    is_trunk_unmeasured,
    left_out_of_masses,
    spoilt_motions,
    unmeasured_mass,
    unmeasured_words,
)
from gaitcal.study.settings import CalibrationSettings
from gaitcal.study.study import Study, completed_static, nominal_of


def phases_of(
    joint: JointCalibration | None, inertial: InertialFit | None, combined: CombinedFit | None, trials: tuple[str, ...]
) -> tuple[Phase, ...]:
    """The fits that were made, those of the joint parameters first; `trials` told of inertial parameters."""
    phases = list(joint.phases) if joint else []
    if inertial is not None:
        phases.append(
            Phase(
                name="inertial",
                trials=trials,
                parameters=len(inertial.names),
                iterations=inertial.iterations,
                seconds=inertial.seconds,
                converged=inertial.converged,
                message=inertial.message,
            )
        )
    if combined is not None and joint is not None and inertial is not None:
        text = "" if combined.converged else f"{combined.ending.value}; "
        text += f"marker sigma {1e3 * combined.marker_sigma:.2f} mm a coordinate, load share {combined.load_share:g}"
        phases.append(
            Phase(
                name="joint and inertial",
                trials=trials,
                parameters=len(joint.free) + len(inertial.names),
                iterations=combined.steps,
                seconds=combined.seconds,
                converged=combined.converged,
                message=text,
            )
        )
    return tuple(phases)


@with_one_blas_thread
def calibrate(
    study: Study, progress: Progress = silent, *, leave_out: bool = False, checked: Sequence[Finding] | None = None
) -> Calibration:
    """Fit a person's joint and inertial parameters and compute the joint torques of every gait trial.

    Parameters
    ----------
    study : from `Study.load`.
    progress : called with a line of text at the beginning of each step.
    leave_out : find the held-out error too (`person/hold_out.py`), which takes four more fits of the joint parameters.
    checked : what `gaitcal.check_study` found; made here unless given. Errors among it do not stop the calibration, but
        its verdict is "refused" then: no torque counts as valid, and no error bar is given.

    Raises
    ------
    InputError
        The recordings do not allow it: landmarks missing in the static trial, too few markers of a segment, forces
        that fit no foot. A phase that stops early is no error: see `Calibration.converged` and `phases`.
    """
    settings = study.settings
    if checked is None:
        progress("checking the recordings")
        checked = check_study(study)
    progress("nominal model from the static trial")
    nominal = nominal_of(study)
    fitted = joint_stage(study, nominal, progress, leave_out=leave_out)
    trials, joint, parameters = fitted.trials, fitted.joint, fitted.parameters
    static = completed_static(study).static
    count = counted_from_static if settings.keeps_ankle_zero and joint is not None else as_fitted
    counted = count(nominal, parameters, static)
    parameters = counted.parameters
    progress("tracking with the nominal and the calibrated joint parameters")
    tracked = tracked_trials(trials, nominal, parameters, settings)
    motions, reactions = tracked.motions, tracked.reactions
    stages: dict[Stage, tuple[Parameters, Mapping[str, Motion]]] = {Stage.NOMINAL: (nominal.parameters, tracked.before)}
    if joint is not None:
        stages[Stage.JP] = parameters, motions
    progress("do motion and forces agree?")
    influence = nominal_influence() if joint is None else joint.influence
    walks = [t for t in trials if t.joint is None]
    scores = {t.name: _scores(t, motions, parameters, influence) for t in walks}
    diagnosis = diagnose_forces(trials, nominal, parameters, motions, reactions, checked)
    silent_on_masses = diagnosis.faulty | (spoilt := spoilt_motions(checked))
    believed = {name: r for name, r in reactions.items() if r.valid.any() and name not in silent_on_masses}
    shown = {name: r for name, r in believed.items() if not is_trunk_unmeasured(motions[name])}
    progress("the floors of marker errors" if settings.ip == "none" else "inertial parameters")
    fitted_motions = [_fitted_motion(t, motions, parameters, joint) for t in trials]
    inertial = _inertial_fit(trials, nominal, parameters, influence, motions, scores, shown or believed, settings)
    if inertial is not None:
        parameters = parameters.with_inertial(inertial.inertial)
        stages[Stage.JP_IP] = parameters, motions
    combined = None
    if joint is not None and inertial is not None and settings.joint_step and shown:
        combined = _combined_fit(trials, nominal, parameters, joint, motions, shown, settings, progress)
    if combined is not None:
        counted = count(nominal, combined.parameters, static)
        parameters, moved = counted.parameters, counted.moved
        motions = {
            t.name: motion_of(
                t.body, parameters, shifted(nodes, t.body.chain.coordinates, moved), converged=combined.converged
            )
            for t, nodes in zip(trials, combined.nodes, strict=True)
        }
        stages[Stage.COMBINED] = parameters, motions
        scores = {t.name: _scores(t, motions, parameters, influence) for t in walks}
        fitted_motions = [_fitted_motion(t, motions, parameters, joint) for t in trials]
    progress("standard errors and inverse dynamics")
    uncertainty = Uncertainty(
        influence, _inertial_spread(inertial, parameters, settings, spread_of_people(nominal.subject))
    )
    of_trials = dict(zip([t.name for t in trials], fitted_motions, strict=True))

    results = [
        trial_result(
            t,
            {stage: (p, of_trial[t.name]) for stage, (p, of_trial) in stages.items()},
            motions[t.name],
            fitted=of_trials[t.name],
            scores=scores.get(t.name),
            reactions=reactions.get(t.name),
            uncertainty=uncertainty,
            plates=PlateErrors.of(settings.plate_error),
            axes=axis_deviations(settings),
            model=nominal,
            held_out=fitted.held_out.get(t.name),
        )
        for t in trials
    ]
    kept: tuple[str, ...] = () if inertial is None or inertial.moved else (inertial.message,)
    if settings.ip != "none":
        kept += (*left_out_of_masses(trials, diagnosis.faulty, spoilt),)
    phases = phases_of(joint, inertial, combined, tuple(shown or believed))
    later = (
        *diagnosis.findings,
        *fitted.findings,
        *(joint.findings if joint else ()),
        *calibration_findings(study, results, parameters, phases, nominal, joint),
        *unmeasured_mass(results, nominal.parameters),
    )
    names = [t.name for t in walks]
    found = without_consequences((*checked, *later, *(finding for t in results for finding in t.findings)))
    verdict = judge(found, names, forced=bool(stopping(checked, names)))
    remarks = (note_of(finding) for finding in later if finding.severity is Severity.INFO)
    notes = (
        *nominal.notes,
        *(joint.notes if joint else ()),
        *kept,
        *(note for t in results for note in t.notes),
        *remarks,
    )
    calibration = Calibration(
        study=study,
        nominal=nominal,
        model=replace(nominal, parameters=parameters, notes=notes),
        static_angles=counted.static,
        trials=tuple(results),
        phases=phases,
        joint=joint,
        inertial=inertial,
        uncertainty=uncertainty,
        unidentifiable=joint.unidentifiable if joint else (),
        notes=notes,
        findings=found,
        verdict=verdict,
    )
    return with_truth(withdrawn(calibration))


def _scores(
    trial: PreparedTrial, motions: Mapping[str, Motion], parameters: Parameters, influence: ErrorSources
) -> TrialScores:
    return whole_body_scores(trial.with_skin, motions[trial.name].nodes, parameters, influence)


def _fitted_motion(
    trial: PreparedTrial, motions: Mapping[str, Motion], parameters: Parameters, joint: JointCalibration | None
) -> FittedMotion:
    return fitted_motion(trial, parameters, parameters_for(joint, trial.name, parameters), motions[trial.name])


def _inertial_fit(
    trials: Sequence[PreparedTrial],
    nominal: SubjectModel,
    parameters: Parameters,
    influence: ErrorSources,
    motions: Mapping[str, Motion],
    scores: Mapping[str, TrialScores],
    on_plates: Mapping[str, GroundReactions],
    settings: CalibrationSettings,
) -> InertialFit | None:
    """From the trials `on_plates`; None where the settings leave inertial parameters alone or there is none."""
    if settings.ip == "none" or not on_plates:
        return None
    began = time.perf_counter()
    loaded = [
        LoadedMotion(name=name, q=m.q, velocity=m.velocity, acceleration=m.acceleration, wrench=r.wrench, valid=r.valid)
        for name, m, r in ((name, motions[name], r) for name, r in on_plates.items())
    ]
    width = float(np.linalg.norm(nominal.landmarks["hjc_r"][1] - nominal.landmarks["hjc_l"][1]))
    subject, scale, which = nominal.subject, TorqueScale(settings.torque_scale), _inertial_set(settings)
    people = spread_of_people(subject)
    equations = equations_of(loaded, parameters, subject, scale, width)
    unseen = [motions[name] for name in on_plates if is_trunk_unmeasured(motions[name])]
    if unseen:  # then none of these trials shows it: those that do would stand alone here
        words = unmeasured_words(unseen[0], parameters)
        return unmeasured_stay(equations, parameters.inertial, which, words, people)
    if settings.ip == "published":
        return fit_published(equations, parameters.inertial, which)
    noise = residual_noise(
        [
            LoadedProblem(
                problem=t.with_skin, nodes=motions[t.name].nodes, reactions=on_plates[t.name], scores=scores.get(t.name)
            )
            for t in trials
            if t.name in on_plates
        ],
        parameters,
        influence,
        subject,
        LogChart(parameters.inertial, which),
        torque_length(subject, scale, width),
        PlateNoise(PlateErrors.of(settings.plate_error)),
        spread_of_the_rest(parameters.inertial, which),
    )
    fit = fit_by_evidence(equations, parameters.inertial, which, noise, people)
    return replace(fit, seconds=time.perf_counter() - began)


def spread_of_people(subject: Subject) -> ConsistentSettings:
    """How far people scatter about the table of the nominal masses: further where it may be the wrong one."""
    return ConsistentSettings(more_of=child_spread(subject))


def _inertial_set(settings: CalibrationSettings) -> InertialSet:
    return symmetric_set() if settings.ip_set == "symmetric" else full_set()


def _combined_fit(
    trials: Sequence[PreparedTrial],
    nominal: SubjectModel,
    parameters: Parameters,
    joint: JointCalibration,
    motions: Mapping[str, Motion],
    on_plates: Mapping[str, GroundReactions],
    settings: CalibrationSettings,
    progress: Progress,
) -> CombinedFit | None:
    """With the loads of the trials `on_plates`; None for impossible bodies, which its chart cannot hold."""
    if impossible_bodies(parameters.inertial):
        return None
    progress("joint and inertial parameters together")
    steps = []
    for t in trials:
        r = on_plates.get(t.name)
        wrench, valid = (None, None) if r is None else (r.wrench, r.valid)
        nodes = motions[t.name].nodes
        steps.append(CombinedTrial(t.body.followed(nodes), nodes, wrench, valid))
    determined = tuple(name for name in joint.free if name not in joint.unidentifiable)
    chosen = CombinedSettings(load_share=settings.joint_step_load_share, spread=spread_of_people(nominal.subject))
    return combined_fit(steps, parameters, determined, _inertial_set(settings), nominal.subject, chosen)


def _inertial_spread(
    inertial: InertialFit | None, parameters: Parameters, settings: CalibrationSettings, people: ConsistentSettings
) -> Array | None:
    """(84, n) R with covariance R R^T: of the fit, and of people where it moves nothing; None: unknown."""
    if inertial is None:
        if impossible_bodies(parameters.inertial):
            return None
        inertial = stay_nominal(parameters.inertial, _inertial_set(settings), people)
    if not inertial.statistical:
        return None
    return np.hstack([inertial_square_root(inertial), spread_of_the_rest(parameters.inertial, _inertial_set(settings))])
