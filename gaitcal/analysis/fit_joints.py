"""Joint parameters of a session: plain or under a robust loss, with or without the error on frames
left out.

Robust loss: calibrate, weigh every marker sample anew by its residual, calibrate again. The weights
of a trial come from tracking it under the loss with the joint parameters of the round before, the
first time with the nominal ones; rounds end when the joint parameters settle. What is all but left
out in the end becomes a finding.

Held-out error: every trial is cut into blocks of time. Each fold leaves out every fourth block of
all trials, fits the joint parameters to the rest, and then tracks the whole trials with these; what
counts is the marker error in the blocks left out. The four folds together visit every frame once.
The motion in a block left out is fitted to its own markers, as for the nominal model: what is
tested is the joint parameters, not a guess of the motion.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from gaitcal.analysis.prepared_trials import CalibrationState, MovingTrial, fits_legs_together
from gaitcal.analysis.result import HeldOut
from gaitcal.arrays import Array, BoolArray, IntArray
from gaitcal.calibration import joint_calibration, joint_phases, joint_prior, soft_tissue_artefact
from gaitcal.errors import STUDY, Code, Finding, Severity, listed
from gaitcal.io.recording import find_runs, format_spans
from gaitcal.model.anthropometry import move_limb_inertia
from gaitcal.model.linkage import LOWER_BODY
from gaitcal.model.parameters import Parameters, list_gait_parameters, list_leg_parameters
from gaitcal.runtime import Progress, silent
from gaitcal.study.settings import Protocol
from gaitcal.study.study_trial import Role
from gaitcal.tracking.motion import Loss, RobustTracking, track_motion, track_robustly
from gaitcal.tracking.trial_problem import MotionProblem

FOLDS = 4
BLOCK_S = 0.2
"""s, of a block: longer than skin movement repeats itself."""
SETTLED = 5e-4
"""m and rad: largest change of a joint parameter from round to round at which the rounds end."""
MOST_ROUNDS = 8
NAMED_SHARE = 0.01
"""Share of a marker's samples left out from which it is named."""
SIDES = {"both": ("r", "l"), "right": ("r",), "left": ("l",)}

JointFitter = Callable[
    [Sequence[MovingTrial]], tuple[joint_phases.JointCalibration | None, Parameters]
]
"""Calibrates the joint parameters of trials."""


def fit_joints(
    session: CalibrationState, progress: Progress = silent, *, leave_out: bool = False
) -> CalibrationState:
    """The session with the joint parameters that its settings ask for, the table's mass centres
    going with its joints.

    `leave_out`: with the held-out error too.
    """
    settings, nominal, trials, findings = (
        session.settings,
        session.model.parameters,
        session.trials,
        session.findings,
    )
    fit = partial(joint_parameters, session)
    if settings.jp and trials:
        progress("joint parameters")
    if settings.robust == "none":
        joint, parameters = fit(trials)
    else:
        trials, joint, parameters, outliers = calibrate_robustly(
            trials, nominal, Loss(settings.robust), fit
        )
        findings += outliers
    if joint is not None:
        if leave_out:
            progress("joint parameters with blocks of time left out")
            errors = hold_out(trials, nominal, fit)
            trials = tuple(replace(t, held_out=errors.get(t.name)) for t in trials)
        trials = tuple(t.with_tissue(joint.tissue.get(t.name), joint.artefact) for t in trials)
        if settings.ip != "published":
            parameters = parameters.with_inertial(
                move_limb_inertia(parameters.inertial, nominal, parameters)
            )
    return replace(session, trials=trials, joint=joint, parameters=parameters, findings=findings)


def joint_parameters(
    session: CalibrationState, trials: Sequence[MovingTrial]
) -> tuple[joint_phases.JointCalibration | None, Parameters]:
    """The joint parameters that the settings of a session ask for, fitted to some of its trials."""
    settings, nominal = session.settings, session.model.parameters
    if not settings.jp or not trials:
        return None, nominal
    bounds = joint_calibration.JointSettings(
        position_bound=1e-3 * settings.position_bound_mm,
        orientation_bound=np.deg2rad(settings.orientation_bound_deg),
    )
    sides = SIDES[settings.legs]
    taking_part = [
        joint_phases.JointProblem(
            t.body, t.joints, t.joint, t.name if t.role is Role.MOTION else ""
        )
        for t in trials
    ]
    if settings.decided_by is Protocol.EVIDENCE:
        joint = joint_phases.calibrate_by_evidence(
            taking_part, nominal, bounds, sides, session.prior
        )
        return joint, joint.parameters
    of_gait = list_leg_parameters if settings.gait_parameters == "leg" else list_gait_parameters
    phases_of = (
        joint_phases.plan_simultaneous_phases
        if fits_legs_together(settings)
        else joint_phases.plan_sequential_phases
    )
    phases = phases_of(taking_part, {side: of_gait(side) for side in sides})
    used = [t for t in taking_part if t.joint is None or t.joint[-1] in sides]
    kinds, parts = {t.name: t.kind for t in used}, {t.name: t.fitted for t in used}
    soft = soft_tissue_artefact.prepare_task_tissue(kinds, parts, nominal, fitted=False)
    phases = [phase.with_tissue(soft) for phase in phases]
    weak = joint_prior.WEAK if settings.prior == "weak" else None
    how = joint_phases.PhaseSettings(
        search=bounds, prior=weak, equal_weights=True, fits_tissue=False
    )
    joint = joint_phases.calibrate_in_phases(phases, nominal, how)
    keys = [key for phase in phases for key in phase.tissue.keys]
    joint = replace(joint, tissue=soft.make_body_columns({t.name: t.body for t in used}, keys))
    return joint, joint.parameters


