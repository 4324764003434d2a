"""What is said against a finished calibration: when, with which numbers, and with which cure."""

from __future__ import annotations

from dataclasses import replace

import pytest

from gaitcal.person.result import Calibration
from gaitcal.person.warnings import disagreements
from tests.fake_result import fake_calibration


@pytest.fixture(scope="module")
def whole() -> Calibration:
    return fake_calibration()


def test_a_trial_that_is_met_worse_is_told(whole: Calibration) -> None:
    knee = whole.trial("knee")
    worse = replace(
        knee, final=replace(knee.final, errors=replace(knee.final.errors, distance=3.0 * knee.final.errors.distance))
    )
    assert list(disagreements([knee])) == []
    (told,) = disagreements([worse])
    assert told.startswith("knee: ") and told.endswith("the trials disagree")
