"""Standard errors at small size: `python -m scripts.validation coverage` has them at 200 draws."""

import numpy as np
import pytest

from scripts.validation import coverage as check
from scripts.validation.error_bars import shares

DRAWS = 24
RANGES = {"68 %": (55.0, 82.0), "95 %": (87.0, 99.5)}
"""What 24 draws leave of 60 to 76 % and 91 to 98 %: errors of one draw are correlated, so that the coverage scatters by
some 4 %."""


@pytest.mark.slow
def test_intervals_cover_the_truth_as_often_as_they_say() -> None:
    found = check.draws(DRAWS, 0.010, 1, 1)
    assert [values.shape[0] for values in found.values()] == [DRAWS] * 6
    for name, values in found.items():
        of_bars = np.sqrt(np.mean(values**2))
        assert 0.7 < of_bars < 1.3, name
        for level, share in zip(RANGES, shares(values), strict=True):
            low, high = RANGES[level]
            assert low <= share <= high or (name == check.HEARS_FEW_WAVES and level == "68 %"), (name, level)


def test_coverage_counts() -> None:
    errors = np.random.default_rng(0).normal(size=100_000)
    assert shares(errors)[0] == pytest.approx(68.3, abs=0.5)
    assert shares(1.5 * errors)[1] == pytest.approx(80.9, abs=0.5)
