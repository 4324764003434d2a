"""Speed, cadence, steps and phases: on feet that are put down where we say, and on files that tell
theirs.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gaitcal.dynamics.foot_contact import FootPoints, estimate_belt_velocities
from gaitcal.errors import Code
from gaitcal.gait.cycles import EventSource, GaitEvent
from gaitcal.gait.events import GaitEvents, combine_events
from gaitcal.gait.spatiotemporal import (
    LEAST_SD,
    MEASURES,
    Stride,
    average_measures,
    check_strides,
    measure_strides,
    select_straight_strides,
)
from gaitcal.gait.strides import list_strides
from gaitcal.io.labels import FootMoment
from tests.gait.walks import hand_count, recorded_strides, vendor_figures
from tests.messages import check_finding, numbers

RATE = 100.0
STEP_S, STANCE_S = 0.55, 0.66
"""s: a stride of 1.1 s of which 60 % are stance."""
EXACT = 1e-9


def steps(
    count: int,
    length: float = 0.6,
    width: float = 0.12,
    stance: float = STANCE_S,
    step: float = STEP_S,
) -> tuple[np.ndarray, FootPoints, GaitEvents]:
    """Feet that stand still from strike to off and glide to the next place: right first,
    along x.
    """
    time = np.arange(0.0, step * count + 1.0, 1.0 / RATE)
    heel, events = np.zeros((len(time), 2, 3)), []
    for foot, side in enumerate("rl"):
        strikes = [0.2 + step * k for k in range(foot, count, 2)]
        places = [length * k for k in range(foot, count, 2)]
        at, x = [], []
        for when, place in zip(strikes, places, strict=True):
            at += [when, when + stance]
            x += [place, place]
            events.append(GaitEvent(FootMoment.STRIKE, side, when, EventSource.PLATES))
            events.append(GaitEvent(FootMoment.OFF, side, when + stance, EventSource.PLATES))
        heel[:, foot, 0] = np.interp(time, at, x)
        heel[:, foot, 2] = 0.5 * width * (1.0 if side == "r" else -1.0)
    feet = FootPoints(
        heel=heel,
        toe=heel + [0.2, 0, 0],
        tip=heel,
        heel_speed=heel[:, :, 0],
        toe_speed=heel[:, :, 0],
    )
    kept = [e for e in events if e.time <= time[-1]]
    return time, feet, GaitEvents(tuple(sorted(kept, key=lambda e: e.time)))


def whole(strides: tuple[Stride, ...], side: str = "r") -> list[Stride]:
    return [s for s in strides if s.side == side and s.number]


def test_a_walk_measures_what_it_was_made_of() -> None:
    time, feet, events = steps(6)
    found = measure_strides(events, time, feet)
    assert [s.number for s in whole(found)] == [1, 2] and [s.number for s in whole(found, "l")] == [
        1,
        2,
    ]
    expected = {
        "speed": 0.6 / STEP_S, "cadence": 60.0 / STEP_S, "stride_length": 1.2,
        "stride_time": 2 * STEP_S,
        "step_length": 0.6, "step_width": 0.12, "step_time": STEP_S, "stance": 0.66,
        "stance_percent": 60.0,
        "swing": 0.44, "swing_percent": 40.0, "first_double_support": 0.11,
        "first_double_support_percent": 10.0,
        "second_double_support": 0.11, "second_double_support_percent": 10.0,
        "double_support": 0.22,
        "double_support_percent": 20.0, "single_support": 0.44, "single_support_percent": 40.0,
    }  # fmt: skip
    stride = whole(found)[1]
    assert tuple(stride.measures) == tuple(MEASURES) and stride.sources == (EventSource.PLATES,) * 2
    assert {n: round(v, 9) for n, v in stride.measures.items()} == {
        n: round(v, 9) for n, v in expected.items()
    }


@settings(max_examples=25, deadline=None)
@given(st.floats(0.0, 2 * np.pi), st.floats(0.3, 2.0), st.floats(-0.05, 0.3))
def test_nothing_depends_on_the_direction_in_the_room_nor_on_a_belt(
    turn: float, belt: float, width: float
) -> None:
    """A walk turned about the vertical, and the same on a belt that carries it back, measure the
    same.
    """
    time, feet, events = steps(6, width=width)
    plain = measure_strides(events, time, feet)
    c, s = np.cos(turn), np.sin(turn)
    about = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    velocity = about @ np.array([-belt, 0.0, 0.0])
    carried = feet.heel @ about.T + (time - time[0])[:, None, None] * velocity
    turned = measure_strides(
        events, time, replace(feet, heel=carried, ground=np.tile(velocity, (2, 1)))
    )
    for one, other in zip(plain, turned, strict=True):
        np.testing.assert_allclose(
            list(one.measures.values()), list(other.measures.values()), atol=EXACT
        )
    assert whole(plain)[0].measures["step_width"] == pytest.approx(
        width
    )  # negative where feet cross


def test_on_split_belts_strides_are_each_belts_and_steps_are_in_the_room() -> None:
    """Each foot stands on its own belt from 0.3 m in front of the body to where the belt takes it,
    by hand.
    """
    time, feet, events = steps(8)
    fast, slow, heel = 1.2, 0.6, np.zeros_like(feet.heel)
    for foot, belt in enumerate((fast, slow)):
        foot_events = events.select_foot("rl"[foot])
        at = np.sort(np.concatenate([foot_events.strikes, foot_events.strikes + 0.66]))
        x = np.where(np.isin(at, foot_events.strikes), 0.3, 0.3 - 0.66 * belt)
        heel[:, foot, 0], heel[:, foot, 1] = (
            np.interp(time, at, x),
            np.where(_down(time, foot_events.strikes), 0.0, 0.1),
        )
    points = np.concatenate([heel, heel + [0.2, 0.0, 0.0]], axis=1)
    ground = estimate_belt_velocities(points, np.gradient(points, time, axis=0))
    np.testing.assert_allclose(ground, [[-fast, 0.0, 0.0], [-slow, 0.0, 0.0]], atol=1e-6)
    found = measure_strides(events, time, replace(feet, heel=heel, ground=ground))
    right, left = whole(found)[1].measures, whole(found, "l")[1].measures
    assert right["stride_length"] == pytest.approx(fast * 2 * STEP_S) and right[
        "speed"
    ] == pytest.approx(fast)
    assert left["stride_length"] == pytest.approx(slow * 2 * STEP_S) and left[
        "speed"
    ] == pytest.approx(slow)
    assert right["step_length"] == pytest.approx(slow * STEP_S) and left[
        "step_length"
    ] == pytest.approx(fast * STEP_S)


def _down(time: np.ndarray, strikes: np.ndarray) -> np.ndarray:
    return np.any([(time >= t) & (time <= t + 0.66) for t in strikes], axis=0)


def test_in_a_turn_lengths_follow_each_stride_and_the_outer_foot_steps_longer() -> None:
    """Feet on two circles about one centre, radius 2 m and 0.1 m between them: chords, by hand
    (Huxham et al. 2006).
    """
    time, feet, events = steps(6)
    angle = 0.3
    radius = {0: 2.05, 1: 1.95}  # to the left: the right foot is the outer one
    heel = feet.heel.copy()
    for foot in (0, 1):
        turned = angle * feet.heel[:, foot, 0] / 0.6
        heel[:, foot, 0], heel[:, foot, 2] = (
            radius[foot] * np.sin(turned),
            radius[foot] * np.cos(turned),
        )
    found = measure_strides(events, time, replace(feet, heel=heel))
    right, left = whole(found)[0].measures, whole(found, "l")[0].measures
    assert right["stride_length"] == pytest.approx(2 * 2.05 * np.sin(angle))
    assert left["stride_length"] == pytest.approx(2 * 1.95 * np.sin(angle))
    # The inner foot's place is half way along the outer one's chord, as far from it as the chord's
    # middle less 1.95.
    assert right["step_length"] == pytest.approx(right["stride_length"] / 2)
    assert right["step_width"] == pytest.approx(2.05 * np.cos(angle) - 1.95)
    assert left["step_width"] == pytest.approx(2.05 - 1.95 * np.cos(angle))


def test_strides_that_the_recording_cuts_count_for_what_they_show() -> None:
    time, feet, events = steps(4)  # strikes of the right foot: 1st and 3rd step
    found = measure_strides(events, time, feet)
    parts = [s for s in found if s.number is None]
    assert [(s.side, s.start is None, s.stop is None) for s in parts] == [
        ("r", False, True), ("l", True, False), ("l", False, True),
    ]  # fmt: skip
    last, first_left, _ = parts
    assert set(last.measures) == {
        "stance", "first_double_support", "second_double_support", "double_support",
        "single_support",
    }  # fmt: skip
    assert last.measures["stance"] == pytest.approx(STANCE_S)
    assert first_left.measures == pytest.approx(
        {"step_time": STEP_S, "step_length": 0.6, "step_width": 0.12}
    )
    assert not any("percent" in name or "speed" in name for s in parts for name in s.measures)


def test_a_gap_between_strikes_that_is_no_stride_is_none() -> None:
    *_, events = steps(8)
    kept = GaitEvents(tuple(e for e in events.events if not (e.side == "r" and 1.0 < e.time < 3.0)))
    late = GaitEvents(
        tuple(
            replace(e, time=e.time + 3.0) if e.side == "r" and e.time > 3.0 else e
            for e in kept.events
        )
    )
    assert not whole(measure_strides(late, np.arange(0.0, 9.0, 0.01), None))


def test_running_has_no_double_support() -> None:
    time, feet, events = steps(6, length=1.2, stance=0.25, step=0.35)
    first, second = (s.measures for s in whole(measure_strides(events, time, feet)))
    assert second["double_support"] == 0.0 and second["single_support"] == pytest.approx(0.25)
    assert second["speed"] == pytest.approx(1.2 / 0.35)
    assert not any("double" in name for name in first), (
        "it is not known since when the left foot is in the air"
    )


def without(events: GaitEvents, side: str, moment: FootMoment, *which: int) -> GaitEvents:
    """Without some of the events of one foot and kind, or without all."""
    of_kind = [e for e in events.events if e.side == side and e.moment is moment]
    gone = [of_kind[k] for k in which] if which else of_kind
    return GaitEvents(tuple(e for e in events.events if e not in gone))


def test_a_missing_off_is_unknown_and_not_a_support_of_zero() -> None:
    time, feet, events = steps(10)
    one, all_of_them = (
        measure_strides(without(events, "l", FootMoment.OFF, *which), time, feet)
        for which in ((1,), ())
    )
    for stride in (*one, *all_of_them):
        assert all(v > 0.05 for n, v in stride.measures.items() if n.endswith("support")), stride
    plain = measure_strides(events, time, feet)
    assert len(whole(one, "l")) == len(whole(plain, "l"))
    known = [s for s in whole(one) if "double_support" in s.measures]
    assert 0 < len(known) < len(whole(plain))
    # The right foot's first off lies before the recording.
    cut = GaitEvents(
        tuple(e for e in without(events, "r", FootMoment.OFF, 0).events if e.time > 0.5)
    )
    left = whole(measure_strides(cut, time, feet), "l")[0].measures
    assert "first_double_support" not in left and left["second_double_support"] == pytest.approx(
        0.11
    )


@pytest.mark.parametrize("with_off", [False, True])
def test_a_missing_strike_makes_no_stride_of_double_length(with_off: bool) -> None:
    """Alone it shows by two offs in a row, together with its off by two strikes of the
    other foot.
    """
    time, feet, events = steps(10)
    changed_events = without(events, "l", FootMoment.STRIKE, 2)
    changed_events = without(changed_events, "l", FootMoment.OFF, 2) if with_off else changed_events
    for side in "rl":
        strides = measure_strides(changed_events, time, feet)
        assert [s.number for s in whole(strides, side)] == [1, 2, 3, 4][: 4 if side == "r" else 2]
        for stride in strides:
            assert stride.measures.get("stride_length", 1.2) == pytest.approx(1.2)
            assert stride.measures.get("stance", STANCE_S) == pytest.approx(STANCE_S)
            assert stride.measures.get("swing", 0.44) == pytest.approx(0.44)
        cycles = list_strides(changed_events)[side]
        assert [(c.start, c.stop) for c in cycles] == [
            (s.start, s.stop) for s in whole(strides, side)
        ]


def test_events_that_do_not_alternate_are_reported() -> None:
    *_, events = steps(8)
    assert not combine_events(np.arange(0.0, 5.4, 0.01), events.events, [], []).findings
    changed_events = without(events, "l", FootMoment.OFF, 1).events
    (found,) = combine_events(np.arange(0.0, 5.4, 0.01), changed_events, [], []).findings
    check_finding(found, Code.MISSING_EVENTS, 1.85, 2.95)


def test_a_foot_without_markers_at_a_strike_has_no_lengths() -> None:
    time, feet, events = steps(6)
    lost = np.abs(time - (0.2 + 2 * STEP_S)) < 0.05  # about the right foot's second strike
    found = measure_strides(events, time, feet, {"foot_r": lost})
    first, second = whole(found)
    for stride in (first, second):
        assert (
            not {"stride_length", "speed"} & set(stride.measures) and "cadence" in stride.measures
        )
    assert "step_length" not in first.measures
    assert "stride_length" in whole(found, "l")[0].measures
    assert "stride_length" not in whole(measure_strides(events, time, None))[0].measures


def test_feet_that_swing_without_progress_have_no_lengths_and_are_reported() -> None:
    time, feet, events = steps(6)
    still = replace(feet, heel=feet.heel * [0.02, 1.0, 1.0])
    strides = measure_strides(events, time, still)
    assert not any(
        {"speed", "stride_length", "step_length", "step_width"} & set(s.measures) for s in strides
    )
    assert all(s.on_the_spot and s.measures["stance"] > 0 for s in whole(strides))
    (found,) = check_strides("walk", strides)
    check_finding(found, Code.ON_THE_SPOT)
    assert numbers(found.found)[:4] == [1, 2, 1, 2]
    assert not check_strides("walk", measure_strides(events, time, feet))


def test_strides_that_turn_are_in_no_mean_and_are_named() -> None:
    time, feet, events = steps(8)
    faced = np.radians(np.interp(time, [2.4, 3.5], [0.0, 50.0])) + 0.1 * np.sin(
        2 * np.pi * time / 1.1
    )
    strides = measure_strides(events, time, feet, None, faced)
    assert [round(s.turn or 0.0) for s in whole(strides)] == [0, 0, 50]
    kept = select_straight_strides(strides)
    assert [s.number for s in whole(kept)] == [1, 2] and [s.number for s in whole(kept, "l")] == [1]
    (found,) = check_strides("walk", strides)
    check_finding(found, Code.TURNING_STRIDES, 3, 2, 50)
    width = next(
        m
        for m in average_measures({"walk": select_straight_strides(strides)})
        if m.name == "step_width"
    )
    assert width.symmetry is None and width.right is not None and width.left is not None


def test_what_needs_a_refused_leg_counts_for_nothing() -> None:
    time, feet, events = steps(6)
    strides = select_straight_strides(measure_strides(events, time, feet), ("l",))
    assert not any(s.measures for s in strides if s.side == "l")
    left = {name for s in strides for name in s.measures}
    assert {"stance", "cadence", "stride_length"} <= left and not any(
        "step" in n or "support" in n for n in left
    )
    assert not any(s.measures for s in select_straight_strides(strides, ("r", "l")))


def test_means_count_each_stride_and_symmetry_is_that_of_the_means() -> None:
    def stride(side: str, value: float) -> Stride:
        return Stride(
            side=side, number=1, start=0.0, stop=1.0, sources=(), measures={"step_length": value}
        )

    trials = {"a": [stride("r", 0.6), stride("r", 0.7), stride("l", 0.5)], "b": [stride("r", 0.8)]}
    (found,) = average_measures(trials)
    assert (found.right.n, found.right.trials, found.left.n) == (3, 2, 1) and found.unit == "m"
    assert (
        found.right.mean == pytest.approx(0.7)
        and found.right.sd == pytest.approx(0.1)
        and found.left.sd is None
    )
    assert found.right.sd_within == pytest.approx(np.std([0.6, 0.7], ddof=1))
    assert found.symmetry == pytest.approx(100 * (0.7 - 0.5) / 0.6)
    right, left = (
        0.1 / 3**0.5,
        LEAST_SD["m"],
    )  # of three strides as they vary, of one as events are known
    d = 1e-6  # m: by differences of the index itself
    slopes = [
        100
        * ((0.7 + x - 0.5 - y) / (0.6 + (x + y) / 2) - (0.7 - x - 0.5 + y) / (0.6 - (x + y) / 2))
        / (2 * d)
        for x, y in ((d, 0.0), (0.0, d))
    ]
    assert found.symmetry_error == pytest.approx(
        np.hypot(slopes[0] * right, slopes[1] * left), rel=1e-6
    )


# ----------------------------------------------------------------------------- other people's files

Walks = dict[str, tuple[tuple[Stride, ...], Path]]
VENDOR_S, VENDOR_M = 2e-3, 0.012
"""Times to 1 ms, as the files have them; lengths to a centimetre: theirs are between markers, ours
between heels.
"""


@pytest.fixture(scope="module")
def walks(data_dir: Path) -> Walks:
    """Strides of nine walks of three people, tracked with their nominal models."""
    return recorded_strides(data_dir)


@pytest.mark.slow
def test_walks_of_a_hospital_measure_as_by_its_program(walks: Walks) -> None:
    ours = {
        "Cadence": "cadence", "Walking Speed": "speed", "Stride Time": "stride_time",
        "Step Time": "step_time",
        "Opposite Foot Off": "first_double_support_percent", "Foot Off": "stance_percent",
        "Single Support": "single_support", "Double Support": "double_support",
        "Stride Length": "stride_length",
        "Step Length": "step_length",
    }  # fmt: skip
    compared = 0
    for strides, path in walks.values():
        for (side, name), value in vendor_figures(path).items():
            if name in ours:
                mine = whole(strides, side)[0].measures[ours[name]]
                scale = {"m": VENDOR_M, "m/s": VENDOR_M, "s": VENDOR_S}.get(
                    MEASURES[ours[name]], 0.2
                )
                assert mine == pytest.approx(value, abs=scale), (path.name, side, name)
                compared += 1
    assert compared == 5 * 2 * len(ours)


@pytest.mark.slow
def test_children_measure_what_a_hand_count_of_events_and_heel_markers_gives(walks: Walks) -> None:
    """Straight and in a turn: events and heel markers of the file alone."""
    compared = 0
    for name, (strides, path) in walks.items():
        for side, counted in hand_count(path).items() if name.startswith("HC") else ():
            for mine, by_hand in zip(whole(strides, side), counted, strict=True):
                for measure, value in by_hand.items():
                    close = 0.02 if MEASURES[measure] in ("m", "m/s") else VENDOR_S
                    assert mine.measures[measure] == pytest.approx(value, abs=close), (
                        name,
                        side,
                        measure,
                    )
                    compared += 1
    assert compared > 50
