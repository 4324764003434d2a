"""Stretches of frames."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from gaitcal.io.intervals import duration, runs, spans


@given(st.lists(st.booleans(), max_size=40), st.integers(1, 5))
def test_runs_are_all_stretches_that_are_long_enough(marked: list[bool], shortest: int) -> None:
    found = runs(np.array(marked, dtype=bool), shortest)
    frames = {k for run in found for k in range(run.start, run.stop)}
    assert all(marked[k] for k in frames)
    for run in found:
        assert run.stop - run.start >= shortest
        assert run.start == 0 or not marked[run.start - 1]
        assert run.stop == len(marked) or not marked[run.stop]
    if shortest == 1:
        assert frames == {k for k, mark in enumerate(marked) if mark}


def test_the_shortest_run_counts() -> None:
    marked = np.array([1, 1, 1, 0, 1, 1, 0, 1], dtype=bool)
    assert runs(marked, 3) == [slice(0, 3)]
    assert runs(marked, 2) == [slice(0, 3), slice(4, 6)]


def test_stretches_as_times() -> None:
    time = np.arange(8) / 10
    stretches = [slice(0, 3), slice(4, 6)]
    assert [duration(time, stretch) for stretch in stretches] == [0.2, 0.5 - 0.4]
    assert spans(time, stretches) == "0.00-0.20, 0.40-0.50 s"
    assert spans(time, stretches, most=1) == "0.00-0.20 s and 1 more"
