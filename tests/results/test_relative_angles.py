"""`angles = "relative"`: in tables of a calibration and of further trials, never in the .mot."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gaitcal.errors import InputError
from gaitcal.io.opensim_files import read_table
from gaitcal.model.linkage import COORDINATES
from gaitcal.results.calibration import write_trial
from gaitcal.results.saved import _static_angles
from gaitcal.results.summary import STATIC_ANGLES, summary
from tests.fake_result import fake_calibration

WRITTEN_DEG = 1e-4
"""What rounding to four places leaves."""


def test_tables_are_relative_and_the_mot_is_not(tmp_path: Path) -> None:
    calibration = fake_calibration(plates=False)
    trial = next(t for t in calibration.trials if t.joint is None)
    write_trial(trial, calibration.model, tmp_path, {"hip_flexion_r": np.deg2rad(11.0)})
    text = (tmp_path / "motion" / f"{trial.name}.csv").read_text(encoding="utf-8")
    assert "# static trial, deg: hip_flexion_r 11.00\n" in text
    table = pd.read_csv(tmp_path / "motion" / f"{trial.name}.csv", comment="#")
    anatomical = np.rad2deg(trial.body.q[:, COORDINATES.index("hip_flexion_r")])
    np.testing.assert_allclose(table["hip_flexion_r"], anatomical - 11.0, atol=WRITTEN_DEG)
    mot = read_table(tmp_path / "motion" / f"{trial.name}.mot")
    np.testing.assert_allclose(mot.column("hip_flexion_r"), anatomical, atol=WRITTEN_DEG)


def test_static_angles_come_back_from_the_summary(tmp_path: Path) -> None:
    angles = {"pelvis_tx": 0.1, "hip_flexion_r": 0.2, "ankle_angle_l": -0.05}
    entries = summary(replace(fake_calibration(), static_angles=angles))
    back = _static_angles(entries, tmp_path)
    assert back == pytest.approx({n: v for n, v in angles.items() if n != "pelvis_tx"}, abs=np.deg2rad(WRITTEN_DEG))
    with pytest.raises(InputError, match="calibrate again"):
        _static_angles({k: v for k, v in entries.items() if k != STATIC_ANGLES}, tmp_path)
