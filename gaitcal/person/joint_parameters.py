"""Joint parameters of a study: plain or under a robust loss, with or without the error on frames left out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

from gaitcal.calibration.joint_evidence import EvidenceTrial, calibrate_by_evidence
from gaitcal.calibration.joint_phases import (
    JointCalibration,
    JointTrial,
    calibrate_sequentially,
    calibrate_simultaneously,
)
from gaitcal.calibration.joint_prior import prior_of_study
from gaitcal.findings import Finding
from gaitcal.model.joint_parameters import gait_parameters, leg_parameters
from gaitcal.model.parameters import Parameters
from gaitcal.model.subject_model import SubjectModel
from gaitcal.motion.robust import Loss
from gaitcal.person.hold_out import HeldOut, hold_out
from gaitcal.person.prepare import PreparedTrial, joint_settings, prepare_trial
from gaitcal.person.robust import calibrate_robustly, without_exchanged_labels
from gaitcal.records import dataclass
from gaitcal.runtime import Progress
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
    by_evidence = settings.jp and settings.decided_by is Protocol.EVIDENCE
    prior = prior_of_study(settings.joint_prior, study.joint_prior)
    fit = partial(joint_parameters, nominal=nominal, settings=settings, prior=prior)
    if settings.jp and trials:
        progress("joint parameters")
    if loss is None:
        joint, parameters = fit(trials)
    else:
        together = not by_evidence and Mode(settings.mode) is Mode.SIMULTANEOUS
        trials, joint, parameters, outliers = calibrate_robustly(
            trials, nominal.parameters, loss, fit, parameters_for, together=together
        )
        findings += outliers
    held_out: Mapping[str, HeldOut] = {}
    if leave_out and joint is not None:
        progress("joint parameters with blocks of time left out")
        held_out = hold_out(trials, nominal.parameters, fit, parameters_for)
    if joint is not None:
        trials = [replace(t, tissue=joint.tissue.get(t.name)) for t in trials]
    return JointStage(trials=tuple(trials), joint=joint, parameters=parameters, held_out=held_out, findings=findings)


def joint_parameters(
    trials: list[PreparedTrial], nominal: SubjectModel, settings: CalibrationSettings, prior: JointPrior | None = None
) -> tuple[JointCalibration | None, Parameters]:
    """The joint parameters that the settings ask for, fitted to prepared trials.

    `prior`: in place of anatomy's, asked for where the evidence decides.
    """
    if not settings.jp or not trials:
        return None, nominal.parameters
    if settings.decided_by is Protocol.EVIDENCE:
        taking_part = [EvidenceTrial(t.body, t.fitted, t.joint) for t in trials]
        with_prior = replace(joint_settings(settings), prior=prior)
        by_evidence = calibrate_by_evidence(taking_part, nominal.parameters, with_prior, SIDES[settings.legs])
        return by_evidence, by_evidence.parameters
    calibrate = calibrate_sequentially if Mode(settings.mode) is Mode.SEQUENTIAL else calibrate_simultaneously
    calibration = calibrate(
        [JointTrial(t.fitted, t.legs, t.joint) for t in trials],
        nominal.parameters,
        joint_settings(settings),
        {side: parameters_of_gait(side, settings) for side in SIDES[settings.legs]},
    )
    return calibration, calibration.parameters


def parameters_of_gait(side: str, settings: CalibrationSettings) -> tuple[str, ...]:
    """The joint parameters that gait may move in one leg."""
    return leg_parameters(side) if settings.gait_parameters == "leg" else gait_parameters(side)


def parameters_for(joint: JointCalibration | None, trial: str, final: Parameters) -> Parameters:
    """The joint parameters at the end of the last phase that a trial took part in; `final` where it took part in none.

    In a sequence an isolated trial's own phase comes before gait moves the joints once more.
    """
    if joint is not None and joint.fits:
        for phase, fit in zip(reversed(joint.phases), reversed(joint.fits), strict=True):
            if trial in phase.trials:
                return fit.parameters
    return final
