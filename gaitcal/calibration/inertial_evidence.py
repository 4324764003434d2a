"""What else than wrong masses makes a pelvis residual, and how much of it a change of the masses would look like.

With rho the pelvis residual [F; T] of the valid frames, in units of a scale, every source c of error moves it by

    d rho_c = (d rho/d q) B d N_c + (d rho/d v) B' d N_c + (d rho/d a) B'' d N_c + (d rho/d p) d p_c

for marker coordinates and nominal joint parameters (`influence.py`), and directly for

    plates       gain, place, turn and clock:  d F = -d F_foot,  d T = -(d M_foot - x_pelvis x d F_foot)
                 (`dynamics/plate_errors.py`, with the sources of their sizes)
    inertia      what the fit does not move and people scatter in:  d rho = (d rho/d IP) d IP
    bandwidth    rho of this motion less rho of its fit with 1 / sqrt 2 of the knot spans: what half an octave holds
                 (a motion that a penalty smooths has a source of its own for that, `trial_scores`)
    the rest     independent errors of force and moment, repeated for `memory`: what plates bend, and the spline leaves.

A fit of inertial variables x hears of the residual through the scores A^T rho alone, A = d rho/d x at the nominal
model: their covariance is sum_c s_c s_c^T + sigma^2 A^T A times the frames that repeat each other, s_c = A^T d rho_c.
Sources that several trials share are summed before they are squared.

Inertial parameters move where the pelvis residual asks for it, and nowhere else.

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
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from gaitcal.arrays import Array, IntArray
from gaitcal.calibration.error_sources import ErrorSources, TrialScores, trial_scores
from gaitcal.calibration.inertial_calibration import (
    ConsistentSettings,
    InertialFit,
    LogChart,
    RootEquations,
    by_inertial,
)
from gaitcal.calibration.joint_calibration import ending
from gaitcal.dynamics.derivatives import RootResidual, root_residual
from gaitcal.dynamics.ground_reactions import GroundReactions
from gaitcal.dynamics.inverse_dynamics import FEET, Dynamics, pelvis_residual
from gaitcal.dynamics.plate_errors import DEFAULT, OF_A_PLATE, PlateErrors, wrench_errors, wrench_rates
from gaitcal.model.parameters import InertialSet, Parameters, dynamic_jacobian, dynamic_parameters, full_set
from gaitcal.model.subject_model import Subject
from gaitcal.motion.spline import MINIMUM_NODES, ORDER, SplineBasis, basis_matrix, frame_rate, spline_basis
from gaitcal.motion.trial_problem import TrialProblem

BLOCK = 500
"""Frames whose changes are held at once."""
COARSER = np.sqrt(2.0)
"""Spans of the motion that bandwidth is judged by, over those of the motion: half an octave."""


@dataclass(frozen=True)
class PlateNoise:
    """How far force plates are to be believed where residuals are weighed."""

    errors: PlateErrors = DEFAULT
    rest: float = 0.005
    """Body weights (force), body weights times height (moment), independent from one `memory` to the next."""
    memory: float = 0.1
    """s, for which an error of the rest repeats itself."""


@dataclass(frozen=True, kw_only=True)
class LoadedProblem:
    """A gait trial with its motion and the ground reactions on it."""

    problem: TrialProblem
    """Of the whole body, with the skin that moves."""
    nodes: Array
    """(nn, 27)."""
    reactions: GroundReactions
    scores: TrialScores | None = None
    """Of its markers, where known already (`whole_body_scores`)."""


@dataclass(frozen=True, kw_only=True)
class ResidualNoise:
    """What a fit of inertial variables hears that is not theirs."""

    covariance: Array
    """(n, n) of the scores A^T rho, rho in units of the scale."""
    rms_force: float
    """N, RMS over valid frames and three components of the residual that is to be expected."""
    rms_moment: float
    """N·m."""


def residual_noise(
    trials: Sequence[LoadedProblem],
    parameters: Parameters,
    influence: ErrorSources,
    subject: Subject,
    chart: LogChart,
    length: float,
    plates: PlateNoise | None = None,
    unmoved: Array | None = None,
) -> ResidualNoise:
    """What noise makes of the pelvis residual over the valid frames of all trials.

    Parameters
    ----------
    parameters : joint parameters of the motions; the inertial ones are where `chart` begins.
    influence : errors of the joint parameters.
    length : m, torques are divided by body weight times this, as in the equations that are to be fitted.
    unmoved : (84, n) R with covariance R R^T of inertial parameters that `chart` does not move; exact unless given.
    """
    plates = plates or PlateNoise()
    slopes = dynamic_jacobian(parameters.inertial)
    kept = np.zeros((len(parameters.inertial), 0)) if unmoved is None else unmoved
    by_variable, by_kept = (
        np.einsum("sdk,skn->sdn", slopes, x.reshape(len(slopes), 7, -1)).reshape(10 * len(slopes), -1)
        for x in (chart.jacobian(np.zeros(chart.size)), kept)
    )
    scale = np.repeat([1.0 / subject.weight, 1.0 / (subject.weight * length)], 3)
    rest = plates.rest * subject.weight * np.repeat([1.0, subject.height], 3)
    total, covariance = np.zeros(6), np.zeros((chart.size, chart.size))
    scores: dict[str, Array] = {}
    frames = 0
    for trial in trials:
        sources = _TrialSources(trial, parameters, influence, plates)
        repeated = max(plates.memory * frame_rate(trial.problem.basis), 1.0)
        for at in sources.blocks():
            residual, moved = sources.at(at)
            moved = np.concatenate([moved, residual.regressor @ by_kept], axis=2)
            rows = scale[:, None] * (residual.regressor @ by_variable)
            """(frames, 6, n) A."""
            pulls = np.einsum("fin,fic->nc", rows, scale[:, None] * moved)
            for k, name in enumerate((*sources.names, *(f"inertia/{n}" for n in range(by_kept.shape[1])))):
                scores[name] = scores.get(name, 0.0) + pulls[:, k]
            covariance += repeated * np.einsum("fin,i,fim->nm", rows, (scale * rest) ** 2, rows)
            total += (moved**2).sum(axis=(0, 2)) + len(at) * rest**2
            frames += len(at)
    columns = np.stack(list(scores.values()), axis=1)
    mean = np.sqrt(total.reshape(2, 3).mean(axis=1) / max(frames, 1))
    return ResidualNoise(
        covariance=covariance + columns @ columns.T, rms_force=float(mean[0]), rms_moment=float(mean[1])
    )


class _TrialSources:
    """The sources of one trial, and what each makes of its pelvis residual."""

    def __init__(
        self, trial: LoadedProblem, parameters: Parameters, influence: ErrorSources, plates: PlateNoise
    ) -> None:
        self.trial, self.parameters, self.plates = trial, parameters, plates
        self.opened = trial.problem.with_free(influence.free)
        own = trial.scores or trial_scores(self.opened, parameters, trial.nodes)
        self.node_moves, self.sensitivity = -own.nodes, own.sensitivity
        self.shift = influence.parameters[self.opened.places_in(influence.free)]
        """(np, nc) d p_c of joint parameters, then of the skin."""
        self.known = len(influence.clusters)
        markers = (*influence.clusters, *own.clusters)
        feet = tuple(f"plate/{foot}/{what}" for foot in FEET for what in OF_A_PLATE)
        self.markers, self.names = len(markers), (*markers, *feet, "plate/clock")
        self.rates = wrench_rates(trial.problem.basis.time, trial.reactions.wrench)
        self.coarse = None if trial.problem.penalty else _coarser(trial.problem.basis, trial.nodes)
        if self.coarse:
            self.names += ("bandwidth",)
            self.dynamics = Dynamics(parameters)

    def blocks(self) -> list[IntArray]:
        """Valid frames, some at a time."""
        valid = np.flatnonzero(self.trial.reactions.valid)
        return [valid[k : k + BLOCK] for k in range(0, len(valid), BLOCK)]

    def at(self, frames: IntArray) -> tuple[RootResidual, Array]:
        """The residual, and (frames, 6, sources) what each source makes of it; N and N·m."""
        basis, wrench = self.trial.problem.basis, self.trial.reactions.wrench[frames]
        q, v, a = (basis.evaluate(self.trial.nodes, k)[frames] for k in range(3))
        free = self.opened.chain.free[: self.opened.joint_parameters]
        residual = root_residual(self.parameters, free, q, v, a, wrench)
        out = np.zeros((len(frames), 6, len(self.names)))
        by_unknown = -_through(residual, basis, frames, self.sensitivity)
        by_unknown[:, :, : residual.by_parameter.shape[2]] += residual.by_parameter
        out[:, :, : self.known] = by_unknown @ self.shift
        out[:, :, self.known : self.markers] = _through(residual, basis, frames, self.node_moves)
        plate_moves = _plate_moves(q, wrench_errors(wrench, self.rates[frames], self.plates.errors))
        out[:, :, self.markers : self.markers + plate_moves.shape[2]] = plate_moves
        if self.coarse:
            coarse, nodes = self.coarse
            q, v, a = (coarse.evaluate(nodes, k)[frames] for k in range(3))
            out[:, :, -1] = residual.value - pelvis_residual(q, self.dynamics.forces(q, v, a, wrench))
        return residual, out


def _through(residual: RootResidual, basis: SplineBasis, frames: IntArray, columns: Array) -> Array:
    """(frames, 6, k) change of the residual by changes of the nodes (nn * nq, k)."""
    nq = residual.by_position.shape[2]
    near = slice(int(basis.first[frames[0]]), int(basis.first[frames[-1]]) + ORDER)
    by_node = columns[near.start * nq : near.stop * nq].reshape(near.stop - near.start, -1)
    out = np.zeros((len(frames), 6, columns.shape[1]))
    for k, slope in enumerate((residual.by_position, residual.by_velocity, residual.by_acceleration)):
        out += slope @ (basis_matrix(basis, k)[frames][:, near] @ by_node).reshape(len(frames), nq, -1)
    return out


def _plate_moves(q: Array, errors: Array) -> Array:
    """(frames, 6, k) change of the residual by errors of the foot wrenches (frames, 2, 6, k)."""
    force, moment = -errors[:, :, :3].sum(axis=1), -errors[:, :, 3:].sum(axis=1)
    return np.concatenate([force, moment - np.cross(q[:, :3, None], force, axis=1)], axis=1)


def _coarser(basis: SplineBasis, nodes: Array) -> tuple[SplineBasis, Array]:
    """The same motion with longer knot spans."""
    spans = max(round((basis.nodes - MINIMUM_NODES + 1) / COARSER), 1)
    coarse = spline_basis(basis.time, spans + MINIMUM_NODES - 1)
    return coarse, coarse.fit(basis.evaluate(nodes))


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
