"""Read and write gaitcal's CSV tables of recordings: y up, metres, seconds, N, N·m.

    NAME.csv         markers   time,RASI_x,RASI_y,RASI_z,...   (an empty cell is a gap)
    NAME_forces.csv  plates    time,1_fx,1_fy,1_fz,1_px,1_py,1_pz,1_tx,1_ty,1_tz,2_fx,...
                               (force, point, moment about it)
    NAME_plates.csv  corners   plate,corner,x,y,z
    NAME_facts.csv   the rest  fact,value              person and events of a C3D file

No number is converted on reading. Markers or forces that clearly have another axis up are rotated
by quarter turns. Corners have a separate table because the table of forces has no column for
them; they show whether a foot was entirely on its plate. Numbers are written in the shortest form
that reads back to the same bits. Lines before the header that begin with `#` are comments. Facts
are those of `labels.Facts`, without name and doubts, in kg, m, rad, s, values as JSON:

    mass,66.5
    knee_width,"{""r"": 0.105, ""l"": 0.107}"
    event,"[1.23, ""r"", ""foot strike""]"

Computed points are columns of the marker table: `computed:RKNE_x`.

`events.csv`: foot events as corrected by a person, in the folder of the recordings.

    file,time,side,event
    walk.c3d,1.230,right,foot strike          s on the time axis of the recording

A recording that the table names has these events only; events of its file, plates and motion are
not used. A recording that it does not name is unchanged. `result.html` writes the table (Save
events). Empty cells and rows of a spreadsheet, and capitals, are accepted. A file of this name
without these columns belongs to another program and is not used.
"""

import csv
import json
import math
import re
from collections.abc import Collection, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from gaitcal.arrays import Array
from gaitcal.io import atomic, text_file
from gaitcal.io.axes import find_body_vertical, rotate_vertical_to_y
from gaitcal.io.force_tables import (
    Forces,
    PlateColumns,
    build_plate,
    orient_forces,
    tabulate_plates,
)
from gaitcal.io.labels import (
    SIDES,
    ComputedPoints,
    Facts,
    FootEvent,
    FootMoment,
    clean_label,
    find_axes_points,
    number_repetitions,
)
from gaitcal.io.recording import ForcePlate, Recording, replace_zeros, require_plain_labels

MARKER_COLUMN = re.compile(r"(?P<name>.+)_(?P<axis>[xyz])", re.DOTALL)
FORCE_COLUMN = re.compile(r"(?P<name>.+)_(?P<quantity>[fpt])(?P<axis>[xyz])", re.DOTALL)
QUANTITIES = {"f": "force", "p": "point", "t": "moment"}
CORNER_HEADER = ["plate", "corner", "x", "y", "z"]
CORNER_COUNT = 4


