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
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array, IntArray
from gaitcal.calibration.error_sources import ErrorSources, TrialScores, trial_scores
from gaitcal.calibration.inertial_chart import LogChart
from gaitcal.dynamics.derivatives import RootResidual, root_residual
from gaitcal.dynamics.ground_contact import GroundReactions
from gaitcal.dynamics.inverse_dynamics import FEET, Dynamics, pelvis_residual
from gaitcal.dynamics.plate_errors import DEFAULT, OF_A_PLATE, PlateErrors, wrench_errors, wrench_rates
from gaitcal.model.parameters import Parameters, dynamic_jacobian
from gaitcal.model.subject_model import Subject
from gaitcal.motion.spline import MINIMUM_NODES, ORDER, SplineBasis, frame_rate, spline_basis
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
        out += slope @ (basis.matrices[k][frames][:, near] @ by_node).reshape(len(frames), nq, -1)
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
