"""Seams of a recording: frames missing or duplicated, parts joined, and similar motions."""

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from gaitcal.arrays import Array
from gaitcal.errors import Code, Severity
from gaitcal.io.formats import read_recording
from gaitcal.io.recording import Recording
from gaitcal.quality.sampling import HALF_WINDOW, find_seams
from gaitcal.synthetic.synthetic_motion import simulate_gait
from tests.quality.spoilt import findings, sound_study, with_trial
from tests.synthetic_studies import made_recording

NEAR = 0.3
"""Frames by which the number of lost ones may be reported wrong: a foot's path bends within the
windows.
"""
REAL = (
    "pig_c3d/gait.c3d",
    "children/HC002D/turn.c3d",
    "subject01/subject01_walk1.trc",
    "uf3/gait.trc",
)
CAMERAS_M = 0.0005


@lru_cache(maxsize=1)
def walk() -> Array:
    """(nf, nm, 3) m, with the noise of cameras."""
    markers = made_recording(simulate_gait()).markers
    return np.asarray(markers + np.random.default_rng(5).normal(0.0, CAMERAS_M, markers.shape))


def cut(x: Array, at: int, count: int) -> Array:
    """Remove some frames from `at` on; -1: duplicate that frame."""
    return (
        np.insert(x, at, x[at], axis=0)
        if count < 0
        else np.delete(x, range(at, at + count), axis=0)
    )


def places(x: Array) -> range:
    """Frames with a whole window on either side."""
    return range(HALF_WINDOW + 1, len(x) - HALF_WINDOW - 3, 7)


@pytest.mark.parametrize("count", [1, 2, -1])
def test_a_frame_lost_or_doubled_is_found_wherever_it_is(count: int) -> None:
    x = walk()
    assert find_seams(x) == []
    for at in places(x):
        [found] = find_seams(cut(x, at, count))
        assert abs(found.frame - (at if count < 0 else at - 1)) <= 1
        assert found.lost == pytest.approx(count, abs=NEAR)


@pytest.mark.parametrize("name", REAL)
def test_real_walks_have_no_seam_until_a_frame_is_cut_out(name: str, data_dir: Path) -> None:
    x = read_recording(data_dir / name).markers
    assert find_seams(x) == []
    missed = [at for at in places(x) for count in (1, -1) if not find_seams(cut(x, at, count))]
    assert missed == []


def test_parts_joined_sideways_are_a_seam() -> None:
    x = walk().copy()
    x[100:] += [0.0, 0.0, 0.3]
    assert [one.frame for one in find_seams(x)] == [99]


def test_sudden_stop_is_no_seam() -> None:
    """As in landing: velocities change between two frames, positions do not."""
    time = np.arange(60) / 100.0
    falling = np.where(time < 0.3, 2.0 * (0.3 - time), 0.0)
    x = np.random.default_rng(6).uniform(0.0, 1.0, (1, 20, 3)) + falling[:, None, None] * [
        0.0,
        1.0,
        0.0,
    ]
    assert find_seams(x) == []


def test_few_markers_or_a_body_at_rest_have_no_seam() -> None:
    x = walk()
    still = x[:1] + np.random.default_rng(7).normal(0.0, CAMERAS_M, x.shape)
    assert find_seams(cut(x[:, :5], 80, 1)) == []
    assert find_seams(cut(still, 80, 1)) == []


@pytest.mark.parametrize(
    ("count", "words"), [(1, "missing"), (-1, "duplicated")], ids=["lost", "twice"]
)
def test_seam_is_a_warning_in_a_walk_and_a_note_in_a_functional_trial(
    count: int, words: str
) -> None:
    def spoil(recording: Recording) -> Recording:
        markers = cut(recording.markers, 100, count)[: len(recording.time)]
        return replace(recording, time=recording.time[: len(markers)], markers=markers)

    [found] = findings(with_trial(sound_study(), "walk", spoil), code=Code.SEAM)
    assert found.severity is Severity.WARNING and words in found.cause
    assert "0.49 s" in found.found or "0.50 s" in found.found
    noted = findings(with_trial(sound_study(), "knee_r", spoil), code=Code.SEAM)
    assert all(f.severity is Severity.INFO for f in noted)
