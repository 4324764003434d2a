"""Foot strikes, cycles, normalisation and peaks on known contacts; mean curves against plain loops."""

import itertools
import warnings
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gaitcal.errors import InputError
from gaitcal.gait.cycles import (
    POINTS,
    EventSource,
    FootEvents,
    GaitCycle,
    best_cycle,
    gait_cycles,
    known_variables,
    normalise,
    resample,
    stances,
    steady,
)
from gaitcal.gait.ensemble import ENSEMBLE_COLUMNS, ensemble, spread
from gaitcal.gait.peaks import PEAKS, PHASE_PEAKS, PHASES, peak_columns, peak_means, phase_peaks, stride_peaks
from tests.gait.walks import vendor_strides

FRAME = 0.01
ROUNDING = 1e-9
"""Linear interpolation of numbers up to 1e3."""


def contact(time: np.ndarray, phase: float) -> np.ndarray:
    return ((time - phase) % 1.1) < 0.66


FEET = FootEvents(
    np.array([0.2, 1.3, 2.4]), np.array([0.1, 0.86, 1.96]), (EventSource.FILE, EventSource.PLATES, EventSource.MOTION)
)


def test_cycles_run_from_strike_to_next_strike_of_the_same_foot() -> None:
    cycles = gait_cycles(FEET)
    assert [(c.start, c.stop, c.toe_off) for c in cycles] == [(0.2, 1.3, 0.86), (1.3, 2.4, 1.96)]
    assert [c.stance for c in cycles] == pytest.approx([60.0, 60.0])


def test_a_cycle_says_what_told_its_two_strikes() -> None:
    assert [c.sources for c in gait_cycles(FEET)] == [FEET.sources[:2], FEET.sources[1:]]


def test_a_stop_or_a_flicker_is_no_cycle() -> None:
    assert gait_cycles(FootEvents(np.array([0.2, 0.5, 5.0]), np.array([]))) == ()


def test_flickers_of_the_threshold_are_no_steps() -> None:
    time = np.arange(0.0, 3.0, FRAME)
    loaded = contact(time, 0.2)
    loaded[50:54] = False
    loaded[100:103] = True
    assert np.array_equal(steady(time, loaded), contact(time, 0.2))


def test_stances_also_at_the_ends_of_the_trial() -> None:
    time = np.arange(0.0, 2.0, FRAME)
    found = stances(FootEvents(np.array([0.8, 1.9]), np.array([0.36, 1.46])), time)
    assert found == ((0.0, 0.36), (0.8, 1.46), (1.9, time[-1]))
    assert stances(FootEvents(np.array([]), np.array([])), time) == ()


def test_the_drawn_cycle_is_the_one_with_most_valid_frames() -> None:
    time = np.arange(0.0, 3.0, FRAME)
    cycles = (GaitCycle(0.0, 1.0, 0.6), GaitCycle(1.0, 2.0, 1.6))
    assert best_cycle(cycles, time, time > 0.9) == cycles[1]
    assert best_cycle(cycles, time, np.ones(len(time), dtype=bool)) == cycles[0]


cycle_times = st.tuples(st.floats(0.0, 1.0), st.floats(0.5, 1.5)).map(lambda t: GaitCycle(t[0], t[0] + t[1], None))


@given(cycle_times, st.floats(-100, 100), st.floats(-100, 100), st.integers(2, 200))
def test_a_straight_line_stays_one(cycle: GaitCycle, level: float, slope: float, points: int) -> None:
    time = np.arange(0.0, 3.0, FRAME)
    out = normalise(time, level + slope * time, cycle, points)
    expected = level + slope * np.linspace(cycle.start, cycle.stop, points)
    assert out == pytest.approx(expected, abs=ROUNDING * 1e3)


@given(cycle_times, st.floats(-5, 5), st.floats(0.2, 5))
def test_the_clock_does_not_matter(cycle: GaitCycle, shift: float, scale: float) -> None:
    time = np.arange(0.0, 3.0, FRAME)
    values = np.stack([np.sin(5 * time), np.cos(3 * time)], axis=1)
    moved = GaitCycle(scale * cycle.start + shift, scale * cycle.stop + shift, None)
    here, there = normalise(time, values, cycle), normalise(scale * time + shift, values, moved)
    inside = np.isfinite(here) & np.isfinite(there)
    assert inside[1:-1].all()
    assert here[inside] == pytest.approx(there[inside], abs=1e-6)


