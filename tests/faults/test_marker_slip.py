"""Markers that leave their place for a while are named with their time."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from gaitcal.errors import Finding, Severity
from gaitcal.faults.study import check_study
from gaitcal.io.recording import Recording
from gaitcal.study.study import Study
from tests.faults.spoilt import moved, with_trial

Array = NDArray[np.float64]


def left(study: Study) -> list[Finding]:
    return [f for f in check_study(study) if f.topic == "left its place"]


def shifted(frames: slice, by: float) -> object:
    def change(x: Array) -> Array:
        x[frames] += [0.0, by, by]
        return x

    return change


@pytest.mark.parametrize("label", ["R.Heel", "V.Sacral"])
def test_a_marker_elsewhere_for_a_stretch(sound: Study, label: str) -> None:
    spoilt = with_trial(sound, "walk", moved(label, shifted(slice(70, 100), 0.05)))  # type: ignore[arg-type]
    found = left(spoilt)
    assert [f"'{label}'" in f.cause for f in found] == [True]
    time = spoilt.trials[1].recording.time
    assert f"{time[70]:.2f}" in found[0].found and found[0].where == "walk"


@pytest.mark.parametrize("label", ["R.Heel", "L.Thigh.Front"])
def test_a_marker_that_slips_and_stays(sound: Study, label: str) -> None:
    spoilt = with_trial(sound, "walk", moved(label, shifted(slice(90, None), 0.025)))  # type: ignore[arg-type]
    found = left(spoilt)
    assert [f"'{label}' slipped" in f.cause for f in found] == [True]
    assert f"{spoilt.trials[1].recording.time[90]:.2f}-" in found[0].found


def every(frames: int, seconds: float, by: float) -> Callable[[Recording], Recording]:
    """Each so-many-th frame, in which R.Heel goes up within so many seconds by so many metres, and stays."""

    def change(recording: Recording) -> Recording:
        x = recording.markers.copy()
        time = recording.time - recording.time[90]
        share = (time >= 0.0).astype(float) if seconds == 0.0 else np.clip(time / seconds, 0.0, 1.0)
        x[:, recording.labels.index("R.Heel"), 1] += by * share
        return replace(recording, time=recording.time[::frames], markers=x[::frames])

    return change


@pytest.mark.parametrize("frames", [1, 4])
def test_what_takes_a_while_is_no_slip_at_any_rate(sound: Study, frames: int) -> None:
    slow = left(with_trial(sound, "walk", every(frames, 0.15, 0.02)))
    assert not any("slipped" in f.cause for f in slow)
    at_once = left(with_trial(sound, "walk", every(frames, 0.0, 0.06)))
    assert any("'R.Heel' slipped" in f.cause for f in at_once)


def test_a_marker_that_cameras_lose_again_and_again_has_not_slipped(sound: Study) -> None:
    def rattling(x: Array) -> Array:
        for edge in (40, 48, 60):
            x[edge : edge + 3, 1] += 0.02
        x[90:, 1] += 0.02
        return x

    assert not any("slipped" in f.cause for f in left(with_trial(sound, "walk", moved("R.Heel", rattling))))


@pytest.mark.parametrize("made", ["held", "straight", "cubic"])
def test_a_path_that_software_made_up(sound: Study, made: str) -> None:
    def bridged(x: Array) -> Array:
        end = x[60] if made == "held" else x[110]
        around = [*range(55, 60), *range(111, 116)]
        x[60:111] = x[60] + np.linspace(0.0, 1.0, 51)[:, None] * (end - x[60])
        if made == "cubic":
            x[60:111] = CubicSpline(around, x[around])(np.arange(60, 111))
        return x

    label = "R.Heel" if made == "cubic" else "R.Shank.Front"
    found = left(with_trial(sound, "walk", moved(label, bridged)))
    assert len(found) == 1 and f"'{label}'" in found[0].cause
    assert "held or drawn as a straight or smooth line" in found[0].cause
    if made == "held":
        assert found[0].severity is Severity.ERROR


def test_skin_that_moves_smoothly_is_not_told(sound: Study) -> None:
    def skin(x: Array) -> Array:
        wave = 0.008 * np.sin(np.linspace(0.0, 9.0, len(x)))
        return x + wave[:, None] * [1.0, 0.5, -0.5]

    assert left(with_trial(sound, "walk", moved("R.Thigh.Front", skin))) == []
