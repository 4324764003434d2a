"""What an activity that is no gait repeats, from the height of the pelvis; which activities have
strides instead.
"""

from __future__ import annotations

import itertools
from types import SimpleNamespace

import numpy as np
import pytest

from gaitcal.analysis.trial_result import _check_crouches
from gaitcal.arrays import Array
from gaitcal.gait.cycles import FootEvents
from gaitcal.gait.events import GaitEvents, find_crouches, find_repetitions, is_alternating
from gaitcal.synthetic.walk import compute_ramp

RATE = 100.0
BOUNDS_S = 0.4
"""A repetition begins and ends where the pelvis leaves and reaches its rest, within a tenth of its
way.
"""


def path(*stops: tuple[float, float]) -> tuple[Array, Array]:
    """Time (s) and height (m) of a pelvis that rests at stops (s, m) and goes smoothly from one to
    the next.
    """
    time = np.arange(round(stops[-1][0] * RATE) + 1) / RATE
    height = np.full(len(time), stops[0][1])
    for (a, low), (b, high) in itertools.pairwise(stops):
        height += compute_ramp((time - a) / (b - a)) * (high - low)
    return time, height + 0.001 * np.sin(3.0 * time)


STAND, SQUAT, SIT, BOX = 0.95, 0.6, 0.55, 1.25
PAUSING = [
    (0, STAND),
    (1, STAND),
    (2, SQUAT),
    (3, STAND),
    (4, STAND),
    (5, SQUAT),
    (6, STAND),
    (7, STAND),
]
AT_ONCE = [(0, STAND), (1, SQUAT), (2, STAND), (3, SQUAT), (4, STAND), (5, SQUAT), (6, STAND)]
RISING = [(0, SIT), (1, SIT), (2, STAND), (3, STAND), (4, SIT), (5, SIT)]


@pytest.mark.parametrize(
    ("stops", "wanted"),
    [
        (PAUSING, [(1, 3), (4, 6)]),
        (AT_ONCE, [(0, 2), (2, 4), (4, 6)]),
        (RISING, [(1, 4)]),
        (RISING[:4], [(1, 2)]),  # stands up, once
        ([(0, STAND), (5, STAND)], []),
    ],
)
def test_from_rest_to_rest(
    stops: list[tuple[float, float]], wanted: list[tuple[float, float]]
) -> None:
    found = [(c.start, c.stop) for c in find_repetitions(*path(*stops))]
    assert len(found) == len(wanted)
    phases = {(1, 2): "rising", (1, 4): "rising lowering"}
    for cycle, whole in zip(find_repetitions(*path(*stops)), wanted, strict=True):
        assert " ".join(name for name, _ in cycle.parts) == phases.get(whole, "lowering rising")
        assert cycle.parts[-1][1] == cycle.stop
    np.testing.assert_allclose(found, np.reshape(wanted, (-1, 2)) if wanted else [], atol=BOUNDS_S)


def test_squats_among_steps_are_where_no_foot_steps() -> None:
    """Two steps, a squat, two steps; a pelvis that sinks with a step, or ends lower, is
    no squat.
    """
    time, height = path((0, STAND), (3, STAND), (4, SQUAT), (5, STAND), (9, STAND))
    right, left = (
        FootEvents(np.array(t), np.array(t) + 0.6) for t in ([0.5, 1.6, 6.0], [1.0, 2.1, 6.5])
    )
    assert find_crouches(time, height, (right, left)) == [(pytest.approx(2.7), pytest.approx(6.0))]
    assert find_crouches(*path((0, STAND), (3, STAND), (4, SQUAT), (9, SQUAT)), (right, left)) == []
    assert find_crouches(time, STAND - 0.04 * (1.0 - np.cos(12.0 * time)), (right, left)) == []


@pytest.mark.parametrize("hz", [1.0, 2.5])
def test_who_goes_on_at_once_has_as_many(hz: float) -> None:
    """However fast: at the top there may be no frame that is slow enough for a rest."""
    time = np.arange(0.0, 8.0, 1.0 / 50.0)
    turns = 2.0 * np.pi * np.clip(hz * (time - 1.013), 0.0, 5.0)
    assert len(find_repetitions(time, STAND - 0.03 * (1.0 - np.cos(turns)))) == 5


def test_the_top_of_a_jump_is_no_rest() -> None:
    """A drop jump, whose flight goes as high as the box that it began on: one repetition, from box
    to standing.
    """
    time, height = path(
        (0, BOX), (1, BOX), (1.4, SQUAT), (1.6, STAND), (2.0, SQUAT), (3, STAND), (4, STAND)
    )
    flight = 0.5 * 9.81 * (0.245**2 - (time - 1.845) ** 2)
    height = np.where(flight > 0, STAND + flight, height)
    feet = (
        FootEvents(np.array([0.9, 2.1]), np.array([1.61])),
        FootEvents(np.array([2.12]), np.array([1.62])),
    )
    (found,) = find_repetitions(time, height, feet)
    names, ends = zip(*found.parts, strict=True)
    assert names[1:5] == ("flight", "landing", "push-off", "flight")
    assert ends[3:5] == (1.62, 2.1), "the last foot off, the first one down"
    assert ends[2] == pytest.approx(1.4, abs=0.05) and found.phases[100] == "rising"
    assert height[flight > 0].max() > BOX - 0.02
    np.testing.assert_allclose((found.start, found.stop), (1, 3), atol=BOUNDS_S)


def test_feet_that_strike_in_turn_make_strides() -> None:
    def strikes(*times: float, offs: tuple[float, ...] = ()) -> FootEvents:
        return FootEvents(np.array(times), np.array(offs))

    right = strikes(0.2, 1.2, 2.2)
    assert is_alternating(right, strikes(0.7, 1.7))
    assert is_alternating(right, strikes(0.45))  # a limp, and a single strike
    assert not is_alternating(right, strikes(0.23, 1.23, 2.23))  # jumps
    assert not is_alternating(right, strikes())  # hops
    assert not is_alternating(
        strikes(1.53, offs=(1.17,)), strikes(1.67, offs=(1.17,))
    )  # a jump, one of whose feet slides


@pytest.mark.parametrize("second", [STAND - 0.15, STAND])
def test_a_repetition_that_is_too_shallow_is_reported(second: float) -> None:
    time, height = path(
        (0, STAND),
        (1, STAND),
        (2, SQUAT),
        (3, STAND),
        (4, STAND),
        (5, second),
        (6, STAND),
        (7, STAND),
    )
    found = find_repetitions(time, height)
    body = SimpleNamespace(time=time, coordinates=("pelvis_ty",), q=height[:, None])
    reported = _check_crouches("squat", body, GaitEvents(repeats=found))
    assert len(found) == 1
    assert [f.cause for f in reported] == ["not all of the trial is repetitions"] * (second < STAND)
    assert all(f.found.startswith(f"{found[0].stop:.2f}-7.00 s") for f in reported)
    cut = slice(150, 260)  # the lower part of the first squat
    late = SimpleNamespace(time=time[cut], coordinates=("pelvis_ty",), q=height[cut, None])
    assert not find_repetitions(late.time, late.q[:, 0])
    assert len(_check_crouches("squat", late, GaitEvents(), activity=True)) == 1
    assert not _check_crouches("knee", late, GaitEvents())
