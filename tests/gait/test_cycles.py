"""Foot strikes, cycles, normalisation and peaks on known contacts; mean curves against
plain loops.
"""

import itertools
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gaitcal.errors import Code
from gaitcal.gait.cycles import (
    POINTS,
    EventSource,
    FootEvents,
    GaitCycle,
    find_gait_cycles,
    list_variables,
    normalise,
    remove_flicker,
    resample,
    select_best_cycle,
)
from gaitcal.gait.ensemble import ENSEMBLE_COLUMNS, compute_statistics, ensemble
from gaitcal.gait.peaks import (
    PEAKS,
    PHASE_PEAKS,
    PHASES,
    average_peaks,
    find_phase_peaks,
    find_stride_peaks,
    make_peak_columns,
)
from tests.gait.walks import vendor_strides
from tests.messages import refuses

TIME = np.arange(0.0, 3.0, 0.01)
ROUNDING = 1e-9
"""Linear interpolation of numbers up to 1e3."""


def contact(time: np.ndarray, phase: float) -> np.ndarray:
    return ((time - phase) % 1.1) < 0.66


FEET = FootEvents(
    np.array([0.2, 1.3, 2.4]),
    np.array([0.1, 0.86, 1.96]),
    (EventSource.FILE, EventSource.PLATES, EventSource.MOTION),
)


def test_cycles_are_from_strike_to_next_strike_of_a_foot_with_their_sources() -> None:
    cycles = find_gait_cycles(FEET)
    assert cycles == (
        GaitCycle(0.2, 1.3, 0.86, sources=FEET.sources[:2]),
        GaitCycle(1.3, 2.4, 1.96, sources=FEET.sources[1:]),
    )  # fmt: skip
    assert [c.stance for c in cycles] == pytest.approx([60.0, 60.0])
    assert find_gait_cycles(FootEvents(np.array([0.2, 0.5, 5.0]), np.array([]))) == (), (
        "a flicker and a stop"
    )


def test_flickers_of_the_threshold_are_no_steps() -> None:
    loaded = contact(TIME, 0.2)
    loaded[50:54] = False
    loaded[100:103] = True
    assert np.array_equal(remove_flicker(TIME, loaded), contact(TIME, 0.2))


def test_the_drawn_cycle_is_the_one_with_most_valid_frames() -> None:
    cycles = (GaitCycle(0.0, 1.0, 0.6), GaitCycle(1.0, 2.0, 1.6))
    assert select_best_cycle(cycles, TIME, TIME > 0.9) == cycles[1]
    assert select_best_cycle(cycles, TIME, TIME >= 0.0) == cycles[0]


cycle_times = st.tuples(st.floats(0.0, 1.0), st.floats(0.5, 1.5)).map(
    lambda t: GaitCycle(t[0], t[0] + t[1], None)
)


@given(cycle_times, st.floats(-100, 100), st.floats(-100, 100), st.integers(2, 200))
def test_a_straight_line_stays_one(
    cycle: GaitCycle, level: float, slope: float, points: int
) -> None:
    expected = level + slope * np.linspace(cycle.start, cycle.stop, points)
    assert normalise(TIME, level + slope * TIME, cycle, points) == pytest.approx(
        expected, abs=ROUNDING * 1e3
    )


@given(cycle_times, st.floats(-5, 5), st.floats(0.2, 5))
def test_a_time_offset_does_not_matter(cycle: GaitCycle, shift: float, scale: float) -> None:
    values = np.stack([np.sin(5 * TIME), np.cos(3 * TIME)], axis=1)
    moved = GaitCycle(scale * cycle.start + shift, scale * cycle.stop + shift, None)
    here, there = normalise(TIME, values, cycle), normalise(scale * TIME + shift, values, moved)
    inside = np.isfinite(here) & np.isfinite(there)
    assert inside[1:-1].all()
    assert here[inside] == pytest.approx(there[inside], abs=1e-6)


@given(cycle_times, st.integers(0, 280), st.integers(1, 19))
def test_a_gap_stays_a_gap_and_nothing_else_becomes_one(
    cycle: GaitCycle, first: int, length: int
) -> None:
    values = np.ones(len(TIME))
    values[first : first + length] = np.nan
    at, last = np.linspace(cycle.start, cycle.stop, 101), first + length - 1
    out = normalise(TIME, values, cycle)
    inside = (at > TIME[first] + ROUNDING) & (at < TIME[last] - ROUNDING)
    outside = (at < TIME[max(first - 1, 0)] - ROUNDING) | (
        at > TIME[min(last + 1, len(TIME) - 1)] + ROUNDING
    )
    assert np.isnan(out[inside]).all()
    assert out[outside] == pytest.approx(1.0)


