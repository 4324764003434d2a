"""Inertial parameters move where the pelvis residual asks for it, and nowhere else.

Marker noise alone makes a pelvis residual of 12 to 20 N; least squares turn it into masses (0.34 kg off where the table
was 0.22 kg off). Here the residual is weighed against what makes residuals without wrong masses (`residual_noise.py`).
With x the variables of the chart (0 at the nominal model), rho(x) the residual of all valid frames and A = d rho/d x at
0, what a fit can hear are the scores g(x) = A^T rho(x); at the true x they have the covariance G of the noise:

    min_x  g^T G^-1 g + sum_n (x_n / s_n)^2,        s_n the spread of people about the anthropometric table,

generalised least squares, whose posterior covariance is (M^T G^-1 M + diag(1 / s^2))^-1, M = d g/d x. Whether it is to
be believed at all is asked first: how much likelier are the scores with people's spread than with exactly nominal
values? Linear in x, the Bayes factor is

    2 ln K = g0^T (G^-1 - (G + M S^2 M^T)^-1) g0 - ln det (1 + G^-1 M S^2 M^T).

Below `STRONG` (Kass and Raftery, J. Am. Stat. Assoc. 90, 1995: "strong evidence") the parameters stay nominal, and the
spread of people is their covariance.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from scipy.optimize import least_squares

from gaitcal.arrays import Array
from gaitcal.calibration.inertial_calibration import InertialFit, RootEquations, by_inertial
from gaitcal.calibration.inertial_chart import ConsistentSettings, LogChart
from gaitcal.calibration.joint_calibration import ending
from gaitcal.calibration.residual_noise import ResidualNoise
from gaitcal.model.parameters import InertialSet, dynamic_parameters, full_set

STRONG = float(np.log(20.0))
"""ln K from which the inertial parameters move: odds of 20 to 1."""
UNHEARD = 1e-10
"""Part of the largest variance of the scores below which a direction of x makes no residual at all."""


def stay_nominal(seed: Array, which: InertialSet, settings: ConsistentSettings | None = None) -> InertialFit:
    """The seed as it is, with the spread of people about it."""
    chart = LogChart(seed, which)
    spread = chart.spread(settings or ConsistentSettings())
    return InertialFit(
        names=which.names,
        inertial=seed,
        jacobian=chart.jacobian(np.zeros(chart.size)),
        residual_jacobian=np.diag(1.0 / spread),
        rms_force=np.nan,
        rms_moment=np.nan,
        seeds=1,
        iterations=0,
        seconds=0.0,
        converged=True,
        message="inertial parameters stay nominal",
        moved=False,
    )


def unmeasured_stay(
    equations: RootEquations,
    seed: Array,
    which: InertialSet,
    unmeasured: str,
    settings: ConsistentSettings | None = None,
) -> InertialFit:
    """The seed as it is, as the residual tells first how mass moves that markers leave open, `unmeasured` in words."""
    force, moment = equations.rms(seed)
    return replace(
        stay_nominal(seed, which, settings),
        rms_force=force,
        rms_moment=moment,
        message=f"inertial parameters stay nominal: markers do not determine {unmeasured}; the pelvis residual "
        f"({force:.1f} N, {moment:.1f} N·m RMS) tells how that moves, not what it weighs",
    )


def spread_of_the_rest(inertial: Array, which: InertialSet, settings: ConsistentSettings | None = None) -> Array:
    """(84, n) R with covariance R R^T of the mass centres that no variable of `which` moves.

    They stay nominal, and people scatter about them as about others; pelvis and trunk are taken to be symmetric.
    """
    every = full_set()
    chart = LogChart(inertial, every)
    free = np.abs(which.selection).sum(axis=1) > 0
    limb = [name.split(".")[0].endswith(("_r", "_l")) for name in every.names]
    scatter = [".com." in n and (paired or not n.endswith(".lat")) for n, paired in zip(every.names, limb, strict=True)]
    kept = np.flatnonzero(scatter & ~free)
    spread = chart.spread(settings or ConsistentSettings())
    out: Array = (chart.jacobian(np.zeros(chart.size)) * spread)[:, kept]
    return out


def fit_by_evidence(
    equations: RootEquations,
    seed: Array,
    which: InertialSet,
    noise: ResidualNoise,
    settings: ConsistentSettings | None = None,
) -> InertialFit:
    """Physically possible inertias of unchanged total mass; the seed itself unless the residual tells against it.

    Parameters
    ----------
    noise : of the chart that begins at `seed`, with the scale of `equations`.
    """
    began = time.perf_counter()
    settings = settings or ConsistentSettings()
    chart = LogChart(seed, which)
    spread, start = chart.spread(settings), np.zeros(chart.size)
    rows = by_inertial(equations.factor, seed) @ chart.jacobian(start)
    values, vectors = np.linalg.eigh(noise.covariance)
    heard = values > UNHEARD * values[-1]
    weigh = (vectors[:, heard] / np.sqrt(values[heard])).T @ rows.T
    """G^-1/2 A^T."""

    def residual(x: Array) -> Array:
        gap = equations.factor @ dynamic_parameters(chart.inertial(x)).ravel() + equations.target
        return np.concatenate([weigh @ gap, x / spread])

    def jacobian(x: Array) -> Array:
        by_x = by_inertial(equations.factor, chart.inertial(x)) @ chart.jacobian(x)
        return np.vstack([weigh @ by_x, np.diag(1.0 / spread)])

    scores = residual(start)[: len(weigh)]
    factor = log_bayes_factor(scores, weigh @ rows * spread)
    explained = f"({noise.rms_force:.1f} N, {noise.rms_moment:.1f} N·m)"
    force, moment = equations.rms(seed)
    told = f"the pelvis residual ({force:.1f} N, {moment:.1f} N·m RMS)"
    if factor < STRONG:
        beyond = force > noise.rms_force or moment > noise.rms_moment
        why = (
            f"is more than marker noise, bandwidth and plates explain {explained}, but not what other masses would make"
            if beyond
            else f"is what marker noise, bandwidth and plates explain {explained}"
        )
        return replace(
            stay_nominal(seed, which, settings),
            rms_force=force,
            rms_moment=moment,
            seconds=time.perf_counter() - began,
            message=f"inertial parameters stay nominal: {told} {why}; ln K = {factor:.1f}",
        )
    result = least_squares(residual, start, jac=jacobian, method="lm", ftol=1e-13, xtol=1e-13)
    inertial = chart.inertial(result.x)
    rms_force, rms_moment = equations.rms(inertial)
    return InertialFit(
        names=which.names,
        inertial=inertial,
        jacobian=chart.jacobian(result.x),
        residual_jacobian=jacobian(result.x),
        rms_force=rms_force,
        rms_moment=rms_moment,
        seeds=1,
        iterations=int(result.nfev),
        seconds=time.perf_counter() - began,
        converged=bool(result.status > 0),
        message=f"{ending(result)}; {told} moves as wrong masses make it, ln K = {factor:.1f}, beside what marker "
        f"noise, bandwidth and plates explain {explained}",
    )


def log_bayes_factor(scores: Array, slopes: Array) -> float:
    """Logarithm of K of whitened scores (k,) whose slopes by variables of unit spread are (k, n)."""
    predicted = np.eye(len(scores)) + slopes @ slopes.T
    gain = float(scores @ scores - scores @ np.linalg.solve(predicted, scores))
    return 0.5 * (gain - float(np.linalg.slogdet(predicted)[1]))
