"""Which norm somebody is held against; Gait Profile Scores by hand, of the norm itself, and with their errors."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gaitcal.gait.normal_bands import read_normal_bands
from gaitcal.gait.norms import FREE as FREE_SPEEDS
from gaitcal.gait.norms import SLOWEST, SPEEDS, free_steps, leg_length, norm_for, own_norm
from gaitcal.gait.profile_score import ANGLES, BOTH, GPS, profile_scores
from gaitcal.model.linkage import PELVIS_ANGLES
from gaitcal.model.subject_model import GRAVITY, Subject

CHILD = Subject("c", 30.0, 1.34, "female", age=9.0, leg_length={"r": 0.70, "l": 0.70})
FREE = "schwartz2008-free"


def at(relative: float, leg: float = 0.70) -> float:
    return relative * float(np.sqrt(GRAVITY * leg))


@pytest.mark.parametrize(
    ("relative", "words"), [(0.2, "very slow"), (0.3, "slow"), (0.43, "free"), (0.55, "fast"), (0.7, "very fast")]
)
def test_a_child_is_held_against_children_of_its_speed(relative: float, words: str) -> None:
    norm = norm_for(CHILD, at(relative))
    assert norm.words == f"children 4 to 17 years, {words} speed, n = 83 (Schwartz, Rozumalski, Trost 2008)"
    assert f"{relative:.2f} times √(g · leg length), 0.70 m: {words}" in norm.remark and set(ANGLES) < set(norm.bands)


def test_the_same_speed_is_another_one_for_a_longer_leg() -> None:
    tall = Subject("t", 60.0, 1.75, "male", age=16.0)
    assert "slow speed" in norm_for(tall, at(0.37)).words and "free speed" in norm_for(CHILD, at(0.37)).words
    assert leg_length(tall)[0] == pytest.approx(0.91) and "by height, as nobody measured it" in leg_length(tall)[1]


@pytest.mark.parametrize(
    ("subject", "why"),
    [
        (Subject("a", 70.0, 1.75, "male", age=35.0), "No norm fits an age of 35 years"),
        (Subject("b", 12.0, 0.95, "male", age=3.99), "No norm fits an age of 3.9 years: those"),
        (Subject("d", 70.0, 1.75, "male", age=18.0), "No norm fits an age of 18 years"),
        (Subject("e", 48.0, 1.58, "female"), "No norm: no age is told"),
        (Subject("s", 28.0, 1.33, "female"), "No norm: no age is told"),
    ],
)
def test_nobody_else_is_held_against_children_without_a_word(subject: Subject, why: str) -> None:
    norm = norm_for(subject, 1.2)
    assert not norm.bands and not norm.steps and why in norm.remark
    asked = own_norm(read_normal_bands(FREE), FREE, subject)
    assert asked.bands and "Bands of children of 4 to 17 years, as asked for" in asked.remark


@pytest.mark.parametrize("speed", [0.05, 4.0])
def test_no_curves_for_who_walks_slower_or_faster_than_they_did(speed: float) -> None:
    norm = norm_for(CHILD, speed)
    assert (
        not norm.bands and norm.steps and "are of 0.158 to 0.705" in norm.remark and f"{speed:.2f} m/s" in norm.remark
    )
    assert norm_for(CHILD, None).remark.endswith("no stride tells the speed, which chooses it.")


def test_the_outer_limits_are_one_sd_beyond_those_of_the_paper() -> None:
    sd = FREE_SPEEDS["speed"][1]
    assert (SLOWEST, SPEEDS[-1].high) == pytest.approx((SPEEDS[0].high - sd, SPEEDS[-2].high + sd))


def test_steps_scale_with_the_leg() -> None:
    """Speed is cadence times step length, non-dimensional or not, within what means over people leave."""
    short, long = free_steps(0.6), free_steps(0.9)
    assert long["step_length"][0] / short["step_length"][0] == pytest.approx(1.5)
    assert long["speed"][0] / short["speed"][0] == pytest.approx(np.sqrt(1.5))
    for steps in (short, long):
        assert steps["cadence"][0] / 60.0 * steps["step_length"][0] == pytest.approx(steps["speed"][0], rel=0.01)


def strides(offset: dict[str, float], error: float = 0.0, alternate: float = 0.0) -> dict[str, np.ndarray]:
    """Two strides of each leg that are the norm's mean, plus deg; `alternate`: added to the second one."""
    rows = []
    for side in "rl":
        for number in (1, 2):
            for name in ANGLES:
                mean, _ = read_normal_bands(FREE)[name].for_person(CHILD, side)
                value = mean + offset.get(f"{name}_{side}", 0.0) + (number == 2) * alternate
                columns = {"side": side, "variable": name, "value": value, "se": error, "se_stride": 0.0}
                rows.append(pd.DataFrame({**columns, "valid": 1, "turn": 0.0}))
    table = pd.concat(rows, ignore_index=True)
    return {str(name): table[name].to_numpy() for name in table}