@given(cycle_times, st.integers(0, 280), st.integers(1, 19))
def test_a_gap_stays_a_gap_and_nothing_else_becomes_one(cycle: GaitCycle, first: int, length: int) -> None:
    time = np.arange(0.0, 3.0, FRAME)
    values = np.ones(len(time))
    values[first : first + length] = np.nan
    at = np.linspace(cycle.start, cycle.stop, 101)
    out = normalise(time, values, cycle)
    last = min(first + length, len(time)) - 1
    inside = (at > time[first] + ROUNDING) & (at < time[last] - ROUNDING)
    outside = (at < time[max(first - 1, 0)] - ROUNDING) | (at > time[min(last + 1, len(time) - 1)] + ROUNDING)
    assert np.isnan(out[inside]).all()
    assert out[outside] == pytest.approx(1.0)


def test_outside_the_trial_there_is_nothing() -> None:
    time = np.arange(0.0, 1.0, FRAME)
    out = resample(time, np.ones(len(time)), np.array([-0.1, 0.5, 2.0]))
    assert np.isnan(out[[0, 2]]).all() and out[1] == 1.0


def test_a_time_in_single_precision_takes_nothing_from_a_gap_beside_its_frame() -> None:
    """As strikes of C3D files are: the sample at 100 % was invalid where the next frame is."""
    time = 1.23 + 0.01 * np.arange(200)
    values = np.full((200, 2), np.nan)
    at = np.float32(time).astype(float)
    assert (at > time).any() and (at < time).any()
    for frame in range(200):
        values[:], values[frame, 0] = np.nan, 3.0
        np.testing.assert_array_equal(resample(time, values, at[[frame]]), [[3.0, np.nan]])
    between = time[:-1] + 1e-6
    values[:, 0] = np.where(np.arange(200) % 2, np.nan, 3.0)
    assert np.isnan(resample(time, values, between)).all()


WITHIN, BETWEEN, OWN, SHARED = 2.0, 3.0, 1.5, 4.0
EXACT = 1e-10


def table(values: dict[tuple[str, str, int], np.ndarray], valid: np.ndarray | None = None) -> pd.DataFrame:
    """Strides of one variable: (trial, side, stride) -> (m,) values."""
    rows = []
    for (trial, side, stride), curve in values.items():
        for percent, value in enumerate(curve):
            rows.append(
                {
                    "person": "p", "session": "", "trial": trial, "side": side, "stride": stride, "percent": percent,
                    "variable": "knee_angle", "value": value, "se": np.hypot(OWN, SHARED), "valid": 1,
                    "se_stride": OWN,
                }
            )  # fmt: skip
    return pd.DataFrame(rows)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.integers(1, 4), min_size=1, max_size=5), st.integers(0, 2**32 - 1))
def test_statistics_are_those_of_plain_loops_over_what_is_valid(sizes: list[int], seed: int) -> None:
    """Whatever the numbers of strides in trials, with samples missing anywhere."""
    rng = np.random.default_rng(seed)
    trials = np.repeat(np.arange(len(sizes)), sizes)
    values = rng.normal(size=(len(trials), 6))
    values[rng.uniform(size=values.shape) < 0.3] = np.nan
    found = spread(values, trials)
    for point in range(6):
        there = np.isfinite(values[:, point])
        y, of = values[there, point], trials[there]
        groups = [y[of == t] for t in sorted(set(of.tolist()))]
        n, k = len(y), len(groups)
        assert (found.n[point], found.trials[point]) == (n, k)
        if not n:
            assert np.isnan([found.mean[point], found.sd[point]]).all()
            continue
        assert found.mean[point] == pytest.approx(y.mean(), abs=EXACT)
        assert found.sd[point] == pytest.approx(np.std(y, ddof=1) if n > 1 else np.nan, nan_ok=True)
        if n == k:
            assert np.isnan(found.sd_within[point]) and np.isnan(found.sd_between[point])
            continue
        within = sum(((g - g.mean()) ** 2).sum() for g in groups) / (n - k)
        assert found.sd_within[point] == pytest.approx(np.sqrt(within), abs=1e-7)
        if k == 1:
            assert np.isnan(found.sd_between[point])
        else:
            size = (n - sum(len(g) ** 2 for g in groups) / n) / (k - 1)
            apart = sum(len(g) * (g.mean() - y.mean()) ** 2 for g in groups) / (k - 1)
            assert found.sd_between[point] == pytest.approx(np.sqrt(max((apart - within) / size, 0.0)), abs=1e-6)


