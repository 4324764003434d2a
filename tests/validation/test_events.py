"""`python -m scripts.validation events`: motion against plates on people whose contacts are known, and its own sums."""

from pathlib import Path

import numpy as np
import pytest

from gaitcal.io.labels import FootEvent, FootMoment
from scripts.validation import events as check
from scripts.validation.harness import results
from tests.real_studies import write_study

NEAR_MS = 35.0
"""ms: `subject01` walks on a treadmill, recorded at 60 Hz; its feet slide a little after each contact."""


def test_motion_is_measured_against_plates(data_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    labs = results("events", str(write_study("subject01", data_dir, tmp_path)))
    for moment in FootMoment:
        found = 1e3 * check.all_differences(labs["subject01"], check.RULES["ours"], moment)
        assert len(found) == 3 and np.isfinite(found).all()
        assert np.abs(found).max() < NEAR_MS and found.std() < 0.2 * NEAR_MS
    said = capsys.readouterr().out.splitlines()
    assert said[1].startswith("subject01   foot strike") and "ours plates" in said[1] and "(3)" in said[1]


def test_differences_are_found_less_true_and_missing_ones_are_counted() -> None:
    strike, time = FootMoment.STRIKE, np.arange(0.0, 5.0, 0.01)
    truth = [FootEvent(strike, side, t) for side, t in (("r", 1.0), ("l", 2.0), ("r", 3.0), ("r", 4.9))]
    found = [FootEvent(strike, "r", 1.02), FootEvent(FootMoment.OFF, "l", 2.0), FootEvent(strike, "r", 2.99)]
    differences = np.array(check.differences(found, truth, strike, time))
    np.testing.assert_allclose(differences, [0.02, np.nan, -0.01])
    assert check.told(differences) == "   5 ± 15 (2, 1 missed)"
    assert check.told(np.array([])) == "-"
