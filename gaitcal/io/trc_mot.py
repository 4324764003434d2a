"""TRC files (Motion Analysis, OpenSim): marker coordinates, tab-separated.

The header is believed only where nothing better is there: marker names and data columns are counted, the number of
frames is what follows, and the Time column is the clock. Line 3 gives the unit; the vertical is found from the data.

MOT and STO tables (OpenSim, SIMM), and the ground reactions in them.

The header ends at `endheader`; its counts are not believed. Files of forces are in m, N and N·m, by definition of the
format's users (OpenSim's ExternalLoads in the ground frame), and already as their maker wants them: no offset is
removed here. They are y up there; one whose forces act along another axis is turned as its markers are (`axes.py`).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from os import PathLike
from pathlib import Path

import numpy as np

from gaitcal.arrays import Array
from gaitcal.codes import Code
from gaitcal.errors import InputError, nearest
from gaitcal.io.atomic import atomic_file, atomic_text
from gaitcal.io.axes import Vertical, make_y_up
from gaitcal.io.force_tables import Forces, build_plate, find_plates, on_one_time, standing
from gaitcal.io.labels import clean, common_prefix, is_unlabelled, unique
from gaitcal.io.recording import ForcePlate, Recording, require_plain_labels, zeros_to_missing
from gaitcal.io.text_file import number_lines, parse_rows, read_lines, require_increasing, undo_rounding

PER_METRE = {"mm": 1000.0, "cm": 100.0, "m": 1.0, "millimeters": 1000.0, "meters": 1.0}
LONGEST_HEADER = 20
AXIS_LINE = re.compile(r"(\s*[XYZ]\d+)*\s*", re.IGNORECASE)
"""X1 Y1 Z1 X2 ..., or nothing."""
USUAL_VERTICAL = Vertical(1, 1, "the usual practice, as the data do not tell")


def read_trc(path: Path) -> Recording:
    """Markers of a TRC file, in metres, y up."""
    return make_y_up(parse_trc(path), USUAL_VERTICAL)


def parse_trc(path: Path) -> Recording:
    """Markers of a TRC file, in metres, in the axes of the file."""
    lines = [_single_tabs(line) for line in read_lines(path)]
    label_line = _label_line(path, lines)
    separator = "\t" if "\t" in lines[label_line] else None
    facts = _facts(lines[:label_line])
    start = label_line + 1
    while start < len(lines) and AXIS_LINE.fullmatch(lines[start]):
        start += 1
    width = len(lines[start].rstrip().split(separator)) if start < len(lines) else 0
    names = _names(path, lines[label_line], separator, width)
    table = parse_rows(lines, start, 2 + 3 * len(names), source=path, separator=separator, short_step=3)
    require_increasing(table.values[:, 1], path, table.lines)
    time, notes = undo_rounding(table.values[:, 1])
    frames = len(time)
    if table.filled_rows:
        notes += (f"{table.filled_rows} rows end before their last markers, which were taken as gaps.",)
    if facts.get("numframes", str(frames)) not in (str(frames), f"{frames}.0"):
        notes += (f"Header says {facts['numframes'][:20]} frames; {frames} found.",)
    keep = [i for i, name in enumerate(names) if not is_unlabelled(name)]
    if len(keep) < len(names):
        notes += (f"{len(names) - len(keep)} unlabelled trajectories left out.",)
    if not keep:
        raise InputError(
            "found no marker with a name", source=path, field=f"line {label_line + 1}", code=Code.FILE_FORMAT
        )
    unit, unit_notes = _unit(path, facts)
    markers = table.values[:, 2:].reshape(frames, len(names), 3)[:, keep] / unit
    markers, gap_notes = zeros_to_missing(markers)
    prefix, prefix_notes = common_prefix([names[i] for i in keep])
    labels, repetition_notes = unique(names[i].removeprefix(prefix) for i in keep)
    notes += unit_notes + gap_notes + prefix_notes + repetition_notes
    return Recording(source=str(path), time=time, labels=labels, markers=markers, notes=notes)


def write_trc(path: Path, recording: Recording) -> None:
    """Markers in metres, y up; every float in the shortest form that reads back to the same bits."""
    require_plain_labels(recording, path)
    rate = recording.rate if len(recording.time) > 1 else 0.0
    frames, markers = len(recording.time), len(recording.labels)
    rows = [
        f"PathFileType\t4\t(X/Y/Z)\t{path.name}",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"{rate:.6g}\t{rate:.6g}\t{frames}\t{markers}\tm\t{rate:.6g}\t1\t{frames}",
        "Frame#\tTime\t" + "\t\t\t".join(recording.labels) + "\t\t",
        "\t\t" + "\t".join(f"{axis}{i + 1}" for i in range(markers) for axis in "XYZ"),
        "",
    ]
    with atomic_file(path) as part, part.open("w", encoding="utf-8", newline="\n") as file:
        file.write("\n".join(rows) + "\n")
        numbers = number_lines(np.column_stack([recording.time, recording.markers.reshape(frames, -1)]), "\t")
        file.writelines(f"{index}\t{line}" for index, line in enumerate(numbers.splitlines(keepends=True), start=1))


def _label_line(path: Path, lines: Sequence[str]) -> int:
    for index, line in enumerate(lines[:LONGEST_HEADER]):
        if line.split("\t")[0].strip().lower().startswith("frame#"):
            return index
    raise InputError(
        f"found no line of marker names; a line that begins with 'Frame#' is needed among the first {LONGEST_HEADER}",
        source=path,
        code=Code.FILE_FORMAT,
    )


def _facts(lines: Sequence[str]) -> dict[str, str]:
    """The two lines of keys and values, keys in small letters."""
    for keys, values in pairwise(lines):
        if "units" in keys.lower():
            separator = "\t" if "\t" in keys else None
            given = [keys.lower().split(separator), values.split(separator)]
            filled = [[cell for cell in cells if cell.strip()] for cells in given]
            words, numbers = filled if len(filled[0]) == len(filled[1]) else given  # tabs may be doubled in one line
            return {key.strip(): value.strip() for key, value in zip(words, numbers, strict=False)}
    return {}


def _single_tabs(line: str) -> str:
    """The line with single tabs, where all its tabs are doubled (some programs write so, in headers or throughout).

    A gap in a line with single tabs leaves some tabs alone, so that it is not touched.
    """
    runs = re.findall(r"\t+", line.rstrip())
    doubled = bool(runs) and all(len(run) % 2 == 0 for run in runs) and not line.startswith("\t")
    return line.replace("\t\t", "\t") if doubled else line


def _names(path: Path, line: str, separator: str | None, width: int) -> list[str]:
    """Names by their places, three columns each; by their order, where that alone fits the `width` of a row."""
    cells = [clean(cell) for cell in line.split(separator)]
    place = next((i for i, cell in enumerate(cells[1:], start=1) if cell), 0)  # after tabs of its own, in some files
    cells = cells[:1] + cells[place:]
    if len(cells) < 3 or cells[1].lower() != "time":
        raise InputError(
            "'Frame#' must be followed by 'Time' and marker names",
            source=path,
            field="marker names",
            code=Code.FILE_FORMAT,
        )
    filled = [i for i, cell in enumerate(cells[2:]) if cell]
    if not filled:
        raise InputError("found no marker name after 'Time'", source=path, field="marker names", code=Code.FILE_FORMAT)
    by_place = all(i % 3 == 0 for i in filled) and (len(filled) > 1 or len(cells) > 3)
    if by_place and not (width < 2 + filled[-1] + 1 and width == 2 + 3 * len(filled)):
        return cells[2 : 2 + filled[-1] + 1 : 3]
    return [cells[2 + i] for i in filled]


def _unit(path: Path, facts: dict[str, str]) -> tuple[float, tuple[str, ...]]:
    name = facts.get("units")
    if name is None:
        return 1000.0, ("The header names no unit; millimetres were taken.",)
    unit = PER_METRE.get(name.lower())
    if unit is None:
        raise InputError(
            f"found '{name[:20]}'; allowed are mm, cm and m{nearest(name, PER_METRE)}",
            source=path,
            field="Units",
            code=Code.FILE_FORMAT,
        )
    return unit, ()


MOT_LONGEST_HEADER = 500


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
    end = next((i for i, line in enumerate(lines[:MOT_LONGEST_HEADER]) if line.strip().lower() == "endheader"), None)
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
