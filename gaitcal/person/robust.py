"""A calibration under a robust loss: calibrate, weigh every marker sample anew by its residual, calibrate again.

The weights of a trial come from tracking it under the loss with the joint parameters of the round before, the first
time with the nominal ones; rounds end when the joint parameters settle. What then was all but left out is told.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from gaitcal.calibration.joint_phases import JointCalibration
from gaitcal.checks.finding import listed
from gaitcal.model.parameters import Parameters
from gaitcal.motion.robust import Loss, RobustTracking, robust_tracking
from gaitcal.motion.trial_problem import TrialProblem
from gaitcal.person.prepare import PreparedTrial
from gaitcal.recording.intervals import runs, spans

SETTLED = 5e-4
"""m and rad: largest change of a joint parameter from round to round at which the rounds end."""
MOST_ROUNDS = 8
TOLD = 0.01
"""Share of a marker's samples left out from which it is named."""

Fit = Callable[[list[PreparedTrial]], tuple[JointCalibration | None, Parameters]]
ParametersOf = Callable[[JointCalibration | None, str, Parameters], Parameters]


@dataclass(frozen=True)
class WeighedTrial(PreparedTrial):
    """A prepared trial whose problems carry the weights of a robust loss."""

    own_fitted: TrialProblem
    own_legs: TrialProblem

    @property
    def fitted(self) -> TrialProblem:
        """As in `PreparedTrial`, weighed."""
        return self.own_fitted

    @property
    def legs(self) -> TrialProblem:
        """As in `PreparedTrial`, weighed."""
        return self.own_legs


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
        return _weighed(t, t.body, fitted, legs)

    def finish(self, parameters: Parameters, own: Parameters) -> tuple[PreparedTrial, tuple[str, ...]]:
        """The trial with all its parts weighed, for tracking with the joint parameters found; and what was left out."""
        t = self.trial
        body = robust_tracking(t.body, parameters, self.loss)
        fitted = body if t.joint is None else robust_tracking(t.fitted, own, self.loss)
        legs = t.legs if self.last is None or not self.together else self.last.problem
        return _weighed(t, body.problem, fitted.problem, legs), _told(t.name, fitted)


def _weighed(t: PreparedTrial, body: TrialProblem, fitted: TrialProblem, legs: TrialProblem) -> PreparedTrial:
    return WeighedTrial(t.trial, t.recording, t.model, t.rule, body, fitted, legs)


def calibrate_robustly(
    trials: Sequence[PreparedTrial],
    nominal: Parameters,
    loss: Loss,
    fit: Fit,
    parameters_of: ParametersOf,
    *,
    together: bool,
) -> tuple[list[PreparedTrial], JointCalibration | None, Parameters, tuple[str, ...]]:
    """Trials with their last weights, the joint parameters fitted with them, and warnings.

    `fit` calibrates the joint parameters of weighed trials; `parameters_of` gives those at which a trial was fitted;
    `together` tells whether all trials are fitted at once, by pelvis and legs.
    """
    rounds = [_Rounds(t, loss, together=together) for t in trials]
    joint, parameters = fit([r.weigh(nominal) for r in rounds])
    change, count = np.inf, 1
    while joint is not None and change > SETTLED and count < MOST_ROUNDS:
        before = parameters.joint
        present = [r.weigh(parameters_of(joint, r.trial.name, parameters)) for r in rounds]
        joint, parameters = fit(present)
        change, count = float(np.abs(parameters.joint - before).max()), count + 1
    done = [r.finish(parameters, parameters_of(joint, r.trial.name, parameters)) for r in rounds]
    told = [text for _, texts in done for text in texts]
    if joint is not None and change > SETTLED:
        told.append(
            f"robust weights did not settle in {MOST_ROUNDS} rounds: joint parameters still moved by "
            f"{1e3 * change:.2f} mm or {np.rad2deg(change):.2f} deg"
        )
    return [trial for trial, _ in done], joint, parameters, tuple(told)


def _told(name: str, tracking: RobustTracking) -> tuple[str, ...]:
    """Outliers of a trial in words."""
    problem, outliers = tracking.problem, tracking.outliers
    seen = problem.data.weight > 0
    if not outliers.any():
        return ()
    often = [
        f"{label} {100 * out.sum() / max(int(used.sum()), 1):.0f} %"
        for label, out, used in zip(problem.labels, outliers, seen, strict=True)
        if out.sum() > TOLD * used.sum()
    ]
    share = 100 * outliers.sum() / max(int(seen.sum()), 1)
    where = spans(problem.basis.time, runs(np.logical_or.reduce(outliers, axis=0)))
    names = f", most in {listed(often)}" if often else ""
    return (
        f"{name}: robust loss all but left out {int(outliers.sum())} marker samples ({share:.1f} %){names}, frames at "
        f"{where}; scale {1e3 * tracking.scale:.1f} mm a coordinate",
    )
