"""Normal equations of markers against dense references, and the banded solver that they are solved
by.
"""

import numpy as np
import pinocchio as pin
import pytest

from gaitcal.model.chain import build_linkage
from gaitcal.model.parameters import JP_INDEX, list_gait_parameters, list_isolated_parameters
from gaitcal.tracking.banded import ArrowEquations, BandFactor, NormalEquations, SharedPrior
from gaitcal.tracking.marker_residual import assemble_frame_equations
from gaitcal.tracking.trial_problem import MotionProblem
from tests.derivatives import (
    Array,
    central_differences,
    from_band,
    perturbed_parameters,
    random_trial,
    with_gaps,
)

DERIVATIVE = 1e-7
"""Relative to the largest entry: what central differences of step 1e-6 can tell."""


def residual(problem: MotionProblem, parameters: object, coefficients: Array, p: Array) -> Array:
    values = parameters.with_joint(problem.chain.free, p)  # type: ignore[attr-defined]
    gap = (
        problem.compute_positions(coefficients, problem.build_body(values)) - problem.data.measured
    )
    return (np.sqrt(problem.data.weight)[:, None] * gap).ravel()


def test_normal_equations_are_those_of_the_residual() -> None:
    """Explicit Jacobian by central differences, on a part with gaps, unequal weights and free joint
    parameters.
    """
    rng = np.random.default_rng(4)
    parameters = perturbed_parameters(rng)
    segments = ("pelvis", "thigh_r", "shank_r", "talus_r", "foot_r")
    problem, true = random_trial(
        rng, parameters, free=list_gait_parameters("r"), frames=30, nodes=7, segments=segments
    )
    problem = with_gaps(problem, rng)
    coefficients = true + rng.normal(0, 0.02, true.shape)
    p = problem.get_values(parameters) + rng.normal(0, 0.01, len(problem.chain.free))
    at = parameters.with_joint(problem.chain.free, p)
    equations = problem.assemble_equations(coefficients, problem.build_body(at))
    by_nodes = central_differences(
        lambda x: residual(problem, parameters, x.reshape(coefficients.shape), p),
        coefficients.ravel(),
    )
    by_p = central_differences(lambda x: residual(problem, parameters, coefficients, x), p)
    r = residual(problem, parameters, coefficients, p)
    for found, wanted in (
        (equations.node_gradient.ravel(), by_nodes.T @ r),
        (equations.parameter_gradient, by_p.T @ r),
        (from_band(equations.band), by_nodes.T @ by_nodes),
        (equations.mixed, by_nodes.T @ by_p),
        (equations.parameters, by_p.T @ by_p),
    ):
        np.testing.assert_allclose(found, wanted, rtol=0, atol=DERIVATIVE * np.abs(wanted).max())
    np.testing.assert_allclose(equations.cost, r @ r, rtol=1e-12)
    cost, gradient = problem.compute_gradient(coefficients, problem.build_body(at))
    np.testing.assert_allclose(
        gradient, equations.node_gradient, rtol=0, atol=1e-12 * np.abs(gradient).max()
    )
    np.testing.assert_allclose(
        [cost, problem.compute_cost(coefficients, problem.build_body(at))],
        equations.cost,
        rtol=1e-12,
    )


def test_frame_hessian_is_the_mass_matrix_of_markers_as_point_masses() -> None:
    rng = np.random.default_rng(5)
    parameters = perturbed_parameters(rng)
    free = (*list_gait_parameters("r"), *list_isolated_parameters("ankle_l"))
    problem, true = random_trial(rng, parameters, free=free, frames=12, nodes=6)
    linkage = build_linkage(parameters, problem.chain.free)
    for joint in range(1, linkage.model.njoints):
        linkage.model.inertias[joint] = pin.Inertia.Zero()
    for segment, local in zip(problem.data.segment, problem.data.local, strict=True):
        point = linkage.segment_placement[segment].act(local)
        linkage.model.inertias[int(linkage.chain.segment_joint[segment])] += pin.Inertia(
            1.0, point, np.zeros((3, 3))
        )
    order = [linkage.index(name) for name in (*problem.chain.coordinates, *problem.chain.free)]
    q = problem.basis.evaluate(true)
    pairs = problem._pairs
    found = assemble_frame_equations(problem.build_body(parameters), pairs, problem.data, q)
    data = linkage.model.createData()
    for f in range(len(q)):
        full = np.zeros(linkage.model.nq)
        full[order] = np.concatenate(
            [q[f], parameters.joint[[JP_INDEX[n] for n in problem.chain.free]]]
        )
        mass = np.triu(pin.crba(linkage.model, data, full, pin.Convention.WORLD))
        mass = (mass + np.triu(mass, 1).T)[np.ix_(order, order)]
        ours = np.zeros_like(mass)
        products = found.compute_products()[f][pairs.shallow, pairs.deep]
        ours[pairs.first, pairs.second] = ours[pairs.second, pairs.first] = products
        np.testing.assert_allclose(ours, mass, rtol=0, atol=1e-13 * np.abs(mass).max())


