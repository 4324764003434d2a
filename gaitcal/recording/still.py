"""The stillest stretch of a static trial, which may hold walking before and after.

The speed of a stretch is the RMS, over its frames and markers, of displacement across LAG_S divided by LAG_S. The lag
keeps measurement noise out: 0.2 mm of it would read as 28 mm/s from one 100 Hz frame to the next, and so as 3 mm/s.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from gaitcal.errors import InputError
from gaitcal.recording.recording import Recording, seen_mask

LAG_S = 0.1
STILL_M_S = 0.05
"""Quiet standing sways at up to 0.02 m/s at the height of the head; the slowest walk moves a body at over 0.2 m/s. In a
window of 0.5 s at this speed a marker strays by 12 mm from its mean, at worst."""
DURATION_S = 0.5


@dataclass(frozen=True)
class StillWindow:
    """Where a subject stood still."""

    frames: slice
    """Frames of the recording."""
    speed: float
    """m/s, RMS over frames and markers; 0 for a single frame, which has none."""
    start: float
    """s."""
    stop: float
    """s, time of the last frame."""


def still_window(recording: Recording, labels: Iterable[str], duration: float = DURATION_S) -> StillWindow:
    """The window of `duration` s in which most of the markers `labels` are seen, and of those the stillest.

    A recording shorter than `duration` is taken whole. InputError where none of the labels is ever seen, or where no
    window is slower than STILL_M_S; it tells the smallest speed found.
    """
    wanted = list(dict.fromkeys(labels))
    places = [recording.labels.index(label) for label in wanted if label in recording.labels]
    seen = seen_mask(recording.markers[:, places])
    if not places or not seen.any():
        some = ", ".join(wanted[:6]) + ("..." if len(wanted) > 6 else "")
        raise InputError(f"none of the markers {some} is seen", source=recording.source, field="static trial")
    frames = len(recording.time)
    if frames == 1:
        return StillWindow(slice(0, 1), 0.0, float(recording.time[0]), float(recording.time[0]))
    length = min(frames, max(2, round(duration * recording.rate) + 1))
    speeds, coverage = _windows(recording, places, length)
    still = speeds <= STILL_M_S
    if not still.any():
        reason = f"the stillest {length / recording.rate:.2g} s move at {np.nanmin(speeds):.3g} m/s RMS"
        if np.isnan(speeds).all():
            reason = "no marker is seen twice within a window"
        raise InputError(
            f"no still window: {reason}; at most {STILL_M_S:g} m/s is allowed",
            source=recording.source,
            field="static trial",
        )
    most_seen = still & (coverage == coverage[still].max())
    start = int(np.argmin(np.where(most_seen, speeds, np.inf)))
    window = slice(start, start + length)
    times = recording.time[window]
    return StillWindow(window, float(speeds[start]), float(times[0]), float(times[-1]))


def _windows(recording: Recording, places: list[int], length: int) -> tuple[np.ndarray, np.ndarray]:
    """For each window of `length` frames: RMS speed (NaN: unknown), and how many of the markers are seen in it."""
    lag = min(length - 1, max(1, round(LAG_S * recording.rate)))
    markers = recording.markers[:, places]
    steps = (recording.time[lag:] - recording.time[:-lag])[:, None]
    squares = np.sum((markers[lag:] - markers[:-lag]) ** 2, axis=2) / steps**2
    known = np.isfinite(squares)
    per_window = length - lag
    total = _moving_sum(np.where(known, squares, 0.0).sum(axis=1), per_window)
    count = _moving_sum(known.sum(axis=1).astype(np.float64), per_window)
    with np.errstate(invalid="ignore", divide="ignore"):
        speeds = np.sqrt(np.maximum(total, 0.0) / count)
    speeds[count < 0.5] = np.nan
    seen = seen_mask(markers).astype(np.float64)
    coverage = sum(_moving_sum(column, length) > 0.5 for column in seen.T)
    return speeds, np.asarray(coverage)


def _moving_sum(values: np.ndarray, length: int) -> np.ndarray:
    """Sums over `length` successive values, one for each start."""
    cumulative = np.concatenate([[0.0], np.cumsum(values)])
    return np.asarray(cumulative[length:] - cumulative[:-length])
