"""`scripts/check_sessions.py`: what it prints of figures that are known, and that it runs."""

from __future__ import annotations

import numpy as np
import pytest

from tests.scripts import script


def test_the_part_inside_error_bars() -> None:
    script("check_sessions")
    from sessions.coverage import coverage

    told = coverage(np.array([0.5, -0.9, 1.5, 3.0]))
    assert told == "50% of 4 inside 68 %, 75% inside 95 %, RMS 1.75 standard errors"


def test_a_part_that_it_does_not_know_is_refused() -> None:
    with pytest.raises(SystemExit):
        script("check_sessions").main(["--parts", "imagined"])


@pytest.mark.slow
def test_a_made_up_person_comes_twice(capsys: pytest.CaptureFixture[str]) -> None:
    assert script("check_sessions").main(["--parts", "made-up", "--people", "1"]) == 0
    said = capsys.readouterr().out
    assert "joint positions, mm RMS: nominal" in said and "nearer the truth together than alone" in said
