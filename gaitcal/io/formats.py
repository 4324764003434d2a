"""One door for every file: its ending says which reader and which writer it meets.

What `convert` makes of a file:

| from        | to                                                                                     |
|-------------|----------------------------------------------------------------------------------------|
| C3D         | CSV (with plates: NAME_forces.csv, too), TRC (NAME_forces.mot); corners: NAME_plates.csv |
|             | and, for CSV, the person, events and widths: NAME_facts.csv                            |
| TRC         | CSV, C3D                                                                               |
| CSV markers | TRC, C3D (with the plates of NAME_forces.csv, where that lies beside it)                |
| MOT, STO    | CSV of forces                                                                          |
| XML loads   | CSV of forces, MOT (with the names that the ExternalLoads give)                        |
| CSV forces  | MOT                                                                                    |
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import TypeVar

import numpy as np

from gaitcal.errors import Code, InputError, nearest
from gaitcal.io import csv_recordings as csv_files
from gaitcal.io import segment_poses, text_file
from gaitcal.io.c3d.reader import read_c3d
from gaitcal.io.c3d.writer import write_c3d
from gaitcal.io.force_tables import Forces
from gaitcal.io.opensim_files import (
    read_external_loads,
    read_mot_forces,
    read_trc,
    write_forces_mot,
    write_trc,
)
from gaitcal.io.recording import ForcePlate, Recording
from gaitcal.runtime import with_one_blas_thread

MARKER_READERS = {".c3d": read_c3d, ".trc": read_trc, ".csv": csv_files.read_markers_csv}
FORCE_READERS = {
    ".mot": read_mot_forces,
    ".sto": read_mot_forces,
    ".csv": csv_files.read_forces_csv,
    ".xml": read_external_loads,
}
MARKER_WRITERS = {".csv": csv_files.write_markers_csv, ".trc": write_trc, ".c3d": write_c3d}
FORCE_WRITERS = {
    ".csv": csv_files.write_forces_csv,
    ".mot": write_forces_mot,
    ".sto": write_forces_mot,
}

_T = TypeVar("_T")


@with_one_blas_thread
def read_recording(
    path: str | PathLike[str], *, forces: str | PathLike[str] | None = None
) -> Recording:
    """Markers of a .c3d, .trc or .csv file, and its plates.

    The plates are those of `forces` (.mot, .sto, .csv, .xml) if given, else the C3D file's own.
    Metres, seconds, newtons, y up; the turn to the progression is `turn_to_progression`. Sizes are
    not judged here: millimetres declared as metres are for `gaitcal check`.

    Raises
    ------
    InputError
        Every fault of a file, in one line: file, field, what was found, what is allowed.
    """
    recording = segment_poses.with_landmarks(_read(Path(path), MARKER_READERS))
    if forces is None:
        return recording
    read = read_forces(forces)
    notes = read.notes
    if recording.plates:
        notes = (
            f"The {len(recording.plates)} plates of the C3D file gave way to those of "
            f"{read.source}.",
            *notes,
        )
    return replace(recording, plates=read.plates, feet=read.feet, notes=recording.notes + notes)


def read_forces(path: str | PathLike[str]) -> Forces:
    """Plates of a .mot, .sto or .csv file or of an ExternalLoads .xml, in m, N and N·m by
    definition of these formats.

    Their corners are those of NAME_plates.csv, where it lies beside NAME_forces.csv.
    """
    return csv_files.with_corners(_read(Path(path), FORCE_READERS), Path(path))


def _read(file: Path, readers: Mapping[str, Callable[[Path], _T]]) -> _T:
    """What the reader for the file's ending makes of it."""
    reader = readers.get(file.suffix.lower())
    if reader is None:
        text_file.readable_size(file)  # a missing file or a folder is the plainer fault
        ending = f"found the ending '{file.suffix[:20]}'" if file.suffix else "found no ending"
        allowed = f"allowed are {', '.join(readers)}{nearest(file.suffix, readers)}"
        raise InputError(f"{ending}; {allowed}", source=file, code=Code.FILE_FORMAT)
    with np.errstate(
        all="ignore"
    ):  # absurd numbers of a damaged file may overflow on their way to a message
        return reader(file)


def convert(source: str | PathLike[str], target: str | PathLike[str]) -> tuple[Path, ...]:
    """Write `source` anew as `target`; the endings say how. Returns the files written, the target
    first.
    """
    return _convert(Path(target), Path(source))


@text_file.naming_file
def _convert(new: Path, old: Path) -> tuple[Path, ...]:
    text_file.readable_size(old)
    if new.is_dir():
        raise text_file.FileFault("found a folder; a file name is needed", code=Code.NOT_WRITABLE)
    if new.exists() and new.samefile(old):
        raise text_file.FileFault("source and target are the same file", code=Code.NOT_WRITABLE)
    before, ending = old.suffix.lower(), new.suffix.lower()
    holds_forces = before in (".mot", ".sto", ".xml") or (
        before == ".csv" and csv_files.is_force_header(csv_files.read_header(old))
    )
    allowed = FORCE_WRITERS if holds_forces else MARKER_WRITERS
    if ending not in allowed:
        found = new.suffix[:20] or "no ending"
        raise text_file.FileFault(
            f"found {found}; {old.name} can become {', '.join(allowed)}", code=Code.NOT_WRITABLE
        )
    if holds_forces:
        return _write_forces(new, read_forces(old).plates)
    beside = old.with_name(f"{old.stem}_forces.csv")
    forces = beside if (before, ending) == (".csv", ".c3d") and beside.is_file() else None
    recording = read_recording(old, forces=forces)
    written: tuple[Path, ...] = ()
    if recording.plates and ending != ".c3d":
        forces_ending = ".csv" if ending == ".csv" else ".mot"
        written = _write_forces(
            new.with_name(f"{new.stem}_forces{forces_ending}"), recording.plates
        )
    MARKER_WRITERS[ending](new, recording)
    if ending == ".csv" and csv_files.facts_file(new).is_file():
        written = (*written, csv_files.facts_file(new))
    return (new, *written)


def _write_forces(path: Path, plates: tuple[ForcePlate, ...]) -> tuple[Path, ...]:
    """Write forces and, where any plate has them, corners beside them; returns the files written.

    Without corners, a table of them that lies there already is emptied, as it is another's.
    """
    FORCE_WRITERS[path.suffix.lower()](path, plates)
    corners = csv_files.plates_file(path)
    if not corners.exists() and all(plate.corners is None for plate in plates):
        return (path,)
    csv_files.write_plates_csv(corners, plates)
    return path, corners
