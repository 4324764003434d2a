"""Ways to spoil the ground reactions of a walk: functions of one force plate and the words of the
table.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.signal import butter, sosfilt, sosfiltfilt
from scipy.spatial.transform import Rotation

from gaitcal.arrays import Array
from gaitcal.io.force_plate import LOADED_N, compute_centre_on_ground
from gaitcal.io.recording import ForcePlate
from scripts.validation.force_faults.faults import placed

BODY_N = 50.0
"""Vertical force that only a body makes."""


def middle_of(p: ForcePlate) -> Array:
    """(3,) m of the surface: of its corners, or of the centres of pressure while somebody stands on
    it.
    """
    if p.corners is not None:
        return np.asarray(p.corners.mean(axis=0))
    on = p.force[:, 1] > BODY_N
    return np.asarray(p.point[on].mean(axis=0)) if on.any() else np.asarray(p.point.mean(axis=0))


def _channels(p: ForcePlate, change: Callable[[Array], Array]) -> ForcePlate:
    """The six channels (ns, 6) about the middle of the plate changed, so that the centre of
    pressure moves too.
    """
    centre = middle_of(p)
    values = change(np.hstack([p.force, p.moment + np.cross(p.point - centre, p.force)]))
    wrench = np.hstack([values[:, :3], values[:, 3:] + np.cross(centre, values[:, :3])])
    loaded = np.abs(wrench[:, 1]) > LOADED_N
    point = np.tile(centre, (len(wrench), 1))
    point[loaded] = compute_centre_on_ground(wrench[loaded], float(centre[1]))
    return replace(
        p, force=wrench[:, :3], point=point, moment=wrench[:, 3:] - np.cross(point, wrench[:, :3])
    )


def gain(p: ForcePlate, factor: float) -> ForcePlate:
    """Force and moment times a factor: a wrong gain, or another unit of force."""
    return replace(p, force=factor * p.force, moment=factor * p.moment)


def axis_gain(p: ForcePlate, axis: int, factor: float) -> ForcePlate:
    """One axis of the force times a factor (-1: turned round; 0: dead), the centre of pressure
    kept.
    """
    return replace(p, force=p.force * np.where(np.arange(3) == axis, factor, 1.0))


def channel_signed(p: ForcePlate, axis: int) -> ForcePlate:
    """One of the six channels turned round, and the centre of pressure made from them."""
    return _channels(p, lambda c: c * np.where(np.arange(6) == axis, -1.0, 1.0))


def axes_exchanged(p: ForcePlate) -> ForcePlate:
    """Forward and sideways force exchanged."""
    return replace(p, force=p.force[:, [2, 1, 0]])


def free_moment(p: ForcePlate, factor: float) -> ForcePlate:
    """The free moment times a factor: another unit, or another sign."""
    return replace(p, moment=factor * p.moment)


def at_times(p: ForcePlate, time: Array) -> ForcePlate:
    """What the plate told at other times (ns,), as if at its own."""

    def values(told: Array) -> Array:
        return np.column_stack([np.interp(time, p.time, column) for column in told.T])

    return replace(p, force=values(p.force), point=values(p.point), moment=values(p.moment))


def late(p: ForcePlate, seconds: float) -> ForcePlate:
    """Forces that come later (or earlier) than the markers."""
    return at_times(p, p.time - seconds)


def other_clock(p: ForcePlate, factor: float) -> ForcePlate:
    """Forces whose clock runs `factor` times as fast, from the beginning of the trial on."""
    return at_times(p, p.time[0] + (p.time - p.time[0]) * factor)


def moved(p: ForcePlate, mm: tuple[float, float, float]) -> ForcePlate:
    """A plate that stands elsewhere than its corners say, along the laboratory's axes."""
    return placed(p, np.eye(3), np.zeros(3), 1e-3 * np.array(mm))


def turned(p: ForcePlate, degrees: float, axis: str = "y") -> ForcePlate:
    """A plate turned about its middle: `y` yaw, `x` and `z` tilt."""
    return placed(
        p, Rotation.from_euler(axis, degrees, degrees=True).as_matrix(), middle_of(p), np.zeros(3)
    )


def room_turned(p: ForcePlate, degrees: float, axis: str) -> ForcePlate:
    """A plate turned about the laboratory's origin."""
    return placed(
        p, Rotation.from_euler(axis, degrees, degrees=True).as_matrix(), np.zeros(3), np.zeros(3)
    )


def offset(p: ForcePlate, newtons: tuple[float, float, float]) -> ForcePlate:
    """A reading of the empty plate that was not taken off."""
    return _channels(p, lambda c: c + np.array([*newtons, 0.0, 0.0, 0.0]))


def drifting(p: ForcePlate, newtons: float) -> ForcePlate:
    """A vertical force that drifts by so much over the trial."""
    return _channels(p, lambda c: c + np.linspace(0, newtons, len(c))[:, None] * np.eye(6)[1])


def saturated(p: ForcePlate, share: float) -> ForcePlate:
    """An amplifier that ends at a share of the peak vertical force."""
    force = p.force.copy()
    force[:, 1] = np.minimum(force[:, 1], share * force[:, 1].max())
    return replace(p, force=force)


def low_passed(p: ForcePlate, hertz: float) -> ForcePlate:
    """Forces and moments filtered on reading."""
    filters = butter(2, hertz, fs=1.0 / float(np.median(np.diff(p.time))), output="sos")
    return _channels(p, lambda c: sosfiltfilt(filters, c, axis=0))


def filtered_forwards(p: ForcePlate, hertz: float) -> ForcePlate:
    """The same by a filter that runs forwards only, and so makes forces late."""
    filters = butter(2, hertz, fs=1.0 / float(np.median(np.diff(p.time))), output="sos")
    return _channels(p, lambda c: sosfilt(filters, c, axis=0))


def leant(p: ForcePlate, newtons: float) -> ForcePlate:
    """So much more on the feet, in proportion to their load: what hands carry, or take away."""
    more = newtons * p.force[:, 1] / max(float(p.force[:, 1].max()), BODY_N)
    return replace(p, force=p.force + more[:, None] * [0.0, 1.0, 0.0])


def points_scaled(p: ForcePlate, factor: float) -> ForcePlate:
    """Centres of pressure in another unit than metres."""
    return replace(p, point=factor * p.point)


def points_held(p: ForcePlate) -> ForcePlate:
    """Every centre of pressure in the middle of the plate."""
    return replace(p, point=np.tile(middle_of(p), (len(p.time), 1)))


def cut(p: ForcePlate, part: tuple[float, float]) -> ForcePlate:
    """A part of the contact, by shares of it, without any force."""
    on = np.flatnonzero(p.force[:, 1] > BODY_N)
    if len(on) == 0:
        return p
    first, length = on[0], on[-1] - on[0]
    kept = np.ones((len(p.force), 1))
    kept[int(first + part[0] * length) : int(first + part[1] * length)] = 0.0
    return replace(p, force=kept * p.force, moment=kept * p.moment)


def first_contact(p: ForcePlate) -> float | None:
    """When somebody steps on it, s."""
    on = np.flatnonzero(p.force[:, 1] > BODY_N)
    return float(p.time[on[0]]) if len(on) else None
