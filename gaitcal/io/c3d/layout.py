"""What the first blocks of a C3D file say of its layout: checked before a parser is let loose on it, and followed
where the parser goes astray.

Layout (C3D user guide, www.c3d.org): 512-byte blocks; byte 1 of block 1 is the block number of the parameters, byte 2
is 0x50; then 16-bit words: 2 points, 3 analog values a frame, 4 first and 5 last frame, 7-8 scale (float; negative:
data are floats), 9 first data block, 10 analog samples a frame. Byte 4 of the parameter section is the processor:
84 Intel, 85 DEC, 86 MIPS.

ezc3d takes the layout of a frame from the parameters. Old files may lack ANALOG:RATE or ANALOG:USED, and are then
read askew, without complaint: the analog values of one frame pass for points of the next. Where the header accounts
for the length of the file and the parameters do not, the header is right, and `read_samples` follows it.

Facts about the person, and foot events, from the parameters of a C3D file.

PROCESSING is where Vicon's programs keep what was measured by hand: kg and mm, angles in rad. EVENT is the standard's
own group: TIMES is (2, n), minutes and seconds from the beginning of the recording, as the frames count.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from gaitcal.arrays import Array
from gaitcal.codes import Code
from gaitcal.errors import InputError
from gaitcal.io.labels import Facts, FootEvent, FootMoment, clean
from gaitcal.io.text_file import readable_size

BLOCK = 512
C3D_KEY = 0x50
INTEL, DEC, MIPS = 84, 85, 86
HEADER_BYTES = 24


@dataclass(frozen=True, kw_only=True)
class C3DHeader:
    """The first block of a C3D file, and the size of the file."""

    size: int
    """Bytes."""
    processor: int
    points: int
    analog_values: int
    """A frame: channels times samples a frame."""
    samples: int
    """Analog samples a frame; 0 in some files without ANALOG:RATE."""
    first_frame: int
    last_frame: int
    scale: float
    """Negative where data are floats; NaN for DEC."""
    is_float: bool
    start: int
    """Byte of the first datum."""

    @property
    def frames(self) -> int:
        """Frames by the header; more may follow where the last is 65535."""
        return self.last_frame - self.first_frame + 1

    @property
    def data_bytes(self) -> int:
        """Length of the data by the header."""
        return self.frames * (4 * self.points + self.analog_values) * (4 if self.is_float else 2)


def check_c3d_header(path: Path) -> C3DHeader:
    """The header; InputError where it is no C3D, is cut short, or has an encoding we do not read."""
    size = readable_size(path)
    try:
        with path.open("rb") as file:
            head = file.read(HEADER_BYTES)
            if len(head) < HEADER_BYTES or head[1] != C3D_KEY:
                raise InputError(
                    "this is not a C3D file (its second byte is not 0x50)", source=path, code=Code.FILE_FORMAT
                )
            parameters = (head[0] - 1) * BLOCK
            if parameters < BLOCK or size < parameters + BLOCK:
                raise InputError(
                    f"cut short or damaged: {size} bytes end before the parameters",
                    source=path,
                    code=Code.DAMAGED_RECORDING,
                )
            file.seek(parameters + 3)
            processor = file.read(1)[0]
    except OSError as error:
        raise InputError(f"cannot be read ({error})", source=path, code=Code.UNREADABLE) from None
    if processor == MIPS:
        raise InputError(
            "found SGI/MIPS byte order; allowed are Intel and DEC. Save the file again in Intel format",
            source=path,
            code=Code.FILE_FORMAT,
        )
    if processor not in (INTEL, DEC):
        raise InputError(
            f"found processor code {processor}; allowed are {INTEL} (Intel) and {DEC} (DEC)",
            source=path,
            code=Code.FILE_FORMAT,
        )
    return _checked(path, _header(size, head, processor))


def _header(size: int, head: bytes, processor: int) -> C3DHeader:
    words = struct.unpack("<12H", head)
    scale = struct.unpack("<f", head[12:16])[0] if processor == INTEL else float("nan")
    # The sign bit of the scale sits in the last byte of an IEEE float, in the second of a DEC one.
    is_float = bool(head[15 if processor == INTEL else 13] & 0x80)
    return C3DHeader(
        size=size,
        processor=processor,
        points=words[1],
        analog_values=words[2],
        samples=words[9],
        first_frame=words[3],
        last_frame=words[4],
        scale=scale,
        is_float=is_float,
        start=(words[8] - 1) * BLOCK,
    )


def _checked(path: Path, header: C3DHeader) -> C3DHeader:
    """The header, unless it contradicts itself or the length of the file."""
    if header.frames < 1:
        found = f"frame {header.first_frame} is its first and {header.last_frame} its last"
        raise InputError(found, source=path, field="header", code=Code.DAMAGED_RECORDING)
    if header.start < BLOCK:
        found = f"its data start at block {header.start // BLOCK + 1}; allowed from 2"
        raise InputError(found, source=path, field="header", code=Code.DAMAGED_RECORDING)
    needed = header.start + header.data_bytes
    if header.size < needed:
        raise InputError(
            f"cut short: {header.size} bytes found, {needed} needed for its {header.frames} frames of "
            f"{header.points} points",
            source=path,
            code=Code.DAMAGED_RECORDING,
        )
    return header


def is_askew(header: C3DHeader, points: Array, analogs: Array) -> bool:
    """True where points (3, np, nf) and analogs (na, ns) do not fill the file, while the header does."""
    frames = points.shape[2]
    values = frames * 4 * points.shape[1] + analogs.size
    filled = values * (4 if header.is_float else 2)
    room = header.size - header.start
    fits = 0 <= room - header.data_bytes < 2 * BLOCK
    return frames == header.frames and filled != header.data_bytes and fits


def read_samples(path: Path, header: C3DHeader, parameters: Mapping[str, Mapping[str, Any]]) -> tuple[Array, Array]:
    """Points (3, np, nf), NaN where missing, and analogs (na, ns), both in the units of the file."""
    if header.processor != INTEL:
        raise InputError(
            "found DEC encoding without ANALOG:RATE; save the file again in Intel format",
            source=path,
            code=Code.FILE_FORMAT,
        )
    kind = np.dtype("<f4") if header.is_float else np.dtype("<i2")
    length = header.data_bytes // kind.itemsize
    try:
        raw = np.fromfile(path, dtype=kind, count=length, offset=header.start).astype(np.float64)
    except OSError as error:
        raise InputError(f"cannot be read ({error})", source=path, code=Code.UNREADABLE) from None
    # a frame: x y z and residual of every point, then `samples` times all channels; a negative residual is a gap
    rows = raw.reshape(header.frames, -1)
    quads = rows[:, : 4 * header.points].reshape(header.frames, header.points, 4)
    points = quads[:, :, :3] * (1.0 if header.is_float else header.scale)
    points[quads[:, :, 3] < 0] = np.nan
    samples = max(1, header.samples)
    if header.analog_values % samples:
        samples = 1
    analogs = rows[:, 4 * header.points :].reshape(header.frames * samples, -1).T
    group = parameters.get("ANALOG", {})
    count = len(analogs)
    scaled = (analogs - _per_channel(group, "OFFSET", count, 0.0)) * _per_channel(group, "SCALE", count, 1.0)
    general = np.asarray(group.get("GEN_SCALE", [1.0]), dtype=np.float64).ravel()
    return points.transpose(2, 1, 0), scaled * (general[0] if len(general) else 1.0)


def _per_channel(group: Mapping[str, Any], name: str, count: int, default: float) -> Array:
    """(count, 1) of an ANALOG parameter, completed where it names too few channels."""
    given = np.asarray(group.get(name, []), dtype=np.float64).ravel()[:count]
    return np.concatenate([given, np.full(count - len(given), default)])[:, None]


MILLIMETRE: Final = 1e-3
GRAVITY_M_S2: Final = 9.80665
MASS_KG, HEIGHT_M = (2.0, 400.0), (0.3, 2.6)
"""Outside of these a number is no mass, no height: 0 stands where nobody filled in the form."""
WIDTH_M, LENGTH_M = (0.02, 0.3), (0.1, 1.5)
PERSON_KG, PERSON_M = (5.0, 250.0), (0.5, 2.3)
"""Of a person whose figures are in another unit than they should be: a guess has to be a likely one."""
KNEE_M, ANKLE_M = (0.05, 0.2), (0.03, 0.15)
CENTIMETRE: Final = 1e-2
OTHER_MASSES: Final = {"N": 1 / GRAVITY_M_S2, "g": 1e-3}
OTHER_HEIGHTS: Final = {"cm": CENTIMETRE, "inches": 0.0254}
OTHER_WIDTHS: Final = {"cm": CENTIMETRE}
SIDES: Final = {"right": "r", "left": "l"}
MOMENTS: Final = {
    "foot strike": FootMoment.STRIKE,
    "heel strike": FootMoment.STRIKE,
    "initial contact": FootMoment.STRIKE,
    "foot contact": FootMoment.STRIKE,
    "foot off": FootMoment.OFF,
    "toe off": FootMoment.OFF,
}


_Doubt = tuple[str, float | None] | None
"""A figure that cannot be in its unit, in words, and what it is in the only other unit that fits."""


def facts_of(parameters: Mapping[str, Mapping[str, Any]]) -> Facts:
    """What the groups PROCESSING and SUBJECTS say; a number that cannot be meant is taken as not given."""
    group = {str(name).lower(): value for name, value in parameters.get("PROCESSING", {}).items()}
    subjects = parameters.get("SUBJECTS", {})

    def number(names: Iterable[str], unit: float, allowed: tuple[float, float]) -> float | None:
        for name in names:
            value = _first_number(group.get(name.lower()))
            if value and allowed[0] <= value * unit <= allowed[1]:  # 0 stands where nobody filled in the form
                return value * unit
        return None

    def sided(name: str, unit: float, allowed: tuple[float, float]) -> dict[str, float]:
        found = {s: number([f"{s.upper()}{name}"], unit, allowed) for s in SIDES.values()}
        return {s: value for s, value in found.items() if value is not None}

    def doubt(
        names: Iterable[str], why: str, others: Mapping[str, float], allowed: tuple[float, float], si: str
    ) -> _Doubt:
        for name in names:
            if value := _first_number(group.get(name.lower())):
                told = {unit: value * by for unit, by in others.items() if allowed[0] <= value * by <= allowed[1]}
                if not told:
                    continue  # no figure of a person in any unit: a form that nobody filled in
                words = " or ".join(f"{meant:.4g} {si} if {unit}" for unit, meant in told.items())
                text = f"{name} = {value:g}: {why}; {words}"
                return text, next(iter(told.values())) if len(told) == 1 else None
        return None

    masses, heights = ("Bodymass", "Mass", "Weight"), ("Height",)
    mass = number(masses, 1.0, MASS_KG)
    height = number(heights, MILLIMETRE, HEIGHT_M) or number(heights, 1.0, HEIGHT_M)
    knee, ankle = sided("KneeWidth", MILLIMETRE, WIDTH_M), sided("AnkleWidth", MILLIMETRE, WIDTH_M)
    doubts = {
        "mass": None if mass else doubt(masses, "no mass in kg", OTHER_MASSES, PERSON_KG, "kg"),
        "height": None if height else doubt(heights, "no height in mm or m", OTHER_HEIGHTS, PERSON_M, "m"),
    }
    for field, sides, name, allowed in (
        ("knee_width", knee, "KneeWidth", KNEE_M),
        ("ankle_width", ankle, "AnkleWidth", ANKLE_M),
    ):
        for s in [s for s in SIDES.values() if s not in sides]:
            doubts[f"{field}_{s}"] = doubt([f"{s.upper()}{name}"], "no width in mm", OTHER_WIDTHS, allowed, "m")
    static = _first_number(subjects.get("IS_STATIC"))
    return Facts(
        name=_first_text(subjects.get("NAMES")),
        mass=mass,
        height=height,
        marker_set=_first_text(subjects.get("MARKER_SETS")),
        marker_diameter=number(("MarkerDiameter",), MILLIMETRE, (0.003, 0.04)),
        asis_distance=number(("InterAsisDistance",), MILLIMETRE, (0.08, 0.5)),
        knee_width=knee,
        ankle_width=ankle,
        leg_length=sided("LegLength", MILLIMETRE, LENGTH_M),
        static_plantarflexion=sided("StaticPlantFlex", 1.0, (-1.5, 1.5)),
        doubtful={field: told for field, told in doubts.items() if told is not None},
        is_static=bool(static) if static else None,
    )


def events_of(parameters: Mapping[str, Mapping[str, Any]]) -> tuple[FootEvent, ...]:
    """Foot strikes and offs with a side, in order of time."""
    group = parameters.get("EVENT", {})
    labels, contexts = _texts(group.get("LABELS")), _texts(group.get("CONTEXTS"))
    times = np.asarray(group.get("TIMES", ()), dtype=np.float64)
    if times.ndim != 2 or times.shape[0] != 2:
        return ()
    seconds = 60.0 * times[0] + times[1]
    events = [
        FootEvent(MOMENTS[label.lower()], SIDES[context.lower()], float(second))
        for label, context, second in zip(labels, contexts, seconds, strict=False)
        if label.lower() in MOMENTS and context.lower() in SIDES and np.isfinite(second)
    ]
    return tuple(sorted(events, key=lambda e: e.time))


def _texts(values: Any) -> list[str]:
    return [clean(text) if isinstance(text, str) else "" for text in ([] if values is None else values)]


def _first_text(values: Any) -> str | None:
    return next((text for text in _texts(values) if text), None)


def _first_number(values: Any) -> float | None:
    try:
        found = np.asarray(values, dtype=np.float64).ravel()
    except (TypeError, ValueError):
        return None
    return float(found[0]) if len(found) and np.isfinite(found[0]) else None
