"""The still part of a recording, stretches of frames, gaps."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gaitcal.errors import Code
from gaitcal.io.recording import Recording, find_runs, find_still_window, measure_gaps
from tests.io.recordings import LABELS, body
from tests.messages import refuses


def walk_stand_walk(noise: float = 2e-4) -> Recording:
    """2 s walking at 1 m/s, 1 s standing, 2 s walking, 100 Hz, with measurement noise in m."""
    recording = body(500, speed=0.0)
    time = recording.time
    way = np.minimum(time, 2.0) + np.maximum(time - 3.0, 0.0)
    noisy = recording.markers + np.random.default_rng(0).normal(0, noise, recording.markers.shape)
    noisy[..., 0] += way[:, None]
    return replace(recording, markers=noisy)


def test_the_standing_second_between_two_walks_is_found() -> None:
    window = find_still_window(walk_stand_walk(), LABELS)
    assert 2.0 <= window.start < window.stop <= 3.0
    assert window.stop - window.start == pytest.approx(0.5)
    assert window.frames.stop - window.frames.start == 51
    assert window.speed < 0.01


def test_no_stillness_is_an_error_with_the_smallest_speed() -> None:
    with refuses(Code.NO_STILL_WINDOW, 0.51, 1.2, 0.1, field="static trial"):
        find_still_window(body(200, speed=1.2), LABELS)


@pytest.mark.parametrize("noise", [2e-3, 3e-3, 5e-3])
def test_noise_is_no_movement(noise: float) -> None:
    window = find_still_window(walk_stand_walk(noise), LABELS)
    assert 2.0 <= window.start < window.stop <= 3.0
    assert window.speed < 4.5 * noise
    with refuses(Code.NO_STILL_WINDOW, field="static trial"):
        moving = walk_stand_walk(noise)
        find_still_window(
            replace(
                moving, markers=moving.markers + [[[0.2, 0.0, 0.0]]] * moving.time[:, None, None]
            ),
            LABELS,
        )


def test_gaps_beside_noise() -> None:
    recording = walk_stand_walk(3e-3)
    recording.markers[np.random.default_rng(1).random(recording.markers.shape[:2]) < 0.1] = np.nan
    window = find_still_window(recording, LABELS)
    assert 1.95 <= window.start < window.stop <= 3.05  # within what is averaged
    assert window.speed < 0.02


def test_a_restless_person_is_used_with_the_speed_told() -> None:
    assert find_still_window(body(200, speed=0.08), LABELS).speed == pytest.approx(0.08)
    with refuses(Code.NO_STILL_WINDOW, 0.12, 0.1, field="static trial"):
        find_still_window(body(200, speed=0.12), LABELS)


def test_whoever_stands_still_somewhere_is_not_taken_from_where_they_are_restless() -> None:
    recording = body(300, speed=0.0)
    way = np.minimum(recording.time, 1.5) * 0.07
    markers = recording.markers + way[:, None, None] * [1.0, 0.0, 0.0]
    markers[150:, 3] = np.nan  # more markers are seen while the person drifts
    window = find_still_window(replace(recording, markers=markers), LABELS)
    assert window.start >= 1.4


def test_a_window_in_which_every_marker_is_seen_comes_first() -> None:
    recording = body(300, speed=0.0)
    markers = recording.markers + np.random.default_rng(0).normal(0, 1e-4, recording.markers.shape)
    markers[:200, 3] = np.nan
    window = find_still_window(replace(recording, markers=markers), LABELS)
    assert window.frames.stop > 200


def test_only_the_markers_asked_for_count() -> None:
    recording = body(100, speed=0.0)
    recording.markers[:, 7, 0] += np.linspace(0, 3, 100)
    assert find_still_window(recording, LABELS[:7]).speed < 1e-9
    with refuses(Code.NO_STILL_WINDOW, field="static trial"):
        find_still_window(recording, LABELS[7:])


@pytest.mark.parametrize("frames", [1, 2, 5, 30])
def test_short_recordings_are_taken_whole(frames: int) -> None:
    window = find_still_window(body(frames, speed=0.0), [*LABELS, "not there"])
    assert window.frames == slice(0, frames)
    assert window.speed < 1e-12


def test_markers_never_seen_are_an_error() -> None:
    recording = body(20)
    blind = replace(recording, markers=np.full_like(recording.markers, np.nan))
    for labels in (LABELS, ["absent"], []):
        with refuses(Code.TOO_LITTLE_SEEN, field="static trial"):
            find_still_window(blind, labels)


@pytest.mark.parametrize("frames", [2, 5])
def test_one_marker_that_jumps_in_a_few_frames_is_no_walk(frames: int) -> None:
    """It stays in the scatter; the person has not moved."""
    jumping = body(frames, speed=0.0)
    jumping.markers[frames // 2 :, 3] += [0.0, 0.05, 0.0]
    window = find_still_window(jumping, LABELS)
    assert window.speed < 1e-9 and window.scatter > 0.005
    for speed in (0.4, 1.0):
        walking = body(frames, speed=speed)
        walking.markers[:, :3] = walking.markers[:1, :3]  # a foot on the ground
        with refuses(Code.NO_STILL_WINDOW, field="static trial"):
            find_still_window(walking, LABELS)


@given(st.lists(st.booleans(), max_size=40), st.integers(1, 5))
def test_runs_are_all_stretches_that_are_long_enough(marked: list[bool], shortest: int) -> None:
    found = find_runs(np.array(marked, dtype=bool), shortest)
    frames = {k for run in found for k in range(run.start, run.stop)}
    assert all(marked[k] for k in frames)
    for run in found:
        assert run.stop - run.start >= shortest
        assert run.start == 0 or not marked[run.start - 1]
        assert run.stop == len(marked) or not marked[run.stop]
    if shortest == 1:
        assert frames == {k for k, mark in enumerate(marked) if mark}


def test_seen_share_and_longest_gap() -> None:
    recording = body(101)  # 1 s
    markers = recording.markers.copy()
    markers[10:20, 0] = np.nan
    markers[50:53, 0] = np.nan
    markers[:30, 1] = np.nan
    markers[90:, 2] = np.nan
    markers[:, 3] = np.nan
    markers[40, 4] = np.nan
    gaps = measure_gaps(replace(recording, markers=markers))
    assert [g.label for g in gaps] == list(recording.labels)
    assert [round(g.visible_share * 101) for g in gaps[:5]] == [88, 71, 90, 0, 100]
    assert [g.longest_gap for g in gaps[:5]] == pytest.approx([0.11, 0.30, 0.11, 1.0, 0.02])
