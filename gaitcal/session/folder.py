"""Every file of a folder, read once: recordings, tables of forces, marker sets, studies, and what is none of these.

Only files directly in the folder: one person a folder. A file that cannot be read ends nothing; it keeps its reason.

Names of trials, and what the names of files say of them: weak evidence, told where it contradicts.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from gaitcal.codes import Code
from gaitcal.errors import InputError
from gaitcal.io.csv import CORNER_HEADER, is_force_header, read_header
from gaitcal.io.force_tables import Forces
from gaitcal.io.formats import FORCE_READERS, read_forces, read_recording
from gaitcal.io.recording import Recording
from gaitcal.io.result_folder import MANIFEST, ResultKind, read_object
from gaitcal.io.toml import read_toml
from gaitcal.model.marker_set import MarkerSet, load_marker_set

MOST_FILES = 2000
"""A folder with more files is no person's."""
MARKER_ENDINGS, TABLE_ENDINGS = (".c3d", ".trc"), (".mot", ".sto")
LARGEST_XML = 1_000_000
"""Bytes; the settings of external forces take some 3 kB."""
_HIDDEN = re.compile(r"[.~]")


class FileKind(Enum):
    """What a file is."""

    RECORDING = "recording"
    FORCES = "forces"
    EXTERNAL_LOADS = "external forces"
    """OpenSim's XML that says which columns of a table are which force."""
    CORNERS = "corners of plates"
    MARKER_SET = "marker set"
    STUDY = "study"
    UNREADABLE = "not readable"
    OTHER = "other"


@dataclass(frozen=True, kw_only=True)
class FolderFile:
    """One file, as it was read."""

    path: Path
    name: str
    """As seen from the folder."""
    kind: FileKind
    recording: Recording | None = None
    forces: Forces | None = None
    marker_set: MarkerSet | None = None
    names: str = ""
    """Of external forces: the table that they name."""
    reason: str = ""
    """Why it is of no use, where it is of none."""


@dataclass(frozen=True, kw_only=True)
class Folder:
    """A folder as it was read."""

    path: Path
    files: tuple[FolderFile, ...]
    """In the order of their names, letters without case."""
    subfolders: tuple[tuple[str, int], ...]
    """Folders in it that hold recordings, and how many."""
    deep: bool = False
    """Whether the files of these are among `files`."""

    def of_kind(self, kind: FileKind) -> tuple[FolderFile, ...]:
        """Its files of one kind."""
        return tuple(file for file in self.files if file.kind is kind)

    @property
    def name(self) -> str:
        """Name of the folder, whatever way leads to it."""
        return self.path.resolve().name


def read_folder(path: Path, *, deep: bool = False) -> Folder:
    """Read every file that lies in a folder; `deep`: and in the folders directly in it that hold recordings.

    Raises
    ------
    InputError
        It is no folder, cannot be listed, or holds more than `MOST_FILES` files.
    """
    if not path.is_dir():
        raise InputError("is no folder; a folder with one person's recordings is needed", source=path, code=Code.FOLDER)
    try:
        entries = sorted(path.iterdir(), key=lambda p: (p.name.lower(), p.name))
    except OSError as error:
        raise InputError(f"cannot be listed: {error.strerror}", source=path, code=Code.UNREADABLE) from None
    files = _files_in(path)
    below = [(p.name, _recordings_in(p)) for p in entries if p.is_dir() and not _HIDDEN.match(p.name)]
    subfolders = tuple((name, count) for name, count in below if count)
    if deep:
        files += [file for name, _ in subfolders for file in _files_in(path / name)]
    if len(files) > MOST_FILES:
        raise InputError(
            f"found {len(files)} files; a folder of one person has fewer than {MOST_FILES}",
            source=path,
            code=Code.FOLDER,
        )
    read = tuple(_read(file, file.relative_to(path).as_posix()) for file in files)
    return Folder(path=path, files=read, subfolders=subfolders, deep=deep)


def _files_in(folder: Path) -> list[Path]:
    try:
        files = sorted(folder.iterdir(), key=lambda p: (p.name.lower(), p.name))
    except OSError:
        return []
    return [p for p in files if p.is_file() and not _HIDDEN.match(p.name)]


def _recordings_in(folder: Path) -> int:
    try:
        if (folder / MANIFEST).is_file() and read_object(folder / MANIFEST).get("kind") != ResultKind.EXAMPLE.value:
            return 0  # a result of ours
        return sum(p.suffix.lower() in MARKER_ENDINGS for p in folder.iterdir())
    except OSError:
        return 0


def _read(path: Path, name: str) -> FolderFile:
    try:
        return replace(_understood(path), name=name)
    except InputError as fault:
        return FolderFile(path=path, name=name, kind=FileKind.UNREADABLE, reason=_plain(fault, path))


