"""Fitted and nominal joints are told apart by everybody, on a light page and a dark one, and before
a bone.

Colour-blind sight: the matrices of Machado, Oliveira and Fernandes (2009, IEEE Trans Vis Comput
Graph 15(6)), full severity, in linear RGB. Distance: CIEDE2000 (Sharma, Wu and Dalal 2005, Color
Res Appl 30(1)); 1 is just noticeable, 10 plain at a glance. Contrast: WCAG 2.
"""

import math
import re
from importlib.resources import files

import numpy as np
import pytest

SIGHT = {
    "all colours": np.eye(3),
    "protanopia": np.array(
        [
            [0.152286, 1.052583, -0.204868],
            [0.114503, 0.786281, 0.099216],
            [-0.003882, -0.048116, 1.051998],
        ]
    ),
    "deuteranopia": np.array(
        [
            [0.367322, 0.860646, -0.227968],
            [0.280085, 0.672501, 0.047413],
            [-0.011820, 0.042940, 0.968881],
        ]
    ),
    "tritanopia": np.array(
        [
            [1.255528, -0.076749, -0.178779],
            [-0.078411, 0.930809, 0.147602],
            [0.004733, 0.691367, 0.303900],
        ]
    ),
}
_XYZ = np.array(
    [
        [0.4124564, 0.3575761, 0.1804375],
        [0.2126729, 0.7151522, 0.0721750],
        [0.0193339, 0.1191920, 0.9503041],
    ]
)
_WHITE = _XYZ @ np.ones(3)


def linear(colour: int) -> np.ndarray:
    """(3,) linear RGB of 0xrrggbb."""
    srgb = np.array([colour >> 16, colour >> 8 & 255, colour & 255]) / 255.0
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def contrast(a: int, b: int) -> float:
    lights = sorted(float(_XYZ[1] @ linear(c)) for c in (a, b))
    return (lights[1] + 0.05) / (lights[0] + 0.05)


def seen_apart(a: int, b: int, sight: str) -> float:
    """CIEDE2000 between two colours as they are seen."""
    return ciede2000(*(lab(np.clip(SIGHT[sight] @ linear(c), 0.0, 1.0)) for c in (a, b)))


def lab(rgb: np.ndarray) -> np.ndarray:
    t = _XYZ @ rgb / _WHITE
    f = np.where(t > (6 / 29) ** 3, np.cbrt(t), t / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def cos(degrees: float) -> float:
    return math.cos(math.radians(degrees))


def ciede2000(one: np.ndarray, two: np.ndarray) -> float:
    """Colour difference of two CIELAB colours."""
    (l1, a1, b1), (l2, a2, b2) = (map(float, v) for v in (one, two))
    mean = (math.hypot(a1, b1) + math.hypot(a2, b2)) / 2
    g = 0.5 * (1 - math.sqrt(mean**7 / (mean**7 + 25**7)))
    a1, a2 = a1 * (1 + g), a2 * (1 + g)
    c1, c2 = math.hypot(a1, b1), math.hypot(a2, b2)
    h1, h2 = (math.degrees(math.atan2(b, a)) % 360 for a, b in ((a1, b1), (a2, b2)))
    dh = 0.0 if c1 * c2 == 0 else (h2 - h1 + 180) % 360 - 180
    light, chroma, hue = l2 - l1, c2 - c1, 2 * math.sqrt(c1 * c2) * math.sin(math.radians(dh) / 2)
    lm, cm = (l1 + l2) / 2, (c1 + c2) / 2
    if c1 * c2 == 0:
        hm = h1 + h2
    else:
        hm = (
            (h1 + h2) / 2
            if abs(h1 - h2) <= 180
            else (h1 + h2 + (360 if h1 + h2 < 360 else -360)) / 2
        )
    t = (
        1
        - 0.17 * cos(hm - 30)
        + 0.24 * cos(2 * hm)
        + 0.32 * cos(3 * hm + 6)
        - 0.20 * cos(4 * hm - 63)
    )
    sl = 1 + 0.015 * (lm - 50) ** 2 / math.sqrt(20 + (lm - 50) ** 2)
    sc, sh = 1 + 0.045 * cm, 1 + 0.015 * cm * t
    turn = 60 * math.exp(-(((hm - 275) / 25) ** 2))
    rt = -2 * math.sqrt(cm**7 / (cm**7 + 25**7)) * math.sin(math.radians(turn))
    parts = light / sl, chroma / sc, hue / sh
    return math.sqrt(sum(p * p for p in parts) + rt * parts[1] * parts[2])


PLAIN = 20.0
"""CIEDE2000 at which two thin rods are plainly of two colours; 10 is plain for areas side by side.
"""
GRAPHIC = 3.0
"""WCAG 2.1, 1.4.11: least contrast of what must be seen with what is around."""


@pytest.fixture(scope="module")
def colours() -> dict[str, int]:
    script = (files("gaitcal.report.page") / "scripts" / "body.js").read_text(encoding="utf-8")
    return {name: int(code, 16) for name, code in re.findall(r"(\w+): 0x([0-9a-f]{6})", script)}


@pytest.fixture(scope="module")
def grounds() -> list[int]:
    """What is behind the body on a light page and on a dark one: floor and distance."""
    style = (files("gaitcal.report.page") / "styles" / "page.css").read_text(encoding="utf-8")
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
def test_they_stand_out_from_what_is_behind(
    kind: str, colours: dict[str, int], grounds: list[int]
) -> None:
    for behind in (*grounds, colours["bone"]):
        assert contrast(colours[kind], behind) >= GRAPHIC, hex(behind)
