"""Motion, generalised forces and ground reactions as files that OpenSim's tools take over.

All are tables as OpenSim's Storage reads them (`.mot`, `.sto`): a header, `endheader`, column names, rows; tab
separated. Storage stops reading at the first NaN, without a word; so a row that holds one is left out, and the header
says so. Ground reactions are written as the force at the centre of pressure and the moment about it
(`dynamics/centre_of_pressure.py`), with an XML file that says which columns act on which foot.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gaitcal.dynamics.centre_of_pressure import point_and_torque
from gaitcal.dynamics.inverse_dynamics import FEET
from gaitcal.errors import InputError
from gaitcal.export.osim import DOCUMENT_VERSION
from gaitcal.export.xml_text import child, safe_name, write_xml
from gaitcal.files.atomic import atomic_text
from gaitcal.model.linkage import COORDINATE_INDEX, COORDINATES, FILE_COORDINATES, is_translation

Array = NDArray[np.float64]

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
    _write_storage(path, "Coordinates", names, time, values * scale, comments=MOTION_COMMENTS, in_degrees=True)


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
    title = "Inverse Dynamics Generalized Forces"
    _write_storage(path, title, columns, time, values, comments=(*MOMENT_COMMENTS, *comments))


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
        raise InputError(f"found wrenches of shape {wrenches.shape}, expected (frames, 2, 6)", source=path)
    if not np.isfinite(wrenches).all():
        raise InputError("a ground reaction is not finite; leave out frames without one", source=path)
    names: list[str] = []
    columns: list[Array] = []
    for foot, wrench in zip(FEET, np.moveaxis(wrenches, 1, 0), strict=True):
        force, point, torque = _identifiers(foot)
        names += [f"{identifier}{axis}" for identifier in (force, point, torque) for axis in "xyz"]
        columns += [wrench[:, :3], *point_and_torque(wrench)]
    comment = "Ground reactions on the feet, laboratory axes: force N, point m, moment about the point N m."
    _write_storage(path, "Ground reactions", tuple(names), time, np.hstack(columns), comments=(comment,))
    _write_loads(loads, path.name)
    return path, loads


def _in_file_order(path: Path | str, coordinates: tuple[str, ...], values: Array) -> tuple[tuple[str, ...], Array]:
    """The coordinates as OpenSim's files order them, and the columns of `values` (nf, len(coordinates)) likewise."""
    for name in coordinates:
        if name not in COORDINATE_INDEX:
            raise InputError(f"found '{name}'; allowed are {', '.join(FILE_COORDINATES)}", source=path, field="columns")
    if values.ndim != 2 or values.shape[1] != len(coordinates):
        raise InputError(f"found values of shape {values.shape}, expected (frames, {len(coordinates)})", source=path)
    names = tuple(name for name in FILE_COORDINATES if name in coordinates)
    return names, values[:, [coordinates.index(name) for name in names]]


def _identifiers(foot: str) -> tuple[str, str, str]:
    side = foot[-1]
    return f"ground_force_{side}_v", f"ground_force_{side}_p", f"ground_torque_{side}_"


def _write_loads(path: Path, table: str) -> None:
    document = ET.Element("OpenSimDocument", Version=DOCUMENT_VERSION)
    loads = child(document, "ExternalLoads", name="ground_reactions")
    objects = child(loads, "objects")
    for foot in FEET:
        force, point, torque = _identifiers(foot)
        load = child(objects, "ExternalForce", name=f"ground_on_{foot}")
        child(load, "applied_to_body", foot)
        child(load, "force_expressed_in_body", "ground")
        child(load, "point_expressed_in_body", "ground")
        child(load, "force_identifier", force)
        child(load, "point_identifier", point)
        child(load, "torque_identifier", torque)
    child(loads, "datafile", table)
    write_xml(document, path)


def _write_storage(
    path: Path | str,
    title: str,
    names: tuple[str, ...],
    time: Array,
    values: Array,
    *,
    comments: tuple[str, ...],
    in_degrees: bool = False,
) -> None:
    """A table of `values` (nf, len(names)) over `time` (nf,), s; every number comes back to the same bits.

    A title or comment that would end the header or be taken for an entry of it is made harmless.
    """
    nf, columns = len(time), len(names)
    if values.shape != (nf, columns):
        raise InputError(f"found values of shape {values.shape}, expected {(nf, columns)}", source=path)
    if not (np.isfinite(time).all() and (np.diff(time) > 0).all()):
        raise InputError("must be finite and increase from row to row", source=path, field="time")
    known = np.isfinite(values).all(axis=1)
    missing = nf - int(known.sum())
    left_out = (f"{missing} of {nf} rows are left out: they hold no value.",) if missing else ()
    header = [
        _one_line(title),
        "version=1",
        f"nRows={nf - missing}",
        f"nColumns={columns + 1}",
        f"inDegrees={'yes' if in_degrees else 'no'}",
        *(_one_line(comment) for comment in (*comments, *left_out)),
        "endheader",
        "\t".join(("time", *names)),
    ]
    kept = np.column_stack([time, values])[known]
    rows = ["\t".join(map(repr, row)) for row in kept.tolist()]
    atomic_text(path, "\n".join([*header, *rows]) + "\n")


def _one_line(text: str) -> str:
    return " ".join(text.split()).replace("=", ":").replace("endheader", "end of header") or "gaitcal"
