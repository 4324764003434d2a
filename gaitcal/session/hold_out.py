"""Held-out error: how well joint parameters meet markers that had no say in them.

Every trial is cut into blocks of time. Each fold leaves out every fourth block of all trials, fits the joint parameters
to the rest, and then tracks the whole trials with these parameters; what counts is the marker error in the blocks left
out. The four folds together visit every frame once. A fit that is better only for being freer gains nothing here.

The motion in a block left out is fitted to its own markers, as it is for the nominal model: what is tested is the
joint parameters, not a guess of the motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array, BoolArray, IntArray
from gaitcal.calibration.joint_phases import parameters_for
from gaitcal.model.linkage import LOWER_BODY
from gaitcal.model.parameters import Parameters
from gaitcal.motion.motion import tracked_motion
from gaitcal.motion.trial_problem import TrialProblem
from gaitcal.session.prepare import PreparedTrial
from gaitcal.session.robust import JointFitter

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
