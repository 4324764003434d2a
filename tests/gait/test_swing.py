"""Strikes and offs from the speed of a foot's slower end, on swings that are known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gaitcal.gait.events import OFF, STRIKE, swing_events

STRIDE, SWING = 1.1, 0.44
"""s."""
STRIKES, OFFS = (0.3, 1.4, 2.5), (0.96, 2.06)
BETWEEN_FRAMES = 0.2
"""Of a frame: what a straight line between two frames misses of a parabola."""


def speed(time: np.ndarray, peak: float = 3.0, first: float = 0.3) -> np.ndarray:
    """A foot that swings along a parabola before each strike, and rests between."""
    phase = (time - first + SWING) % STRIDE
    return np.where(phase < SWING, peak * 4.0 * phase * (SWING - phase) / SWING**2, 0.0)


def part_of_swing(share: float) -> float:
    """Time (s) from the end of a parabola to where it is this share of its peak."""
    return SWING * 0.5 * (1.0 - np.sqrt(1.0 - share))


def frames(rate: float = 100.0, stop: float = 3.0) -> np.ndarray:
    return np.arange(0.0, stop, 1.0 / rate)


@pytest.mark.parametrize("rate", [60.0, 100.0, 250.0])
def test_events_are_where_the_speed_passes_its_thresholds(rate: float) -> None:
    time = frames(rate)
    strikes, offs = swing_events(time, speed(time))
    assert strikes == pytest.approx(np.array(STRIKES) - part_of_swing(STRIKE), abs=BETWEEN_FRAMES / rate)
    assert offs == pytest.approx(np.array(OFFS) + part_of_swing(OFF), abs=BETWEEN_FRAMES / rate)


@given(st.floats(0.3, 4.0), st.floats(0.5, 2.0), st.floats(-50.0, 50.0))
def test_speed_of_walking_and_begin_of_the_clock_do_not_matter(slower: float, stretch: float, shift: float) -> None:
    time = frames()
    here = swing_events(time, speed(time))
    there = swing_events(shift + stretch * time, speed(time, peak=slower * 3.0))
    for a, b in zip(here, there, strict=True):
        assert b == pytest.approx(shift + stretch * a, abs=1e-9 * (1.0 + abs(shift)))


def test_a_dip_within_a_swing_is_no_contact() -> None:
    time = frames()
    dipped = speed(time) * (1.0 - 0.4 * np.exp(-(((time - 1.15) / 0.03) ** 2)))
    for a, b in zip(swing_events(time, speed(time)), swing_events(time, dipped), strict=True):
        assert b == pytest.approx(a, abs=0.005)


def test_a_short_step_among_long_ones_is_a_step() -> None:
    time = frames()
    uneven = np.where((time > 0.9) & (time < 1.5), 0.35, 1.0) * speed(time)
    strikes, offs = swing_events(time, uneven)
    assert len(strikes) == 3 and len(offs) == 2


def test_a_foot_that_sways_or_shuffles_on_the_spot_makes_no_step() -> None:
    time = frames()
    sway = 0.2 * np.abs(np.sin(9.0 * time))
    knock = np.where((time > 0.7) & (time < 0.75), 1.0, 0.0)
    for standing in (sway, speed(time) + np.where(speed(time) > 0, 0.0, 0.2 * np.abs(np.sin(25 * time)))):
        assert len(swing_events(time, standing)[0]) in (0, 3)
    assert all(len(found) == 3 - k for k, found in enumerate(swing_events(time, np.maximum(speed(time), knock))))


def test_a_swing_that_the_trial_cuts_tells_the_end_that_it_shows() -> None:
    time = frames()
    whole = swing_events(time, speed(time))
    late, early = time > 0.22, time < 2.2
    assert swing_events(time[late], speed(time)[late])[0] == pytest.approx(whole[0], abs=1e-9)
    assert swing_events(time[early], speed(time)[early])[1] == pytest.approx(whole[1], abs=1e-9)


@pytest.mark.parametrize("values", [np.zeros(300), np.full(300, np.nan), np.ones(2)])
def test_nothing_is_made_of_nothing(values: np.ndarray) -> None:
    assert all(len(found) == 0 for found in swing_events(0.01 * np.arange(len(values)), values))
