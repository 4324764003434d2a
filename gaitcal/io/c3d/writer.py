"""Write C3D files: from a recording, or as a copy with further points, events and parameters.

From a recording: the usual form of Vicon, millimetres, z up, type-2 plates. C3D holds 32-bit
floats, so markers and wrenches are kept to 1e-7 of their size.

As a copy: ezc3d reads and writes the file, with points, residuals and analog samples as 32-bit
floats. A file of integers becomes one of floats. Parameters that change otherwise are returned.
"""

import itertools
import struct
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np

from gaitcal.arrays import Array
from gaitcal.errors import Code, InputError
from gaitcal.io import atomic, force_plate, text_file
from gaitcal.io.axes import AxisPermutation
from gaitcal.io.c3d import layout
from gaitcal.io.labels import FootEvent, FootMoment
from gaitcal.io.recording import ForcePlate, Recording, require_plain_labels

# From y up to z up: the inverse of UP_TO_Y[2, 1]
Y_TO_Z_UP = AxisPermutation((0, 2, 1), (1, -1, 1))
CHANNEL_NAMES = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
MARGIN_M = 0.1  # Around the points of a plate whose corners are unknown
MOST_FRAMES = 65535  # First and last frame are 16-bit numbers
MOST_LABELS = 255  # A list of names counts them in one byte
LONGEST_TEXT = 255  # Bytes
INTEGER_TYPE = 2  # Type of a parameter
UNIFORM_TOLERANCE_SAMPLES = 1e-3  # Departure, in samples, up to which times count as uniform


def _make_fault(message: str, field: str | None = None) -> text_file.FileFault:
    return text_file.FileFault(message, field, Code.NOT_WRITABLE)


@text_file.name_file_in_faults
def write_c3d(path: Path, recording: Recording) -> None:
    """Write markers and plates as a C3D file that `read_recording` reads back.

    A plate without corners gets a rectangle around its points of application.

    Parameters
    ----------
    path
        File to write.
    recording
        Markers and plates, m and N, y up. Times must be uniform and start at a whole number of
        frames. Plates need a whole multiple of the marker rate and the same first and last frame.

    Raises
    ------
    InputError
        The format cannot hold the recording, or the file cannot be written.
    """
    import ezc3d

    require_plain_labels(recording)
    if len(recording.labels) > MOST_LABELS:
        raise _make_fault(
            f"{len(recording.labels)} markers found; at most {MOST_LABELS} are allowed"
        )
    rate, first = _find_uniform_rate(recording.time)
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
    with atomic.write_atomically(path) as part:
        written = part.with_suffix(".c3d")  # ezc3d adds this ending to any other, .C3D too
        try:
            file.write(str(written))
        except (RuntimeError, ValueError) as error:
            raise _make_fault(f"cannot be written ({error})") from None
        written.replace(part)


def _find_uniform_rate(time: Array) -> tuple[float, int]:
    """Find the frame rate (Hz), and the number of the first frame counted from 0."""
    if len(time) == 1:
        return 100.0, round(100.0 * float(time[0]))
    rate = (len(time) - 1) / float(time[-1] - time[0])
    if abs(rate - round(rate)) < 1e-6 * rate:
        rate = float(round(rate))
    first = round(float(time[0]) * rate)
    away = float(np.max(np.abs((first + np.arange(len(time))) - time * rate)))
    if away > UNIFORM_TOLERANCE_SAMPLES:
        raise _make_fault(
            f"times differ by up to {away:.2g} frames from a constant frame rate; C3D needs one"
        )
    if first < 0 or first + len(time) > MOST_FRAMES:
        raise _make_fault(
            f"frames {first + 1} to {first + len(time)} found; 1 to {MOST_FRAMES} are allowed"
        )
    return rate, first


def _add_plates(
    file: Any, plates: tuple[ForcePlate, ...], rate: float, frames: int, start: float
) -> None:
    samples = len(plates[0].time)
    ratio = samples // frames
    for plate in plates:
        steps, count = (plate.time - start) * rate * ratio, len(plate.time)
        uniform = samples == ratio * frames and count == samples
        if not uniform or np.abs(steps - np.arange(samples)).max() > UNIFORM_TOLERANCE_SAMPLES:
            raise _make_fault(
                f"{count} samples from {plate.time[0]:.4f} s for {frames} frames from {start:.4f} "
                "s; a whole number of "
                "samples a frame, from the first frame on, is needed",
                f"plate {plate.name}",
            )
        if not np.isfinite(plate.wrench()).all():
            raise _make_fault(
                "its wrench contains NaN, which C3D channels cannot store", f"plate {plate.name}"
            )
    parts = [_express_in_plate_frame(plate) for plate in plates]
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


