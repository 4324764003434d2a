"""Fit inertial parameters by generalised least squares; keep the table's without strong evidence.

Marker noise alone causes a pelvis residual of 12 to 20 N. Least squares attribute it to masses (an
error of 0.34 kg where the table's was 0.22 kg). So the residual is compared with its causes other
than wrong masses. With rho the pelvis residual [F; T] of the valid frames, in units of a scale,
every source c of error changes it by

    d rho_c = (d rho/d q) B d N_c + (d rho/d v) B' d N_c + (d rho/d a) B'' d N_c + (d rho/d p) d p_c

for marker coordinates and nominal joint parameters (`error_sources.py`), and directly for

    plates       gain, place, turn and clock:
                 d F = -d F_foot,  d T = -(d M_foot - x_pelvis x d F_foot)
                 (`dynamics/measurement_errors.py`, with the sources of their sizes)
    inertia      parameters that are not fitted and in which people scatter:
                 d rho = (d rho/d IP) d IP
    bandwidth    rho of this motion less rho of its fit with 1 / sqrt 2 of the knot spans: half an
                 octave (a motion smoothed by a penalty has a separate source for that,
                 `compute_marker_scores`)
    the rest     independent errors of force and moment, repeated for `memory`: bending of plates,
                 spline residuals.

With x the variables of the chart (0 at the nominal model) and A = d rho/d x at 0, a fit depends on
the scores g(x) = A^T rho(x). At the true x they have the covariance of the noise, s_c =
A^T d rho_c summed over trials,

    G = sum_c s_c s_c^T + sigma^2 A^T A times the frames that repeat each other,

    min_x  g^T G^-1 g + sum_n (x_n / s_n)^2,

    s_n the spread of people about the anthropometric table,

generalised least squares, whose posterior covariance is (M^T G^-1 M + diag(1 / s^2))^-1, M = d g/d
x. Before that, the evidence is computed: how much likelier are the scores with people's spread than
with exactly nominal values? Linear in x, the Bayes factor is

    2 ln K = g0^T (G^-1 - (G + M S^2 M^T)^-1) g0 - ln det (1 + G^-1 M S^2 M^T).

Below `STRONG` (Kass and Raftery, J. Am. Stat. Assoc. 90, 1995: "strong evidence") the parameters
keep the table's values, and the spread of people is their covariance.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gaitcal.arrays import Array
from gaitcal.calibration import inertial_calibration
from gaitcal.calibration.error_sources import ErrorSources, MarkerScores, compute_marker_scores
from gaitcal.dynamics import derivatives, inverse_dynamics, measurement_errors
from gaitcal.dynamics.ground_reactions import GroundReactions
from gaitcal.model.parameters import (
    InertialSet,
    Parameters,
    compute_dynamic_jacobian,
    compute_dynamic_parameters,
    make_full_set,
)
from gaitcal.model.subject_model import Subject
from gaitcal.tracking import spline, trial_problem

BLOCK = 500  # Frames whose changes are held at once
# Knot spans of the refit for the bandwidth error, over those of the motion: half an octave
COARSER_SPANS = np.sqrt(2.0)
# ln K from which the inertial parameters move: odds of 20 to 1
STRONG = float(np.log(20.0))
# Part of the largest variance of the scores below which a direction of x makes no residual at all
NULL_DIRECTION = 1e-10


@dataclass(frozen=True)
class PlateNoise:
    """Errors of force plates in the pelvis residual."""

    errors: measurement_errors.PlateErrors = measurement_errors.DEFAULT
    rest: float = 0.005
    """Body weights (force), body weights times height (moment), independent from one `memory` to
    the next.
    """
    memory: float = 0.1  # s, for which an error of the rest repeats itself


@dataclass(frozen=True, kw_only=True)
class LoadedProblem:
    """A gait trial with its motion and its ground reactions."""

    # Of the whole body, with the skin that moves
    problem: trial_problem.MotionProblem
    coefficients: Array  # (nn, 27)
    reactions: GroundReactions
    # Of its markers, where known already (`compute_marker_scores`)
    scores: MarkerScores | None = None


@dataclass(frozen=True, kw_only=True)
class ResidualNoise:
    """Noise of the pelvis residual that wrong inertial parameters do not cause."""

    covariance: Array  # (n, n) of the scores A^T rho, rho in units of the scale
    # N, RMS over valid frames and three components of the residual that is to be expected
    rms_force: float
    rms_moment: float  # N·m


def estimate_residual_noise(
    trials: Sequence[LoadedProblem],
    parameters: Parameters,
    sources: ErrorSources,
    subject: Subject,
    chart: inertial_calibration.LogChart,
    length: float,
    plates: PlateNoise | None = None,
    unmoved: Array | None = None,
) -> ResidualNoise:
    """Estimate the noise of the pelvis residual over the valid frames of all trials.

    Parameters
    ----------
    trials : sequence of LoadedProblem
        Gait trials with motions and ground reactions.
    parameters : Parameters
        Joint parameters of the motions; the inertial ones are where `chart` begins.
    sources : ErrorSources
        Errors of the joint parameters.
    subject : Subject
        Weight and height of the person.
    chart : LogChart
        Variables of the fit.
    length : float
        Torques are divided by body weight times this (m), as in the equations to be fitted.
    plates : PlateNoise, optional
        Errors of the force plates.
    unmoved : (84, n) array, optional
        R with covariance R R^T of inertial parameters that `chart` does not change; exact if not
        given.

    Returns
    -------
    ResidualNoise
        Covariance of the scores, and the expected RMS residual (N, N·m).
    """
    plates = plates or PlateNoise()
    slopes = compute_dynamic_jacobian(parameters.inertial)
    kept = np.zeros((len(parameters.inertial), 0)) if unmoved is None else unmoved
    by_variable, by_kept = (
        np.einsum("sdk,skn->sdn", slopes, x.reshape(len(slopes), 7, -1)).reshape(
            10 * len(slopes), -1
        )
        for x in (chart.compute_jacobian(np.zeros(chart.size)), kept)
    )
    scale = np.repeat([1.0 / subject.weight, 1.0 / (subject.weight * length)], 3)
    rest = plates.rest * subject.weight * np.repeat([1.0, subject.height], 3)
    total, covariance = np.zeros(6), np.zeros((chart.size, chart.size))
    summed: dict[str, Array] = {}
    """Source -> (n,) its scores, over all trials."""
    of_sources = np.zeros((chart.size, len(sources.sources)))
    """(n, nc) the scores of errors of joint parameters and soft tissue."""
    dynamics, frames = inverse_dynamics.Dynamics(parameters), 0
    feet = [
        f"plate/{foot}/{column}"
        for foot in inverse_dynamics.FEET
        for column in measurement_errors.PLATE_ERROR_COLUMNS
    ]
    for trial in trials:
        basis, wrenches = trial.problem.basis, trial.reactions.wrench
        opened = trial.problem.with_free(sources.names)
        moves = trial.scores or compute_marker_scores(
            trial.problem, trial.coefficients, parameters, sources
        )
        shift, marker_columns = (
            sources.effects[opened.locate_in(sources.names)],
            moves.coefficients.shape[1],
        )
        unit_moves = moves.append_unknowns()
        # the same covariance by as many columns as the trial has unknowns, of thousands of sources
        root = np.asarray(np.linalg.qr(shift.T, mode="r")).T
        rates = measurement_errors.compute_wrench_rates(basis.time, wrenches)
        coarse = None if trial.problem.penalty else _refit_coarser(basis, trial.coefficients)
        names = [*moves.clusters, *feet, "plate/clock"]
        names += [f"inertia/{n}" for n in range(by_kept.shape[1])] + (
            ["bandwidth"] if coarse else []
        )
        repeated = max(plates.memory * spline.compute_frame_rate(basis), 1.0)
        valid = np.flatnonzero(trial.reactions.valid)
        for at in (valid[k : k + BLOCK] for k in range(0, len(valid), BLOCK)):
            q, v, a = (basis.evaluate(trial.coefficients, k)[at] for k in range(3))
            residual = derivatives.compute_root_residual(
                parameters, opened.chain.free[: opened.joint_parameters], q, v, a, wrenches[at]
            )
            by_state = np.concatenate(
                [residual.by_position, residual.by_velocity, residual.by_acceleration], axis=2
            )
            every = unit_moves.propagate(basis, at, by_state, residual.by_parameter)
            unknown, columns = every[:, :, marker_columns:], [every[:, :, :marker_columns]]
            columns.append(
                _compute_plate_errors(
                    q,
                    measurement_errors.compute_wrench_errors(
                        wrenches[at], rates[at], plates.errors
                    ),
                )
            )
            columns.append(residual.regressor @ by_kept)
            if coarse:
                q, v, a = (coarse[0].evaluate(coarse[1], k)[at] for k in range(3))
                other = inverse_dynamics.compute_pelvis_residual(
                    q, dynamics.compute_forces(q, v, a, wrenches[at])
                )
                columns.append((residual.value - other)[:, :, None])
            moved = np.concatenate(columns, axis=2)
            rows = scale[:, None] * (residual.regressor @ by_variable)
            """(frames, 6, n) A."""
            flat = (scale[:, None] * rows).reshape(-1, chart.size)
            of_sources += flat.T @ unknown.reshape(len(flat), -1) @ shift
            for name, score in zip(names, moved.reshape(len(flat), -1).T @ flat, strict=True):
                summed[name] = summed.get(name, 0.0) + score
            covariance += repeated * np.einsum("fin,i,fim->nm", rows, (scale * rest) ** 2, rows)
            total += (
                (moved**2).sum(axis=(0, 2))
                + ((unknown @ root) ** 2).sum(axis=(0, 2))
                + len(at) * rest**2
            )
            frames += len(at)
    for name, score in zip(sources.sources, of_sources.T, strict=True):
        summed[name] = summed.get(name, 0.0) + score
    scores = np.stack(list(summed.values()), axis=1)
    mean = np.sqrt(total.reshape(2, 3).mean(axis=1) / max(frames, 1))
    return ResidualNoise(
        covariance=covariance + scores @ scores.T,
        rms_force=float(mean[0]),
        rms_moment=float(mean[1]),
    )


def _compute_plate_errors(q: Array, errors: Array) -> Array:
    """Compute residual changes (frames, 6, k) by errors (frames, 2, 6, k) of foot wrenches."""
    force, moment = -errors[:, :, :3].sum(axis=1), -errors[:, :, 3:].sum(axis=1)
    return np.concatenate([force, moment - np.cross(q[:, :3, None], force, axis=1)], axis=1)


def _refit_coarser(
    basis: spline.SplineBasis, coefficients: Array
) -> tuple[spline.SplineBasis, Array]:
    """Refit the same motion with longer knot spans."""
    spans = max(round((basis.control_points - spline.MINIMUM_NODES + 1) / COARSER_SPANS), 1)
    coarse = spline.build_spline_basis(basis.time, spans + spline.MINIMUM_NODES - 1)
    return coarse, coarse.fit(basis.evaluate(coefficients))


def keep_nominal(
    seed: Array,
    which: InertialSet,
    settings: inertial_calibration.ConsistentSettings = inertial_calibration.PEOPLE,
    rms: tuple[float, float] = (np.nan, np.nan),
    why: str = "",
) -> inertial_calibration.InertialFit:
    """Keep the seed, with the spread of people about it.

    Parameters
    ----------
    seed : (84,) array
        Inertial parameters, SI units.
    which : InertialSet
        Variables that are not fitted.
    settings : ConsistentSettings
        Spread of people.
    rms : tuple of float
        RMS residual force (N) and moment (N·m) of the seed.
    why : str
        Reason, for the message.

    Returns
    -------
    InertialFit
        With `moved` false.
    """
    chart = inertial_calibration.LogChart(seed, which)
    return inertial_calibration.InertialFit(
        names=which.names,
        inertial=seed,
        jacobian=chart.compute_jacobian(np.zeros(chart.size)),
        residual_jacobian=np.diag(1.0 / chart.compute_spread(settings)),
        rms_force=rms[0],
        rms_moment=rms[1],
        iterations=0,
        seconds=0.0,
        converged=True,
        message=f"inertial parameters stay the table's{why and f': {why}'}",
        moved=False,
    )


def describe_residual(rms: tuple[float, float]) -> str:
    """Describe the RMS pelvis residual (N, N·m), for a sentence."""
    return f"the pelvis residual ({rms[0]:.1f} N, {rms[1]:.1f} N·m RMS)"


def compute_fixed_spread(inertial: Array, which: InertialSet) -> Array:
    """Compute the spread of the mass centres that no variable of `which` changes.

    They keep the values of the table, and people scatter about them. Pelvis and trunk are taken as
    symmetric.

    Parameters
    ----------
    inertial : (84,) array
        Inertial parameters, SI units.
    which : InertialSet
        Fitted variables.

    Returns
    -------
    (84, n) array
        R with covariance R R^T.
    """
    every = make_full_set()
    chart = inertial_calibration.LogChart(inertial, every)
    free = np.abs(which.selection).sum(axis=1) > 0
    limb = [name.split(".")[0].endswith(("_r", "_l")) for name in every.names]
    scatter = [
        ".com." in n and (paired or not n.endswith(".lat"))
        for n, paired in zip(every.names, limb, strict=True)
    ]
    kept = np.flatnonzero(scatter & ~free)
    return (
        chart.compute_jacobian(np.zeros(chart.size))
        * chart.compute_spread(inertial_calibration.PEOPLE)
    )[:, kept]


def fit_by_evidence(
    equations: inertial_calibration.RootEquations,
    seed: Array,
    which: InertialSet,
    noise: ResidualNoise,
    settings: inertial_calibration.ConsistentSettings = inertial_calibration.PEOPLE,
) -> inertial_calibration.InertialFit:
    """Fit inertial parameters by generalised least squares if the evidence is strong.

    Inertias stay physically possible with unchanged total mass. The seed is kept unless the Bayes
    factor of the residual exceeds `STRONG`.

    Parameters
    ----------
    equations : RootEquations
        The pelvis residual.
    seed : (84,) array
        Inertial parameters of the table, SI units.
    which : InertialSet
        Free variables.
    noise : ResidualNoise
        Noise for the chart that begins at `seed`, with the scale of `equations`.
    settings : ConsistentSettings
        Spread of people.

    Returns
    -------
    InertialFit
        `moved` is true if the values differ from the seed.
    """
    began = time.perf_counter()
    chart = inertial_calibration.LogChart(seed, which)
    spread, start = chart.compute_spread(settings), np.zeros(chart.size)
    rows = inertial_calibration.differentiate_by_inertial(
        equations.factor, seed
    ) @ chart.compute_jacobian(start)
    values, vectors = np.linalg.eigh(noise.covariance)
    observable = values > NULL_DIRECTION * values[-1]
    weigh = (vectors[:, observable] / np.sqrt(values[observable])).T @ rows.T
    """G^-1/2 A^T."""
    gap = equations.factor @ compute_dynamic_parameters(seed).ravel() + equations.target
    factor = compute_log_bayes_factor(weigh @ gap, weigh @ rows * spread)
    explained = f"({noise.rms_force:.1f} N, {noise.rms_moment:.1f} N·m)"
    before = equations.compute_rms(seed)
    if factor < STRONG:
        exceeds_noise = before[0] > noise.rms_force or before[1] > noise.rms_moment
        if exceeds_noise:
            why = (
                f"is more than marker noise, bandwidth and plates explain {explained}, but does "
                "not change as with other masses"
            )
        else:
            why = f"is explained by marker noise, bandwidth and plates {explained}"
        stay = keep_nominal(
            seed, which, settings, before, f"{describe_residual(before)} {why}; ln K = {factor:.1f}"
        )
        return replace(stay, seconds=time.perf_counter() - began)
    result, slopes = inertial_calibration.fit_chart(equations, chart, spread, weigh, start)
    found = inertial_calibration.make_inertial_fit(equations, chart, result, slopes, began)
    message = (
        f"{found.message}; {describe_residual(before)} changes as with other masses, ln K = "
        f"{factor:.1f}; marker noise, bandwidth and plates explain {explained}"
    )
    return replace(found, message=message)


def compute_log_bayes_factor(scores: Array, slopes: Array) -> float:
    """Compute ln K of whitened scores (k,) with derivatives (k, n) by variables of unit spread."""
    predicted = np.eye(len(scores)) + slopes @ slopes.T
    gain = float(scores @ scores - scores @ np.linalg.solve(predicted, scores))
    return 0.5 * (gain - float(np.linalg.slogdet(predicted)[1]))
