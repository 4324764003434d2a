"""What everything stands on: arithmetic of arrays, properties that are computed once, names that
are alike.
"""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from gaitcal.arrays import cross
from gaitcal.errors import alike, nearest, side_named
from gaitcal.runtime import remembered


@pytest.mark.parametrize(
    ("left", "right"), [((3,), (3,)), ((5, 3), (3,)), ((3,), (5, 3)), ((4, 1, 3), (5, 3))]
)
def test_cross_is_that_of_numpy(left: tuple[int, ...], right: tuple[int, ...]) -> None:
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=left), rng.normal(size=right)
    np.testing.assert_array_equal(cross(a, b), np.cross(a, b))


@dataclass(frozen=True)
class Person:
    """Somebody with a name."""

    name: str


calls: list[str] = []


@remembered
def greeting(of: Person) -> str:
    """Of a person."""
    calls.append(of.name)
    if not of.name:
        raise ValueError("nobody")
    return f"hello {of.name}"


def test_it_is_computed_once_for_each_object() -> None:
    calls.clear()
    ann = Person("Ann")
    assert [greeting(ann), greeting(ann)] == ["hello Ann"] * 2
    assert calls == ["Ann"]
    assert greeting(replace(ann, name="Bob")) == "hello Bob"
    assert greeting(ann) == "hello Ann"
    assert ann == Person("Ann")


def test_a_fault_is_raised_every_time() -> None:
    nobody = Person("")
    for _ in range(2):
        with pytest.raises(ValueError, match="nobody"):
            greeting(nobody)


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
    assert side_named(label) == side


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
    assert alike(name, allowed) == offered
    assert nearest(name, allowed) == (f"; did you mean '{offered[0]}'?" if offered else "")
