"""Convert the parameters and analog channels of a C3D file to force plate wrenches.

The conventions and equations of the plate types are those of `gaitcal.io.force_plate`.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from gaitcal.arrays import Array, BoolArray, cross
from gaitcal.io import force_plate
from gaitcal.io.recording import ForcePlate

C3DGroups = Mapping[str, Mapping[str, Any]]
CHANNELS = {1: 6, 2: 6, 3: 8, 4: 6}  # Channels of each plate type read here
# Part of a note on a declared unit that the data contradict
DECLARED_UNIT_TEXT = "declares in its UNITS"
# Share of centres of pressure outside the plate above which a note is given
DOUBTFUL_SHARE = 0.2


@dataclass(frozen=True, kw_only=True)
class MeasuredPlate:
    """Plate before the vertical is known: wrench about its centre, in the axes of the file."""

    name: str
    time: Array  # (ns,) s
    force: Array  # (ns, 3) N
    moment: Array  # (ns, 3) N·m
    frame: force_plate.PlateFrame

    def to_force_plate(self) -> ForcePlate:
        """Convert to a force plate with the full moment about the centre of the surface."""
        point, wrench = (
            np.tile(self.frame.centre, (len(self.time), 1)),
            {"force": self.force, "moment": self.moment},
        )
        return ForcePlate(
            name=self.name, time=self.time, **wrench, point=point, corners=self.frame.corners
        )


def read_force_plates(
    parameters: C3DGroups,
    analogs: Array,
    first: float,
    rate: float,
    length_unit_m: float,
    markers: Array,
) -> tuple[tuple[MeasuredPlate, ...], tuple[str, ...]]:
    """Read all usable force plates of a C3D file.

    Parameters
    ----------
    parameters
        Groups of parameters of the file.
    analogs
        (na, ns) All analog channels in the units of the file: N, and for moments N times the length
        of POINT:UNITS unless ANALOG:UNITS differs.
    first
        Number of samples from time zero to the first sample.
    rate
        Sampling rate, Hz.
    length_unit_m
        Length of the unit of POINT:UNITS, m.
    markers
        (nf, nm, 3) Marker positions, m, in the axes of the file; they show when a person is over a
        plate.

    Returns
    -------
    plates, notes
        Usable plates, and one sentence for each plate that was left out or corrected.
    """
    group = parameters.get("FORCE_PLATFORM", {})
    types, used = _read_numbers(group, "TYPE").ravel(), _read_numbers(group, "USED").ravel()
    count = min(len(types), int(used[0])) if len(used) and np.isfinite(used[0]) else len(types)
    if count < 1:
        return (), ()
    if analogs.size == 0:
        return (), (f"{count} force plate(s) left out: the file has no analog samples.",)
    plates: list[MeasuredPlate] = []
    notes: list[str] = []
    for index in range(count):
        try:
            plate, plate_notes = _read_plate(
                parameters, index, analogs, first, rate, length_unit_m, markers
            )
        except ValueError as fault:
            notes.append(f"Plate {index + 1} left out: {fault}.")
            continue
        plates.append(plate)
        notes += [f"Plate {index + 1}: {note}." for note in plate_notes]
    return tuple(plates), tuple(notes)


def orient_plates(
    plates: tuple[MeasuredPlate, ...], up: Array
) -> tuple[tuple[ForcePlate, ...], tuple[str, ...]]:
    """Give plates a centre of pressure and the force that acts on the body.

    Parameters
    ----------
    up
        (3,) Unit vector of the vertical in these axes.

    Returns
    -------
    plates, notes
        Plates in the same axes, and one sentence for each correction.
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
        if force_plate.is_reaction_on_plate(force, up):
            force, moment = -force, -moment
            notes.append(f"Plate {plate.name}: {force_plate.REVERSED_NOTE}")
        ready.append(
            force_plate.build_plate_from_moment(
                plate.name, plate.time, force, moment, frame.centre, normal, frame.corners
            )
        )
    return tuple(ready), tuple(notes)


