"""Made-up recordings for the tests of this folder."""

from pathlib import Path
from typing import Any

import ezc3d
import numpy as np

from gaitcal.io.force_plate import build_plate_from_moment
from gaitcal.io.recording import ForcePlate, Recording

BODY_N = 700.0
CORNERS_MM = np.array([[0.0, 500.0, 0.0], [600.0, 500.0, 0.0], [600.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
"""Of a plate in a z-up laboratory, standard order: x of the plate is -x, y is +y, z is down."""
LABELS = ("LASI", "RASI", "SACR", "LKNE", "RKNE", "LTOE", "RTOE", "C7")


def body(frames: int = 50, rate: float = 100.0, speed: float = 1.2, seed: int = 1) -> Recording:
    """A rigid cloud of eight markers, y up, moving along x."""
    rng = np.random.default_rng(seed)
    heights = np.array([1.0, 1.0, 1.02, 0.5, 0.5, 0.05, 0.05, 1.45])
    cloud = np.column_stack([rng.normal(0.2, 0.08, 8), heights, rng.normal(0.2, 0.12, 8)])
    time = np.arange(frames) / rate
    way = np.zeros((frames, 3))
    way[:, 0] = speed * time
    return Recording(source="made up", time=time, labels=LABELS, markers=cloud[None] + way[:, None])


def plate(time: np.ndarray, name: str = "1", load: np.ndarray | None = None) -> ForcePlate:
    """A plate of our axes under a foot that rolls along x, empty in the first and last fifth."""
    if load is None:
        phase = np.clip((time - time[0]) / (time[-1] - time[0]) * 5 - 1, 0, 3) / 3
        load = BODY_N * np.sin(np.pi * phase) ** 0.5
    corners = CORNERS_MM[:, [0, 2, 1]] * [1e-3, 1e-3, -1e-3]
    centre = corners.mean(axis=0)
    force = np.column_stack([0.1 * load * np.sin(time), load, 0.03 * load])
    where = centre + np.column_stack([0.1 * np.cos(3 * time), 0 * time, 0.02 + 0 * time])
    moment = np.cross(where - centre, force)
    moment[:, 1] += 0.005 * load
    return build_plate_from_moment(
        name, time, force, moment, centre, np.array([0.0, 1.0, 0.0]), corners
    )


def loaded_body(frames: int = 100, rate: float = 100.0, ratio: int = 10) -> Recording:
    """`body` with two plates, at `ratio` samples a frame."""
    recording = body(frames, rate)
    dense = np.arange(frames * ratio) / (rate * ratio)
    plates = (plate(dense), plate(dense, "2", load=np.where(dense > 0.5, 400.0, 0.0)))
    return Recording(
        source="made up",
        time=recording.time,
        labels=recording.labels,
        markers=recording.markers,
        plates=plates,
    )


def write_raw_c3d(
    path: Path,
    points_mm: np.ndarray,
    labels: list[str],
    *,
    rate: float = 100.0,
    first_frame: int = 0,
    units: str = "mm",
    point_lists: dict[str, list[str]] | None = None,
    analogs: np.ndarray | None = None,
    ratio: int = 1,
    platform: dict[str, Any] | None = None,
    analog_units: list[str] | None = None,
) -> Path:
    """A C3D file of points (nf, np, 3) as given, in the axes given, and analog channels
    (na, ns).
    """
    file = ezc3d.c3d()
    file["parameters"]["POINT"]["RATE"]["value"] = [rate]
    file["parameters"]["POINT"]["LABELS"]["value"] = labels
    file["parameters"]["POINT"]["UNITS"]["value"] = [units]
    file["header"]["points"]["first_frame"] = first_frame
    data = points_mm.transpose(2, 1, 0)
    missing = np.isnan(data).any(axis=0)
    file["data"]["points"] = np.concatenate([data, np.ones((1, *missing.shape))])
    file["data"]["meta_points"]["residuals"] = np.where(missing, -1.0, 0.0)[None]
    file["data"]["meta_points"]["camera_masks"] = np.zeros((7, *missing.shape), dtype=bool)
    for name, entries in (point_lists or {}).items():
        file.add_parameter("POINT", name, entries)
    if analogs is not None:
        count = len(analogs)
        analog = file["parameters"]["ANALOG"]
        analog["RATE"]["value"] = [rate * ratio]
        analog["LABELS"]["value"] = [f"A{i}" for i in range(count)]
        analog["UNITS"]["value"] = analog_units or ["N"] * count
        analog["SCALE"]["value"] = [1.0] * count
        analog["OFFSET"]["value"] = [0] * count
        file["data"]["analogs"] = analogs[None]
    for name, value in (platform or {}).items():
        file["parameters"]["FORCE_PLATFORM"][name]["value"] = np.asarray(value)
    file.write(str(path))
    return path


def standing_points_mm(frames: int) -> np.ndarray:
    """Points (nf, 8, 3) of `body` standing, in mm, z up."""
    still = body(frames, speed=0.0).markers
    return 1e3 * np.stack([still[..., 0], -still[..., 2], still[..., 1]], axis=-1)
