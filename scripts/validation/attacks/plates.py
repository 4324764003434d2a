"""Ways to spoil the ground reactions of a walk."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TypeAlias

import numpy as np
from scipy.signal import butter, sosfiltfilt
from scipy.spatial.transform import Rotation

from gaitcal import Recording, Study
from gaitcal.arrays import Array
from gaitcal.io.force_plate import LOADED_N, centre_on_ground
from gaitcal.io.recording import ForcePlate
from scripts.validation.attacks.attack import WALK, StudyChange, loaded, with_recording
from scripts.validation.attacks.markers import MM

PlateChange: TypeAlias = Callable[[ForcePlate], ForcePlate]

BODY_N = 50.0
"""Vertical force that only a body makes."""


def walk_of(study: Study) -> Recording:
    """The recording of the walk."""
    return next(trial.recording for trial in study.trials if trial.name == WALK)


def plates(change: PlateChange, number: int | None = None) -> StudyChange:
    """Every plate of the walk changed, or one of them, counted from 1."""

    def spoil(study: Study) -> Study:
        walk = walk_of(study)
        after = tuple(change(p) if number in (None, k) else p for k, p in enumerate(walk.plates, start=1))
        return with_recording(study, WALK, replace(walk, plates=after))

    return spoil


def force(change: Callable[[Array, ForcePlate], Array]) -> PlateChange:
    """The force changed, its point and the free moment kept."""
    return lambda p: replace(p, force=change(p.force.copy(), p))


def channels(change: Callable[[Array], Array]) -> PlateChange:
    """The six channels (ns, 6) about the middle of the plate changed, so that the centre of pressure moves too."""

    def spoil(p: ForcePlate) -> ForcePlate:
        centre = _middle(p)
        moment = p.moment + np.cross(p.point - centre, p.force)
        values = change(np.hstack([p.force, moment]))
        wrench = np.hstack([values[:, :3], values[:, 3:] + np.cross(centre, values[:, :3])])
        return _from_wrench(p, wrench)

    return spoil


def _middle(p: ForcePlate) -> Array:
    if p.corners is not None:
        return np.asarray(p.corners.mean(axis=0))
    on = p.force[:, 1] > BODY_N
    return np.asarray(p.point[on].mean(axis=0)) if on.any() else np.asarray(p.point.mean(axis=0))


def _from_wrench(p: ForcePlate, wrench: Array) -> ForcePlate:
    loaded_ = np.abs(wrench[:, 1]) > LOADED_N
    point = np.tile(_middle(p), (len(wrench), 1))
    point[loaded_] = centre_on_ground(wrench[loaded_], float(_middle(p)[1]))
    moment = wrench[:, 3:] - np.cross(point, wrench[:, :3])
    return replace(p, force=wrench[:, :3], point=point, moment=moment)


def signed(axis: int) -> PlateChange:
    """One axis of the force turned round, the centre of pressure kept."""
    signs = np.where(np.arange(3) == axis, -1.0, 1.0)
    return force(lambda f, p: f * signs)


def channel_signed(axis: int) -> PlateChange:
    """One of the six channels turned round, and the centre of pressure made from them."""
    return channels(lambda c: c * np.where(np.arange(6) == axis, -1.0, 1.0))


def gain(factor: float) -> PlateChange:
    """Force and moment times a factor: a wrong gain, or another unit of force."""
    return lambda p: replace(p, force=factor * p.force, moment=factor * p.moment)


def axis_gain(axis: int, factor: float) -> PlateChange:
    """One axis of the force times a factor, the centre of pressure kept."""
    return force(lambda f, p: f * np.where(np.arange(3) == axis, factor, 1.0))


def axes_exchanged(p: ForcePlate) -> ForcePlate:
    """Forward and sideways force exchanged."""
    return replace(p, force=p.force[:, [2, 1, 0]])


def free_moment(factor: float) -> PlateChange:
    """The free moment times a factor: another unit, or another sign."""
    return lambda p: replace(p, moment=factor * p.moment)


def _at(p: ForcePlate, time: Array) -> ForcePlate:
    """What the plate told at other times (ns,), as if at its own."""

    def values(told: Array) -> Array:
        return np.column_stack([np.interp(time, p.time, column) for column in told.T])

    return replace(p, force=values(p.force), point=values(p.point), moment=values(p.moment))


def late(seconds: float) -> PlateChange:
    """Forces that come later (or earlier) than the markers."""
    return lambda p: _at(p, p.time - seconds)


def other_clock(factor: float) -> PlateChange:
    """Forces whose clock runs `factor` times as fast, from the beginning of the trial on."""
    return lambda p: _at(p, p.time[0] + (p.time - p.time[0]) * factor)


def moved(mm: tuple[float, float, float]) -> PlateChange:
    """A plate that stands elsewhere than its corners say, along the laboratory's axes."""
    by = MM * np.array(mm)
    return lambda p: replace(p, point=p.point + by, corners=None if p.corners is None else p.corners + by)


def _turned(p: ForcePlate, turn: Array, about: Array) -> ForcePlate:
    corners = None if p.corners is None else (p.corners - about) @ turn.T + about
    point = (p.point - about) @ turn.T + about
    return replace(p, force=p.force @ turn.T, moment=p.moment @ turn.T, point=point, corners=corners)


