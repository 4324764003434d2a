"""Fitted and nominal joints are told apart by everybody, on a light page and a dark one, and before a bone."""

import re
from importlib.resources import files

import numpy as np
import pytest

from tests.page.colour_vision import SIGHT, ciede2000, contrast, seen_apart

PLAIN = 20.0
"""CIEDE2000 at which two thin rods are plainly of two colours; 10 is plain for areas side by side."""
GRAPHIC = 3.0
"""WCAG 2.1, 1.4.11: least contrast of what must be seen with what is around."""


@pytest.fixture(scope="module")
def colours() -> dict[str, int]:
    script = (files("gaitcal.page") / "scripts" / "body.js").read_text(encoding="utf-8")
    return {name: int(code, 16) for name, code in re.findall(r"(\w+): 0x([0-9a-f]{6})", script)}


@pytest.fixture(scope="module")
def grounds() -> list[int]:
    """What is behind the body on a light page and on a dark one: floor and distance."""
    style = (files("gaitcal.page") / "styles" / "page.css").read_text(encoding="utf-8")
    found = [int(code, 16) for code in re.findall(r"--(?:ground|tile): #([0-9a-f]{6})", style)]
    assert len(found) == 4
    return found


def test_the_measure_itself() -> None:
    """Pairs of Sharma, Wu and Dalal (2005), table 1: 1, 7, 17 and 25."""
    pairs = [
        ((50, 2.6772, -79.7751), (50, 0, -82.7485), 2.0425),
        ((50, 0, 0), (50, -1, 2), 2.3669),
        ((50, 2.5, 0), (73, 25, -18), 27.1492),
        ((60.2574, -34.0099, 36.2677), (60.4626, -34.1751, 39.4387), 1.2644),
    ]
    for one, two, printed in pairs:
        assert ciede2000(np.array(one), np.array(two)) == pytest.approx(printed, abs=6e-5)
    assert contrast(0xFFFFFF, 0) == pytest.approx(21.0)


@pytest.mark.parametrize("sight", SIGHT)
def test_fitted_and_nominal_are_two_colours(sight: str, colours: dict[str, int]) -> None:
    assert seen_apart(colours["fitted"], colours["nominal"], sight) > PLAIN


@pytest.mark.parametrize("kind", ["fitted", "nominal"])
def test_they_stand_out_from_what_is_behind(kind: str, colours: dict[str, int], grounds: list[int]) -> None:
    for behind in (*grounds, colours["bone"]):
        assert contrast(colours[kind], behind) >= GRAPHIC, hex(behind)