def _express_in_plate_frame(plate: ForcePlate) -> tuple[Array, Array]:
    """Express a plate in its frame: corners (4, 3) m, z up, and channels (6, ns) N, N·mm."""
    corners = Y_TO_Z_UP.apply(_order_corners(plate))
    # Rounded as the file will hold them
    corners = (1e3 * corners).astype(np.float32).astype(np.float64) / 1e3
    frame = force_plate.build_plate_frame(corners)
    wrench = plate.wrench()
    force = Y_TO_Z_UP.apply(wrench[:, :3])
    moment = Y_TO_Z_UP.apply(wrench[:, 3:]) - np.cross(frame.centre, force)
    return corners, np.concatenate([(force @ frame.rotation).T, 1e3 * (moment @ frame.rotation).T])


def _order_corners(plate: ForcePlate) -> Array:
    """Order corners (4, 3) m, y up, so that the plate's z points down; a rectangle if unknown."""
    if plate.corners is None:
        points = plate.point[plate.force[:, 1] > 0]
        points = points if len(points) else plate.point
        low, high = points.min(axis=0) - MARGIN_M, points.max(axis=0) + MARGIN_M
        y = float(np.median(points[:, 1]))
        # x forward and z right here are x and -y of the file: +x +y, -x +y, -x -y, +x -y seen from
        # below.
        return np.array(
            [[high[0], y, high[2]], [low[0], y, high[2]], [low[0], y, low[2]], [high[0], y, low[2]]]
        )
    normal = np.cross(plate.corners[0] - plate.corners[1], plate.corners[0] - plate.corners[3])
    return plate.corners if normal[1] < 0 else plate.corners[[1, 0, 3, 2]]


# ----------------------------------------------------------------------- a copy with further points

CONTEXTS = {"r": "Right", "l": "Left"}
EVENT_LABELS = {
    FootMoment.STRIKE: ("Foot Strike", "The instant the heel strikes the ground (gaitcal)", 1),
    FootMoment.OFF: ("Foot Off", "The instant the toe leaves the ground (gaitcal)", 2),
}
"""Label, description and icon as in Vicon's programs."""
MOST_EVENTS = 255
POINT_PARAMETERS = frozenset(
    (
        *(f"POINT:{name}" for name in ("USED", "LABELS", "DESCRIPTIONS", "DATA_START", "SCALE")),
        *(f"POINT:{name}" for name in ("ANGLES", "MOMENTS", "POWERS", "FORCES", "MODELED_MARKERS")),
    )
)
EVENT_PARAMETERS = frozenset(
    f"EVENT:{name}"
    for name in (
        *("USED", "TIMES", "CONTEXTS", "LABELS"),
        *("DESCRIPTIONS", "SUBJECTS", "ICON_IDS", "GENERIC_FLAGS"),
    )
)
"""Parameters that change if events are added (`POINT_PARAMETERS`: points)."""


class PointKind(Enum):
    """Kind of the three numbers of a point: the list of POINT that names it, and its singular."""

    ANGLE = ("ANGLES", "ANGLE")
    MOMENT = ("MOMENTS", "MOMENT")
    POWER = ("POWERS", "POWER")
    FORCE = ("FORCES", "FORCE")
    POSITION = ("MODELED_MARKERS", "MODELED_MARKER")


@dataclass(frozen=True, kw_only=True)
class AddedPoint:
    """Point to be added to a C3D file."""

    name: str
    kind: PointKind
    values: Array  # (nf, 3) for every frame of the file, in its axes and units; NaN where unknown
    description: str = ""


