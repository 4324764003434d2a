"""How well each cause alone explains the pelvis residual, and at which size.

    Q_c = min over x of |y_c(x)|^2,    y_c the whitened residual without a fault of size x (`force_residual.py`)
    gain_c = sum_t n_t / 2 log((Q_0t + FLOOR m_t) / (Q_ct + FLOOR m_t)) - p / 2 log sum_t n_t,     n_t = TEMPER m_t

over trials t of m_t rows, plus what the witnesses say (`force_witnesses.py`), less log(plates) for one plate alone: the
Bayesian information criterion with the scale of the noise unknown in each trial, but not below sqrt(FLOOR) of what
clean walks leave. TEMPER counts rows as half: noise is not as Gaussian as that.
A cause without a coefficient has p = 1 / 2, being one of a few.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from gaitcal.arrays import Array
from gaitcal.faults.force_causes import Cause, Kind, Undone, causes_of
from gaitcal.faults.force_evidence import ForceEvidence
from gaitcal.faults.force_residual import ForceResidual
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
    undone = [(t, Undone(t.wrenches) if cause is None else cause.undo(t, x)) for t in residual.trials]
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
