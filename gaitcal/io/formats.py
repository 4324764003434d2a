"""One door for every file: its ending says which reader and which writer it meets.

What `convert` makes of a file:

| from        | to                                                                                     |
|-------------|----------------------------------------------------------------------------------------|
| C3D         | CSV (with plates: NAME_forces.csv, too), TRC (NAME_forces.mot); corners: NAME_plates.csv |
| TRC         | CSV, C3D                                                                               |
| CSV markers | TRC, C3D (with the plates of NAME_forces.csv, where that lies beside it)                |
| MOT, STO    | CSV of forces                                                                          |
| XML loads   | CSV of forces, MOT (with the names that the ExternalLoads give)                        |
| CSV forces  | MOT                                                                                    |
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import TypeVar

import numpy as np

from gaitcal.codes import Code
from gaitcal.errors import InputError, nearest
from gaitcal.io.c3d.reader import read_c3d
from gaitcal.io.c3d.writer import write_c3d
from gaitcal.io.csv import (
    is_force_header,
    plates_file,
    read_forces_csv,
    read_header,
    read_markers_csv,
    with_corners,
    write_forces_csv,
    write_markers_csv,
    write_plates_csv,
)
from gaitcal.io.external_loads import read_external_loads
from gaitcal.io.force_tables import Forces
from gaitcal.io.recording import ForcePlate, Recording
from gaitcal.io.text_file import readable_size
from gaitcal.io.trc_mot import read_mot_forces, read_trc, write_forces_mot, write_trc
from gaitcal.runtime import with_one_blas_thread

MARKER_READERS = {".c3d": read_c3d, ".trc": read_trc, ".csv": read_markers_csv}
FORCE_READERS = {".mot": read_mot_forces, ".sto": read_mot_forces, ".csv": read_forces_csv, ".xml": read_external_loads}
MARKER_WRITERS = {".csv": write_markers_csv, ".trc": write_trc, ".c3d": write_c3d}
FORCE_WRITERS = {".csv": write_forces_csv, ".mot": write_forces_mot, ".sto": write_forces_mot}

_T = TypeVar("_T")


@with_one_blas_thread
def read_recording(path: str | PathLike[str], *, forces: str | PathLike[str] | None = None) -> Recording:
    """Markers of a .c3d, .trc or .csv file, and its plates.

    The plates are those of `forces` (.mot, .sto, .csv, .xml) if given, else the C3D file's own. Metres, seconds,
    newtons, y up; the turn to the progression is `turn_to_progression`. Sizes are not judged here: millimetres declared
    as metres are for `gaitcal check`.

    Raises
    ------
    InputError
        Every fault of a file, in one line: file, field, what was found, what is allowed.
    """
    recording = _read(Path(path), MARKER_READERS)
    if forces is None:
        return recording
    read = read_forces(forces)
    notes = read.notes
    if recording.plates:
        notes = (f"The {len(recording.plates)} plates of the C3D file gave way to those of {read.source}.", *notes)
    return replace(recording, plates=read.plates, feet=read.feet, notes=recording.notes + notes)


def read_forces(path: str | PathLike[str]) -> Forces:
    """Plates of a .mot, .sto or .csv file or of an ExternalLoads .xml, in m, N and N·m by definition of these formats.

    Their corners are those of NAME_plates.csv, where it lies beside NAME_forces.csv.
    """
    forces = _read(Path(path), FORCE_READERS)
    plates, corner_notes = with_corners(forces.plates, Path(path), forces.turn)
    return replace(forces, plates=plates, notes=forces.notes + corner_notes)


def _read(file: Path, readers: Mapping[str, Callable[[Path], _T]]) -> _T:
    """What the reader for the file's ending makes of it."""
    reader = readers.get(file.suffix.lower())
    if reader is None:
        readable_size(file)  # a missing file or a folder is the plainer fault
        ending = f"found the ending '{file.suffix[:20]}'" if file.suffix else "found no ending"
        raise InputError(
            f"{ending}; allowed are {', '.join(readers)}{nearest(file.suffix, readers)}",
            source=file,
            code=Code.FILE_FORMAT,
        )
    with np.errstate(all="ignore"):  # absurd numbers of a damaged file may overflow on their way to a message
        return reader(file)


def convert(source: str | PathLike[str], target: str | PathLike[str]) -> tuple[Path, ...]:
    """Write `source` anew as `target`; the endings say how. Returns the files written, the target first."""
    old, new = Path(source), Path(target)
    readable_size(old)
    if new.is_dir():
        raise InputError("found a folder; a file name is needed", source=new, code=Code.NOT_WRITABLE)
    if new.exists() and new.samefile(old):
        raise InputError("source and target are the same file", source=new, code=Code.NOT_WRITABLE)
    if _holds_forces(old):
        _require_ending(new, FORCE_WRITERS, old)
        plates = read_forces(old).plates
        FORCE_WRITERS[new.suffix.lower()](new, plates)
        return (new, *_write_corners(new, plates))
    _require_ending(new, MARKER_WRITERS, old)
    beside = old.with_name(f"{old.stem}_forces.csv")
    forces = beside if old.suffix.lower() == ".csv" and new.suffix.lower() == ".c3d" and beside.is_file() else None
    return _write_markers(read_recording(old, forces=forces), new)


def _holds_forces(file: Path) -> bool:
    ending = file.suffix.lower()
    return ending in (".mot", ".sto", ".xml") or (ending == ".csv" and is_force_header(read_header(file)))


def _write_markers(recording: Recording, new: Path) -> tuple[Path, ...]:
    """Write markers, and beside formats that hold no plates those too; returns the files written."""
    ending, written = new.suffix.lower(), [new]
    if recording.plates and ending != ".c3d":
        forces_ending = ".csv" if ending == ".csv" else ".mot"
        forces = new.with_name(f"{new.stem}_forces{forces_ending}")
        FORCE_WRITERS[forces_ending](forces, recording.plates)
        written += [forces, *_write_corners(forces, recording.plates)]
    MARKER_WRITERS[ending](new, recording)
    return tuple(written)


def _write_corners(forces: Path, plates: tuple[ForcePlate, ...]) -> tuple[Path, ...]:
    """Beside a file of forces; where there are none, a table that lies there already is emptied, as it is another's."""
    path = plates_file(forces)
    if not path.exists() and all(plate.corners is None for plate in plates):
        return ()
    write_plates_csv(path, plates)
    return (path,)


def _require_ending(new: Path, allowed: Iterable[str], old: Path) -> None:
    if new.suffix.lower() not in allowed:
        ending = new.suffix[:20] or "no ending"
        raise InputError(
            f"found {ending}; {old.name} can become {', '.join(allowed)}", source=new, code=Code.NOT_WRITABLE
        )
