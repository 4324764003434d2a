"""Motion, moments and ground reactions as files: read back by our reader, unchanged."""

import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gaitcal.errors import Code
from gaitcal.export.other_formats import write_external_loads, write_mot, write_sto_moments
from gaitcal.io.force_plate import LOADED_N, split_wrench
from gaitcal.io.opensim_files import read_mot_forces, read_table
from gaitcal.model.linkage import COORDINATES, FILE_COORDINATES, is_translation
from tests.messages import refuses

ROUNDING = 1e-12
"""Relative: degrees to radians and back; cross products of metres and kilonewtons."""
TIME = np.linspace(0.4, 1.6, 25)


def table(seed: int, columns: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(len(TIME), columns))


def test_mot_round_trip(tmp_path: Path) -> None:
    q = table(1, len(COORDINATES))
    write_mot(tmp_path / "walk.mot", TIME, COORDINATES, q)
    text = (tmp_path / "walk.mot").read_text(encoding="utf-8")
    assert "inDegrees=yes" in text.splitlines()
    assert "nRows=25" in text.splitlines()
    assert f"nColumns={1 + len(COORDINATES)}" in text.splitlines()
    read = read_table(tmp_path / "walk.mot")
    assert read.names == FILE_COORDINATES
    np.testing.assert_array_equal(read.time, TIME)
    for i, name in enumerate(COORDINATES):
        unit = 1.0 if is_translation(name) else np.pi / 180
        np.testing.assert_allclose(read.get_column(name) * unit, q[:, i], rtol=ROUNDING)


def test_mot_of_some_coordinates_in_any_order(tmp_path: Path) -> None:
    write_mot(tmp_path / "a.mot", TIME, ("knee_angle_l", "pelvis_tx", "pelvis_tilt"), table(2, 3))
    read = read_table(tmp_path / "a.mot")
    assert read.names == ("pelvis_tilt", "pelvis_tx", "knee_angle_l")


@pytest.mark.parametrize(("names", "columns"), [(("knee_angle",), 1), (("knee_angle_r",), 2)])
def test_mot_refuses(tmp_path: Path, names: tuple[str, ...], columns: int) -> None:
    with refuses(Code.NOT_WRITABLE, source="a.mot"):
        write_mot(tmp_path / "a.mot", TIME, names, table(3, columns))


def test_time_must_increase(tmp_path: Path) -> None:
    with refuses(Code.NOT_WRITABLE, field="time", source="a.mot"):
        write_mot(tmp_path / "a.mot", TIME[::-1], COORDINATES, table(3, len(COORDINATES)))
    assert not list(tmp_path.iterdir())


def test_moments(tmp_path: Path) -> None:
    tau = table(4, len(COORDINATES))
    tau[3, 5] = np.nan
    write_sto_moments(
        tmp_path / "walk.sto", TIME, tau, comments=("endheader", "nRows=7\nnColumns=2")
    )
    lines = (tmp_path / "walk.sto").read_text(encoding="utf-8").splitlines()
    end = lines.index("endheader")
    assert lines[0] == "Inverse Dynamics Generalized Forces"
    assert [line for line in lines[:end] if line.startswith("nRows=")] == ["nRows=24"]
    header = " ".join(lines[:end])
    assert all(
        word in header
        for word in ("Internal and net", "Sign", "Frame", "Units", "inDegrees=no", "1 of 25 rows")
    )
    names = lines[end + 1].split("\t")
    assert names[:2] == ["time", "pelvis_tilt_moment"]
    assert "pelvis_tx_force" in names
    assert "hip_flexion_r_moment" in names
    values = np.array([[float(cell) for cell in line.split("\t")] for line in lines[end + 2 :]])
    kept = np.delete(tau, 3, axis=0)
    np.testing.assert_array_equal(values[:, 0], np.delete(TIME, 3))
    for name, ours in (("knee_angle_r", 9), ("pelvis_tilt", 3), ("pelvis_tx", 0)):
        np.testing.assert_array_equal(values[:, 1 + FILE_COORDINATES.index(name)], kept[:, ours])


