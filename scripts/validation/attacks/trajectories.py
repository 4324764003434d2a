"""Attacks on whole trials: trajectories that are not what the cameras saw (stuck, filled, smoothed, late, noisy), ways
to stand wrong in a static trial, and what goes wrong with all markers of a file at once: unit, axes, clock.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfiltfilt
from scipy.spatial.transform import Rotation

from gaitcal import MarkerSet, Recording, Study
from gaitcal.arrays import Array
from scripts.validation.attacks.attack import StudyChange, loaded, with_recording
from scripts.validation.attacks.markers import MM, SEED, WHOLE, Change, Part, body_axes, columns, frames, put


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


HIP_BELOW_ASIS = np.array([-0.05, -0.09, 0.0])
"""m forward, up, right: roughly the middle of the hips from the middle of both ASIS."""


def knees_bent(degrees: float, sides: str = "rl") -> Change:
    """Knees flexed by so many degrees over feet that stay flat: half of it in the hip, half in the ankle."""
    return _posed(lambda share: np.full(1, degrees), sides)


def knees_bending(degrees: float, hertz: float = 0.5) -> Change:
    """The person goes down and up while the static trial is recorded."""
    return _posed(lambda time: degrees * 0.5 * (1 - np.cos(2 * np.pi * hertz * time)), "rl")


def _posed(angle: Callable[[Array], Array], sides: str) -> Change:
    def spoil(recording: Recording, markers: MarkerSet) -> Recording:
        out = recording.markers.copy()
        known = np.flatnonzero(np.isfinite(recording.markers[:, _asis(recording, markers)]).all(axis=(1, 2)))
        axes = body_axes(recording, markers, int(known[0]))
        asis = np.nanmean(recording.markers[:, _asis(recording, markers)], axis=1)
        half = 0.5 * np.broadcast_to(angle(recording.time - recording.time[0]), len(recording.time))
        forward = Rotation.from_rotvec(np.deg2rad(half)[:, None] * axes[:, 2]).as_matrix()
        hip = asis + axes @ HIP_BELOW_ASIS
        for side in sides:
            knee = np.nanmean(recording.markers[:, columns(recording, markers, f"knee_lat_{side}")], axis=1)
            ankle = np.nanmean(recording.markers[:, columns(recording, markers, f"ankle_lat_{side}")], axis=1)
            knee_now = hip + _turn(forward, knee - hip)
            back = np.swapaxes(forward, 1, 2)
            ankle_now = knee_now + _turn(back, ankle - knee)
            for name, old, new, turn in (
                ("thigh", knee, knee_now, forward),
                ("shank", knee, knee_now, back),
                ("foot", ankle, ankle_now, np.broadcast_to(np.eye(3), forward.shape)),
            ):
                at = _with_landmarks(recording, markers, name, side)
                lever = recording.markers[:, at] - old[:, None]
                out[:, at] = new[:, None] + np.einsum("fij,fmj->fmi", turn, lever)
        return replace(recording, markers=out)

    return spoil


def _with_landmarks(recording: Recording, markers: MarkerSet, segment: str, side: str) -> list[int]:
    """Columns of a segment's markers and of the landmarks at its lower end."""
    ends = {"thigh": ("knee_lat", "knee_med"), "shank": ("ankle_lat", "ankle_med")}.get(segment, ())
    known = [f"{end}_{side}" for end in ends if f"{end}_{side}" in markers.landmarks]
    found = [c for key in (f"{segment}_{side}", *known) for c in columns(recording, markers, key)]
    return list(dict.fromkeys(found))


def _asis(recording: Recording, markers: MarkerSet) -> list[int]:
    return [*columns(recording, markers, "asis_r"), *columns(recording, markers, "asis_l")]


def _turn(rotations: Array, vectors: Array) -> Array:
    out: Array = np.einsum("fij,fj->fi", rotations, vectors)
    return out


def static_of(base: str, factor: float = 1.0) -> StudyChange:
    """The static trial of another person who wears the same marker set."""

    def change(study: Study) -> Study:
        other = loaded(base).static.recording
        return with_recording(study, "static", replace(other, markers=factor * other.markers))

    return change


def scaled(factor: float) -> Change:
    """All positions times a factor: another unit, or a person of another size."""
    return lambda recording, markers: replace(recording, markers=factor * recording.markers)


def axes(order: tuple[int, int, int], signs: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> Change:
    """Axes of the markers in another order, or turned round."""
    return lambda recording, markers: replace(recording, markers=recording.markers[:, :, order] * np.array(signs))


def tilted(degrees: float, axis: str = "x") -> Change:
    """The room of the markers turned against that of the plates."""
    turn = Rotation.from_euler(axis, degrees, degrees=True).as_matrix()
    return lambda recording, markers: replace(recording, markers=recording.markers @ turn.T)


def other_rate(factor: float) -> Change:
    """A header that tells `factor` times the true frame rate; the forces keep their own clock."""
    return lambda recording, markers: replace(recording, time=recording.time / factor)


def frames_dropped(part: Part) -> Change:
    """Frames that the file lacks, the rest moved up as if there had been no gap."""

    def spoil(recording: Recording, markers: MarkerSet) -> Recording:
        gone = np.arange(len(recording.time))[frames(recording, part)]
        kept = np.delete(recording.markers, gone, axis=0)
        return replace(recording, time=recording.time[: len(kept)], markers=kept)

    return spoil


def frame_lost(share: float, count: int = 1) -> Change:
    """So many frames are missing at a share of the trial, and the times are numbered on as if nothing were."""

    def spoil(recording: Recording, markers: MarkerSet) -> Recording:
        at = round(share * len(recording.time))
        kept = np.delete(recording.markers, np.arange(at, at + count), axis=0)
        return replace(recording, time=recording.time[: len(kept)], markers=kept)

    return spoil


def frame_twice(share: float) -> Change:
    """One frame stands in the file twice, and the last one is left out."""

    def spoil(recording: Recording, markers: MarkerSet) -> Recording:
        at = round(share * len(recording.time))
        twice = np.insert(recording.markers, at, recording.markers[at], axis=0)
        return replace(recording, markers=twice[:-1])

    return spoil


def backwards(recording: Recording, markers: MarkerSet) -> Recording:
    """Played from the end to the beginning."""
    return replace(recording, markers=recording.markers[::-1].copy())


def hardly_moving(share: float) -> Change:
    """Every marker stays near its mean."""

    def spoil(recording: Recording, markers: MarkerSet) -> Recording:
        mean = np.nanmean(recording.markers, axis=0)
        return replace(recording, markers=mean + share * (recording.markers - mean))

    return spoil


def cropped(part: Part) -> Change:
    """Only a part of the frames."""

    def spoil(recording: Recording, markers: MarkerSet) -> Recording:
        where = frames(recording, part)
        return replace(recording, time=recording.time[where], markers=recording.markers[where])

    return spoil
