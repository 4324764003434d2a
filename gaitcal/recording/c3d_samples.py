"""The data section of a C3D file laid out after its header alone.

ezc3d takes the layout of a frame from the parameters. Old files may lack ANALOG:RATE or ANALOG:USED, and are then
read askew, without complaint: the analog values of one frame pass for points of the next. Where the header accounts
for the length of the file and the parameters do not, the header is right.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gaitcal.errors import InputError
from gaitcal.recording.c3d_header import BLOCK, INTEL, C3DHeader
from gaitcal.recording.recording import Array


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
        raise InputError("found DEC encoding without ANALOG:RATE; save the file again in Intel format", source=path)
    kind = np.dtype("<f4") if header.is_float else np.dtype("<i2")
    length = header.data_bytes // kind.itemsize
    try:
        raw = np.fromfile(path, dtype=kind, count=length, offset=header.start).astype(np.float64)
    except OSError as error:
        raise InputError(f"cannot be read ({error})", source=path) from None
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
    given = np.asarray(group.get(name, []), dtype=np.float64).ravel()[:count]
    return np.concatenate([given, np.full(count - len(given), default)])[:, None]
