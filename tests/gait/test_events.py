"""Events of file, plates and motion as one list: which source wins, and how the others are moved."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gaitcal.findings import Severity
from gaitcal.gait.cycles import EventSource, source_words
from gaitcal.gait.events import OFF, STRIKE, corrected, joined_events, plate_events, swing_events
from gaitcal.io.labels import FootEvent, FootMoment
from gaitcal.io.recording import ForcePlate
from tests.gait.walks import TIME, moved, walk

SAMPLE = 1e-3
"""s, of the plates."""


def test_the_file_comes_first_then_plates_then_motion() -> None:
    file, plates = walk(2.0, 3.0), moved(walk(2.8, 4.0), 0.01)
    found = joined_events(TIME, file, plates, moved(walk(), -0.02))
    assert found.findings == ()
    assert [(e.side, e.moment) for e in found.events] == [(e.side, e.moment) for e in walk()]
    sources = [e.source for e in found.events]
    of_file, of_plates = len(file), len(walk(3.0, 4.0))
    expected = [EventSource.FILE] * of_file + [EventSource.PLATES] * of_plates
    assert sources == expected + [EventSource.MOTION] * (len(walk()) - of_file - of_plates)
    assert [e.time for e in found.events[:of_file]] == [e.time for e in file]


def test_corrected_events_are_the_only_ones_and_what_is_apart_is_told() -> None:
    """No other joins them, none is moved; the trial's ends cut; forces and motion are a finding, no reason."""
    far = FootEvent(FootMoment.STRIKE, "r", 1.5 * TIME[-1])
    moved_one, *rest = walk(2.0, 3.0)
    set_by_hand = [FootEvent(moved_one.moment, moved_one.side, moved_one.time + 0.15), *rest[:2], far]
    found = corrected(TIME, set_by_hand, walk())
    assert [e.time for e in found.events] == [e.time for e in set_by_hand[:-1]]
    assert {e.source for e in found.events} == {EventSource.PERSON}
    [apart] = [f for f in found.findings if f.cause == "corrected events lie apart from forces and motion"]
    assert f"{set_by_hand[0].time:.2f} s: more than 100 ms" in apart.found and apart.severity is Severity.INFO
    assert not corrected(TIME, walk(), walk()).findings


def test_what_corrected_events_leave_out_is_told_and_a_foot_without_a_kind_is_warned_of() -> None:
    """Both sources have each event once; one that is moved is apart, not left out."""
    shown = [*walk(3.0, 4.5), *moved(walk(), 0.05)]
    one_off = next(e for e in walk() if e.time > 3.0 and e.moment is FootMoment.OFF)
    [left_out] = corrected(TIME, [e for e in walk() if e != one_off], shown).findings[:1]
    assert left_out.found.count("foot off") == 1 and f"off {one_off.time:.2f} s" in left_out.found
    assert left_out.severity is Severity.INFO
    [none] = corrected(TIME, [e for e in walk() if e.side == "r"], shown).findings
    assert none.severity is Severity.WARNING and none.cause.endswith("no foot strike and no foot off of the left foot")
    assert "motion show 3 foot strikes and 4 foot offs, which are not used: strides" in none.found
    strikes = [e for e in walk() if e.side == "r" or e.moment is FootMoment.STRIKE]
    [offs] = corrected(TIME, strikes, []).findings
    assert offs.severity is Severity.WARNING and offs.cause.endswith("no foot off of the left foot")
    assert not corrected(TIME, [e for e in walk() if e.side == "r"], []).findings


def test_events_of_the_motion_are_moved_to_mean_the_same_as_those_known_better() -> None:
    """Strikes 30 ms early, offs 20 ms late, of which the plates show one stride."""
    motion = [FootEvent(e.moment, e.side, e.time + (-0.03 if e.moment is FootMoment.STRIKE else 0.02)) for e in walk()]
    found = joined_events(TIME, [], walk(3.0, 4.2), motion)
    assert [e.time for e in found.events] == pytest.approx([e.time for e in walk()])
    alone = joined_events(TIME, [], [], motion)
    assert [e.time for e in alone.events] == pytest.approx(sorted(e.time for e in motion))


def test_a_plate_that_is_entered_or_left_during_stance_makes_no_event() -> None:
    """The foot rolls over the plate's edge 0.2 s before it leaves the ground."""
    whole = [e for e in walk() if e.side == "r"][2:4]
    left_early = [whole[0], FootEvent(whole[1].moment, "r", whole[1].time - 0.2)]
    found = joined_events(TIME, [], left_early, walk())
    at = {(e.side, e.moment, round(e.time, 2)): e.source for e in found.events}
    assert at["r", whole[0].moment, round(whole[0].time, 2)] is EventSource.PLATES
    assert at["r", whole[1].moment, round(whole[1].time, 2)] is EventSource.MOTION
    assert len(found.events) == len(walk())


def test_plates_tell_the_moment_between_frames() -> None:
    frames, samples = np.arange(0.0, 2.0, 0.02), np.arange(0.0, 2.0, SAMPLE)
    force = np.zeros((len(samples), 3))
    force[:, 1] = np.where((samples > 0.4514) & (samples < 1.1237), 700.0, 0.0)
    plate = ForcePlate(name="1", time=samples, force=force, point=0 * force, moment=0 * force)
    loaded = np.interp(frames, samples, force[:, 1])[:, None] > 20.0
    found = plate_events(frames, np.hstack([loaded, 0 * loaded > 1]), [plate])
    assert [(e.moment, e.side) for e in found] == [(FootMoment.STRIKE, "r"), (FootMoment.OFF, "r")]
    assert [e.time for e in found] == pytest.approx([0.4514, 1.1237], abs=1.01 * SAMPLE)


