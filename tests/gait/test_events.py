"""Events of file, plates and motion as one list; those of motion alone; clocks and sides of files
that are wrong.
"""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gaitcal.errors import Code, Severity
from gaitcal.gait.cycles import EventSource, describe_sources
from gaitcal.gait.event_checks import check_file_events
from gaitcal.gait.events import (
    OFF,
    STRIKE,
    combine_events,
    find_plate_events,
    find_swing_events,
    use_corrected_events,
)
from gaitcal.io.labels import FootEvent, FootMoment
from gaitcal.io.recording import ForcePlate
from tests.gait.walks import TIME, exchanged, moved, walk
from tests.messages import check_finding, check_text

SAMPLE = 1e-3
"""s, of the plates."""


def test_the_file_comes_first_then_plates_then_motion() -> None:
    file, plates = walk(2.0, 3.0), moved(walk(2.8, 4.0), 0.01)
    found = combine_events(TIME, file, plates, moved(walk(), -0.02))
    assert found.findings == ()
    assert [(e.side, e.moment) for e in found.events] == [(e.side, e.moment) for e in walk()]
    sources = [e.source for e in found.events]
    of_file, of_plates = len(file), len(walk(3.0, 4.0))
    expected = [EventSource.FILE] * of_file + [EventSource.PLATES] * of_plates
    assert sources == expected + [EventSource.MOTION] * (len(walk()) - of_file - of_plates)
    assert [e.time for e in found.events[:of_file]] == [e.time for e in file]


def test_only_corrected_events_are_used_and_differences_are_reported() -> None:
    """No other joins them, none is moved; the trial's ends cut; forces and motion are a finding, no
    reason.
    """
    far = FootEvent(FootMoment.STRIKE, "r", 1.5 * TIME[-1])
    moved_one, *rest = walk(2.0, 3.0)
    set_by_hand = [
        FootEvent(moved_one.moment, moved_one.side, moved_one.time + 0.15),
        *rest[:2],
        far,
    ]
    found = use_corrected_events(TIME, set_by_hand, walk())
    assert [e.time for e in found.events] == [e.time for e in set_by_hand[:-1]]
    assert {e.source for e in found.events} == {EventSource.PERSON}
    [apart] = [
        f for f in found.findings if f.cause == "corrected events differ from forces and motion"
    ]
    check_finding(apart, Code.FILE_EVENTS, Severity.INFO, f"{set_by_hand[0].time:.2f}", 100)
    assert not use_corrected_events(TIME, walk(), walk()).findings


def test_missing_corrected_events_are_reported_and_a_foot_without_a_kind_is_a_warning() -> None:
    """Both sources have each event once; one that is moved is apart, not left out."""
    shown = [*walk(3.0, 4.5), *moved(walk(), 0.05)]
    one_off = next(e for e in walk() if e.time > 3.0 and e.moment is FootMoment.OFF)
    [left_out] = use_corrected_events(TIME, [e for e in walk() if e != one_off], shown).findings[:1]
    check_finding(left_out, Code.FILE_EVENTS, f"{one_off.time:.2f}")
    assert left_out.severity is Severity.INFO
    [none] = use_corrected_events(TIME, [e for e in walk() if e.side == "r"], shown).findings
    check_finding(none, Code.FILE_EVENTS, Severity.WARNING, 3, 4)
    strikes = [e for e in walk() if e.side == "r" or e.moment is FootMoment.STRIKE]
    [offs] = use_corrected_events(TIME, strikes, []).findings
    check_finding(offs, Code.FILE_EVENTS, Severity.WARNING)
    assert not use_corrected_events(TIME, [e for e in walk() if e.side == "r"], []).findings


