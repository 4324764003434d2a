"""Why no study follows from a folder, in one line and file by file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from gaitcal.io.recording import Recording
from gaitcal.model.marker_roles import MarkerSet
from gaitcal.session.draft import Draft
from gaitcal.session.folder import Folder, FolderFile
from gaitcal.session.marker_sets import candidates, explained
from gaitcal.session.seen import row_of


def several_people(files: Sequence[FolderFile], people: Mapping[int, tuple[str, ...]]) -> tuple[str, dict[str, str]]:
    """That files hold the markers of several people, in one line, and file -> of whom."""
    told = {files[i].name: f"markers of {len(found)} people ({', '.join(found)})" for i, found in people.items()}
    name, words = next(iter(told.items()))
    more = f", and {len(told) - 1} more files too" if len(told) > 1 else ""
    return f"{words} in one file, {name}{more}: write each person's markers into a file of their own", told


def nothing_here(folder: Folder) -> str:
    """That a folder has no recording, and where some are."""
    if folder.subfolders:
        below = ", ".join(f"{name} ({count})" for name, count in folder.subfolders[:6])
        return f"holds no recording that can be read; folders in it do: {below}; name one of them, one person a folder"
    if not folder.files:
        return "is empty; .c3d, .trc or .csv files of one person are needed"
    return f"holds {len(folder.files)} files, but no recording that can be read (.c3d, .trc or .csv)"


def no_set(recordings: Sequence[Recording], own: Sequence[tuple[str, MarkerSet]]) -> str:
    """Which labels no marker set knows, and what the nearest set misses."""
    labels = list(dict.fromkeys(label for r in recordings for label in r.labels))
    nearest, found = max(
        ((entry, explained(s, labels)) for entry, s in candidates(own)),
        key=lambda pair: (pair[1].legs, -len(pair[1].missing)),
    )
    lacks = ", ".join(found.missing[:6]) + (", ..." if len(found.missing) > 6 else "")
    shown = ", ".join(labels[:12]) + (", ..." if len(labels) > 12 else "")
    return (
        f"no marker set knows enough of the labels {shown}; the nearest, {nearest}, knows {found.known} of "
        f"{len(labels)} and misses {lacks or 'nothing'}; name your own in a TOML file in the folder "
        "(models/markersets has examples), or put the labels right by 'rename' in a study file"
    )


def refused(folder: Folder, fault: str, told: Mapping[str, str]) -> Draft:
    """What was seen of a folder from which no study follows."""
    seen = tuple(row_of(file, reason=told.get(file.name, "")) for file in folder.files)
    return Draft(folder=folder, choice=None, person={}, trials=(), seen=seen, fault=fault)
