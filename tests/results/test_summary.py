"""The figures of `summary.json` that stand beside each other."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import pytest

from gaitcal.page.report import report_html
from gaitcal.results.summary import trial_summary
from tests.fake_result import fake_calibration


def test_a_trial_and_its_segments_have_both_floors_and_ratios() -> None:
    trial = fake_calibration().trials[0]
    out = cast(Any, trial_summary(trial))
    for rms in (out["rms_mm"], out["pelvis_and_legs_mm"], out["segments"]["thigh_r"]["rms_mm"]):
        assert rms["joint_floor"] == pytest.approx(1.1 * rms["rigid_floor"])
        assert rms["calibrated_to_joint_floor"] == pytest.approx(rms["calibrated"] / rms["joint_floor"])
        assert rms["calibrated_to_floor"] == pytest.approx(rms["calibrated"] / rms["rigid_floor"])
    assert out["joint_floor_mm"] == {"hip_r": 5.3, "knee_r": 5.4, "ankle_r": 5.5}
    assert "joint_floor" not in out["segments"]["thigh_l"]["rms_mm"], "in no joint: absent, never 0"


def test_without_a_joint_there_is_no_joint_floor() -> None:
    whole = fake_calibration()
    trial = replace(whole.trials[0], joint_floor=None)
    out = cast(Any, trial_summary(trial))
    assert "joint_floor_mm" not in out
    assert not [key for key in out["rms_mm"] if "joint_floor" in key]
    assert "Joint floor" in report_html(replace(whole, trials=(trial,)))
