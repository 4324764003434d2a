"""Choose the fault that explains a pelvis residual: of one trial alone, or common to a session.

A cause is reported if it explains much (`EXPLAINED`), is large enough to matter (`SIZES`) and has
decisive evidence (`LEAST_GAIN`). Its rivals, with nearly the same gain, are reported with it. What
belongs to the laboratory is common to all trials. One common cause is reported if it gains more
than separate causes, each of which costs `CHOICE_COST`, and if the trials without a cause of their
own confirm it by themselves: the fault of one trial must not be attributed to all.

Gain of each cause, at its best size:

    Q_c = min over x of |y_c(x)|^2,
             y_c the whitened residual without a fault of size x (`force_evidence.py`)
    gain_c = sum_t n_t / 2 log((Q_0t + FLOOR m_t) / (Q_ct + FLOOR m_t)) - p / 2 log sum_t n_t,
             n_t = TEMPER m_t

over trials t of m_t rows, plus the gain of side evidence (`plate_forces.py`), less log(plates) for
one plate alone. This is the Bayesian information criterion with unknown noise scale in each trial,
not below sqrt(FLOOR) of that of clean walks. TEMPER counts rows as half, as the noise is not
Gaussian. A cause without a coefficient has p = 1 / 2, as one of a few.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.special import softmax

from gaitcal.arrays import Array
from gaitcal.dynamics.measurement_errors import PlateErrors
from gaitcal.quality.force_causes import Cause, Corrected, ForceFault, list_causes
from gaitcal.quality.force_evidence import ForceEvidence, ForceResidual
from gaitcal.quality.plate_forces import compute_surprise

FLOOR = 0.20  # Least noise variance in units of that of clean walks
TEMPER = 0.5  # Weight of a row, as the noise is not Gaussian
COST_WITHOUT_COEFFICIENT = 0.5  # p of a cause without a coefficient
STEP = {ForceFault.CLOCK: 0.01}  # s, scale of the coefficient in its nonlinear fit
ROTATION_STEP = 0.03  # rad, the same of rotations
MOST_EVALUATIONS = 25
LEAST_GAIN = 7.0  # Nats: odds of 1000 to 1 for the cause, before one of some thirty is chosen
EXPLAINED = 0.10
"""Least explained share of the disagreement. In a single step of a clean walk up to 18 % is
explained by chance, with gains below 5."""
EXPLAINED_FREE = 0.30
"""The same for the free moment: arms and trunk rotate the body as well, and their model error is so
explained by chance (16 % in a walk whose static trial has raised arms)."""
EXPLAINED_LEVER = 0.25
"""The same where the lever arm of the weight changes (`LEVER_FAULTS`) and samples of markers are
missing (`MISSING_SHARE`), which disturbs the trunk. Samples removed at random (5, 10 and 20 % of
all, three times) are so explained to 21 % in one clean walk, by 15 nats, as the lever also changes
mass centres; in walks of 12 others by less than 5 nats. Of 31 plates displaced by 60 or 80 mm or
tilted by 3 or 4 deg that are found with nothing missing, 29 explain as much."""
# Share of missing samples; with 1 and 2 % at random the gain in that walk is below 5 nats
MISSING_SHARE = 0.03
EXPLAINED_DOUBTFUL = 0.5
"""The same where markers do not determine the motion of a leg: its error is so explained to 27 %.
Forces in kgf, a wrong sign or wrong axes explain more."""
LEVER_FAULTS = (ForceFault.PLACE, ForceFault.TILT, ForceFault.MARKERS_TILTED)
RIVAL_SHARE = 0.75  # A rival has this share of the best gain,
MOST_BEHIND = 25.0  # and is at most so many nats behind;
RIVAL_BEHIND = 3.0  # or it is within so many nats (odds of 20)
MOST_RIVALS = 3
ODD_FACTORS: Mapping[ForceFault, ForceFault] = {
    ForceFault.FORCE_UNIT: ForceFault.GAIN,
    ForceFault.MOMENT_UNIT: ForceFault.FREE_MOMENT,
}
"""A unit fault, and the factor fault with the same effect."""
# Nats by which a unit may be behind: an exact factor of 9.80665 or 1000 is rarely a coincidence
UNIT_BEHIND = 8.0
CHOICE_COST = float(np.log(30.0))  # Nats, cost of each reported cause: one of some thirty
TRIAL_GAIN = -2.0  # Nats, least gain in each trial of a cause common to all
# A common cause with this share of each trial's best gain is the simpler explanation
SHARED_GAIN = 0.7
UNEXPLAINED_SQUARE = 4.0
"""|y|^2 a row above which an unexplained disagreement is reported: clean recordings have 0.2 to
1.1, and up to 1.9 without markers on the trunk."""
FACTOR_FAULTS = (
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
"""Least size that is reported (for factors the departure from 1), and the range of coefficients
outside which a cause is no explanation: s, m, rad, N."""


@dataclass(frozen=True, kw_only=True)
class ForceFit:
    """One cause at its best size."""

    cause: Cause
    x: Array  # Its coefficients
    gain: float  # Nats against no fault
    explained: float  # Share of the disagreement |y|^2 that is removed with the fault
    gains: Array  # (trials,) contribution of each trial to the gain, nats


def fit_causes(residual: ForceResidual, only: object = None) -> tuple[float, list[ForceFit]]:
    """Fit every cause to the residual of some trials.

    `only`: key of the causes to fit (`Cause.key`); None: all. Returns: |y|^2 a row without any
    cause; 1 is usual; the best fit of each key, the largest gain first.
    """
    plain = _whiten(residual, None, np.zeros(0))
    before = residual.sum_squares(plain)
    found: dict[object, ForceFit] = {}
    for cause in list_causes(residual.trials):
        if only is not None and cause.key != only:
            continue
        fit = _fit_cause(residual, cause, plain, before)
        if cause.key not in found or fit.gain > found[cause.key].gain:
            found[cause.key] = fit
    return float(before.sum() / residual.rows.sum()), sorted(found.values(), key=lambda f: -f.gain)


def _compute_gains(
    before: Array, after: Array, rows: Array, parameters: float, choices: int = 1
) -> Array:
    """Compute the evidence of a cause in each trial.

    `before`, `after`: (trials,) sums of squares without and with the cause. `rows`: (trials,)
    numbers of rows. `parameters`: number of coefficients, p. `choices`: number of plates from which
    one was chosen. Returns: (trials,) nats; the cost of the coefficients is shared equally.
    """
    floor, count = FLOOR * rows, TEMPER * rows
    cost = (0.5 * parameters * np.log(count.sum()) + np.log(choices)) / len(rows)
    out: Array = 0.5 * count * np.log((before + floor) / (after + floor)) - cost
    return out


def evaluate_at_size(alone: Sequence[ForceResidual], fit: ForceFit) -> ForceFit:
    """Evaluate a cause of the same size in several trials, each with inertial errors of its own.

    Returns: the same cause and size, with the gains of these trials.
    """
    rows = np.array([residual.rows.sum() for residual in alone])
    before, after = np.zeros(len(alone)), np.zeros(len(alone))
    for i, residual in enumerate(alone):
        before[i] = residual.sum_squares(_whiten(residual, None, fit.x)).sum()
        after[i] = residual.sum_squares(_whiten(residual, fit.cause, fit.x)).sum()
    return _assemble_fit(alone, fit.cause, fit.x, before, after, rows)


def _whiten(residual: ForceResidual, cause: Cause | None, x: Array) -> Array:
    """Compute y (rows,) without a fault of size `x`; as measured if `cause` is None."""
    undone = [
        (t, Corrected(t.wrenches) if cause is None else cause.undo(t, x)) for t in residual.trials
    ]
    return residual.whiten(
        [trial.compute_residual(u.wrenches, u.required_wrench) for trial, u in undone]
    )


def _assemble_fit(
    residuals: Sequence[ForceResidual],
    cause: Cause,
    x: Array,
    before: Array,
    after: Array,
    rows: Array,
) -> ForceFit:
    """Assemble the fit of a cause of size `x` from sums of squares without and with it."""
    trials = [trial for residual in residuals for trial in residual.trials]
    # the choice of one plate among several costs log(plates)
    plates = len({plate.name for trial in trials for plate in trial.plates}) if cause.plates else 1
    of_side = [
        compute_surprise(t.baseline) - compute_surprise(_compute_side_evidence(t, cause, x))
        for t in trials
    ]
    of_trials = _compute_gains(
        before, after, rows, cause.parameters or COST_WITHOUT_COEFFICIENT, plates
    ) + np.array(of_side)
    explained = float(1.0 - after.sum() / before.sum())
    return ForceFit(
        cause=cause, x=x, gain=float(of_trials.sum()), explained=explained, gains=of_trials
    )


def _fit_cause(residual: ForceResidual, cause: Cause, plain: Array, before: Array) -> ForceFit:
    """Fit the size of a cause: by linear or nonlinear least squares, or without a coefficient."""

    def compute_misfit(x: Array) -> Array:
        return _whiten(residual, cause, x)

    def compute_square(x: tuple[float, ...]) -> float:
        y = compute_misfit(np.array(x))
        return float(y @ y)

    x: Array = np.zeros(0)
    if not cause.parameters:
        y = compute_misfit(x)
    elif cause.starts:
        step = STEP.get(cause.kind, ROTATION_STEP)
        start = np.array(min(cause.starts, key=compute_square))
        most = MOST_EVALUATIONS * (len(start) + 1)
        fit = least_squares(
            lambda u: compute_misfit(step * u), start / step, method="lm", max_nfev=most
        )
        x, y = step * fit.x, fit.fun
    else:
        jacobian = np.stack([compute_misfit(e) - plain for e in np.eye(cause.parameters)], axis=1)
        rows, known = jacobian, plain
        if cause.by_side_evidence:
            baseline = np.concatenate([trial.baseline for trial in residual.trials])
            columns = []
            for e in np.eye(cause.parameters):
                each = [_compute_side_evidence(trial, cause, e) for trial in residual.trials]
                columns.append(np.concatenate(each) - baseline)
            rows = np.concatenate([jacobian, np.stack(columns, axis=1)])
            known = np.concatenate([plain, baseline])
        x = np.asarray(np.linalg.lstsq(rows, -known, rcond=None)[0], dtype=np.float64)
        y = plain + jacobian @ x
    return _assemble_fit([residual], cause, x, before, residual.sum_squares(y), residual.rows)


def _compute_side_evidence(trial: ForceEvidence, cause: Cause, x: Array) -> Array:
    """Compute the side evidence z (n,) of a trial without a fault of size `x`."""
    undone = cause.undo(trial, x)
    offsets = np.zeros(len(trial.plates)) if undone.offsets is None else undone.offsets
    return trial.compute_side_evidence(undone.wrenches, offsets)


def get_reported_size(fit: ForceFit) -> np.ndarray:
    """Return the size as reported: s, m, rad, N, or the factor by which the file is too large."""
    if fit.cause.kind in FACTOR_FAULTS:
        return 1.0 / (1.0 + fit.x)
    return fit.x


@dataclass(frozen=True, kw_only=True)
class NamedFault:
    """The causes that explain some trials: one, or several that the evidence does not separate."""

    trials: tuple[ForceEvidence, ...]  # Trials with the fault
    fits: tuple[ForceFit, ...]  # The best one first


@dataclass(frozen=True, kw_only=True)
class UnexplainedTrial:
    """A trial whose motion and forces disagree without a single cause that explains it."""

    trial: ForceEvidence
    size: float  # |y|^2 a row: 1 is usual


class Choice(NamedTuple):
    """Faults of the forces of the trials of one session."""

    named: list[NamedFault]
    unexplained: list[UnexplainedTrial]
    # Trial -> additional uncertainty of its plates, with or without a named cause
    possible: dict[str, PlateErrors]


def _estimate_plate_errors(found: Sequence[ForceFit]) -> PlateErrors:
    """Estimate the uncertainty of a trial's plates from all its causes.

    A cause is exp(gain - CHOICE_COST) times as likely as no fault. The plates are uncertain by its
    size, weighted by its probability among all. A gain is determined by the subject's mass.

    `found`: fits of all causes in one trial. Returns: standard deviations of position, time offset
    and rotation.
    """
    # the first entry is the hypothesis of no fault
    share = softmax([0.0, *(fit.gain - CHOICE_COST for fit in found)])[1:]

    def compute_size(kind: ForceFault) -> float:
        squares = [_compute_departure(fit) ** 2 if fit.cause.kind is kind else 0.0 for fit in found]
        return float(np.sqrt(share @ squares))

    return PlateErrors(
        position=compute_size(ForceFault.PLACE),
        gain=0.0,
        time_offset=compute_size(ForceFault.CLOCK),
        rotation=compute_size(ForceFault.YAW),
    )


def choose(trials: Sequence[ForceEvidence]) -> Choice:
    """Choose the faults of the forces of the trials of one session.

    Parameters
    ----------
    trials
        Gait trials of one person over the same plates.

    Returns
    -------
    Choice
        One common fault, or a fault of each trial; unexplained trials; uncertainty of the plates.
    """
    alone: list[NamedFault] = []
    left: list[UnexplainedTrial] = []
    possible = dict[str, PlateErrors]()
    residuals = [ForceResidual([trial]) for trial in trials]
    for trial, residual in zip(trials, residuals, strict=True):
        size, found = fit_causes(residual)
        possible[trial.name] = _estimate_plate_errors(found)
        best = select_named(found, *_find_doubts([trial]))
        if best:
            alone.append(NamedFault(trials=(trial,), fits=best))
        elif size > UNEXPLAINED_SQUARE and not trial.doubtful:
            left.append(UnexplainedTrial(trial=trial, size=size))
    together = _choose_common_cause(trials, residuals) if len(trials) > 1 else None
    separate = Choice(alone, left, possible)
    if together is None:
        return separate
    first = together.fits[0]
    # a common fault must also be found in the trials without one of their own
    named_trials = {one.trials[0].name for one in alone}
    if alone and not _is_confirmed(
        [r for r in residuals if r.trials[0].name not in named_trials], first
    ):
        return separate
    share = {trial.name: gain for trial, gain in zip(trials, first.gains, strict=True)}
    as_good = all(share[one.trials[0].name] > SHARED_GAIN * one.fits[0].gain for one in alone)
    separate_gain = sum(one.fits[0].gain - CHOICE_COST for one in alone)
    if as_good or first.gain - CHOICE_COST > separate_gain:
        return Choice([together], [], possible)
    return separate


def _is_confirmed(others: Sequence[ForceResidual], common: ForceFit) -> bool:
    """Return whether trials without a fault of their own show the common fault by themselves.

    Beside one walk whose forces come 25 ms late, four that are 14 ms late by themselves, as clean
    walks may be, gain 6 nats each by 20 ms.
    """
    if not others:
        return True
    trials = [trial for residual in others for trial in residual.trials]
    _, found = fit_causes(ForceResidual(trials), common.cause.key)
    fit = evaluate_at_size(others, found[0])
    return fit.gain > CHOICE_COST and _is_reportable(fit, *_find_doubts(trials))


def _choose_common_cause(
    trials: Sequence[ForceEvidence], alone: Sequence[ForceResidual]
) -> NamedFault | None:
    """Choose a cause common to all trials; None if there is none.

    Its size is fitted to all trials, and its gain summed over each trial alone. Marginalised
    together, the inertial errors would carry a fault of one trial into all others.
    """
    _, found = fit_causes(ForceResidual(trials))
    common = [evaluate_at_size(alone, fit) for fit in found if fit.gain > 0.0]
    kept = sorted(
        (fit for fit in common if (fit.gains > TRIAL_GAIN).all()), key=lambda fit: -fit.gain
    )
    best = select_named(kept, *_find_doubts(trials))
    return NamedFault(trials=tuple(trials), fits=best) if best else None


def _find_doubts(trials: Sequence[ForceEvidence]) -> tuple[bool, bool]:
    """Return whether samples of markers are missing, and whether a leg's motion is in doubt."""
    return any(trial.missing > MISSING_SHARE for trial in trials), any(
        trial.doubtful for trial in trials
    )


