"""From one file format to another.

| from        | to                                                                                     |
|-------------|----------------------------------------------------------------------------------------|
| C3D         | CSV (with plates: NAME_forces.csv, too), TRC (NAME_forces.mot); corners: NAME_plates.csv |
| TRC         | CSV, C3D                                                                               |
| CSV markers | TRC, C3D (with the plates of NAME_forces.csv, where that lies beside it)                |
| MOT, STO    | CSV of forces                                                                          |
| CSV forces  | MOT                                                                                    |
"""

from __future__ import annotations

from os import PathLike
from pathlib import Path

from gaitcal.errors import InputError
from gaitcal.recording.c3d.writer import write_c3d
from gaitcal.recording.csv import (
    is_force_header,
    plates_file,
    read_header,
    write_forces_csv,
    write_markers_csv,
    write_plates_csv,
)
from gaitcal.recording.mot import write_forces_mot
from gaitcal.recording.read import read_forces, read_recording
from gaitcal.recording.recording import ForcePlate, Recording
from gaitcal.recording.text_file import readable_size
from gaitcal.recording.trc import write_trc

MARKER_TARGETS = (".csv", ".trc", ".c3d")
FORCE_TARGETS = (".csv", ".mot", ".sto")


def convert(source: str | PathLike[str], target: str | PathLike[str]) -> tuple[Path, ...]:
    """Write `source` anew as `target`; the endings say how. Returns the files written, the target first."""
    old, new = Path(source), Path(target)
    readable_size(old)
    if new.is_dir():
        raise InputError("found a folder; a file name is needed", source=new)
    if new.exists() and new.samefile(old):
        raise InputError("source and target are the same file", source=new)
    if _holds_forces(old):
        return _convert_forces(old, new)
    _require_ending(new, MARKER_TARGETS, old)
    beside = old.with_name(f"{old.stem}_forces.csv")
    forces = beside if old.suffix.lower() == ".csv" and new.suffix.lower() == ".c3d" and beside.is_file() else None
    return _write_markers(read_recording(old, forces=forces), new)


def _holds_forces(file: Path) -> bool:
    ending = file.suffix.lower()
    return ending in (".mot", ".sto") or (ending == ".csv" and is_force_header(read_header(file)))


def _convert_forces(old: Path, new: Path) -> tuple[Path, ...]:
    _require_ending(new, FORCE_TARGETS, old)
    forces = read_forces(old)
    if new.suffix.lower() == ".csv":
        write_forces_csv(new, forces.plates)
    else:
        write_forces_mot(new, forces.plates)
    return (new, *_write_corners(new, forces.plates))


def _write_markers(recording: Recording, new: Path) -> tuple[Path, ...]:
    ending = new.suffix.lower()
    if ending == ".c3d":
        write_c3d(new, recording)
        return (new,)
    written = [new]
    if recording.plates:
        forces = new.with_name(f"{new.stem}_forces{'.csv' if ending == '.csv' else '.mot'}")
        (write_forces_csv if ending == ".csv" else write_forces_mot)(forces, recording.plates)
        written.append(forces)
        written += _write_corners(forces, recording.plates)
    (write_markers_csv if ending == ".csv" else write_trc)(new, recording)
    return tuple(written)


def _write_corners(forces: Path, plates: tuple[ForcePlate, ...]) -> tuple[Path, ...]:
    """Beside a file of forces; where there are none, a table that lies there already is emptied, as it is another's."""
    path = plates_file(forces)
    if not path.exists() and all(plate.corners is None for plate in plates):
        return ()
    write_plates_csv(path, plates)
    return (path,)


def _require_ending(new: Path, allowed: tuple[str, ...], old: Path) -> None:
    if new.suffix.lower() not in allowed:
        found = new.suffix[:20] or "no ending"
        raise InputError(f"found {found}; {old.name} can become {', '.join(allowed)}", source=new)