@dataclass(frozen=True, kw_only=True)
class C3DOriginal:
    """C3D file to be supplemented, in its axes and units."""

    path: Path
    header: layout.C3DHeader
    file: Any  # The `ezc3d.c3d` of it, its samples laid out as `read_c3d` has them

    @property
    def frames(self) -> int:
        """Number of frames."""
        return int(self.file["data"]["points"].shape[2])

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of its points, as far as they have names."""
        return tuple(
            _read_list(self.file, "POINT", "LABELS")[: self.file["data"]["points"].shape[1]]
        )

    def get_unit(self, name: str) -> str:
        """Get a POINT parameter that names a unit, such as `ANGLE_UNITS`; empty if missing."""
        return next(iter(_read_list(self.file, "POINT", name)), "")

    def get_positions(self) -> Array:
        """Get (nf, np, 3) coordinates of all points, NaN where they are missing."""
        return np.asarray(self.file["data"]["points"][:3].transpose(2, 1, 0))


@text_file.name_file_in_faults
def open_c3d_original(path: Path, frames: int) -> C3DOriginal:
    """Open a C3D file that `read_c3d` could read.

    Parameters
    ----------
    path
        The file.
    frames
        Number of frames that were read from it.

    Returns
    -------
    C3DOriginal
        The file, its samples laid out as `read_c3d` reads them.

    Raises
    ------
    InputError
        The file is damaged, or has another number of frames.
    """
    import ezc3d

    header = layout.check_c3d_header(path)
    try:
        file = ezc3d.c3d(str(path))
    except (RuntimeError, ValueError, IndexError) as fault:
        raise text_file.FileFault(f"damaged: {fault}", code=Code.DAMAGED_RECORDING) from None
    points, analogs = file["data"]["points"], file["data"]["analogs"]
    parameters = {
        group: {name: entry["value"] for name, entry in entries.items() if name != "__METADATA__"}
        for group, entries in file["parameters"].items()
    }
    whole = layout.find_sample_layout(header, parameters, points[:3], analogs[0])
    if whole:
        places, samples = layout.read_samples(path, whole, parameters)
        file["data"]["points"] = points = np.concatenate([places, np.ones((1, *places.shape[1:]))])
        file["data"]["analogs"] = samples[None]
        file["data"]["meta_points"] = {
            "residuals": np.where(np.isnan(places).any(axis=0), -1.0, 0.0)[None],
            "camera_masks": np.zeros((7, *places.shape[1:]), dtype=bool),
        }
    if points.shape[2] != frames:
        raise text_file.FileFault(
            f"it has {points.shape[2]} frames; {frames} were read", code=Code.DAMAGED_RECORDING
        )
    return C3DOriginal(path=path, header=header, file=file)


def supplement_c3d(
    original: C3DOriginal,
    target: Path,
    points: Sequence[AddedPoint],
    events: Sequence[FootEvent] = (),
    group: tuple[str, Mapping[str, Sequence[str]]] | None = None,
    units: Mapping[str, str] | None = None,
) -> tuple[str, ...]:
    """Write a copy of a C3D file with further points and events.

    Parameters
    ----------
    original
        The file to copy.
    target
        The file to write.
    points
        Points to add; one with the name of an existing point replaces it.
    events
        Events to add after those of the file.
    group
        Name of a group of parameters, and its parameters, each a list of text.
    units
        POINT parameter -> unit, such as `ANGLE_UNITS`, where the file has none.

    Returns
    -------
    tuple of str
        Entries that could not be copied unchanged: parameters as `GROUP:NAME`.

    Raises
    ------
    InputError
        The file cannot hold them: a limit of the format is met.
    """
    file = open_c3d_original(original.path, original.frames).file
    if "" in file["parameters"]:  # a record without a name ends the section
        del file["parameters"][""]
    if not file["data"]["rotations"].shape[2]:  # else an empty group of them is added
        del file["data"]["rotations"]
    try:
        _add_points(file, points)
        _complete_channels(file)
        _add_events(file, events)
        for name, unit in (units or {}).items():
            if not original.get_unit(name):
                _put_parameter(file, "POINT", name, [unit])
        if group is not None:
            for name, texts in group[1].items():
                _put_parameter(file, group[0], name, list(texts))
        with atomic.write_atomically(target) as part:
            written = part.with_suffix(".c3d")
            file.write(str(written))
            is_restored = _restore_residuals(original, written, {point.name for point in points})
            written.replace(part)
    except (ValueError, RuntimeError, KeyError, IndexError, TypeError) as fault:
        message = f"cannot be given further points: {fault}"
        raise InputError(message, source=original.path, code=Code.NOT_WRITABLE) from None
    asked = (
        {*POINT_PARAMETERS, *(f"{group[0]}:{name}" for name in group[1])}
        if group
        else POINT_PARAMETERS
    )
    asked = asked | EVENT_PARAMETERS if events else asked
    names = layout.find_changed_parameters(original.path.read_bytes(), target.read_bytes())
    names = tuple(name for name in names if name.rstrip("23456789") not in asked)
    names = names if is_restored else (*names, "residuals of points")
    # ezc3d leaves out the descriptions of the first 255 points where there are more
    described, asked_for = (
        _read_list(f, "POINT", "DESCRIPTIONS")
        for f in (open_c3d_original(target, original.frames).file, file)
    )
    is_described = described == [text.rstrip() for text in asked_for]
    return names if is_described else (*names, "POINT:DESCRIPTIONS")


def _restore_residuals(original: C3DOriginal, path: Path, replaced: Container[str]) -> bool:
    """Restore the fourth word of the original's points, and the header's scale of it.

    That word holds the residual and the cameras of a point. ezc3d keeps 15 of its 16 bits, and
    writes -1 as the scale into the header. Returns False for DEC floats, which cannot be restored.
    """
    header, frames, group = original.header, original.frames, original.file["parameters"]["POINT"]
    scale = float(np.ravel(group["SCALE"]["value"])[0]) if "SCALE" in group else 1.0
    with path.open("r+b") as stream:
        stream.seek(12)
        stream.write(struct.pack("<f", -abs(scale)))
    if header.processor == layout.DEC and header.is_float:
        return False
    kind = np.dtype("<f4" if header.is_float else "<i2")
    new = layout.check_c3d_header(path)
    shapes = [(frames, h.frame_bytes // size) for h, size in ((header, kind.itemsize), (new, 4))]
    theirs = np.memmap(original.path, kind, "r", header.start, shapes[0])
    ours = np.memmap(path, "<f4", "r+", new.start, shapes[1])
    places = [
        4 * k + 3
        for k, label in enumerate(_pad_list(list(original.labels), header.points))
        if label not in replaced
    ]
    is_missing = original.file["data"]["meta_points"]["residuals"][0].T < 0
    if not np.array_equal(theirs[:, 3 : 4 * header.points : 4] < 0, is_missing):
        return False
    ours[:, places] = theirs[:, places]
    ours.flush()
    return True


def _read_list(file: Any, group: str, name: str) -> list[str]:
    """Read a list of texts with its continuations NAME2, NAME3, ...; empty if there is none."""
    entries = file["parameters"].get(group, {})
    out: list[str] = []
    for key in itertools.takewhile(entries.__contains__, _generate_names(name)):
        out += map(str, entries[key]["value"])
    return out


def _generate_names(name: str) -> Iterator[str]:
    """Generate NAME, NAME2, NAME3, ..."""
    return itertools.chain([name], (f"{name}{number}" for number in itertools.count(2)))


def _put_parameter(file: Any, group: str, name: str, value: Any) -> None:
    """Set a parameter and keep its description; a long list of texts continues in NAME2, ..."""
    entries = file["parameters"].get(group, {})
    if not isinstance(value, list):
        parts: list[Any] = [value]
    else:
        texts = [text.encode()[:LONGEST_TEXT].decode(errors="ignore") for text in value]
        parts = [texts[at : at + MOST_LABELS] for at in range(0, len(texts), MOST_LABELS)] or [[]]
    for key, part in zip(_generate_names(name), parts, strict=False):
        if key not in entries:
            integer = isinstance(part, np.ndarray) and part.dtype.kind == "i"
            file.add_parameter(group, key, part.astype(float) if integer else part)
            entries = file["parameters"][group]
            if integer:
                entries[key]["type"] = INTEGER_TYPE
        entries[key]["value"] = part


def _pad_list(entries: list[str], count: int) -> list[str]:
    """Pad or cut a list to `count` entries, the missing ones empty."""
    return entries[:count] + [""] * (count - len(entries))


def _add_points(file: Any, points: Sequence[AddedPoint]) -> None:
    data, masks = file["data"], file["data"]["meta_points"]["camera_masks"]
    values, residuals = data["points"], data["meta_points"]["residuals"]
    count, frames = values.shape[1], values.shape[2]
    labels = _pad_list(_read_list(file, "POINT", "LABELS"), count)
    descriptions = _pad_list(_read_list(file, "POINT", "DESCRIPTIONS"), count)
    more = [point.name for point in points if point.name not in labels]
    labels += more
    descriptions += [""] * len(more)
    values = np.concatenate([values, np.ones((values.shape[0], len(more), frames))], axis=1)
    residuals = np.concatenate([residuals, np.zeros((1, len(more), frames))], axis=1)
    masks = np.concatenate([masks, np.zeros((7, len(more), frames), dtype=bool)], axis=1)
    for point in points:
        if point.values.shape != (frames, 3):
            raise ValueError(f"{point.name} has values of shape {point.values.shape}")
        place = labels.index(point.name)
        values[:3, place] = point.values.T
        residuals[0, place] = np.where(np.isfinite(point.values).all(axis=1), 0.0, -1.0)
        masks[:, place] = False
        descriptions[place] = point.description
    data["points"], data["meta_points"] = values, {"residuals": residuals, "camera_masks": masks}
    _put_parameter(file, "POINT", "LABELS", labels)
    _put_parameter(file, "POINT", "DESCRIPTIONS", descriptions)
    pairs = _read_list(file, "POINT", "TYPE_GROUPS")
    for kind in PointKind:
        lists, word = kind.value
        if new := [point.name for point in points if point.kind is kind and point.name in more]:
            _put_parameter(file, "POINT", lists, [*_read_list(file, "POINT", lists), *new])
            pairs += [] if lists in pairs else [lists, word]
    if pairs and "TYPE_GROUPS" in file["parameters"]["POINT"]:
        _put_parameter(file, "POINT", "TYPE_GROUPS", pairs)


def _complete_channels(file: Any) -> None:
    """Complete names, units and scales of the channels, which ezc3d needs for each."""
    count = file["data"]["analogs"].shape[1]
    group = file["parameters"]["ANALOG"]
    for name in ("LABELS", "DESCRIPTIONS", "UNITS"):
        _put_parameter(file, "ANALOG", name, _pad_list(_read_list(file, "ANALOG", name), count))
    scales = (
        np.asarray(group["SCALE"]["value"], dtype=float).ravel()[:count]
        if "SCALE" in group
        else np.zeros(0)
    )
    _put_parameter(file, "ANALOG", "SCALE", np.concatenate([scales, np.ones(count - len(scales))]))


def _add_events(file: Any, events: Sequence[FootEvent]) -> None:
    """Write `events` after those of the file."""
    if not events:
        return
    entries = file["parameters"].get("EVENT", {})
    times = (
        np.asarray(entries["TIMES"]["value"], dtype=float)
        if "TIMES" in entries
        else np.zeros((2, 0))
    )
    if times.ndim != 2 or times.shape[0] != 2:
        if times.size:
            raise ValueError(f"EVENT:TIMES has the shape {times.shape}; (2, events) is needed")
        times = np.zeros((2, 0))
    there = times.shape[1]
    if there + len(events) > MOST_EVENTS:
        raise ValueError(f"it would have {there + len(events)} events; {MOST_EVENTS} are allowed")
    entries_of_events = [EVENT_LABELS[event.moment] for event in events]
    subject = next(
        iter(_read_list(file, "EVENT", "SUBJECTS") or _read_list(file, "SUBJECTS", "NAMES")), ""
    )
    columns = {
        "CONTEXTS": [CONTEXTS[event.side] for event in events],
        "LABELS": [label for label, _, _ in entries_of_events],
        "DESCRIPTIONS": [text for _, text, _ in entries_of_events],
        "SUBJECTS": [subject] * len(events),
    }
    new = np.array(
        [[event.time // 60.0 for event in events], [event.time % 60.0 for event in events]]
    )
    _put_parameter(file, "EVENT", "TIMES", np.hstack([times, new]))
    for name, texts in columns.items():
        _put_parameter(
            file, "EVENT", name, _pad_list(_read_list(file, "EVENT", name), there) + texts
        )
    for name, numbers in (
        ("ICON_IDS", [icon for _, _, icon in entries_of_events]),
        ("GENERIC_FLAGS", [0] * len(events)),
    ):
        known = (
            np.asarray(entries[name]["value"]).ravel()[:there]
            if name in entries
            else np.zeros(0, dtype=int)
        )
        flags = np.concatenate([known, np.zeros(there - len(known)), numbers]).astype(int)
        _put_parameter(file, "EVENT", name, flags)
    _put_parameter(file, "EVENT", "USED", np.array([there + len(events)]))
