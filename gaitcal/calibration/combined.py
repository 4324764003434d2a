"""Third step: joint parameters, inertial parameters and motions together, against markers and ground reactions.

    min  sum_m w |r_m|^2 / sigma_m^2  +  sum_f { |F|^2 / sigma_F^2 + |T|^2 / sigma_T^2 }  +  |x / spread|^2

sigma_m is the marker residual that phase 1 left (per coordinate); sigma_F = s BW and sigma_T = s BW H with one figure
s, the weight between markers and loads: how large a pelvis residual measurement alone explains. x are the variables of
`inertial_chart.py`. Residual loads depend on positions, velocities and accelerations, hence on the same six nodes as
the markers of the frame: the normal matrix keeps its band, and (joint, inertial) parameters are the arrow's point.
Levenberg-Marquardt from the end of phases 1 and 2.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gaitcal.calibration.inertial_chart import ConsistentSettings, LogChart
from gaitcal.dynamics.root_residual import root_residual
from gaitcal.model.inertial_parameters import InertialSet, dynamic_jacobian
from gaitcal.model.joint_parameters import JP_INDEX
from gaitcal.model.parameters import Parameters
from gaitcal.model.subject_model import Subject
from gaitcal.motion.banded import BandFactor
from gaitcal.motion.spline import ORDER
from gaitcal.motion.trial_problem import TrialProblem

Array = NDArray[np.float64]


@dataclass(frozen=True)
class JointStepTrial:
    """A trial of the third step."""

    problem: TrialProblem
    nodes: Array
    """(nn, nq) where phases 1 and 2 ended."""
    wrench: Array | None = None
    """(nf, 2, 6) ground reactions of a whole-body trial; None: markers only."""
    valid: NDArray[np.bool_] | None = None
    """(nf,) frames whose residual counts."""


@dataclass(frozen=True)
class JointStepSettings:
    """Weights and tolerances."""

    load_share: float = 0.005
    """s: standard deviation of F / BW and of T / (BW H) that measurement alone explains."""
    spread: ConsistentSettings = field(default_factory=ConsistentSettings)
    tolerance: float = 1e-6
    most_steps: int = 60


@dataclass(frozen=True)
class JointStepFit:
    """Where the third step ended."""

    parameters: Parameters
    nodes: tuple[Array, ...]
    marker_sigma: float
    """m, per coordinate."""
    load_share: float
    cost: float
    steps: int
    seconds: float
    converged: bool


@dataclass(frozen=True)
class _System:
    cost: float
    band: Array
    mixed: Array
    gradient: Array
    corner: Array
    corner_gradient: Array


def joint_step(
    trials: Sequence[JointStepTrial],
    parameters: Parameters,
    free: tuple[str, ...],
    which: InertialSet,
    subject: Subject,
    settings: JointStepSettings | None = None,
) -> JointStepFit:
    """Fit joint parameters `free`, the inertial variables `which` and all motions together."""
    began = time.perf_counter()
    settings = settings or JointStepSettings()
    problem = _JointStep(trials, parameters, free, which, subject, settings)
    theta = np.concatenate([parameters.joint[[JP_INDEX[n] for n in free]], np.zeros(problem.chart.size)])
    nodes = [trial.nodes for trial in trials]
    systems, damping = problem.systems(theta, nodes), 1e-4
    cost = problem.cost(theta, systems)
    converged, step = False, 0
    while step < settings.most_steps and not converged:
        step += 1
        d_theta, d_nodes = problem.step(theta, systems, damping)
        next_theta = theta + d_theta
        next_nodes = [n + d for n, d in zip(nodes, d_nodes, strict=True)]
        candidate = problem.systems(next_theta, next_nodes)
        next_cost = problem.cost(next_theta, candidate)
        if next_cost <= cost:
            converged = cost - next_cost <= settings.tolerance * cost
            theta, nodes, systems, cost = next_theta, next_nodes, candidate, next_cost
            damping = damping / 10 if damping > 1e-10 else 0.0
        else:
            damping = max(10 * damping, 1e-8)
            if damping > 1e8:
                converged = True
    return JointStepFit(
        problem.parameters_at(theta),
        tuple(nodes),
        problem.sigma,
        settings.load_share,
        cost,
        step,
        time.perf_counter() - began,
        converged,
    )


class _JointStep:
    def __init__(
        self,
        trials: Sequence[JointStepTrial],
        parameters: Parameters,
        free: tuple[str, ...],
        which: InertialSet,
        subject: Subject,
        settings: JointStepSettings,
    ) -> None:
        self.trials, self.free, self.start = trials, free, parameters
        self.chart = LogChart(parameters.inertial, which)
        self.prior = 1.0 / self.chart.spread(settings.spread)
        self.open = [trial.problem.with_free(free) for trial in trials]
        place = {name: k for k, name in enumerate(free)}
        self.columns = [np.array([place[n] for n in p.chain.free], dtype=np.intp) for p in self.open]
        self.sigma = self._marker_sigma()
        scale = settings.load_share * subject.weight
        self.load_weight = np.repeat([1.0 / scale, 1.0 / (scale * subject.height)], 3)

    def _marker_sigma(self) -> float:
        """Marker error in m per coordinate: the marker residual at the start, over all trials."""
        total, count = 0.0, 0.0
        for trial, problem in zip(self.trials, self.open, strict=True):
            total += problem.cost(trial.nodes, problem.constants(self.start))
            count += 3.0 * float((problem.data.weight > 0).sum())
        return float(np.sqrt(total / count))

    def parameters_at(self, theta: Array) -> Parameters:
        size = len(self.free)
        moved = self.start.with_joint(self.free, theta[:size])
        return moved.with_inertial(self.chart.inertial(theta[size:]))

    def cost(self, theta: Array, systems: Sequence[_System]) -> float:
        x = theta[len(self.free) :] * self.prior
        return sum(s.cost for s in systems) + float(x @ x)

    def systems(self, theta: Array, nodes: Sequence[Array]) -> list[_System]:
        parameters = self.parameters_at(theta)
        x = theta[len(self.free) :]
        return [self._system(k, parameters, x, n) for k, n in enumerate(nodes)]

    def _system(self, k: int, parameters: Parameters, x: Array, nodes: Array) -> _System:
        problem, trial, columns = self.open[k], self.trials[k], self.columns[k]
        marker = problem.equations(nodes, problem.constants(parameters))
        share, size = 1.0 / self.sigma**2, len(self.free) + self.chart.size
        mixed, corner = np.zeros((nodes.size, size)), np.zeros((size, size))
        mixed[:, columns] = share * marker.mixed
        corner[np.ix_(columns, columns)] = share * marker.parameters
        corner_gradient = np.zeros(size)
        corner_gradient[columns] = share * marker.parameter_gradient
        system = _System(
            share * marker.cost,
            share * marker.band,
            mixed,
            share * marker.node_gradient.ravel(),
            corner,
            corner_gradient,
        )
        if trial.wrench is None:
            return system
        return self._add_loads(system, problem, trial.wrench, trial.valid, parameters, x, nodes)

    def _add_loads(
        self,
        system: _System,
        problem: TrialProblem,
        wrench: Array,
        counts: NDArray[np.bool_] | None,
        parameters: Parameters,
        x: Array,
        nodes: Array,
    ) -> _System:
        basis, nq = problem.basis, nodes.shape[1]
        valid = np.ones(len(basis.time), bool) if counts is None else counts
        q, v, a = (basis.evaluate(nodes, d)[valid] for d in range(3))
        load = root_residual(parameters, self.free, q, v, a, wrench[valid])
        weight = self.load_weight[None, :, None]
        value = load.value * self.load_weight
        by_phi = dynamic_jacobian(parameters.inertial)
        by_ip = np.einsum("frsd,sdk->frsk", load.regressor.reshape(*load.value.shape, 12, 10), by_phi)
        by_x = by_ip.reshape(*load.value.shape, 84) @ self.chart.jacobian(x)
        by_theta = np.zeros((*load.value.shape, len(self.free) + self.chart.size))
        by_theta[:, :, [self.free.index(n) for n in load.free]] = load.by_parameter
        by_theta[:, :, len(self.free) :] = by_x
        by_theta *= weight
        system.corner[:] += np.einsum("fri,frj->ij", by_theta, by_theta)
        system.corner_gradient[:] += np.einsum("fri,fr->i", by_theta, value)
        rows, within = np.cumsum(valid) - 1, ORDER * nq
        i, j = np.tril_indices(within)
        for first, frames in basis.spans:
            at = rows[frames][valid[frames]]
            if not len(at):
                continue
            w0, w1, w2 = (w[frames][valid[frames]] for w in (basis.value, basis.rate, basis.acceleration))
            block = (
                np.einsum("fk,frq->frkq", w0, load.by_position[at])
                + np.einsum("fk,frq->frkq", w1, load.by_velocity[at])
                + np.einsum("fk,frq->frkq", w2, load.by_acceleration[at])
            )
            matrix = (block.reshape(len(at), 6, within) * weight).reshape(-1, within)
            start = first * nq
            gram = matrix.T @ matrix
            system.band[start + j, i - j] += gram[i, j]
            span = slice(start, start + within)
            system.mixed[span] += matrix.T @ by_theta[at].reshape(len(matrix), -1)
            system.gradient[span] += matrix.T @ value[at].ravel()
        return _System(
            system.cost + float(np.sum(value**2)),
            system.band,
            system.mixed,
            system.gradient,
            system.corner,
            system.corner_gradient,
        )

    def step(self, theta: Array, systems: Sequence[_System], damping: float) -> tuple[Array, list[Array]]:
        size = len(theta)
        matrix, right = np.zeros((size, size)), np.zeros(size)
        inertial = slice(len(self.free), size)
        matrix[inertial, inertial] = np.diag(self.prior**2)
        right[inertial] = self.prior**2 * theta[inertial]
        solved = []
        for s in systems:
            both = BandFactor(s.band, damping).solve(np.column_stack([s.mixed, s.gradient]))
            solved.append(both)
            matrix += s.corner - s.mixed.T @ both[:, :-1]
            right += s.corner_gradient - s.mixed.T @ both[:, -1]
        matrix += np.diag(damping * np.diag(sum(s.corner for s in systems)) + 1e-14 * np.trace(matrix))
        d_theta = np.asarray(-np.linalg.solve(matrix, right), dtype=np.float64)
        shapes = [trial.nodes.shape for trial in self.trials]
        return d_theta, [
            -(b[:, -1] + b[:, :-1] @ d_theta).reshape(shape) for b, shape in zip(solved, shapes, strict=True)
        ]
