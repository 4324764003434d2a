"""The penalty against quadrature, finite differences and dense solvers; what it leaves alone."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import BSpline
from scipy.linalg import eigh
from scipy.optimize import least_squares

from gaitcal.motion.bandwidth import Smoother
from gaitcal.motion.descent import DescentSettings
from gaitcal.motion.motion import track_nodes
from gaitcal.motion.spline import DEGREE, ORDER, TENSION_HZ, frame_rate, roughness, smoothing, spline_basis, stiffness
from gaitcal.motion.trial_problem import MotionProblem
from tests.derivatives import Array, assert_derivative, perturbed_parameters, random_trial

SEGMENTS = ("pelvis", "thigh_r", "shank_r")
FREE = ("knee_r.thigh.sup", "knee_r.shank.sup")
PARAMETERS = perturbed_parameters(np.random.default_rng(61))


def penalised(rng: np.random.Generator, *, frames: int = 40, nodes: int = 9) -> tuple[MotionProblem, Array]:
    """A trial with noise and a penalty that couples all coordinates, and the nodes of its true motion."""
    problem, true = random_trial(rng, PARAMETERS, free=FREE, frames=frames, nodes=nodes, segments=SEGMENTS)
    half = rng.normal(size=(true.shape[1], true.shape[1]))
    rough = smoothing(problem.basis, half @ half.T + np.eye(len(half)), 3.0)
    noisy = problem.data.measured + rng.normal(0, 0.005, problem.data.measured.shape)
    return replace(problem.with_measured(noisy), smoothing=rough), true


def whole(problem: MotionProblem) -> Array:
    """(nn * nq, nn * nq) the penalty's matrix, node by node."""
    return np.kron(problem.penalty.roughness.matrix.toarray(), problem.penalty.coupling)


def from_band(band: Array) -> Array:
    """The symmetric matrix of a transposed lower band."""
    out = np.zeros((len(band), len(band)))
    for d in range(band.shape[1]):
        values = band[: len(band) - d, d]
        out += np.diag(values, -d) + (np.diag(values, d) if d else 0.0)
    return out


def test_roughness_is_the_integral_of_squared_derivatives() -> None:
    basis = spline_basis(np.linspace(0.0, 1.3, 50), 14)
    nodes = np.random.default_rng(62).normal(size=(14, 2))
    spline = BSpline(basis.knots, nodes, DEGREE)
    fine = np.linspace(0.0, 1.3, 200_001)
    expected = np.trapezoid(spline.derivative(3)(fine) ** 2, fine, axis=0)
    expected += (2 * np.pi * TENSION_HZ) ** 4 * np.trapezoid(spline.derivative(1)(fine) ** 2, fine, axis=0)
    rough = roughness(basis.knots)
    np.testing.assert_allclose(np.diag(nodes.T @ rough.matrix @ nodes), expected, rtol=1e-8)
    assert rough.both(nodes, np.eye(2))[0] == pytest.approx(expected.sum(), rel=1e-8)
    np.testing.assert_allclose(
        rough.both(nodes, np.eye(nodes.shape[1]))[1], rough.matrix @ nodes, rtol=1e-9, atol=1e-9 * expected.max()
    )
    for d in range(ORDER):
        np.testing.assert_array_equal(rough.band[: 14 - d, d], rough.matrix.toarray().diagonal(d))
    assert rough.both(nodes + 1e6, np.eye(2))[0] == pytest.approx(rough.both(nodes, np.eye(2))[0], rel=1e-6)


def test_cost_and_gradients() -> None:
    rng = np.random.default_rng(63)
    problem, true = penalised(rng)
    constants = problem.constants(PARAMETERS)
    nodes = true + rng.normal(0, 0.02, true.shape)
    cost, by_nodes, by_values = problem.both_gradients(nodes, constants)
    plain_cost, plain_by_nodes, plain_by_values = replace(problem, smoothing=None).both_gradients(nodes, constants)
    assert cost == problem.cost(nodes, constants) > plain_cost == problem.marker_cost(nodes, constants)
    np.testing.assert_array_equal(by_values, plain_by_values)

    def total(x: Array) -> Array:
        return np.array([problem.cost(x.reshape(nodes.shape), constants)])

    assert_derivative(2 * by_nodes.reshape(1, -1), total, nodes.ravel(), relative=1e-6)
    assert np.abs(by_nodes - plain_by_nodes).max() > 1e-3 * np.abs(plain_by_nodes).max()


