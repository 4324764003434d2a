"""Peaks over strides: what is hardly valid has none, one alone has its own error."""

from __future__ import annotations

import numpy as np
import pytest

from gaitcal.gait.cycles import POINTS
from gaitcal.gait.spatiotemporal import LEAST_VALID, stride_peaks

ERRORS = np.tile(np.linspace(0.1, 0.2, POINTS), (3, 1))


def curves() -> np.ndarray:
    """Three strides that rise to 1, 2 and 4 at their ends."""
    return np.outer([1.0, 2.0, 4.0], np.linspace(0.0, 1.0, POINTS))


def test_mean_and_deviation_of_the_strides_peaks() -> None:
    found = stride_peaks(curves(), ERRORS)
    assert (found.mean, found.count, found.strides) == (pytest.approx(7 / 3), 3, 3)
    assert found.error == pytest.approx(np.std([1, 2, 4], ddof=1))


def test_a_stride_of_which_little_is_valid_has_no_peak() -> None:
    values = curves()
    values[2, 34:] = np.nan
    values[1, 90:] = np.nan  # 90 of 101: too few by one
    assert 90 / POINTS < LEAST_VALID < 91 / POINTS
    found = stride_peaks(values, ERRORS)
    assert (found.mean, found.error, found.count, found.strides) == (1.0, pytest.approx(0.2), 1, 3)
    values[1] = curves()[1]
    values[1, 91:] = np.nan
    assert stride_peaks(values, ERRORS).mean == pytest.approx((1.0 + 2.0 * 0.9) / 2)


def test_without_a_stride_there_is_no_number() -> None:
    for values in (np.full((2, POINTS), np.nan), np.empty((0, POINTS))):
        found = stride_peaks(values, np.empty_like(values))
        assert np.isnan(found.mean) and (found.count, found.strides) == (0, len(values))