def walking_wrenches(seed: int = 5) -> np.ndarray:
    """(nf, 2, 6): forces through points near the ground, either foot unloaded for part of
    the time.
    """
    rng = np.random.default_rng(seed)
    wrenches = np.zeros((len(TIME), 2, 6))
    for foot, loaded in enumerate((slice(0, 15), slice(9, 25))):
        n = len(TIME[loaded])
        force = rng.normal(size=(n, 3)) * 50 + [0, 700, 0]
        force[:2] *= 0.01  # some frames below the threshold
        point = rng.normal(size=(n, 3)) * [0.3, 0.0, 0.1]
        free = rng.normal(size=(n, 3)) * [0, 5, 0]
        wrenches[loaded, foot] = np.hstack([force, np.cross(point, force) + free])
    return wrenches


def test_point_and_torque_are_the_same_wrench() -> None:
    for wrench in np.moveaxis(walking_wrenches(), 1, 0):
        point, torque = split_wrench(wrench)
        np.testing.assert_allclose(
            np.cross(point, wrench[:, :3]) + torque, wrench[:, 3:], atol=1e-10
        )
        loaded = wrench[:, 1] >= LOADED_N
        np.testing.assert_allclose(torque[loaded][:, [0, 2]], 0.0, atol=1e-10)
        assert (point[:, 1] == 0.0).all()
        steps = np.linalg.norm(np.diff(point, axis=0), axis=1)
        assert (steps[~loaded[1:] & ~loaded[:-1]] <= steps.max()).all()
        first = int(np.argmax(loaded))
        np.testing.assert_array_equal(point[:first], np.tile(point[first], (first, 1)))


def test_never_loaded() -> None:
    wrench = np.full((4, 6), 0.5)
    point, torque = split_wrench(wrench)
    assert (point == 0).all()
    np.testing.assert_array_equal(torque, wrench[:, 3:])


def test_external_loads_round_trip(tmp_path: Path) -> None:
    wrenches = walking_wrenches()
    table_path, loads_path = write_external_loads(tmp_path, TIME, wrenches, "../walk <1>")
    assert table_path.parent == loads_path.parent == tmp_path
    assert {p.name for p in tmp_path.iterdir()} == {table_path.name, loads_path.name}
    forces = read_mot_forces(table_path)
    assert len(forces.plates) == 2
    for foot, plate in enumerate(forces.plates):
        np.testing.assert_allclose(plate.wrench(), wrenches[:, foot], rtol=ROUNDING, atol=1e-10)
    root = ET.parse(loads_path).getroot()
    assert [e.text for e in root.iter("applied_to_body")] == ["foot_r", "foot_l"]
    assert [e.text for e in root.iter("datafile")] == [table_path.name]


def test_external_loads_refuse(tmp_path: Path) -> None:
    wrenches = walking_wrenches()
    with refuses(Code.NOT_WRITABLE, 2, source="ground_reactions.mot"):
        write_external_loads(tmp_path, TIME, wrenches[:, 0])
    wrenches[3, 0, 0] = np.nan
    with refuses(Code.NOT_WRITABLE, source="ground_reactions.mot"):
        write_external_loads(tmp_path, TIME, wrenches)


def test_opensim_reads_the_tables(osim: Any, tmp_path: Path) -> None:
    q, tau = table(6, len(COORDINATES)), table(7, len(COORDINATES))
    tau[2, 3] = np.nan
    write_mot(tmp_path / "a.mot", TIME, COORDINATES, q)
    write_sto_moments(tmp_path / "a.sto", TIME, tau)
    loads, _ = write_external_loads(tmp_path, TIME, walking_wrenches())
    for name, degrees, columns, rows in (
        ("a.mot", True, len(COORDINATES) + 1, 25),
        ("a.sto", False, len(COORDINATES) + 1, 24),
        (loads.name, False, 19, 25),
    ):
        storage = osim.Storage(str(tmp_path / name))
        assert storage.getSize() == rows
        assert storage.isInDegrees() == degrees
        assert storage.getColumnLabels().getSize() == columns
    motion = osim.Storage(str(tmp_path / "a.mot"))
    column = osim.ArrayDouble()
    motion.getDataColumn("knee_angle_r", column)
    read = np.array([column.get(i) for i in range(len(TIME))])
    np.testing.assert_allclose(
        np.deg2rad(read), q[:, COORDINATES.index("knee_angle_r")], rtol=ROUNDING
    )
    newer = osim.TimeSeriesTable(str(tmp_path / "a.sto"))
    assert newer.getNumRows() == len(TIME) - 1