@pytest.mark.parametrize("curved", [False, True])
def test_equations_hold_the_penalty(curved: bool) -> None:
    problem, true = penalised(np.random.default_rng(64))
    closed = problem.with_free(())
    for trial in (closed,) if curved else (closed, problem):
        constants = trial.constants(PARAMETERS)
        if not trial.chain.free:
            constants = constants.without_parameters()
        equations = trial.equations(true, constants, curved=curved)
        plain = replace(trial, smoothing=None).equations(true, constants, curved=curved)
        matrix = whole(trial)
        added = from_band(equations.band) - from_band(plain.band)
        np.testing.assert_allclose(added, matrix, rtol=0, atol=1e-12 * np.abs(from_band(equations.band)).max())
        gradient = (equations.node_gradient - plain.node_gradient).ravel()
        np.testing.assert_allclose(gradient, matrix @ true.ravel(), rtol=0, atol=1e-9 * np.abs(gradient).max())
        assert equations.cost == pytest.approx(plain.cost + true.ravel() @ matrix @ true.ravel(), rel=1e-9)
        np.testing.assert_array_equal(equations.mixed, plain.mixed)


def test_tracking_ends_where_a_dense_solver_does() -> None:
    problem, true = penalised(np.random.default_rng(65))
    problem = problem.with_free(())
    constants = problem.constants(PARAMETERS)
    root = np.linalg.cholesky(whole(problem) + 1e-12 * np.eye(true.size)).T

    def residual(x: Array) -> Array:
        gap = problem.positions(x.reshape(true.shape), constants) - problem.data.measured
        return np.concatenate([gap.ravel(), root @ x])

    reference = least_squares(residual, true.ravel(), tr_solver="exact", xtol=1e-15, ftol=1e-15, gtol=1e-15)
    result = track_nodes(problem, constants, true, DescentSettings(gain=1e-15))
    assert result.cost == pytest.approx(2 * reference.cost, rel=1e-8)
    assert result.cost > 1.01 * problem.marker_cost(result.nodes, constants)
    np.testing.assert_allclose(result.nodes.ravel(), reference.x, atol=1e-6)


def test_smoothing_survives_and_idle_coordinates_keep_their_start() -> None:
    problem, true = penalised(np.random.default_rng(66))
    weight = problem.data.weight.copy()
    weight[problem.data.segment == problem.chain.segments.index("shank_r")] = 0.0
    for other in (
        problem.with_free(()),
        problem.with_measured(problem.data.measured + 0.1),
        problem.with_weight(weight),
    ):
        assert other.smoothing is problem.smoothing
    lost = problem.with_free(()).with_weight(weight)
    idle = ~lost.active
    assert idle.any() and not idle.all()
    tracked = track_nodes(lost, lost.constants(PARAMETERS), true)
    np.testing.assert_array_equal(tracked.nodes[:, idle], true[:, idle])
    assert np.abs(tracked.nodes[:, ~idle] - true[:, ~idle]).max() > 1e-6


def test_smoother_is_a_dense_hat_matrix_and_its_trace_a_sum_of_gains() -> None:
    rng = np.random.default_rng(67)
    basis, hz = spline_basis(np.arange(90) / 60.0, 50), 5.0
    b = BSpline.design_matrix(basis.time, basis.knots, DEGREE).toarray()
    rough, rate = roughness(basis.knots).matrix.toarray(), frame_rate(basis)
    hat = b @ np.linalg.solve(b.T @ b + rate * (2 * np.pi * hz) ** -6.0 * rough, b.T)
    assert stiffness(basis, hz) == pytest.approx(rate * (2 * np.pi * hz) ** -6.0)
    smoother = Smoother(basis)
    series, nodes = rng.normal(size=(90, 3)), rng.normal(size=(50, 3))
    np.testing.assert_allclose(
        basis.evaluate(smoother.nodes(basis.matrices[0].T @ series, hz)), hat @ series, atol=1e-8
    )
    lost = b @ nodes - hat @ b @ nodes
    np.testing.assert_allclose(basis.evaluate(smoother.lost(nodes, hz)), lost, atol=1e-8)
    mu = eigh(rough, b.T @ b, eigvals_only=True)
    reinsch = (rate * np.maximum(mu, 0.0)) ** (1 / 6) / (2 * np.pi)
    gains = 1 / (1 + (reinsch / hz) ** 6)
    assert np.trace(hat) == pytest.approx(gains.sum(), rel=1e-6)


@pytest.mark.parametrize("hz, gain", [(3.0, 1 / (1 + 0.5**6)), (6.0, 0.5), (12.0, 1 / (1 + 2.0**6))])
def test_half_of_an_oscillation_passes_at_the_cut_off(hz: float, gain: float) -> None:
    time = np.arange(1000) / 200.0
    basis = spline_basis(time, 505)
    wave = np.sin(2 * np.pi * hz * time)[:, None]
    passed = basis.evaluate(Smoother(basis).nodes(basis.matrices[0].T @ wave, 6.0))
    middle = slice(250, 750)
    assert float((passed * wave)[middle].sum() / (wave**2)[middle].sum()) == pytest.approx(gain, abs=0.005)
