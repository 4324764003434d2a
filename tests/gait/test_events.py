"""Events of file, plates and motion as one list: which source wins, and how the others are moved."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from gaitcal.gait.cycles import EventSource, source_words
from gaitcal.gait.events import joined_events, motion_events, plate_events
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


def test_both_feet_by_their_own_motion() -> None:
    speed = np.stack([np.maximum(0.0, 3.0 * np.sin(6.0 * TIME + phase)) for phase in (0.0, np.pi)], axis=1)
    found = motion_events(TIME, speed)
    right, left = ([e.time for e in found if e.side == s and e.moment is FootMoment.STRIKE] for s in "rl")
    between = sorted([(t, "r") for t in right] + [(t, "l") for t in left])
    assert len(right) + len(left) >= 6
    assert all(a[1] != b[1] for a, b in pairwise(between)), "the feet take turns"


def test_strikes_of_one_foot_carry_their_sources() -> None:
    found = joined_events(TIME, [], walk(3.0, 4.2), walk())
    foot = found.of("r")
    assert len(foot.sources) == len(foot.strikes) and set(foot.sources) == {EventSource.PLATES, EventSource.MOTION}
    assert foot.strikes.tolist() == sorted(e.time for e in walk() if e.side == "r" and e.moment is FootMoment.STRIKE)


def test_sources_in_words() -> None:
    assert source_words([EventSource.MOTION, EventSource.PLATES]) == "force plates and the motion of the feet"
    assert source_words(()) == ""
