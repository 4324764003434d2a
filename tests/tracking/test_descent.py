"""The one iteration: minima of plain functions, and an ending that says what happened, through all
that use it.
"""

from collections.abc import Container
from dataclasses import dataclass, replace

import numpy as np
import pytest

from gaitcal.calibration.reduced_problem import ReducedProblem
from gaitcal.model.nominal import published_model
from gaitcal.montecarlo.draw import refit
from gaitcal.montecarlo.protocol import MonteCarloSettings
from gaitcal.reproduction.recovery import descend_together
from gaitcal.tracking.banded import NormalEquations
from gaitcal.tracking.descent import DescentSettings, Ending, Evaluation, descend
from gaitcal.tracking.motion import SharedMotions, track_coefficients
from gaitcal.tracking.trial_problem import MotionProblem
from tests.derivatives import Array, seeded_trial

KNEE = ("knee_r.thigh.sup", "knee_r.shank.sup")


@dataclass(frozen=True)
class _Dense:
    """M as a dense matrix."""

    matrix: Array

    def solve(self, gradient: Array) -> Array:
        return np.asarray(np.linalg.solve(self.matrix, gradient))


class _Rosenbrock:
    """r = (10 (y - x^2), 1 - x), whose valley is curved; the minimum is 0 at (1, 1)."""

    nothing_left = 1e-28
    has_curvature = False

    def __init__(self) -> None:
        self.matrices = 0

    def evaluate(self, x: Array) -> Evaluation:
        residual, jacobian = self._parts(x)
        return Evaluation(float(residual @ residual), jacobian.T @ residual)

    def linearise(self, x: Array, *, curved: bool) -> "_Linear":
        assert not curved
        self.matrices += 1
        jacobian = self._parts(x)[1]
        return _Linear(self.evaluate(x), jacobian.T @ jacobian)

    @staticmethod
    def _parts(x: Array) -> tuple[Array, Array]:
        residual = np.array([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]])
        return residual, np.array([[-20.0 * x[0], 10.0], [-1.0, 0.0]])


@dataclass(frozen=True)
class _Linear:
    evaluation: Evaluation
    matrix: Array
    spent: bool = False

    def factor(self, damping: float) -> _Dense:
        return _Dense(self.matrix + damping * np.diag(np.diag(self.matrix)))


class _Uphill(_Rosenbrock):
    """Its gradient points the wrong way: every step raises the cost."""

    def evaluate(self, x: Array) -> Evaluation:
        plain = super().evaluate(x)
        return Evaluation(plain.cost, -plain.gradient)


@pytest.mark.parametrize(
    ("settings", "endings"),
    [
        (DescentSettings(), Ending),
        (DescentSettings(first_damping=1e-3, keep_within=0.0), Ending),
        # with damping of 1e9 the first steps gain next to nothing: that says nothing of the minimum
        (DescentSettings(first_damping=1e9), Ending),
        (DescentSettings(gain=0.0, shortest_step=1e-3), (Ending.SHORT_STEP, Ending.NOTHING_LEFT)),
    ],
)
@pytest.mark.parametrize("start", [(-1.2, 1.0), (3.0, -4.0), (0.9, 0.8)])
def test_the_minimum_of_a_curved_valley_is_found(
    settings: DescentSettings, endings: Container[Ending], start: tuple[float, float]
) -> None:
    end = descend(_Rosenbrock(), np.array(start), settings)
    assert end.converged and end.ending in endings
    np.testing.assert_allclose(end.x, [1.0, 1.0], atol=1e-6)


def test_a_known_factor_spares_the_first_matrix() -> None:
    start = np.array([0.98, 0.96])
    problem = _Rosenbrock()
    known = problem.linearise(start, curved=False).factor(0.0)
    problem.matrices = 0
    found = descend(problem, start, DescentSettings(keep_within=np.inf), known)
    with_known, problem.matrices = problem.matrices, 0
    descend(problem, start, DescentSettings(keep_within=np.inf))
    assert found.converged
    assert with_known < problem.matrices


