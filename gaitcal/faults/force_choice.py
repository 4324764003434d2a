"""Which of the causes is told: of one trial alone, or of all trials of a session together.

A cause is named where it explains much (`EXPLAINED`), is large enough to matter (`LEAST`), and its gain is beyond
doubt (`ENOUGH`); with it go its rivals, whose gain is nearly as high. What belongs to the laboratory is common to all
trials: one cause for all of them is told where it gains more than a cause for each, every further statement costing
what the choice among so many causes costs, and where the trials that no cause is named in by themselves bear it out
without the others: what one trial has much of is not to be laid on all.

How well each cause alone explains the pelvis residual, and at which size.

    Q_c = min over x of |y_c(x)|^2,    y_c the whitened residual without a fault of size x (`force_residual.py`)
    gain_c = sum_t n_t / 2 log((Q_0t + FLOOR m_t) / (Q_ct + FLOOR m_t)) - p / 2 log sum_t n_t,     n_t = TEMPER m_t

over trials t of m_t rows, plus what the witnesses say (`force_witnesses.py`), less log(plates) for one plate alone: the
Bayesian information criterion with the scale of the noise unknown in each trial, but not below sqrt(FLOOR) of what
clean walks leave. TEMPER counts rows as half: noise is not as Gaussian as that.
A cause without a coefficient has p = 1 / 2, being one of a few.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from gaitcal.arrays import Array
from gaitcal.faults.force_causes import Cause, Corrected, Kind, causes_of
from gaitcal.faults.force_evidence import ForceEvidence, ForceResidual
from gaitcal.faults.force_witnesses import surprise

FLOOR, TEMPER = 0.20, 0.5
NO_COEFFICIENT = 0.5
STEP = {Kind.CLOCK: 0.01}
TURN_STEP = 0.03
"""s, rad: by which coefficients of causes that are not linear are scaled."""
MOST_EVALUATIONS = 25


@dataclass(frozen=True, kw_only=True)
class ForceFit:
    """One cause at the size that explains most."""

    cause: Cause
    x: Array
    """Its coefficients."""
    gain: float
    """Nats against no fault."""
    explained: float
    """Part of the disagreement, |y|^2, that is gone without the fault."""
    gains: Array
    """(trials,) part of the gain that each trial gives."""


def fits(residual: ForceResidual, only: object = None) -> tuple[float, list[ForceFit]]:
    """|y|^2 a row without any cause, and every cause with its best size (or `only` of that key), the best one first."""
    plain = _whitened(residual, None, np.zeros(0))
    before = residual.squares(plain)
    found: dict[object, ForceFit] = {}
    for cause in causes_of(residual.trials):
        if only is not None and cause.key != only:
            continue
        fit = _fit(residual, cause, plain, before)
        if cause.key not in found or fit.gain > found[cause.key].gain:
            found[cause.key] = fit
    return float(before.sum() / residual.rows.sum()), sorted(found.values(), key=lambda f: -f.gain)


def gains(before: Array, after: Array, rows: Array, parameters: float, choices: int = 1) -> Array:
    """(trials,) evidence of a cause from the sums of squares (trials,) without and with it; its cost in equal parts."""
    floor, count = FLOOR * rows, TEMPER * rows
    cost = (0.5 * parameters * np.log(count.sum()) + np.log(choices)) / len(rows)
    out: Array = 0.5 * count * np.log((before + floor) / (after + floor)) - cost
    return out


def at_size(alone: Sequence[ForceResidual], fit: ForceFit) -> ForceFit:
    """The same cause of the same size in several trials, each by itself."""
    rows = np.array([residual.rows.sum() for residual in alone])
    before, after = np.zeros(len(alone)), np.zeros(len(alone))
    for i, residual in enumerate(alone):
        before[i] = residual.squares(_whitened(residual, None, fit.x)).sum()
        after[i] = residual.squares(_whitened(residual, fit.cause, fit.x)).sum()
    return _judged(alone, fit.cause, fit.x, before, after, rows)


def _whitened(residual: ForceResidual, cause: Cause | None, x: Array) -> Array:
    """(rows,) y without a fault of size x; as measured where no cause is given."""
    undone = [(t, Corrected(t.wrenches) if cause is None else cause.undo(t, x)) for t in residual.trials]
    return residual.whitened([trial.residual(u.wrenches, u.need) for trial, u in undone])


def _judged(
    residuals: Sequence[ForceResidual], cause: Cause, x: Array, before: Array, after: Array, rows: Array
) -> ForceFit:
    """A cause of size x, from the sums of squares (trials,) without and with it."""
    cost = (cause.parameters or NO_COEFFICIENT, _choices(residuals, cause))
    witnessed = np.concatenate([_witnessed(residual, cause, x) for residual in residuals])
    of_trials = gains(before, after, rows, *cost) + witnessed
    return ForceFit(
        cause=cause,
        x=x,
        gain=float(of_trials.sum()),
        explained=float(1.0 - after.sum() / before.sum()),
        gains=of_trials,
    )


def _fit(residual: ForceResidual, cause: Cause, plain: Array, before: Array) -> ForceFit:
    def misfit(x: Array) -> Array:
        return _whitened(residual, cause, x)

    x: Array = np.zeros(0)
    if not cause.parameters:
        y = misfit(x)
    elif cause.linear:
        slopes = np.stack([misfit(e) - plain for e in np.eye(cause.parameters)], axis=1)
        x = _solved(residual, cause, plain, slopes)
        y = plain + slopes @ x
    else:
        x, y = _sought(misfit, cause)
    return _judged([residual], cause, x, before, residual.squares(y), residual.rows)


def _choices(residuals: Sequence[ForceResidual], cause: Cause) -> int:
    """Among how many plates one was chosen."""
    if not cause.plates:
        return 1
    return len({plate.name for r in residuals for trial in r.trials for plate in trial.plates})


def _solved(residual: ForceResidual, cause: Cause, plain: Array, slopes: Array) -> Array:
    """Coefficients of a linear cause, by the residual and, where they tell of it, by the witnesses."""
    if cause.witnessed:
        usual = np.concatenate([trial.usual for trial in residual.trials])
        each = [_witnesses(residual, cause, e) - usual for e in np.eye(cause.parameters)]
        slopes = np.concatenate([slopes, np.stack(each, axis=1)])
        plain = np.concatenate([plain, usual])
    return np.asarray(np.linalg.lstsq(slopes, -plain, rcond=None)[0], dtype=np.float64)


def _witnesses(residual: ForceResidual, cause: Cause, x: Array) -> Array:
    return np.concatenate([_of_trial(trial, cause, x) for trial in residual.trials])


def _of_trial(trial: ForceEvidence, cause: Cause, x: Array) -> Array:
    undone = cause.undo(trial, x)
    return trial.witnesses(undone.wrenches, np.zeros(len(trial.plates)) if undone.offsets is None else undone.offsets)


def _witnessed(residual: ForceResidual, cause: Cause, x: Array) -> Array:
    """(trials,) nats that the witnesses give to a cause."""
    out = []
    for trial in residual.trials:
        out.append(surprise(trial.usual) - surprise(_of_trial(trial, cause, x)))
    return np.array(out)


def _sought(misfit: Callable[[Array], Array], cause: Cause) -> tuple[Array, Array]:
    """Coefficients and rows at the least sum of squares, from the best of the cause's starts."""
    step = STEP.get(cause.kind, TURN_STEP)
    start = min((np.array(s) for s in cause.starts), key=lambda s: float((y := misfit(s)) @ y))
    fit = least_squares(
        lambda u: misfit(step * u), start / step, method="lm", max_nfev=MOST_EVALUATIONS * (len(start) + 1)
    )
    found: Array = step * fit.x
    return found, fit.fun


