"""Spoilt markers move calibrated joint parameters by less than 3 mm and 2 deg under a robust loss."""

from __future__ import annotations

from types import ModuleType

import pytest

from gaitcal.study.study import Study
from tests.scripts import script


@pytest.fixture(scope="module")
def robustness() -> ModuleType:
    return script("check_robustness")


@pytest.fixture(scope="module")
def study(robustness: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Study:
    """One isolated trial: the knee."""
    made: Study = robustness.made_study(tmp_path_factory.mktemp("made") / "study", 2, 0.003, ("knee_r",))
    return made


@pytest.mark.slow
def test_spoilt_markers_move_little(robustness: ModuleType, study: Study) -> None:
    moved = [c for c in robustness.changes(study, 2, ("cauchy",), robustness.SPOILS) if c.against == "cauchy"]
    assert len(moved) == len(robustness.SPOILS)
    assert [change for change in moved if not change.small] == []


@pytest.mark.slow
def test_least_squares_would_not_do(robustness: ModuleType, study: Study) -> None:
    swap = {"pair swapped": robustness.SPOILS["pair swapped, one segment"]}
    (moved,) = robustness.changes(study, 2, ("none",), swap)
    assert not moved.small
