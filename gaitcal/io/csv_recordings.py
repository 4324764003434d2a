"""Our own CSV tables: y up, metres, seconds, N, N·m. No number is converted on reading; markers or
forces that clearly have another axis up are turned by quarters, as their other files are.

    NAME.csv         markers   time,RASI_x,RASI_y,RASI_z,...                               an empty cell is a gap
    NAME_forces.csv  plates    time,1_fx,1_fy,1_fz,1_px,1_py,1_pz,1_tx,1_ty,1_tz,2_fx,...  force, point, moment about it
    NAME_plates.csv  corners   plate,corner,x,y,z
    NAME_facts.csv   the rest  fact,value              what a C3D file said of the person and of events

The corners have no place in the table of forces, and without them nobody can tell whether a foot
was wholly on its plate. Numbers are written in the shortest form that reads back to the same bits.
Lines before the header that begin with `#` are comments. Facts are those of `labels.Facts`, without
name and doubts, in kg, m, rad, s, values as JSON:

    mass,66.5
    knee_width,"{""r"": 0.105, ""l"": 0.107}"
    event,"[1.23, ""r"", ""foot strike""]"

Computed points are columns of the table itself: `computed:RKNE_x`.

`events.csv`: foot events as a person corrected them, beside the recordings that they belong to.

    file,time,side,event
    walk.c3d,1.230,right,foot strike          s on the clock of the recording

A recording that the table names has these events and no others: its own, and those that plates and
motion tell, give way. One that it does not name stays as it is. `result.html` writes the table
(Save events). Empty cells and rows that a spreadsheet adds, and capitals, do no harm. A file of
this name without these columns is another program's: not used.
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
from gaitcal.io.axes import body_vertical, turn_up
from gaitcal.io.force_tables import Forces, PlateColumns, build_plate, on_one_time, standing
from gaitcal.io.labels import (
    SIDES,
    ComputedPoints,
    Facts,
    FootEvent,
    FootMoment,
    axes_points,
    clean,
    unique,
)
from gaitcal.io.recording import ForcePlate, Recording, require_plain_labels, zeros_to_missing

MARKER_COLUMN = re.compile(r"(?P<name>.+)_(?P<axis>[xyz])", re.DOTALL)
FORCE_COLUMN = re.compile(r"(?P<name>.+)_(?P<quantity>[fpt])(?P<axis>[xyz])", re.DOTALL)
QUANTITIES = {"f": "force", "p": "point", "t": "moment"}
CORNER_HEADER = ["plate", "corner", "x", "y", "z"]
CORNERS = 4


@text_file.naming_file
def read_markers_csv(path: Path) -> Recording:
    """Markers of a wide table, every number as written."""
    names, table = _table(path)
    if is_force_header(names):
        raise text_file.FileFault("this is a table of forces; give it as the forces of a trial")
    facts, events = read_facts_csv(facts_file(path))
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
    of_models = {
        name: columns for (name, _), columns in places.items() if name.startswith(COMPUTED)
    }
    places = {key: columns for key, columns in places.items() if key[0] not in of_models}
    labels, repetition_notes = unique(clean(name) or "?" for name, _ in places)
    markers, gap_notes = zeros_to_missing(_points(table, places.values()))
    modelled = tuple(clean(name.removeprefix(COMPUTED)) or "?" for name in of_models)
    recording = Recording(
        source=str(path),
        time=np.ascontiguousarray(table.values[:, 0]),
        labels=labels,
        markers=markers,
        notes=repetition_notes + gap_notes,
        events=events,
        facts=facts,
        computed=ComputedPoints(modelled, _points(table, of_models.values()))
        if of_models
        else None,
    )
    vertical = body_vertical(markers)
    return recording if vertical is None or vertical.axis == 1 else turn_up(recording, vertical)


def _points(table: text_file.NumberTable, columns: Collection[dict[int, int]]) -> Array:
    """(nf, np, 3) m of the columns (axis -> column after time) of points."""
    order = [of_point[axis] for of_point in columns for axis in range(3)]
    return table.values[:, 1:][:, order].reshape(len(table.values), len(columns), 3)


@text_file.naming_file
def read_forces_csv(path: Path) -> Forces:
    """Plates of a wide table, every number as written."""
    names, table = _table(path)
    columns_of: dict[str, PlateColumns] = {}
    for column, name in enumerate(names):
        match = FORCE_COLUMN.fullmatch(name)
        if match is None:
            raise text_file.FileFault(
                f"found the column '{name[:40]}'; 1_fx, 1_px, 1_tx and so on are allowed"
            )
        columns = columns_of.setdefault(clean(match["name"]), PlateColumns())
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
    return standing(
        path, [plate for plate, _ in built], tuple(note for _, notes in built for note in notes)
    )


def is_force_header(names: list[str]) -> bool:
    """True where every column is one of a plate."""
    return bool(names) and all(FORCE_COLUMN.fullmatch(name) for name in names)


@text_file.naming_file
def read_header(path: Path) -> list[str]:
    """Column names after time."""
    return _header(text_file.read_lines(path))[0]


@text_file.naming_file
def write_markers_csv(path: Path, recording: Recording) -> None:
    """Markers as a wide table that reads back bit for bit, and NAME_facts.csv beside it where there
    is more to say.
    """
    require_plain_labels(recording)
    labels, values = list(recording.labels), recording.markers
    if (computed := recording.computed) is not None:
        left_out = axes_points(computed.labels)  # the four points of each segment's axes
        at = [i for i, label in enumerate(computed.labels) if label not in left_out]
        labels += [COMPUTED + computed.labels[i] for i in at]
        values = np.concatenate([values, computed.points[:, at]], axis=1)
    names = [f"{label}_{axis}" for label in labels for axis in "xyz"]
    _write(path, names, recording.time, values.reshape(len(recording.time), -1))
    write_facts_csv(facts_file(path), recording)


@text_file.naming_file
def write_forces_csv(path: Path, plates: tuple[ForcePlate, ...]) -> None:
    """Plates with one common time as a wide table that reads back bit for bit."""
    time, values = on_one_time(plates)
    names = [
        f"{plate.name}_{quantity}{axis}" for plate in plates for quantity in "fpt" for axis in "xyz"
    ]
    _write(path, names, time, values)


def _write(path: Path, names: list[str], time: Array, values: Array) -> None:
    with atomic.atomic_file(path) as part, part.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerow(["time", *names])
        file.write(text_file.number_lines(np.column_stack([time, values]), ","))


def _table(path: Path) -> tuple[list[str], text_file.NumberTable]:
    """Column names after time, and the numbers with increasing times."""
    lines = text_file.read_lines(path)
    names, start = _header(lines)
    table = text_file.parse_rows(lines, start, 1 + len(names), ",")
    text_file.require_increasing(table.values[:, 0], table.lines)
    return names, table


def _header(lines: list[str]) -> tuple[list[str], int]:
    """Column names after time, and the index of the first line of numbers."""
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


# --------------------------------------------------------------------------------------------- corners of the plates


def plates_file(forces: Path) -> Path:
    """NAME_plates.csv beside NAME_forces.csv (or beside NAME.csv)."""
    return forces.with_name(f"{forces.stem.removesuffix('_forces')}_plates.csv")


def write_plates_csv(path: Path, plates: tuple[ForcePlate, ...]) -> None:
    """The corners of all plates that have some; reads back bit for bit."""
    with atomic.atomic_file(path) as part, part.open("w", encoding="utf-8", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(CORNER_HEADER)
        for plate in plates:
            for k, corner in enumerate([] if plate.corners is None else plate.corners.tolist()):
                rows.writerow([plate.name, k + 1, *map(repr, corner)])


def with_corners(forces: Forces, path: Path) -> Forces:
    """The forces of the file at `path`, with the corners of the table beside it, if there is one;
    and a note on that.

    InputError where that table is damaged or names a plate that the forces lack.
    """
    table = plates_file(path)
    if not table.is_file():
        return forces
    names = [plate.name for plate in forces.plates]
    corners = {
        name: forces.turn.apply(of_plate)
        for name, of_plate in _read_corners(table, path.name, names).items()
    }
    placed = tuple(
        replace(plate, corners=corners.get(plate.name, plate.corners)) for plate in forces.plates
    )
    notes = (f"Corners of plates {', '.join(corners)} from {table.name}.",)
    return replace(forces, plates=placed, notes=forces.notes + notes)


@text_file.naming_file
def _read_corners(path: Path, forces: str, allowed: Sequence[str]) -> dict[str, Array]:
    """Plate, of those that the file `forces` has -> corners (4, 3) m, from a table of corners in
    any order.
    """
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
        if not 1 <= corner <= CORNERS or len(values) != 3 or not all(map(math.isfinite, values)):
            raise text_file.FileFault(
                f"found '{text}'; a corner of 1 to {CORNERS} and three numbers are needed", field
            )
        of_plate = corners.setdefault(name, np.full((CORNERS, 3), np.nan))
        if not np.isnan(of_plate[corner - 1, 0]):
            raise text_file.FileFault(f"found corner {corner} of plate '{name[:20]}' twice", field)
        of_plate[corner - 1] = values
    for name, of_plate in corners.items():
        if np.isnan(of_plate).any():
            missing = ", ".join(str(k + 1) for k in np.flatnonzero(np.isnan(of_plate[:, 0])))
            raise text_file.FileFault(
                f"corner {missing} of plate '{name[:20]}' is missing; 4 are needed"
            )
        if name not in allowed:
            raise text_file.FileFault(
                f"found the plate '{name[:20]}'; {forces} has {', '.join(allowed)}"
            )
    return corners


# ------------------------------------------------------------------------------ what a C3D file says beside its samples

FACT_HEADER: Final = ["fact", "value"]
COMPUTED: Final = "computed:"
EVENT: Final = "event"
_NAMES: Final = tuple(f.name for f in fields(Facts) if f.name not in ("name", "doubtful"))


def facts_file(markers: Path) -> Path:
    """NAME_facts.csv beside NAME.csv."""
    return markers.with_name(f"{markers.stem}_facts.csv")


def write_facts_csv(path: Path, recording: Recording) -> None:
    """What `read_facts_csv` reads back to the same numbers; nothing where there is nothing to say.

    A table that lies there already is another's: it is emptied then.
    """
    facts = {name: getattr(recording.facts, name) for name in _NAMES}
    rows: list[tuple[str, Any]] = [
        (name, value) for name, value in facts.items() if value not in (None, {})
    ]
    rows += [(EVENT, [e.time, e.side, e.moment.value]) for e in recording.events]
    if rows or path.exists():
        with atomic.atomic_file(path) as part, part.open("w", encoding="utf-8", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows(
                [FACT_HEADER, *((n, json.dumps(v)) for n, v in rows)]
            )


@text_file.naming_file
def read_facts_csv(path: Path) -> tuple[Facts, tuple[FootEvent, ...]]:
    """Facts and events of the table at `path`, none where there is none; FileFault for a row that
    says neither.
    """
    facts: dict[str, Any] = {}
    events: list[FootEvent] = []
    rows = list(csv.reader(text_file.read_lines(path))) if path.is_file() else [FACT_HEADER]
    if not rows or rows[0] != FACT_HEADER:
        raise text_file.FileFault(f"a header '{','.join(FACT_HEADER)}' is needed")
    for number, row in enumerate(rows[1:], start=1):
        try:
            name, value = row[0], json.loads(row[1])
            if name == EVENT:
                time, side, moment = value
                events.append(
                    FootEvent(FootMoment(moment), {"r": "r", "l": "l"}[side], _number(time))
                )
            else:
                facts[name] = _fact(name, value)
        except (ValueError, TypeError, KeyError, IndexError, RecursionError):
            allowed = ", ".join((*_NAMES, EVENT))
            raise text_file.FileFault(
                f"found '{','.join(row)[:60]}'; allowed facts: {allowed}", f"row {number}"
            ) from None
    return Facts(**facts), tuple(sorted(events, key=lambda e: e.time))


def _fact(name: str, value: Any) -> Any:
    """A fact of the right kind; ValueError or KeyError else."""
    if name not in _NAMES or (isinstance(value, dict) and not set(value) <= {"r", "l"}):
        raise KeyError(name)
    if name in ("marker_set", "session_date", "birth_date", "is_static"):
        return bool(value) if name == "is_static" else str(value)
    return (
        {side: _number(part) for side, part in value.items()}
        if isinstance(value, dict)
        else _number(value)
    )


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(value)
    return float(value)


EVENTS: Final = "events.csv"
HEADER: Final = ("file", "time", "side", "event")
FOREIGN: Final = f"its first line is not '{','.join(HEADER)}'"


def events_beside(recording: Path) -> tuple[Path, ...]:
    """The table of events in the folder of a recording, if there is one of ours."""
    path = recording.parent / EVENTS
    return (path,) if path.is_file() and is_event_table(path) else ()


@text_file.naming_file
def is_event_table(path: Path) -> bool:
    """Whether a file is meant as such a table: its first line names the columns, however they are
    parted.
    """
    return set(HEADER) - {"time"} <= set(
        re.findall("[a-z]+", text_file.read_lines(path)[0].lower())
    )


@text_file.naming_file
def read_events(path: Path) -> dict[str, dict[FootEvent, int]]:
    """File name of a recording -> its events, each with its line; every row is right, and names a
    file beside it.
    """
    lines = text_file.read_lines(path)
    head, *rows = (_cells(row) for row in csv.reader(lines))
    if tuple(cell.lower() for cell in head) != HEADER:
        raise text_file.FileFault(
            f"found '{','.join(head)[:60]}'; a header '{','.join(HEADER)}' is needed", "line 1"
        )
    kinds, sides = {moment.value: moment for moment in FootMoment}, ("right", "left")
    events: dict[str, dict[FootEvent, int]] = {}
    for number, row in enumerate(rows, start=2):
        if not any(row):
            continue
        if len(row) != len(HEADER):
            raise text_file.FileFault(
                f"found {len(row)} cells; {len(HEADER)} are needed: {', '.join(HEADER)}",
                f"line {number}",
            )
        name, time, side, kind = row

        def fault(
            found: str, allowed: str, field: str, number: int = number
        ) -> text_file.FileFault:
            return text_file.FileFault(
                f"found '{found[:60]}'; allowed: {allowed}", f"line {number}, {field}"
            )

        if not name or Path(name).name != name or not (path.parent / name).is_file():
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
        event = FootEvent(kinds[kind.lower()], SIDES[side.lower()], seconds)
        if event in events.setdefault(name, {}):
            raise fault(time, f"each {kind} of a foot once", "time")
        events[name][event] = number
    return events


def _cells(row: list[str]) -> list[str]:
    """Without empty cells after the last column."""
    last = max((k for k, cell in enumerate(row, start=1) if cell.strip()), default=0)
    return [cell.strip() for cell in row[: max(last, len(HEADER))]]


def with_corrected_events(recording: Recording, path: Path) -> Recording:
    """The whole recording of the file at `path`, with its events in the table beside it, and a
    note; as it is without.

    Raises InputError: The table is damaged, or has an event of this recording before its first
    frame or after its last one.
    """
    for table in events_beside(path):
        if (events := read_events(table).get(path.name)) is not None:
            return _corrected(table, recording, events)
    if (path.parent / EVENTS).is_file() and not events_beside(path):
        return recording.with_notes(f"{EVENTS} is not used: {FOREIGN}")
    return recording


@text_file.naming_file
def _corrected(table: Path, recording: Recording, events: dict[FootEvent, int]) -> Recording:
    first, last = float(recording.time[0]), float(recording.time[-1])
    for event, line in events.items():
        if not first - 1e-3 <= event.time <= last + 1e-3:
            raise text_file.FileFault(
                f"found {event.time:g}; allowed: {first:g} to {last:g} s", f"line {line}, time"
            )
    note = (
        f"{len(events)} foot events are those of {EVENTS}; others of the file, plates and motion "
        "are not used"
    )
    ordered = tuple(sorted(events, key=lambda e: e.time))
    return replace(recording, events=ordered, corrected=True).with_notes(note)