ENOUGH = 7.0
"""Nats: odds of 1000 to 1 for the cause, before one of some thirty is chosen."""
EXPLAINED = 0.10
"""Of the disagreement. Clean walks can be explained to 18 % by accident, in a single step, by gains below 5."""
EXPLAINED_FREE = 0.30
"""Where only the free moment is wrong: arms and trunk turn the body too, and their model explains so much by accident
(16 % in a walk with arms raised in its static trial)."""
EXPLAINED_LEVER = 0.25
"""Where the weight gets another lever arm (`LEVERS`) and markers come and go (`SHAKEN`): these shake the trunk. Single
frames of markers taken away at random (5, 10 and 20 % of all, three times) are so explained to 21 % in one clean walk,
by 15 nats, for mass centres are freed with the lever; in walks of 12 others by less than 5 nats. Of 31 plates 60 or
80 mm away or tilted by 3 or 4 deg that are so named with nothing missing, 29 explain as much."""
SHAKEN = 0.03
"""Share of missing samples; 1 and 2 % at random left that walk in peace, by 5 nats."""
EXPLAINED_DOUBTFUL = 0.5
"""Where markers leave open how a leg moves: what such a leg would need is so explained to 27 %. Forces in kgf, a sign
or axes that are wrong explain more."""
LEVERS = (Kind.PLACE, Kind.TILT, Kind.MARKERS_TILTED)
MARGIN, CLOSE, FAR = 0.75, 3.0, 25.0
"""A rival has 0.75 of the gain and is not more than 25 nats behind, or comes within 3 nats (odds of 20)."""
MOST_RIVALS = 3
ODD: Mapping[Kind, Kind] = {Kind.FORCE_UNIT: Kind.GAIN, Kind.MOMENT_UNIT: Kind.FREE_MOMENT}
"""A unit, and the cause of any factor that can stand for it."""
UNIT_BEHIND = 8.0
"""Nats by which a unit may be behind: an exact factor of 9.80665 or 1000 seldom comes about otherwise."""
A_CHOICE = float(np.log(30.0))
"""Nats that each statement costs."""
TRIAL_GAIN = -2.0
"""A cause common to all trials may not speak against itself in one of them by more than this."""
SHARED = 0.7
"""Of the gain of its own best cause: where a common one gives as much in every trial, it is the simpler."""
UNEXPLAINED = 4.0
"""|y|^2 a row above which a disagreement that nothing explains is told: clean recordings have 0.2 to 1.1, and up to 1.9
where no marker shows the trunk."""


