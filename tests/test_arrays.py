"""Arithmetic of the arrays themselves."""

import numpy as np
import pytest

from gaitcal.arrays import cross


@pytest.mark.parametrize(("left", "right"), [((3,), (3,)), ((5, 3), (3,)), ((3,), (5, 3)), ((4, 1, 3), (5, 3))])
def test_cross_is_that_of_numpy(left: tuple[int, ...], right: tuple[int, ...]) -> None:
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=left), rng.normal(size=right)
    np.testing.assert_array_equal(cross(a, b), np.cross(a, b))
