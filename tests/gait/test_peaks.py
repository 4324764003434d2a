"""Peaks by phase: windows that follow the foot, turning points, errors, and what a strike's shock must not become."""

import warnings
from pathlib import Path

import numpy as np
import pytest

from gaitcal.gait.cycles import POINTS, known_variables
from gaitcal.gait.peaks import PEAKS, peak_columns, peak_means, stride_peaks
from tests.gait.recorded_walks import vendor_strides

PERCENT = np.arange(float(POINTS))
NONE = np.full(POINTS, np.nan)


def bump(*at: tuple[float, float]) -> np.ndarray:
    """Bumps of a width of 4 %, each (percent, height)."""
    return np.asarray(sum(height * np.exp(-(((PERCENT - place) / 4.0) ** 2)) for place, height in at))


def test_variables_are_those_of_the_table_and_windows_lie_within_the_stride() -> None:
    assert {peak.variable for peak in PEAKS.values()} <= set(known_variables())
    assert all(0.0 <= peak.window[0] <= peak.window[1] <= 2.0 for peak in PEAKS.values())
    loads = [peak for peak in PEAKS.values() if peak.variable.endswith(("_moment", "_power", "_vertical"))]
    assert min(peak.window[0] for peak in loads) == 0.08


@pytest.mark.parametrize("toe_off", [55.0, 62.0, 75.0])
def test_windows_follow_the_foot_not_the_percent(toe_off: float) -> None:
    """The same phases of a quick and of a slow walk: half of stance, half of swing."""
    push, swing = 0.8 * toe_off, toe_off + 0.4 * (100.0 - toe_off)
    found = stride_peaks(
        {"ankle_angle_moment": (-bump((push, 90.0)), NONE, NONE), "knee_angle": (bump((swing, 60.0)), NONE, NONE)},
        toe_off,
    )
    assert found["plantarflexion_moment"][3] == round(push) and found["knee_flexion_swing"][3] == round(swing)
    assert "knee_flexion_loading" not in found


def test_the_shock_of_the_strike_is_no_peak() -> None:
    """An extensor moment of 56 N·m at 1 %, and one of 30 at 12 %: the second. Alone, the shock is none."""
    both, alone = -bump((1.0, 56.0), (12.0, 30.0)), -bump((1.0, 56.0))
    of = {
        name: stride_peaks({"hip_flexion_moment": (curve, NONE, NONE)}, 62.0)
        for name, curve in (("both", both), ("alone", alone))
    }
    assert of["both"]["hip_extension_moment"][3] == 12.0 and of["both"]["hip_extension_moment"][0] == both[12]
    assert "hip_extension_moment" not in of["alone"]


def test_a_wiggle_on_a_rising_curve_is_no_peak() -> None:
    """A knee that bends on through its loading window, with 1.5 deg more in one sample, and one that turns there."""
    rising = PERCENT + 1.5 * (PERCENT == 15.0)
    assert "knee_flexion_loading" not in stride_peaks({"knee_angle": (rising, NONE, NONE)}, 60.0)
    turning = rising + 40.0 * (PERCENT == 15.0)
    assert stride_peaks({"knee_angle": (turning, NONE, NONE)}, 60.0)["knee_flexion_loading"][3] == 15.0


@pytest.mark.parametrize("toe_off", [0.0, 100.0])
def test_a_stride_without_stance_or_swing_has_no_peaks_there(toe_off: float) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = stride_peaks({"knee_angle": (bump((50.0, 60.0)), NONE, NONE)}, toe_off)
    assert ("knee_flexion_swing" in found) == (toe_off == 0.0) and "knee_flexion_loading" not in found


def test_a_gap_in_the_window_or_an_unknown_toe_off_has_no_peak() -> None:
    curve = bump((82.0, 60.0))
    holed = np.where((PERCENT > 70) & (PERCENT < 78), np.nan, curve)
    assert "knee_flexion_swing" not in stride_peaks({"knee_angle": (holed, NONE, NONE)}, 62.0)
    assert list(stride_peaks({"knee_angle": (curve, NONE, NONE)}, None)) == ["knee_flexion_strike"]


def test_a_range_shares_what_its_ends_share() -> None:
    """5 deg that all strides share is at both ends: what is left is the stride's own 1 deg at each."""
    curve, error, own = 10.0 * np.sin(PERCENT / 16.0), np.full(POINTS, np.sqrt(26.0)), np.ones(POINTS)
    value, total, alone, _ = stride_peaks({"pelvis_list": (curve, error, own)}, 62.0)["pelvis_list_range"]
    assert value == pytest.approx(np.ptp(curve)) and total == pytest.approx(alone) == pytest.approx(np.sqrt(2.0))
    assert stride_peaks({"pelvis_tilt": (curve, error, own)}, 62.0)["pelvis_tilt_mean"][:2] == pytest.approx(
        (curve.mean(), np.sqrt(26.0))
    )


def test_means_are_of_the_strides_peaks_with_shared_errors() -> None:
    """Peaks of 10 and 14 at other percents; c = 2 shared, 1 own: se^2 = 8 / 2 + 2^2."""
    shared = np.sqrt(5.0)
    strides = [
        ("walk", "r", stride_peaks({"knee_angle": (bump((at, high)), NONE + 1, NONE)}, 62.0) | {
            "knee_flexion_swing": (high, shared, 1.0, at)})
        for at, high in ((72.0, 10.0), (76.0, 14.0))
    ]  # fmt: skip
    (of,) = [m for m in peak_means([*strides, ("walk", "r", {})]) if m.peak.name == "knee_flexion_swing"]
    assert (of.n, of.strides, of.mean, of.percent) == (2, 3, 12.0, 74.0)
    assert of.sd == pytest.approx(np.sqrt(8.0)) and of.se == pytest.approx(np.sqrt(8.0 / 2 + 4.0))
    assert "62" not in of.peak.words and peak_columns([of])["window"] == ["0 to 100 % of swing"]


@pytest.mark.parametrize("person", ["HC002D", "HC032A"])
def test_peaks_of_a_childs_vendor_curves_are_where_clinics_look_for_them(person: str, data_dir: Path) -> None:
    """Plug-in Gait's own knees and powers, through the same windows: A2 at push-off, K4 at the end of swing."""
    (of_legs,) = [
        {m.peak.name: m.percent for m in peak_means(("straight", "r", stride_peaks(*s)) for s in strides)}
        for strides in [vendor_strides(data_dir / "children" / person / "straight.c3d")]
    ]
    for name, low, high in (
        ("knee_flexion_swing", 66, 76), ("ankle_power_2", 48, 56), ("knee_power_1", 5, 11), ("knee_power_4", 86, 94),
        ("hip_power_2", 34, 45), ("hip_flexion_swing", 78, 92),
    ):  # fmt: skip
        assert low <= of_legs[name] <= high, name
