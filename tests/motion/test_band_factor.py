"""The factor of a band against dense linear algebra."""

from __future__ import annotations

import numpy as np
import pytest

from gaitcal.motion.banded import BandFactor

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
