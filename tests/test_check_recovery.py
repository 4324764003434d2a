"""`scripts/check_recovery.py` at small size: whole calibrations, through files, with error bars that hold."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from tests.scripts import script

SEEDS = (3, 4, 5)
"""Three people: errors of one person go together, so that their coverage scatters by some 10 %."""


@pytest.mark.slow
@pytest.mark.parametrize("settings", ["synthesized", "default", "gait-only"])
def test_intervals_of_whole_calibrations_cover_the_truth(settings: str) -> None:
    check = script("check_recovery")
    people = [check.synthetic_person(seed, check.Settings(settings)) for seed in SEEDS]
    parameters = pd.concat([p.parameters for p in people])
    joint = parameters[parameters["kind"].str.startswith("joint")]["z"].dropna()
    for z in (joint, np.concatenate([p.torques.ravel() for p in people])):
        # wide for these people, who vary less (within 10 mm, 10 deg, 10 %) than people of whom priors are
        assert 55.0 < 100.0 * np.mean(np.abs(z) < 1.0) < 92.0
        assert 100.0 * np.mean(np.abs(z) < 1.96) > 86.0
    report = list(check.lines(people))
    assert any(line.startswith("knee       position") and "in 95 %" in line for line in report)
    assert any(line.startswith("subtalar_angle_l") for line in report)
