"""Steps that go further: they end where plain ones end, sooner, and never uphill."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from gaitcal.motion.descent import DescentSettings, Evaluation, Step, descend, further
from tests.derivatives import Array

RNG = np.random.default_rng(8)


@dataclass(frozen=True)
class _Factor:
    matrix: Array

    def solve(self, gradient: Array) -> Array:
        return np.asarray(np.linalg.solve(self.matrix, gradient))


@dataclass(frozen=True)
class _Linear:
    evaluation: Evaluation
    matrix: Array
    spent = False

    def factor(self, damping: float) -> _Factor:
        return _Factor(self.matrix + damping * np.diag(np.diag(self.matrix)))


class _Wrong:
    """x^T H x + 1 + bump |x|^4, with a matrix that overrates two directions of H threefold and half again."""

    nothing_left = 0.0
    has_curvature = False

    def __init__(self, bump: float = 0.0) -> None:
        basis = np.linalg.qr(RNG.normal(size=(6, 6)))[0]
        values = np.array([40.0, 9.0, 4.0, 2.0, 1.0, 0.3])
        self.hessian = basis * values @ basis.T
        self.matrix = basis * (values * [1.0, 1.0, 1.0, 1.5, 1.0, 3.0]) @ basis.T
        self.bump, self.costs = bump, list[float]()

    def evaluate(self, x: Array) -> Evaluation:
        squared = float(x @ x)
        cost = float(x @ self.hessian @ x) + 1.0 + self.bump * squared**2
        return Evaluation(cost, self.hessian @ x + 2.0 * self.bump * squared * x)

    def linearise(self, x: Array, *, curved: bool) -> _Linear:
        here = self.evaluate(x)
        self.costs.append(here.cost)
        return _Linear(here, self.matrix)


def test_two_steps_along_one_line_lead_to_its_minimum() -> None:
    """On x^2 with twice its curvature, every plain step goes half of the way."""
    before = Step(np.array([8.0]), np.array([-4.0]), np.array([8.0]))
    now = Step(np.array([4.0]), np.array([-2.0]), np.array([4.0]))
    assert further(now, before) == pytest.approx([0.0], abs=1e-12)
    assert further(now, None) is None
    upward = Step(np.array([8.0]), np.array([-4.0]), np.array([2.0]))
    assert further(now, upward) is None, "where the curvature is not positive nothing is known"


@pytest.mark.parametrize("bump", [0.0, 0.5])
def test_slow_steps_end_sooner_at_the_same_minimum(bump: float) -> None:
    start = RNG.normal(size=6)
    settings = DescentSettings(gain=1e-10, keep_within=0.0)
    plain, quick = _Wrong(bump), _Wrong(bump)
    quick.hessian, quick.matrix = plain.hessian, plain.matrix
    slow = descend(plain, start, settings)
    fast = descend(quick, start, DescentSettings(gain=1e-10, keep_within=0.0, goes_further=True))
    assert slow.converged and fast.converged
    np.testing.assert_allclose(fast.x, slow.x, atol=1e-4)
    assert len(quick.costs) < 0.7 * len(plain.costs)


def test_a_leap_that_does_not_gain_is_not_taken() -> None:
    """Where everything but the plain step is a wall, the plain step is taken."""

    class Walled(_Wrong):
        def evaluate(self, x: Array) -> Evaluation:
            here = super().evaluate(x)
            return here if not leaps or np.abs(x - leaps[-1]).max() > 1e-12 else Evaluation(1e9, here.gradient)

    leaps = list[Array]()
    problem = Walled()
    start = RNG.normal(size=6)

    def noted(now: Step, before: Step | None) -> Array | None:
        leap = further(now, before)
        if leap is not None:
            leaps.append(leap)
        return leap

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("gaitcal.motion.descent.further", noted)
        end = descend(problem, start, DescentSettings(gain=1e-8, keep_within=0.0, goes_further=True))
    assert leaps and end.converged
    np.testing.assert_allclose(end.x, 0.0, atol=1e-3)
