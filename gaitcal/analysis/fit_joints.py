"""Fit the joint parameters of a session, on demand under a robust loss or with held-out errors.

Robust loss: the joint parameters are fitted, every marker sample is weighted anew by its residual,
and they are fitted again. The weights of a trial come from tracking it under the loss with the
joint parameters of the round before, the first time with the nominal ones. Rounds end when the
joint parameters settle. Samples of nearly no weight in the end become a finding.

Held-out error: every trial is cut into blocks of time. Each fold leaves out every fourth block of
all trials, fits the joint parameters to the rest, and then tracks the whole trials with these. The
error is the marker distance in the blocks left out. The four folds together visit every frame once.
The motion in a block left out is fitted to the markers of the block, as for the nominal model: the
test is of the joint parameters, not of a prediction of the motion.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from gaitcal.analysis.prepared_trials import CalibrationState, MovingTrial, fits_legs_together
from gaitcal.analysis.result import HeldOut
from gaitcal.arrays import Array, BoolArray, IntArray, compute_rms
from gaitcal.calibration import joint_phases, joint_prior, soft_tissue_artefact
from gaitcal.calibration.joint_estimate import JointSettings
from gaitcal.errors import STUDY, Code, Finding, Severity, join_names
from gaitcal.io.recording import find_runs, format_spans
from gaitcal.model.anthropometry import move_limb_inertia
from gaitcal.model.linkage import LOWER_BODY
from gaitcal.model.parameters import Parameters, list_gait_parameters, list_leg_parameters
from gaitcal.runtime import Progress, silent
from gaitcal.study.settings import CalibrationSettings, Protocol
from gaitcal.study.study_trial import Role
from gaitcal.tracking.motion import Loss, RobustTracking, track_motion, track_robustly
from gaitcal.tracking.trial_problem import MotionProblem

FOLDS = 4
BLOCK_S = 0.2
"""s, length of a block: longer than the time over which soft tissue movement repeats itself."""
SETTLED = 5e-4
"""m and rad: largest change of a joint parameter from round to round at which the rounds end."""
MOST_ROUNDS = 8
NAMED_SHARE = 0.01
"""Share of a marker's samples that are outliers from which the marker is named."""
SIDES = {"both": ("r", "l"), "right": ("r",), "left": ("l",)}
"""Setting `legs` -> sides whose joints are fitted."""

JointFitter = Callable[
    [Sequence[MovingTrial]], tuple[joint_phases.JointCalibration | None, Parameters]
]
"""Fits the joint parameters of trials."""


def fit_joints(
    state: CalibrationState, progress: Progress = silent, *, compute_held_out: bool = False
) -> CalibrationState:
    """Fit the joint parameters that the settings ask for.

    The table's mass centres of the limbs move with the joints.

    Parameters
    ----------
    state : CalibrationState
        From `prepare_calibration`.
    progress : callable
        Called with a line of text at the beginning of each step.
    compute_held_out : bool
        Also compute the held-out error.

    Returns
    -------
    CalibrationState
        With the joint fit, its parameters, the soft tissue of every trial, and the findings of a
        robust loss.
    """
    settings, nominal = state.settings, state.model.parameters
    trials, findings = state.trials, state.findings
    fit = partial(fit_joint_parameters, state)
    if settings.jp and trials:
        progress("joint parameters")
    if settings.robust == "none":
        joint, parameters = fit(trials)
    else:
        trials, joint, parameters, outliers = _calibrate_robustly(
            trials, nominal, Loss(settings.robust), fit
        )
        findings += outliers
    if joint is not None:
        if compute_held_out:
            progress("joint parameters with blocks of time left out")
            errors = compute_held_out_errors(trials, nominal, fit)
            trials = tuple(replace(t, held_out=errors.get(t.name)) for t in trials)
        trials = tuple(t.with_tissue(joint.tissue.get(t.name), joint.artefact) for t in trials)
        # Limbs carry their mass centres and moments along as joints move.
        if settings.ip != "published":
            parameters = parameters.with_inertial(
                move_limb_inertia(parameters.inertial, nominal, parameters)
            )
    return replace(state, trials=trials, joint=joint, parameters=parameters, findings=findings)