def select_named(
    found: Sequence[ForceFit], shaken: bool = False, doubtful: bool = False
) -> tuple[ForceFit, ...]:
    """Select the cause to report and its rivals.

    `shaken`: whether samples of markers are missing. `doubtful`: whether the motion of a leg is in
    doubt. Returns: the best one first; empty if no cause has decisive evidence.
    """
    reportable = [fit for fit in found if _is_reportable(fit, shaken, doubtful)]
    if not reportable or reportable[0].gain < LEAST_GAIN:
        return ()
    best = reportable[0].gain
    # least gain of a rival, relative to the best cause
    least = min(max(0.5 * LEAST_GAIN, RIVAL_SHARE * best, best - MOST_BEHIND), best - RIVAL_BEHIND)
    return _prefer_units([fit for fit in reportable if fit.gain >= least])[: 1 + MOST_RIVALS]


def _prefer_units(named: list[ForceFit]) -> tuple[ForceFit, ...]:
    """Prefer a unit to a factor of all plates that explains as much, and drop that factor."""
    units = {fit.cause.kind: fit.gain for fit in named if fit.cause.kind in ODD_FACTORS}
    if not units or max(units.values()) < named[0].gain - UNIT_BEHIND:
        return tuple(named)
    best = max(units, key=lambda kind: units[kind])
    left = [fit for fit in named if fit.cause.kind is not ODD_FACTORS[best]]
    return tuple(sorted(left, key=lambda fit: fit.cause.kind is not best))


def _is_reportable(fit: ForceFit, shaken: bool, doubtful: bool) -> bool:
    """Return whether a fit explains enough and has a size in its range."""
    kind, explained = fit.cause.kind, EXPLAINED
    if doubtful:
        explained = EXPLAINED_DOUBTFUL
    elif kind is ForceFault.FREE_MOMENT:
        explained = EXPLAINED_FREE
    elif shaken and kind in LEVER_FAULTS:
        explained = EXPLAINED_LEVER
    if fit.explained < explained or not len(fit.x):
        return fit.explained >= explained
    least, low, high = SIZES[kind]
    return bool(low <= fit.x.min() and fit.x.max() <= high and _compute_departure(fit) >= least)


def _compute_departure(fit: ForceFit) -> float:
    """Compute the distance of a fit from no fault: s, m, rad, N, or that of a factor from 1."""
    kind = fit.cause.kind
    return float(
        np.linalg.norm(
            get_reported_size(fit) - 1.0
            if kind in FACTOR_FAULTS and kind is not ForceFault.FREE_MOMENT
            else fit.x
        )
    )
