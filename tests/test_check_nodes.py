"""`scripts/check_nodes.py`: too few nodes cannot follow a walk, which shows in the frames left out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.scripts import script
from tests.synthetic_studies import write_synthetic_study


def test_prediction_of_frames_left_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    script("check_nodes").main([str(write_synthetic_study(tmp_path))])
    heading, *rows = capsys.readouterr().out.splitlines()
    assert heading.split()[-8:] == ["8", "10", "12", "15", "20", "25", "30", "40"]
    assert len(rows) == 2
    for row in rows:
        errors = np.array([float(word) for word in row.split()[-8:]])
        assert errors[0] > 2 * errors[4]


def test_frames_left_out_come_in_runs_and_keep_the_ends() -> None:
    held = script("check_nodes").left_out(200, 5)
    edges = np.flatnonzero(np.diff(held.astype(int)))
    assert (np.diff(edges)[::2] == 5).all()
    assert not held[:10].any() and not held[-10:].any()
    assert 15 <= held.sum() <= 20