def _understood(path: Path) -> FolderFile:
    """A file by its ending and content, named without its folder."""
    ending = path.suffix.lower()
    if ending in MARKER_ENDINGS:
        return _recording(path)
    if ending in TABLE_ENDINGS:
        return FolderFile(path=path, name=path.name, kind=FileKind.FORCES, forces=_forces(path))
    if ending == ".csv":
        return _csv(path)
    if ending == ".toml":
        return _toml(path)
    if ending == ".xml":
        return _xml(path)
    return FolderFile(
        path=path, name=path.name, kind=FileKind.OTHER, reason=f"a file ending in '{ending}' holds no recording"
    )


def _other(path: Path, reason: str) -> FolderFile:
    return FolderFile(path=path, name=path.name, kind=FileKind.OTHER, reason=reason)


def _plain(fault: InputError, path: Path) -> str:
    """The fault without the path, which stands before it anyway."""
    return str(fault).removeprefix(f"{path}: ")


def _recording(path: Path) -> FolderFile:
    with np.errstate(all="ignore"):
        recording = read_recording(path)
    return FolderFile(path=path, name=path.name, kind=FileKind.RECORDING, recording=recording)


def _forces(path: Path) -> Forces:
    with np.errstate(all="ignore"):
        return read_forces(path)


def _csv(path: Path) -> FolderFile:
    try:
        header = read_header(path)
    except InputError:
        text = path.read_bytes()[:4000].decode("utf-8", "replace")
        if any(line.strip().lower() == ",".join(CORNER_HEADER) for line in text.splitlines()):
            return FolderFile(path=path, name=path.name, kind=FileKind.CORNERS)
        raise
    if is_force_header(header):
        return FolderFile(path=path, name=path.name, kind=FileKind.FORCES, forces=_forces(path))
    return _recording(path)


def _toml(path: Path) -> FolderFile:
    content = read_toml(path)
    if declares_study(content):
        return FolderFile(path=path, name=path.name, kind=FileKind.STUDY)
    if "landmarks" in content:
        return FolderFile(path=path, name=path.name, kind=FileKind.MARKER_SET, marker_set=load_marker_set(path))
    return _other(path, "neither a study nor a marker set")


def declares_study(content: Mapping[str, object]) -> bool:
    """Whether a TOML table is a study."""
    return "trial" in content or "subject" in content


def _xml(path: Path) -> FolderFile:
    try:
        text = path.read_bytes()
        if len(text) > LARGEST_XML or b"<!ENTITY" in text:
            raise InputError("is no XML of external forces", source=path, code=Code.FILE_FORMAT)
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, OSError) as error:
        raise InputError(f"is no readable XML: {error}", source=path, code=Code.FILE_FORMAT) from None
    table = (root.findtext(".//datafile") or "").strip()
    if not table:
        return FolderFile(
            path=path, name=path.name, kind=FileKind.OTHER, reason="an XML that names no table of external forces"
        )
    forces = None
    if ".xml" in FORCE_READERS and _readable(path.parent / table) is None:
        forces = _readable(path)  # the table has columns that only the XML explains
    return FolderFile(path=path, name=path.name, kind=FileKind.EXTERNAL_LOADS, names=table, forces=forces)


def _readable(path: Path) -> Forces | None:
    """The forces of a table or of an XML that names one; None where they cannot be read."""
    try:
        return _forces(path)
    except InputError:
        return None


def marker_sets_above(folder: Path) -> tuple[FolderFile, ...]:
    """Marker sets that lie beside the folder, where laboratories keep one for all of their people."""
    above = folder.resolve().parent
    try:
        files = sorted(p for p in above.iterdir() if p.suffix.lower() == ".toml" and p.is_file())
    except OSError:
        return ()
    return tuple(found for found in (_read(file, file.name) for file in files) if found.kind is FileKind.MARKER_SET)


_JOINT_WORD = re.compile(r"(hip|knee|ankle)(?![a-z]*cent)", re.IGNORECASE)


def name_contradicts(stem: str, role: tuple[str, str]) -> str:
    """What a file's name says against its role; empty where it says nothing."""
    word = _JOINT_WORD.search(stem)
    if word is None:
        return ""
    name = word.group(1).lower()
    if role[0] == "joint" and role[1].startswith(name):
        return ""
    return f"though its name says {name}"


def trial_names(stems: Sequence[str]) -> list[str]:
    """Names of trials from those of files: safe as file names, and each once whatever the case."""
    out: list[str] = []
    for stem in stems:
        plain = re.sub(r"[^A-Za-z0-9_-]+", "_", stem).strip("_")[:60] or "trial"
        if re.fullmatch(r"(con|prn|aux|nul|com\d|lpt\d)", plain, re.IGNORECASE):
            plain += "_"
        name, count = plain, 1
        while name.lower() in {other.lower() for other in out}:
            count += 1
            name = f"{plain}_{count}"
        out.append(name)
    return out