def fit_joint_parameters(
    state: CalibrationState, trials: Sequence[MovingTrial]
) -> tuple[joint_phases.JointCalibration | None, Parameters]:
    """Fit the joint parameters that the settings of a session ask for to some of its trials.

    Returns: `joint` None if the settings keep the joints, or there are no trials; `parameters` the
    fitted parameters, or the nominal ones.
    """
    settings, nominal = state.settings, state.model.parameters
    if not settings.jp or not trials:
        return None, nominal
    fit_settings = JointSettings(
        position_bound=1e-3 * settings.position_bound_mm,
        orientation_bound=np.deg2rad(settings.orientation_bound_deg),
        prior=state.prior,
    )
    problems = [
        joint_phases.JointProblem(
            t.whole_body_problem,
            t.joint_fit_problem,
            t.joint,
            t.name if t.role is Role.MOTION else "",
        )
        for t in trials
    ]
    if settings.decided_by is Protocol.EVIDENCE:
        joint = joint_phases.calibrate_by_evidence(
            problems, nominal, fit_settings, SIDES[settings.legs]
        )
    else:
        joint = _fit_published_phases(problems, nominal, settings, fit_settings)
    return joint, joint.parameters


def _fit_published_phases(
    problems: Sequence[joint_phases.JointProblem],
    nominal: Parameters,
    settings: CalibrationSettings,
    fit_settings: JointSettings,
) -> joint_phases.JointCalibration:
    """Fit the joint parameters in the phases of the published protocol."""
    sides = SIDES[settings.legs]
    list_parameters = (
        list_leg_parameters if settings.gait_parameters == "leg" else list_gait_parameters
    )
    plan_phases = (
        joint_phases.plan_simultaneous_phases
        if fits_legs_together(settings)
        else joint_phases.plan_sequential_phases
    )
    phases = plan_phases(problems, {side: list_parameters(side) for side in sides})
    used = [t for t in problems if t.joint is None or t.joint[-1] in sides]
    kinds, parts = {t.name: t.kind for t in used}, {t.name: t.fitted for t in used}
    # The phases fit no soft tissue; its table gives the error bars.
    tissue = soft_tissue_artefact.prepare_task_tissue(kinds, parts, nominal, fitted=False)
    phases = [phase.with_tissue(tissue) for phase in phases]
    fit_settings = replace(
        fit_settings,
        prior=joint_prior.WEAK if settings.prior == "weak" else None,
        equal_weights=True,
        fits_tissue=False,
    )
    joint = joint_phases.calibrate_in_phases(phases, nominal, fit_settings)
    # Columns of every trial, also of those that a phase did not use.
    keys = [key for phase in phases for key in phase.tissue.keys]
    columns = tissue.make_body_columns({t.name: t.body for t in used}, keys)
    return replace(joint, tissue=columns)


def compute_held_out_errors(
    trials: Sequence[MovingTrial], nominal: Parameters, fit: JointFitter
) -> dict[str, HeldOut]:
    """Compute the held-out error of every trial by cross-validation over blocks of time.

    Returns: trial -> error; without trials that have no marker with weight.
    """
    before = {t.name: _compute_marker_distances(t.reported_problem, nominal) for t in trials}
    after = {name: np.full_like(d, np.nan) for name, d in before.items()}
    folds = {t.name: assign_folds(t) for t in trials}
    for fold in range(FOLDS):
        # A trial that lies wholly in this fold takes no part in the fit.
        kept = [t for t in trials if not (folds[t.name] == fold).all()]
        joint, parameters = fit([mask_frames(t, folds[t.name] == fold) for t in kept])
        for t in trials:
            held = folds[t.name] == fold
            # Frames of this fold, tracked with parameters that never saw them.
            if held.any():
                tissued = (
                    t if joint is None else t.with_tissue(joint.tissue.get(t.name), joint.artefact)
                )
                fitted = joint_phases.get_parameters_for_trial(joint, t.name, parameters)
                after[t.name][held] = _compute_marker_distances(tissued.reported_problem, fitted)[
                    held
                ]
    out = {}
    for t in trials:
        first, last = before[t.name], after[t.name]
        if not np.isfinite(first).any():
            continue
        lower = np.array(
            [
                t.reported_problem.chain.segments[s] in LOWER_BODY
                for s in t.reported_problem.data.segment
            ]
        )
        legs = None
        if not t.joint:
            legs = float(compute_rms(first[:, lower])), float(compute_rms(last[:, lower]))
        count = len(np.unique(folds[t.name]))
        out[t.name] = HeldOut(float(compute_rms(first)), float(compute_rms(last)), count, legs)
    return out


def assign_folds(trial: MovingTrial) -> IntArray:
    """Assign the frames of a trial to folds, block by block.

    Parameters
    ----------
    trial : MovingTrial
        The trial.

    Returns
    -------
    (nf,) array of int
        The fold that leaves out each frame. A trial with fewer blocks than folds is in fewer folds.
    """
    elapsed = trial.reported_problem.basis.time - trial.reported_problem.basis.time[0]
    block = (elapsed / BLOCK_S + 1e-9).astype(np.intp)
    folds: IntArray = (
        block % FOLDS if elapsed[-1] >= FOLDS * BLOCK_S else np.minimum(block, FOLDS - 1)
    )
    return folds


