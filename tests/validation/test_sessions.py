"""`python -m scripts.validation sessions`: what it prints of figures that are known, and that it runs."""

import numpy as np
import pytest

from scripts.validation.harness import results


def test_the_part_inside_error_bars() -> None:
    from scripts.validation.error_bars import coverage

    told = coverage(np.array([0.5, -0.9, 1.5, 3.0]))
    assert told == "50% of 4 inside 68 %, 75% inside 95 %, RMS 1.75 standard errors"


@pytest.mark.slow
def test_a_made_up_person_comes_twice(capsys: pytest.CaptureFixture[str]) -> None:
    results("sessions", "--parts", "made-up", "--people", "1")
    said = capsys.readouterr().out
    assert "joint positions, mm RMS: nominal" in said and "nearer the truth together than alone" in said
