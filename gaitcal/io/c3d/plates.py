"""The force plates that a C3D file describes: parameters and analog channels to wrenches in the axes of the file."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from gaitcal.arrays import Array
from gaitcal.io.force_plate import (
    BODY_N,
    OFFSET_TOLD_N,
    OUTSIDE_M,
    TURNED_ROUND,
    PlateFrame,
    about_surface,
    offset,
    outside_share,
    plate_frame,
    plate_from_moment,
    pushes_down,
    sensor_origin,
    wrench_type_1,
    wrench_type_3,
)
from gaitcal.io.recording import ForcePlate

CHANNELS = {1: 6, 2: 6, 3: 8, 4: 6}
"""Channels of each plate type read here."""
DOUBTFUL = 0.2
"""Share of centres of pressure outside the plate from which the user is told."""


@dataclass(frozen=True, kw_only=True)
class MeasuredPlate:
    """A plate before the vertical is known: wrench about the middle of its surface, in the axes of the file."""

    name: str
    time: Array
    """(ns,) s."""
    force: Array
    """(ns, 3) N."""
    moment: Array
    """(ns, 3) N·m."""
    frame: PlateFrame

    def as_plate(self) -> ForcePlate:
        """With its full moment about the middle of its surface."""
        point = np.tile(self.frame.centre, (len(self.time), 1))
        return ForcePlate(
            name=self.name,
            time=self.time,
            force=self.force,
            point=point,
            moment=self.moment,
            corners=self.frame.corners,
        )


def measured_plates(
    parameters: Mapping[str, Mapping[str, Any]], analogs: Array, first: float, rate: float, metres: float
) -> tuple[tuple[MeasuredPlate, ...], tuple[str, ...]]:
    """All plates that can be read from `analogs` (na, ns), sampled at `rate` Hz, and notes on them.

    `first` is how many samples the clock was past zero at the first one. `metres` is the length of POINT:UNITS. A plate
    that cannot be placed or read is left out, with a note.
    """
    group = parameters.get("FORCE_PLATFORM", {})
    types = _numbers(group, "TYPE").ravel()
    used = _numbers(group, "USED").ravel()
    count = min(len(types), int(used[0])) if len(used) and np.isfinite(used[0]) else len(types)
    if count < 1:
        return (), ()
    if analogs.size == 0:
        return (), (f"{count} force plate(s) left out: the file holds no analog samples.",)
    plates: list[MeasuredPlate] = []
    notes: list[str] = []
    for index in range(count):
        name = f"Plate {index + 1}"
        try:
            plate, plate_notes = _plate(parameters, index, analogs, first, rate, metres)
        except ValueError as fault:
            notes.append(f"{name} left out: {fault}.")
            continue
        plates.append(plate)
        notes += [f"{name}: {note}." for note in plate_notes]
    return tuple(plates), tuple(notes)


def stand_up(plates: tuple[MeasuredPlate, ...], up: Array) -> tuple[tuple[ForcePlate, ...], tuple[str, ...]]:
    """Plates with centres of pressure and with the force acting on the body, given the vertical `up` (3,)."""
    ready = []
    notes = []
    for plate in plates:
        force, moment, frame = plate.force, plate.moment, plate.frame
        normal = frame.up
        if normal @ up < 0:
            normal = -normal
            notes.append(f"Plate {plate.name}: its corners are numbered against the standard (its z axis points up).")
        if pushes_down(force, up):
            force, moment = -force, -moment
            notes.append(f"Plate {plate.name}: {TURNED_ROUND}")
        ready.append(plate_from_moment(plate.name, plate.time, force, moment, frame.centre, normal, frame.corners))
    return tuple(ready), tuple(notes)


def _plate(
    parameters: Mapping[str, Mapping[str, Any]], index: int, analogs: Array, first: float, rate: float, metres: float
) -> tuple[MeasuredPlate, list[str]]:
    group = parameters["FORCE_PLATFORM"]
    kind = _type(group, index)
    frame = plate_frame(_column(group, "CORNERS", index, (3, 4)).T * metres)
    channels, unit = _channels(parameters, group, index, CHANNELS[kind], analogs)
    keep = np.flatnonzero(np.isfinite(channels).all(axis=0))
    if not len(keep):
        raise ValueError("its channels hold no numbers")
    notes = []
    begin, end = int(keep[0]), int(keep[-1])
    if len(keep) < channels.shape[1]:
        notes.append(f"{channels.shape[1] - len(keep)} samples hold no numbers (those at its ends were cut off)")
    time = np.asarray((first + np.arange(begin, end + 1)) / rate, dtype=np.float64)
    channels = channels[:, begin : end + 1]
    torque = metres if unit is None else unit
    origin = np.zeros(3) if kind == 1 else _column(group, "ORIGIN", index, (3,)) * metres
    force, moment, turned = _wrench(kind, channels, origin, group, index, frame, metres, torque)
    if turned:
        notes.append("ORIGIN has the opposite sign (the centre of pressure lies on the plate only so)")
    empty, was_empty = offset(force, moment, rate)
    if not was_empty:
        notes.append("never empty, so that its offset is unknown and was left in")
    elif np.linalg.norm(empty[:3]) > OFFSET_TOLD_N:
        force, moment = force - empty[:3], moment - empty[3:]
        removed = ", ".join(f"{value:.1f}" for value in empty[:3])
        notes.append(f"offset of the empty plate removed, {removed} N in its own axes")
    share = outside_share(force, moment, frame)
    if share > DOUBTFUL:
        notes.append(
            f"{100 * share:.0f} % of the centres of pressure under more than {BODY_N:.0f} N lie over "
            f"{1e3 * OUTSIDE_M:.0f} mm outside its corners: check CORNERS, ORIGIN and CHANNEL"
        )
    turn = frame.rotation.T
    plate = MeasuredPlate(name=str(index + 1), time=time, force=force @ turn, moment=moment @ turn, frame=frame)
    return plate, notes


def _wrench(
    kind: int,
    channels: Array,
    origin: Array,
    group: Mapping[str, Any],
    index: int,
    frame: PlateFrame,
    metres: float,
    torque: float,
) -> tuple[Array, Array, bool]:
    """Force and moment about the middle of the surface, plate axes; and whether ORIGIN had to be turned round."""
    if kind == 1:
        return *wrench_type_1(channels * np.array([1, 1, 1, metres, metres, torque])[:, None]), False
    if kind == 3:
        return *wrench_type_3(channels, origin), False
    if kind == 4:
        channels = _column(group, "CAL_MATRIX", index, (6, 6)) @ channels
        torque = metres
    force, sensor = channels[:3].T.copy(), channels[3:].T * torque
    arm = sensor_origin(origin)
    moment = about_surface(force, sensor, arm)
    # ORIGIN without a height does not betray its sign; the plate itself does.
    other = about_surface(force, sensor, -arm)
    if outside_share(force, moment, frame) > 0.5 and outside_share(force, other, frame) < 0.1:
        return force, other, True
    return force, moment, False


def _type(group: Mapping[str, Any], index: int) -> int:
    value = _numbers(group, "TYPE").ravel()[index]
    if value not in CHANNELS:
        raise ValueError(f"its type is {value:g}; allowed are 1, 2, 3 and 4")
    return int(value)


def _channels(
    parameters: Mapping[str, Mapping[str, Any]], group: Mapping[str, Any], index: int, count: int, analogs: Array
) -> tuple[Array, float | None]:
    """(count, ns) channels of a plate, and metres in their unit of torque where the file names one."""
    table = _numbers(group, "CHANNEL")
    if table.ndim != 2 or table.shape[0] < count or table.shape[1] <= index:
        raise ValueError(f"FORCE_PLATFORM:CHANNEL has the shape {table.shape}; {count} channels are needed")
    numbers = table[:count, index]
    if not np.all((numbers >= 1) & (numbers <= len(analogs))):
        raise ValueError(f"it uses channels {numbers.astype(int).tolist()}; the file holds 1 to {len(analogs)}")
    places = numbers.astype(int) - 1
    units = parameters.get("ANALOG", {}).get("UNITS", [])
    name = str(units[places[-1]]) if len(units) > places[-1] else ""
    return analogs[places], _torque_unit(name)


def _torque_unit(name: str) -> float | None:
    text = re.sub(r"[^a-z]", "", name.lower())
    if re.fullmatch(r"(n|nt|newton)mm", text):
        return 1e-3
    return 1.0 if re.fullmatch(r"(n|nt|newton)m(eters?|etres?)?", text) else None


def _numbers(group: Mapping[str, Any], name: str) -> Array:
    value = group.get(name, [])
    try:
        return np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"FORCE_PLATFORM:{name} holds no numbers") from None


def _column(group: Mapping[str, Any], name: str, index: int, shape: tuple[int, ...]) -> Array:
    """The part of a parameter (*shape, plates) that belongs to one plate."""
    value = _numbers(group, name)
    if value.ndim == len(shape):
        value = value[..., None]
    if value.shape[:-1] != shape or value.shape[-1] <= index:
        raise ValueError(f"FORCE_PLATFORM:{name} has the shape {value.shape}; {(*shape, index + 1)} is needed")
    part = value[..., index]
    if not np.all(np.isfinite(part)):
        raise ValueError(f"FORCE_PLATFORM:{name} holds no finite numbers")
    return part