def _read_plate(
    parameters: C3DGroups,
    index: int,
    analogs: Array,
    first: float,
    rate: float,
    length_unit_m: float,
    markers: Array,
) -> tuple[MeasuredPlate, list[str]]:
    group = parameters["FORCE_PLATFORM"]
    kind = _read_numbers(group, "TYPE").ravel()[index]
    if kind not in CHANNELS:
        raise ValueError(f"its type is {kind:g}; allowed are 1, 2, 3 and 4")
    frame = force_plate.build_plate_frame(
        _read_column(group, "CORNERS", index, (3, 4)).T * length_unit_m
    )
    channels, given_moment_unit_m = _select_channels(parameters, index, CHANNELS[kind], analogs)
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
    origin = (
        np.zeros(3) if kind == 1 else _read_column(group, "ORIGIN", index, (3,)) * length_unit_m
    )
    if kind == 4:
        channels = _read_column(group, "CAL_MATRIX", index, (6, 6)) @ channels
        given_moment_unit_m = length_unit_m
    is_declared = given_moment_unit_m is not None and kind != 4
    moment_unit_m = length_unit_m if given_moment_unit_m is None else given_moment_unit_m
    scale = _find_unit_scale(int(kind), channels, origin, length_unit_m, moment_unit_m, frame)
    if scale != 1.0:
        quantity, unit, size = (
            ("centres of pressure", "m", length_unit_m)
            if kind == 1
            else ("moments", "N·m", moment_unit_m)
        )
        why = (
            f"not {size:g} {unit} as the file "
            f"{DECLARED_UNIT_TEXT if is_declared or kind == 1 else 'leads to expect'}"
        )
        why += ": only then is the centre of pressure under the foot, on the plate"
        notes.append(f"its {quantity} are in units of {scale * size:g} {unit}, {why}")
        length_unit_m = length_unit_m * scale if kind == 1 else length_unit_m
        moment_unit_m *= scale
    force, moment = compute_wrench(int(kind), channels, origin, length_unit_m, moment_unit_m)
    # The sign of ORIGIN is wrong where only the opposite one keeps the centre on the plate
    if kind in (2, 4) and force_plate.compute_outside_share(force, moment, frame) > 0.5:
        other = moment + 2.0 * cross(_orient_origin(origin), force)
        if force_plate.compute_outside_share(force, other, frame) < 0.1:
            moment = other
            notes.append(
                "ORIGIN has the opposite sign (only then is the centre of pressure on the plate)"
            )
    frames = np.arange(begin, end) * len(markers) // analogs.shape[1]
    empty = force_plate.estimate_offset(
        force, moment, rate, *(mask[frames] for mask in _find_presence(group, frame, markers))
    )
    if empty is None:
        notes.append("never empty, so its offset is unknown and was not removed")
    elif np.linalg.norm(empty[:3]) > force_plate.LEAST_OFFSET_N:
        force, moment = force - empty[:3], moment - empty[3:]
        removed = ", ".join(f"{value:.1f}" for value in empty[:3])
        notes.append(f"offset of the empty plate removed, {removed} N in the axes of the plate")
    notes += _note_doubtful_corners(force, moment, frame)
    to_file_axes = frame.rotation.T
    time = np.asarray((first + np.arange(begin, end)) / rate, dtype=np.float64)
    return MeasuredPlate(
        name=str(index + 1),
        time=time,
        force=force @ to_file_axes,
        moment=moment @ to_file_axes,
        frame=frame,
    ), notes


def _note_doubtful_corners(force: Array, moment: Array, frame: force_plate.PlateFrame) -> list[str]:
    """Note a plate whose centres of pressure are often outside its corners."""
    share = force_plate.compute_outside_share(force, moment, frame)
    if share > DOUBTFUL_SHARE:
        return [
            f"{100 * share:.0f} % of the centres of pressure under more than "
            f"{force_plate.BODY_N:.0f} N are over "
            f"{1e3 * force_plate.OUTSIDE_M:.0f} mm outside its corners: check CORNERS, ORIGIN and "
            "CHANNEL"
        ]
    return []


def _find_unit_scale(
    kind: int,
    channels: Array,
    origin: Array,
    length_unit_m: float,
    moment_unit_m: float,
    frame: force_plate.PlateFrame,
) -> float:
    """Find the factor that corrects the unit of the moments (type 1: of the centres of pressure).

    It is nearly always 1. Moments in N·m that are taken for N·mm keep the centre of pressure within
    a millimetre of the sensor's axis. The reverse moves it far beyond the plate. Another unit is
    used if this one does either, and that one neither.
    """

    def fits(scale: float, most: float) -> bool:
        """Whether at most such a share of the centres of pressure is outside the plate, and they
        move at all.
        """
        units = length_unit_m * (scale if kind == 1 else 1.0), moment_unit_m * scale
        outside = force_plate.compute_outside_share(
            *compute_wrench(kind, channels, origin, *units), frame
        )
        about_sensor = compute_wrench(kind, channels, np.zeros(3), *units)
        return np.isnan(outside) or (
            outside < most
            and force_plate.measure_cop_travel(*about_sensor) > force_plate.LEAST_SWAY_M
        )

    if kind == 3 or fits(1.0, 0.5):
        return 1.0
    others = [unit / (length_unit_m if kind == 1 else moment_unit_m) for unit in (1e-3, 1.0)]
    fitting = [scale for scale in others if fits(scale, 0.1)]
    return fitting[0] if len(fitting) == 1 else 1.0