def turned(degrees: float, axis: str = "y") -> PlateChange:
    """A plate turned about its middle: `y` yaw, `x` and `z` tilt."""
    turn = Rotation.from_euler(axis, degrees, degrees=True).as_matrix()
    return lambda p: _turned(p, turn, _middle(p))


def room_turned(degrees: float, axis: str = "x") -> StudyChange:
    """All plates turned together about the laboratory's origin."""
    turn = Rotation.from_euler(axis, degrees, degrees=True).as_matrix()
    return plates(lambda p: _turned(p, turn, np.zeros(3)))


def cables_exchanged(study: Study) -> Study:
    """The signals of the first plate come from where the second stands, and the other way round."""
    walk = walk_of(study)
    one, two = walk.plates[:2]
    a, b = _middle(one), _middle(two)

    def swapped(here: ForcePlate, there: ForcePlate, by: Array) -> ForcePlate:
        return replace(here, time=there.time, force=there.force, point=there.point + by, moment=there.moment)

    plates_ = (swapped(one, two, a - b), swapped(two, one, b - a), *walk.plates[2:])
    return with_recording(study, WALK, replace(walk, plates=plates_))


def points_exchanged(study: Study) -> Study:
    """Each force at the centre of pressure of the other plate."""
    walk = walk_of(study)
    one, two = walk.plates[:2]
    plates_ = (replace(one, point=two.point), replace(two, point=one.point), *walk.plates[2:])
    return with_recording(study, WALK, replace(walk, plates=plates_))


def offset(newtons: tuple[float, float, float]) -> PlateChange:
    """A reading of the empty plate that was not taken off."""
    return channels(lambda c: c + np.array([*newtons, 0.0, 0.0, 0.0]))


def drifting(newtons: float) -> PlateChange:
    """A vertical force that drifts by so much over the trial."""
    return channels(lambda c: c + np.linspace(0, newtons, len(c))[:, None] * np.eye(6)[1])


def saturated(share: float) -> PlateChange:
    """An amplifier that ends at a share of the peak vertical force."""

    def clip(f: Array, p: ForcePlate) -> Array:
        f[:, 1] = np.minimum(f[:, 1], share * f[:, 1].max())
        return f

    return force(clip)


def low_passed(hertz: float) -> PlateChange:
    """Forces and moments filtered on reading."""

    def smooth(p: ForcePlate) -> ForcePlate:
        filters = butter(2, hertz, fs=1.0 / float(np.median(np.diff(p.time))), output="sos")
        return channels(lambda c: sosfiltfilt(filters, c, axis=0))(p)

    return smooth


def points_scaled(factor: float) -> PlateChange:
    """Centres of pressure in another unit than metres."""
    return lambda p: replace(p, point=factor * p.point)


def points_held(p: ForcePlate) -> ForcePlate:
    """Every centre of pressure in the middle of the plate."""
    return replace(p, point=np.tile(_middle(p), (len(p.time), 1)))


def empty(p: ForcePlate) -> ForcePlate:
    """Nothing but zeros."""
    return replace(p, force=np.zeros_like(p.force), moment=np.zeros_like(p.moment))


def cut(share: tuple[float, float]) -> PlateChange:
    """A part of the contact, by shares of it, without any force."""

    def spoil(p: ForcePlate) -> ForcePlate:
        on = np.flatnonzero(p.force[:, 1] > BODY_N)
        if len(on) == 0:
            return p
        first, length = on[0], on[-1] - on[0]
        gone = slice(int(first + share[0] * length), int(first + share[1] * length))
        force_, moment = p.force.copy(), p.moment.copy()
        force_[gone], moment[gone] = 0.0, 0.0
        return replace(p, force=force_, moment=moment)

    return spoil


def dead_channel(axis: int) -> PlateChange:
    """A force channel that reads zero."""
    return axis_gain(axis, 0.0)


def missing(number: int) -> StudyChange:
    """The walk without one of its plates."""

    def spoil(study: Study) -> Study:
        walk = walk_of(study)
        kept = tuple(p for k, p in enumerate(walk.plates, start=1) if k != number)
        return with_recording(study, WALK, replace(walk, plates=kept))

    return spoil


def of_another_walk(base: str) -> StudyChange:
    """The force file of another walk, its first contact at the same moment."""

    def spoil(study: Study) -> Study:
        walk, other = walk_of(study), walk_of(loaded(base))
        first = min(_contact(p) for p in walk.plates if _contact(p) is not None)  # type: ignore[type-var]
        theirs = min(_contact(p) for p in other.plates if _contact(p) is not None)  # type: ignore[type-var]
        time = walk.plates[0].time
        source = time - first + theirs  # type: ignore[operator]
        told = [replace(_at(p, source), time=time, corners=None) for p in other.plates]
        after = tuple(replace(p, name=own.name) for own, p in zip(walk.plates, told, strict=False))
        return with_recording(study, WALK, replace(walk, plates=after))

    return spoil


def _contact(p: ForcePlate) -> float | None:
    on = np.flatnonzero(p.force[:, 1] > BODY_N)
    return float(p.time[on[0]]) if len(on) else None


def assigned(feet: Mapping[str, str]) -> StudyChange:
    """The study says which foot is on which plate."""
    return lambda study: replace(
        study, trials=tuple(replace(t, plates=dict(feet)) if t.name == WALK else t for t in study.trials)
    )
