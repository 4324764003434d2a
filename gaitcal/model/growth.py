"""How the shares of body mass change as a child grows (Jensen 1989, `models/jensen_1989.json`).

Tables of adults and of children cut the body in different places (Jensen's thigh of an 18 year old has 11 % of the
mass, de Leva's of an adult 14 %), so that one cannot stand for the other. What children's tables tell reliably is the
change with age, a ratio in which the cut cancels:

    growth(age) = Jensen's share at that age / Jensen's share at 18 years

for head, upper arm, forearm with hand, thigh, and shank with foot. The torso has what these leave. Measured on boys;
no polynomials of girls were found.
"""

from __future__ import annotations

import functools
import json

import numpy as np

from gaitcal.io.package_data import models_path
from gaitcal.model.subject_model import Subject

CHILD_HEIGHT = 1.45
"""m; few adults are shorter, and most children before puberty are."""
YOUTH_HEIGHT, YOUTH_MASS = 1.60, 50.0
"""m and kg; somebody below both may be a child of 10 to 14 years: the median child passes both shortly before the 14th
birthday (2000 CDC Growth Charts, Vital Health Stat 11(246), 2002); some slender women are below both, too."""
UNKNOWN_AGE, UNKNOWN_AGE_OF_YOUTH = 8.0, 12.0
"""Years that a child counts as where its age is not known, to say how wrong the table of adults may be: one shorter
than CHILD_HEIGHT, and any other; half of the children of 12 are taller than 1.50 m."""

GROWING: dict[str, str] = {
    "Head2": "head",
    "UpperArm": "upper_arm",
    "Forearm": "forearm_hand",
    "Hand": "forearm_hand",
    "Thigh": "thigh",
    "Shank2": "shank_foot",
    "Foot": "shank_foot",
}
"""Segment of de Leva's -> the part of Jensen's that it belongs to; the torso is in neither."""


@functools.cache
def _table() -> tuple[tuple[float, float], dict[str, list[float]]]:
    data = json.loads((models_path() / "jensen_1989.json").read_text(encoding="utf-8"))
    low, high = data["age_years"]
    return (float(low), float(high)), data["mass_share"]


def youngest_and_adult_age() -> tuple[float, float]:
    """Years of age from which and up to which the shares change."""
    return _table()[0]


def jensen_share(part: str, age: float) -> float:
    """Share of body mass, 0 to 1, of one part of Jensen's, at an age in years."""
    return float(np.polynomial.polynomial.polyval(age, _table()[1][part]))


def growth(age: float) -> dict[str, float]:
    """Segment of de Leva's -> its share of body mass at this age (years) over that of an adult; 1 from 18 years on."""
    youngest, adult = youngest_and_adult_age()
    at = float(np.clip(age, youngest, adult))
    return {name: jensen_share(part, at) / jensen_share(part, adult) for name, part in GROWING.items()}


def is_known_child(subject: Subject) -> bool:
    """Whether the age is given, and below that of adults."""
    return subject.age is not None and subject.age < youngest_and_adult_age()[1]


def looks_like_child(subject: Subject) -> bool:
    """Whether the age is not given, and height and mass may be those of a child."""
    youth = subject.height < YOUTH_HEIGHT and subject.mass < YOUTH_MASS
    return subject.age is None and (subject.height < CHILD_HEIGHT or youth)


def supposed_age(subject: Subject) -> float:
    """Years that somebody who looks like a child counts as."""
    return UNKNOWN_AGE if subject.height < CHILD_HEIGHT else UNKNOWN_AGE_OF_YOUTH