@text_file.name_file_in_faults
def read_markers_csv(path: Path) -> Recording:
    """Read markers from a CSV table, with facts and events from the table beside it.

    Parameters
    ----------
    path
        The file `NAME.csv`.

    Returns
    -------
    Recording
        m, s, y up, every number as written.

    Raises
    ------
    InputError
        A column, number or fact cannot be read, or the table holds forces.
    """
    names, table = _read_table(path)
    if is_force_header(names):
        raise text_file.FileFault("this is a table of forces; give it as the forces of a trial")
    facts, events = read_facts_csv(locate_facts_file(path))
    places: dict[tuple[str, int], dict[int, int]] = {}
    for column, name in enumerate(names):
        match = MARKER_COLUMN.fullmatch(name)
        if match is None:
            raise text_file.FileFault(
                f"found the column '{name[:40]}'; NAME_x, NAME_y and NAME_z are allowed"
            )
        axis, repeat = "xyz".index(match["axis"]), 0
        while axis in places.setdefault((match["name"], repeat), {}):
            repeat += 1
        places[match["name"], repeat][axis] = column
    for (name, _), columns in places.items():
        if len(columns) < 3:
            axes = ", ".join("xyz"[axis] for axis in sorted(columns))
            raise text_file.FileFault(
                f"found only {axes}; x, y and z are needed", f"marker {name[:40]}"
            )
    if not places:
        raise text_file.FileFault("found no marker columns; NAME_x, NAME_y and NAME_z are needed")
    computed_columns = {
        name: columns for (name, _), columns in places.items() if name.startswith(COMPUTED_PREFIX)
    }
    places = {key: columns for key, columns in places.items() if key[0] not in computed_columns}
    labels, repetition_notes = number_repetitions(clean_label(name) or "?" for name, _ in places)
    markers, gap_notes = replace_zeros(_gather_points(table, places.values()))
    computed_labels = tuple(
        clean_label(name.removeprefix(COMPUTED_PREFIX)) or "?" for name in computed_columns
    )
    recording = Recording(
        source=str(path),
        time=np.ascontiguousarray(table.values[:, 0]),
        labels=labels,
        markers=markers,
        notes=repetition_notes + gap_notes,
        events=events,
        facts=facts,
        computed=ComputedPoints(computed_labels, _gather_points(table, computed_columns.values()))
        if computed_columns
        else None,
    )
    vertical = find_body_vertical(markers)
    return (
        recording
        if vertical is None or vertical.axis == 1
        else rotate_vertical_to_y(recording, vertical)
    )


def _gather_points(table: text_file.NumberTable, columns: Collection[dict[int, int]]) -> Array:
    """Gather (nf, np, 3) m of points from their columns (axis -> column after time)."""
    order = [point_columns[axis] for point_columns in columns for axis in range(3)]
    return table.values[:, 1:][:, order].reshape(len(table.values), len(columns), 3)


@text_file.name_file_in_faults
def read_forces_csv(path: Path) -> Forces:
    """Read force plates from a CSV table.

    Parameters
    ----------
    path
        The file `NAME_forces.csv`.

    Returns
    -------
    Forces
        m, N, N·m, y up, every number as written; without corners.

    Raises
    ------
    InputError
        A column or number cannot be read.
    """
    names, table = _read_table(path)
    columns_of: dict[str, PlateColumns] = {}
    for column, name in enumerate(names):
        match = FORCE_COLUMN.fullmatch(name)
        if match is None:
            raise text_file.FileFault(
                f"found the column '{name[:40]}'; 1_fx, 1_px, 1_tx and so on are allowed"
            )
        columns = columns_of.setdefault(clean_label(match["name"]), PlateColumns())
        axes, axis = columns.columns[QUANTITIES[match["quantity"]]], "xyz".index(match["axis"])
        if axis in axes:
            raise text_file.FileFault(f"found the column '{name[:40]}' twice")
        axes[axis] = column
        columns.names.append(name)
    if not columns_of:
        raise text_file.FileFault(
            "found no force columns; 1_fx, 1_fy, 1_fz, 1_px and so on are needed"
        )
    time = np.ascontiguousarray(table.values[:, 0])
    built = [
        build_plate(name, time, table.values[:, 1:], columns)
        for name, columns in columns_of.items()
    ]
    return orient_forces(
        path, [plate for plate, _ in built], tuple(note for _, notes in built for note in notes)
    )


def is_force_header(names: list[str]) -> bool:
    """Return whether every column name is one of a force plate."""
    return bool(names) and all(FORCE_COLUMN.fullmatch(name) for name in names)


@text_file.name_file_in_faults
def read_header(path: Path) -> list[str]:
    """Read the column names after time from a CSV table.

    Parameters
    ----------
    path
        The file.

    Returns
    -------
    list of str
        Column names without outer blanks.

    Raises
    ------
    InputError
        There is no header that begins with `time`.
    """
    return _find_header(text_file.read_lines(path))[0]


