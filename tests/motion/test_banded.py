"""Bands and arrows against dense linear algebra."""

import numpy as np
import pytest

from gaitcal.motion.banded import ArrowEquations, BandFactor, NormalEquations, SharedPrior
from tests.derivatives import Array
from tests.motion.test_marker_equations import dense

EXACT = 1e-9
"""Relative; the arrow adds 1e-14 of its trace, and bands a floor of 1e-13 of their largest entry."""
SIZE, NODES, COORDINATES, WIDTH = 3, 8, 2, 12
COLUMNS = [np.array([0, 2]), np.array([2, 1, 0])]
"""Places of each trial's own parameters among the shared ones."""


def trial(rng: np.random.Generator, parameters: int) -> NormalEquations:
    """Half gradient and matrix of a least-squares problem whose nodes are coupled within the band."""
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
        nodes = np.arange(SIZE + k * n, SIZE + (k + 1) * n)
        matrices: tuple[Array, Array] = dense(one), one.parameters
        whole[np.ix_(nodes, nodes)], corner = (m + damping * np.diag(np.diag(m)) for m in matrices)
        whole[np.ix_(own, own)] += corner
        whole[np.ix_(nodes, own)], whole[np.ix_(own, nodes)] = one.mixed, one.mixed.T
        gradient[nodes] = one.node_gradient.ravel()
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
def test_halves_and_wholes_are_those_of_the_dense_matrix(size: int, width: int, columns: int | None) -> None:
    """Blocks of the band's width, the last of them smaller or not, for one right side and for many."""
    rng = np.random.default_rng(size)
    band = rng.normal(size=(size, width))
    band[:, 0] = 3 * width
    dense = np.zeros((size, size))
    for d in range(width):
        band[size - d :, d] = 0.0
        dense += np.diag(band[: size - d, d], -d) + (np.diag(band[: size - d, d], d) if d else 0.0)
    right = rng.normal(size=size if columns is None else (size, columns))
    factor, lower = BandFactor(band), np.linalg.cholesky(dense)
    pairs = (
        (factor.solve(right), np.linalg.solve(dense, right)),
        (factor.forward(right), np.linalg.solve(lower, right)),
        (factor.backward(right), np.linalg.solve(lower.T, right)),
    )
    for ours, theirs in pairs:
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=ROUNDING)
