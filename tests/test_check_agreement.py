"""`scripts/check_agreement.py`: a person without noise agrees with itself, one with a wrong half does not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gaitcal import InputError
from tests.scripts import script
from tests.synthetic_studies import write_synthetic_study

EXACT_M = 1e-3
"""m: markers without noise, of which each half tells the hips."""


@pytest.mark.slow
def test_hips_of_a_person_without_noise_agree(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    check = script("check_agreement")
    gaps, ratios = check.main([str(write_synthetic_study(tmp_path, ("hip_r",)))])
    assert [(g.hip, g.segment) for g in gaps] == [("hip_r", "pelvis"), ("hip_r", "thigh")]
    assert all(g.distance < EXACT_M and (g.error > 0).all() for g in gaps)
    assert set(ratios) == {"walk", "hip_r"}
    said = capsys.readouterr().out
    assert "hip_r  in pelvis" in said and "6 of 6 coordinates within 2 standard errors" in said


def test_gaps_are_told_in_mm_and_in_standard_errors_of_the_difference() -> None:
    check = script("check_agreement")
    gap = check.HipGap(hip="hip_l", segment="thigh", gap=np.array([0.003, 0.0, -0.004]), error=np.full(3, 0.001))
    assert gap.distance == pytest.approx(0.005)
    np.testing.assert_allclose(gap.standardised, [3.0, 0.0, -4.0])
    said = list(check.lines([gap], {"walk": 1.25}))
    assert "5.0       3.0 (+3.0)" in said[1]
    assert said[2] == "1 of 3 coordinates within 2 standard errors, the largest 4.0"
    assert said[-1].split() == ["walk", "1.25"]


def test_a_study_without_isolated_trials_has_no_halves(tmp_path: Path) -> None:
    check = script("check_agreement")
    with pytest.raises(InputError, match="role = 'joint'"):
        check.main([str(write_synthetic_study(tmp_path))])
