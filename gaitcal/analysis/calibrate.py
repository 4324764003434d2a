"""Calibrate a study, in five stages that hand on one `CalibrationState`.

1. `preprocess_study`: clean the trials, build the nominal model from the static trial
   (`preprocess/preprocessed_study.py`).
2. `session_of`: rotate the trials to the direction of progression and pose their tracking problems.
3. `fit_joints`: joint parameters and soft tissue from the markers of all trials.
4. `track`: motions with the nominal and the fitted model, forces under the feet, disagreement of
   both.
5. `fit_inertia`: inertial parameters from the pelvis residual; on demand all parameters together.
   `judged`: standard errors, torques, findings and the verdict.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from gaitcal.analysis import fit_findings
from gaitcal.analysis.fit_joints import fit_joints
from gaitcal.analysis.prepared_trials import CalibrationState, MovingTrial, session_of, tracked
from gaitcal.analysis.result import Calibration, Stage, TrialResult, Uncertainty, withdrawn
from gaitcal.analysis.trial_result import (
    Counted,
    counted_from_static,
    shifted,
    static_angles,
    trial_result,
)
from gaitcal.analysis.truth_comparison import with_truth
from gaitcal.arrays import Array
from gaitcal.calibration import inertial_calibration, inertial_evidence
from gaitcal.calibration.combined import (
    CombinedFit,
    CombinedProblem,
    CombinedSettings,
    fit_combined,
)
from gaitcal.calibration.error_sources import make_nominal_errors
from gaitcal.calibration.joint_phases import Phase
from gaitcal.calibration.torque_errors import factor_inertial_covariance
from gaitcal.dynamics.ground_reactions import GroundReactions
from gaitcal.dynamics.measurement_errors import PlateErrors
from gaitcal.errors import Finding, Severity, listed, note_of
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
from gaitcal.runtime import Progress, silent, with_one_blas_thread
from gaitcal.study.settings import CalibrationSettings
from gaitcal.study.study import Study
from gaitcal.tracking.motion import build_motion

Loaded: TypeAlias = tuple[MovingTrial, GroundReactions]


@with_one_blas_thread
def calibrate(
    study: Study,
    progress: Progress = silent,
    *,
    leave_out: bool = False,
    checked: Sequence[Finding] | None = None,
) -> Calibration:
    """Fit a person's joint and inertial parameters and compute the joint torques of every gait
    trial.

    Parameters
    ----------
    study
        From `Study.load`.
    progress
        Called with a line of text at the beginning of each step.
    leave_out
        Find the held-out error too (`analysis/fit_joints.py`), which takes four more fits of the
        joint parameters.
    checked
        What `gaitcal.check_study` found; made here unless given. Errors among it do not stop the
        calibration, but its verdict is "refused" then: no torque counts as valid, and no error bar
        is given.

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
    return calibrate_preprocessed(preprocessed, checked, progress, leave_out=leave_out)


@with_one_blas_thread
def calibrate_preprocessed(
    preprocessed: PreprocessedStudy,
    checked: Sequence[Finding],
    progress: Progress = silent,
    *,
    leave_out: bool = False,
) -> Calibration:
    """Calibrate a study that is prepared, as `calibrate` does.

    Parameters
    ----------
    preprocessed
        From `preprocess_study`.
    checked
        What `check_preprocessed` found.
    progress, leave_out
        As of `calibrate`.

    Raises
    ------
    InputError
        As of `calibrate`.
    """
    progress("nominal model from the static trial")
    prepared = session_of(preprocessed, checked)
    session = track(fit_joints(prepared, progress, leave_out=leave_out), progress)
    refused = impossible_functional_trials(session)
    if refused:
        progress(f"once more without {listed(list(refused))}")
        rest = tuple(t for t in prepared.trials if t.name not in refused)
        prepared = replace(prepared, trials=rest, findings=(*prepared.findings, *refused.values()))
        session = track(fit_joints(prepared, progress, leave_out=leave_out), progress)
    session = fit_inertia(session, progress)
    return judged(session, preprocessed.study, progress)


def impossible_functional_trials(session: CalibrationState) -> dict[str, Finding]:
    """Find functional trials (single-joint) in which a leg moves as none can.

    What is wrong with one trial concerns that trial: the joints are to be found without it, and no
    torque of a walk is refused for it.

    Parameters
    ----------
    session
        After tracking.

    Returns
    -------
    dict
        Trial -> warning that it is left out; empty where nothing would be left to fit, or no joint
        was fitted.
    """
    if session.joint is None:
        return {}
    out = dict[str, Finding]()
    for trial in (t for t in session.trials if t.joint is not None):
        for finding in check_physical_limits(trial.motion, session.model.subject.weight):
            left_out = f"{finding.found}; the joint parameters were found without this trial"
            out[trial.name] = replace(
                finding, severity=Severity.WARNING, found=left_out, leg="", topic=LEFT_OUT
            )
    return out if len(out) < len(session.trials) else {}


