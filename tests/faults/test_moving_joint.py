"""Isolated trials: one joint moves, and nothing else."""

from __future__ import annotations

from dataclasses import replace

import pytest

from gaitcal.faults.study import check_study
from gaitcal.study.study import Study
from tests.faults.spoilt import sound_study, with_trial


@pytest.fixture(scope="module")
def study() -> Study:
    return sound_study()


def test_a_walk_that_is_declared_for_one_joint(study: Study) -> None:
    walk = next(t.recording for t in study.trials if t.name == "walk")
    found = [f for f in check_study(with_trial(study, "knee_r", lambda _: walk)) if f.topic == "role"]
    assert [f.cause for f in found] == ["the trial is declared for knee_r alone, but this looks like a walk"]
    assert "the pelvis goes" in found[0].found and "of the other leg turn by" in found[0].found
    on_the_spot = replace(walk, markers=walk.markers - walk.markers[:, :, :].mean(axis=1, keepdims=True) * [1, 0, 1])
    (still,) = [f for f in check_study(with_trial(study, "knee_r", lambda _: on_the_spot)) if f.topic == "role"]
    assert "the pelvis goes" not in still.found and "of the other leg turn by" in still.found