def mask_frames(trial: MovingTrial, held: BoolArray) -> MovingTrial:
    """Give frames of a trial no weight in the fit of joint parameters.

    `held`: (nf,) the frames.
    """

    def mask(problem: MotionProblem) -> MotionProblem:
        return problem.with_weight(np.where(held, 0.0, problem.data.weight))

    return replace(
        trial,
        whole_body_problem=mask(trial.whole_body_problem),
        joint_fit_problem=mask(trial.joint_fit_problem),
    )


def _compute_marker_distances(problem: MotionProblem, parameters: Parameters) -> Array:
    """Compute distances of the markers from the model after tracking.

    `parameters`: parameters of the linkage to track with. Returns: (nf, nm) m; NaN for markers
    without weight.
    """
    errors = track_motion(problem, parameters).errors
    return np.where(errors.select_observed(), errors.distance, np.nan)


def _calibrate_robustly(
    trials: Sequence[MovingTrial], nominal: Parameters, loss: Loss, fit: JointFitter
) -> tuple[
    tuple[MovingTrial, ...], joint_phases.JointCalibration | None, Parameters, tuple[Finding, ...]
]:
    """Fit joint parameters with marker weights that a robust loss gives, until both settle.

    Returns: `trials` with their last weights; `joint` the last fit; `parameters` its parameters;
    `findings` outliers of each trial, and a warning if the weights did not settle.
    """
    last: dict[str, RobustTracking] = {}

    def reweight(
        joint: joint_phases.JointCalibration | None, parameters: Parameters
    ) -> list[MovingTrial]:
        for t in trials:
            factor = last[t.name].factor if t.name in last else None
            fitted = joint_phases.get_parameters_for_trial(joint, t.name, parameters)
            last[t.name] = track_robustly(t.joint_fit_problem, fitted, loss, factor)
        return [replace(t, joint_fit_problem=last[t.name].problem) for t in trials]

    # Iteratively reweighted least squares: fit, weigh the samples by their residuals, fit again.
    joint, parameters = fit(reweight(None, nominal))
    change, count = np.inf, 1
    while joint is not None and change > SETTLED and count < MOST_ROUNDS:
        before = parameters.joint
        joint, parameters = fit(reweight(joint, parameters))
        change, count = float(np.abs(parameters.joint - before).max()), count + 1
    finished, findings = [], []
    for t in trials:
        # Each of a trial's problems gets weights by its residuals.
        body = track_robustly(t.whole_body_problem, parameters, loss)
        phase_parameters = joint_phases.get_parameters_for_trial(joint, t.name, parameters)
        fitted = (
            body if t.joint is None else track_robustly(t.reported_problem, phase_parameters, loss)
        )
        joints = (
            fitted.problem if t.joint_fit_problem is t.reported_problem else last[t.name].problem
        )
        finished.append(
            replace(
                t,
                whole_body_problem=body.problem,
                reported_problem=fitted.problem,
                joint_fit_problem=joints,
            )
        )
        findings += _report_outliers(t.name, fitted)
    if joint is not None and change > SETTLED:
        findings.append(
            Finding(
                severity=Severity.WARNING,
                topic="robust",
                where=STUDY,
                cause=f"robust weights did not settle in {MOST_ROUNDS} rounds",
                found=f"joint parameters changed by {1e3 * change:.2f} mm or "
                f"{np.rad2deg(change):.2f} deg in the last round",
                cure="look for markers with many outliers, and give them weight 0",
                code=Code.ROBUST_UNSETTLED,
            )
        )
    return tuple(finished), joint, parameters, tuple(findings)


def _report_outliers(name: str, tracking: RobustTracking) -> list[Finding]:
    """Report the outliers of a trial in one note; none if there are none."""
    problem, outliers = tracking.problem, tracking.outliers
    observed = problem.data.weight > 0
    if not outliers.any():
        return []
    often = [
        f"{label} {100 * out.sum() / max(int(used.sum()), 1):.0f} %"
        for label, out, used in zip(problem.labels, outliers, observed, strict=True)
        if out.sum() > NAMED_SHARE * used.sum()
    ]
    share = 100 * outliers.sum() / max(int(observed.sum()), 1)
    when = format_spans(problem.basis.time, find_runs(np.logical_or.reduce(outliers, axis=0)))
    names = f", most in {join_names(often)}" if often else ""
    return [
        Finding(
            severity=Severity.INFO,
            topic="robust",
            where=name,
            cause="the robust loss gave some samples nearly no weight",
            found=f"{int(outliers.sum())} marker samples ({share:.1f} %){names}, frames at {when}; "
            f"scale {1e3 * tracking.scale:.1f} mm a coordinate",
            cure="",
            code=Code.OUTLIERS,
        )
    ]
