"""Trajectories that are not what the cameras saw: stuck, filled, smoothed, late, noisy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfiltfilt

from gaitcal import MarkerSet, Recording
from gaitcal.arrays import Array
from scripts.validation.attacks.markers import MM, SEED, WHOLE, Change, Part, columns, frames, put


def of_marker(key: str, change: Callable[[Array, Array], Array], part: Part = WHOLE) -> Change:
    """Trajectories (nf, nm, 3) of the markers of a key changed, given time (nf,) too."""

    def spoil(recording: Recording, markers: MarkerSet) -> Recording:
        at = columns(recording, markers, key)
        return put(recording, at, part, change(recording.markers[:, at].copy(), recording.time))

    return spoil


def frozen(key: str, part: Part) -> Change:
    """A marker that stays where it was at the beginning of the part."""

    def spoil(recording: Recording, markers: MarkerSet) -> Recording:
        start = frames(recording, part).start
        return of_marker(key, lambda x, t: np.broadcast_to(x[start], x.shape), part)(recording, markers)

    return spoil


def interpolated(key: str, part: Part) -> Change:
    """A gap filled by a straight line."""

    def spoil(recording: Recording, markers: MarkerSet) -> Recording:
        where = frames(recording, part)
        share = np.clip((np.arange(len(recording.time)) - where.start) / (where.stop - where.start), 0, 1)
        stop = min(where.stop, len(recording.time) - 1)
        return of_marker(key, lambda x, t: x[where.start] + share[:, None, None] * (x[stop] - x[where.start]), part)(
            recording, markers
        )

    return spoil


def spline_filled(key: str, part: Part) -> Change:
    """A gap filled by a cubic spline through five frames on either side."""

    def spoil(recording: Recording, markers: MarkerSet) -> Recording:
        where = frames(recording, part)
        around = [
            *range(max(where.start - 5, 0), where.start),
            *range(where.stop, min(where.stop + 5, len(recording.time))),
        ]
        return of_marker(key, lambda x, t: CubicSpline(t[around], x[around])(t), part)(recording, markers)

    return spoil


def low_passed(key: str, hertz: float) -> Change:
    """Trajectories smoothed by a Butterworth filter, there and back."""

    def spoil(recording: Recording, markers: MarkerSet) -> Recording:
        filters = butter(2, hertz, fs=recording.rate, output="sos")
        return of_marker(key, lambda x, t: _filled(x, lambda y: sosfiltfilt(filters, y, axis=0)))(recording, markers)

    return spoil


def _filled(values: Array, change: Callable[[Array], Array]) -> Array:
    """`change` of trajectories whose gaps are bridged, with the gaps put back."""
    flat = values.reshape(len(values), -1).copy()
    gaps = ~np.isfinite(flat)
    frame = np.arange(len(flat))
    for column, gap in zip(flat.T, gaps.T, strict=True):
        if gap.any() and not gap.all():
            column[gap] = np.interp(frame[gap], frame[~gap], column[~gap])
    out = change(flat)
    out[gaps] = np.nan
    return out.reshape(values.shape)


def delayed(key: str, seconds: float) -> Change:
    """Markers that come later than the others."""

    def late(x: Array, t: Array) -> Array:
        return _filled(x, lambda y: np.column_stack([np.interp(t - seconds, t, column) for column in y.T]))

    return of_marker(key, late)


def drifting(key: str, mm: tuple[float, float, float]) -> Change:
    """A marker that creeps away over the whole trial, along the laboratory's axes."""
    return of_marker(key, lambda x, t: x + MM * np.linspace(0, 1, len(t))[:, None, None] * np.array(mm))


def lost(key: str, part: Part) -> Change:
    """Markers that are not seen in a part."""
    return of_marker(key, lambda x, t: np.full_like(x, np.nan), part)


def ghost(key: str, mm: tuple[float, float, float], part: Part) -> Change:
    """A gap filled with a reflection elsewhere, standing still in the room."""

    def spoil(recording: Recording, markers: MarkerSet) -> Recording:
        start = frames(recording, part).start
        return of_marker(key, lambda x, t: np.broadcast_to(x[start] + MM * np.array(mm), x.shape), part)(
            recording, markers
        )

    return spoil


def noisy(mm: float, key: str | None = None) -> Change:
    """White noise on every coordinate of all markers, or those of a key."""

    def spoil(recording: Recording, markers: MarkerSet) -> Recording:
        noise = MM * mm * np.random.default_rng(SEED).normal(size=recording.markers.shape)
        if key is None:
            return replace(recording, markers=recording.markers + noise)
        at = columns(recording, markers, key)
        return put(recording, at, WHOLE, (recording.markers + noise)[:, at])

    return spoil
