"""Ways to stand wrong in a static trial."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from gaitcal import MarkerSet, Recording, Study
from gaitcal.arrays import Array
from scripts.validation.attacks.attack import StudyChange
from scripts.validation.attacks.bases import loaded, with_recording
from scripts.validation.attacks.markers import Change, columns
from scripts.validation.attacks.placement import body_axes

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