@text_file.name_file_in_faults
def write_markers_csv(path: Path, recording: Recording) -> None:
    """Write markers as a CSV table, and facts and events to NAME_facts.csv beside it.

    Parameters
    ----------
    path
        File to write.
    recording
        Markers, m; they read back to the same bits.

    Raises
    ------
    InputError
        A name cannot be written as text, or the file cannot be written.
    """
    require_plain_labels(recording)
    labels, values = list(recording.labels), recording.markers
    if (computed := recording.computed) is not None:
        # The four points of each segment's axes are not written
        left_out = find_axes_points(computed.labels)
        at = [i for i, label in enumerate(computed.labels) if label not in left_out]
        labels += [COMPUTED_PREFIX + computed.labels[i] for i in at]
        values = np.concatenate([values, computed.points[:, at]], axis=1)
    names = [f"{label}_{axis}" for label in labels for axis in "xyz"]
    _write_table(path, names, recording.time, values.reshape(len(recording.time), -1))
    _write_facts_csv(locate_facts_file(path), recording)


@text_file.name_file_in_faults
def write_forces_csv(path: Path, plates: tuple[ForcePlate, ...]) -> None:
    """Write force plates with common times as a CSV table that reads back to the same bits.

    Parameters
    ----------
    path
        File to write.
    plates
        Plates, m, N, N·m.

    Raises
    ------
    InputError
        The plates have different times, or the file cannot be written.
    """
    time, values = tabulate_plates(plates)
    names = [
        f"{plate.name}_{quantity}{axis}" for plate in plates for quantity in "fpt" for axis in "xyz"
    ]
    _write_table(path, names, time, values)


def _write_table(path: Path, names: list[str], time: Array, values: Array) -> None:
    with (
        atomic.write_atomically(path) as part,
        part.open("w", encoding="utf-8", newline="") as file,
    ):
        csv.writer(file, lineterminator="\n").writerow(["time", *names])
        file.write(text_file.format_number_lines(np.column_stack([time, values]), ","))


def _read_table(path: Path) -> tuple[list[str], text_file.NumberTable]:
    """Read column names after time, and the numbers with increasing times."""
    lines = text_file.read_lines(path)
    names, start = _find_header(lines)
    table = text_file.parse_rows(lines, start, 1 + len(names), ",")
    text_file.require_increasing(table.values[:, 0], table.lines)
    return names, table


def _find_header(lines: list[str]) -> tuple[list[str], int]:
    """Find the column names after time, and the index of the first line of numbers."""
    start = next(
        (i for i, line in enumerate(lines) if line.strip() and not line.startswith("#")), len(lines)
    )
    if start == len(lines):
        raise text_file.FileFault("found only comments; a header line is needed")
    try:
        cells = next(csv.reader([lines[start]]))
    except csv.Error as error:
        raise text_file.FileFault(f"damaged header ({error})", f"line {start + 1}") from None
    if not cells or cells[0].strip().lower() != "time":
        hint = " (this one is separated by ';')" if ";" in lines[start] else ""
        needed = (
            f"a header 'time,NAME_x,NAME_y,...' with commas is needed{hint}, or the C3D or TRC of "
            "it"
        )
        raise text_file.FileFault(f"found '{lines[start][:40]}'; {needed}", f"line {start + 1}")
    return [cell.strip() for cell in cells[1:]], start + 1


# ---------------------------------------------------------------------------- corners of the plates


def locate_plates_file(forces: Path) -> Path:
    """Return the path of NAME_plates.csv beside NAME_forces.csv or NAME.csv."""
    return forces.with_name(f"{forces.stem.removesuffix('_forces')}_plates.csv")


def write_plates_csv(path: Path, plates: tuple[ForcePlate, ...]) -> None:
    """Write the corners of all plates that have them; they read back to the same bits.

    Parameters
    ----------
    path
        File to write.
    plates
        Plates; corners (4, 3) m.

    Raises
    ------
    InputError
        The file cannot be written.
    """
    with (
        atomic.write_atomically(path) as part,
        part.open("w", encoding="utf-8", newline="") as file,
    ):
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(CORNER_HEADER)
        for plate in plates:
            for k, corner in enumerate([] if plate.corners is None else plate.corners.tolist()):
                rows.writerow([plate.name, k + 1, *map(repr, corner)])