def test_variances_that_were_put_in_come_out() -> None:
    """Many trials of three strides, with an error that all share: it moves the mean, and is in no spread."""
    rng = np.random.default_rng(1)
    trials, strides, points = 40, 3, 400
    shape = (trials, strides, points)
    values = BETWEEN * rng.normal(size=(trials, 1, points)) + WITHIN * rng.normal(size=shape)
    values = values + OWN * rng.normal(size=shape) + SHARED * rng.normal(size=points)
    labels = np.repeat(np.arange(trials), strides)
    own, total = np.full((len(labels), points), OWN), np.full((len(labels), points), np.hypot(OWN, SHARED))
    found = spread(values.reshape(-1, points), labels, own, total)
    rms = {name: float(np.sqrt(np.mean(getattr(found, name) ** 2))) for name in ("sd_within", "sd_between", "sd_error")}
    assert rms["sd_within"] == pytest.approx(np.hypot(WITHIN, OWN), rel=0.02)
    assert rms["sd_between"] == pytest.approx(BETWEEN, rel=0.03)
    assert rms["sd_error"] == pytest.approx(OWN)
    # The mean misses 0 by what all share and by little more: its standard error says so.
    assert float(np.sqrt(np.mean(found.mean**2))) == pytest.approx(SHARED, rel=0.1)
    assert found.se == pytest.approx(np.sqrt(SHARED**2 + found.sd**2 / len(labels)))


def test_one_stride_has_its_own_standard_error_and_no_spread() -> None:
    found = ensemble(table({("a", "r", 1): np.arange(4.0)}))
    assert tuple(found.columns) == ENSEMBLE_COLUMNS
    assert found["mean"].tolist() == [0.0, 1.0, 2.0, 3.0] and found["sd"].isna().all()
    np.testing.assert_allclose(found["se"], np.hypot(OWN, SHARED))
    assert (found["n"] == 1).all()


def test_samples_that_are_not_valid_are_left_out_percent_by_percent_and_sides_stay_apart() -> None:
    strides = table({("a", "r", 1): np.full(3, 1.0), ("b", "r", 1): np.full(3, 3.0), ("a", "l", 1): np.full(3, 9.0)})
    strides.loc[(strides["trial"] == "b") & (strides["percent"] == 1), "valid"] = 0
    found = ensemble(strides)
    right = found[found["side"] == "r"]
    assert right["n"].tolist() == [2, 1, 2] and right["mean"].tolist() == [2.0, 1.0, 2.0]
    assert right["trials"].tolist() == [2, 1, 2]
    assert found[found["side"] == "l"]["mean"].tolist() == [9.0] * 3


def test_the_order_of_rows_is_no_matter() -> None:
    rng = np.random.default_rng(3)
    strides = table({(t, s, k): rng.normal(size=5) for t, s, k in itertools.product("ab", "rl", (1, 2))})
    mixed = strides.sample(frac=1.0, random_state=4)
    keys = ["side", "percent"]
    one, other = (ensemble(t).sort_values(keys, ignore_index=True) for t in (strides, mixed))
    pd.testing.assert_frame_equal(one, other)


