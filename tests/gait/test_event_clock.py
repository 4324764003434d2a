"""Events of a file against forces and motion: what fits is used, every known fault is named, nothing else alarms."""

from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gaitcal.findings import Severity
from gaitcal.gait.event_clock import checked_events
from gaitcal.io.labels import FootEvent, FootMoment
from tests.gait.walks import TIME, exchanged, moved, walk

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
