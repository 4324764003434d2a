"""What is advised where trials do not determine a joint: nothing that was done already."""

from __future__ import annotations

import numpy as np

from gaitcal.calibration.identifiability import in_words

UNSEEN = ("talocrural_r.shank.front", "subtalar_r.foot.sag")


def advice(turned: dict[str, dict[str, float]]) -> dict[str, str]:
    return {f.found.split(".")[0]: f.cure for f in in_words(UNSEEN, "kept", turned)}


def test_an_isolated_trial_is_asked_for_where_there_is_none() -> None:
    assert all("add an isolated ankle trial of the right leg" in line for line in advice({}).values())
    other = {"ankle_l": {"ankle_angle": 1.1, "subtalar_angle": 0.6}}
    assert all("add an isolated ankle trial" in line for line in advice(other).values())


def test_not_where_one_with_62_deg_was_given() -> None:
    told = advice({"ankle_r": {"ankle_angle": np.deg2rad(62.0), "subtalar_angle": np.deg2rad(12.0)}})
    assert all("add an isolated" not in line and "62 deg in dorsiflexion" in line for line in told.values())
    assert "enough" in told["talocrural_r"]
    assert "move inversion further" in told["subtalar_r"]
