"""De Leva's table for a person: the published subject's numbers, a body's total mass, possible bodies."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gaitcal.model.anthropometry import BodyLengths, default_length, default_limbs, inertial_parameters
from gaitcal.model.parameters import (
    IP_INDEX,
    IP_NAMES,
    IP_TO_SI,
    MASSIVE_SEGMENTS,
    is_physical,
    published_subject,
    table,
)
from gaitcal.model.subject_model import Subject

PUBLISHED = Subject("published", 69.4, 1.70, "male")
HALF_UNIT = {"mass": 0.0005, "com": 0.05, "moi": 0.5}
"""Half of the last printed digit: kg, mm, kg*mm^2."""
SLACK = 1.01
"""The printed table was itself made from inputs in printed digits (0.9508 kg is printed as 0.951)."""


def published_lengths() -> BodyLengths:
    """The limbs that the printed inertia was made from: femur and tibia as quoted, arms scaled by height."""
    limbs = default_limbs(PUBLISHED)
    for side in "rl":
        limbs |= {f"thigh_{side}": 0.4198, f"shank_{side}": 0.3774}
    return BodyLengths(limbs, np.array([-0.0473, -0.0745]), 0.0770 + 0.0745)


def test_published_numbers_come_back_to_the_printed_digits() -> None:
    made = inertial_parameters(PUBLISHED, published_lengths()) / IP_TO_SI
    printed = published_subject().inertial / IP_TO_SI
    for i, name in enumerate(IP_NAMES):
        assert abs(made[i] - printed[i]) <= SLACK * HALF_UNIT[name.split(".")[1]], (name, made[i], printed[i])


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("pelvis.mass", 7.752),
        ("pelvis.com.sup", -19.2),
        ("pelvis.moi.ant", 59345),
        ("thigh_l.com.sup", -171.9),
        ("shank_r.moi.sup", 4453),
        ("foot_r.com.ant", 111.3),
        ("head_trunk.com.sup", 272.0),
        ("head_trunk.moi.ant", 1021935),
        ("forearm_hand_l.moi.lat", 19661),
    ],
)
def test_numbers_written_in_the_method(name: str, value: float) -> None:
    made = inertial_parameters(PUBLISHED, published_lengths()) / IP_TO_SI
    kind = name.split(".")[1]
    assert made[IP_INDEX[name]] == pytest.approx(value, abs=SLACK * HALF_UNIT[kind])


@given(
    mass=st.floats(20.0, 200.0),
    height=st.floats(0.9, 2.2),
    sex=st.sampled_from(["male", "female"]),
    factor=st.floats(0.7, 1.4),
)
def test_any_person_is_possible_and_weighs_what_they_weigh(mass: float, height: float, sex: str, factor: float) -> None:
    subject = Subject("any", mass, height, sex)
    limbs = {segment: factor * length for segment, length in default_limbs(subject).items()}
    lengths = BodyLengths(limbs, np.array([-0.05, -0.08]), 0.15)
    inertial = inertial_parameters(subject, lengths)
    assert is_physical(inertial).all()
    assert table(inertial)[:, 0].sum() == pytest.approx(mass, rel=1e-14)
    left_right = [
        (i, MASSIVE_SEGMENTS.index(s[:-2] + "_l")) for i, s in enumerate(MASSIVE_SEGMENTS) if s.endswith("_r")
    ]
    for r, left in left_right:
        np.testing.assert_array_equal(table(inertial)[r], table(inertial)[left])


def test_de_leva_lengths_belong_to_his_people() -> None:
    assert default_length("Thigh", Subject("", 73.0, 1.741, "male")) == pytest.approx(0.4222)
    assert default_length("Thigh", Subject("", 61.9, 1.735, "female")) == pytest.approx(0.3685)