def track(session: CalibrationState, progress: Progress) -> CalibrationState:
    """Motions and forces of all trials with the nominal and the fitted joint parameters."""
    joint = session.joint
    counted = _counted(session)
    progress("tracking with the nominal and the calibrated joint parameters")
    session = replace(
        session,
        parameters=counted.parameters,
        static_angles=counted.static,
        uncertainty=Uncertainty(make_nominal_errors(), None)
        if joint is None
        else Uncertainty(joint.errors, None, joint.artefact),
    )
    stage = Stage.NOMINAL if joint is None else Stage.JP
    session = replace(session, trials=tuple(tracked(t, session, stage) for t in session.trials))
    progress("do motion and forces agree?")
    return replace(session, forces=fit_findings.diagnose_forces(session))


def fit_inertia(session: CalibrationState, progress: Progress) -> CalibrationState:
    """Inertial parameters, then, where asked for, joint and inertial parameters together."""
    settings, loaded = session.settings, weighing(session)
    progress("the floors of marker errors" if settings.ip == "none" else "inertial parameters")
    inertial = None if settings.ip == "none" or not loaded else _inertial_fit(session, loaded)
    if inertial is not None:
        parameters = session.parameters.with_inertial(inertial.inertial)
        trials = tuple(t.reached(Stage.JP_IP, parameters, t.motion) for t in session.trials)
        session = replace(session, inertial=inertial, parameters=parameters, trials=trials)
        if settings.joint_step and not fit_findings.is_trunk_unmeasured(loaded[0][0].motion):
            session = _fit_together(session, loaded, progress)
    return replace(
        session, uncertainty=replace(session.uncertainty, inertial=_inertial_spread(session))
    )


def judged(session: CalibrationState, study: Study, progress: Progress) -> Calibration:
    """The calibration with its standard errors, torques, findings and verdict."""
    progress("standard errors and inverse dynamics")
    results = tuple(trial_result(t, session) for t in session.trials)
    nominal, joint, phases = session.model, session.joint, phases_of(session)
    later = (
        *session.forces.findings,
        *session.findings,
        *(joint.findings if joint else ()),
        *fit_findings.calibration_findings(session, results, phases),
        *fit_findings.unmeasured_mass(results, nominal.parameters),
    )
    names = [t.name for t in session.walks]
    absent = {f.where: f.evidence for f in session.findings if f.topic == LEFT_OUT}
    found = remove_consequences(
        (*session.checked, *later, *(finding for t in results for finding in t.findings))
    )
    notes = _notes(session, results, later)
    calibration = Calibration(
        study=replace(study, trials=tuple(t for t in study.trials if t.name not in absent)),
        nominal=nominal,
        model=replace(nominal, parameters=session.parameters, notes=notes),
        static_angles=session.static_angles,
        trials=results,
        phases=phases,
        joint=joint,
        inertial=session.inertial,
        uncertainty=session.uncertainty,
        unidentifiable=joint.unidentifiable if joint else (),
        notes=notes,
        findings=found,
        verdict=judge(found, names, forced=bool(select_stopping_errors(session.checked, names))),
        left_out=absent,
    )
    return with_truth(withdrawn(calibration))


def _notes(
    session: CalibrationState, results: Sequence[TrialResult], later: Sequence[Finding]
) -> tuple[str, ...]:
    """What was assumed: of the model, the joint and inertial parameters, the trials, and remarks
    among the findings.
    """
    joint, inertial = session.joint, session.inertial
    return (
        *session.model.notes,
        *(joint.notes if joint else ()),
        *(() if inertial is None or inertial.moved else (inertial.message,)),
        *(() if session.settings.ip == "none" else fit_findings.left_out_of_masses(session)),
        *(note for t in results for note in t.notes),
        *(note_of(finding) for finding in later if finding.severity is Severity.INFO),
    )


def _counted(session: CalibrationState) -> Counted:
    """The session's parameters with ankle angles counted from the static posture, where its
    settings ask for it.
    """
    if session.static is None:
        return Counted(session.parameters, {}, {})
    if session.settings.keeps_ankle_zero and session.joint is not None:
        return counted_from_static(session.model, session.parameters, session.static)
    return Counted(
        session.parameters, {}, static_angles(session.model, session.parameters, session.static)
    )


def weighing(session: CalibrationState) -> list[Loaded]:
    """Tracked trials whose forces tell of masses: those whose trunk is seen, or all where it is
    seen in none.
    """
    silent_on_masses = session.forces.faulty | fit_findings.spoilt_motions(session.checked)
    believed = [
        (t, t.reactions)
        for t in session.trials
        if t.reactions is not None and t.reactions.valid.any() and t.name not in silent_on_masses
    ]
    return [
        (t, r) for t, r in believed if not fit_findings.is_trunk_unmeasured(t.motion)
    ] or believed


