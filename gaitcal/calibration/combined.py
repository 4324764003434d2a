"""Third step: joint parameters, inertial parameters and motions combined, against markers and
ground reactions.

    min  sum_m w |r_m|^2 / sigma_m^2  +  sum_f { |F|^2 / sigma_F^2 + |T|^2 / sigma_T^2 }
         +  |x / spread|^2

sigma_m is the marker residual that phase 1 left (per coordinate); sigma_F = s BW and sigma_T = s BW
H with one figure s, the weight between markers and loads: the pelvis residual that measurement
alone explains. x are the variables of `inertial_calibration.py`. Residual loads depend on
positions, velocities and accelerations, hence on the same six control points as the markers of the
frame. So the normal matrix keeps its band, and (joint, inertial) parameters are the arrow's point
(`tracking/banded.py`). Levenberg-Marquardt starts at the end of phases 1 and 2.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.calibration.inertial_calibration import ConsistentSettings, LogChart
from gaitcal.dynamics.derivatives import RootResidual, compute_root_residual
from gaitcal.model.parameters import JP_INDEX, InertialSet, Parameters, compute_dynamic_jacobian
from gaitcal.model.subject_model import Subject
from gaitcal.tracking.banded import ArrowEquations, NormalEquations, SharedPrior
from gaitcal.tracking.descent import DescentSettings, Ending, Evaluation, descend
from gaitcal.tracking.motion import SharedMotions
from gaitcal.tracking.spline import ORDER, SplineBasis
from gaitcal.tracking.trial_problem import MotionProblem

DESCENT = DescentSettings(first_damping=1e-4, lowered_by=10.0, keep_within=0.0, most_steps=60)
"""Slightly damped at first: markers and loads disagree at the end of phases 1 and 2."""


@dataclass(frozen=True)
class CombinedProblem:
    """A trial of the combined fit."""

    problem: MotionProblem
    coefficients: Array  # (nn, nq) where phases 1 and 2 ended
    # (nf, 2, 6) ground reactions of a whole-body trial; None: markers only
    wrench: Array | None = None
    # (nf,) frames whose residual counts; None: all
    valid: BoolArray | None = None


@dataclass(frozen=True)
class CombinedSettings:
    """Weights and tolerances of the combined fit."""

    # s: standard deviation of F / BW and of T / (BW H) that measurement alone explains
    load_share: float = 0.005
    spread: ConsistentSettings = field(default_factory=ConsistentSettings)
    descent: DescentSettings = DESCENT


@dataclass(frozen=True, kw_only=True)
class CombinedFit:
    """Result of the combined fit."""

    parameters: Parameters
    coefficients: tuple[Array, ...]
    marker_sigma: float  # m, per coordinate
    load_share: float
    cost: float
    steps: int
    seconds: float
    ending: Ending

    @property
    def converged(self) -> bool:
        """Whether it reached its tolerance."""
        return self.ending.converged


def fit_combined(
    trials: Sequence[CombinedProblem],
    parameters: Parameters,
    free: tuple[str, ...],
    which: InertialSet,
    subject: Subject,
    settings: CombinedSettings | None = None,
) -> CombinedFit:
    """Fit joint parameters, inertial variables and all motions together.

    Parameters
    ----------
    trials : sequence of CombinedProblem
        Trials with their motions where phases 1 and 2 ended.
    parameters : Parameters
        Start values, and values of the parameters that are not free.
    free : tuple of str
        Free joint parameters.
    which : InertialSet
        Free inertial variables.
    subject : Subject
        Weight and height scale the loads.
    settings : CombinedSettings, optional
        Weights and tolerances.

    Returns
    -------
    CombinedFit
        Parameters and coefficients at the minimum.
    """
    began = time.perf_counter()
    settings = settings or CombinedSettings()
    problem = _MarkersAndLoads(trials, parameters, free, which, subject, settings)
    theta = np.concatenate(
        [parameters.joint[[JP_INDEX[n] for n in free]], np.zeros(problem.chart.size)]
    )
    end = descend(
        problem,
        problem.join_unknowns(theta, [trial.coefficients for trial in trials]),
        settings.descent,
    )
    theta, coefficients = problem.split_unknowns(end.x)
    return CombinedFit(
        parameters=problem.parameters_at(theta),
        coefficients=tuple(coefficients),
        marker_sigma=problem.sigma,
        load_share=settings.load_share,
        cost=end.cost,
        steps=end.steps,
        seconds=time.perf_counter() - began,
        ending=end.ending,
    )


class _MarkersAndLoads(SharedMotions):
    """Cost by theta = (joint parameters, inertial variables) and the coefficients of each trial."""

    def __init__(
        self,
        trials: Sequence[CombinedProblem],
        parameters: Parameters,
        free: tuple[str, ...],
        which: InertialSet,
        subject: Subject,
        settings: CombinedSettings,
    ) -> None:
        super().__init__([trial.problem for trial in trials], parameters, free)
        self.chart = LogChart(parameters.inertial, which)
        self.size = len(free) + self.chart.size
        self.nothing_left = 0.0
        self.trials = trials
        self.precision = 1.0 / self.chart.compute_spread(settings.spread)
        square = count = 0.0
        for trial, problem in zip(trials, self.open, strict=True):
            square += problem.compute_marker_cost(
                trial.coefficients, problem.build_body(parameters)
            )
            count += 3.0 * float((problem.data.weight > 0).sum())
        self.sigma = float(np.sqrt(square / count))
        """m per coordinate: the marker residual at the start, over all trials."""
        scale = settings.load_share * subject.weight
        self.load_weight = np.repeat([1.0 / scale, 1.0 / (scale * subject.height)], 3)
        """(6,) one over sigma_F (1/N) and sigma_T (1/(N m))."""

    def parameters_at(self, theta: Array) -> Parameters:
        """Return the parameters of the linkage at theta."""
        split = len(self.free)
        moved = self.parameters.with_joint(self.free, theta[:split])
        return moved.with_inertial(self.chart.compute_inertial(theta[split:]))

    def evaluate(self, x: Array) -> Evaluation:
        """Evaluate cost and half gradient (no unit); only the markers restrict joint parameters."""
        return self.linearise(x, curved=False).evaluation

    def linearise(self, x: Array, *, curved: bool) -> ArrowEquations:
        """Form the equations at x, with the arrow."""
        theta, coefficients = self.split_unknowns(x)
        parameters = self.parameters_at(theta)
        equations = [
            self._form_equations(k, parameters, theta, n) for k, n in enumerate(coefficients)
        ]
        # only the markers restrict joint parameters: no prior on them
        precision = np.concatenate([np.zeros(len(self.free)), self.precision])
        scaled = precision * theta
        prior = SharedPrior(float(scaled @ scaled), precision * scaled, np.diag(precision**2))
        return ArrowEquations(equations, [np.arange(self.size)] * len(equations), self.size, prior)

    def _form_equations(
        self, k: int, parameters: Parameters, theta: Array, coefficients: Array
    ) -> NormalEquations:
        """Form the equations of one trial: markers in units of sigma_m, and its loads."""
        problem, trial, columns = self.open[k], self.trials[k], self.columns[k]
        marker = problem.assemble_equations(
            coefficients, problem.build_body(parameters)
        ).scale_cost(1.0 / self.sigma**2)
        mixed, corner = np.zeros((coefficients.size, self.size)), np.zeros((self.size, self.size))
        gradient = np.zeros(self.size)
        mixed[:, columns], gradient[columns] = marker.mixed, marker.parameter_gradient
        corner[np.ix_(columns, columns)] = marker.parameters
        placed = replace(marker, mixed=mixed, parameters=corner, parameter_gradient=gradient)
        if trial.wrench is None:
            return placed
        valid = np.ones(len(problem.basis.time), bool) if trial.valid is None else trial.valid
        q, v, a = (problem.basis.evaluate(coefficients, d)[valid] for d in range(3))
        load = compute_root_residual(parameters, self.free, q, v, a, trial.wrench[valid])
        by_theta = self._differentiate_residual(load, parameters, theta)
        return _with_loads(placed, problem.basis, valid, load, by_theta, self.load_weight)

    def _differentiate_residual(
        self, load: RootResidual, parameters: Parameters, theta: Array
    ) -> Array:
        """Differentiate the root residual by theta, in standard deviations: (frames, 6, size)."""
        frames = len(load.value)
        by_dynamic = load.regressor.reshape(frames, 6, -1, 10)
        by_inertial = np.einsum(
            "frsd,sdk->frsk", by_dynamic, compute_dynamic_jacobian(parameters.inertial)
        )
        out = np.zeros((frames, 6, self.size))
        out[:, :, [self.free.index(n) for n in load.free]] = load.by_parameter
        split = len(self.free)
        out[:, :, split:] = by_inertial.reshape(frames, 6, -1) @ self.chart.compute_jacobian(
            theta[split:]
        )
        out *= self.load_weight[None, :, None]
        return out


def _with_loads(
    markers: NormalEquations,
    basis: SplineBasis,
    valid: BoolArray,
    load: RootResidual,
    by_theta: Array,
    weight: Array,
) -> NormalEquations:
    """Add the root residuals of the valid frames to the equations of the markers, in place."""
    value = load.value * weight
    corner = markers.parameters + np.einsum("fri,frj->ij", by_theta, by_theta)
    corner_gradient = markers.parameter_gradient + np.einsum("fri,fr->i", by_theta, value)
    nn, nq = markers.node_gradient.shape
    gradient = markers.node_gradient.reshape(nn * nq)
    # Row of each frame in the arrays over valid frames; the six nodes of a span are neighbours in
    # the band.
    row, within = np.cumsum(valid) - 1, ORDER * nq
    i, j = np.tril_indices(within)
    for first_node, frames in basis.spans:
        here = row[frames][valid[frames]]
        if not len(here):
            continue
        # d residual / d node k, coordinate q = d/dq B_k + d/dv B'_k + d/da B''_k: (frames, 6 rows,
        # 6 nodes, nq)
        b, rate, acceleration = (
            w[frames][valid[frames]] for w in (basis.value, basis.rate, basis.acceleration)
        )
        by_node = (
            np.einsum("fk,frq->frkq", b, load.by_position[here])
            + np.einsum("fk,frq->frkq", rate, load.by_velocity[here])
            + np.einsum("fk,frq->frkq", acceleration, load.by_acceleration[here])
        )
        matrix = (by_node.reshape(len(here), 6, within) * weight[None, :, None]).reshape(-1, within)
        start = first_node * nq
        gram = matrix.T @ matrix
        markers.band[start + j, i - j] += gram[
            i, j
        ]  # entry (i, j) of a lower band stands at row j, column i - j
        span = slice(start, start + within)
        markers.mixed[span] += matrix.T @ by_theta[here].reshape(len(matrix), -1)
        gradient[span] += matrix.T @ value[here].ravel()
    return replace(
        markers,
        cost=markers.cost + float(np.sum(value**2)),
        parameters=corner,
        node_gradient=gradient.reshape(nn, nq),
        parameter_gradient=corner_gradient,
    )