def add_corners(forces: Forces, path: Path) -> Forces:
    """Add the corners of NAME_plates.csv to forces, with a note, if that file exists.

    Parameters
    ----------
    forces
        Forces as read, y up.
    path
        File that they were read from.

    Returns
    -------
    Forces
        With corners in the same axes.

    Raises
    ------
    InputError
        The table is damaged, or names a plate that the forces lack.
    """
    table = locate_plates_file(path)
    if not table.is_file():
        return forces
    names = [plate.name for plate in forces.plates]
    corners = {
        name: forces.rotation.apply(plate_corners)
        for name, plate_corners in _read_corners(table, path.name, names).items()
    }
    placed = tuple(
        replace(plate, corners=corners.get(plate.name, plate.corners)) for plate in forces.plates
    )
    notes = (f"Corners of plates {', '.join(corners)} from {table.name}.",)
    return replace(forces, plates=placed, notes=forces.notes + notes)


@text_file.name_file_in_faults
def _read_corners(path: Path, forces: str, allowed: Sequence[str]) -> dict[str, Array]:
    """Read plate -> corners (4, 3) m; `forces` is the name of the force file, for messages."""
    rows = list(
        csv.reader(
            line for line in text_file.read_lines(path) if line.strip() and not line.startswith("#")
        )
    )
    if not rows or [cell.strip().lower() for cell in rows[0]] != CORNER_HEADER:
        raise text_file.FileFault(f"a header '{','.join(CORNER_HEADER)}' is needed")
    corners: dict[str, Array] = {}
    for number, row in enumerate(rows[1:], start=1):
        field, text = f"row {number}", ",".join(row)[:60]
        try:
            name, corner, values = row[0].strip(), int(row[1]), [float(cell) for cell in row[2:]]
        except (ValueError, IndexError):
            raise text_file.FileFault(
                f"found '{text}'; plate,corner,x,y,z are needed", field
            ) from None
        if (
            not 1 <= corner <= CORNER_COUNT
            or len(values) != 3
            or not all(map(math.isfinite, values))
        ):
            raise text_file.FileFault(
                f"found '{text}'; a corner of 1 to {CORNER_COUNT} and three numbers are needed",
                field,
            )
        plate_corners = corners.setdefault(name, np.full((CORNER_COUNT, 3), np.nan))
        if not np.isnan(plate_corners[corner - 1, 0]):
            raise text_file.FileFault(f"found corner {corner} of plate '{name[:20]}' twice", field)
        plate_corners[corner - 1] = values
    for name, plate_corners in corners.items():
        if np.isnan(plate_corners).any():
            missing = ", ".join(str(k + 1) for k in np.flatnonzero(np.isnan(plate_corners[:, 0])))
            raise text_file.FileFault(
                f"corner {missing} of plate '{name[:20]}' is missing; 4 are needed"
            )
        if name not in allowed:
            raise text_file.FileFault(
                f"found the plate '{name[:20]}'; {forces} has {', '.join(allowed)}"
            )
    return corners


# ------------------------------------------------------------ subject data and events of a C3D file

FACT_HEADER: Final = ["fact", "value"]
COMPUTED_PREFIX: Final = "computed:"
EVENT_FACT: Final = "event"
_FACT_NAMES: Final = tuple(f.name for f in fields(Facts) if f.name not in ("name", "doubtful"))


def locate_facts_file(markers: Path) -> Path:
    """Return the path of NAME_facts.csv beside NAME.csv."""
    return markers.with_name(f"{markers.stem}_facts.csv")


