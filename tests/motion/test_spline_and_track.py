"""Splines against SciPy, tracking against a dense SciPy reference, starts, gaps and headings."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from gaitcal.model.chain import axis_rotation
from gaitcal.motion.descent import DescentSettings
from gaitcal.motion.rigid import rigid_distances, rigid_fit
from gaitcal.motion.spline import NodeRule, cutoff, spline_basis, to_bspline
from gaitcal.motion.start import starting_nodes
from gaitcal.motion.track import track_nodes
from tests.derivatives import Array, perturbed_parameters, random_trial


@given(st.integers(6, 40), st.integers(30, 120), st.integers(0, 2**31))
@settings(max_examples=30)
def test_spline_and_derivatives_are_scipys(nodes: int, frames: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.uniform(0.5, 1.5, frames)) / 100.0
    basis = spline_basis(time, nodes)
    values = rng.normal(size=(nodes, 2))
    reference = to_bspline(basis, values)
    for k in range(3):
        expected = reference(time, k)
        np.testing.assert_allclose(basis.evaluate(values, k), expected, rtol=0, atol=1e-11 * np.abs(expected).max())


def test_spline_fit_finds_a_curve_of_its_own_space() -> None:
    basis = spline_basis(np.linspace(0, 2, 200), 25)
    nodes = np.random.default_rng(7).normal(size=(25, 3))
    np.testing.assert_allclose(basis.fit(basis.evaluate(nodes)), nodes, atol=1e-8)


def test_effective_cutoff_is_where_the_fit_passes_71_percent() -> None:
    time = np.arange(4000) / 1000.0
    nodes = NodeRule(per_second=15.0).nodes(time)
    basis = spline_basis(time, nodes)
    middle = slice(1000, 3000)
    gains = []
    for phase in (0.0, np.pi / 2):  # near the knots' Nyquist frequency the gain depends on phase; the mean does not
        wave = np.sin(2 * np.pi * cutoff(time, nodes) * time + phase)[:, None]
        passed = basis.evaluate(basis.fit(wave))
        gains.append(float((passed[middle].T @ wave[middle])[0, 0] / (wave[middle].T @ wave[middle])[0, 0]))
    assert np.mean(gains) == pytest.approx(np.sqrt(0.5), abs=0.01)


@pytest.mark.parametrize("zero", [False, True])
def test_tracking_recovers_a_motion_exactly(zero: bool) -> None:
    rng = np.random.default_rng(8)
    parameters = perturbed_parameters(rng)
    problem, true = random_trial(rng, parameters, frames=80, nodes=12)
    constants = problem.constants(parameters)
    if zero:
        start = np.zeros_like(true)
    else:
        start = starting_nodes(problem.chain, constants, problem.data, problem.basis)
    result = track_nodes(problem, constants, start, DescentSettings(first_damping=1e-3 if zero else 0.0))
    assert result.converged
    assert np.sqrt(result.cost / problem.data.weight.sum()) < 1e-12
    np.testing.assert_allclose(problem.basis.evaluate(result.nodes), problem.basis.evaluate(true), atol=1e-9)


def test_tracking_ends_where_a_dense_solver_does() -> None:
    rng = np.random.default_rng(9)
    parameters = perturbed_parameters(rng)
    segments = ("pelvis", "thigh_r", "shank_r")
    problem, true = random_trial(rng, parameters, frames=40, nodes=8, segments=segments)
    noisy = problem.data.measured + rng.normal(0, 0.005, problem.data.measured.shape)
    weight = rng.uniform(0.3, 1.0, problem.data.weight.shape)
    problem = problem.with_measured(noisy).with_weight(weight)
    constants = problem.constants(parameters)

    def residual(x: Array) -> Array:
        gap = problem.positions(x.reshape(true.shape), constants) - noisy
        return (np.sqrt(weight)[:, None] * gap).ravel()

    reference = least_squares(
        residual, true.ravel(), jac="3-point", method="trf", tr_solver="exact", xtol=1e-15, ftol=1e-15, gtol=1e-15
    )
    result = track_nodes(problem, constants, np.zeros_like(true), DescentSettings(gain=1e-14, first_damping=1e-3))
    assert result.cost == pytest.approx(2 * reference.cost, rel=1e-8)
    np.testing.assert_allclose(result.nodes.ravel(), reference.x, atol=1e-5)


def test_gaps_leave_the_rest_alone() -> None:
    """A marker lost for half the trial, and whole segments lost for a while: the exact motion is still found."""
    rng = np.random.default_rng(10)
    parameters = perturbed_parameters(rng)
    problem, true = random_trial(rng, parameters, frames=100, nodes=10)
    weight = problem.data.weight.copy()
    weight[rng.random(weight.shape) < 0.2] = 0.0
    weight[5, :50] = 0.0
    constants = problem.constants(parameters)
    gappy = problem.with_weight(weight)
    start = starting_nodes(gappy.chain, constants, gappy.data, gappy.basis)
    result = track_nodes(gappy, constants, start)
    np.testing.assert_allclose(problem.basis.evaluate(result.nodes), problem.basis.evaluate(true), atol=1e-8)


@given(st.floats(-np.pi, np.pi), st.integers(0, 2**31))
@settings(max_examples=10)
def test_any_heading_is_tracked(heading: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    parameters = perturbed_parameters(rng)
    problem, _ = random_trial(rng, parameters, frames=50, nodes=8)
    turn = axis_rotation(1, heading)
    turned = np.einsum("ij,mjf->mif", turn, problem.data.measured) + np.array([3.0, 0.0, -2.0])[None, :, None]
    problem = problem.with_measured(turned)
    constants = problem.constants(parameters)
    start = starting_nodes(problem.chain, constants, problem.data, problem.basis)
    result = track_nodes(problem, constants, start)
    # The turned motion lies in the spline space only as far as Euler angles turn with it.
    assert np.sqrt(result.cost / problem.data.weight.sum()) < 0.005


def test_rigid_fit_finds_the_rigid_motion_and_says_where_it_cannot() -> None:
    rng = np.random.default_rng(11)
    local = rng.normal(0, 0.1, (5, 3))
    rotation = axis_rotation(0, 0.4) @ axis_rotation(2, 1.1)
    measured = (local @ rotation.T + [1.0, 2.0, 3.0])[:, :, None].repeat(3, axis=2)
    weight = np.ones((5, 3))
    weight[2:, 1] = 0.0
    fit = rigid_fit(local, measured, weight)
    np.testing.assert_allclose(fit.rotation[0], rotation, atol=1e-12)
    np.testing.assert_allclose(fit.origin[2], [1.0, 2.0, 3.0], atol=1e-12)
    assert fit.determined.tolist() == [True, False, True]
    assert np.nanmax(rigid_distances(local, measured, weight)) < 1e-12
