"""Masses of children: Jensen's polynomials against his printed shares, and what they do to a body."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gaitcal.model.anthropometry import (
    BodyLengths,
    child_spread,
    default_limbs,
    growth,
    inertial_parameters,
    jensen_share,
    mass_shares,
    table_words,
    youngest_and_adult_age,
)
from gaitcal.model.parameters import is_physical, table
from gaitcal.model.subject_model import Subject

PRINTED = {
    12: {"head": 10.1, "upper_arm": 3.2, "forearm_hand": 1.7 + 0.9, "thigh": 11.0, "shank_foot": 5.3 + 2.1},
    18: {"head": 7.0, "upper_arm": 3.6, "forearm_hand": 1.9 + 0.9, "thigh": 11.4, "shank_foot": 4.8 + 1.7},
}
"""Percent of body mass: Jensen 1986 at 12, Jensen 1989 at 18 years."""
TWO_ROUNDINGS = 0.1
"""Percent: half a last digit twice."""


@pytest.mark.parametrize("age", sorted(PRINTED))
def test_polynomials_give_the_printed_shares(age: int) -> None:
    for part, percent in PRINTED[age].items():
        assert 100 * jensen_share(part, age) == pytest.approx(percent, abs=TWO_ROUNDINGS), part


@given(age=st.floats(0.5, 30.0), mass=st.floats(8.0, 120.0), sex=st.sampled_from(["male", "female"]))
def test_a_child_of_any_age_is_possible_and_weighs_what_it_weighs(age: float, mass: float, sex: str) -> None:
    subject = Subject("child", mass, 1.2, sex, age=age)
    lengths = BodyLengths(default_limbs(subject), np.array([-0.04, -0.06]), 0.12)
    inertial = inertial_parameters(subject, lengths)
    assert is_physical(inertial).all()
    assert table(inertial)[:, 0].sum() == pytest.approx(mass, rel=1e-14)


def test_growth_ends_in_the_table_of_adults() -> None:
    _, adult = youngest_and_adult_age()
    for age in (adult, 40.0):
        assert set(growth(age).values()) == {1.0}
        assert mass_shares("female", age) == pytest.approx(mass_shares("female", None), rel=1e-14)
    assert growth(2.0) == growth(4.0)


def test_a_small_child_has_a_heavy_head_and_light_thighs() -> None:
    child, adult = mass_shares("male", 6.0), mass_shares("male", None)
    assert child["Head2"] > 2.0 * adult["Head2"]
    assert child["Thigh"] < 0.8 * adult["Thigh"]
    ratio = child["UpperTrunk"] / adult["UpperTrunk"]
    assert child["LowerTrunk"] / adult["LowerTrunk"] == pytest.approx(ratio)


def test_a_table_that_may_be_the_wrong_one_is_told_and_believed_less() -> None:
    unknown = Subject("child", 28.0, 1.30, "female")
    assert "table of adults, though 1.30 m looks like a child's" in table_words(unknown)
    spread = child_spread(unknown)
    assert spread["thigh"] == pytest.approx(
        np.log(mass_shares("female", None)["Thigh"] / mass_shares("female", 8.0)["Thigh"])
    )
    for known in (Subject("child", 28.0, 1.30, "female", age=9.0), Subject("adult", 70.0, 1.70, "female")):
        assert child_spread(known) == {}
    assert "no age is known" in table_words(Subject("who knows", 60.3, 1.58, "male"))
    assert "9 years of age by Jensen 1989" in table_words(Subject("child", 28.0, 1.30, "female", age=9.0))
    assert table_words(Subject("short adult", 45.0, 1.40, "female", age=40.0)) == "de Leva 1996, female"


def test_older_children_are_known_by_mass_and_height_together() -> None:
    """Two of the recorded children, and grown people as light or as short."""
    for mass, height in ((32.1, 1.45), (45.8, 1.48)):
        child = Subject("child", mass, height, "male")
        assert "looks like a child's" in table_words(child)
        thigh = np.log(mass_shares("male", None)["Thigh"] / mass_shares("male", 12.0)["Thigh"])
        assert child_spread(child)["thigh"] == pytest.approx(abs(thigh))
    for mass, height in ((49.0, 1.66), (62.0, 1.52)):
        assert child_spread(Subject("adult", mass, height, "female")) == {}
