"""Which of the causes is told: of one trial alone, or of all trials of a session together.

A cause is named where it explains much (`EXPLAINED`), is large enough to matter (`SIZES`), and its
gain is beyond doubt (`LEAST_GAIN`); with it go its rivals, whose gain is nearly as high. What
belongs to the laboratory is common to all trials: one cause for all of them is told where it gains
more than a cause for each, every further statement costing what the choice among so many causes
costs, and where the trials that no cause is named in by themselves bear it out without the others:
what one trial has much of is not to be laid on all.

How well each cause alone explains the pelvis residual, and at which size.

    Q_c = min over x of |y_c(x)|^2,    y_c the whitened residual without a fault of size x (`force_evidence.py`)
    gain_c = sum_t n_t / 2 log((Q_0t + FLOOR m_t) / (Q_ct + FLOOR m_t)) - p / 2 log sum_t n_t,     n_t = TEMPER m_t

over trials t of m_t rows, plus what side evidence says (`plate_forces.py`), less log(plates) for
one plate alone: the Bayesian information criterion with the scale of the noise unknown in each
trial, but not below sqrt(FLOOR) of what clean walks leave. TEMPER counts rows as half: noise is not
as Gaussian as that. A cause without a coefficient has p = 1 / 2, being one of a few.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.special import softmax

from gaitcal.arrays import Array
from gaitcal.dynamics.measurement_errors import PlateErrors
from gaitcal.quality.force_causes import Cause, Corrected, ForceFault, causes_of
from gaitcal.quality.force_evidence import ForceEvidence, ForceResidual
from gaitcal.quality.plate_forces import surprise

FLOOR, TEMPER = 0.20, 0.5
NO_COEFFICIENT = 0.5
STEP = {ForceFault.CLOCK: 0.01}
TURN_STEP = 0.03  # s, rad: by which coefficients of causes that are not linear are scaled
MOST_EVALUATIONS = 25
LEAST_GAIN = 7.0  # Nats: odds of 1000 to 1 for the cause, before one of some thirty is chosen
EXPLAINED = 0.10
"""Of the disagreement. Clean walks can be explained to 18 % by accident, in a single step, by gains
below 5.
"""
EXPLAINED_FREE = 0.30
"""Where only the free moment is wrong: arms and trunk turn the body too, and their model explains
so much by accident (16 % in a walk with arms raised in its static trial)."""
EXPLAINED_LEVER = 0.25
"""Where the weight gets another lever arm (`LEVERS`) and markers come and go (`MISSING`): these
shake the trunk. Single frames of markers taken away at random (5, 10 and 20 % of all, three times)
are so explained to 21 % in one clean walk, by 15 nats, for mass centres are freed with the lever;
in walks of 12 others by less than 5 nats. Of 31 plates 60 or 80 mm away or tilted by 3 or 4 deg
that are so named with nothing missing, 29 explain as much."""
MISSING = 0.03  # Share of missing samples; 1 and 2 % at random left that walk in peace, by 5 nats
EXPLAINED_DOUBTFUL = 0.5
"""Where markers leave open how a leg moves: what such a leg would need is so explained to 27 %.
Forces in kgf, a sign or axes that are wrong explain more."""
LEVERS = (ForceFault.PLACE, ForceFault.TILT, ForceFault.MARKERS_TILTED)
RIVAL_SHARE, RIVAL_BEHIND, MOST_BEHIND = 0.75, 3.0, 25.0
"""A rival has 0.75 of the gain and is not more than 25 nats behind, or comes within 3 nats (odds of
20).
"""
MOST_RIVALS = 3
ODD: Mapping[ForceFault, ForceFault] = {
    ForceFault.FORCE_UNIT: ForceFault.GAIN,
    ForceFault.MOMENT_UNIT: ForceFault.FREE_MOMENT,
}
"""A unit, and the cause of any factor that can stand for it."""
# Nats by which a unit may be behind: an exact factor of 9.80665 or 1000 seldom comes about
# otherwise
UNIT_BEHIND = 8.0
A_CHOICE = float(np.log(30.0))  # Nats that each statement costs
TRIAL_GAIN = (
    -2.0
)  # A cause common to all trials may not speak against itself in one of them by more than this
# Of the gain of its own best cause: where a common one gives as much in every trial, it is the
# simpler
SHARED = 0.7
UNEXPLAINED = 4.0
"""|y|^2 a row above which a disagreement that nothing explains is told: clean recordings have 0.2
to 1.1, and up to 1.9 where no marker shows the trunk."""
FACTORS = (
    ForceFault.GAIN,
    ForceFault.VERTICAL_GAIN,
    ForceFault.HORIZONTAL_GAIN,
    ForceFault.FORE_AFT_GAIN,
    ForceFault.SIDEWAYS_GAIN,
    ForceFault.FREE_MOMENT,
)
SIZES: Mapping[ForceFault, tuple[float, float, float]] = {
    ForceFault.CLOCK: (0.018, -0.35, 0.35),
    ForceFault.PLACE: (0.015, -1.5, 1.5),
    ForceFault.YAW: (float(np.deg2rad(4.0)), -np.inf, np.inf),
    ForceFault.TILT: (float(np.deg2rad(1.5)), -0.35, 0.35),
    ForceFault.MARKERS_TILTED: (float(np.deg2rad(1.5)), -0.35, 0.35),
    ForceFault.GAIN: (0.05, -0.95, 30.0),
    ForceFault.VERTICAL_GAIN: (0.05, -0.95, 30.0),
    ForceFault.HORIZONTAL_GAIN: (0.15, -0.9, 9.0),
    ForceFault.FORE_AFT_GAIN: (0.15, -0.9, 9.0),
    ForceFault.SIDEWAYS_GAIN: (0.25, -0.9, 9.0),
    ForceFault.FREE_MOMENT: (0.5, -2.5, 299.0),
    ForceFault.OFFSET: (15.0, -300.0, 300.0),
    ForceFault.TRUNK: (0.05, -0.15, 0.15),
}
"""Size that is worth telling (of factors by how much 1 + x differs from 1), and coefficients beyond
which a cause is no explanation: s, m, rad, N."""


@dataclass(frozen=True, kw_only=True)
class ForceFit:
    """One cause at the size that explains most."""

    cause: Cause
    x: Array  # Its coefficients
    gain: float  # Nats against no fault
    explained: float  # Part of the disagreement, |y|^2, that is gone without the fault
    gains: Array  # (trials,) part of the gain that each trial gives


def fits(residual: ForceResidual, only: object = None) -> tuple[float, list[ForceFit]]:
    """|y|^2 a row without any cause, and every cause with its best size (or `only` of that key),
    the best one first.
    """
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
    """(trials,) evidence of a cause from the sums of squares (trials,) without and with it; its
    cost in equal parts.
    """
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
    undone = [
        (t, Corrected(t.wrenches) if cause is None else cause.undo(t, x)) for t in residual.trials
    ]
    return residual.whitened([trial.residual(u.wrenches, u.required_wrench) for trial, u in undone])


def _judged(
    residuals: Sequence[ForceResidual],
    cause: Cause,
    x: Array,
    before: Array,
    after: Array,
    rows: Array,
) -> ForceFit:
    """A cause of size x, from the sums of squares (trials,) without and with it."""
    trials = [trial for residual in residuals for trial in residual.trials]
    plates = len({plate.name for trial in trials for plate in trial.plates}) if cause.plates else 1
    of_side = [surprise(t.baseline) - surprise(_side_evidence(t, cause, x)) for t in trials]
    of_trials = gains(before, after, rows, cause.parameters or NO_COEFFICIENT, plates) + np.array(
        of_side
    )
    explained = float(1.0 - after.sum() / before.sum())
    return ForceFit(
        cause=cause, x=x, gain=float(of_trials.sum()), explained=explained, gains=of_trials
    )


def _fit(residual: ForceResidual, cause: Cause, plain: Array, before: Array) -> ForceFit:
    """A cause at its best size: by linear least squares, from its starts, or without a coefficient."""

    def misfit(x: Array) -> Array:
        return _whitened(residual, cause, x)

    x: Array = np.zeros(0)
    if not cause.parameters:
        y = misfit(x)
    elif cause.starts:
        step = STEP.get(cause.kind, TURN_STEP)
        start = min((np.array(s) for s in cause.starts), key=lambda s: float((y := misfit(s)) @ y))
        most = MOST_EVALUATIONS * (len(start) + 1)
        fit = least_squares(lambda u: misfit(step * u), start / step, method="lm", max_nfev=most)
        x, y = step * fit.x, fit.fun
    else:
        slopes = np.stack([misfit(e) - plain for e in np.eye(cause.parameters)], axis=1)
        rows, known = slopes, plain
        if cause.by_side_evidence:
            baseline = np.concatenate([trial.baseline for trial in residual.trials])
            each = [
                np.concatenate([_side_evidence(t, cause, e) for t in residual.trials]) - baseline
                for e in np.eye(cause.parameters)
            ]
            rows = np.concatenate([slopes, np.stack(each, axis=1)])
            known = np.concatenate([plain, baseline])
        x = np.asarray(np.linalg.lstsq(rows, -known, rcond=None)[0], dtype=np.float64)
        y = plain + slopes @ x
    return _judged([residual], cause, x, before, residual.squares(y), residual.rows)


def _side_evidence(trial: ForceEvidence, cause: Cause, x: Array) -> Array:
    undone = cause.undo(trial, x)
    offsets = np.zeros(len(trial.plates)) if undone.offsets is None else undone.offsets
    return trial.side_evidence(undone.wrenches, offsets)


def told_size(fit: ForceFit) -> np.ndarray:
    """The size in the units in which it is told: s, m, rad, N, or a factor that the file has too
    much.
    """
    if fit.cause.kind in FACTORS:
        return 1.0 / (1.0 + fit.x)
    return fit.x


@dataclass(frozen=True, kw_only=True)
class Named:
    """The causes that explain some trials: one, or several that evidence cannot part."""

    trials: tuple[ForceEvidence, ...]  # That the fault is in
    fits: tuple[ForceFit, ...]  # The best one first


@dataclass(frozen=True, kw_only=True)
class Unexplained:
    """A trial whose motion and forces disagree, and no single cause says why."""

    trial: ForceEvidence
    size: float  # |y|^2 a row: 1 is usual


class Choice(NamedTuple):
    """What is wrong with the forces of the trials of one session."""

    named: list[Named]
    unexplained: list[Unexplained]
    possible: dict[
        str, PlateErrors
    ]  # Trial -> by how much more its plates are uncertain, named or not


def possible_errors(found: Sequence[ForceFit]) -> PlateErrors:
    """What the plates of a trial may have, by all its causes: one is exp(gain - A_CHOICE) times as
    likely as no fault, and by its size, weighed by its probability among all, the plates are
    uncertain. A gain is held by the person's mass.
    """
    share = softmax([0.0, *(fit.gain - A_CHOICE for fit in found)])[1:]

    def size(kind: ForceFault) -> float:
        squares = [_departure(fit) ** 2 if fit.cause.kind is kind else 0.0 for fit in found]
        return float(np.sqrt(share @ squares))

    return PlateErrors(
        position=size(ForceFault.PLACE),
        gain=0.0,
        time_offset=size(ForceFault.CLOCK),
        rotation=size(ForceFault.YAW),
    )


def choose(trials: Sequence[ForceEvidence]) -> Choice:
    """What is wrong with the forces of the trials of one session."""
    alone: list[Named] = []
    left: list[Unexplained] = []
    possible = dict[str, PlateErrors]()
    residuals = [ForceResidual([trial]) for trial in trials]
    for trial, residual in zip(trials, residuals, strict=True):
        size, found = fits(residual)
        possible[trial.name] = possible_errors(found)
        if best := named(found, *_doubts([trial])):
            alone.append(Named(trials=(trial,), fits=best))
        elif size > UNEXPLAINED and not trial.doubtful:
            left.append(Unexplained(trial=trial, size=size))
    together = _together(trials, residuals) if len(trials) > 1 else None
    apart = Choice(alone, left, possible)
    if together is None:
        return apart
    first = together.fits[0]
    convicted = {one.trials[0].name for one in alone}
    if alone and not _borne_out([r for r in residuals if r.trials[0].name not in convicted], first):
        return apart
    share = {trial.name: gain for trial, gain in zip(trials, first.gains, strict=True)}
    as_good = all(share[one.trials[0].name] > SHARED * one.fits[0].gain for one in alone)
    separately = sum(one.fits[0].gain - A_CHOICE for one in alone)
    if as_good or first.gain - A_CHOICE > separately:
        return Choice([together], [], possible)
    return apart


def _borne_out(rest: Sequence[ForceResidual], common: ForceFit) -> bool:
    """Whether trials that are not convicted by themselves have the same fault without the others,
    large enough to tell.

    Beside one walk whose forces come 25 ms late, four that are 14 ms late by themselves, as clean
    walks may be, gain 6 nats each by 20 ms.
    """
    if not rest:
        return True
    trials = [trial for residual in rest for trial in residual.trials]
    _, found = fits(ForceResidual(trials), common.cause.key)
    fit = at_size(rest, found[0])
    return fit.gain > A_CHOICE and _worth_telling(fit, *_doubts(trials))


def _together(trials: Sequence[ForceEvidence], alone: Sequence[ForceResidual]) -> Named | None:
    """A cause that all trials share, its size sought in all of them and its gain summed over each
    by itself.

    Marginalised together, the inertial errors would carry a fault of one trial into all others.
    """
    _, found = fits(ForceResidual(trials))
    common = [at_size(alone, fit) for fit in found if fit.gain > 0.0]
    kept = sorted(
        (fit for fit in common if (fit.gains > TRIAL_GAIN).all()), key=lambda fit: -fit.gain
    )
    best = named(kept, *_doubts(trials))
    return Named(trials=tuple(trials), fits=best) if best else None


def _doubts(trials: Sequence[ForceEvidence]) -> tuple[bool, bool]:
    """Whether markers come and go in any of them; whether the motion of a leg is in doubt."""
    return any(trial.missing > MISSING for trial in trials), any(trial.doubtful for trial in trials)


def named(
    found: Sequence[ForceFit], shaken: bool = False, doubtful: bool = False
) -> tuple[ForceFit, ...]:
    """The cause that is told, and its rivals; none where no cause is beyond doubt. `found`: the
    best one first.
    """
    telling = [fit for fit in found if _worth_telling(fit, shaken, doubtful)]
    if not telling or telling[0].gain < LEAST_GAIN:
        return ()
    best = telling[0].gain
    least = min(max(0.5 * LEAST_GAIN, RIVAL_SHARE * best, best - MOST_BEHIND), best - RIVAL_BEHIND)
    return _units_first([fit for fit in telling if fit.gain >= least])[: 1 + MOST_RIVALS]


def _units_first(named: list[ForceFit]) -> tuple[ForceFit, ...]:
    """A unit that explains as much as an odd factor of all plates is what is meant, and the factor
    is not told.
    """
    units = {fit.cause.kind: fit.gain for fit in named if fit.cause.kind in ODD}
    if not units or max(units.values()) < named[0].gain - UNIT_BEHIND:
        return tuple(named)
    best = max(units, key=lambda kind: units[kind])
    left = [fit for fit in named if fit.cause.kind is not ODD[best]]
    return tuple(sorted(left, key=lambda fit: fit.cause.kind is not best))


def _worth_telling(fit: ForceFit, shaken: bool, doubtful: bool) -> bool:
    kind, explained = fit.cause.kind, EXPLAINED
    if doubtful:
        explained = EXPLAINED_DOUBTFUL
    elif kind is ForceFault.FREE_MOMENT:
        explained = EXPLAINED_FREE
    elif shaken and kind in LEVERS:
        explained = EXPLAINED_LEVER
    if fit.explained < explained or not len(fit.x):
        return fit.explained >= explained
    least, low, high = SIZES[kind]
    return bool(low <= fit.x.min() and fit.x.max() <= high and _departure(fit) >= least)


def _departure(fit: ForceFit) -> float:
    """s, m, rad, N, or of 1: how far from no fault."""
    kind = fit.cause.kind
    return float(
        np.linalg.norm(
            told_size(fit) - 1.0
            if kind in FACTORS and kind is not ForceFault.FREE_MOMENT
            else fit.x
        )
    )
