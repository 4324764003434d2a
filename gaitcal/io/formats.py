"""Read, write and convert recordings; the ending of a file selects its reader and writer.

`convert` writes:

| from        | to                                                                                 |
|-------------|------------------------------------------------------------------------------------|
| C3D         | CSV (plates: NAME_forces.csv), TRC (plates: NAME_forces.mot);                      |
|             | corners: NAME_plates.csv; CSV, too: person, events and widths in NAME_facts.csv    |
| TRC         | CSV, C3D                                                                           |
| CSV markers | TRC, C3D (with the plates of NAME_forces.csv, if it is in the same folder)         |
| MOT, STO    | CSV of forces                                                                      |
| XML loads   | CSV of forces, MOT (with the names of the ExternalLoads)                           |
| CSV forces  | MOT                                                                                |
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import TypeVar

import numpy as np

from gaitcal.errors import Code, InputError, suggest_name
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
    """Read the markers and force plates of one trial.

    x is not rotated to the progression (`rotate_to_progression`). Sizes are not checked here;
    `gaitcal check` reports millimetres declared as metres.

    Parameters
    ----------
    path
        Markers: a .c3d, .trc or .csv file.
    forces
        Force plates: a .mot, .sto, .csv or .xml file; unless given, the plates of the C3D file.

    Returns
    -------
    Recording
        Metres, seconds, newtons, y up.

    Raises
    ------
    InputError
        A file cannot be read; one line with file, field, the value found and the allowed ones.
    """
    recording = segment_poses.add_landmarks(_read_by_suffix(Path(path), MARKER_READERS))
    if forces is None:
        return recording
    read = read_forces(forces)
    notes = read.notes
    if recording.plates:
        notes = (
            f"The {len(recording.plates)} plates of the C3D file were replaced by those of "
            f"{read.source}.",
            *notes,
        )
    return replace(recording, plates=read.plates, feet=read.feet, notes=recording.notes + notes)


def read_forces(path: str | PathLike[str]) -> Forces:
    """Read the force plates of a .mot, .sto or .csv file or of an ExternalLoads .xml.

    Corners are those of NAME_plates.csv beside NAME_forces.csv, if it exists.

    Parameters
    ----------
    path
        File of the forces, in m, N and N·m.

    Returns
    -------
    Forces
        y up, acting on the body.

    Raises
    ------
    InputError
        The file cannot be read.
    """
    return csv_files.add_corners(_read_by_suffix(Path(path), FORCE_READERS), Path(path))


def _read_by_suffix(file: Path, readers: Mapping[str, Callable[[Path], _T]]) -> _T:
    """Read a file with the reader for its ending."""
    reader = readers.get(file.suffix.lower())
    if reader is None:
        # A missing file or a folder is reported rather than its ending
        text_file.check_readable(file)
        ending = f"found the ending '{file.suffix[:20]}'" if file.suffix else "found no ending"
        allowed = f"allowed are {', '.join(readers)}{suggest_name(file.suffix, readers)}"
        raise InputError(f"{ending}; {allowed}", source=file, code=Code.FILE_FORMAT)
    # Absurd numbers of a damaged file may overflow before they are reported
    with np.errstate(all="ignore"):
        return reader(file)


def convert(source: str | PathLike[str], target: str | PathLike[str]) -> tuple[Path, ...]:
    """Convert a file to another format; the endings select the formats.

    Parameters
    ----------
    source
        File to read.
    target
        File to write.

    Returns
    -------
    tuple of Path
        The files written, `target` first.

    Raises
    ------
    InputError
        The source cannot be read, or cannot be written in that format.
    """
    return _convert(Path(target), Path(source))


@text_file.name_file_in_faults
def _convert(new: Path, old: Path) -> tuple[Path, ...]:
    text_file.check_readable(old)
    if new.is_dir():
        raise text_file.FileFault("found a folder; a file name is needed", code=Code.NOT_WRITABLE)
    if new.exists() and new.samefile(old):
        raise text_file.FileFault("source and target are the same file", code=Code.NOT_WRITABLE)
    old_ending, ending = old.suffix.lower(), new.suffix.lower()
    holds_forces = old_ending in (".mot", ".sto", ".xml") or (
        old_ending == ".csv" and csv_files.is_force_header(csv_files.read_header(old))
    )
    allowed = FORCE_WRITERS if holds_forces else MARKER_WRITERS
    if ending not in allowed:
        found = new.suffix[:20] or "no ending"
        raise text_file.FileFault(
            f"found {found}; {old.name} can become {', '.join(allowed)}", code=Code.NOT_WRITABLE
        )
    if holds_forces:
        return _write_forces(new, read_forces(old).plates)
    force_file = old.with_name(f"{old.stem}_forces.csv")
    has_forces = (old_ending, ending) == (".csv", ".c3d") and force_file.is_file()
    forces = force_file if has_forces else None
    recording = read_recording(old, forces=forces)
    written: tuple[Path, ...] = ()
    if recording.plates and ending != ".c3d":
        forces_ending = ".csv" if ending == ".csv" else ".mot"
        written = _write_forces(
            new.with_name(f"{new.stem}_forces{forces_ending}"), recording.plates
        )
    MARKER_WRITERS[ending](new, recording)
    if ending == ".csv" and csv_files.locate_facts_file(new).is_file():
        written = (*written, csv_files.locate_facts_file(new))
    return (new, *written)


def _write_forces(path: Path, plates: tuple[ForcePlate, ...]) -> tuple[Path, ...]:
    """Write forces and the corners of plates; return the files written.

    Without corners, an existing table of corners belongs to other forces and is emptied.
    """
    FORCE_WRITERS[path.suffix.lower()](path, plates)
    corners = csv_files.locate_plates_file(path)
    if not corners.exists() and all(plate.corners is None for plate in plates):
        return (path,)
    csv_files.write_plates_csv(corners, plates)
    return path, corners
