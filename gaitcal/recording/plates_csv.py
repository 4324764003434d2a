"""Corners of force plates in a table of their own beside the table of forces: `plate,corner,x,y,z`, in metres, y up.

The wide table of forces has no place for them, and without them nobody can tell whether a foot was wholly on its plate.
"""

from __future__ import annotations

import csv
import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from gaitcal.atomic import atomic_file
from gaitcal.errors import InputError
from gaitcal.recording.input_file import read_lines
from gaitcal.recording.recording import Array, ForcePlate

HEADER = ["plate", "corner", "x", "y", "z"]
CORNERS = 4


def plates_file(forces: Path) -> Path:
    """NAME_plates.csv beside NAME_forces.csv (or beside NAME.csv)."""
    return forces.with_name(f"{forces.stem.removesuffix('_forces')}_plates.csv")


def write_plates_csv(path: Path, plates: tuple[ForcePlate, ...]) -> None:
    """The corners of all plates that have some; reads back bit for bit."""
    with atomic_file(path) as part, part.open("w", encoding="utf-8", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(HEADER)
        for plate in plates:
            for k, corner in enumerate([] if plate.corners is None else plate.corners.tolist()):
                rows.writerow([plate.name, k + 1, *map(repr, corner)])


def with_corners(plates: tuple[ForcePlate, ...], forces: Path) -> tuple[tuple[ForcePlate, ...], tuple[str, ...]]:
    """The plates with the corners of the table beside `forces`, if there is one; and a note that says so.

    InputError where that table is damaged or names a plate that the forces lack.
    """
    path = plates_file(forces)
    if not path.is_file():
        return plates, ()
    corners = _read(path)
    names = [plate.name for plate in plates]
    for name in corners:
        if name not in names:
            allowed = ", ".join(names)
            raise InputError(f"found the plate '{name[:20]}'; {forces.name} has {allowed}", source=path)
    found = tuple(replace(plate, corners=corners.get(plate.name, plate.corners)) for plate in plates)
    return found, (f"Corners of plates {', '.join(corners)} from {path.name}.",)


def _read(path: Path) -> dict[str, Array]:
    rows = list(csv.reader(line for line in read_lines(path) if line.strip() and not line.startswith("#")))
    if not rows or [cell.strip().lower() for cell in rows[0]] != HEADER:
        raise InputError(f"a header '{','.join(HEADER)}' is needed", source=path)
    found: dict[str, Array] = {}
    for number, row in enumerate(rows[1:], start=1):
        field = f"row {number}"
        try:
            name, corner, values = row[0].strip(), int(row[1]), [float(cell) for cell in row[2:]]
        except (ValueError, IndexError):
            shown = ",".join(row)[:60]
            raise InputError(f"found '{shown}'; plate,corner,x,y,z are needed", source=path, field=field) from None
        if not 1 <= corner <= CORNERS or len(values) != 3 or not all(map(math.isfinite, values)):
            raise InputError(
                f"found '{','.join(row)[:60]}'; a corner of 1 to {CORNERS} and three numbers are needed",
                source=path,
                field=field,
            )
        own = found.setdefault(name, np.full((CORNERS, 3), np.nan))
        if not np.isnan(own[corner - 1, 0]):
            raise InputError(f"found corner {corner} of plate '{name[:20]}' twice", source=path, field=field)
        own[corner - 1] = values
    for name, own in found.items():
        if np.isnan(own).any():
            missing = ", ".join(str(k + 1) for k in np.flatnonzero(np.isnan(own[:, 0])))
            raise InputError(f"corner {missing} of plate '{name[:20]}' is missing; 4 are needed", source=path)
    return found
