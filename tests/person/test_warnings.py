"""What is said against a finished calibration: when, with which numbers, and with which cure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gaitcal.dynamics import residual_limits as rules
from gaitcal.dynamics.residual_limits import residual_limits
from gaitcal.person.result import Calibration, Stage, TrialResult
from gaitcal.person.warnings import disagreements, large_residuals
from tests.fake_result import fake_calibration


@pytest.fixture(scope="module")
def whole() -> Calibration:
    return fake_calibration()


def with_residual(trial: TrialResult, force: float, moment: float) -> TrialResult:
    """Residuals of the last step with these magnitudes in every frame (N, N·m), along x and z."""
    assert trial.loads is not None
    last = trial.loads.final
    x, z = (np.tile(axis, (len(last.residual_force), 1)) for axis in ([1.0, 0.0, 0.0], [0.0, 0.0, 1.0]))
    last = replace(last, residual_force=force * x, residual_moment=moment * z)
    return replace(trial, loads=replace(trial.loads, moments={**trial.loads.moments, Stage.JP_IP: last}))


def test_residuals_are_told_above_the_limits_of_the_report_and_not_below(whole: Calibration) -> None:
    trial, parameters = whole.trial("walk"), whole.model.parameters
    assert trial.loads is not None
    limits = residual_limits(parameters, trial.body.q, trial.loads.reactions, trial.recording.plates)

    def told(force: float, moment: float) -> list[str]:
        return list(large_residuals([with_residual(trial, force * limits.force, moment * limits.moment)], parameters))

    assert told(0.99, 0.99) == []
    (force,) = told(1.1, 0.99)
    assert (
        force.startswith("walk: ") and "force 77 N RMS, limit 70 N (5 % of the peak ground reaction of 1400 N" in force
    )
    assert "moment" not in force.partition("pelvis:")[2]
    (moment,) = told(0.99, 1.1)
    assert f"moment {1.1 * limits.moment:.1f} N·m RMS, limit {limits.moment:.1f} N·m" in moment
    assert "force 69" not in moment
    (both,) = told(1.1, 1.1)
    assert "N RMS" in both and "N·m RMS" in both


def test_the_limits_are_those_of_one_place(whole: Calibration, monkeypatch: pytest.MonkeyPatch) -> None:
    trial = with_residual(whole.trial("walk"), 60.0, 0.0)
    assert list(large_residuals([trial], whole.model.parameters)) == []
    monkeypatch.setattr(rules, "FORCE_SHARE", 0.04)
    assert len(list(large_residuals([trial], whole.model.parameters))) == 1


def test_trials_without_forces_or_valid_frames_have_no_residual() -> None:
    for made in (fake_calibration(plates=False), fake_calibration(valid=False)):
        assert list(large_residuals(made.trials, made.model.parameters)) == []


def test_a_trial_that_is_met_worse_is_told(whole: Calibration) -> None:
    knee = whole.trial("knee")
    worse = replace(
        knee, final=replace(knee.final, errors=replace(knee.final.errors, distance=3.0 * knee.final.errors.distance))
    )
    assert list(disagreements([knee])) == []
    (told,) = disagreements([worse])
    assert told.startswith("knee: ") and told.endswith("the trials disagree")