def _find_presence(
    group: Mapping[str, Any], frame: force_plate.PlateFrame, markers: Array
) -> tuple[BoolArray, ...]:
    """Find frames (nf,) with a person over the plate; without by ZERO; without by the markers."""
    occupied, known = force_plate.find_points_over_plate(markers, frame)
    zero = _read_numbers(group, "ZERO").ravel()
    first, last = zero if len(zero) == 2 else (1.0, 0.0)
    numbers = np.arange(1, len(markers) + 1)
    # No frame is named in a damaged file without these numbers
    named = (numbers >= first) & (numbers <= last)
    return occupied, named & ~occupied, known & ~occupied


def compute_wrench(
    kind: int, channels: Array, origin: Array, length_unit_m: float, moment_unit_m: float
) -> tuple[Array, Array]:
    """Compute the wrench about the centre of the surface from the channels of a plate.

    `kind`: TYPE of the plate, 1 to 4. `channels`: (6 or 8, ns) forces in N, moments in units of
    `moment_unit_m`, centres of pressure in units of `length_unit_m`. `origin`: (3,) ORIGIN of the
    plate, m. `length_unit_m`: unit of the centres of pressure, m. `moment_unit_m`: unit of the
    moments, N·m. Returns: (ns, 3) N and (ns, 3) N·m in the plate frame.
    """
    if kind == 3:
        x12, x34, y14, y23, z1, z2, z3, z4 = channels
        a, b = np.abs(origin[:2])
        force = np.column_stack([x12 + x34, y14 + y23, z1 + z2 + z3 + z4])
        moments = [
            b * (z1 + z2 - z3 - z4),
            a * (-z1 + z2 + z3 - z4),
            b * (x34 - x12) + a * (y14 - y23),
        ]
        return force, np.column_stack(moments) - cross(np.array([0.0, 0.0, -abs(origin[2])]), force)
    force = channels[:3].T.copy()
    if kind == 1:
        # The centre of pressure of an unloaded plate is noise divided by noise
        loaded = np.abs(force[:, 2]) > force_plate.LOADED_N
        point = np.zeros_like(force)
        point[loaded, :2] = channels[3:5].T[loaded] * length_unit_m
        moment = cross(point, force)
        moment[:, 2] += channels[5] * moment_unit_m
        return force, moment
    return force, channels[3:].T * moment_unit_m - cross(_orient_origin(origin), force)


def _orient_origin(origin: Array) -> Array:
    """Orient ORIGIN as the guide defines it: from sensor to surface, so that z is not positive."""
    return -origin if origin[2] > 0 else origin


def _select_channels(
    parameters: C3DGroups, index: int, count: int, analogs: Array
) -> tuple[Array, float | None]:
    """Select the (count, ns) channels of a plate, with its unit of torque (m) if given."""
    table = _read_numbers(parameters["FORCE_PLATFORM"], "CHANNEL")
    if table.ndim != 2 or table.shape[0] < count or table.shape[1] <= index:
        raise ValueError(
            f"FORCE_PLATFORM:CHANNEL has the shape {table.shape}; {count} channels are needed"
        )
    numbers = table[:count, index]
    if not np.all((numbers >= 1) & (numbers <= len(analogs))):
        raise ValueError(
            f"it uses channels {numbers.astype(int).tolist()}; the file has 1 to {len(analogs)}"
        )
    rows = numbers.astype(int) - 1
    units = parameters.get("ANALOG", {}).get("UNITS", [])
    unit = re.sub(r"[^a-z]", "", str(units[rows[-1]]).lower()) if len(units) > rows[-1] else ""
    in_mm, in_m = (
        re.fullmatch(r"(n|nt|newton)mm", unit),
        re.fullmatch(r"(n|nt|newton)m(eters?|etres?)?", unit),
    )
    return analogs[rows], 1e-3 if in_mm else 1.0 if in_m else None


def _read_numbers(group: Mapping[str, Any], name: str) -> Array:
    value = group.get(name, [])
    try:
        return np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"FORCE_PLATFORM:{name} has no numbers") from None


def _read_column(group: Mapping[str, Any], name: str, index: int, shape: tuple[int, ...]) -> Array:
    """Read the part of a parameter (*shape, plates) that belongs to one plate."""
    value = _read_numbers(group, name)
    if value.ndim == len(shape):
        value = value[..., None]
    if value.shape[:-1] != shape or value.shape[-1] <= index:
        raise ValueError(
            f"FORCE_PLATFORM:{name} has the shape {value.shape}; {(*shape, index + 1)} is needed"
        )
    part = value[..., index]
    if not np.all(np.isfinite(part)):
        raise ValueError(f"FORCE_PLATFORM:{name} has no finite numbers")
    return part
