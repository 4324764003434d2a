"""One row for every file of a folder: what it is, what it shows, what it is used as, and why or why not."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import PureWindowsPath

from gaitcal.session.draft import Seen
from gaitcal.session.folder import FileKind, Folder, FolderFile
from gaitcal.session.force_files import ForceChoice
from gaitcal.session.marker_sets import SetChoice, explained, respelt
from gaitcal.session.movement import Movement

FIRST_LABELS = 8
"""Shown of a recording that no marker set explains."""


@dataclass(frozen=True)
class Roles:
    """What became of the recordings and tables of a folder; recordings by their number."""

    roles: Mapping[int, tuple[str, str]]
    """Role and joint."""
    out: Mapping[int, str]
    """Why a recording is not used."""
    moves: Mapping[int, Movement]
    forces: Mapping[int, ForceChoice]
    unpaired: Mapping[str, str]
    """Table -> why it is nobody's."""
    of_set: frozenset[int]
    """Recordings with the labels of the marker set."""


def row_of(file: FolderFile, *, labels: str = "", shows: str = "", used: str = "", reason: str = "") -> Seen:
    """A file as it was read, and what became of it."""
    frames = None if file.recording is None else len(file.recording.time)
    if file.recording is not None and not labels:
        labels = f"{len(file.recording.labels)}: {' '.join(file.recording.labels[:FIRST_LABELS])}"
    return Seen(
        name=file.name,
        kind=file.kind.value,
        frames=frames,
        labels=labels,
        shows=shows,
        used=used,
        reason=reason or file.reason,
    )


def rows_of(folder: Folder, files: tuple[FolderFile, ...], choice: SetChoice, became: Roles) -> tuple[Seen, ...]:
    """One row a file, in the order of the folder; `files` are its recordings."""
    number = {file.name: i for i, file in enumerate(files)}
    owner = {forces.file.name: files[i].name for i, forces in became.forces.items()}
    return tuple(
        _recording(file, number[file.name], choice, became)
        if file.name in number
        else _other(file, choice, owner, became.unpaired)
        for file in folder.files
    )


def _recording(file: FolderFile, i: int, choice: SetChoice, became: Roles) -> Seen:
    labels = file.recording.labels if file.recording is not None else ()
    found = explained(choice.marker_set, respelt(labels, choice.rename))
    counts = f"{found.known} of {len(labels)} known"
    if i not in became.of_set:
        more = " ..." if len(labels) > FIRST_LABELS else ""
        reason = f"not of marker set {choice.entry}: has {' '.join(labels[:FIRST_LABELS])}{more}"
        return row_of(file, labels=counts, reason=reason)
    moves = became.moves.get(i)
    shows, evidence = ("", "") if moves is None else (moves.shows.value, moves.evidence)
    used = " ".join(filter(None, became.roles.get(i, ())))
    return row_of(file, labels=counts, shows=shows, used=used, reason=became.out.get(i, "") or evidence)


def _other(file: FolderFile, choice: SetChoice, owner: Mapping[str, str], unpaired: Mapping[str, str]) -> Seen:
    """A row of a file that is no recording."""
    if file.forces is not None:
        used = f"forces of {owner[file.name]}" if file.name in owner else ""
        return row_of(file, used=used, reason="" if used else unpaired.get(file.name, "no walk needs it"))
    if file.kind is FileKind.EXTERNAL_LOADS:
        table = PureWindowsPath(file.names).name  # takes / and \ alike
        used = f"says that {table} holds forces" if any(PureWindowsPath(name).name == table for name in owner) else ""
        return row_of(file, used=used, reason="" if used else f"names {table}, which is not used")
    if file.kind is FileKind.MARKER_SET:
        chosen = str(file.path) == choice.entry
        return row_of(file, used="marker set" * chosen, reason="" if chosen else "another set knows more labels")
    if file.kind is FileKind.CORNERS:
        return row_of(file, used="corners of the plates in the table of forces beside it")
    if file.kind is FileKind.STUDY:
        return row_of(file, reason="a study file; it is not looked into")
    return row_of(file)