def told_size(fit: ForceFit) -> np.ndarray:
    """The size in the units in which it is told: s, m, rad, N, or a factor that the file has too much."""
    if fit.cause.kind in FACTORS:
        return 1.0 / (1.0 + fit.x)
    return fit.x


FACTORS = (
    Kind.GAIN,
    Kind.VERTICAL_GAIN,
    Kind.HORIZONTAL_GAIN,
    Kind.FORE_AFT_GAIN,
    Kind.SIDEWAYS_GAIN,
    Kind.FREE_MOMENT,
)
LEAST: Mapping[Kind, float] = {
    Kind.CLOCK: 0.018,
    Kind.PLACE: 0.015,
    Kind.YAW: float(np.deg2rad(4.0)),
    Kind.TILT: float(np.deg2rad(1.5)),
    Kind.MARKERS_TILTED: float(np.deg2rad(1.5)),
    Kind.GAIN: 0.05,
    Kind.VERTICAL_GAIN: 0.05,
    Kind.HORIZONTAL_GAIN: 0.15,
    Kind.FORE_AFT_GAIN: 0.15,
    Kind.SIDEWAYS_GAIN: 0.25,
    Kind.FREE_MOMENT: 0.5,
    Kind.OFFSET: 15.0,
    Kind.TRUNK: 0.05,
}
"""Sizes that are worth telling; of factors by how much 1 + x differs from 1: s, m, rad, N."""
MOST: Mapping[Kind, tuple[float, float]] = {
    Kind.CLOCK: (-0.35, 0.35),
    Kind.PLACE: (-1.5, 1.5),
    Kind.TILT: (-0.35, 0.35),
    Kind.MARKERS_TILTED: (-0.35, 0.35),
    Kind.GAIN: (-0.95, 30.0),
    Kind.VERTICAL_GAIN: (-0.95, 30.0),
    Kind.HORIZONTAL_GAIN: (-0.9, 9.0),
    Kind.FORE_AFT_GAIN: (-0.9, 9.0),
    Kind.SIDEWAYS_GAIN: (-0.9, 9.0),
    Kind.FREE_MOMENT: (-2.5, 299.0),
    Kind.OFFSET: (-300.0, 300.0),
    Kind.TRUNK: (-0.15, 0.15),
}
"""Coefficients beyond which a cause is no explanation."""


@dataclass(frozen=True, kw_only=True)
class Named:
    """The causes that explain some trials: one, or several that evidence cannot part."""

    trials: tuple[ForceEvidence, ...]
    """That the fault is in."""
    fits: tuple[ForceFit, ...]
    """The best one first."""


@dataclass(frozen=True, kw_only=True)
class Unexplained:
    """A trial whose motion and forces disagree, and no single cause says why."""

    trial: ForceEvidence
    size: float
    """|y|^2 a row: 1 is usual."""


