"""Motion, generalised forces and ground reactions as files that OpenSim's tools take over.

All are tables of OpenSim's Storage (`.mot`, `.sto`), which stops reading at the first NaN, without a word: a row that
holds one is left out, and the header says so. Ground reactions are written as the force at the centre of pressure and
the moment about it, with an XML file that says which columns act on which foot.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np

from gaitcal.arrays import Array
from gaitcal.codes import Code
from gaitcal.dynamics.inverse_dynamics import FEET
from gaitcal.errors import InputError
from gaitcal.export.osim import DOCUMENT_VERSION, child, safe_name, write_xml
from gaitcal.io.atomic import atomic_text
from gaitcal.io.force_plate import point_and_torque
from gaitcal.io.opensim_files import StorageTable
from gaitcal.model.linkage import COORDINATE_INDEX, COORDINATES, FILE_COORDINATES, is_translation

MOTION_COMMENTS = ("Coordinates of the model.osim beside this file; rotations in degrees, translations in m.",)

MOMENT_COMMENTS = (
    "Units: N m for rotations (NAME_moment), N for translations (NAME_force); time in s.",
    "Internal and net: the generalised force of all structures that cross the joint, on the child segment.",
    "Sign: positive drives the coordinate of that name in its positive direction; an external moment is the negative.",
    "Frame: each about or along the axis of its own coordinate; laboratory x forward, y up, z right.",
    "pelvis rows are the residual: what the ground reactions do not explain.",
)


def write_mot(path: Path | str, time: Array, coordinates: tuple[str, ...], q: Array) -> None:
    """Write `q` (nf, len(coordinates)), m and rad, as an OpenSim motion: m and degrees, pelvis rotations first.

    Raises
    ------
    InputError
        A name is none of the 27 coordinates, or shapes do not agree.
    """
    names, values = _in_file_order(path, coordinates, q)
    scale = np.array([1.0 if is_translation(name) else 180.0 / np.pi for name in names])
    _write(path, "Coordinates", MOTION_COMMENTS, StorageTable(np.asarray(time), names, values * scale, True))


def write_sto_moments(
    path: Path | str,
    time: Array,
    tau: Array,
    coordinates: tuple[str, ...] = COORDINATES,
    *,
    comments: tuple[str, ...] = (),
) -> None:
    """Write generalised forces `tau` (nf, len(coordinates)), N·m and N, with the column names of OpenSim's own tool.

    `comments` are further lines of the header, after those that say frame, sign and what is meant.
    """
    names, values = _in_file_order(path, coordinates, tau)
    columns = tuple(f"{name}_{'force' if is_translation(name) else 'moment'}" for name in names)
    table = StorageTable(np.asarray(time), columns, values, False)
    _write(path, "Inverse Dynamics Generalized Forces", (*MOMENT_COMMENTS, *comments), table)


def write_external_loads(
    folder: Path | str, time: Array, wrenches: Array, stem: str = "ground_reactions"
) -> tuple[Path, Path]:
    """Write ground reactions on the feet as `STEM.mot` and `STEM.xml` (OpenSim's ExternalLoads on foot_r and foot_l).

    `time` (nf,) s; `wrenches` (nf, 2, 6) on the right and the left foot, force (N) and moment (N·m) about the
    laboratory origin. `stem` is made safe first, so a trial's name may be given as it is. Returns table and loads.

    Raises
    ------
    InputError
        Shapes do not agree or a number is not finite.
    """
    name = safe_name(stem)
    path, loads = Path(folder) / f"{name}.mot", Path(folder) / f"{name}.xml"
    if wrenches.shape != (len(time), len(FEET), 6):
        raise _fault(path, f"found wrenches of shape {wrenches.shape}, expected (frames, 2, 6)")
    if not np.isfinite(wrenches).all():
        raise _fault(path, "a ground reaction is not finite; leave out frames without one")
    document = ET.Element("OpenSimDocument", Version=DOCUMENT_VERSION)
    external = child(document, "ExternalLoads", name="ground_reactions")
    objects = child(external, "objects")
    names: list[str] = []
    columns: list[Array] = []
    for foot, wrench in zip(FEET, np.moveaxis(wrenches, 1, 0), strict=True):
        side = foot[-1]
        force, point, torque = f"ground_force_{side}_v", f"ground_force_{side}_p", f"ground_torque_{side}_"
        names += [f"{identifier}{axis}" for identifier in (force, point, torque) for axis in "xyz"]
        columns += [wrench[:, :3], *point_and_torque(wrench)]
        load = child(objects, "ExternalForce", name=f"ground_on_{foot}")
        child(load, "applied_to_body", foot)
        child(load, "force_expressed_in_body", "ground")
        child(load, "point_expressed_in_body", "ground")
        child(load, "force_identifier", force)
        child(load, "point_identifier", point)
        child(load, "torque_identifier", torque)
    child(external, "datafile", path.name)
    comments = ("Ground reactions on the feet, laboratory axes: force N, point m, moment about the point N m.",)
    table = StorageTable(np.asarray(time), tuple(names), np.hstack(columns), False)
    _write(path, "Ground reactions", comments, table)
    write_xml(document, loads)
    return path, loads


def _fault(path: Path | str, message: str, field: str | None = None) -> InputError:
    return InputError(message, source=path, field=field, code=Code.NOT_WRITABLE)


def _in_file_order(path: Path | str, coordinates: tuple[str, ...], values: Array) -> tuple[tuple[str, ...], Array]:
    """The coordinates as OpenSim's files order them, and the columns of `values` (nf, len(coordinates)) likewise."""
    for name in coordinates:
        if name not in COORDINATE_INDEX:
            raise _fault(path, f"found '{name}'; allowed are {', '.join(FILE_COORDINATES)}", "columns")
    if values.ndim != 2 or values.shape[1] != len(coordinates):
        raise _fault(path, f"found values of shape {values.shape}, expected (frames, {len(coordinates)})")
    names = tuple(name for name in FILE_COORDINATES if name in coordinates)
    return names, values[:, [coordinates.index(name) for name in names]]


def _write(path: Path | str, title: str, comments: tuple[str, ...], table: StorageTable) -> None:
    """Write a table, rows with NaN left out: OpenSim's Storage stops reading at the first one, without a word.

    A title or comment that would end the header or be taken for an entry of it is made harmless.
    """
    nf, columns = len(table.time), len(table.names)
    if table.values.shape != (nf, columns):
        raise _fault(path, f"found values of shape {table.values.shape}, expected {(nf, columns)}")
    if not (np.isfinite(table.time).all() and (np.diff(table.time) > 0).all()):
        raise _fault(path, "must be finite and increase from row to row", "time")
    known = np.isfinite(table.values).all(axis=1)
    missing = nf - int(known.sum())
    if missing:
        comments = (*comments, f"{missing} of {nf} rows are left out: they hold no value.")
    kept = replace(table, time=table.time[known], values=table.values[known])
    atomic_text(path, kept.text(_one_line(title), tuple(map(_one_line, comments))))


def _one_line(text: str) -> str:
    return " ".join(text.split()).replace("=", ":").replace("endheader", "end of header") or "gaitcal"
