"""Calibrate a study, in stages that hand on one `CalibrationState`.

1. `preprocess_study`: clean the trials, build the nominal model from the static trial
   (`preprocess/preprocessed_study.py`).
2. `prepare_calibration`: rotate the trials to the direction of progression and pose their tracking
   problems.
3. `fit_joints`: joint parameters and soft tissue from the markers of all trials.
4. `track_trials`: motions with the nominal and the fitted model, forces under the feet,
   disagreement of both.
5. `fit_inertia`: inertial parameters from the pelvis residual; on demand all parameters together.
6. `_assemble_calibration`: standard errors, torques, findings and the verdict.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import TypeAlias

import numpy as np

from gaitcal.analysis import fit_findings
from gaitcal.analysis.fit_joints import fit_joints
from gaitcal.analysis.prepared_trials import (
    CalibrationState,
    MovingTrial,
    prepare_calibration,
    track_trial,
)
from gaitcal.analysis.result import (
    Calibration,
    Stage,
    TrialResult,
    Uncertainty,
    remove_refused_results,
)
from gaitcal.analysis.trial_result import (
    AnkleZeroCorrection,
    assemble_trial_result,
    compute_static_angles,
    shift_coefficients,
    zero_ankle_angles,
)
from gaitcal.analysis.truth_comparison import compare_with_truth
from gaitcal.arrays import Array
from gaitcal.calibration import inertial_calibration, inertial_evidence
from gaitcal.calibration.combined import (
    CombinedFit,
    CombinedProblem,
    CombinedSettings,
    fit_combined,
)
from gaitcal.calibration.error_sources import make_nominal_errors
from gaitcal.calibration.joint_phases import PhaseSummary
from gaitcal.calibration.torque_errors import factor_inertial_covariance
from gaitcal.dynamics.ground_reactions import GroundReactions
from gaitcal.dynamics.measurement_errors import PlateErrors
from gaitcal.errors import Finding, Severity, format_note, join_names
from gaitcal.model.anthropometry import estimate_table_error
from gaitcal.model.parameters import (
    InertialSet,
    find_impossible_bodies,
    make_full_set,
    make_symmetric_set,
)
from gaitcal.preprocess.preprocessed_study import PreprocessedStudy, preprocess_study
from gaitcal.quality.after_fit import check_physical_limits
from gaitcal.quality.study_checks import check_preprocessed
from gaitcal.quality.verdict import LEFT_OUT, judge, remove_consequences, select_stopping_errors
from gaitcal.runtime import Progress, map_in_pairs, silent, with_one_blas_thread
from gaitcal.study.settings import CalibrationSettings, Protocol
from gaitcal.study.study import Study
from gaitcal.tracking.motion import build_motion

LoadedTrial: TypeAlias = tuple[MovingTrial, GroundReactions]
"""A tracked trial and the ground reactions on its feet."""


@with_one_blas_thread
def calibrate(
    study: Study,
    progress: Progress = silent,
    *,
    leave_out: bool = False,
    checked: Sequence[Finding] | None = None,
) -> Calibration:
    """Fit the joint and inertial parameters of a person and compute the joint torques.

    Parameters
    ----------
    study : Study
        From `Study.load`.
    progress : callable
        Called with a line of text at the beginning of each step.
    leave_out : bool
        Also compute the held-out error (`analysis/fit_joints.py`), which takes four more fits of
        the joint parameters.
    checked : sequence of Finding, optional
        Findings of `gaitcal.check_study`; the study is checked here if they are not given. Errors
        among them do not stop the calibration, but its verdict is "refused" then: no torque counts
        as valid, and no error bar is given.

    Returns
    -------
    Calibration
        Models, motions, torques of every gait trial, standard errors, findings and verdict.

    Raises
    ------
    InputError
        The recordings do not allow it: landmarks missing in the static trial, too few markers of a
        segment, forces that fit no foot. A phase that stops early is no error: see
        `Calibration.converged` and `phases`.
    """
    if checked is None:
        progress("checking the recordings")
    preprocessed = preprocess_study(study)
    if checked is None:
        checked = check_preprocessed(preprocessed)
    return calibrate_preprocessed(preprocessed, checked, progress, compute_held_out=leave_out)


@with_one_blas_thread
def calibrate_preprocessed(
    preprocessed: PreprocessedStudy,
    checked: Sequence[Finding],
    progress: Progress = silent,
    *,
    compute_held_out: bool = False,
) -> Calibration:
    """Calibrate a study that is preprocessed, as `calibrate` does.

    Parameters
    ----------
    preprocessed : PreprocessedStudy
        From `preprocess_study`.
    checked : sequence of Finding
        Findings of `check_preprocessed`.
    progress : callable
        Called with a line of text at the beginning of each step.
    compute_held_out : bool
        Also compute the held-out error.

    Returns
    -------
    Calibration

    Raises
    ------
    InputError
        As of `calibrate`.
    """
    progress("nominal model from the static trial")
    prepared = prepare_calibration(preprocessed, checked)
    state = track_trials(
        fit_joints(prepared, progress, compute_held_out=compute_held_out), progress
    )
    # A functional trial whose joint cannot have moved so spoils the joints of all trials.
    refused = find_impossible_functional_trials(state)
    if refused:
        # The joints are fitted again, to the other trials.
        progress(f"once more without {join_names(list(refused))}")
        remaining = tuple(t for t in prepared.trials if t.name not in refused)
        findings = (*prepared.findings, *refused.values())
        prepared = replace(prepared, trials=remaining, findings=findings)
        state = track_trials(
            fit_joints(prepared, progress, compute_held_out=compute_held_out), progress
        )
    state = fit_inertia(state, progress)
    return _assemble_calibration(state, preprocessed.study, progress)


def find_impossible_functional_trials(state: CalibrationState) -> dict[str, Finding]:
    """Find functional (single-joint) trials in which a leg moves as no leg can.

    A fault of one functional trial concerns that trial alone: the joints are fitted without it, and
    no torque of a walk is refused because of it.

    Returns: trial -> warning that it is left out; empty if no trial would remain, or no joint was
    fitted.
    """
    if state.joint is None:
        return {}
    out = dict[str, Finding]()
    for trial in (t for t in state.trials if t.joint is not None):
        for finding in check_physical_limits(trial.motion, state.model.subject.weight):
            message = f"{finding.found}; the joint parameters were fitted without this trial"
            out[trial.name] = replace(
                finding, severity=Severity.WARNING, found=message, leg="", topic=LEFT_OUT
            )
    return out if len(out) < len(state.trials) else {}


def track_trials(state: CalibrationState, progress: Progress) -> CalibrationState:
    """Track all trials with the nominal and the fitted joint parameters and diagnose the forces.

    `state`: after the fit of the joint parameters. `progress`: called with a line of text at the
    beginning of each step. Returns: with motions, ground reactions, ankle angles zeroed in the
    static posture, and the force diagnosis.
    """
    joint = state.joint
    # A tilted talus shifts the ankle angles, not the posture: they are counted from the static
    # trial.
    zeroed = _zero_ankles(state)
    progress("tracking with the nominal and the calibrated joint parameters")
    if joint is None:
        uncertainty = Uncertainty(make_nominal_errors(), None)
    else:
        uncertainty = Uncertainty(joint.errors, None, joint.artefact)
    state = replace(
        state,
        parameters=zeroed.parameters,
        static_angles=zeroed.static_angles,
        uncertainty=uncertainty,
    )
    stage = Stage.NOMINAL if joint is None else Stage.JP
    trials = map_in_pairs(partial(track_trial, state=state, stage=stage), state.trials)
    state = replace(state, trials=tuple(trials))
    progress("comparing motion and forces")
    return replace(state, force_diagnosis=fit_findings.diagnose_forces(state))


def fit_inertia(state: CalibrationState, progress: Progress) -> CalibrationState:
    """Fit the inertial parameters, then, if the settings ask for it, all parameters together.

    `progress`: called with a line of text at the beginning of each step. Returns: with the inertial
    fit, its parameters as the last stage of every trial, and the errors of inertial parameters.
    """
    settings, loaded = state.settings, _select_trials_for_inertial_fit(state)
    progress("error bars of the masses" if settings.ip == "none" else "inertial parameters")
    inertial = None if settings.ip == "none" or not loaded else _fit_inertial(state, loaded)
    if inertial is not None:
        parameters = state.parameters.with_inertial(inertial.inertial)
        trials = tuple(t.with_stage(Stage.JP_IP, parameters, t.motion) for t in state.trials)
        state = replace(state, inertial=inertial, parameters=parameters, trials=trials)
        if settings.joint_step and not fit_findings.is_trunk_unmeasured(loaded[0][0].motion):
            state = _fit_together(state, loaded, progress)
    uncertainty = replace(state.uncertainty, inertial=_factor_inertial_errors(state))
    return replace(state, uncertainty=uncertainty)


def _assemble_calibration(state: CalibrationState, study: Study, progress: Progress) -> Calibration:
    """Assemble the calibration with its standard errors, torques, findings and verdict.

    Parameters
    ----------
    state : CalibrationState
        After the fit of the inertial parameters.
    study : Study
        The preprocessed study.
    progress : callable
        Called with a line of text at the beginning of each step.

    Returns
    -------
    Calibration
        Compared with the truth if the study declares it; without results that its verdict refuses.
    """
    progress("standard errors and inverse dynamics")
    results = tuple(assemble_trial_result(t, state) for t in state.trials)
    nominal, joint, phases = state.model, state.joint, _list_phases(state)
    after_fit = (
        *state.force_diagnosis.findings,
        *state.findings,
        *(joint.findings if joint else ()),
        *fit_findings.check_calibration(state, results, phases),
        *fit_findings.check_unmeasured_mass(results, nominal.parameters),
    )
    names = [t.name for t in state.walks]
    # Trials that were left out while fitting belong to the result with their reason.
    absent = {f.where: f.evidence for f in state.findings if f.topic == LEFT_OUT}
    of_trials = (finding for t in results for finding in t.findings)
    # A fault is reported once, without the findings that only follow from it.
    found = remove_consequences((*state.checked, *after_fit, *of_trials))
    notes = _collect_notes(state, results, after_fit)
    calibration = Calibration(
        study=replace(study, trials=tuple(t for t in study.trials if t.name not in absent)),
        nominal=nominal,
        model=replace(nominal, parameters=state.parameters, notes=notes),
        static_angles=state.static_angles,
        trials=results,
        phases=phases,
        joint=joint,
        inertial=state.inertial,
        uncertainty=state.uncertainty,
        joint_prior=state.prior if state.settings.decided_by is Protocol.EVIDENCE else None,
        unidentifiable=joint.unidentifiable if joint else (),
        notes=notes,
        findings=found,
        verdict=judge(found, names, forced=bool(select_stopping_errors(state.checked, names))),
        left_out=absent,
    )
    return compare_with_truth(remove_refused_results(calibration))


def _collect_notes(
    state: CalibrationState, results: Sequence[TrialResult], after_fit: Sequence[Finding]
) -> tuple[str, ...]:
    """Collect the assumptions: of model, fits and trials, and the findings that are notes."""
    joint, inertial = state.joint, state.inertial
    return (
        *state.model.notes,
        *(joint.notes if joint else ()),
        *(() if inertial is None or inertial.moved else (inertial.message,)),
        *(() if state.settings.ip == "none" else fit_findings.note_trials_without_masses(state)),
        *(note for t in results for note in t.notes),
        *(format_note(finding) for finding in after_fit if finding.severity is Severity.INFO),
    )


def _zero_ankles(state: CalibrationState) -> AnkleZeroCorrection:
    """Zero the ankle angles of the last model in the static posture if the settings ask for it."""
    if state.static is None:
        return AnkleZeroCorrection(state.parameters, {}, {})
    if state.settings.keeps_ankle_zero and state.joint is not None:
        return zero_ankle_angles(state.model, state.parameters, state.static)
    angles = compute_static_angles(state.model, state.parameters, state.static)
    return AnkleZeroCorrection(state.parameters, {}, angles)


def _select_trials_for_inertial_fit(state: CalibrationState) -> list[LoadedTrial]:
    """Select the tracked trials with valid ground reactions that determine masses.

    Trials with faulty forces, or with a leg whose markers do not determine its motion, are left
    out. Trials without trunk markers are used only if no other trial is left.
    """
    excluded = state.force_diagnosis.faulty | fit_findings.list_trials_with_faulty_legs(
        state.checked
    )
    usable = []
    for t in state.trials:
        if t.reactions is not None and t.reactions.valid.any() and t.name not in excluded:
            usable.append((t, t.reactions))
    with_trunk = [(t, r) for t, r in usable if not fit_findings.is_trunk_unmeasured(t.motion)]
    return with_trunk or usable


def _fit_inertial(
    state: CalibrationState, loaded: Sequence[LoadedTrial]
) -> inertial_calibration.InertialFit:
    """Fit the inertial parameters to the pelvis residual of the loaded trials."""
    began = time.perf_counter()
    nominal, parameters, settings = state.model, state.parameters, state.settings
    motions = [inertial_calibration.LoadedMotion.from_motion(t.motion, r) for t, r in loaded]
    # m, distance of the hip centres: one of the published scales of torque.
    width = float(np.linalg.norm(nominal.landmarks["hjc_r"][1] - nominal.landmarks["hjc_l"][1]))
    subject, which = nominal.subject, _choose_inertial_set(settings)
    scale = inertial_calibration.TorqueScale(settings.torque_scale)
    equations = inertial_calibration.assemble_root_equations(
        motions, parameters, subject, scale, width
    )
    if fit_findings.is_trunk_unmeasured(loaded[0][0].motion):
        # The residual is then mostly the error of the trunk's assumed motion.
        rms = equations.compute_rms(parameters.inertial)
        segments = fit_findings.describe_unmeasured_segments(loaded[0][0].motion, parameters)
        residual = inertial_evidence.describe_residual(rms)
        why = (
            f"markers do not determine {segments}; {residual} depends on their motion, not on their"
            " mass"
        )
        return inertial_evidence.keep_nominal(
            parameters.inertial, which, _make_population_spread(state), rms, why
        )
    if settings.ip == "published":
        return inertial_calibration.fit_published(equations, parameters.inertial, which)
    problems = [
        inertial_evidence.LoadedProblem(
            problem=t.body_with_tissue,
            coefficients=t.motion.coefficients,
            reactions=r,
            scores=t.scores,
        )
        for t, r in loaded
    ]
    # Errors of markers, joints, plates and fixed masses also move the residual: the fit may explain
    # only what exceeds them.
    noise = inertial_evidence.estimate_residual_noise(
        problems,
        parameters,
        state.uncertainty.joint or make_nominal_errors(),
        subject,
        inertial_calibration.LogChart(parameters.inertial, which),
        inertial_calibration.get_torque_length(subject, scale, width),
        inertial_evidence.PlateNoise(PlateErrors.from_table(settings.plate_error)),
        inertial_evidence.compute_fixed_spread(parameters.inertial, which),
    )
    fit = inertial_evidence.fit_by_evidence(
        equations, parameters.inertial, which, noise, _make_population_spread(state)
    )
    return replace(fit, seconds=time.perf_counter() - began)


def _make_population_spread(state: CalibrationState) -> inertial_calibration.ConsistentSettings:
    """Describe how people scatter about the anthropometric table: more if it may be the wrong one.

    Parameters
    ----------
    state : CalibrationState
        Its model has the subject.

    Returns
    -------
    ConsistentSettings
    """
    return inertial_calibration.ConsistentSettings(
        more_of=estimate_table_error(state.model.subject)
    )


def _choose_inertial_set(settings: CalibrationSettings) -> InertialSet:
    return make_symmetric_set() if settings.ip_set == "symmetric" else make_full_set()


def _fit_together(
    state: CalibrationState, loaded: Sequence[LoadedTrial], progress: Progress
) -> CalibrationState:
    """Fit joint and inertial parameters together.

    The state is returned unchanged if a body is impossible: the chart of the fit cannot hold it.
    """
    joint, settings = state.joint, state.settings
    if joint is None or find_impossible_bodies(state.parameters.inertial):
        return state
    progress("joint and inertial parameters together")
    forces = {t.name: r for t, r in loaded}
    problems = []
    for t in state.trials:
        coefficients, r = t.motion.coefficients, forces.get(t.name)
        wrench, valid = (None, None) if r is None else (r.wrench, r.valid)
        problems.append(
            CombinedProblem(
                t.whole_body_problem.follow_pelvis(coefficients), coefficients, wrench, valid
            )
        )
    # Parameters that no trial shows stay as they are: forces would move them to absorb other
    # errors.
    determined = tuple(name for name in joint.free if name not in joint.unidentifiable)
    chosen = CombinedSettings(
        load_share=settings.joint_step_load_share, spread=_make_population_spread(state)
    )
    fit = fit_combined(
        problems,
        state.parameters,
        determined,
        _choose_inertial_set(settings),
        state.model.subject,
        chosen,
    )
    zeroed = _zero_ankles(replace(state, parameters=fit.parameters))
    trials = []
    for t, coefficients in zip(state.trials, fit.coefficients, strict=True):
        # Moving the zero angles changes coordinates by a constant.
        shifted = shift_coefficients(
            coefficients, t.whole_body_problem.chain.coordinates, zeroed.offsets
        )
        motion = build_motion(
            t.whole_body_problem, zeroed.parameters, shifted, converged=fit.converged
        )
        trial = t.with_stage(Stage.COMBINED, zeroed.parameters, motion)
        trials.append(trial.with_marker_scores(state.uncertainty))
    return replace(
        state,
        combined=fit,
        parameters=zeroed.parameters,
        static_angles=zeroed.static_angles,
        trials=tuple(trials),
    )


def _factor_inertial_errors(state: CalibrationState) -> Array | None:
    """Compute (84, n) R with covariance R R^T of the inertial parameters; None if unknown.

    It is the covariance of the fit, and that of the population for parameters that the fit keeps.
    """
    inertial, nominal = state.inertial, state.parameters.inertial
    which = _choose_inertial_set(state.settings)
    if inertial is None:
        if find_impossible_bodies(nominal):
            return None
        inertial = inertial_evidence.keep_nominal(nominal, which, _make_population_spread(state))
    if not inertial.statistical:
        return None
    fixed = inertial_evidence.compute_fixed_spread(nominal, which)
    return np.hstack([factor_inertial_covariance(inertial), fixed])


def _list_phases(state: CalibrationState) -> tuple[PhaseSummary, ...]:
    """List the fits that were made, those of the joint parameters first.

    `state`: after the fit of the inertial parameters. Returns: in the order in which they were
    made.
    """
    joint, inertial, combined = state.joint, state.inertial, state.combined
    fits = list[tuple[str, inertial_calibration.InertialFit | CombinedFit, int, int, str]]()
    if inertial is not None:
        fits.append(
            ("inertial", inertial, len(inertial.names), inertial.iterations, inertial.message)
        )
    if combined is not None and joint is not None and inertial is not None:
        text = "" if combined.converged else f"{combined.ending.value}; "
        text += (
            f"marker sigma {1e3 * combined.marker_sigma:.2f} mm a coordinate, load share "
            f"{combined.load_share:g}"
        )
        count = len(joint.free) + len(inertial.names)
        fits.append(("joint and inertial", combined, count, combined.steps, text))
    # Both fits use the same walks.
    trials = tuple(t.name for t, _ in _select_trials_for_inertial_fit(state))
    inertial_phases = [
        PhaseSummary(
            name=name,
            trials=trials,
            parameters=count,
            iterations=iterations,
            seconds=fit.seconds,
            converged=fit.converged,
            message=message,
        )
        for name, fit, count, iterations, message in fits
    ]
    return (*(joint.phases if joint else ()), *inertial_phases)
