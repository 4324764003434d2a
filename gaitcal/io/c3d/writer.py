"""C3D files written from a recording: Vicon's usual shape, millimetres, z up, type-2 plates.

C3D keeps 32-bit floats, so markers come back to 1e-7 of their size, and wrenches likewise.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gaitcal.arrays import Array
from gaitcal.codes import Code
from gaitcal.errors import InputError
from gaitcal.io.atomic import atomic_file
from gaitcal.io.axes import Turn
from gaitcal.io.force_plate import plate_frame
from gaitcal.io.recording import ForcePlate, Recording, require_plain_labels
from gaitcal.io.text_file import naming_file

Y_TO_Z_UP = Turn((0, 2, 1), (1, -1, 1))
"""Our axes to the laboratory's: the inverse of UP_TO_Y[2, 1]."""
CHANNEL_NAMES = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
MARGIN_M = 0.1
"""Around the points of a plate whose corners are unknown."""
MOST_FRAMES = 65535
"""First and last frame are 16-bit numbers."""
MOST_LABELS = 255
"""A list of names counts them in one byte; nobody wears more markers."""
LOOSE = 1e-3
"""Departure, in samples, up to which times count as uniform."""


@naming_file
def write_c3d(path: Path, recording: Recording) -> None:
    """Markers and plates as a C3D file that `read_recording` returns again.

    Times must be uniform and start at a whole number of frames; plate samples a whole multiple of the marker rate, from
    the first frame on, to the last. A plate without corners gets a rectangle around its points. InputError otherwise.
    """
    import ezc3d

    require_plain_labels(recording)
    if len(recording.labels) > MOST_LABELS:
        raise InputError(
            f"{len(recording.labels)} markers found; at most {MOST_LABELS} are allowed",
            source=path,
            code=Code.NOT_WRITABLE,
        )
    rate, first = _clock(path, recording)
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
        _add_plates(path, file, recording.plates, rate, frames, float(recording.time[0]))
    with atomic_file(path) as part:
        written = part.with_suffix(".c3d")  # ezc3d adds this ending to any other, .C3D too
        try:
            file.write(str(written))
        except (RuntimeError, ValueError) as error:
            raise InputError(f"cannot be written ({error})", source=path, code=Code.NOT_WRITABLE) from None
        written.replace(part)


def _clock(path: Path, recording: Recording) -> tuple[float, int]:
    """Frames a second, and the number of the first frame counted from 0."""
    time = recording.time
    if len(time) == 1:
        return 100.0, round(100.0 * float(time[0]))
    rate = (len(time) - 1) / float(time[-1] - time[0])
    if abs(rate - round(rate)) < 1e-6 * rate:
        rate = float(round(rate))
    first = round(float(time[0]) * rate)
    away = float(np.max(np.abs((first + np.arange(len(time))) - time * rate)))
    if away > LOOSE:
        raise InputError(
            f"times lie up to {away:.2g} frames off a uniform clock; C3D allows none",
            source=path,
            code=Code.NOT_WRITABLE,
        )
    if first < 0 or first + len(time) > MOST_FRAMES:
        raise InputError(
            f"frames {first + 1} to {first + len(time)} found; 1 to {MOST_FRAMES} are allowed",
            source=path,
            code=Code.NOT_WRITABLE,
        )
    return rate, first


def _add_plates(
    path: Path, file: object, plates: tuple[ForcePlate, ...], rate: float, frames: int, start: float
) -> None:
    samples = len(plates[0].time)
    ratio = samples // frames
    for plate in plates:
        steps = (plate.time - start) * rate * ratio
        if samples != ratio * frames or len(plate.time) != samples or np.abs(steps - np.arange(samples)).max() > LOOSE:
            raise InputError(
                f"{len(plate.time)} samples from {plate.time[0]:.4f} s for {frames} frames from {start:.4f} s; a whole "
                "number of samples a frame, from the first frame on, is needed",
                source=path,
                field=f"plate {plate.name}",
                code=Code.NOT_WRITABLE,
            )
        if not np.isfinite(plate.wrench()).all():
            raise InputError(
                "its wrench holds NaN; channels cannot",
                source=path,
                field=f"plate {plate.name}",
                code=Code.NOT_WRITABLE,
            )
    parts = [_plate_in_its_frame(plate) for plate in plates]
    channels = 6 * len(plates)
    parameters = file["parameters"]  # type: ignore[index]
    analog = parameters["ANALOG"]
    analog["RATE"]["value"] = [rate * ratio]
    analog["LABELS"]["value"] = [f"{name}{i + 1}" for i in range(len(plates)) for name in CHANNEL_NAMES]
    analog["DESCRIPTIONS"]["value"] = [""] * channels
    analog["UNITS"]["value"] = ["N", "N", "N", "Nmm", "Nmm", "Nmm"] * len(plates)
    analog["SCALE"]["value"] = [1.0] * channels
    analog["OFFSET"]["value"] = [0] * channels
    file["data"]["analogs"] = np.concatenate([part[1] for part in parts])[None]  # type: ignore[index]
    corners = np.stack([1e3 * part[0].T for part in parts], axis=2)
    platform = parameters["FORCE_PLATFORM"]  # its entries are there, and have the right types
    platform["USED"]["value"] = np.array([len(plates)])
    platform["TYPE"]["value"] = np.array([2] * len(plates))
    platform["CORNERS"]["value"] = corners
    platform["ORIGIN"]["value"] = np.zeros((3, len(plates)))
    platform["CHANNEL"]["value"] = np.arange(1, channels + 1).reshape(len(plates), 6).T


def _plate_in_its_frame(plate: ForcePlate) -> tuple[Array, Array]:
    """Corners (4, 3) m, z up, and channels (6, ns) N, N·mm about the middle of the surface in the plate's frame."""
    corners = Y_TO_Z_UP.apply(_standard_corners(plate))
    corners = (1e3 * corners).astype(np.float32).astype(np.float64) / 1e3  # as the file will hold them
    frame = plate_frame(corners)
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
