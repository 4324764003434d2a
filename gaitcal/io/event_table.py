"""`events.csv`: foot events as a person corrected them, beside the recordings that they belong to.

    file,time,side,event
    walk.c3d,1.230,right,foot strike          s on the clock of the recording

A recording that the table names has these events and no others: its own, and those that plates and motion tell, give
way. One that it does not name stays as it is. `result.html` writes the table (Save events). Empty cells and rows that a
spreadsheet adds, and capitals, do no harm. A file of this name without these columns is another program's: not used.
"""

from __future__ import annotations

import csv
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Final

from gaitcal.io.labels import SIDES, FootEvent, FootMoment
from gaitcal.io.recording import Recording
from gaitcal.io.text_file import FileFault, naming_file, read_lines

EVENTS: Final = "events.csv"
HEADER: Final = ("file", "time", "side", "event")
FOREIGN: Final = f"its first line is not '{','.join(HEADER)}'"


def events_beside(recording: Path) -> tuple[Path, ...]:
    """The table of events in the folder of a recording, if there is one of ours."""
    path = recording.parent / EVENTS
    return (path,) if path.is_file() and is_event_table(path) else ()


@naming_file
def is_event_table(path: Path) -> bool:
    """Whether a file is meant as such a table: its first line names the columns, however they are parted."""
    return set(HEADER) - {"time"} <= set(re.findall("[a-z]+", read_lines(path)[0].lower()))


@naming_file
def read_events(path: Path) -> dict[str, dict[FootEvent, int]]:
    """File name of a recording -> its events, each with its line; every row is right, and names a file beside it."""
    lines = read_lines(path)
    head, *rows = (_cells(row) for row in csv.reader(lines))
    if tuple(cell.lower() for cell in head) != HEADER:
        raise FileFault(f"found '{','.join(head)[:60]}'; a header '{','.join(HEADER)}' is needed", "line 1")
    kinds, sides = {moment.value: moment for moment in FootMoment}, ("right", "left")
    events: dict[str, dict[FootEvent, int]] = {}
    for number, row in enumerate(rows, start=2):
        if not any(row):
            continue
        if len(row) != len(HEADER):
            raise FileFault(f"found {len(row)} cells; {len(HEADER)} are needed: {', '.join(HEADER)}", f"line {number}")
        name, time, side, kind = row

        def fault(found: str, allowed: str, field: str, number: int = number) -> FileFault:
            return FileFault(f"found '{found[:60]}'; allowed: {allowed}", f"line {number}, {field}")

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
    """The whole recording of the file at `path`, with its events in the table beside it, and a note; as it is without.

    Raises
    ------
    InputError
        The table is damaged, or has an event of this recording before its first frame or after its last one.
    """
    for table in events_beside(path):
        if (events := read_events(table).get(path.name)) is not None:
            return _corrected(table, recording, events)
    if (path.parent / EVENTS).is_file() and not events_beside(path):
        return recording.with_notes(f"{EVENTS} is not used: {FOREIGN}")
    return recording


@naming_file
def _corrected(table: Path, recording: Recording, events: dict[FootEvent, int]) -> Recording:
    first, last = float(recording.time[0]), float(recording.time[-1])
    for event, line in events.items():
        if not first - 1e-3 <= event.time <= last + 1e-3:
            raise FileFault(f"found {event.time:g}; allowed: {first:g} to {last:g} s", f"line {line}, time")
    note = f"{len(events)} foot events are those of {EVENTS}; others of the file, plates and motion are not used"
    ordered = tuple(sorted(events, key=lambda e: e.time))
    return replace(recording, events=ordered, corrected=True).with_notes(note)