def test_outside_the_trial_there_is_nothing() -> None:
    out = resample(TIME, np.ones(len(TIME)), np.array([-0.1, 0.5, 3.5]))
    np.testing.assert_array_equal(out, [np.nan, 1.0, np.nan])


def test_a_time_in_single_precision_takes_nothing_from_a_gap_next_to_its_frame() -> None:
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


def table(values: dict[tuple[str, str, int], np.ndarray]) -> pd.DataFrame:
    """Strides of one variable: (trial, side, stride) -> (m,) values."""
    same = {
        "person": "p",
        "session": "",
        "variable": "knee_angle",
        "se": np.hypot(OWN, SHARED),
        "valid": 1,
    }
    keys = ("trial", "side", "stride")
    rows = [
        {
            **same,
            **dict(zip(keys, key, strict=True)),
            "percent": percent,
            "value": value,
            "se_stride": OWN,
        }
        for key, curve in values.items()
        for percent, value in enumerate(curve)
    ]
    return pd.DataFrame(rows)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.integers(1, 4), min_size=1, max_size=5), st.integers(0, 2**32 - 1))
def test_statistics_are_those_of_plain_loops_over_what_is_valid(
    sizes: list[int], seed: int
) -> None:
    """Whatever the numbers of strides in trials, with samples missing anywhere."""
    rng = np.random.default_rng(seed)
    trials = np.repeat(np.arange(len(sizes)), sizes)
    values = rng.normal(size=(len(trials), 6))
    values[rng.uniform(size=values.shape) < 0.3] = np.nan
    found = compute_statistics(values, trials)
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
            assert found.sd_between[point] == pytest.approx(
                np.sqrt(max((apart - within) / size, 0.0)), abs=1e-6
            )


def test_variances_that_were_put_in_come_out() -> None:
    """Many trials of three strides, with an error that all share: it moves the mean, and is in no
    spread.
    """
    rng = np.random.default_rng(1)
    trials, strides, points = 40, 3, 400
    shape = (trials, strides, points)
    values = BETWEEN * rng.normal(size=(trials, 1, points)) + WITHIN * rng.normal(size=shape)
    values = values + OWN * rng.normal(size=shape) + SHARED * rng.normal(size=points)
    labels = np.repeat(np.arange(trials), strides)
    individual, total = (
        np.full((len(labels), points), OWN),
        np.full((len(labels), points), np.hypot(OWN, SHARED)),
    )
    found = compute_statistics(values.reshape(-1, points), labels, individual, total)
    rms = {
        name: float(np.sqrt(np.mean(getattr(found, name) ** 2)))
        for name in ("sd_within", "sd_between", "sd_error")
    }
    assert rms["sd_within"] == pytest.approx(np.hypot(WITHIN, OWN), rel=0.02)
    assert rms["sd_between"] == pytest.approx(BETWEEN, rel=0.03)
    assert rms["sd_error"] == pytest.approx(OWN)
    # The mean differs from 0 by the shared error and little more, as its standard error says.
    assert float(np.sqrt(np.mean(found.mean**2))) == pytest.approx(SHARED, rel=0.1)
    assert found.se == pytest.approx(np.sqrt(SHARED**2 + found.sd**2 / len(labels)))


def test_a_single_stride_has_a_standard_error_and_no_spread() -> None:
    found = ensemble(table({("a", "r", 1): np.arange(4.0)}))
    assert tuple(found.columns) == ENSEMBLE_COLUMNS
    assert found["mean"].tolist() == [0.0, 1.0, 2.0, 3.0] and found["sd"].isna().all()
    np.testing.assert_allclose(found["se"], np.hypot(OWN, SHARED))
    assert (found["n"] == 1).all()


def test_invalid_samples_are_left_out_percent_by_percent_and_sides_are_separate() -> None:
    strides = table(
        {
            ("a", "r", 1): np.full(3, 1.0),
            ("b", "r", 1): np.full(3, 3.0),
            ("a", "l", 1): np.full(3, 9.0),
        }
    )
    strides.loc[(strides["trial"] == "b") & (strides["percent"] == 1), "valid"] = 0
    found = ensemble(strides)
    right = found[found["side"] == "r"]
    assert right["n"].tolist() == [2, 1, 2] and right["mean"].tolist() == [2.0, 1.0, 2.0]
    assert right["trials"].tolist() == [2, 1, 2]
    assert found[found["side"] == "l"]["mean"].tolist() == [9.0] * 3


def test_the_order_of_rows_is_no_matter() -> None:
    rng = np.random.default_rng(3)
    strides = table(
        {(t, s, k): rng.normal(size=5) for t, s, k in itertools.product("ab", "rl", (1, 2))}
    )
    mixed = strides.sample(frac=1.0, random_state=4)
    keys = ["side", "percent"]
    one, other = (ensemble(t).sort_values(keys, ignore_index=True) for t in (strides, mixed))
    pd.testing.assert_frame_equal(one, other)


