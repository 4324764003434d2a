"""Events of file, plates and motion as one list; those of motion alone; clocks and sides of files that are wrong."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gaitcal.errors import Severity
from gaitcal.gait.cycles import EventSource, source_words
from gaitcal.gait.event_clock import checked_events
from gaitcal.gait.events import OFF, STRIKE, corrected, joined_events, plate_events, swing_events
from gaitcal.io.labels import FootEvent, FootMoment
from gaitcal.io.recording import ForcePlate
from tests.gait.walks import TIME, exchanged, moved, walk

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
    late, early = time > 0.15, time < 2.3
    assert swing_events(time[late], speed(time)[late])[0] == pytest.approx(whole[0], abs=1e-9)
    assert swing_events(time[early], speed(time)[early])[1] == pytest.approx(whole[1], abs=1e-9)
    later, shaken = time > 0.26, speed(time)  # too little of the swing to tell it from what filters do at an end
    assert swing_events(time[later], speed(time)[later])[0] == pytest.approx(whole[0][1:], abs=1e-9)
    shaken[time < 0.47] = 0.0
    shaken[:4] = (0.9, 0.5, 0.2, 0.05)
    assert swing_events(time, shaken)[0] == pytest.approx(whole[0][1:], abs=1e-9)


@pytest.mark.parametrize("values", [np.zeros(300), np.full(300, np.nan), np.ones(2)])
def test_nothing_is_made_of_nothing(values: np.ndarray) -> None:
    assert all(len(found) == 0 for found in swing_events(0.01 * np.arange(len(values)), values))


BY_EYE = 0.012
"""s, deviation of events that somebody set by eye, or that motion told."""
NEAR = 0.02 + 0.005
"""s, of an offset that is the median of a dozen such events, told in hundredths."""
few = settings(max_examples=20)
seeds = st.integers(0, 10_000)


def causes(file: list[FootEvent], plates: list[FootEvent], motion: list[FootEvent]) -> list[str]:
    return [f.cause for f in checked_events(file, plates, motion, TIME)[1]]


@few
@given(seeds)
def test_events_set_by_eye_are_used_and_nothing_is_said(seed: int) -> None:
    file = moved(walk(), 0.0, BY_EYE, seed)
    inside = [e for e in file if TIME[0] - 0.005 <= e.time <= TIME[-1] + 0.005]
    assert checked_events(file, walk(3.0, 4.5), moved(walk(), 0.01, BY_EYE, seed + 1), TIME) == (inside, ())


@few
@given(seeds)
def test_a_foot_that_drags_is_no_wrong_clock(seed: int) -> None:
    """Its motion tells strikes late and offs early, as long as it lasts; the file may tell fewer offs than strikes."""
    motion = [replace(e, time=e.time + (0.075 if e.moment is FootMoment.STRIKE else -0.075)) for e in walk()]
    file = moved(walk(), 0.0, 0.5 * BY_EYE, seed)
    few_offs = [e for e in file if e.moment is FootMoment.STRIKE or e.time < 3.6]
    assert causes(file, [], motion) == causes(few_offs, [], motion) == []


@pytest.mark.parametrize("offset", [-0.45, -0.2, 0.13, 0.35])
@few
@given(seeds)
def test_one_offset_of_all_events_is_told_with_its_size(offset: float, seed: int) -> None:
    used, (finding,) = checked_events(
        moved(walk(), offset, BY_EYE, seed), [], moved(walk(), 0.0, BY_EYE, seed + 1), TIME
    )
    assert used == [] and finding.severity is Severity.WARNING
    assert finding.cause.endswith("too late" if offset > 0 else "too early")
    size = float(finding.cause.removeprefix("the file's events come ").split(" s ")[0])
    assert size == pytest.approx(abs(offset), abs=NEAR)


@pytest.mark.parametrize("offset", [-0.06, 0.07])
def test_a_small_offset_is_told_against_plates(offset: float) -> None:
    used, (finding,) = checked_events(moved(walk(), offset), walk(3.0, 4.5), walk(), TIME)
    assert used == [] and f"{1e3 * abs(offset):.0f} ms too" in finding.cause and "force plates" in finding.found
    assert causes(moved(walk(), 0.5 * offset), walk(3.0, 4.5), walk()) == []


def test_a_small_offset_is_told_against_the_motion_where_there_are_no_plates() -> None:
    used, (finding,) = checked_events(moved(walk(), 0.08), [], walk(), TIME)
    assert used == [] and "80 ms too late" in finding.cause and "motion" in finding.found


@pytest.mark.parametrize("step", [0.49, 0.53, 0.6])
@few
@given(seeds)
def test_exchanged_sides_are_told(step: float, seed: int) -> None:
    file = exchanged(moved(walk(step=step), 0.0, BY_EYE, seed))
    used, (finding,) = checked_events(file, [], walk(step=step), TIME)
    assert used == [] and finding.cause == "left and right of the file's events are exchanged"
    assert finding.severity is Severity.WARNING


@few
@given(seeds)
def test_times_from_the_first_frame_are_used_as_they_are_meant(seed: int) -> None:
    right = moved(walk(2.1, 5.9), 0.0, BY_EYE, seed)
    for offset, words in ((-float(TIME[0]), "from its first frame"), (float(TIME[0]), "from frame 0 twice over")):
        used, (finding,) = checked_events(moved(right, offset), [], walk(), TIME)
        assert [e.time for e in used] == pytest.approx([e.time for e in right])
        assert words in finding.cause and finding.severity is Severity.INFO


def test_a_single_event_astray_is_left_out_and_named() -> None:
    right = walk()
    file = [*right[:4], replace(right[4], time=right[4].time + 0.2), *right[5:]]
    used, (finding,) = checked_events(file, [], right, TIME)
    assert used == [*right[:4], *right[5:]]
    assert f"{file[4].time:.2f} s" in finding.found and finding.severity is Severity.INFO


def test_events_before_and_after_a_trial_that_was_cut_are_no_fault() -> None:
    used, findings = checked_events(walk(0.5, 9.0), [], walk(), TIME)
    assert used == walk() and findings == ()


def test_events_that_no_known_fault_explains_are_not_used_and_this_is_said() -> None:
    times = [2.31, 2.77, 3.64, 3.9, 4.9, 5.3]
    file = [FootEvent(FootMoment.STRIKE, "rl"[k % 2], t) for k, t in enumerate(times)]
    used, (finding,) = checked_events(file, [], walk(), TIME)
    assert used == [] and finding.severity is Severity.INFO and "not used" in finding.found


def test_without_anything_to_check_them_by_events_are_believed() -> None:
    assert checked_events(walk(1.0, 5.0), [], [], TIME) == (walk(2.0, 5.0), ())
    assert checked_events([], walk(), walk(), TIME) == ([], ())


def late(events: list[FootEvent], by: float, side: str = "", moment: FootMoment | None = None) -> list[FootEvent]:
    """The same with those of one side or one kind later by `by` s."""
    chosen = [(not side or e.side == side) and (moment is None or e.moment is moment) for e in events]
    return [replace(e, time=e.time + by) if c else e for e, c in zip(events, chosen, strict=True)]


@pytest.mark.parametrize(
    ("side", "moment", "word"), [("l", None, "left"), ("r", None, "right"), ("", FootMoment.STRIKE, "foot strike")]
)
@pytest.mark.parametrize("by", [-0.06, 0.08])
def test_an_offset_of_one_foot_or_one_kind_is_told_and_the_others_stay(
    side: str, moment: FootMoment | None, word: str, by: float
) -> None:
    file = late(walk(), by, side, moment)
    used, (finding,) = checked_events(file, walk(2.6, 4.9), walk(), TIME)
    assert f"the file's {word} events come {1e3 * abs(by):.0f} ms too" in finding.cause
    assert finding.severity is Severity.WARNING
    assert used and all(e in walk() and not (e.side == side or e.moment is moment) for e in used)


def test_one_event_that_its_plate_contradicts_gives_way_and_is_named() -> None:
    plates = walk(3.0, 4.5)
    wrong = next(e for e in plates if e.moment is FootMoment.STRIKE)
    file = [replace(e, time=e.time + 0.06) if e == wrong else e for e in walk()]
    used, (finding,) = checked_events(file, plates, walk(), TIME)
    assert f"{wrong.time + 0.06:.2f} s (plate {wrong.time:.2f} s)" in finding.found
    assert len(used) == len(checked_events(walk(), plates, walk(), TIME)[0]) - 1
    assert not any(e.side == wrong.side and abs(e.time - wrong.time) < 0.1 and e.moment is wrong.moment for e in used)


def test_a_foot_that_comes_down_in_front_of_its_plate_contradicts_no_event() -> None:
    """The plate is loaded 80 ms after the strike, which the motion shows where the file has it."""
    on_plates = walk(3.0, 4.5)
    first = next(e for e in on_plates if e.moment is FootMoment.STRIKE)
    plates = [replace(e, time=e.time + 0.08) if e == first else e for e in on_plates]
    assert causes(walk(), plates, walk()) == []


def test_events_that_stand_twice_are_used_once_and_told() -> None:
    clean = checked_events(walk(), walk(3.0, 4.5), walk(), TIME)[0]
    file = [*walk(), *moved(walk(), 0.06)]
    used, (finding,) = checked_events(file, walk(3.0, 4.5), walk(), TIME)
    assert used == sorted(clean, key=lambda e: e.time) and "more than once" in finding.cause
    alone, told = checked_events(file, [], [], TIME)
    assert len(alone) == len(checked_events(walk(), [], [], TIME)[0]) and told
