"""Foot strikes, cycles and normalisation on contacts that are known."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gaitcal.gait.cycles import (
    EventSource,
    FootEvents,
    GaitCycle,
    best_cycle,
    gait_cycles,
    normalise,
    resample,
    stances,
    steady,
)

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