def _write_facts_csv(path: Path, recording: Recording) -> None:
    """Write the facts and events of a recording as `read_facts_csv` reads them.

    Nothing is written if there are none. A table that already exists belongs to another recording
    and is then emptied.

    `path`: file to write. `recording`: its facts are in kg, m and rad, its events in s.
    """
    facts = {name: getattr(recording.facts, name) for name in _FACT_NAMES}
    rows: list[tuple[str, Any]] = [
        (name, value) for name, value in facts.items() if value not in (None, {})
    ]
    rows += [(EVENT_FACT, [e.time, e.side, e.moment.value]) for e in recording.events]
    if rows or path.exists():
        with (
            atomic.write_atomically(path) as part,
            part.open("w", encoding="utf-8", newline="") as file,
        ):
            csv.writer(file, lineterminator="\n").writerows(
                [FACT_HEADER, *((n, json.dumps(v)) for n, v in rows)]
            )


@text_file.name_file_in_faults
def read_facts_csv(path: Path) -> tuple[Facts, tuple[FootEvent, ...]]:
    """Read the table of facts and events, if it exists.

    `path`: the file `NAME_facts.csv`. Returns: kg, m, rad; events in order of time. Both are empty
    without the file. Raises InputError: a row is neither a fact nor an event.
    """
    facts: dict[str, Any] = {}
    events: list[FootEvent] = []
    rows = list(csv.reader(text_file.read_lines(path))) if path.is_file() else [FACT_HEADER]
    if not rows or rows[0] != FACT_HEADER:
        raise text_file.FileFault(f"a header '{','.join(FACT_HEADER)}' is needed")
    for number, row in enumerate(rows[1:], start=1):
        try:
            name, value = row[0], json.loads(row[1])
            if name == EVENT_FACT:
                time, side, moment = value
                events.append(
                    FootEvent(FootMoment(moment), {"r": "r", "l": "l"}[side], _parse_number(time))
                )
            else:
                facts[name] = _parse_fact(name, value)
        except (ValueError, TypeError, KeyError, IndexError, RecursionError):
            allowed = ", ".join((*_FACT_NAMES, EVENT_FACT))
            raise text_file.FileFault(
                f"found '{','.join(row)[:60]}'; allowed facts: {allowed}", f"row {number}"
            ) from None
    return Facts(**facts), tuple(sorted(events, key=lambda e: e.time))


def _parse_fact(name: str, value: Any) -> Any:
    """Parse a fact; ValueError or KeyError if it is of the wrong kind."""
    if name not in _FACT_NAMES or (isinstance(value, dict) and not set(value) <= {"r", "l"}):
        raise KeyError(name)
    if name in ("marker_set", "session_date", "birth_date", "is_static"):
        return bool(value) if name == "is_static" else str(value)
    return (
        {side: _parse_number(part) for side, part in value.items()}
        if isinstance(value, dict)
        else _parse_number(value)
    )


def _parse_number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(value)
    return float(value)


EVENT_FILE: Final = "events.csv"
EVENT_HEADER: Final = ("file", "time", "side", "event")
NOT_AN_EVENT_TABLE: Final = f"its first line is not '{','.join(EVENT_HEADER)}'"


def find_event_tables(recording: Path) -> tuple[Path, ...]:
    """Find the table of corrected events in the folder of a recording.

    Parameters
    ----------
    recording
        File of the recording.

    Returns
    -------
    tuple of Path
        The table, or nothing.
    """
    path = recording.parent / EVENT_FILE
    return (path,) if path.is_file() and is_event_table(path) else ()


@text_file.name_file_in_faults
def is_event_table(path: Path) -> bool:
    """Return whether the first line of a file names the columns of an event table."""
    return set(EVENT_HEADER) - {"time"} <= set(
        re.findall("[a-z]+", text_file.read_lines(path)[0].lower())
    )


