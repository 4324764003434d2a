"""Read the binary layout of a C3D file: header, parameter records and samples.

C3D user guide (www.c3d.org): 512-byte blocks; byte 1 of block 1 is the block number of the
parameters, byte 2 is 0x50; then 16-bit words: 2 points, 3 analog values a frame, 4 first and 5 last
frame, 7-8 scale (float; negative: data are floats), 9 first data block, 10 analog samples a frame.

Parameters: four bytes (the third: number of 512-byte blocks; the fourth: processor, 84 Intel, 85
DEC, 86 MIPS), then records: length of the name (negative: locked), number of the group (negative:
this record is the group itself), the name, a 16-bit offset to the next record, counted from itself,
and the content. Of a group: length and text of its description. Of a parameter: type (-1 text, 1
byte, 2 integer, 4 float), number of dimensions, dimensions, data (first dimension fastest),
description. A record with a name of length 0 ends the section.

ezc3d reads the file; this module reads parts of it again where ezc3d is not sufficient:

- ezc3d takes the layout of a frame from the parameters. In old files without ANALOG:RATE or
  ANALOG:USED it then takes analog values for points. If the header explains the length of the file
  and the parameters do not, `read_samples` follows the header.
- Frame numbers of the header stop at 65535 or begin again at zero. The number of frames is then
  that of TRIAL, LONG_FRAMES or further rounds of the counter with which the data fill the file.
- ezc3d does not name a damaged parameter (`find_damage`).
- ezc3d does not report what it writes differently: groups without a name, and types
  (`find_changed_parameters`).
"""

import struct
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from gaitcal.arrays import Array
from gaitcal.errors import Code
from gaitcal.io.text_file import FileFault, check_readable, name_file_in_faults

BLOCK = 512
WORD = 1 << 16
"""Number of values of a 16-bit word, in which a header counts frames."""
C3D_KEY = 0x50
INTEL, DEC, MIPS = 84, 85, 86
HEADER_BYTES = 24