def test_events_of_the_motion_are_moved_to_mean_the_same_as_those_known_better() -> None:
    """Strikes 30 ms early, offs 20 ms late, of which the plates show one stride."""
    motion = [
        FootEvent(e.moment, e.side, e.time + (-0.03 if e.moment is FootMoment.STRIKE else 0.02))
        for e in walk()
    ]
    found = combine_events(TIME, [], walk(3.0, 4.2), motion)
    assert [e.time for e in found.events] == pytest.approx([e.time for e in walk()])
    alone = combine_events(TIME, [], [], motion)
    assert [e.time for e in alone.events] == pytest.approx(sorted(e.time for e in motion))


def test_a_plate_that_is_entered_or_left_during_stance_makes_no_event() -> None:
    """The foot rolls over the plate's edge 0.2 s before it leaves the ground."""
    whole = [e for e in walk() if e.side == "r"][2:4]
    left_early = [whole[0], FootEvent(whole[1].moment, "r", whole[1].time - 0.2)]
    found = combine_events(TIME, [], left_early, walk())
    at = {(e.side, e.moment, round(e.time, 2)): e.source for e in found.events}
    assert at["r", whole[0].moment, round(whole[0].time, 2)] is EventSource.PLATES
    assert at["r", whole[1].moment, round(whole[1].time, 2)] is EventSource.MOTION
    assert len(found.events) == len(walk())


def test_an_event_of_a_plate_near_an_end_of_the_trial_needs_no_swing() -> None:
    """There the motion cannot show one; in the middle a foot came onto the plate otherwise."""
    for time in (TIME[0] + 0.1, TIME[-1] - 0.1):
        on_plate = FootEvent(FootMoment.STRIKE, "r", float(time))
        found = combine_events(
            TIME, [], [on_plate], [e for e in walk() if abs(e.time - time) > 0.3]
        )
        assert [e.time for e in found.events if e.source is EventSource.PLATES] == [time]


def test_a_plate_whose_record_begins_and_ends_under_load_has_no_event_there() -> None:
    frames = np.arange(0.0, 2.0, 0.02)
    samples = frames[(frames > 0.5) & (frames < 1.5)]
    force = np.column_stack([0 * samples, np.full(len(samples), 700.0), 0 * samples])
    plate = ForcePlate(name="1", time=samples, force=force, point=0 * force, moment=0 * force)
    loaded = ((frames > 0.5) & (frames < 1.5))[:, None] & np.array([True, False])
    assert find_plate_events(frames, loaded, [plate]) == []
    assert len(find_plate_events(frames, loaded, [])) == 2


def test_plates_give_the_time_between_frames() -> None:
    frames, samples = np.arange(0.0, 2.0, 0.02), np.arange(0.0, 2.0, SAMPLE)
    force = np.zeros((len(samples), 3))
    force[:, 1] = np.where((samples > 0.4514) & (samples < 1.1237), 700.0, 0.0)
    plate = ForcePlate(name="1", time=samples, force=force, point=0 * force, moment=0 * force)
    loaded = np.interp(frames, samples, force[:, 1])[:, None] > 20.0
    found = find_plate_events(frames, np.hstack([loaded, 0 * loaded > 1]), [plate])
    assert [(e.moment, e.side) for e in found] == [(FootMoment.STRIKE, "r"), (FootMoment.OFF, "r")]
    assert [e.time for e in found] == pytest.approx([0.4514, 1.1237], abs=1.01 * SAMPLE)


def test_a_contact_that_the_trial_begins_or_ends_with_is_no_event() -> None:
    frames = np.arange(0.0, 2.0, 0.02)
    loaded = np.stack([(frames < 0.5) | (frames > 1.5), frames > 9.0], axis=1)
    found = [(e.moment, round(e.time, 6)) for e in find_plate_events(frames, loaded, [])]
    assert found == [(FootMoment.OFF, 0.48), (FootMoment.STRIKE, 1.52)]


def test_strikes_of_one_foot_carry_their_sources() -> None:
    found = combine_events(TIME, [], walk(3.0, 4.2), walk())
    foot = found.select_foot("r")
    assert len(foot.sources) == len(foot.strikes) and set(foot.sources) == {
        EventSource.PLATES,
        EventSource.MOTION,
    }
    check_text(describe_sources(foot.sources))
    assert describe_sources(()) == ""
    assert foot.strikes.tolist() == sorted(
        e.time for e in walk() if e.side == "r" and e.moment is FootMoment.STRIKE
    )


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


