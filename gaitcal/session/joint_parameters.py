"""Joint parameters of a study: plain or under a robust loss, with or without the error on frames left out.

Held-out error: how well joint parameters meet markers that had no say in them.

Every trial is cut into blocks of time. Each fold leaves out every fourth block of all trials, fits the joint parameters
to the rest, and then tracks the whole trials with these parameters; what counts is the marker error in the blocks left
out. The four folds together visit every frame once. A fit that is better only for being freer gains nothing here.

The motion in a block left out is fitted to its own markers, as it is for the nominal model: what is tested is the
joint parameters, not a guess of the motion.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from gaitcal.arrays import Array, BoolArray, IntArray
from gaitcal.calibration.joint_phases import (
    JointCalibration,
    JointTrial,
    PhaseSettings,
    calibrate_by_evidence,
    calibrate_in_phases,
    parameters_for,
    sequential_phases,
    simultaneous_phases,
)
from gaitcal.calibration.joint_prior import WEAK, prior_of_study
from gaitcal.calibration.soft_tissue_artefact import task_tissue
from gaitcal.findings import Finding
from gaitcal.model.linkage import LOWER_BODY
from gaitcal.model.parameters import Parameters, gait_parameters, leg_parameters
from gaitcal.model.subject_model import SubjectModel
from gaitcal.motion.motion import tracked_motion
from gaitcal.motion.robust import Loss
from gaitcal.motion.trial_problem import TrialProblem
from gaitcal.runtime import Progress
from gaitcal.session.prepare import PreparedTrial, joint_bounds, prepare_trial
from gaitcal.session.robust import JointFitter, calibrate_robustly, without_exchanged_labels
from gaitcal.study.joint_prior import JointPrior
from gaitcal.study.settings import CalibrationSettings, Mode, Protocol
from gaitcal.study.study import Study

FOLDS = 4
BLOCK_S = 0.2
"""s, of a block: longer than skin movement repeats itself."""


@dataclass(frozen=True)
class HeldOut:
    """Marker error of one trial over frames that did not take part in the fit."""

    nominal: float
    """m, RMS over the same frames with the nominal joint parameters."""
    calibrated: float
    """m, with joint parameters fitted without them."""
    folds: int
    legs: tuple[float, float] | None = None
    """m, nominal and calibrated over the markers of pelvis and legs; None for an isolated trial."""


def hold_out(trials: Sequence[PreparedTrial], nominal: Parameters, fit: JointFitter) -> dict[str, HeldOut]:
    """Held-out error of every trial; `fit` calibrates the joint parameters of trials."""
    before = {t.name: distances(t.fitted, nominal) for t in trials}
    after = {name: np.full_like(d, np.nan) for name, d in before.items()}
    blocks = {t.name: fold_of_frame(t) for t in trials}
    for fold in range(FOLDS):
        kept = [t for t in trials if not (blocks[t.name] == fold).all()]
        joint, parameters = fit([without(t, blocks[t.name] == fold) for t in kept])
        for t in trials:
            held = blocks[t.name] == fold
            if held.any():
                after[t.name][held] = distances(t.fitted, parameters_for(joint, t.name, parameters))[held]
    return {
        t.name: _held_out(t, before[t.name], after[t.name], len(np.unique(blocks[t.name])))
        for t in trials
        if np.isfinite(before[t.name]).any()
    }


def _held_out(trial: PreparedTrial, before: Array, after: Array, folds: int) -> HeldOut:
    problem = trial.fitted
    lower = np.array([problem.chain.segments[s] in LOWER_BODY for s in problem.data.segment])
    legs = None if trial.joint else (_rms(before[:, lower]), _rms(after[:, lower]))
    return HeldOut(_rms(before), _rms(after), folds, legs)


def fold_of_frame(trial: PreparedTrial) -> IntArray:
    """(nf,) the fold that leaves out each frame; a trial of fewer blocks than folds is left out less often."""
    since = trial.fitted.basis.time - trial.fitted.basis.time[0]
    block = (since / BLOCK_S + 1e-9).astype(np.intp)
    folds: IntArray = block % FOLDS if since[-1] >= FOLDS * BLOCK_S else np.minimum(block, FOLDS - 1)
    return folds


def without(trial: PreparedTrial, held: BoolArray) -> PreparedTrial:
    """The trial with no weight on the frames `held` (nf,)."""

    def masked(problem: TrialProblem) -> TrialProblem:
        return problem.with_weight(np.where(held, 0.0, problem.data.weight))

    return trial.with_problems(masked(trial.body), masked(trial.fitted), masked(trial.legs))


def distances(problem: TrialProblem, parameters: Parameters) -> Array:
    """(nf, nm) m, distances of the markers with weight from the model tracked with `parameters`; NaN elsewhere."""
    errors = tracked_motion(problem, parameters).errors
    return np.where(errors.kept(), errors.distance, np.nan)


def _rms(distance: Array) -> float:
    return float(np.sqrt(np.nanmean(distance**2)))


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