def test_people_and_sessions_are_separate_and_a_stride_twice_is_refused() -> None:
    strides = table({("a", "r", 1): np.zeros(3)})
    found = ensemble(
        pd.concat([strides, strides.assign(session="second", value=5.0)], ignore_index=True)
    )
    assert found.groupby("session")["mean"].mean().to_dict() == {"": 0.0, "second": 5.0}
    with refuses(Code.STRIDE_TABLE, 1, field="strides"):
        ensemble(pd.concat([strides, strides], ignore_index=True))


def test_without_standard_errors_there_is_no_error_and_without_strides_no_row() -> None:
    found = ensemble(
        table({("a", "r", 1): np.zeros(3), ("a", "r", 2): np.ones(3)}).drop(
            columns=["se", "se_stride"]
        )
    )
    assert (
        found["sd_error"].isna().all()
        and found["se"].isna().all()
        and found["sd_within"].notna().all()
    )
    assert ensemble(table({}).reindex(columns=[*ENSEMBLE_COLUMNS])).empty


PERCENT = np.arange(float(POINTS))
NONE = np.full(POINTS, np.nan)


def bump(*at: tuple[float, float]) -> np.ndarray:
    """Bumps of a width of 4 %, each (percent, height)."""
    return np.asarray(
        sum(height * np.exp(-(((PERCENT - place) / 4.0) ** 2)) for place, height in at)
    )


def test_variables_are_those_of_the_table_and_windows_lie_within_the_stride() -> None:
    assert {peak.variable for peak in PEAKS.values()} <= set(list_variables())
    assert all(0.0 <= peak.window[0] <= peak.window[1] <= 2.0 for peak in PEAKS.values())
    loads = [
        peak
        for peak in PEAKS.values()
        if peak.variable.endswith(("_moment", "_power", "_vertical"))
    ]
    assert min(peak.window[0] for peak in loads) == 0.08


STRIKE, SWING, PUSH_OFF = "knee_flexion_strike", "knee_flexion_swing", "plantarflexion_moment"
RISING = PERCENT + 1.5 * (PERCENT == 15.0)
"""deg: a knee that bends on through its loading window, with 1.5 deg more in one sample."""
SWINGING = bump((82.0, 60.0))


def ankle_and_knee(push: float, swing: float) -> dict[str, np.ndarray]:
    """Half of stance and half of swing, in percent of a quick or a slow walk."""
    return {"ankle_angle_moment": -bump((push, 90.0)), "knee_angle": bump((swing, 60.0))}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("curves", "toe_off", "places"),
    [
        pytest.param(ankle_and_knee(44.0, 73.0), 55.0, {PUSH_OFF: 44.0, STRIKE: 0.0, SWING: 73.0},
            id="quick"),
        pytest.param(ankle_and_knee(49.6, 77.2), 62.0, {PUSH_OFF: 50.0, STRIKE: 0.0, SWING: 77.0},
            id="usual"),
        pytest.param(ankle_and_knee(60.0, 85.0), 75.0, {PUSH_OFF: 60.0, STRIKE: 0.0, SWING: 85.0},
            id="slow"),
        pytest.param(
            {"hip_flexion_moment": -bump((1.0, 56.0), (12.0, 30.0))}, 62.0,
            {"hip_extension_moment": 12.0},
            id="the shock of the strike is lower but no peak",
        ),
        pytest.param({"hip_flexion_moment": -bump((1.0, 56.0))}, 62.0, {}, id="the shock alone"),
        pytest.param({"knee_angle": RISING}, 60.0, {STRIKE: 0.0}, id="a wiggle on a rising curve"),
        pytest.param(
            {"knee_angle": RISING + 40.0 * (PERCENT == 15.0)}, 60.0,
            {STRIKE: 0.0, "knee_flexion_loading": 15.0},
            id="a curve that turns there",
        ),
        pytest.param({"knee_angle": bump((50.0, 60.0))}, 0.0, {SWING: 50.0}, id="no stance"),
        pytest.param({"knee_angle": bump((50.0, 60.0))}, 100.0, {STRIKE: 0.0}, id="no swing"),
        pytest.param(
            {"knee_angle": np.where(abs(PERCENT - 74.0) < 4.0, np.nan, SWINGING)}, 62.0,
            {STRIKE: 0.0},
            id="a gap in the window",
        ),
        pytest.param({"knee_angle": SWINGING}, None, {STRIKE: 0.0}, id="an unknown toe-off"),
    ],
)  # fmt: skip
def test_a_peak_is_where_its_curve_turns_within_the_window_of_its_phase(
    curves: dict[str, np.ndarray], toe_off: float | None, places: dict[str, float]
) -> None:
    found = find_stride_peaks(
        {name: (curve, NONE, NONE) for name, curve in curves.items()}, toe_off
    )
    assert {name: at for name, (*_, at) in found.items()} == places
    assert {found[name][0] for name in places} <= {
        value for curve in curves.values() for value in curve
    }


