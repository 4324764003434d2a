"""Markers that are displaced for a while are named with their time."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from gaitcal.errors import Code, Finding, Severity
from gaitcal.io.recording import Recording
from gaitcal.study.study import Study
from tests.messages import check_finding
from tests.quality.spoilt import Array, Change, findings, moved, put, recording_of, with_trial


def find_displaced(study: Study, change: Change, label: str = "R.Heel") -> list[Finding]:
    """Find displacements of this marker, and no other, in a walk."""
    found = findings(with_trial(study, "walk", change), "displaced markers")
    assert all(f"'{label}'" in f.cause and f.where == "walk" for f in found) and len(found) <= 1
    return found


def shifted(label: str, frames: slice, by: float) -> Change:
    return moved(label, lambda x: put(x, frames, x[frames] + [0.0, by, by]))


@pytest.mark.parametrize(
    ("label", "frames", "by", "words"),
    [
        ("R.Heel", slice(70, 100), 0.05, ""),
        ("V.Sacral", slice(70, 100), 0.05, ""),
        ("R.Heel", slice(90, None), 0.025, "slipped"),
        ("L.Thigh.Front", slice(90, None), 0.025, "slipped"),
    ],
)
def test_marker_displaced_for_a_while_or_permanently(
    sound: Study, label: str, frames: slice, by: float, words: str
) -> None:
    (found,) = find_displaced(sound, shifted(label, frames, by), label)
    assert words in found.cause and f"{recording_of(sound).time[frames.start]:.2f}-" in found.found


def move_every(frames: int, seconds: float, by: float) -> Change:
    """Move R.Heel up in every n-th frame within some seconds by some metres, permanently."""

    def change(recording: Recording) -> Recording:
        x = recording.markers.copy()
        time = recording.time - recording.time[90]
        share = (time >= 0.0).astype(float) if seconds == 0.0 else np.clip(time / seconds, 0.0, 1.0)
        x[:, recording.labels.index("R.Heel"), 1] += by * share
        return replace(recording, time=recording.time[::frames], markers=x[::frames])

    return change


@pytest.mark.parametrize("frames", [1, 4])
def test_slow_displacement_is_no_slip_at_any_rate(sound: Study, frames: int) -> None:
    assert not any(
        "slipped" in f.cause for f in find_displaced(sound, move_every(frames, 0.15, 0.02))
    )
    assert any("slipped" in f.cause for f in find_displaced(sound, move_every(frames, 0.0, 0.06)))


def test_intermittent_marker_has_not_slipped(sound: Study) -> None:
    def rattling(x: Array) -> Array:
        for edge in (40, 48, 60):
            x[edge : edge + 3, 1] += 0.02
        x[90:, 1] += 0.02
        return x

    assert not any("slipped" in f.cause for f in find_displaced(sound, moved("R.Heel", rattling)))


@pytest.mark.parametrize("made", ["held", "straight", "cubic"])
def test_interpolated_path_is_reported(sound: Study, made: str) -> None:
    def bridged(x: Array) -> Array:
        end = x[60] if made == "held" else x[110]
        around = [*range(55, 60), *range(111, 116)]
        x[60:111] = x[60] + np.linspace(0.0, 1.0, 51)[:, None] * (end - x[60])
        if made == "cubic":
            x[60:111] = CubicSpline(around, x[around])(np.arange(60, 111))
        return x

    label = "R.Heel" if made == "cubic" else "R.Shank.Front"
    (found,) = find_displaced(sound, moved(label, bridged), label)
    check_finding(found, Code.MARKER_LEFT_PLACE)
    assert made != "held" or found.severity is Severity.ERROR


def test_smooth_soft_tissue_is_not_reported(sound: Study) -> None:
    def skin(x: Array) -> Array:
        wave = 0.008 * np.sin(np.linspace(0.0, 9.0, len(x)))
        return x + wave[:, None] * [1.0, 0.5, -0.5]

    assert find_displaced(sound, moved("R.Thigh.Front", skin)) == []
