"""Joint parameters of a study: plain or under a robust loss, with or without the error on frames left out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial

from gaitcal.calibration.joint_evidence import calibrate_by_evidence
from gaitcal.calibration.joint_phases import (
    JointCalibration,
    JointTrial,
    PhaseSettings,
    calibrate_in_phases,
    sequential_phases,
    simultaneous_phases,
)
from gaitcal.calibration.joint_prior import WEAK, prior_of_study
from gaitcal.calibration.task_tissue import task_tissue
from gaitcal.findings import Finding
from gaitcal.model.joint_parameters import gait_parameters, leg_parameters
from gaitcal.model.parameters import Parameters
from gaitcal.model.subject_model import SubjectModel
from gaitcal.motion.robust import Loss
from gaitcal.runtime import Progress
from gaitcal.session.hold_out import HeldOut, hold_out
from gaitcal.session.prepare import PreparedTrial, joint_bounds, prepare_trial
from gaitcal.session.robust import calibrate_robustly, without_exchanged_labels
from gaitcal.study.joint_prior import JointPrior
from gaitcal.study.settings import CalibrationSettings, Mode, Protocol
from gaitcal.study.study import Study

SIDES = {"both": ("r", "l"), "right": ("r",), "left": ("l",)}


@dataclass(frozen=True, kw_only=True)
class JointStage:
    """What the first stage of a calibration gives."""

    trials: tuple[PreparedTrial, ...]
    """With the weights that they were fitted with."""
    joint: JointCalibration | None
    """None where the settings leave joint parameters alone."""
    parameters: Parameters
    held_out: Mapping[str, HeldOut]
    """Trial -> error on frames that took no part; empty unless asked for."""
    findings: tuple[Finding, ...]
    """What a robust loss left out or put right."""


def joint_stage(study: Study, nominal: SubjectModel, progress: Progress, *, leave_out: bool) -> JointStage:
    """Prepare the moving trials and fit the joint parameters to them."""
    settings = study.settings
    loss = None if settings.robust == "none" else Loss(settings.robust)
    study, findings = (study, ()) if loss is None else without_exchanged_labels(study, nominal)
    trials = [prepare_trial(trial, nominal, settings) for trial in study.moving]
    prior = prior_of_study(settings.joint_prior, study.joint_prior)
    fit = partial(joint_parameters, nominal=nominal, settings=settings, prior=prior)
    if settings.jp and trials:
        progress("joint parameters")
    if loss is None:
        joint, parameters = fit(trials)
    else:
        together = settings.jp and fits_legs_together(settings)
        trials, joint, parameters, outliers = calibrate_robustly(
            trials, nominal.parameters, loss, fit, together=together
        )
        findings += outliers
    held_out: Mapping[str, HeldOut] = {}
    if leave_out and joint is not None:
        progress("joint parameters with blocks of time left out")
        held_out = hold_out(trials, nominal.parameters, fit)
    if joint is not None:
        trials = [replace(t, tissue=joint.tissue.get(t.name)) for t in trials]
    return JointStage(trials=tuple(trials), joint=joint, parameters=parameters, held_out=held_out, findings=findings)


def joint_parameters(
    trials: list[PreparedTrial], nominal: SubjectModel, settings: CalibrationSettings, prior: JointPrior
) -> tuple[JointCalibration | None, Parameters]:
    """The joint parameters that the settings ask for, fitted to prepared trials.

    `prior`: of anatomy, study and cohort, asked for where the evidence decides.
    """
    if not settings.jp or not trials:
        return None, nominal.parameters
    together, bounds, sides = fits_legs_together(settings), joint_bounds(settings), SIDES[settings.legs]
    taking_part = [JointTrial(t.body, t.legs if together else t.fitted, t.joint) for t in trials]
    if settings.decided_by is Protocol.EVIDENCE:
        joint = calibrate_by_evidence(taking_part, nominal.parameters, bounds, sides, prior)
    else:
        phases = (simultaneous_phases if together else sequential_phases)(
            taking_part, {side: parameters_of_gait(side, settings) for side in sides}
        )
        used = [t for t in taking_part if t.joint is None or t.joint[-1] in sides]
        soft = task_tissue({t.name: t.kind for t in used}, {t.name: t.fitted for t in used}, nominal.parameters)
        phases = [phase.with_tissue(soft) for phase in phases]
        weak = WEAK if settings.prior == "weak" else None
        how = PhaseSettings(search=bounds, prior=weak, equal_weights=True, fits_tissue=False)
        joint = calibrate_in_phases(phases, nominal.parameters, how)
        keys = [key for phase in phases for key in phase.tissue.keys]
        joint = replace(joint, tissue=soft.of_bodies({t.name: t.body for t in used}, keys))
    return joint, joint.parameters


def fits_legs_together(settings: CalibrationSettings) -> bool:
    """Whether all trials are fitted at once, by pelvis and legs."""
    return settings.decided_by is Protocol.PUBLISHED and Mode(settings.mode) is Mode.SIMULTANEOUS


def parameters_of_gait(side: str, settings: CalibrationSettings) -> tuple[str, ...]:
    """The joint parameters that gait may move in one leg."""
    return leg_parameters(side) if settings.gait_parameters == "leg" else gait_parameters(side)
