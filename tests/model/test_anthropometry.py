"""De Leva's table for a person, and Jensen's for a child: published numbers, a body's total mass,
possible bodies.
"""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gaitcal.model.anthropometry import (
    BodyLengths,
    compute_default_length,
    compute_default_limb_lengths,
    compute_growth_ratios,
    compute_inertial_parameters,
    compute_jensen_share,
    compute_mass_shares,
    describe_mass_table,
    estimate_child_table_error,
    estimate_table_error,
    get_growth_ages,
    move_limb_inertia,
)
from gaitcal.model.parameters import (
    IP_INDEX,
    IP_NAMES,
    IP_TO_SI,
    JP_INDEX,
    MASSIVE_SEGMENTS,
    is_physical,
    read_published_parameters,
    view_as_table,
)
from gaitcal.model.subject_model import Subject
from tests.messages import check_text

PUBLISHED = Subject("published", 69.4, 1.70, "male")
HALF_UNIT = {"mass": 0.0005, "com": 0.05, "moi": 0.5}
"""Half of the last printed digit: kg, mm, kg*mm^2."""
ROUNDING = 1e-12
SLACK = 1.01
"""The printed table was itself made from inputs in printed digits (0.9508 kg is printed as 0.951).
"""


def published_lengths() -> BodyLengths:
    """The limbs that the printed inertia was made from: femur and tibia as quoted, arms scaled by
    height.
    """
    limbs = compute_default_limb_lengths(PUBLISHED)
    for side in "rl":
        limbs |= {f"thigh_{side}": 0.4198, f"shank_{side}": 0.3774}
    return BodyLengths(limbs, np.array([-0.0473, -0.0745]), 0.0770 + 0.0745)


def test_published_numbers_come_back_to_the_printed_digits() -> None:
    made = compute_inertial_parameters(PUBLISHED, published_lengths()) / IP_TO_SI
    printed = read_published_parameters().inertial / IP_TO_SI
    for i, name in enumerate(IP_NAMES):
        assert abs(made[i] - printed[i]) <= SLACK * HALF_UNIT[name.split(".")[1]], (
            name,
            made[i],
            printed[i],
        )


def test_inertia_of_joints_found_elsewhere_is_the_table_s_of_these_lengths() -> None:
    """Every hip 10 mm lower in the thigh, every knee 15 mm lower in the shank; then a hip to the
    side.
    """
    before, lengths = read_published_parameters(), published_lengths()
    moves = {
        f"{place}_{side}": by
        for side in "rl"
        for place, by in (("thigh", -0.01), ("shank", -0.015))
    }
    names = tuple(
        f"{'hip' if s.startswith('thigh') else 'knee'}_{s[-1]}.{s[:-2]}.sup" for s in moves
    )
    after = before.with_joint(
        names, before.joint[[JP_INDEX[n] for n in names]] + list(moves.values())
    )
    limbs = lengths.limbs | {segment: lengths.limbs[segment] + by for segment, by in moves.items()}
    expected = view_as_table(compute_inertial_parameters(PUBLISHED, replace(lengths, limbs=limbs)))
    for segment, by in moves.items():
        expected[MASSIVE_SEGMENTS.index(segment), 2] += by
    moved = view_as_table(
        move_limb_inertia(compute_inertial_parameters(PUBLISHED, lengths), before, after)
    )
    np.testing.assert_allclose(moved, expected, rtol=ROUNDING, atol=ROUNDING)
    back = move_limb_inertia(
        moved.ravel(), after, before
    )  # what two sessions' joints moved apart, shared ones bring back
    np.testing.assert_allclose(
        back, compute_inertial_parameters(PUBLISHED, lengths), rtol=ROUNDING, atol=ROUNDING
    )
    aside = before.with_joint(("hip_r.thigh.lat",), np.array([0.02]))
    share = 1.0 + before.inertial[IP_INDEX["thigh_r.com.sup"]] / 0.4198
    found = view_as_table(move_limb_inertia(before.inertial, before, aside))[
        MASSIVE_SEGMENTS.index("thigh_r"), 3
    ]
    assert found == pytest.approx(share * 0.02, rel=ROUNDING)


@given(
    mass=st.floats(8.0, 200.0),
    age=st.none() | st.floats(0.5, 30.0),
    height=st.floats(0.9, 2.2),
    sex=st.sampled_from(["male", "female", ""]),
    factor=st.floats(0.7, 1.4),
)
def test_any_person_is_possible_and_weighs_what_they_weigh(
    mass: float, age: float | None, height: float, sex: str, factor: float
) -> None:
    subject = Subject("any", mass, height, sex, age=age)
    limbs = {
        segment: factor * length
        for segment, length in compute_default_limb_lengths(subject).items()
    }
    lengths = BodyLengths(limbs, np.array([-0.05, -0.08]), 0.15)
    inertial = compute_inertial_parameters(subject, lengths)
    assert is_physical(inertial).all()
    assert view_as_table(inertial)[:, 0].sum() == pytest.approx(mass, rel=1e-14)
    rows = dict(zip(MASSIVE_SEGMENTS, view_as_table(inertial), strict=True))
    for right in (segment for segment in MASSIVE_SEGMENTS if segment.endswith("_r")):
        np.testing.assert_array_equal(rows[right], rows[f"{right[:-2]}_l"])