def choose(trials: Sequence[ForceEvidence]) -> tuple[list[Named], list[Unexplained]]:
    """What is wrong with the forces of the trials of one session."""
    alone: list[Named] = []
    left: list[Unexplained] = []
    residuals = [ForceResidual([trial]) for trial in trials]
    for trial, residual in zip(trials, residuals, strict=True):
        size, found = fits(residual)
        if best := named(found, _shaken([trial]), trial.doubtful):
            alone.append(Named(trials=(trial,), fits=best))
        elif size > UNEXPLAINED and not trial.doubtful:
            left.append(Unexplained(trial=trial, size=size))
    together = _together(residuals) if len(trials) > 1 else None
    if together is None:
        return alone, left
    first = together.fits[0]
    convicted = {one.trials[0].name for one in alone}
    if alone and not _borne_out([r for r in residuals if r.trials[0].name not in convicted], first):
        return alone, left
    share = {trial.name: gain for trial, gain in zip(trials, first.gains, strict=True)}
    as_good = all(share[one.trials[0].name] > SHARED * one.fits[0].gain for one in alone)
    separately = sum(one.fits[0].gain - A_CHOICE for one in alone)
    if as_good or first.gain - A_CHOICE > separately:
        return [together], []
    return alone, left


def _borne_out(rest: Sequence[ForceResidual], common: ForceFit) -> bool:
    """Whether trials that are not convicted by themselves have the same fault without the others, large enough to tell.

    Beside one walk whose forces come 25 ms late, four that are 14 ms late by themselves, as clean walks may be, gain
    6 nats each by 20 ms.
    """
    if not rest:
        return True
    _, found = fits(ForceResidual([trial for residual in rest for trial in residual.trials]), common.cause.key)
    fit = at_size(rest, found[0])
    trials = [trial for residual in rest for trial in residual.trials]
    return fit.gain > A_CHOICE and _worth_telling(fit, _shaken(trials), _doubtful(trials))


def _together(alone: Sequence[ForceResidual]) -> Named | None:
    """A cause that all trials share, its size sought in all of them and its gain summed over each by itself.

    Marginalised together, the inertial errors would carry a fault of one trial into all others.
    """
    trials = tuple(trial for residual in alone for trial in residual.trials)
    _, found = fits(ForceResidual(trials))
    common = [at_size(alone, fit) for fit in found if fit.gain > 0.0]
    kept = sorted((fit for fit in common if (fit.gains > TRIAL_GAIN).all()), key=lambda fit: -fit.gain)
    best = named(kept, _shaken(trials), _doubtful(trials))
    return Named(trials=trials, fits=best) if best else None


def named(found: Sequence[ForceFit], shaken: bool = False, doubtful: bool = False) -> tuple[ForceFit, ...]:
    """The cause that is told, and its rivals; none where no cause is beyond doubt. `found`: the best one first."""
    telling = [fit for fit in found if _worth_telling(fit, shaken, doubtful)]
    if not telling or telling[0].gain < ENOUGH:
        return ()
    best = telling[0].gain
    least = min(max(0.5 * ENOUGH, MARGIN * best, best - FAR), best - CLOSE)
    return _units_first([fit for fit in telling if fit.gain >= least])[: 1 + MOST_RIVALS]


def _units_first(named: list[ForceFit]) -> tuple[ForceFit, ...]:
    """A unit that explains as much as an odd factor of all plates is what is meant, and the factor is not told."""
    units = {fit.cause.kind: fit.gain for fit in named if fit.cause.kind in ODD}
    if not units or max(units.values()) < named[0].gain - UNIT_BEHIND:
        return tuple(named)
    best = max(units, key=lambda kind: units[kind])
    left = [fit for fit in named if fit.cause.kind is not ODD[best]]
    return tuple(sorted(left, key=lambda fit: fit.cause.kind is not best))


def _shaken(trials: Sequence[ForceEvidence]) -> bool:
    """Whether markers come and go in any of them."""
    return any(trial.missing > SHAKEN for trial in trials)


def _doubtful(trials: Sequence[ForceEvidence]) -> bool:
    """Whether the motion of a leg is in doubt in any of them."""
    return any(trial.doubtful for trial in trials)


def _least_explained(kind: Kind, shaken: bool, doubtful: bool) -> float:
    if doubtful:
        return EXPLAINED_DOUBTFUL
    if kind is Kind.FREE_MOMENT:
        return EXPLAINED_FREE
    return EXPLAINED_LEVER if shaken and kind in LEVERS else EXPLAINED


def _worth_telling(fit: ForceFit, shaken: bool, doubtful: bool) -> bool:
    kind = fit.cause.kind
    if fit.explained < _least_explained(kind, shaken, doubtful):
        return False
    low, high = MOST.get(kind, (-np.inf, np.inf))
    if len(fit.x) and not (low <= fit.x.min() and fit.x.max() <= high):
        return False
    size = told_size(fit) - 1.0 if kind in FACTORS and kind is not Kind.FREE_MOMENT else fit.x
    return not len(fit.x) or float(np.linalg.norm(size)) >= LEAST[kind]