@text_file.name_file_in_faults
def read_events(path: Path) -> dict[str, dict[FootEvent, int]]:
    """Read a table of corrected events.

    Parameters
    ----------
    path
        The file `events.csv`.

    Returns
    -------
    dict
        File name of a recording -> event -> line of the table.

    Raises
    ------
    InputError
        A row is incomplete, repeats an event, or names no recording of the folder.
    """
    lines = text_file.read_lines(path)
    head, *rows = (_trim_cells(row) for row in csv.reader(lines))
    if tuple(cell.lower() for cell in head) != EVENT_HEADER:
        raise text_file.FileFault(
            f"found '{','.join(head)[:60]}'; a header '{','.join(EVENT_HEADER)}' is needed",
            "line 1",
        )
    events: dict[str, dict[FootEvent, int]] = {}
    for number, row in enumerate(rows, start=2):
        # A spreadsheet may add empty rows
        if not any(row):
            continue
        name, event = _parse_event(row, number, path.parent)
        if event in events.setdefault(name, {}):
            message = f"found '{row[1][:60]}'; allowed: each {row[3]} of a foot once"
            raise text_file.FileFault(message, f"line {number}, time")
        events[name][event] = number
    return events


def _parse_event(row: list[str], number: int, folder: Path) -> tuple[str, FootEvent]:
    """Parse a row of an event table: file of a recording in `folder`, and the event."""
    if len(row) != len(EVENT_HEADER):
        raise text_file.FileFault(
            f"found {len(row)} cells; {len(EVENT_HEADER)} are needed: {', '.join(EVENT_HEADER)}",
            f"line {number}",
        )
    kinds, sides = {moment.value: moment for moment in FootMoment}, ("right", "left")
    name, time, side, kind = row

    def fault(found: str, allowed: str, field: str) -> text_file.FileFault:
        return text_file.FileFault(
            f"found '{found[:60]}'; allowed: {allowed}", f"line {number}, {field}"
        )

    if not name or Path(name).name != name or not (folder / name).is_file():
        raise fault(name, "the name of a recording in this folder", "file")
    try:
        seconds = float(time)
    except ValueError:
        seconds = math.nan
    if not math.isfinite(seconds):
        raise fault(time, "a number, in s", "time")
    if side.lower() not in sides:
        raise fault(side, ", ".join(sides), "side")
    if kind.lower() not in kinds:
        raise fault(kind, ", ".join(kinds), "event")
    return name, FootEvent(kinds[kind.lower()], SIDES[side.lower()], seconds)


def _trim_cells(row: list[str]) -> list[str]:
    """Remove empty cells after the last column."""
    last = max((k for k, cell in enumerate(row, start=1) if cell.strip()), default=0)
    return [cell.strip() for cell in row[: max(last, len(EVENT_HEADER))]]


def apply_corrected_events(recording: Recording, path: Path) -> Recording:
    """Replace the events of a recording by those of the table in its folder.

    Parameters
    ----------
    recording
        The complete recording.
    path
        Its file.

    Returns
    -------
    Recording
        With the corrected events and a note; the same one if the table does not name it.

    Raises
    ------
    InputError
        The table is damaged, or has an event of this recording outside its frames.
    """
    for table in find_event_tables(path):
        if (events := read_events(table).get(path.name)) is not None:
            return _replace_events(table, recording, events)
    if (path.parent / EVENT_FILE).is_file() and not find_event_tables(path):
        return recording.with_notes(f"{EVENT_FILE} is not used: {NOT_AN_EVENT_TABLE}")
    return recording


@text_file.name_file_in_faults
def _replace_events(table: Path, recording: Recording, events: dict[FootEvent, int]) -> Recording:
    first, last = float(recording.time[0]), float(recording.time[-1])
    for event, line in events.items():
        if not first - 1e-3 <= event.time <= last + 1e-3:
            raise text_file.FileFault(
                f"found {event.time:g}; allowed: {first:g} to {last:g} s", f"line {line}, time"
            )
    note = (
        f"{len(events)} foot events are those of {EVENT_FILE}; others of the file, plates and "
        "motion are not used"
    )
    ordered = tuple(sorted(events, key=lambda e: e.time))
    return replace(recording, events=ordered, corrected=True).with_notes(note)