FRAMES = np.arange(0.0, 3.0, 0.01)
RESTED = find_swing_events(FRAMES, speed(FRAMES))
"""Strikes and offs of that foot."""


@pytest.mark.parametrize("rate", [60.0, 100.0, 250.0])
def test_events_are_where_the_speed_passes_its_thresholds(rate: float) -> None:
    time = np.arange(0.0, 3.0, 1.0 / rate)
    strikes, offs = find_swing_events(time, speed(time))
    assert strikes == pytest.approx(
        np.array(STRIKES) - part_of_swing(STRIKE), abs=BETWEEN_FRAMES / rate
    )
    assert offs == pytest.approx(np.array(OFFS) + part_of_swing(OFF), abs=BETWEEN_FRAMES / rate)


@given(st.floats(0.3, 4.0), st.floats(0.5, 2.0), st.floats(-50.0, 50.0))
def test_walking_speed_and_time_offset_do_not_matter(
    slower: float, stretch: float, shift: float
) -> None:
    there = find_swing_events(shift + stretch * FRAMES, speed(FRAMES, peak=slower * 3.0))
    for a, b in zip(RESTED, there, strict=True):
        assert b == pytest.approx(shift + stretch * a, abs=1e-9 * (1.0 + abs(shift)))


def test_a_dip_within_a_swing_is_no_contact_and_a_short_step_among_long_ones_is_a_step() -> None:
    dipped = speed(FRAMES) * (1.0 - 0.4 * np.exp(-(((FRAMES - 1.15) / 0.03) ** 2)))
    for a, b in zip(RESTED, find_swing_events(FRAMES, dipped), strict=True):
        assert b == pytest.approx(a, abs=0.005)
    uneven = np.where((FRAMES > 0.9) & (FRAMES < 1.5), 0.35, 1.0) * speed(FRAMES)
    assert [len(found) for found in find_swing_events(FRAMES, uneven)] == [3, 2]


def test_a_foot_that_sways_or_shuffles_on_the_spot_makes_no_step() -> None:
    steps = speed(FRAMES)
    sway = 0.2 * np.abs(np.sin(9.0 * FRAMES))
    shuffle = steps + np.where(steps > 0, 0.0, 0.2 * np.abs(np.sin(25 * FRAMES)))
    knock = np.maximum(steps, np.where((FRAMES > 0.7) & (FRAMES < 0.75), 1.0, 0.0))
    for standing in (sway, shuffle):
        assert len(find_swing_events(FRAMES, standing)[0]) in (0, 3)
    assert [len(found) for found in find_swing_events(FRAMES, knock)] == [3, 2]


