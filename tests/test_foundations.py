"""What everything stands on: arithmetic of arrays, names that are alike."""

import numpy as np
import pytest

from gaitcal.arrays import cross
from gaitcal.errors import find_side, find_similar_names, suggest_name


@pytest.mark.parametrize(
    ("left", "right"), [((3,), (3,)), ((5, 3), (3,)), ((3,), (5, 3)), ((4, 1, 3), (5, 3))]
)
def test_cross_is_that_of_numpy(left: tuple[int, ...], right: tuple[int, ...]) -> None:
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=left), rng.normal(size=right)
    np.testing.assert_array_equal(cross(a, b), np.cross(a, b))


@pytest.mark.parametrize(
    ("label", "side"),
    [
        *[
            (label, "r")
            for label in (
                "RKNE",
                "R.Knee",
                "R_Knee",
                "knee_r",
                "kneeR",
                "Right_Knee",
                "Knee_Right",
                "rKnee",
            )
        ],
        *[(label, "l") for label in ("LKNE", "L.Knee", "hip_l", "left knee", "LeftKnee")],
        *[
            (label, "")
            for label in (
                "V.Sacral",
                "C7",
                "role",
                "rule",
                "clav",
                "Lumbar",
                "Rate",
                "Sternum",
                "legs",
            )
        ],
    ],
)
def test_the_side_that_a_label_names(label: str, side: str) -> None:
    assert find_side(label) == side


@pytest.mark.parametrize(
    ("name", "allowed", "offered"),
    [
        ("RKNE", ["LKNE"], []),
        ("RKNE", ["LKNE", "RKNEE"], ["RKNEE"]),
        ("rkne", ["lkne"], []),
        ("RHEEL", ["LHEE", "LHEEL"], []),
        ("Right knee", ["Left knee"], []),
        ("R_Ankle", ["L_Ankle", "R_Ankel"], ["R_Ankel"]),
        ("rigth", ["left", "right", "both"], ["right"]),
        ("LASI", ["lasi", "rasi"], ["lasi"]),
        ("L.ASIS", ["R_asis", "l asis"], ["l asis"]),
        ("staic", ["static", "gait"], ["static"]),
    ],
)
def test_what_is_offered(name: str, allowed: list[str], offered: list[str]) -> None:
    assert find_similar_names(name, allowed) == offered
    assert suggest_name(name, allowed) == (f"; did you mean '{offered[0]}'?" if offered else "")
