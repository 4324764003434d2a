"""Columns of times: freed of rounding where that is all that is wrong with them."""

import numpy as np
import pytest

from gaitcal.io.text_file import FileFault, require_increasing, undo_rounding

RATE = 60.0
EXACT = 7 / RATE + np.arange(40) / RATE


@pytest.mark.parametrize("shorten", [np.round, np.floor, np.ceil])
def test_times_written_to_the_millisecond_are_put_back(shorten: np.ufunc) -> None:
    """Rounded to the nearest, cut off, or rounded up: up to a whole unit of the last digit."""
    time, notes = undo_rounding(shorten(1e3 * EXACT) / 1e3)
    np.testing.assert_allclose(time, EXACT, atol=1e-12)
    assert "put back on their 60 Hz grid" in notes[0]


def test_times_that_are_no_rounded_grid_stay() -> None:
    jittered = np.round(EXACT, 3)
    jittered[20] += 0.002
    time, notes = undo_rounding(jittered)
    np.testing.assert_array_equal(time, jittered)
    assert notes == ()
    jittered[20] += 0.005
    assert "uneven" in undo_rounding(jittered)[1][0]


def test_times_must_increase_by_more_than_nothing() -> None:
    require_increasing(np.array([0.0, 0.1, 0.2]), (4, 5, 6))
    with pytest.raises(FileFault, match="found 0.1 s after 0.1 s"):
        require_increasing(np.array([0.0, 0.1, 0.1]), (4, 5, 6))
