"""A copy of a C3D file with further points, events and parameters; what was in it stays as it was.

Of a file of floats, every word of its points, residuals, camera masks and analog samples is copied as it stands. A
file of integers becomes one of floats, as ours do not fit its steps: analog samples, residuals and camera masks keep
their values exactly, coordinates are those integers times the file's scale, to the precision of a 32-bit float.
Parameters that are not concerned are copied byte for byte (`parameter_section.py`).
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

import numpy as np

from gaitcal.arrays import Array
from gaitcal.codes import Code
from gaitcal.errors import InputError
from gaitcal.io.c3d.layout import BLOCK, DEC, C3DHeader, check_c3d_header
from gaitcal.io.c3d.parser import INTEGER, ParameterSection, decode_floats, encode_floats, parse_section
from gaitcal.io.labels import FootEvent, FootMoment

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
    PLACE = ("MODELED_MARKERS", "MODELED_MARKER")


@dataclass(frozen=True, kw_only=True)
class AddedPoint:
    """A point to be added."""

    name: str
    kind: PointKind
    values: Array
    """(nf, 3) for every frame of the file, in its axes and units; NaN where unknown."""
    description: str = ""


@dataclass(frozen=True, kw_only=True)
class C3DOriginal:
    """A C3D file that is to be supplemented, in its own axes and units."""

    path: Path
    content: bytes
    header: C3DHeader
    section: ParameterSection
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
            values = decode_floats(rows[:, :own].tobytes(), self.header.processor).astype(np.float64)
        else:
            values = _as_floats(rows, self)[:, :own]
        return values.reshape(self.frames, self.header.points, 4)[:, :, :3]


def c3d_original(path: Path, frames: int) -> C3DOriginal:
    """The C3D file at `path`, of so many frames as its reader counts; InputError where it is damaged."""
    header = check_c3d_header(path)
    content = path.read_bytes()
    at = (content[0] - 1) * BLOCK
    try:
        section = parse_section(content[at : at + content[at + 2] * BLOCK])
    except (ValueError, IndexError, struct.error) as fault:
        raise InputError(f"damaged: {fault}", source=path, code=Code.DAMAGED_RECORDING) from None
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
    points : their names must be new.
    group : a group of parameters of that name, each a list of text.
    units : POINT parameter -> unit, such as `ANGLE_UNITS`, where the file has none.

    Raises
    ------
    InputError
        The file cannot take them: its layout is damaged, or a limit of the format is met.
    """
    header, content = original.header, original.content
    at = (content[0] - 1) * BLOCK
    try:
        section = _with_points(original.section, header.points, points, units or {})
        section = _with_events(section, events)
        if group is not None:
            section = section.with_group(group[0], "what gaitcal added to this file")
            for name, texts in group[1].items():
                section = section.with_list(group[0], name, texts)
        start = at + len(section.to_bytes())
        section = _with_count(section, "POINT", "DATA_START", start // BLOCK + 1)
        out = bytearray(content[:at]) + section.to_bytes()
        out[2:4] = (header.points + len(points)).to_bytes(2, "little")
        out[13 if header.processor == DEC else 15] |= 0x80  # a negative scale: floats
        out[16:18] = (start // BLOCK + 1).to_bytes(2, "little")
        out += _data(original, points)
    except (ValueError, OverflowError, IndexError, StopIteration, struct.error) as fault:
        raise InputError(
            f"cannot be given further points: {fault}", source=original.path, code=Code.NOT_WRITABLE
        ) from None
    target.write_bytes(bytes(out) + bytes(-len(out) % BLOCK))


def _rows(original: C3DOriginal) -> Array:
    """(frames, width) words of the file: four of each point, then the analog samples of the frame."""
    header = original.header
    width = 4 * header.points + header.analog_values
    kind = np.dtype("<u4" if header.is_float else "<i2")
    if header.start + original.frames * width * kind.itemsize > len(original.content):
        raise InputError(
            f"ends before its {original.frames} frames do", source=original.path, code=Code.DAMAGED_RECORDING
        )
    return np.frombuffer(original.content, kind, original.frames * width, header.start).reshape(original.frames, width)


def _data(original: C3DOriginal, points: Sequence[AddedPoint]) -> bytes:
    """All frames, each the file's own points, ours, and the analog samples."""
    header, frames, rows = original.header, original.frames, _rows(original)
    own = 4 * header.points
    if not header.is_float:
        rows = _words(_as_floats(rows, original), header.processor)
    added = np.zeros((frames, len(points), 4))
    for number, point in enumerate(points):
        if point.values.shape != (frames, 3):
            raise ValueError(f"{point.name} has values of shape {point.values.shape}")
        known = np.asarray(np.isfinite(point.values).all(axis=1))
        added[:, number, :3] = np.where(known[:, None], point.values, 0.0)
        added[:, number, 3] = np.where(known, 0.0, -1.0)
    ours = _words(added.reshape(frames, -1), header.processor)
    return np.hstack([rows[:, :own], ours, rows[:, own:]]).tobytes()


def _words(values: Array, processor: int) -> Array:
    """Numbers as the 32-bit words of the file."""
    return np.frombuffer(encode_floats(values, processor), dtype="<u4").reshape(values.shape)


def _as_floats(rows: Array, original: C3DOriginal) -> Array:
    """(frames, width) the numbers that a file of integers means: coordinates scaled, all others as they are."""
    own = 4 * original.header.points
    scale = decode_floats(original.content[12:16], original.header.processor)[0]
    values = rows.astype(np.float64)
    places = values[:, :own].reshape(len(rows), -1, 4)
    places[:, :, :3] *= scale
    if "UNSIGNED" in [word.upper() for word in original.section.texts("ANALOG", "FORMAT") or []]:
        values[:, own:] = rows[:, own:].astype("<u2")
    return np.asarray(values)


def _with_points(
    section: ParameterSection, count: int, points: Sequence[AddedPoint], units: Mapping[str, str]
) -> ParameterSection:
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


def _with_events(section: ParameterSection, events: Sequence[FootEvent]) -> ParameterSection:
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
    for name, kind, values in (("ICON_IDS", INTEGER, [icon for _, _, icon in words]), ("GENERIC_FLAGS", 1, None)):
        flags = section.numbers("EVENT", name)
        known = np.zeros(0) if flags is None else flags.ravel()[:there]
        filled = np.concatenate([known, np.zeros(there - len(known)), values or np.zeros(len(events))])
        section = section.with_numbers("EVENT", name, filled, kind)
    section = section.with_numbers("EVENT", "TIMES", np.hstack([old, new]))
    return _with_count(section, "EVENT", "USED", total)


def _with_count(section: ParameterSection, group: str, name: str, value: int) -> ParameterSection:
    """A whole number, in the dimensions of the one that is there."""
    old = section.numbers(group, name)
    shape = old.shape if old is not None and old.size == 1 else (1,)
    return section.with_numbers(group, name, np.full(shape, value), INTEGER)