EXACT = 1e-9
"""Relative; the arrow adds 1e-14 of its trace, and bands a floor of 1e-13 of their largest entry.
"""
SIZE, NODES, COORDINATES, WIDTH = 3, 8, 2, 12
COLUMNS = [np.array([0, 2]), np.array([2, 1, 0])]
"""Places of each trial's own parameters among the shared ones."""


def trial(rng: np.random.Generator, parameters: int) -> NormalEquations:
    """Half gradient and matrix of a least-squares problem whose nodes are coupled within
    the band.
    """
    n = NODES * COORDINATES
    near = np.abs(np.arange(n)[:, None] - np.arange(n)) < WIDTH // 2
    rows = rng.normal(size=(n, n)) * near
    jacobian = np.hstack([rows, rng.normal(size=(n, parameters))])
    whole = jacobian.T @ jacobian + np.diag(rng.uniform(1.0, 2.0, n + parameters))
    band = np.zeros((n, WIDTH))
    for k in range(WIDTH):
        band[: n - k, k] = np.diagonal(whole[:n, :n], -k)
    gradient = rng.normal(size=n + parameters)
    return NormalEquations(
        cost=1.0,
        band=band,
        mixed=whole[:n, n:],
        parameters=whole[n:, n:],
        node_gradient=gradient[:n].reshape(NODES, COORDINATES),
        parameter_gradient=gradient[n:],
    )


@pytest.mark.parametrize("damping", [0.0, 0.5])
@pytest.mark.parametrize("known", [False, True])
def test_the_arrow_is_solved_as_the_dense_matrix_is(damping: float, known: bool) -> None:
    rng = np.random.default_rng(81)
    trials = [trial(rng, len(own)) for own in COLUMNS]
    rows = rng.normal(size=(2, SIZE))
    prior = SharedPrior(0.3, rng.normal(size=SIZE), rows.T @ rows) if known else None
    equations = ArrowEquations(trials, COLUMNS, SIZE, prior)

    n = NODES * COORDINATES
    whole, gradient = np.zeros((SIZE + 2 * n, SIZE + 2 * n)), np.zeros(SIZE + 2 * n)
    for k, (one, own) in enumerate(zip(trials, COLUMNS, strict=True)):
        coefficients = np.arange(SIZE + k * n, SIZE + (k + 1) * n)
        matrices: tuple[Array, Array] = from_band(one.band), one.parameters
        whole[np.ix_(coefficients, coefficients)], corner = (
            m + damping * np.diag(np.diag(m)) for m in matrices
        )
        whole[np.ix_(own, own)] += corner
        whole[np.ix_(coefficients, own)], whole[np.ix_(own, coefficients)] = one.mixed, one.mixed.T
        gradient[coefficients] = one.node_gradient.ravel()
        gradient[own] += one.parameter_gradient
    cost = 2.0
    if prior is not None:
        whole[:SIZE, :SIZE] += prior.matrix
        gradient[:SIZE] += prior.gradient
        cost += prior.cost

    assert equations.evaluation.cost == pytest.approx(cost)
    np.testing.assert_allclose(equations.evaluation.gradient, gradient, rtol=0, atol=1e-14)
    expected = np.linalg.solve(whole, gradient)
    found = equations.factor(damping).solve(gradient)
    np.testing.assert_allclose(found, expected, rtol=0, atol=EXACT * np.abs(expected).max())


ROUNDING = 1e-12


@pytest.mark.parametrize(("size", "width"), [(40, 6), (41, 12), (18, 18), (20, 18), (97, 24)])
@pytest.mark.parametrize("columns", [None, 1, 7])
def test_halves_and_wholes_are_those_of_the_dense_matrix(
    size: int, width: int, columns: int | None
) -> None:
    """Blocks of the band's width, the last of them smaller or not, for one right side and
    for many.
    """
    rng = np.random.default_rng(size)
    band = rng.normal(size=(size, width))
    band[:, 0] = 3 * width
    for d in range(1, width):
        band[size - d :, d] = 0.0
    dense = from_band(band)
    right = rng.normal(size=size if columns is None else (size, columns))
    factor, lower = BandFactor(band), np.linalg.cholesky(dense)
    for solve, matrix in (
        (factor.solve, dense),
        (factor.solve_forward, lower),
        (factor.solve_backward, lower.T),
    ):
        np.testing.assert_allclose(
            solve(right), np.linalg.solve(matrix, right), rtol=0, atol=ROUNDING
        )
    if columns is not None:
        wanted, memory = factor.solve_forward(right), right.copy()
        np.testing.assert_array_equal(factor.solve_forward(memory, overwrite=True), wanted)
        np.testing.assert_array_equal(memory, wanted)
