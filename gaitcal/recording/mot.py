"""MOT and STO tables (OpenSim, SIMM), and the ground reactions in them.

The header ends at `endheader`; its counts are not believed. Files of forces are y up, in m, N and N·m, by definition
of the format's users (OpenSim's ExternalLoads in the ground frame), and already as their maker wants them: no offset
is removed here.
"""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import numpy as np

from gaitcal.errors import InputError
from gaitcal.files.atomic import atomic_file
from gaitcal.recording.force_columns import build_plate, find_plates
from gaitcal.recording.recording import Array, ForcePlate
from gaitcal.recording.text_file import parse_rows, read_lines, require_increasing, undo_rounding

LONGEST_HEADER = 500


@dataclass(frozen=True)
class Table:
    """A MOT or STO file."""

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


@dataclass(frozen=True)
class Forces:
    """Ground reactions of one trial from a file of their own."""

    source: str
    plates: tuple[ForcePlate, ...]
    notes: tuple[str, ...] = ()


def read_table(path: str | PathLike[str]) -> Table:
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
        raise InputError(f"found no line 'endheader' among the first {LONGEST_HEADER}", source=path)
    names_line = end + 1
    while names_line < len(lines) and not lines[names_line].strip():
        names_line += 1
    if names_line >= len(lines):
        raise InputError("the file ends after its header", source=path)
    separator = "\t" if "\t" in lines[names_line] else None
    names = [name.strip() for name in lines[names_line].rstrip().split(separator)]
    if names[0].lower() != "time":
        raise InputError(
            f"found '{names[0][:40]}'; the first column must be 'time'", source=path, field=f"line {names_line + 1}"
        )
    rows = parse_rows(lines, names_line + 1, len(names), source=path, separator=separator)
    time = rows.values[:, 0]
    require_increasing(time, path, rows.lines)
    return Table(time, tuple(names[1:]), rows.values[:, 1:], _in_degrees(lines[:end]))


def read_mot_forces(path: Path) -> Forces:
    """Plates "1", "2", ... of a MOT or STO file, in the order in which their columns first appear."""
    table = read_table(path)
    found = find_plates(table.names)
    if not found:
        raise InputError(
            f"found no force columns among {', '.join(table.names[:6])}...; names like ground_force_vx are needed",
            source=path,
        )
    time, notes = undo_rounding(table.time)
    plates = []
    for index, columns in enumerate(found):
        plate, told = build_plate(str(index + 1), time, table.values, columns, path)
        plates.append(plate)
        notes += (*told, f"Plate {index + 1} holds the columns {columns.names[0]} and following.")
    return Forces(str(path), tuple(plates), notes)


def write_forces_mot(path: Path, plates: tuple[ForcePlate, ...]) -> None:
    """Plates with one common time as an OpenSim MOT file: ground_force_1_vx, _px, ground_moment_1_mx, and so on."""
    time, values = on_one_time(plates, path)
    names = ["time"]
    for number in range(1, len(plates) + 1):
        names += [f"ground_force_{number}_v{axis}" for axis in "xyz"]
        names += [f"ground_force_{number}_p{axis}" for axis in "xyz"]
        names += [f"ground_moment_{number}_m{axis}" for axis in "xyz"]
    values = np.column_stack([time, values])
    header = [path.name, "version=1", f"nRows={len(values)}", f"nColumns={values.shape[1]}", "inDegrees=yes"]
    with atomic_file(path) as part, part.open("w", encoding="utf-8", newline="\n") as file:
        file.write("\n".join([*header, "endheader", "\t".join(names)]) + "\n")
        for row in values.tolist():
            file.write("\t".join(["nan" if value != value else repr(value) for value in row]) + "\n")


def on_one_time(plates: tuple[ForcePlate, ...], target: Path) -> tuple[Array, Array]:
    """Times (ns,) of a table of all plates, and its values (ns, 9 * plates): force, point, moment of each.

    A plate that begins later or ends sooner than another has NaN there. InputError where plates are sampled at
    different times, as one table has one time column.
    """
    if not plates:
        raise InputError("there are no force plates to write", source=target)
    time = np.unique(np.concatenate([plate.time for plate in plates]))
    values = np.full((len(time), 9 * len(plates)), np.nan)
    for number, plate in enumerate(plates):
        rows = np.searchsorted(time, plate.time)
        if rows[-1] - rows[0] + 1 != len(rows):
            raise InputError("the plates are sampled at different times; a table needs the same for all", source=target)
        values[rows, 9 * number : 9 * number + 9] = np.hstack([plate.force, plate.point, plate.moment])
    return time, values


def _in_degrees(header: list[str]) -> bool | None:
    for line in header:
        key, _, value = line.partition("=")
        if key.strip().lower() == "indegrees":
            return value.strip().lower() in ("yes", "true", "1")
    return None
