"""The low-pass filter of wrenches, and their values at marker frames."""

from dataclasses import replace

import numpy as np
import pytest

from gaitcal.errors import InputError
from gaitcal.io.force_plate import filter_plate, low_pass, resample_wrench
from tests.io.recordings import plate

RATE = 1000.0
TIME = np.arange(4000) / RATE


def gain_and_delay(frequency: float, cutoff: float) -> tuple[float, float]:
    wave = np.exp(2j * np.pi * frequency * TIME)
    out = low_pass(np.column_stack([wave.real, wave.imag]), RATE, cutoff)
    response = np.mean(((out[:, 0] + 1j * out[:, 1]) / wave)[1500:2500])
    return abs(response), float(np.angle(response))


@pytest.mark.parametrize("cutoff", [6.0, 20.0, 400.0])
def test_three_decibels_at_the_stated_cutoff_after_both_passes_and_no_delay(cutoff: float) -> None:
    gain, delay = gain_and_delay(cutoff, cutoff)
    assert gain == pytest.approx(2**-0.5, abs=1e-6)
    assert delay == pytest.approx(0.0, abs=1e-6)


def test_fourth_order_slope() -> None:
    """24 dB an octave of the warped frequency tan(pi f / fs)."""
    octaves = np.log2(np.tan(np.pi * 0.16) / np.tan(np.pi * 0.08))
    fall = 20 * np.log10(gain_and_delay(80.0, 10.0)[0] / gain_and_delay(160.0, 10.0)[0])
    assert fall == pytest.approx(24 * octaves, rel=0.01)


@pytest.mark.parametrize("cutoff", [0.0, -5.0, 500.0, float("nan")])
def test_cutoffs_beyond_nyquist_are_refused(cutoff: float) -> None:
    with pytest.raises(InputError, match="half the sampling rate, 500 Hz"):
        low_pass(np.zeros((100, 1)), RATE, cutoff)


def test_stretches_between_gaps_are_filtered_each_alone() -> None:
    values = np.ones((300, 2))
    values[:100] = 5.0
    values[100:150, 0] = np.nan
    values[299] = np.nan
    out = low_pass(values, RATE, 10.0)
    np.testing.assert_allclose(out[:100], 5.0)
    np.testing.assert_allclose(out[150:299], 1.0)
    assert np.isnan(out[100:150, 0]).all()


def test_the_wrench_about_the_origin_is_filtered_not_the_centre_of_pressure() -> None:
    raw = plate(TIME)
    smooth = filter_plate(raw, 15.0)
    np.testing.assert_allclose(smooth.wrench(), low_pass(raw.wrench(), RATE, 15.0), atol=1e-9)
    loaded = smooth.force[:, 1] > 100
    np.testing.assert_allclose(smooth.point[loaded, 1], 0, atol=1e-12)
    np.testing.assert_allclose(smooth.moment[loaded][:, [0, 2]], 0, atol=1e-9)
    middle = raw.force[:, 1] > 500
    np.testing.assert_allclose(smooth.point[middle], raw.point[middle], atol=2e-3)


def test_the_height_of_the_points_is_kept_with_corners_or_without() -> None:
    with_corners = plate(TIME)
    with_corners = replace(with_corners, point=with_corners.point + [0.0, -0.0075, 0.0])
    raw = replace(with_corners, corners=None)
    smooth = filter_plate(raw, 15.0)
    np.testing.assert_array_equal(filter_plate(with_corners, 15.0).point, smooth.point)
    np.testing.assert_allclose(smooth.wrench(), low_pass(raw.wrench(), RATE, 15.0), atol=1e-9)
    np.testing.assert_allclose(smooth.point[smooth.force[:, 1] > 100, 1], -0.0075, atol=1e-9)


def test_resampling_is_linear_inside_and_unknown_outside() -> None:
    raw = plate(TIME)
    wrench = raw.wrench()
    at = np.array([-0.01, 0.0, 1.0005, 3.999, 4.2])
    found = resample_wrench(raw, at)
    assert np.isnan(found[[0, 4]]).all()
    np.testing.assert_allclose(found[1], wrench[0])
    np.testing.assert_allclose(found[2], 0.5 * (wrench[1000] + wrench[1001]))
    np.testing.assert_allclose(found[3], wrench[3999])
