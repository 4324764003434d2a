"""A calibration under a robust loss: calibrate, weigh every marker sample anew by its residual, calibrate again.

The weights of a trial come from tracking it under the loss with the joint parameters of the round before, the first
time with the nominal ones; rounds end when the joint parameters settle. What is all but left out in the end is told.

Labels that jumped onto each other are put right before anything is fitted. A loss alone cannot do it: three markers of
a segment of which two are exchanged are a mirror image, and least squares turns the segment round. The jump itself
betrays them (`faults/exchanged.py`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from gaitcal.calibration.joint_phases import JointCalibration, parameters_for
from gaitcal.codes import Code
from gaitcal.faults.evidence import TrialEvidence
from gaitcal.faults.exchanged import exchanged_back
from gaitcal.findings import STUDY, Finding, Severity, listed
from gaitcal.io.intervals import runs, spans
from gaitcal.model.parameters import Parameters
from gaitcal.model.subject_model import SubjectModel
from gaitcal.motion.robust import Loss, RobustTracking, robust_tracking
from gaitcal.session.prepare import PreparedTrial
from gaitcal.study.study import Study
from gaitcal.study.study_trial import Role

SETTLED = 5e-4
"""m and rad: largest change of a joint parameter from round to round at which the rounds end."""
MOST_ROUNDS = 8
NAMED_SHARE = 0.01
"""Share of a marker's samples left out from which it is named."""

JointFitter = Callable[[list[PreparedTrial]], tuple[JointCalibration | None, Parameters]]
"""Calibrates the joint parameters of trials."""


def without_exchanged_labels(study: Study, model: SubjectModel) -> tuple[Study, tuple[Finding, ...]]:
    """The study with exchanged labels exchanged back in its moving trials, and what was done."""
    marker_set = study.marker_set.with_weights(study.weights)
    trials, done = [], []
    for trial in study.trials:
        if trial.role is not Role.STATIC:
            evidence = TrialEvidence(
                trial=trial, marker_set=marker_set, subject=study.subject, settings=study.settings, model=model
            )
            recording, found = exchanged_back(evidence)
            trial = replace(trial, recording=recording)
            done += found
        trials.append(trial)
    return replace(study, trials=tuple(trials)), tuple(done)


class _Rounds:
    """Robust weights of one trial, from round to round."""

    def __init__(self, trial: PreparedTrial, loss: Loss, *, together: bool) -> None:
        self.trial, self.loss, self.together = trial, loss, together
        self.last: RobustTracking | None = None

    def weigh(self, parameters: Parameters) -> PreparedTrial:
        """The trial for the next calibration: what it fits, weighed by tracking it with `parameters`."""
        t = self.trial
        used = t.legs if self.together else t.fitted
        self.last = robust_tracking(used, parameters, self.loss, self.last.factor if self.last else None)
        fitted, legs = (t.fitted, self.last.problem) if self.together else (self.last.problem, t.legs)
        return t.with_problems(t.body, fitted, legs)

    def finish(self, final: Parameters, fitted_with: Parameters) -> tuple[PreparedTrial, tuple[Finding, ...]]:
        """The trial with all its parts weighed, for tracking with the joint parameters found; and what was left out."""
        t = self.trial
        body = robust_tracking(t.body, final, self.loss)
        fitted = body if t.joint is None else robust_tracking(t.fitted, fitted_with, self.loss)
        legs = t.legs if self.last is None or not self.together else self.last.problem
        return t.with_problems(body.problem, fitted.problem, legs), _outliers_told(t.name, fitted)


def calibrate_robustly(
    trials: Sequence[PreparedTrial], nominal: Parameters, loss: Loss, fit: JointFitter, *, together: bool
) -> tuple[list[PreparedTrial], JointCalibration | None, Parameters, tuple[Finding, ...]]:
    """Trials with their last weights, the joint parameters fitted with them, and what was left out.

    `together` tells whether all trials are fitted at once, by pelvis and legs.
    """
    rounds = [_Rounds(t, loss, together=together) for t in trials]
    joint, parameters = fit([r.weigh(nominal) for r in rounds])
    change, count = np.inf, 1
    while joint is not None and change > SETTLED and count < MOST_ROUNDS:
        before = parameters.joint
        present = [r.weigh(parameters_for(joint, r.trial.name, parameters)) for r in rounds]
        joint, parameters = fit(present)
        change, count = float(np.abs(parameters.joint - before).max()), count + 1
    finished = [r.finish(parameters, parameters_for(joint, r.trial.name, parameters)) for r in rounds]
    findings = [finding for _, outliers in finished for finding in outliers]
    if joint is not None and change > SETTLED:
        findings.append(
            Finding(
                severity=Severity.WARNING,
                topic="robust",
                where=STUDY,
                cause=f"robust weights did not settle in {MOST_ROUNDS} rounds",
                found=f"joint parameters still moved by {1e3 * change:.2f} mm or {np.rad2deg(change):.2f} deg",
                cure="look for markers that are often left out, and give them weight 0",
                code=Code.ROBUST_UNSETTLED,
            )
        )
    return [trial for trial, _ in finished], joint, parameters, tuple(findings)


def _outliers_told(name: str, tracking: RobustTracking) -> tuple[Finding, ...]:
    """Outliers of a trial in one note; none where there are none."""
    problem, outliers = tracking.problem, tracking.outliers
    seen = problem.data.weight > 0
    if not outliers.any():
        return ()
    often = [
        f"{label} {100 * out.sum() / max(int(used.sum()), 1):.0f} %"
        for label, out, used in zip(problem.labels, outliers, seen, strict=True)
        if out.sum() > NAMED_SHARE * used.sum()
    ]
    share = 100 * outliers.sum() / max(int(seen.sum()), 1)
    where = spans(problem.basis.time, runs(np.logical_or.reduce(outliers, axis=0)))
    names = f", most in {listed(often)}" if often else ""
    found = f"{int(outliers.sum())} marker samples ({share:.1f} %){names}, frames at {where}; "
    found += f"scale {1e3 * tracking.scale:.1f} mm a coordinate"
    cause = "the robust loss all but left out some samples"
    return (
        Finding(
            severity=Severity.INFO, topic="robust", where=name, cause=cause, found=found, cure="", code=Code.OUTLIERS
        ),
    )
