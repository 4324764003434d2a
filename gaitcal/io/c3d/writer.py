"""C3D files written: from a recording, and as a copy of a file with further points, events and parameters.

From a recording: Vicon's usual shape, millimetres, z up, type-2 plates. C3D keeps 32-bit floats, so markers come back
to 1e-7 of their size, and wrenches likewise.

As a copy: of a file of floats, every word of its points, residuals, camera masks and analog samples is copied as it
stands. A file of integers becomes one of floats, as ours do not fit its steps: analog samples, residuals and camera
masks keep their values exactly, coordinates are those integers times the file's scale, to the precision of a 32-bit
float. Parameters that are not concerned are copied byte for byte.
"""

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np

from gaitcal.arrays import Array
from gaitcal.errors import Code, InputError
from gaitcal.io import atomic, force_plate, text_file
from gaitcal.io.axes import Turn
from gaitcal.io.c3d import layout
from gaitcal.io.labels import FootEvent, FootMoment
from gaitcal.io.recording import ForcePlate, Recording, require_plain_labels

Y_TO_Z_UP = Turn((0, 2, 1), (1, -1, 1))  # Our axes to the laboratory's: the inverse of UP_TO_Y[2, 1]
CHANNEL_NAMES = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
MARGIN_M = 0.1  # Around the points of a plate whose corners are unknown
MOST_FRAMES = 65535  # First and last frame are 16-bit numbers
MOST_LABELS = 255  # A list of names counts them in one byte; nobody wears more markers
CLOCK_SAMPLES = 1e-3  # Departure, in samples, up to which times count as uniform


def _fault(message: str, field: str | None = None) -> text_file.FileFault:
    return text_file.FileFault(message, field, Code.NOT_WRITABLE)


@text_file.naming_file
def write_c3d(path: Path, recording: Recording) -> None:
    """Markers and plates as a C3D file that `read_recording` returns again.

    Times must be uniform and start at a whole number of frames; plate samples a whole multiple of the marker rate, from
    the first frame on, to the last. A plate without corners gets a rectangle around its points. InputError otherwise.
    """
    import ezc3d

    require_plain_labels(recording)
    if len(recording.labels) > MOST_LABELS:
        raise _fault(f"{len(recording.labels)} markers found; at most {MOST_LABELS} are allowed")
    rate, first = _clock(recording.time)
    frames = len(recording.time)
    file = ezc3d.c3d()
    point = file["parameters"]["POINT"]
    point["RATE"]["value"] = [rate]
    point["LABELS"]["value"] = list(recording.labels)
    point["DESCRIPTIONS"]["value"] = [""] * len(recording.labels)
    point["UNITS"]["value"] = ["mm"]
    file["header"]["points"]["first_frame"] = first
    millimetres = 1e3 * Y_TO_Z_UP.apply(recording.markers).transpose(2, 1, 0)
    missing = np.isnan(millimetres).any(axis=0)
    file["data"]["points"] = np.concatenate([millimetres, np.ones((1, *missing.shape))])
    file["data"]["meta_points"]["residuals"] = np.where(missing, -1.0, 0.0)[None]
    file["data"]["meta_points"]["camera_masks"] = np.zeros((7, *missing.shape), dtype=bool)
    if recording.plates:
        _add_plates(file, recording.plates, rate, frames, float(recording.time[0]))
    with atomic.atomic_file(path) as part:
        written = part.with_suffix(".c3d")  # ezc3d adds this ending to any other, .C3D too
        try:
            file.write(str(written))
        except (RuntimeError, ValueError) as error:
            raise _fault(f"cannot be written ({error})") from None
        written.replace(part)


