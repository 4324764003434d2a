"""OpenSim's ExternalLoads (`grf.xml`): which columns of which table act on which body.

The file names a table of forces (`datafile`, relative to its own folder; it overrides the `data_source_name` of single
forces) and, for each ExternalForce, the body it acts on and how the names of its columns begin: with `ground_force_v`
for the force, its columns are `ground_force_vx`, `_vy`, `_vz`. Each becomes a plate of that name, given to the foot to
which its body belongs. What the model here cannot take is refused by name: a force on another body than a foot, and one
that is told in the frame of a body that moves.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path, PureWindowsPath

import numpy as np

from gaitcal.codes import Code
from gaitcal.errors import InputError, side_named
from gaitcal.io.force_tables import Forces, PlateColumns, build_plate, standing
from gaitcal.io.labels import clean, unique
from gaitcal.io.text_file import readable_size, undo_rounding
from gaitcal.io.trc_mot import StorageTable, read_table

FOOT = re.compile(r"calc|foot|toe|talus|heel|mtp|forefoot|hindfoot|rearfoot|midfoot", re.IGNORECASE)
"""Bodies of a foot, in the models that people use."""
GROUND = ("", "ground", "/ground", "/", "unassigned")
NOTHING = ("", "unassigned")
"""What an identifier says that names no columns."""


@dataclass(frozen=True, kw_only=True)
class ExternalForce:
    """One force of the file, as it is written there."""

    name: str
    body: str
    force_in: str
    """The frame in which the force is expressed."""
    point_in: str
    force: str
    """How the names of its columns begin; the empty string where none are named."""
    point: str
    torque: str
    table: str
    """File of its columns, as written; the empty string where the file does not say."""


def read_external_loads(path: Path) -> Forces:
    """The plates of an ExternalLoads file, and the foot of each.

    Raises
    ------
    InputError
        The file or its table cannot be read, or it holds a force that is none of the ground on a foot.
    """
    forces, off = _forces(path)
    notes = tuple(f"The force '{name}' is switched off in the file and left out." for name in off)
    if not forces:
        raise InputError("found no ExternalForce that is switched on", source=path, code=Code.FILE_FORMAT)
    tables = {name: read_table(_table(path, name)) for name in dict.fromkeys(f.table for f in forces)}
    names, _ = unique(clean(force.name) or "force" for force in forces)
    plates, feet = [], {}
    for name, force in zip(names, forces, strict=True):
        table = tables[force.table]
        found = _columns(path, force, table)
        if found is None:
            notes += (f"The force '{name}' has no columns and was left out.",)
            continue
        side = side_named(force.body)
        values = table.values[:, [c for of in found.columns.values() for c in of.values()]]
        if not (side and FOOT.search(force.body)):
            if not np.nan_to_num(values[:, :3]).any():
                notes += (f"The force '{name}' on {force.body} is zero throughout and was left out.",)
                continue
            raise InputError(
                f"found a force on '{force.body}'; allowed are forces on the right and left foot (calcn_r, calcn_l)",
                source=path,
                field=f"ExternalForce {name}",
                code=Code.FILE_FORMAT,
            )
        for frame, of in ((force.force_in, "force"), (force.point_in, "point")):
            if frame.lower() not in GROUND:
                raise InputError(
                    f"found its {of} expressed in '{frame}'; allowed is ground",
                    source=path,
                    field=f"ExternalForce {name}",
                    code=Code.FILE_FORMAT,
                )
        time, time_notes = undo_rounding(table.time)
        plate, plate_notes = build_plate(name, time, table.values, found, path)
        plates.append(plate)
        feet[name] = side
        columns = f"Plate {name} holds the columns {force.force}x and following, on {force.body}."
        notes += (*(n for n in time_notes if n not in notes), *plate_notes, columns)
    if not plates:
        raise InputError("found no force on a foot", source=path, code=Code.FILE_FORMAT)
    ready, turn, turn_notes = standing(plates)
    return Forces(str(path), ready, notes + turn_notes, turn, feet)


def loads_tables(path: Path) -> tuple[Path, ...]:
    """The tables that an ExternalLoads file draws on; none for a file of another kind."""
    if path.suffix.lower() != ".xml":
        return ()
    forces, _ = _forces(path)
    return tuple(_table(path, name) for name in dict.fromkeys(force.table for force in forces))


def tables_there(path: Path) -> tuple[Path, ...]:
    """The same of a file that may be none at all: the tables that are there."""
    try:
        return loads_tables(path)
    except InputError:
        return ()


def _forces(path: Path) -> tuple[list[ExternalForce], list[str]]:
    """Forces that are switched on, and the names of those that are not."""
    readable_size(path)
    try:
        root = ET.parse(path).getroot()
    except (ET.ParseError, ValueError, LookupError, OSError) as error:
        raise InputError(f"is not well-formed XML: {error}", source=path, code=Code.FILE_FORMAT) from None
    loads = root if root.tag == "ExternalLoads" else root.find(".//ExternalLoads")
    if loads is None:
        raise InputError(
            f"found <{root.tag}>; a file with <ExternalLoads> is needed", source=path, code=Code.FILE_FORMAT
        )
    common = _text(loads, "datafile")
    forces, off = [], []
    for element in loads.iter("ExternalForce"):
        name = element.get("name", "")
        if _text(element, "isDisabled").lower() == "true" or _text(element, "appliesForce").lower() == "false":
            off.append(name)
            continue
        force, point, torque = (_text(element, f"{of}_identifier") for of in ("force", "point", "torque"))
        forces.append(
            ExternalForce(
                name=name,
                body=_text(element, "applied_to_body").rpartition("/")[2],
                force_in=_text(element, "force_expressed_in_body"),
                point_in=_text(element, "point_expressed_in_body"),
                force="" if force.lower() in NOTHING else force,
                point="" if point.lower() in NOTHING else point,
                torque="" if torque.lower() in NOTHING else torque,
                table=common or _first((_text(element, "datafile"), _text(element, "data_source_name"))),
            )
        )
    return forces, off


def _text(element: ET.Element, tag: str) -> str:
    return (element.findtext(tag) or "").strip()


def _first(texts: Iterable[str]) -> str:
    return next((text for text in texts if text.lower() not in NOTHING), "")


def _table(path: Path, name: str) -> Path:
    """The table of that name: from the folder of the file, or of the same name in it, where it was moved with it."""
    if not name:
        raise InputError("names no table of forces", source=path, field="datafile", code=Code.FILE_FORMAT)
    written = PureWindowsPath(name)  # takes / and \\ alike
    for place in (path.parent / Path(*written.parts), path.parent / written.name):
        if place.is_file():
            return place
    raise InputError(
        f"found '{name}', which does not exist beside it", source=path, field="datafile", code=Code.NO_FILE
    )


def _columns(path: Path, force: ExternalForce, table: StorageTable) -> PlateColumns | None:
    """The columns of one force; None where it names none, or a torque alone that the table lacks, too."""
    if not force.force:
        return None
    found = PlateColumns()
    for quantity, identifier in (("force", force.force), ("point", force.point), ("moment", force.torque)):
        if not identifier:
            continue
        names = [f"{identifier}{axis}" for axis in "xyz"]
        lower = [name.lower() for name in table.names]
        if not all(name.lower() in lower for name in names):
            names = [name for name in table.names if name.startswith(identifier)]
        if len(names) != 3:
            raise InputError(
                f"found {len(names)} columns; {identifier}x, {identifier}y and {identifier}z are needed",
                source=path,
                field=f"ExternalForce {force.name}, {quantity}",
                code=Code.FILE_FORMAT,
            )
        found.columns[quantity] = {axis: lower.index(name.lower()) for axis, name in enumerate(names)}
        found.names += names
    return found
