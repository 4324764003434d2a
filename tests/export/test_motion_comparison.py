"""OpenSim's motion and moments with a model, next to ours."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaitcal.export.opensim.motion_comparison import (
    BothCurves,
    _explain_differences,
    compare_motion,
)
from gaitcal.export.opensim.osim_correspondence import find_leg_joints
from gaitcal.export.opensim.osim_reader import read_osim
from gaitcal.model.linkage import is_translation
from gaitcal.results.opensim_motions import load_compared_trials
from gaitcal.results.saved_result import load_result_model
from tests.kept import kept_result
from tests.messages import check_text

SAME_DEG, SAME_NM, MISSED = 0.05, 0.5, 5e-5
"""deg and N·m RMS, m: markers without noise; what the solver's accuracy leaves, and a prior of soft
tissue, which is never quite absent."""


@pytest.mark.slow
@pytest.mark.peers
def test_our_own_model_moves_and_pulls_as_ours(
    kept: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("opensim")
    monkeypatch.chdir(tmp_path)
    result = kept_result(kept) / "result"
    trials = [t for t in load_compared_trials(result) if t.torques is not None]
    for k, trial in enumerate(trials):
        seen = trial.markers.markers.copy()
        seen[3:6, -1] = np.nan  # the last of a row
        trials[k] = replace(trial, markers=replace(trial.markers, markers=seen))
    found = compare_motion(load_result_model(result)[0], result / "model.osim", trials)
    assert "MODEL" not in capfd.readouterr().out, "OpenSim's tools print what a model holds"
    assert not list(tmp_path.iterdir()), "its log"
    curves = {(c.coordinate, c.unit): c for c in found.curves}
    for joint in ("hip_flexion", "hip_adduction", "knee_angle", "ankle_angle"):
        for side in "rl":
            angle, moment = (curves[f"{joint}_{side}", unit] for unit in ("deg", "N·m"))
            assert max(abs(angle.offset), angle.residual) < SAME_DEG, angle
            assert max(abs(moment.offset), moment.residual) < SAME_NM < np.ptp(moment.ours), moment
    assert not any(is_translation(name) for name, _ in curves)
    assert max(found.marker_errors) < MISSED and not found.notes


def test_another_zero_and_a_rolling_knee_are_reported(data_dir: Path) -> None:
    peer = read_osim(data_dir / "subject01/reference/subject01_simbody.osim")
    knee = np.linspace(0.0, 90.0, 50)
    curve = BothCurves(
        coordinate="knee_angle_r", unit="deg", ours=knee, theirs=knee + 6.0 + 0.1 * np.sin(knee)
    )
    assert (
        curve.offset == pytest.approx(6.0, abs=0.05)
        and 0.0 < curve.residual < 0.1
        and curve.correlation > 0.99
    )
    rolls, zero = _explain_differences(peer, find_leg_joints(peer), [curve])
    check_text(rolls, "knee_r")
    check_text(zero, "knee_angle_r", 6.0)
    locked = replace(curve, coordinate="subtalar_angle_r", theirs=np.zeros(50))
    check_text(
        [*_explain_differences(peer, find_leg_joints(peer), [locked])][-1], "subtalar_angle_r"
    )
    assert np.isnan(locked.correlation)
