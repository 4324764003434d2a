"""MOT and STO tables (OpenSim, SIMM), and the ground reactions in them.

The header ends at `endheader`; its counts are not believed. Files of forces are in m, N and N·m, by definition of the
format's users (OpenSim's ExternalLoads in the ground frame), and already as their maker wants them: no offset is
removed here. They are y up there; one whose forces act along another axis is turned as its markers are (`axes.py`).
"""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import numpy as np

from gaitcal.arrays import Array
from gaitcal.codes import Code
from gaitcal.errors import InputError
from gaitcal.io.atomic import atomic_text
from gaitcal.io.force_tables import Forces, build_plate, find_plates, on_one_time, standing
from gaitcal.io.recording import ForcePlate
from gaitcal.io.text_file import number_lines, parse_rows, read_lines, require_increasing, undo_rounding

LONGEST_HEADER = 500


@dataclass(frozen=True)
class StorageTable:
    """What stands in a MOT or STO file."""

    time: Array
    """(rows,) s, as written."""
    names: tuple[str, ...]
    """Columns after time."""
    values: Array
    """(rows, columns), in the units of the file."""
    in_degrees: bool | None
    """What the header says of angles; None where it does not."""

    def column(self, name: str) -> Array:
        """(rows,) of one column."""
        return np.asarray(self.values[:, self.names.index(name)])

    def text(self, title: str, comments: tuple[str, ...] = ()) -> str:
        """The table as a file holds it: every number in the shortest form that reads back to the same bits."""
        header = [
            title,
            "version=1",
            f"nRows={len(self.time)}",
            f"nColumns={len(self.names) + 1}",
            f"inDegrees={'yes' if self.in_degrees else 'no'}",
            *comments,
            "endheader",
            "\t".join(("time", *self.names)),
        ]
        return "\n".join(header) + "\n" + number_lines(np.column_stack([self.time, self.values]), "\t", missing="nan")


def read_table(path: str | PathLike[str]) -> StorageTable:
    """Any MOT or STO table.

    Raises
    ------
    InputError
        Every fault of the file, in one line: file, field, what was found, what is allowed.
    """
    path = Path(path)
    lines = read_lines(path)
    end = next((i for i, line in enumerate(lines[:LONGEST_HEADER]) if line.strip().lower() == "endheader"), None)
    if end is None:
        raise InputError(
            f"found no line 'endheader' among the first {LONGEST_HEADER}", source=path, code=Code.FILE_FORMAT
        )
    names_line = end + 1
    while names_line < len(lines) and not lines[names_line].strip():
        names_line += 1
    if names_line >= len(lines):
        raise InputError("the file ends after its header", source=path, code=Code.FILE_FORMAT)
    separator = "\t" if "\t" in lines[names_line] else None
    names = [name.strip() for name in lines[names_line].rstrip().split(separator)]
    if names[0].lower() != "time":
        raise InputError(
            f"found '{names[0][:40]}'; the first column must be 'time'",
            source=path,
            field=f"line {names_line + 1}",
            code=Code.FILE_FORMAT,
        )
    rows = parse_rows(lines, names_line + 1, len(names), source=path, separator=separator)
    time = rows.values[:, 0]
    require_increasing(time, path, rows.lines)
    return StorageTable(time, tuple(names[1:]), rows.values[:, 1:], _in_degrees(lines[:end]))


def read_mot_forces(path: Path) -> Forces:
    """Plates "1", "2", ... of a MOT or STO file, in the order in which their columns first appear."""
    table = read_table(path)
    found = find_plates(table.names)
    if not found:
        raise InputError(
            f"found no force columns among {', '.join(table.names[:6])}...; names like ground_force_vx are needed",
            source=path,
            code=Code.FILE_FORMAT,
        )
    time, notes = undo_rounding(table.time)
    plates = []
    for index, columns in enumerate(found):
        plate, plate_notes = build_plate(str(index + 1), time, table.values, columns, path)
        plates.append(plate)
        notes += (*plate_notes, f"Plate {index + 1} holds the columns {columns.names[0]} and following.")
    ready, turn, turn_notes = standing(plates)
    return Forces(str(path), ready, notes + turn_notes, turn)


def write_forces_mot(path: Path, plates: tuple[ForcePlate, ...]) -> None:
    """Plates with one common time as an OpenSim MOT file: ground_force_1_vx, _px, ground_moment_1_mx, and so on."""
    time, values = on_one_time(plates, path)
    kinds = ("ground_force_{}_v", "ground_force_{}_p", "ground_moment_{}_m")
    names = [f"{kind.format(k + 1)}{axis}" for k in range(len(plates)) for kind in kinds for axis in "xyz"]
    atomic_text(path, StorageTable(time, tuple(names), values, True).text(path.name))


def _in_degrees(header: list[str]) -> bool | None:
    for line in header:
        key, _, value = line.partition("=")
        if key.strip().lower() == "indegrees":
            return value.strip().lower() in ("yes", "true", "1")
    return None