def test_de_leva_lengths_belong_to_his_people() -> None:
    assert compute_default_length("Thigh", Subject("", 73.0, 1.741, "male")) == pytest.approx(
        0.4222
    )
    assert compute_default_length("Thigh", Subject("", 61.9, 1.735, "female")) == pytest.approx(
        0.3685
    )


PRINTED = {
    12: {
        "head": 10.1,
        "upper_arm": 3.2,
        "forearm_hand": 1.7 + 0.9,
        "thigh": 11.0,
        "shank_foot": 5.3 + 2.1,
    },
    18: {
        "head": 7.0,
        "upper_arm": 3.6,
        "forearm_hand": 1.9 + 0.9,
        "thigh": 11.4,
        "shank_foot": 4.8 + 1.7,
    },
}
"""Percent of body mass: Jensen 1986 at 12, Jensen 1989 at 18 years."""
TWO_ROUNDINGS = 0.1
"""Percent: half a last digit twice."""


@pytest.mark.parametrize("age", sorted(PRINTED))
def test_polynomials_give_the_printed_shares(age: int) -> None:
    for part, percent in PRINTED[age].items():
        assert 100 * compute_jensen_share(part, age) == pytest.approx(percent, abs=TWO_ROUNDINGS), (
            part
        )


def test_growth_ends_in_the_table_of_adults() -> None:
    _, adult = get_growth_ages()
    for age in (adult, 40.0):
        assert set(compute_growth_ratios(age).values()) == {1.0}
        assert compute_mass_shares("female", age) == pytest.approx(
            compute_mass_shares("female", None), rel=1e-14
        )
    assert compute_growth_ratios(2.0) == compute_growth_ratios(4.0)


def test_a_small_child_has_a_heavy_head_and_light_thighs() -> None:
    child, adult = compute_mass_shares("male", 6.0), compute_mass_shares("male", None)
    assert child["Head2"] > 2.0 * adult["Head2"]
    assert child["Thigh"] < 0.8 * adult["Thigh"]
    ratio = child["UpperTrunk"] / adult["UpperTrunk"]
    assert child["LowerTrunk"] / adult["LowerTrunk"] == pytest.approx(ratio)


@pytest.mark.parametrize(
    ("mass", "height", "sex", "age"),
    [(28.0, 1.30, "female", 8.0), (32.1, 1.45, "male", 12), (45.8, 1.48, "male", 12)],
)
def test_a_table_that_may_be_the_wrong_one_is_told_and_believed_less(
    mass: float, height: float, sex: str, age: float
) -> None:
    """A child, and two of the recorded older ones, who are known by mass and height together."""
    unknown = Subject("child", mass, height, sex)
    assert f"table of adults, though {height:.2f} m looks like a child's" in describe_mass_table(
        unknown
    )
    thigh = np.log(compute_mass_shares(sex, None)["Thigh"] / compute_mass_shares(sex, age)["Thigh"])
    assert estimate_child_table_error(unknown)["thigh"] == pytest.approx(abs(thigh))
    assert estimate_child_table_error(replace(unknown, age=age)) == {}


def test_grown_people_as_light_or_as_short_as_children_are_believed() -> None:
    for mass, height in ((70.0, 1.70), (49.0, 1.66), (62.0, 1.52)):
        assert estimate_child_table_error(Subject("adult", mass, height, "female")) == {}
    check_text(describe_mass_table(Subject("who knows", 60.3, 1.58, "male")), "age")
    child = Subject("child", 28.0, 1.30, "female", age=9.0)
    check_text(describe_mass_table(child), 9, "Jensen 1989")
    assert (
        describe_mass_table(Subject("short adult", 45.0, 1.40, "female", age=40.0))
        == "de Leva 1996, female"
    )


@pytest.mark.parametrize("other", ["male", "female"])
def test_without_a_sex_either_table_lies_within_the_error(other: str) -> None:
    """What nobody says is the mean of both tables, and one standard deviation away is either."""
    one = Subject("", 70.0, 1.75, "")
    mean, table_of = (
        compute_inertial_parameters(s, published_lengths()) for s in (one, replace(one, sex=other))
    )
    spread = estimate_table_error(one)
    for name in ("thigh", "shank", "upper_arm", "pelvis"):
        i = IP_NAMES.index(f"{name if name == 'pelvis' else name + '_r'}.mass")
        assert abs(np.log(table_of[i] / mean[i])) == pytest.approx(spread[f"{name}.mass"], rel=0.05)
        assert abs(table_of[i + 2] - mean[i + 2]) == pytest.approx(
            spread[f"{name}.com.sup"], rel=0.15
        )
    assert estimate_table_error(replace(one, sex=other)) == {}


def test_an_estimated_height_is_an_error_of_what_goes_by_it() -> None:
    one = Subject("", 70.0, 1.75, "male", height_error=0.08)
    spread = estimate_table_error(one)
    step = [
        compute_inertial_parameters(replace(one, height=h), published_lengths())
        for h in (1.67, 1.83)
    ]
    i = IP_NAMES.index("head_trunk.com.sup")
    assert spread["head_trunk.com.sup"] == pytest.approx(0.5 * (step[1] - step[0])[i], rel=1e-9)
    assert "thigh.com.sup" not in spread, "its length is measured"