def hold_out(
    trials: Sequence[MovingTrial], nominal: Parameters, fit: JointFitter
) -> dict[str, HeldOut]:
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
                moved = (
                    t if joint is None else t.with_tissue(joint.tissue.get(t.name), joint.artefact)
                )
                fitted = joint_phases.get_parameters_for_trial(joint, t.name, parameters)
                after[t.name][held] = distances(moved.fitted, fitted)[held]
    out = {}
    for t in (t for t in trials if np.isfinite(before[t.name]).any()):
        both = before[t.name], after[t.name]
        lower = np.array([t.fitted.chain.segments[s] in LOWER_BODY for s in t.fitted.data.segment])
        legs = None if t.joint else (_rms(both[0][:, lower]), _rms(both[1][:, lower]))
        out[t.name] = HeldOut(_rms(both[0]), _rms(both[1]), len(np.unique(blocks[t.name])), legs)
    return out


def fold_of_frame(trial: MovingTrial) -> IntArray:
    """(nf,) the fold that leaves out each frame; a trial of fewer blocks than folds is left out
    less often.
    """
    since = trial.fitted.basis.time - trial.fitted.basis.time[0]
    block = (since / BLOCK_S + 1e-9).astype(np.intp)
    folds: IntArray = (
        block % FOLDS if since[-1] >= FOLDS * BLOCK_S else np.minimum(block, FOLDS - 1)
    )
    return folds


def without(trial: MovingTrial, held: BoolArray) -> MovingTrial:
    """The trial with no weight on the frames `held` (nf,) of what joint parameters are fitted by."""

    def masked(problem: MotionProblem) -> MotionProblem:
        return problem.with_weight(np.where(held, 0.0, problem.data.weight))

    return replace(trial, body=masked(trial.body), joints=masked(trial.joints))


def distances(problem: MotionProblem, parameters: Parameters) -> Array:
    """(nf, nm) m, distances of the markers with weight from the model tracked with `parameters`;
    NaN elsewhere.
    """
    errors = track_motion(problem, parameters).errors
    return np.where(errors.select_observed(), errors.distance, np.nan)


def _rms(distance: Array) -> float:
    return float(np.sqrt(np.nanmean(distance**2)))


def calibrate_robustly(
    trials: Sequence[MovingTrial], nominal: Parameters, loss: Loss, fit: JointFitter
) -> tuple[
    tuple[MovingTrial, ...], joint_phases.JointCalibration | None, Parameters, tuple[Finding, ...]
]:
    """Trials with their last weights, the joint parameters fitted with them, and what was left out."""
    last: dict[str, RobustTracking] = {}

    def weigh(
        joint: joint_phases.JointCalibration | None, parameters: Parameters
    ) -> list[MovingTrial]:
        for t in trials:
            factor = last[t.name].factor if t.name in last else None
            last[t.name] = track_robustly(
                t.joints,
                joint_phases.get_parameters_for_trial(joint, t.name, parameters),
                loss,
                factor,
            )
        return [replace(t, joints=last[t.name].problem) for t in trials]

    joint, parameters = fit(weigh(None, nominal))
    change, count = np.inf, 1
    while joint is not None and change > SETTLED and count < MOST_ROUNDS:
        before = parameters.joint
        joint, parameters = fit(weigh(joint, parameters))
        change, count = float(np.abs(parameters.joint - before).max()), count + 1
    finished, findings = [], []
    for t in trials:
        body = track_robustly(t.body, parameters, loss)
        own = joint_phases.get_parameters_for_trial(joint, t.name, parameters)
        fitted = body if t.joint is None else track_robustly(t.fitted, own, loss)
        joints = fitted.problem if t.joints is t.fitted else last[t.name].problem
        finished.append(replace(t, body=body.problem, fitted=fitted.problem, joints=joints))
        findings += _outliers_of(t.name, fitted)
    if joint is not None and change > SETTLED:
        findings.append(
            Finding(
                severity=Severity.WARNING,
                topic="robust",
                where=STUDY,
                cause=f"robust weights did not settle in {MOST_ROUNDS} rounds",
                found=f"joint parameters still moved by {1e3 * change:.2f} mm or "
                f"{np.rad2deg(change):.2f} deg",
                cure="look for markers that are often left out, and give them weight 0",
                code=Code.ROBUST_UNSETTLED,
            )
        )
    return tuple(finished), joint, parameters, tuple(findings)


def _outliers_of(name: str, tracking: RobustTracking) -> list[Finding]:
    """Outliers of a trial in one note; none where there are none."""
    problem, outliers = tracking.problem, tracking.outliers
    seen = problem.data.weight > 0
    if not outliers.any():
        return []
    often = [
        f"{label} {100 * out.sum() / max(int(used.sum()), 1):.0f} %"
        for label, out, used in zip(problem.labels, outliers, seen, strict=True)
        if out.sum() > NAMED_SHARE * used.sum()
    ]
    share = 100 * outliers.sum() / max(int(seen.sum()), 1)
    where = format_spans(problem.basis.time, find_runs(np.logical_or.reduce(outliers, axis=0)))
    names = f", most in {listed(often)}" if often else ""
    found = f"{int(outliers.sum())} marker samples ({share:.1f} %){names}, frames at {where}; "
    found += f"scale {1e3 * tracking.scale:.1f} mm a coordinate"
    cause = "the robust loss all but left out some samples"
    return [
        Finding(
            severity=Severity.INFO,
            topic="robust",
            where=name,
            cause=cause,
            found=found,
            cure="",
            code=Code.OUTLIERS,
        )
    ]