def _clock(time: Array) -> tuple[float, int]:
    """Frames a second, and the number of the first frame counted from 0."""
    if len(time) == 1:
        return 100.0, round(100.0 * float(time[0]))
    rate = (len(time) - 1) / float(time[-1] - time[0])
    if abs(rate - round(rate)) < 1e-6 * rate:
        rate = float(round(rate))
    first = round(float(time[0]) * rate)
    away = float(np.max(np.abs((first + np.arange(len(time))) - time * rate)))
    if away > CLOCK_SAMPLES:
        raise _fault(f"times lie up to {away:.2g} frames off a uniform clock; C3D allows none")
    if first < 0 or first + len(time) > MOST_FRAMES:
        raise _fault(f"frames {first + 1} to {first + len(time)} found; 1 to {MOST_FRAMES} are allowed")
    return rate, first


def _add_plates(file: Any, plates: tuple[ForcePlate, ...], rate: float, frames: int, start: float) -> None:
    samples = len(plates[0].time)
    ratio = samples // frames
    for plate in plates:
        steps, count = (plate.time - start) * rate * ratio, len(plate.time)
        uniform = samples == ratio * frames and count == samples
        if not uniform or np.abs(steps - np.arange(samples)).max() > CLOCK_SAMPLES:
            raise _fault(
                f"{count} samples from {plate.time[0]:.4f} s for {frames} frames from {start:.4f} s; a whole number of "
                "samples a frame, from the first frame on, is needed",
                f"plate {plate.name}",
            )
        if not np.isfinite(plate.wrench()).all():
            raise _fault("its wrench holds NaN; channels cannot", f"plate {plate.name}")
    parts = [_plate_in_its_frame(plate) for plate in plates]
    channels = 6 * len(plates)
    values = {
        "RATE": [rate * ratio],
        "LABELS": [f"{name}{i + 1}" for i in range(len(plates)) for name in CHANNEL_NAMES],
        "DESCRIPTIONS": [""] * channels,
        "UNITS": ["N", "N", "N", "Nmm", "Nmm", "Nmm"] * len(plates),
        "SCALE": [1.0] * channels,
        "OFFSET": [0] * channels,
    }
    platform = {
        "USED": np.array([len(plates)]),
        "TYPE": np.array([2] * len(plates)),
        "CORNERS": np.stack([1e3 * corners.T for corners, _ in parts], axis=2),
        "ORIGIN": np.zeros((3, len(plates))),
        "CHANNEL": np.arange(1, channels + 1).reshape(len(plates), 6).T,
    }
    for group, entries in (("ANALOG", values), ("FORCE_PLATFORM", platform)):
        for name, value in entries.items():  # they are there, and have the right types
            file["parameters"][group][name]["value"] = value
    file["data"]["analogs"] = np.concatenate([channel for _, channel in parts])[None]


def _plate_in_its_frame(plate: ForcePlate) -> tuple[Array, Array]:
    """Corners (4, 3) m, z up, and channels (6, ns) N, N·mm about the middle of the surface in the plate's frame."""
    corners = Y_TO_Z_UP.apply(_standard_corners(plate))
    corners = (1e3 * corners).astype(np.float32).astype(np.float64) / 1e3  # as the file will hold them
    frame = force_plate.plate_frame(corners)
    wrench = plate.wrench()
    force = Y_TO_Z_UP.apply(wrench[:, :3])
    moment = Y_TO_Z_UP.apply(wrench[:, 3:]) - np.cross(frame.centre, force)
    return corners, np.concatenate([(force @ frame.rotation).T, 1e3 * (moment @ frame.rotation).T])


def _standard_corners(plate: ForcePlate) -> Array:
    """(4, 3) m, y up, numbered so that the plate's own z points down; a rectangle around the points if unknown."""
    if plate.corners is None:
        points = plate.point[plate.force[:, 1] > 0]
        points = points if len(points) else plate.point
        low, high = points.min(axis=0) - MARGIN_M, points.max(axis=0) + MARGIN_M
        y = float(np.median(points[:, 1]))
        # x forward and z right here are x and -y of the file: +x +y, -x +y, -x -y, +x -y seen from below.
        return np.array([[high[0], y, high[2]], [low[0], y, high[2]], [low[0], y, low[2]], [high[0], y, low[2]]])
    normal = np.cross(plate.corners[0] - plate.corners[1], plate.corners[0] - plate.corners[3])
    return plate.corners if normal[1] < 0 else plate.corners[[1, 0, 3, 2]]