def _inertial_fit(
    session: CalibrationState, loaded: Sequence[Loaded]
) -> inertial_calibration.InertialFit:
    began = time.perf_counter()
    nominal, parameters, settings = session.model, session.parameters, session.settings
    motions = [inertial_calibration.LoadedMotion.from_motion(t.motion, r) for t, r in loaded]
    width = float(np.linalg.norm(nominal.landmarks["hjc_r"][1] - nominal.landmarks["hjc_l"][1]))
    subject, which = nominal.subject, _inertial_set(settings)
    scale = inertial_calibration.TorqueScale(settings.torque_scale)
    equations = inertial_calibration.assemble_root_equations(
        motions, parameters, subject, scale, width
    )
    if fit_findings.is_trunk_unmeasured(loaded[0][0].motion):
        rms, unseen = (
            equations.compute_rms(parameters.inertial),
            fit_findings.unmeasured_words(loaded[0][0].motion, parameters),
        )
        left = inertial_evidence.describe_residual(rms)
        why = f"markers do not determine {unseen}; {left} tells how that moves, not what it weighs"
        return inertial_evidence.keep_nominal(
            parameters.inertial, which, spread_of_people(session), rms, why
        )
    if settings.ip == "published":
        return inertial_calibration.fit_published(equations, parameters.inertial, which)
    noise = inertial_evidence.estimate_residual_noise(
        [
            inertial_evidence.LoadedProblem(
                problem=t.with_skin,
                coefficients=t.motion.coefficients,
                reactions=r,
                scores=t.scores,
            )
            for t, r in loaded
        ],
        parameters,
        session.uncertainty.joint or make_nominal_errors(),
        subject,
        inertial_calibration.LogChart(parameters.inertial, which),
        inertial_calibration.get_torque_length(subject, scale, width),
        inertial_evidence.PlateNoise(PlateErrors.from_table(settings.plate_error)),
        inertial_evidence.compute_fixed_spread(parameters.inertial, which),
    )
    fit = inertial_evidence.fit_by_evidence(
        equations, parameters.inertial, which, noise, spread_of_people(session)
    )
    return replace(fit, seconds=time.perf_counter() - began)


def spread_of_people(session: CalibrationState) -> inertial_calibration.ConsistentSettings:
    """How far people scatter about the table of the nominal masses: further where it may be the
    wrong one.
    """
    return inertial_calibration.ConsistentSettings(
        more_of=estimate_table_error(session.model.subject)
    )


def _inertial_set(settings: CalibrationSettings) -> InertialSet:
    return make_symmetric_set() if settings.ip_set == "symmetric" else make_full_set()


def _fit_together(
    session: CalibrationState, loaded: Sequence[Loaded], progress: Progress
) -> CalibrationState:
    """Joint and inertial parameters together; as it was for impossible bodies, which the fit's
    chart cannot hold.
    """
    joint, settings = session.joint, session.settings
    if joint is None or find_impossible_bodies(session.parameters.inertial):
        return session
    progress("joint and inertial parameters together")
    forces = {t.name: r for t, r in loaded}
    steps = []
    for t in session.trials:
        coefficients, r = t.motion.coefficients, forces.get(t.name)
        wrench, valid = (None, None) if r is None else (r.wrench, r.valid)
        steps.append(
            CombinedProblem(t.body.follow_pelvis(coefficients), coefficients, wrench, valid)
        )
    determined = tuple(name for name in joint.free if name not in joint.unidentifiable)
    chosen = CombinedSettings(
        load_share=settings.joint_step_load_share, spread=spread_of_people(session)
    )
    fit = fit_combined(
        steps,
        session.parameters,
        determined,
        _inertial_set(settings),
        session.model.subject,
        chosen,
    )
    counted = _counted(replace(session, parameters=fit.parameters))
    trials = []
    for t, coefficients in zip(session.trials, fit.coefficients, strict=True):
        moved = shifted(coefficients, t.body.chain.coordinates, counted.moved)
        motion = build_motion(t.body, counted.parameters, moved, converged=fit.converged)
        trials.append(
            t.reached(Stage.COMBINED, counted.parameters, motion).scored(session.uncertainty)
        )
    return replace(
        session,
        combined=fit,
        parameters=counted.parameters,
        static_angles=counted.static,
        trials=tuple(trials),
    )


def _inertial_spread(session: CalibrationState) -> Array | None:
    """(84, n) R with covariance R R^T: of the fit, and of people where it moves nothing; None:
    unknown.
    """
    inertial, nominal, which = (
        session.inertial,
        session.parameters.inertial,
        _inertial_set(session.settings),
    )
    if inertial is None:
        if find_impossible_bodies(nominal):
            return None
        inertial = inertial_evidence.keep_nominal(nominal, which, spread_of_people(session))
    if not inertial.statistical:
        return None
    return np.hstack(
        [
            factor_inertial_covariance(inertial),
            inertial_evidence.compute_fixed_spread(nominal, which),
        ]
    )


def phases_of(session: CalibrationState) -> tuple[Phase, ...]:
    """The fits that were made, those of the joint parameters first."""
    joint, inertial, combined = session.joint, session.inertial, session.combined
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
    trials = tuple(t.name for t, _ in weighing(session))
    of_bodies = [
        Phase(
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
    return (*(joint.phases if joint else ()), *of_bodies)