def test_a_swing_that_the_trial_cuts_gives_the_recorded_event() -> None:
    def of(frames: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return find_swing_events(FRAMES[frames], values[frames])

    strikes, offs = RESTED
    assert of(FRAMES > 0.15, speed(FRAMES))[0] == pytest.approx(strikes, abs=1e-9)
    assert of(FRAMES < 2.3, speed(FRAMES))[1] == pytest.approx(offs, abs=1e-9)
    # too little of the swing to distinguish it from effects of filters at an end
    assert of(FRAMES > 0.26, speed(FRAMES))[0] == pytest.approx(strikes[1:], abs=1e-9)
    shaken = np.where(FRAMES < 0.47, 0.0, speed(FRAMES))
    shaken[:4] = (0.9, 0.5, 0.2, 0.05)
    assert of(FRAMES >= 0.0, shaken)[0] == pytest.approx(strikes[1:], abs=1e-9)


@pytest.mark.parametrize("values", [np.zeros(300), np.full(300, np.nan), np.ones(2)])
def test_nothing_is_made_of_nothing(values: np.ndarray) -> None:
    assert all(
        len(found) == 0 for found in find_swing_events(0.01 * np.arange(len(values)), values)
    )


BY_EYE = 0.012
"""s, deviation of events that are set by eye or found by motion."""
NEAR = 0.02 + 0.005
"""s, of an offset that is the median of a dozen such events, reported in hundredths."""
few = settings(max_examples=20)
seeds = st.integers(0, 10_000)


def causes(file: list[FootEvent], plates: list[FootEvent], motion: list[FootEvent]) -> list[str]:
    return [f.cause for f in check_file_events(file, plates, motion, TIME)[1]]


@few
@given(seeds)
def test_events_set_by_eye_are_used_without_a_finding(seed: int) -> None:
    file = moved(walk(), 0.0, BY_EYE, seed)
    inside = [e for e in file if TIME[0] - 0.005 <= e.time <= TIME[-1] + 0.005]
    assert check_file_events(file, walk(3.0, 4.5), moved(walk(), 0.01, BY_EYE, seed + 1), TIME) == (
        inside,
        (),
    )


@few
@given(seeds)
def test_a_foot_that_drags_is_no_time_offset(seed: int) -> None:
    """Its motion tells strikes late and offs early, as long as it lasts; the file may tell fewer
    offs than strikes.
    """
    motion = [
        replace(e, time=e.time + (0.075 if e.moment is FootMoment.STRIKE else -0.075))
        for e in walk()
    ]
    file = moved(walk(), 0.0, 0.5 * BY_EYE, seed)
    few_offs = [e for e in file if e.moment is FootMoment.STRIKE or e.time < 3.6]
    assert causes(file, [], motion) == causes(few_offs, [], motion) == []


@pytest.mark.parametrize("offset", [-0.45, -0.2, 0.13, 0.35])
@few
@given(seeds)
def test_a_common_offset_of_all_events_is_reported_with_its_size(offset: float, seed: int) -> None:
    used, (finding,) = check_file_events(
        moved(walk(), offset, BY_EYE, seed), [], moved(walk(), 0.0, BY_EYE, seed + 1), TIME
    )
    assert used == [] and finding.severity is Severity.WARNING
    assert finding.cause.endswith("too late" if offset > 0 else "too early")
    size = float(finding.cause.removeprefix("the file's events come ").split(" s ")[0])
    assert size == pytest.approx(abs(offset), abs=NEAR)


def late(
    events: list[FootEvent],
    by: float,
    side: str = "",
    moment: FootMoment | None = None,
    time: float | None = None,
) -> list[FootEvent]:
    """The same with those of one side, one kind or one time later by `by` s."""
    chosen = [
        (not side or e.side == side) and moment in (None, e.moment) and time in (None, e.time)
        for e in events
    ]
    return [replace(e, time=e.time + by) if c else e for e, c in zip(events, chosen, strict=True)]


STRIKES_ALONE = FootMoment.STRIKE
PLATES = walk(3.0, 4.5)
ON_PLATE = next(e for e in PLATES if e.moment is FootMoment.STRIKE)
ASTRAY = walk()[4]
BY_CHANCE = [
    FootEvent(FootMoment.STRIKE, "rl"[k % 2], t)
    for k, t in enumerate((2.31, 2.77, 3.64, 3.9, 4.9, 5.3))
]


def others(side: str = "", moment: FootMoment | None = None) -> list[FootEvent]:
    return [e for e in walk() if e.side != side and e.moment is not moment]


@pytest.mark.parametrize(
    ("file", "plates", "motion", "used", "cause", "found", "severity"),
    [
        pytest.param(moved(walk(), -0.06), PLATES, walk(), [], "60 ms too early", "plates",
            "WARNING", id="early"),
        pytest.param(moved(walk(), 0.07), PLATES, walk(), [], "70 ms too late", "plates", "WARNING",
            id="late"),
        pytest.param(moved(walk(), 0.08), [], walk(), [], "80 ms too late", "motion", "WARNING",
            id="without plates"),
        *(
            pytest.param(
                late(walk(), by, side, moment), walk(2.6, 4.9), walk(), others(side, moment),
                f"the file's {word} events come {1e3 * abs(by):.0f} ms "
                "too", "", "WARNING", id=f"{word} {by}",
            )
            for by in (-0.06, 0.08)
            for side, moment, word in (("l", None, "left"), ("r", None, "right"),
                ("", STRIKES_ALONE, "foot strike"))
        ),
        pytest.param(
            late(walk(), 0.2, time=ASTRAY.time), [], walk(), [e for e in walk() if e != ASTRAY], "",
            f"{ASTRAY.time + 0.2:.2f} s", "INFO", id="one astray",
        ),
        pytest.param(
            late(walk(), 0.06, time=ON_PLATE.time), PLATES, walk(),
            [e for e in walk() if e != ON_PLATE], "",
            f"{ON_PLATE.time + 0.06:.2f} s (plate {ON_PLATE.time:.2f} "
            "s)", "INFO", id="its plate contradicts one",
        ),
        pytest.param(BY_CHANCE, [], walk(), [], "", "not used", "INFO", id="no known fault "
                                                                           "explains them"),
        pytest.param([*walk(), *moved(walk(), 0.06)], PLATES, walk(), walk(), "more than once", "",
            "INFO", id="twice"),
    ],
)  # fmt: skip
def test_wrong_events_are_reported_and_the_others_stay(
    file: list[FootEvent], plates: list[FootEvent], motion: list[FootEvent], used: list[FootEvent],
    cause: str,
    found: str, severity: str,
) -> None:  # fmt: skip
    kept, (finding,) = check_file_events(file, plates, motion, TIME)
    assert kept == used
    assert (
        cause in finding.cause and found in finding.found and finding.severity is Severity[severity]
    )


@pytest.mark.parametrize(
    ("file", "plates", "motion", "used"),
    [
        pytest.param(
            moved(walk(), 0.035),
            PLATES,
            walk(),
            moved(walk(), 0.035),
            id="an offset too small to recognise",
        ),
        pytest.param(
            walk(0.5, 9.0), [], walk(), walk(), id="before and after a trial that was cut"
        ),
        pytest.param(
            walk(),
            late(PLATES, 0.08, time=ON_PLATE.time),
            walk(),
            walk(),
            id="down in front of its plate",
        ),
        pytest.param(walk(1.0, 5.0), [], [], walk(2.0, 5.0), id="nothing to check them by"),
        pytest.param([], walk(), walk(), [], id="none"),
    ],
)
def test_events_that_agree_are_used(
    file: list[FootEvent], plates: list[FootEvent], motion: list[FootEvent], used: list[FootEvent]
) -> None:
    assert check_file_events(file, plates, motion, TIME) == (used, ())


def test_duplicate_events_are_used_once_without_plates_and_motion() -> None:
    alone, reported = check_file_events([*walk(), *moved(walk(), 0.06)], [], [], TIME)
    assert len(alone) == len(walk()) and reported


@pytest.mark.parametrize("step", [0.49, 0.53, 0.6])
@few
@given(seeds)
def test_swapped_sides_are_reported(step: float, seed: int) -> None:
    file = exchanged(moved(walk(step=step), 0.0, BY_EYE, seed))
    used, (finding,) = check_file_events(file, [], walk(step=step), TIME)
    assert used == []
    assert (finding.code, finding.severity) == (Code.FILE_EVENTS, Severity.WARNING)


@few
@given(seeds)
def test_times_from_the_first_frame_are_used_as_they_are_meant(seed: int) -> None:
    right = moved(walk(2.1, 5.9), 0.0, BY_EYE, seed)
    for offset, words in (
        (-float(TIME[0]), "from its first frame"),
        (float(TIME[0]), "contain the time of the first frame twice"),
    ):
        used, (finding,) = check_file_events(moved(right, offset), [], walk(), TIME)
        assert [e.time for e in used] == pytest.approx([e.time for e in right])
        assert words in finding.cause and finding.severity is Severity.INFO
