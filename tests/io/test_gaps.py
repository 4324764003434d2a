"""Gap statistics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gaitcal.io.intervals import marker_gaps
from tests.io.recordings import body


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