def test_people_and_sessions_are_apart_and_a_stride_twice_is_refused() -> None:
    strides = table({("a", "r", 1): np.zeros(3)})
    later = strides.assign(session="second", value=5.0)
    found = ensemble(pd.concat([strides, later], ignore_index=True))
    assert found.groupby("session")["mean"].mean().to_dict() == {"": 0.0, "second": 5.0}
    with pytest.raises(
        InputError, match="found stride 1 of a, side r, twice; allowed: once for each person and session"
    ):
        ensemble(pd.concat([strides, strides], ignore_index=True))


def test_without_standard_errors_there_is_no_error_and_without_strides_no_row() -> None:
    found = ensemble(table({("a", "r", 1): np.zeros(3), ("a", "r", 2): np.ones(3)}).drop(columns=["se", "se_stride"]))
    assert found["sd_error"].isna().all() and found["se"].isna().all() and found["sd_within"].notna().all()
    assert ensemble(table({}).reindex(columns=[*ENSEMBLE_COLUMNS])).empty


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


def test_peaks_of_phases_count_at_their_ends_but_not_beside_a_seat() -> None:
    phases = ["lowering"] * 50 + ["rising"] * 51
    curve, lost = bump((50.0, -60.0)), np.where(PERCENT < 20, np.nan, -PERCENT)

    def of(variable: str, values: np.ndarray) -> dict[str, tuple[float, float, float, float]]:
        return phase_peaks({variable: (values, NONE, NONE)}, phases)

    found = of("knee_angle_moment", curve)
    assert {name: value[3] for name, value in found.items()} == {
        "in_lowering_knee_extension_moment": 49.0, "in_rising_knee_extension_moment": 50.0}  # fmt: skip
    assert list(of("hip_power", -lost)) == ["in_rising_hip_power_generated"]
    assert list(of("hip_power", lost)) == ["in_lowering_hip_power_absorbed", "in_rising_hip_power_generated"]
    assert "in_lowering_hip_flexion" not in of("hip_flexion", lost), "highest where it leaves the seat"
    strides = [(activity, activity, "r", {**found}) for activity in ("squat", "rise")]
    assert [(m.activity, m.n) for m in peak_means(strides)] == [("squat", 1)] * 2 + [("rise", 1)] * 2
    assert {peak.phase for peak in PHASE_PEAKS.values()} == set(PHASES)


def test_means_are_of_the_strides_peaks_with_shared_errors() -> None:
    """Peaks of 10 and 14 at other percents; c = 2 shared, 1 own: se^2 = 8 / 2 + 2^2."""
    shared = np.sqrt(5.0)
    strides = [
        ("gait", "walk", "r", stride_peaks({"knee_angle": (bump((at, high)), NONE + 1, NONE)}, 62.0) | {
            "knee_flexion_swing": (high, shared, 1.0, at)})
        for at, high in ((72.0, 10.0), (76.0, 14.0))
    ]  # fmt: skip
    (of,) = [m for m in peak_means([*strides, ("gait", "walk", "r", {})]) if m.peak.name == "knee_flexion_swing"]
    assert (of.n, of.strides, of.mean, of.percent) == (2, 3, 12.0, 74.0)
    assert of.sd == pytest.approx(np.sqrt(8.0)) and of.se == pytest.approx(np.sqrt(8.0 / 2 + 4.0))
    assert "62" not in of.peak.words and peak_columns([of])["window"] == ["0 to 100 % of swing"]


@pytest.mark.parametrize("person", ["HC002D", "HC032A"])
def test_peaks_of_a_childs_vendor_curves_are_where_clinics_look_for_them(person: str, data_dir: Path) -> None:
    """Plug-in Gait's own knees and powers, through the same windows: A2 at push-off, K4 at the end of swing."""
    (of_legs,) = [
        {m.peak.name: m.percent for m in peak_means(("gait", "straight", "r", stride_peaks(*s)) for s in strides)}
        for strides in [vendor_strides(data_dir / "children" / person / "straight.c3d")]
    ]
    for name, low, high in (
        ("knee_flexion_swing", 66, 76), ("ankle_power_2", 48, 56), ("knee_power_1", 5, 11), ("knee_power_4", 86, 94),
        ("hip_power_2", 34, 45), ("hip_flexion_swing", 78, 92),
    ):  # fmt: skip
        assert low <= of_legs[name] <= high, name
