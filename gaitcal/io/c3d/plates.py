"""The force plates that a C3D file describes: parameters and analog channels to wrenches in the
axes of the file.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from gaitcal.arrays import Array, BoolArray, cross
from gaitcal.io import force_plate
from gaitcal.io.recording import ForcePlate

Parameters = Mapping[str, Mapping[str, Any]]
CHANNELS = {1: 6, 2: 6, 3: 8, 4: 6}  # Channels of each plate type read here
CONTRADICTED = "says in its UNITS"  # In a note on a unit that the data contradict
DOUBTFUL = 0.2  # Share of centres of pressure outside the plate from which the user is told


@dataclass(frozen=True, kw_only=True)
class MeasuredPlate:
    """A plate before the vertical is known: wrench about the middle of its surface, in the axes of
    the file.
    """

    name: str
    time: Array  # (ns,) s
    force: Array  # (ns, 3) N
    moment: Array  # (ns, 3) N·m
    frame: force_plate.PlateFrame

    def as_plate(self) -> ForcePlate:
        """With its full moment about the middle of its surface."""
        point, wrench = (
            np.tile(self.frame.centre, (len(self.time), 1)),
            {"force": self.force, "moment": self.moment},
        )
        return ForcePlate(
            name=self.name, time=self.time, **wrench, point=point, corners=self.frame.corners
        )


def measured_plates(
    parameters: Parameters, analogs: Array, first: float, rate: float, metres: float, markers: Array
) -> tuple[tuple[MeasuredPlate, ...], tuple[str, ...]]:
    """All usable plates and notes on the rest.

    `analogs` (na, ns) are all analog channels at `rate` Hz, in the units of the file (N, and for
    moments N times the length of POINT:UNITS unless ANALOG:UNITS says otherwise); `first` tells how
    many samples the clock was past zero at the first one. `metres` is the length of POINT:UNITS.
    `markers` (nf, nm, 3) m in the axes of the file show when somebody is over a plate. A plate that
    cannot be placed or read is left out, with a note.
    """
    group = parameters.get("FORCE_PLATFORM", {})
    types, used = _numbers(group, "TYPE").ravel(), _numbers(group, "USED").ravel()
    count = min(len(types), int(used[0])) if len(used) and np.isfinite(used[0]) else len(types)
    if count < 1:
        return (), ()
    if analogs.size == 0:
        return (), (f"{count} force plate(s) left out: the file holds no analog samples.",)
    plates: list[MeasuredPlate] = []
    notes: list[str] = []
    for index in range(count):
        try:
            plate, plate_notes = _plate(parameters, index, analogs, first, rate, metres, markers)
        except ValueError as fault:
            notes.append(f"Plate {index + 1} left out: {fault}.")
            continue
        plates.append(plate)
        notes += [f"Plate {index + 1}: {note}." for note in plate_notes]
    return tuple(plates), tuple(notes)


def stand_up(
    plates: tuple[MeasuredPlate, ...], up: Array
) -> tuple[tuple[ForcePlate, ...], tuple[str, ...]]:
    """Plates with centres of pressure and with the force acting on the body, given the vertical
    `up` (3,).
    """
    ready = []
    notes = []
    for plate in plates:
        force, moment, frame = plate.force, plate.moment, plate.frame
        normal = frame.up
        if normal @ up < 0:
            normal = -normal
            notes.append(
                f"Plate {plate.name}: its corners are numbered against the standard (its z axis "
                "points up)."
            )
        if force_plate.pushes_down(force, up):
            force, moment = -force, -moment
            notes.append(f"Plate {plate.name}: {force_plate.TURNED_ROUND}")
        ready.append(
            force_plate.plate_from_moment(
                plate.name, plate.time, force, moment, frame.centre, normal, frame.corners
            )
        )
    return tuple(ready), tuple(notes)


def _plate(
    parameters: Parameters,
    index: int,
    analogs: Array,
    first: float,
    rate: float,
    metres: float,
    markers: Array,
) -> tuple[MeasuredPlate, list[str]]:
    group = parameters["FORCE_PLATFORM"]
    kind = _numbers(group, "TYPE").ravel()[index]
    if kind not in CHANNELS:
        raise ValueError(f"its type is {kind:g}; allowed are 1, 2, 3 and 4")
    frame = force_plate.plate_frame(_column(group, "CORNERS", index, (3, 4)).T * metres)
    channels, torque = _channels(parameters, index, CHANNELS[kind], analogs)
    keep = np.flatnonzero(np.isfinite(channels).all(axis=0))
    if not len(keep):
        raise ValueError("its channels hold no numbers")
    notes = []
    begin, end = int(keep[0]), int(keep[-1]) + 1
    if len(keep) < channels.shape[1]:
        notes.append(
            f"{channels.shape[1] - len(keep)} samples hold no numbers (those at its ends were cut "
            "off)"
        )
    channels = channels[:, begin:end]
    origin = np.zeros(3) if kind == 1 else _column(group, "ORIGIN", index, (3,)) * metres
    if kind == 4:
        channels, torque = _column(group, "CAL_MATRIX", index, (6, 6)) @ channels, metres
    declared, torque = torque is not None and kind != 4, metres if torque is None else torque
    scale = _unit_scale(int(kind), channels, origin, metres, torque, frame)
    if scale != 1.0:
        what, unit, size = (
            ("centres of pressure", "m", metres) if kind == 1 else ("moments", "N·m", torque)
        )
        why = (
            f"not {size:g} {unit} as the file "
            f"{CONTRADICTED if declared or kind == 1 else 'leads to expect'}"
        )
        why += ": only so does the centre of pressure move under the foot, on the plate"
        notes.append(f"its {what} are in units of {scale * size:g} {unit}, {why}")
        metres, torque = (metres * scale if kind == 1 else metres), torque * scale
    force, moment = wrench_of(int(kind), channels, origin, metres, torque)
    # ORIGIN without a height does not betray its sign; the plate itself does.
    if kind in (2, 4) and force_plate.outside_share(force, moment, frame) > 0.5:
        other = moment + 2.0 * cross(_below(origin), force)
        if force_plate.outside_share(force, other, frame) < 0.1:
            moment = other
            notes.append(
                "ORIGIN has the opposite sign (the centre of pressure lies on the plate only so)"
            )
    frames = np.arange(begin, end) * len(markers) // analogs.shape[1]
    empty = force_plate.offset(
        force, moment, rate, *(mask[frames] for mask in _presence(group, frame, markers))
    )
    if empty is None:
        notes.append("never empty, so that its offset is unknown and was left in")
    elif np.linalg.norm(empty[:3]) > force_plate.OFFSET_TOLD_N:
        force, moment = force - empty[:3], moment - empty[3:]
        removed = ", ".join(f"{value:.1f}" for value in empty[:3])
        notes.append(f"offset of the empty plate removed, {removed} N in its own axes")
    share = force_plate.outside_share(force, moment, frame)
    if share > DOUBTFUL:
        notes.append(
            f"{100 * share:.0f} % of the centres of pressure under more than "
            f"{force_plate.BODY_N:.0f} N lie over "
            f"{1e3 * force_plate.OUTSIDE_M:.0f} mm outside its corners: check CORNERS, ORIGIN and "
            "CHANNEL"
        )
    turn, time = (
        frame.rotation.T,
        np.asarray((first + np.arange(begin, end)) / rate, dtype=np.float64),
    )
    return MeasuredPlate(
        name=str(index + 1), time=time, force=force @ turn, moment=moment @ turn, frame=frame
    ), notes


def _unit_scale(
    kind: int,
    channels: Array,
    origin: Array,
    metres: float,
    torque: float,
    frame: force_plate.PlateFrame,
) -> float:
    """By what the unit of the moments (type 1: of the centres of pressure) is to be multiplied;
    nearly always 1.

    Moments in N·m that are taken for N·mm leave the centre of pressure within a millimetre of the
    sensor's axis, whoever walks; the reverse puts it far beyond the plate. Another unit is taken
    where this one does either, and that one neither.
    """

    def fits(scale: float, most: float) -> bool:
        """Whether at most such a share of the centres of pressure is outside the plate, and they
        move at all.
        """
        units = metres * (scale if kind == 1 else 1.0), torque * scale
        outside = force_plate.outside_share(*wrench_of(kind, channels, origin, *units), frame)
        about_sensor = wrench_of(kind, channels, np.zeros(3), *units)
        return np.isnan(outside) or (
            outside < most and force_plate.travel(*about_sensor) > force_plate.SWAY_M
        )

    if kind == 3 or fits(1.0, 0.5):
        return 1.0
    others = [unit / (metres if kind == 1 else torque) for unit in (1e-3, 1.0)]
    fitting = [scale for scale in others if fits(scale, 0.1)]
    return fitting[0] if len(fitting) == 1 else 1.0


def _presence(
    group: Mapping[str, Any], frame: force_plate.PlateFrame, markers: Array
) -> tuple[BoolArray, ...]:
    """Find the frames (nf,) with a person over a plate; without, by ZERO and the markers; without,
    by the markers.
    """
    occupied, known = force_plate.over_plate(markers, frame)
    first, last = zero if len(zero := _numbers(group, "ZERO").ravel()) == 2 else (1.0, 0.0)
    numbers = np.arange(1, len(markers) + 1)
    named = (numbers >= first) & (numbers <= last)  # none where a damaged file has no numbers
    return occupied, named & ~occupied, known & ~occupied


def wrench_of(
    kind: int, channels: Array, origin: Array, metres: float, torque: float
) -> tuple[Array, Array]:
    """Force (ns, 3), N, and moment (ns, 3), N·m, about the middle of the surface, plate axes.

    `channels` (6 or 8, ns): N, moments in units of `torque` N·m, centres of pressure in units of
    `metres` m. `origin` (3,) m is ORIGIN of the plate.
    """
    if kind == 3:
        x12, x34, y14, y23, z1, z2, z3, z4 = channels
        a, b = np.abs(origin[:2])
        force = np.column_stack([x12 + x34, y14 + y23, z1 + z2 + z3 + z4])
        turning = [
            b * (z1 + z2 - z3 - z4),
            a * (-z1 + z2 + z3 - z4),
            b * (x34 - x12) + a * (y14 - y23),
        ]
        return force, np.column_stack(turning) - cross(np.array([0.0, 0.0, -abs(origin[2])]), force)
    force = channels[:3].T.copy()
    if kind == 1:
        loaded = (
            np.abs(force[:, 2]) > force_plate.LOADED_N
        )  # the centre of an unloaded plate is noise divided by noise
        point = np.zeros_like(force)
        point[loaded, :2] = channels[3:5].T[loaded] * metres
        moment = cross(point, force)
        moment[:, 2] += channels[5] * torque
        return force, moment
    return force, channels[3:].T * torque - cross(_below(origin), force)


def _below(origin: Array) -> Array:
    """ORIGIN as the guide means it: from the sensor origin up to the surface, so z is not positive."""
    return -origin if origin[2] > 0 else origin


def _channels(
    parameters: Parameters, index: int, count: int, analogs: Array
) -> tuple[Array, float | None]:
    """(count, ns) channels of a plate, and metres in their unit of torque where the file names one."""
    table = _numbers(parameters["FORCE_PLATFORM"], "CHANNEL")
    if table.ndim != 2 or table.shape[0] < count or table.shape[1] <= index:
        raise ValueError(
            f"FORCE_PLATFORM:CHANNEL has the shape {table.shape}; {count} channels are needed"
        )
    numbers = table[:count, index]
    if not np.all((numbers >= 1) & (numbers <= len(analogs))):
        raise ValueError(
            f"it uses channels {numbers.astype(int).tolist()}; the file holds 1 to {len(analogs)}"
        )
    places = numbers.astype(int) - 1
    units = parameters.get("ANALOG", {}).get("UNITS", [])
    unit = re.sub(r"[^a-z]", "", str(units[places[-1]]).lower()) if len(units) > places[-1] else ""
    in_mm, in_m = (
        re.fullmatch(r"(n|nt|newton)mm", unit),
        re.fullmatch(r"(n|nt|newton)m(eters?|etres?)?", unit),
    )
    return analogs[places], 1e-3 if in_mm else 1.0 if in_m else None


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
        raise ValueError(
            f"FORCE_PLATFORM:{name} has the shape {value.shape}; {(*shape, index + 1)} is needed"
        )
    part = value[..., index]
    if not np.all(np.isfinite(part)):
        raise ValueError(f"FORCE_PLATFORM:{name} holds no finite numbers")
    return part