def test_every_step_uphill_is_told() -> None:
    start = np.array([-1.2, 1.0])
    end = descend(_Uphill(), start, DescentSettings())
    assert (end.ending, end.converged) == (Ending.NO_DESCENT, False)
    np.testing.assert_array_equal(end.x, start)
    impatient = descend(_Uphill(), start, DescentSettings(persistent=False))
    assert (impatient.ending, impatient.converged) == (Ending.SLOW, False)
    few = descend(_Uphill(), start, DescentSettings(most_steps=3))
    assert (few.ending, few.steps) == (Ending.MOST_STEPS, 3)
    lost = descend(_Rosenbrock(), np.array([np.nan, 1.0]), DescentSettings())
    assert lost.ending is Ending.NOT_FINITE


class _Saddle(_Rosenbrock):
    """x^2 + 1 with a matrix of the wrong sign: its steps lead uphill and promise less
    than nothing.
    """

    def evaluate(self, x: Array) -> Evaluation:
        return Evaluation(float(x @ x) + 1.0, x.copy())

    def linearise(self, x: Array, *, curved: bool) -> "_Linear":
        return _Linear(self.evaluate(x), -np.eye(len(x)))


class _Step(_Rosenbrock):
    """1 at the start and 2 elsewhere, with a gradient too small to promise much."""

    def evaluate(self, x: Array) -> Evaluation:
        return Evaluation(1.0 if not x.any() else 2.0, np.full(len(x), 1e-4))

    def linearise(self, x: Array, *, curved: bool) -> "_Linear":
        return _Linear(self.evaluate(x), np.eye(len(x)))


@pytest.mark.parametrize("damping", [0.0, 1e-3])
def test_no_step_that_raises_the_cost_converges(damping: float) -> None:
    settings = DescentSettings(first_damping=damping, keep_within=0.0)
    saddle = descend(_Saddle(), np.ones(2), settings)
    assert (saddle.ending, saddle.x.tolist()) == (Ending.NO_DESCENT, [1.0, 1.0])
    if damping:  # without, the step is the last by its prediction alone
        assert descend(_Step(), np.zeros(2), settings).ending is Ending.NO_DESCENT


@pytest.fixture
def uphill(monkeypatch: pytest.MonkeyPatch) -> tuple[MotionProblem, Array]:
    """A trial whose gradients all point the wrong way, and where to start."""
    rng, _, problem, true = seeded_trial(12, frames=40, nodes=8)
    equations, gradients = MotionProblem.assemble_motion_equations, MotionProblem.compute_gradients

    def wrong_equations(*a: object, **k: object) -> NormalEquations:
        right = equations(*a, **k)  # type: ignore[arg-type]
        return replace(
            right, node_gradient=-right.node_gradient, parameter_gradient=-right.parameter_gradient
        )

    def wrong_gradients(*a: object) -> tuple[float, Array, Array]:
        cost, by_node, by_parameter = gradients(*a)  # type: ignore[arg-type]
        return cost, -by_node, -by_parameter

    monkeypatch.setattr(MotionProblem, "assemble_motion_equations", wrong_equations)
    monkeypatch.setattr(MotionProblem, "compute_gradients", wrong_gradients)
    return problem, true + rng.normal(0, 0.05, true.shape)


def test_everything_that_iterates_says_so(uphill: tuple[MotionProblem, Array]) -> None:
    """Tracking, a far start, the reduced problem and a re-fit."""
    problem, start = uphill
    parameters = published_model().parameters
    body, p = problem.build_body(parameters), problem.with_free(KNEE).get_values(parameters)
    settings = DescentSettings(curved_tries=0)
    tracked = track_coefficients(problem, body, start, settings)
    _, _, together = descend_together([problem], parameters, KNEE, [start], p)
    for found in (tracked, together):
        assert (found.ending, found.converged) == (Ending.NO_DESCENT, False)
    shared = SharedMotions([problem], parameters, KNEE).evaluate(np.concatenate([p, start.ravel()]))
    assert shared.cost == together.cost
    reduced = ReducedProblem([problem], parameters, KNEE, [start], settings)
    assert not reduced.at(p).trials[0].converged and not reduced.settle(p).trials[0].converged
    assert refit(problem, body, start, MonteCarloSettings()).failure == Ending.NO_DESCENT.value
