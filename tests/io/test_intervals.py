"""Stretches of frames, and the gaps of markers."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gaitcal.io.still import duration, marker_gaps, runs, spans
from tests.io.recordings import body


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


def test_stretches_as_times() -> None:
    time = np.arange(8) / 10
    stretches = [slice(0, 3), slice(4, 6)]
    assert [duration(time, stretch) for stretch in stretches] == [0.2, 0.5 - 0.4]
    assert spans(time, stretches) == "0.00-0.20, 0.40-0.50 s"
    assert spans(time, stretches, most=1) == "0.00-0.20 s and 1 more"


def test_seen_share_and_longest_gap() -> None:
    recording = body(101)  # 1 s
    markers = recording.markers.copy()
    markers[10:20, 0] = np.nan
    markers[50:53, 0] = np.nan
    markers[:30, 1] = np.nan
    markers[90:, 2] = np.nan
    markers[:, 3] = np.nan
    markers[40, 4] = np.nan
    gaps = marker_gaps(replace(recording, markers=markers))
    assert [g.label for g in gaps] == list(recording.labels)
    assert [round(g.seen * 101) for g in gaps[:5]] == [88, 71, 90, 0, 100]
    assert [g.longest_gap for g in gaps[:5]] == pytest.approx([0.11, 0.30, 0.11, 1.0, 0.02])
