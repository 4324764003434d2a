"""Residuals with structure are named by marker, kind and time; smooth ones are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from gaitcal.faults.after_fit import TrackedMarkers, marker_findings
from gaitcal.findings import Severity

Array = NDArray[np.float64]

LABELS = ("R.Heel", "R.Toe", "R.Mid", "R.Elbow", "R.Wrist")
SEGMENTS = ("foot_r", "foot_r", "foot_r", "upper_arm_r", "forearm_hand_r")
FRAMES = 200


def tracked(seed: int = 0) -> TrackedMarkers:
    """Markers on their ways with 8 mm of slow skin, 80 mm on the arm, all as a fit leaves them."""
    rng = np.random.default_rng(seed)
    time = np.arange(FRAMES) / 100.0
    model = np.cumsum(rng.normal(size=(1, 5, 3)), axis=0) + 1.3 * time[:, None, None] * [1.0, 0.0, 0.0]
    model = model + 0.2 * np.sin(5.0 * time)[:, None, None] * rng.normal(size=(5, 3))
    waves = np.sin(rng.uniform(2, 9, (5, 3)) * time[:, None, None] + rng.uniform(0, 6, (5, 3)))
    size = np.array([8.0, 8.0, 8.0, 20.0, 20.0])[:, None] * 1e-3
    off = np.array([0.0, 0.0, 0.0, 0.06, 0.08])[:, None] * [1.0, 0.0, 0.0]
    weight = np.array([1.0, 1.0, 1.0, 0.02, 0.02])
    measured = model + size * waves + off
    return TrackedMarkers(
        name="walk", time=time, labels=LABELS, segments=SEGMENTS, weight=weight, measured=measured, model=model
    )


def changed(markers: TrackedMarkers, k: int, frames: slice, path: Array) -> TrackedMarkers:
    measured = markers.measured.copy()
    measured[frames, k] = path
    return replace(markers, measured=measured)


@pytest.mark.parametrize("seed", range(6))
def test_slow_skin_and_a_crude_arm_are_not_told(seed: int) -> None:
    assert marker_findings(tracked(seed)) == ()


@pytest.mark.parametrize("k", [0, 2, 3, 4])
@pytest.mark.parametrize("seed", range(3))
def test_a_marker_elsewhere_is_named_with_its_time(seed: int, k: int) -> None:
    sound = tracked(seed)
    start = int(np.random.default_rng(seed).integers(20, 150))
    frames = slice(start, start + 30)
    (found,) = marker_findings(changed(sound, k, frames, sound.measured[frames, k] + [0.0, 0.15, 0.1]))
    assert found.cause == f"marker '{LABELS[k]}' is elsewhere for a while"
    assert f"({sound.time[start]:.2f}-" in found.found
    assert found.severity is (Severity.ERROR if k < 3 else Severity.WARNING)
    assert found.leg == ("r" if k < 3 else "")


def test_a_held_marker_and_a_straight_line() -> None:
    sound = tracked(1)
    frames = slice(60, 100)
    for end in (60, 100):
        line = sound.measured[60, 1] + np.linspace(0, 1, 40)[:, None] * (sound.measured[end, 1] - sound.measured[60, 1])
        line = line + [0.0, 0.06, 0.0]
        (found,) = marker_findings(changed(sound, 1, frames, line))
        assert found.cause == "the path of marker 'R.Toe' was held or drawn as a straight line over a gap"


def test_two_markers_that_swap_are_told_once() -> None:
    sound = tracked(2)
    frames = slice(80, 121)
    swapped = changed(sound, 0, frames, sound.measured[frames, 4])
    swapped = changed(swapped, 4, frames, sound.measured[frames, 0])
    (found,) = marker_findings(swapped)
    assert "'R.Heel'" in found.cause and "'R.Wrist'" in found.cause and "each other's label" in found.cause


def test_a_marker_far_off_throughout() -> None:
    sound = tracked(3)
    (found,) = marker_findings(changed(sound, 2, slice(None), sound.measured[:, 2] + [0.0, 0.0, 0.09]))
    assert found.cause == "marker 'R.Mid' is not where the static trial has it on foot_r"
    assert found.severity is Severity.ERROR and "throughout 0.00-1.99 s" in found.found


def test_what_has_no_weight_is_left_out() -> None:
    sound = tracked(4)
    spoilt = changed(sound, 0, slice(50, 90), sound.measured[50:90, 0] + [0.0, 0.15, 0.0])
    assert len(marker_findings(spoilt)) == 1
    assert marker_findings(replace(spoilt, weight=sound.weight * [0.0, 1.0, 1.0, 1.0, 1.0])) == ()


def test_gaps_are_no_jumps() -> None:
    sound = tracked(5)
    assert marker_findings(changed(sound, 0, slice(50, 90), np.full((40, 3), np.nan))) == ()
