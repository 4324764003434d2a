"""One door for every file: its ending says which reader it meets."""

from __future__ import annotations

from dataclasses import replace
from os import PathLike
from pathlib import Path

import numpy as np

from gaitcal.errors import InputError, nearest
from gaitcal.recording.c3d.reader import read_c3d
from gaitcal.recording.csv import read_forces_csv, read_markers_csv, with_corners
from gaitcal.recording.force_tables import Forces
from gaitcal.recording.mot import read_mot_forces
from gaitcal.recording.recording import Recording
from gaitcal.recording.text_file import readable_size
from gaitcal.recording.trc import read_trc

MARKER_READERS = {".c3d": read_c3d, ".trc": read_trc, ".csv": read_markers_csv}
FORCE_READERS = {".mot": read_mot_forces, ".sto": read_mot_forces, ".csv": read_forces_csv}


def read_recording(path: str | PathLike[str], *, forces: str | PathLike[str] | None = None) -> Recording:
    """Markers of a .c3d, .trc or .csv file, and its plates.

    The plates are those of `forces` (.mot, .sto, .csv) if given, else the C3D file's own. Metres, seconds, newtons, y
    up; the turn to the progression is `turn_to_progression`. Sizes are not judged here: millimetres declared as metres
    are for `gaitcal check`.

    Raises
    ------
    InputError
        Every fault of a file, in one line: file, field, what was found, what is allowed.
    """
    file = Path(path)
    reader = MARKER_READERS.get(file.suffix.lower())
    if reader is None:
        raise _unknown_ending(file, tuple(MARKER_READERS))
    with np.errstate(all="ignore"):  # absurd numbers of a damaged file may overflow on their way to a message
        recording = reader(file)
    if forces is None:
        return recording
    read = read_forces(forces)
    notes = read.notes
    if recording.plates:
        notes = (f"The {len(recording.plates)} plates of the C3D file gave way to those of {read.source}.", *notes)
    return replace(recording, plates=read.plates, notes=recording.notes + notes)


def read_forces(path: str | PathLike[str]) -> Forces:
    """Plates of a .mot, .sto or .csv file, y up, in m, N and N·m by definition of these formats.

    Their corners are those of NAME_plates.csv, where it lies beside NAME_forces.csv.
    """
    file = Path(path)
    reader = FORCE_READERS.get(file.suffix.lower())
    if reader is None:
        raise _unknown_ending(file, tuple(FORCE_READERS))
    with np.errstate(all="ignore"):
        forces = reader(file)
    plates, corner_notes = with_corners(forces.plates, file)
    return replace(forces, plates=plates, notes=forces.notes + corner_notes)


def _unknown_ending(file: Path, allowed: tuple[str, ...]) -> InputError:
    readable_size(file)  # a missing file or a folder is the plainer fault
    found = f"found the ending '{file.suffix[:20]}'" if file.suffix else "found no ending"
    return InputError(f"{found}; allowed are {', '.join(allowed)}{nearest(file.suffix, allowed)}", source=file)