def scores(table: dict[str, np.ndarray]) -> dict[tuple[str, str], float]:
    return {(s.side, s.variable): s.score for s in profile_scores(table, read_normal_bands(FREE), CHILD)}


def test_the_score_of_the_norm_itself_is_zero_and_healthy_people_have_their_spread() -> None:
    found = profile_scores(strides({}), read_normal_bands(FREE), CHILD)
    assert len(found) == 21 and all(s.score == pytest.approx(0.0, abs=1e-12) for s in found)
    healthy = next(s.norm for s in found if s.variable == GPS and s.side == BOTH)
    assert 5.0 < healthy < 7.0, "Baker's healthy children: a median of 5.2"


def test_a_profile_by_hand() -> None:
    """Offsets make each angle's score; 15 angles count for both legs, the pelvis of left strides once."""
    offsets = {"knee_angle_r": 12.0, "hip_rotation_l": -9.0, "pelvis_tilt_l": 4.0, "pelvis_tilt_r": 5.0}
    found = scores(strides(offsets))
    assert found["r", "knee_angle"] == pytest.approx(12.0) and found["l", "hip_rotation"] == pytest.approx(9.0)
    assert found["r", GPS] == pytest.approx(np.sqrt((12.0**2 + 5.0**2) / 9))
    assert found["l", GPS] == pytest.approx(np.sqrt((9.0**2 + 4.0**2) / 9))
    assert found[BOTH, GPS] == pytest.approx(np.sqrt((12.0**2 + 9.0**2 + 4.0**2) / 15))


def test_errors_of_scores() -> None:
    """Far from the norm an error of all strides moves the score by itself; strides add SD / sqrt(n)."""
    offset = {f"{name}_{side}": 20.0 for name in ANGLES for side in "rl"}
    shared = profile_scores(strides(offset, error=3.0), read_normal_bands(FREE), CHILD)[0]
    assert shared.error == pytest.approx(3.0, rel=1e-3)
    moving = profile_scores(strides(offset, alternate=2.0), read_normal_bands(FREE), CHILD)[0]
    assert (moving.score, moving.error) == (pytest.approx(21.0), pytest.approx(1.0))
    near = profile_scores(strides({}, error=3.0), read_normal_bands(FREE), CHILD)[0]
    draws = np.abs(3.0 * np.random.default_rng(1).standard_normal(100_000))
    assert near.error == pytest.approx(draws.std(), rel=0.15), "near 0 a score is no linear function of the error"


def test_nothing_is_scored_without_an_angle(tmp_path: Path) -> None:
    bands = read_normal_bands(FREE)
    assert profile_scores(strides({}), {n: b for n, b in bands.items() if n not in PELVIS_ANGLES}, CHILD) == ()
    lost = strides({})
    lost["valid"] = np.where((lost["variable"] == "foot_progression") & (lost["side"] == "l"), 0, 1)
    assert {s.side for s in profile_scores(lost, bands, CHILD)} == {"r"}, "the other side has its score, both have none"


def test_speeds_are_in_order() -> None:
    assert [s.high for s in SPEEDS] == sorted(s.high for s in SPEEDS)