def test_a_contact_that_the_trial_begins_or_ends_with_is_no_event() -> None:
    frames = np.arange(0.0, 2.0, 0.02)
    loaded = np.stack([(frames < 0.5) | (frames > 1.5), frames > 9.0], axis=1)
    found = [(e.moment, round(e.time, 6)) for e in plate_events(frames, loaded, [])]
    assert found == [(FootMoment.OFF, 0.48), (FootMoment.STRIKE, 1.52)]


def test_strikes_of_one_foot_carry_their_sources() -> None:
    found = joined_events(TIME, [], walk(3.0, 4.2), walk())
    foot = found.of("r")
    assert len(foot.sources) == len(foot.strikes) and set(foot.sources) == {EventSource.PLATES, EventSource.MOTION}
    assert foot.strikes.tolist() == sorted(e.time for e in walk() if e.side == "r" and e.moment is FootMoment.STRIKE)


def test_sources_in_words() -> None:
    assert source_words([EventSource.MOTION, EventSource.PLATES]) == "force plates and the motion of the feet"
    assert source_words(()) == ""


STRIDE, SWING = 1.1, 0.44
"""s."""
STRIKES, OFFS = (0.3, 1.4, 2.5), (0.96, 2.06)
BETWEEN_FRAMES = 0.2
"""Of a frame: what a straight line between two frames misses of a parabola."""


def speed(time: np.ndarray, peak: float = 3.0, first: float = 0.3) -> np.ndarray:
    """A foot that swings along a parabola before each strike, and rests between."""
    phase = (time - first + SWING) % STRIDE
    return np.where(phase < SWING, peak * 4.0 * phase * (SWING - phase) / SWING**2, 0.0)


def part_of_swing(share: float) -> float:
    """Time (s) from the end of a parabola to where it is this share of its peak."""
    return SWING * 0.5 * (1.0 - np.sqrt(1.0 - share))


def frames(rate: float = 100.0, stop: float = 3.0) -> np.ndarray:
    return np.arange(0.0, stop, 1.0 / rate)


@pytest.mark.parametrize("rate", [60.0, 100.0, 250.0])
def test_events_are_where_the_speed_passes_its_thresholds(rate: float) -> None:
    time = frames(rate)
    strikes, offs = swing_events(time, speed(time))
    assert strikes == pytest.approx(np.array(STRIKES) - part_of_swing(STRIKE), abs=BETWEEN_FRAMES / rate)
    assert offs == pytest.approx(np.array(OFFS) + part_of_swing(OFF), abs=BETWEEN_FRAMES / rate)


@given(st.floats(0.3, 4.0), st.floats(0.5, 2.0), st.floats(-50.0, 50.0))
def test_speed_of_walking_and_begin_of_the_clock_do_not_matter(slower: float, stretch: float, shift: float) -> None:
    time = frames()
    here = swing_events(time, speed(time))
    there = swing_events(shift + stretch * time, speed(time, peak=slower * 3.0))
    for a, b in zip(here, there, strict=True):
        assert b == pytest.approx(shift + stretch * a, abs=1e-9 * (1.0 + abs(shift)))


def test_a_dip_within_a_swing_is_no_contact() -> None:
    time = frames()
    dipped = speed(time) * (1.0 - 0.4 * np.exp(-(((time - 1.15) / 0.03) ** 2)))
    for a, b in zip(swing_events(time, speed(time)), swing_events(time, dipped), strict=True):
        assert b == pytest.approx(a, abs=0.005)


def test_a_short_step_among_long_ones_is_a_step() -> None:
    time = frames()
    uneven = np.where((time > 0.9) & (time < 1.5), 0.35, 1.0) * speed(time)
    strikes, offs = swing_events(time, uneven)
    assert len(strikes) == 3 and len(offs) == 2


def test_a_foot_that_sways_or_shuffles_on_the_spot_makes_no_step() -> None:
    time = frames()
    sway = 0.2 * np.abs(np.sin(9.0 * time))
    knock = np.where((time > 0.7) & (time < 0.75), 1.0, 0.0)
    for standing in (sway, speed(time) + np.where(speed(time) > 0, 0.0, 0.2 * np.abs(np.sin(25 * time)))):
        assert len(swing_events(time, standing)[0]) in (0, 3)
    assert all(len(found) == 3 - k for k, found in enumerate(swing_events(time, np.maximum(speed(time), knock))))


def test_a_swing_that_the_trial_cuts_tells_the_end_that_it_shows() -> None:
    time = frames()
    whole = swing_events(time, speed(time))
    late, early = time > 0.22, time < 2.2
    assert swing_events(time[late], speed(time)[late])[0] == pytest.approx(whole[0], abs=1e-9)
    assert swing_events(time[early], speed(time)[early])[1] == pytest.approx(whole[1], abs=1e-9)


@pytest.mark.parametrize("values", [np.zeros(300), np.full(300, np.nan), np.ones(2)])
def test_nothing_is_made_of_nothing(values: np.ndarray) -> None:
    assert all(len(found) == 0 for found in swing_events(0.01 * np.arange(len(values)), values))
