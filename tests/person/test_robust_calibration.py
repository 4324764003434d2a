"""Spoilt markers move calibrated joint parameters by less than 3 mm and 2 deg under a robust loss."""

from __future__ import annotations

from collections.abc import Iterator
from types import ModuleType

import numpy as np
import pytest

from gaitcal.study.study import Study
from scripts.validation import robustness as robustness_check

LOST = "one lost for half"
Sought = tuple[np.ndarray, tuple[str, ...]]
"""Joint parameters, and the names of those fitted."""


@pytest.fixture(scope="module")
def robustness() -> ModuleType:
    return robustness_check


@pytest.fixture(scope="module")
def study(robustness: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Study]:
    """One isolated trial: the knee. What it gives unspoilt, by loss, is sought once for both tests."""
    made: Study = robustness.made_study(tmp_path_factory.mktemp("made") / "study", 2, 0.003, ("knee_r",))
    sought = robustness.joint_parameters
    clean: dict[str, Sought] = {}

    def joint_parameters(study: Study, loss: str) -> Sought:
        if study is not made:
            return sought(study, loss)
        if loss not in clean:
            clean[loss] = sought(study, loss)
        return clean[loss]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(robustness, "joint_parameters", joint_parameters)
        yield made


@pytest.mark.slow
def test_spoilt_markers_move_little(robustness: ModuleType, study: Study) -> None:
    moved = [c for c in robustness.changes(study, 2, ("cauchy",), robustness.SPOILS) if c.against == "cauchy"]
    assert len(moved) == len(robustness.SPOILS)
    assert [change for change in moved if not change.small and change.spoil != LOST] == []
    (lost,) = (change for change in moved if change.spoil == LOST)
    assert lost.position_mm < 4.0 and lost.orientation_deg < 2.0  # no outlier: what it told is gone


@pytest.mark.slow
def test_least_squares_would_not_do(robustness: ModuleType, study: Study) -> None:
    swap = {"pair swapped": robustness.SPOILS["pair swapped, one segment"]}
    (moved,) = robustness.changes(study, 2, ("none",), swap)
    assert not moved.small