def test_a_range_shares_what_its_ends_share() -> None:
    """5 deg that all strides share is at both ends: only the stride's 1 deg at each end remains."""
    curve, error, individual = (
        10.0 * np.sin(PERCENT / 16.0),
        np.full(POINTS, np.sqrt(26.0)),
        np.ones(POINTS),
    )
    value, total, alone, _ = find_stride_peaks({"pelvis_list": (curve, error, individual)}, 62.0)[
        "pelvis_list_range"
    ]
    assert value == pytest.approx(np.ptp(curve)) and total == pytest.approx(alone) == pytest.approx(
        np.sqrt(2.0)
    )
    assert find_stride_peaks({"pelvis_tilt": (curve, error, individual)}, 62.0)["pelvis_tilt_mean"][
        :2
    ] == pytest.approx((curve.mean(), np.sqrt(26.0)))


def test_peaks_of_phases_count_at_their_ends_but_not_next_to_a_seat() -> None:
    phases = ["lowering"] * 50 + ["rising"] * 51
    curve, lost = bump((50.0, -60.0)), np.where(PERCENT < 20, np.nan, -PERCENT)

    def of(variable: str, values: np.ndarray) -> dict[str, tuple[float, float, float, float]]:
        return find_phase_peaks({variable: (values, NONE, NONE)}, phases)

    found = of("knee_angle_moment", curve)
    assert {name: value[3] for name, value in found.items()} == {
        "in_lowering_knee_extension_moment": 49.0,
        "in_rising_knee_extension_moment": 50.0}  # fmt: skip
    assert list(of("hip_power", -lost)) == ["in_rising_hip_power_generated"]
    assert list(of("hip_power", lost)) == [
        "in_lowering_hip_power_absorbed",
        "in_rising_hip_power_generated",
    ]
    assert "in_lowering_hip_flexion" not in of("hip_flexion", lost), (
        "highest where it leaves the seat"
    )
    strides = [(activity, activity, "r", {**found}) for activity in ("squat", "rise")]
    assert [(m.activity, m.n) for m in average_peaks(strides)] == [("squat", 1)] * 2 + [
        ("rise", 1)
    ] * 2
    assert {peak.phase for peak in PHASE_PEAKS.values()} == set(PHASES)


def test_means_are_of_the_strides_peaks_with_shared_errors() -> None:
    """Peaks of 10 and 14 at other percents; c = 2 shared, 1 individual: se^2 = 8 / 2 + 2^2."""
    shared = np.sqrt(5.0)
    strides = [
        ("gait", "walk", "r", find_stride_peaks({"knee_angle": (bump((at, high)), NONE + 1, NONE)},
            62.0) | {
            "knee_flexion_swing": (high, shared, 1.0, at)})
        for at, high in ((72.0, 10.0), (76.0, 14.0))
    ]  # fmt: skip
    (of,) = [
        m
        for m in average_peaks([*strides, ("gait", "walk", "r", {})])
        if m.peak.name == "knee_flexion_swing"
    ]
    assert (of.n, of.strides, of.mean, of.percent) == (2, 3, 12.0, 74.0)
    assert of.sd == pytest.approx(np.sqrt(8.0)) and of.se == pytest.approx(np.sqrt(8.0 / 2 + 4.0))
    assert "62" not in of.peak.window_label and make_peak_columns([of])["window"] == [
        "0 to 100 % of swing"
    ]


@pytest.mark.parametrize("person", ["HC002D", "HC032A"])
def test_peaks_of_a_childs_vendor_curves_are_where_clinics_look_for_them(
    person: str, data_dir: Path
) -> None:
    """Plug-in Gait's own knees and powers, through the same windows: A2 at push-off, K4 at the end
    of swing.
    """
    (of_legs,) = [
        {
            m.peak.name: m.percent
            for m in average_peaks(
                ("gait", "straight", "r", find_stride_peaks(*s)) for s in strides
            )
        }
        for strides in [vendor_strides(data_dir / "children" / person / "straight.c3d")]
    ]
    for name, low, high in (
        ("knee_flexion_swing", 66, 76), ("ankle_power_2", 48, 56), ("knee_power_1", 5, 11),
        ("knee_power_4", 86, 94),
        ("hip_power_2", 34, 45), ("hip_flexion_swing", 78, 92),
    ):  # fmt: skip
        assert low <= of_legs[name] <= high, name