@dataclass(frozen=True, kw_only=True)
class C3DHeader:
    """First block of a C3D file, and the size of the file."""

    size: int  # Bytes
    processor: int
    points: int
    analog_values: int  # A frame: channels times samples a frame
    samples: int  # Analog samples a frame; 0 in some files without ANALOG:RATE
    frames: (
        int  # By the header, whose counter may have wrapped; more follow where it is `saturated`
    )
    saturated: bool  # Whether the last frame is the greatest number that the header can hold
    scale: float  # Negative where data are floats; NaN for DEC
    is_float: bool
    start: int  # Byte of the first datum

    @property
    def data_bytes(self) -> int:
        """Length of the data (bytes) by the header."""
        return self.frames * self.frame_bytes

    @property
    def frame_bytes(self) -> int:
        """Length of one frame (bytes): four words of each point, then the analog values."""
        return (4 * self.points + self.analog_values) * (4 if self.is_float else 2)

    @property
    def counts(self) -> range:
        """Numbers of frames that the 16-bit counter may stand for, up to what the file can hold."""
        return range(self.frames, (self.size - self.start) // max(self.frame_bytes, 1) + 1, WORD)

    def is_filled_by(self, data_bytes: int) -> bool:
        """Return whether data of this length (bytes) end in the last block of the file."""
        return 0 <= self.size - self.start - data_bytes < 2 * BLOCK


@name_file_in_faults
def check_c3d_header(path: Path) -> C3DHeader:
    """Read and check the header of a C3D file.

    Parameters
    ----------
    path
        The file.

    Returns
    -------
    C3DHeader
        Its header.

    Raises
    ------
    InputError
        The file is no C3D, is cut short, contradicts itself, or is neither Intel nor DEC.
    """
    size = check_readable(path)
    try:
        with path.open("rb") as file:
            head = file.read(HEADER_BYTES)
            if len(head) < HEADER_BYTES or head[1] != C3D_KEY:
                raise FileFault("this is not a C3D file (its second byte is not 0x50)")
            parameters = (head[0] - 1) * BLOCK
            if parameters < BLOCK or size < parameters + BLOCK:
                cut = f"cut short or damaged: {size} bytes end before the parameters"
                raise FileFault(cut, code=Code.DAMAGED_RECORDING)
            file.seek(parameters + 3)
            processor = file.read(1)[0]
    except OSError as error:
        raise FileFault(f"cannot be read ({error})", code=Code.UNREADABLE) from None
    if processor == MIPS:
        raise FileFault(
            "found SGI/MIPS byte order; allowed are Intel and DEC. Save the file again in Intel "
            "format"
        )
    if processor not in (INTEL, DEC):
        raise FileFault(
            f"found processor code {processor}; allowed are {INTEL} (Intel) and {DEC} (DEC)"
        )
    words = struct.unpack("<12H", head)
    header = C3DHeader(
        size=size,
        processor=processor,
        points=words[1],
        analog_values=words[2],
        samples=words[9],
        frames=(words[4] - words[3] + 1) % WORD,
        saturated=words[4] == WORD - 1,
        scale=struct.unpack("<f", head[12:16])[0] if processor == INTEL else float("nan"),
        # The sign bit of the scale sits in the last byte of an IEEE float, in the second of a DEC
        # one.
        is_float=bool(head[15 if processor == INTEL else 13] & 0x80),
        start=(words[8] - 1) * BLOCK,
    )
    if words[4] < words[3] and not any(
        header.is_filled_by(n * header.frame_bytes) for n in header.counts if n
    ):
        found = f"frame {words[3]} is its first and {words[4]} its last"
        raise FileFault(found, "header", Code.DAMAGED_RECORDING)
    if header.start < BLOCK:
        raise FileFault(
            f"its data start at block {words[8]}; allowed from 2", "header", Code.DAMAGED_RECORDING
        )
    needed = header.start + header.data_bytes
    if size < needed:
        sizes = (
            f"{size} bytes found, {needed} needed for its {header.frames} frames of "
            f"{header.points} points"
        )
        raise FileFault(f"cut short: {sizes}", code=Code.DAMAGED_RECORDING)
    return header


def find_sample_layout(
    header: C3DHeader, parameters: Mapping[str, Mapping[str, Any]], points: Array, analogs: Array
) -> C3DHeader | None:
    """Find the frame layout that fills the file, where the samples as parsed do not.

    Parameters
    ----------
    points
        (3, np, nf) Points as the parser read them.
    analogs
        (na, ns) Analog samples as the parser read them.

    Returns
    -------
    C3DHeader or None
        The header with its true number of frames; None if the samples as parsed are right.
    """
    read = (4 * points[0].size + analogs.size) * (4 if header.is_float else 2)
    if not header.frame_bytes or (header.is_filled_by(read) and points.shape[2] != header.frames):
        return None
    trial, point = parameters.get("TRIAL", {}), parameters.get("POINT", {})
    start, end = (
        read_long_number(trial.get(f"ACTUAL_{name}_FIELD", ())) for name in ("START", "END")
    )
    given = [read_long_number(point.get(name, ())) for name in ("LONG_FRAMES", "FRAMES")]
    counts = [
        *header.counts,
        *([end - start + 1] if start and end else []),
        *(count for count in given if count),
    ]
    if header.saturated:
        counts.append((header.size - header.start) // header.frame_bytes)
    whole = next((n for n in counts if n > 0 and header.is_filled_by(n * header.frame_bytes)), None)
    return replace(header, frames=whole) if whole and whole * header.frame_bytes != read else None


def read_long_number(parts: Any) -> int | None:
    """Read a number from two 16-bit values (the lower first) or from one float.

    Parameters
    ----------
    parts
        One or two numbers.

    Returns
    -------
    int or None
        None if there is no such number.
    """
    values = np.asarray(parts, dtype=np.float64).ravel()
    if not 1 <= len(values) <= 2 or not np.isfinite(values).all():
        return None
    return (
        int(values[0])
        if len(values) == 1
        else int(values[0]) % WORD + WORD * (int(values[1]) % WORD)
    )


def read_samples(
    path: Path, header: C3DHeader, parameters: Mapping[str, Mapping[str, Any]]
) -> tuple[Array, Array]:
    """Read the samples of a C3D file by the layout of its header.

    Parameters
    ----------
    path
        The file.
    header
        Its header, from `find_sample_layout`.
    parameters
        Group -> parameter -> value, for the scales of the channels.

    Returns
    -------
    points, analogs
        (3, np, nf), NaN where missing, and (na, ns), both in the units of the file.

    Raises
    ------
    FileFault
        The file is not Intel, or cannot be read.
    """
    if header.processor != INTEL:
        raise FileFault(
            "found DEC encoding and parameters that do not fit; save the file again in Intel format"
        )
    kind = np.dtype("<f4") if header.is_float else np.dtype("<i2")
    length = header.data_bytes // kind.itemsize
    try:
        raw = np.fromfile(path, dtype=kind, count=length, offset=header.start).astype(np.float64)
    except OSError as error:
        raise FileFault(f"cannot be read ({error})", code=Code.UNREADABLE) from None
    # A frame: x y z and residual of every point, then `samples` times all channels. A negative
    # residual is a gap.
    rows = raw.reshape(header.frames, -1)
    # Zeros that fill the last block are no frames, where only the length of the file counts them
    if header.saturated:
        rows = rows[: np.flatnonzero(rows.any(axis=1))[-1] + 1] if rows.any() else rows[:1]
    quads = rows[:, : 4 * header.points].reshape(len(rows), header.points, 4)
    points = quads[:, :, :3] * (1.0 if header.is_float else header.scale)
    points[quads[:, :, 3] < 0] = np.nan
    samples = max(1, header.samples)
    if header.analog_values % samples:
        samples = 1
    analogs = rows[:, 4 * header.points :].reshape(len(rows) * samples, -1).T
    group = parameters.get("ANALOG", {})

    def per_channel(name: str, default: float) -> Array:
        """(na, 1), completed where the parameter names too few channels."""
        given = np.asarray(group.get(name, []), dtype=np.float64).ravel()[: len(analogs)]
        return np.concatenate([given, np.full(len(analogs) - len(given), default)])[:, None]

    scaled = (analogs - per_channel("OFFSET", 0.0)) * per_channel("SCALE", 1.0)
    general = np.asarray(group.get("GEN_SCALE", [1.0]), dtype=np.float64).ravel()
    return points.transpose(2, 1, 0), scaled * (general[0] if len(general) else 1.0)


# --------------------------------------------------------------------------------------- parameters

TEXT, FLOAT = -1, 4
_KINDS = (TEXT, 1, 2, FLOAT)


@dataclass(frozen=True)
class Record:
    """Record of the parameter section: a group, or a parameter of one."""

    group: int  # Number of the group, positive
    name: str
    content: bytes  # What follows the offset
    is_group: bool


def _read_extent(content: bytes) -> tuple[int, tuple[int, ...], int]:
    """Read type and dimensions of a parameter, and the position at which its data end."""
    kind, count = struct.unpack("<bB", content[:2])
    dims = tuple(content[2 : 2 + count])
    return kind, dims, 2 + count + abs(kind) * int(np.prod(dims))


def parse_records(content: bytes) -> tuple[Record, ...]:
    """Parse the parameter section of a C3D file into its records.

    Returns: in the order of the file. Raises ValueError, IndexError, struct.error: the section is
    damaged.
    """
    start = (content[0] - 1) * BLOCK
    section = content[start : start + content[start + 2] * BLOCK]
    records: list[Record] = []
    at = 4
    while at + 1 < len(section) and section[at] != 0:
        length, group = struct.unpack("<bb", section[at : at + 2])
        name = section[at + 2 : at + 2 + abs(length)].decode("latin-1")
        at += 2 + abs(length)
        if at + 2 > len(section):
            raise ValueError("its parameters are cut short")
        (offset,) = struct.unpack("<H", section[at : at + 2])
        if offset:
            end = at + offset
        else:
            # Some programs write the offset of the last record as 0
            end = at + 2 if group < 0 else at + 2 + _read_extent(section[at + 2 :])[2]
            end += 1 + section[end]
        if end > len(section) or end < at + 3:
            raise ValueError(f"{_name_parameter(name)} is damaged")
        records.append(Record(abs(group), name, section[at + 2 : end], is_group=group < 0))
        if offset == 0:
            break
        at = end
    return tuple(records)


def _name_parameter(name: str) -> str:
    """Name a parameter for a message; after damage a name may consist of any bytes."""
    return (
        f"the parameter {name}"
        if name.isidentifier() and name.isascii()
        else "a record of its parameters"
    )


def find_damage(content: bytes) -> str:
    """Describe the first damaged parameter of a C3D file.

    Parameters
    ----------
    content
        All bytes of the file.

    Returns
    -------
    str
        Empty if every record can be read.
    """
    try:
        for record in (record for record in parse_records(content) if not record.is_group):
            kind, _, end = _read_extent(record.content)
            if kind not in _KINDS:
                name = _name_parameter(record.name)
                return f"{name} has the type {kind}; allowed are -1, 1, 2 and 4"
            if end > len(record.content):
                return f"{_name_parameter(record.name)} is longer than its record"
    except (ValueError, IndexError, struct.error) as fault:
        return str(fault) if isinstance(fault, ValueError) else "its parameters are cut short"
    return ""


def find_changed_parameters(source: bytes, target: bytes) -> tuple[str, ...]:
    """List the parameters of one C3D file that another lacks or holds with other types or values.

    Parameters
    ----------
    source, target
        All bytes of the two files.

    Returns
    -------
    tuple of str
        Names `GROUP:NAME`.
    """
    old, new = _read_values(source), _read_values(target)
    return tuple(
        name for name, value in old.items() if new.get(name.upper(), new.get(name)) != value
    )


def _read_values(content: bytes) -> dict[str, tuple[int, tuple[int, ...], list[bytes]]]:
    """Read `GROUP:NAME` -> type, table shape, and texts without trailing blanks, or the numbers."""
    records, out = parse_records(content), {}
    is_dec = content[(content[0] - 1) * BLOCK + 3] == DEC
    groups = {record.group: record.name for record in records if record.is_group}
    for record in (record for record in records if not record.is_group):
        kind, dims, end = _read_extent(record.content)
        data = record.content[2 + len(dims) : end]
        if kind == FLOAT and is_dec:
            # The halves of a DEC float are swapped, and its exponent is greater by two
            halves = np.frombuffer(data, dtype="<u2").reshape(-1, 2)[:, ::-1].tobytes()
            data = (np.frombuffer(halves, dtype="<f4") * np.float32(0.25)).tobytes()
        width = dims[0] if kind == TEXT and dims else 0
        values = (
            [data[at : at + width].rstrip(b" \0") for at in range(0, len(data), width)]
            if width
            else [data]
        )
        table = dims[1:-1] if kind == TEXT else ()
        name = f"{groups.get(record.group, record.group)}:{record.name}"
        out[name] = kind, table, [value for value in values if value]
    return out