# ---------------------------------------------------------------------------------------- a copy with further points

CONTEXTS = {"r": "Right", "l": "Left"}
EVENT_WORDS = {
    FootMoment.STRIKE: ("Foot Strike", "The instant the heel strikes the ground (gaitcal)", 1),
    FootMoment.OFF: ("Foot Off", "The instant the toe leaves the ground (gaitcal)", 2),
}
"""Label, description and icon, as Vicon's programs have them."""
MOST_EVENTS = 255


class PointKind(Enum):
    """What the three numbers of a point are: the list of POINT that names it, and the word for one of its kind."""

    ANGLE = ("ANGLES", "ANGLE")
    MOMENT = ("MOMENTS", "MOMENT")
    POWER = ("POWERS", "POWER")
    FORCE = ("FORCES", "FORCE")
    PLACE = ("MODELED_MARKERS", "MODELED_MARKER")


@dataclass(frozen=True, kw_only=True)
class AddedPoint:
    """A point to be added."""

    name: str
    kind: PointKind
    values: Array  # (nf, 3) for every frame of the file, in its axes and units; NaN where unknown
    description: str = ""


@dataclass(frozen=True, kw_only=True)
class C3DOriginal:
    """A C3D file that is to be supplemented, in its own axes and units."""

    path: Path
    content: bytes
    header: layout.C3DHeader
    section: layout.ParameterSection
    frames: int

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of its points, as far as they have names."""
        return tuple(self.section.list_of("POINT", "LABELS")[: self.header.points])

    def unit(self, name: str) -> str:
        """A POINT parameter that names a unit, such as `ANGLE_UNITS`; the empty string where it is missing."""
        return next(iter(self.section.texts("POINT", name) or []), "")

    def places(self) -> Array:
        """(nf, np, 3) of all points as they stand in the file, zeros where it has zeros."""
        rows, own = _rows(self), 4 * self.header.points
        if self.header.is_float:
            values = layout.decode_floats(rows[:, :own].tobytes(), self.header.processor).astype(np.float64)
        else:
            values = _as_floats(rows, self)[:, :own]
        return values.reshape(self.frames, self.header.points, 4)[:, :, :3]


@text_file.naming_file
def c3d_original(path: Path, frames: int) -> C3DOriginal:
    """The C3D file at `path`, of so many frames as its reader counts; InputError where it is damaged."""
    header = layout.check_c3d_header(path)
    content = path.read_bytes()
    at = (content[0] - 1) * layout.BLOCK
    try:
        section = layout.parse_section(content[at : at + content[at + 2] * layout.BLOCK])
    except (ValueError, IndexError, struct.error) as fault:
        raise text_file.FileFault(f"damaged: {fault}", code=Code.DAMAGED_RECORDING) from None
    return C3DOriginal(path=path, content=content, header=header, section=section, frames=frames)


def supplement_c3d(
    original: C3DOriginal,
    target: Path,
    points: Sequence[AddedPoint],
    events: Sequence[FootEvent] = (),
    group: tuple[str, Mapping[str, Sequence[str]]] | None = None,
    units: Mapping[str, str] | None = None,
) -> None:
    """Write a C3D file with `points` after its own, and `events` after its own.

    Parameters
    ----------
    points : one of the name of a point of the file takes its place.
    group : a group of parameters of that name, each a list of text.
    units : POINT parameter -> unit, such as `ANGLE_UNITS`, where the file has none.

    Raises InputError: The file cannot take them: its layout is damaged, or a limit of the format is met.
    """
    header, content, labels = original.header, original.content, original.labels
    at = (content[0] - 1) * layout.BLOCK
    new = [point for point in points if point.name not in labels]
    instead = {labels.index(point.name): point for point in points if point.name in labels}
    try:
        section = _with_points(original.section, header.points, new, units or {})
        told = section.list_of("POINT", "DESCRIPTIONS")
        told = [instead[k].description if k in instead else text for k, text in enumerate(told)]
        section = section.with_list("POINT", "DESCRIPTIONS", told) if instead else section
        section = _with_events(section, events)
        if group is not None:
            section = section.with_group(group[0], "what gaitcal added to this file")
            for name, texts in group[1].items():
                section = section.with_list(group[0], name, texts)
        start = at + len(section.to_bytes())
        section = _with_count(section, "POINT", "DATA_START", start // layout.BLOCK + 1)
        out = bytearray(content[:at]) + section.to_bytes()
        out[2:4] = (header.points + len(new)).to_bytes(2, "little")
        out[13 if header.processor == layout.DEC else 15] |= 0x80  # a negative scale: floats
        out[16:18] = (start // layout.BLOCK + 1).to_bytes(2, "little")
        out += _data(original, new, instead)
    except (ValueError, OverflowError, IndexError, StopIteration, struct.error) as fault:
        message = f"cannot be given further points: {fault}"
        raise InputError(message, source=original.path, code=Code.NOT_WRITABLE) from None
    target.write_bytes(bytes(out) + bytes(-len(out) % layout.BLOCK))


def _rows(original: C3DOriginal) -> Array:
    """(frames, width) words of the file: four of each point, then the analog samples of the frame."""
    header = original.header
    width = 4 * header.points + header.analog_values
    kind = np.dtype("<u4" if header.is_float else "<i2")
    if header.start + original.frames * width * kind.itemsize > len(original.content):
        message = f"ends before its {original.frames} frames do"
        raise InputError(message, source=original.path, code=Code.DAMAGED_RECORDING)
    return np.frombuffer(original.content, kind, original.frames * width, header.start).reshape(original.frames, width)


def _data(original: C3DOriginal, points: Sequence[AddedPoint], instead: Mapping[int, AddedPoint]) -> bytes:
    """All frames, each the file's own points, ours, and the analog samples; `instead`: of the file's own by number."""
    header, frames, rows = original.header, original.frames, _rows(original)
    own = 4 * header.points
    if not header.is_float:
        rows = _words(_as_floats(rows, original), header.processor)
    every = [*points, *instead.values()]
    added = np.zeros((frames, len(every), 4))
    for number, point in enumerate(every):
        if point.values.shape != (frames, 3):
            raise ValueError(f"{point.name} has values of shape {point.values.shape}")
        known = np.asarray(np.isfinite(point.values).all(axis=1))
        added[:, number, :3] = np.where(known[:, None], point.values, 0.0)
        added[:, number, 3] = np.where(known, 0.0, -1.0)
    ours = _words(added.reshape(frames, -1), header.processor)
    theirs = rows[:, :own].copy()
    for number, place in enumerate(instead, start=len(points)):
        theirs[:, 4 * place : 4 * place + 4] = ours[:, 4 * number : 4 * number + 4]
    return np.hstack([theirs, ours[:, : 4 * len(points)], rows[:, own:]]).tobytes()


def _words(values: Array, processor: int) -> Array:
    """Numbers as the 32-bit words of the file."""
    return np.frombuffer(layout.encode_floats(values, processor), dtype="<u4").reshape(values.shape)


def _as_floats(rows: Array, original: C3DOriginal) -> Array:
    """(frames, width) the numbers that a file of integers means: coordinates scaled, all others as they are."""
    own = 4 * original.header.points
    scale = layout.decode_floats(original.content[12:16], original.header.processor)[0]
    values = rows.astype(np.float64)
    places = values[:, :own].reshape(len(rows), -1, 4)
    places[:, :, :3] *= scale
    if "UNSIGNED" in [word.upper() for word in original.section.texts("ANALOG", "FORMAT") or []]:
        values[:, own:] = rows[:, own:].astype("<u2")
    return np.asarray(values)


def _with_points(
    section: layout.ParameterSection, count: int, points: Sequence[AddedPoint], units: Mapping[str, str]
) -> layout.ParameterSection:
    names = [point.name for point in points]
    for name, texts in (("LABELS", names), ("DESCRIPTIONS", [point.description for point in points])):
        entries = section.list_of("POINT", name)[:count]
        section = section.with_list("POINT", name, [*entries, *[""] * (count - len(entries)), *texts])
    section = _with_count(section, "POINT", "USED", count + len(points))
    scale = section.numbers("POINT", "SCALE")
    if scale is not None:
        section = section.with_numbers("POINT", "SCALE", -np.abs(scale))
    pairs = section.texts("POINT", "TYPE_GROUPS") or []
    for kind in PointKind:
        lists, word = kind.value
        ours = [point.name for point in points if point.kind is kind]
        if ours:
            section = section.with_list("POINT", lists, [*section.list_of("POINT", lists), *ours])
            pairs += [] if lists in pairs else [lists, word]
    section = section.with_list("POINT", "TYPE_GROUPS", pairs, rows=2)
    for name, unit in units.items():
        if not section.texts("POINT", name):
            section = section.with_list("POINT", name, [unit])
    return section


def _with_events(section: layout.ParameterSection, events: Sequence[FootEvent]) -> layout.ParameterSection:
    """The file's own events, and after them those given."""
    if not events:
        return section
    section = section.with_group("EVENT")
    times = section.numbers("EVENT", "TIMES")
    there = times.shape[1] if times is not None and times.ndim == 2 and times.shape[0] == 2 else 0
    if times is not None and times.size and not there:
        raise ValueError(f"EVENT:TIMES has the shape {times.shape}; (2, events) is needed")
    total = there + len(events)
    if total > MOST_EVENTS:
        raise ValueError(f"it would have {total} events; {MOST_EVENTS} are allowed")
    old = np.zeros((2, 0)) if times is None or not there else times
    new = np.array([[e.time // 60.0 for e in events], [e.time % 60.0 for e in events]])
    words = [EVENT_WORDS[e.moment] for e in events]
    subject = next(iter(section.texts("EVENT", "SUBJECTS") or section.texts("SUBJECTS", "NAMES") or []), "")
    columns = {
        "CONTEXTS": [CONTEXTS[e.side] for e in events],
        "LABELS": [label for label, _, _ in words],
        "DESCRIPTIONS": [text for _, text, _ in words],
        "SUBJECTS": [subject] * len(events),
    }
    for name, texts in columns.items():
        entries = section.list_of("EVENT", name)[:there]
        section = section.with_list("EVENT", name, [*entries, *[""] * (there - len(entries)), *texts])
    for name, kind, values in (
        ("ICON_IDS", layout.INTEGER, [icon for _, _, icon in words]),
        ("GENERIC_FLAGS", 1, None),
    ):
        flags = section.numbers("EVENT", name)
        known = np.zeros(0) if flags is None else flags.ravel()[:there]
        filled = np.concatenate([known, np.zeros(there - len(known)), values or np.zeros(len(events))])
        section = section.with_numbers("EVENT", name, filled, kind)
    section = section.with_numbers("EVENT", "TIMES", np.hstack([old, new]))
    return _with_count(section, "EVENT", "USED", total)


def _with_count(section: layout.ParameterSection, group: str, name: str, value: int) -> layout.ParameterSection:
    """A whole number, in the dimensions of the one that is there."""
    old = section.numbers(group, name)
    shape = old.shape if old is not None and old.size == 1 else (1,)
    return section.with_numbers(group, name, np.full(shape, value), layout.INTEGER)
