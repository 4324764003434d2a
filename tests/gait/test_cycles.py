"""Foot strikes, cycles and normalisation on contacts that are known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gaitcal.gait.cycles import (
    GaitCycle,
    best_cycle,
    foot_events,
    gait_cycles,
    normalise,
    resample,
    runs,
    stances,
    steady,
)

FRAME = 0.01
ROUNDING = 1e-9
"""Linear interpolation of numbers up to 1e3."""


def contact(time: np.ndarray, phase: float) -> np.ndarray:
    return ((time - phase) % 1.1) < 0.66


def swing(time: np.ndarray, phase: float, lag: float) -> tuple[np.ndarray, np.ndarray]:
    """Heel and toe in front of the pelvis: furthest forward `lag` before the strike, furthest back before toe-off."""
    heel = 0.3 * np.cos(2 * np.pi * (time - phase + lag) / 1.1)
    toe = -0.3 * np.cos(2 * np.pi * (time - phase - 0.66 + lag) / 1.1)
    return heel, toe


def test_cycles_run_from_strike_to_next_strike_of_the_same_foot() -> None:
    time = np.arange(0.0, 3.0, FRAME)
    events = foot_events(time, contact(time, 0.2))
    cycles = gait_cycles(events)
    assert [c.start for c in cycles] == pytest.approx([0.2, 1.3], abs=1.5 * FRAME)
    assert [c.stop for c in cycles] == pytest.approx([1.3, 2.4], abs=1.5 * FRAME)
    assert [c.stance for c in cycles] == pytest.approx([60.0, 60.0], abs=2.0)


def test_a_contact_that_the_trial_begins_with_is_no_strike() -> None:
    time = np.arange(0.0, 1.5, FRAME)
    events = foot_events(time, contact(time, -0.1))
    assert events.strikes == pytest.approx([1.0], abs=1.5 * FRAME)
    assert gait_cycles(events) == ()


def test_flickers_of_the_threshold_are_no_steps() -> None:
    time = np.arange(0.0, 3.0, FRAME)
    loaded = contact(time, 0.2)
    loaded[50:54] = False
    loaded[100:103] = True
    assert np.array_equal(steady(time, loaded), contact(time, 0.2))
    assert len(gait_cycles(foot_events(time, loaded))) == 2


def test_without_plates_the_motion_tells_the_strikes() -> None:
    time = np.arange(0.0, 3.0, FRAME)
    heel, toe = swing(time, 0.2, 0.0)
    events = foot_events(time, np.zeros(len(time), dtype=bool), heel, toe)
    assert events.strikes == pytest.approx([0.2, 1.3, 2.4], abs=1.5 * FRAME)
    assert events.toe_offs == pytest.approx([0.86, 1.96], abs=1.5 * FRAME)


def test_steps_beside_the_plates_are_moved_to_mean_the_same_as_those_on_them() -> None:
    time = np.arange(0.0, 3.0, FRAME)
    loaded = contact(time, 0.2) & (time < 1.2)
    heel, toe = swing(time, 0.2, 0.05)
    events = foot_events(time, loaded, heel, toe)
    assert events.strikes == pytest.approx([0.2, 1.3, 2.4], abs=2.5 * FRAME)
    assert len(events.toe_offs) == 2


def test_a_standing_foot_has_no_cycle() -> None:
    time = np.arange(0.0, 3.0, FRAME)
    still = 0.005 * np.sin(9.0 * time)
    events = foot_events(time, np.ones(len(time), dtype=bool), still, still)
    assert len(events.strikes) == 0 and gait_cycles(events) == () and stances(events, time) == ()


def test_stances_also_at_the_ends_of_the_trial() -> None:
    time = np.arange(0.0, 2.0, FRAME)
    found = stances(foot_events(time, contact(time, -0.3)), time)
    assert found[0][0] == time[0] and found[-1][1] == time[-1]
    assert len(found) == 3


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


def test_runs() -> None:
    assert runs(np.array([True, True, False, True])) == [slice(0, 2), slice(3, 4)]
