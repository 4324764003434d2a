"""How well each cause alone explains the pelvis residual, and at which size.

    Q_c = min over x of |y_c(x)|^2,    y_c the whitened residual without a fault of size x (`force_residual.py`)
    gain_c = sum_t n_t / 2 log((Q_0t + FLOOR m_t) / (Q_ct + FLOOR m_t)) - p / 2 log sum_t n_t,     n_t = TEMPER m_t

over trials t of m_t rows: the Bayesian information criterion with the scale of the noise unknown in each trial, the
scale not below sqrt(FLOOR) of what clean walks leave. TEMPER counts rows as half: noise is not as Gaussian as that.
A cause without a coefficient has p = 1 / 2, being one of a few.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from gaitcal.arrays import Array
from gaitcal.verdict.force_causes import Cause, Kind, causes_of
from gaitcal.verdict.force_residual import ForceResidual

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


def fits(residual: ForceResidual) -> tuple[float, list[ForceFit]]:
    """|y|^2 a row without any cause, and every cause with its best size, the best cause first."""
    plain = residual.whitened([trial.residual(trial.wrenches) for trial in residual.trials])
    before = residual.squares(plain)
    found: dict[object, ForceFit] = {}
    for cause in causes_of(residual.trials):
        fit = _fit(residual, cause, plain, before)
        if cause.key not in found or fit.gain > found[cause.key].gain:
            found[cause.key] = fit
    return float(before.sum() / residual.rows.sum()), sorted(found.values(), key=lambda f: -f.gain)


def gains(before: Array, after: Array, rows: Array, parameters: float) -> Array:
    """(trials,) evidence of a cause from the sums of squares (trials,) without and with it; its cost in equal parts."""
    floor, count = FLOOR * rows, TEMPER * rows
    cost = 0.5 * parameters * np.log(count.sum()) / len(rows)
    out: Array = 0.5 * count * np.log((before + floor) / (after + floor)) - cost
    return out


def _fit(residual: ForceResidual, cause: Cause, plain: Array, before: Array) -> ForceFit:
    def misfit(x: Array) -> Array:
        return residual.whitened([trial.residual(*cause.undo(trial, x)) for trial in residual.trials])

    if not cause.parameters:
        x: Array = np.zeros(0)
        y = misfit(x)
    elif cause.linear:
        slopes = np.stack([misfit(e) - plain for e in np.eye(cause.parameters)], axis=1)
        x = np.linalg.lstsq(slopes, -plain, rcond=None)[0]
        y = plain + slopes @ x
    else:
        x, y = _sought(misfit, cause)
    after = residual.squares(y)
    of_trials = gains(before, after, residual.rows, cause.parameters or NO_COEFFICIENT)
    return ForceFit(
        cause=cause,
        x=x,
        gain=float(of_trials.sum()),
        explained=float(1.0 - after.sum() / before.sum()),
        gains=of_trials,
    )


def _sought(misfit: Callable[[Array], Array], cause: Cause) -> tuple[Array, Array]:
    """Coefficients and rows at the least sum of squares, from the best of the cause's starts."""
    step = STEP.get(cause.kind, TURN_STEP)
    start = min((np.array(s) for s in cause.starts), key=lambda s: float((y := misfit(s)) @ y))
    fit = least_squares(
        lambda u: misfit(step * u), start / step, method="lm", max_nfev=MOST_EVALUATIONS * (len(start) + 1)
    )
    return step * fit.x, fit.fun
