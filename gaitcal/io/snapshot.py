"""Read a result with all files in one state, and check that they are unchanged when work is done.

A file that does not match the SHA-256 in the manifest was damaged (a flipped bit, an incomplete
copy) or edited, and is reported before it is used.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from gaitcal.errors import Code, InputError
from gaitcal.io.result_folder import (
    MANIFEST,
    ResultKind,
    compute_sha256,
    read_json_object,
    read_listed_hashes,
)

PEOPLE_FOLDER = "people"
"""Folder of the results of all people within that of a cohort."""

Content = TypeVar("Content")


@dataclass(frozen=True)
class Snapshot:
    """Files of a folder at the time they were read."""

    folder: Path
    sha256: Mapping[str, str | None]
    """File -> SHA-256; None: it was not there."""
    edited: tuple[str, ...] = ()
    """Those that are made to be edited, and are not as gaitcal wrote them."""

    @property
    def remarks(self) -> tuple[str, ...]:
        """One sentence for each edited file, for readers of results that come from these files."""
        return tuple(
            f"{name} is not as 'gaitcal calibrate' wrote it: these results are of the edited file; "
            "if you did not edit "
            "it, it is damaged: calibrate again"
            for name in self.edited
        )

    def require_unchanged(self) -> None:
        """Require that all files are as they were read.

        Raises
        ------
        InputError
            A file has changed.
        """
        for name, digest in self.sha256.items():
            if compute_sha256(self.folder / name) != digest:
                message = "changed while this ran; nothing was written, run again"
                raise InputError(message, source=self.folder / name, code=Code.CHANGED_FILE)


def require_person(folder: Path) -> None:
    """Require that a folder is not a cohort; the message names the result of one person.

    Raises
    ------
    InputError
        The folder is the result of a cohort.
    """
    if read_json_object(folder / MANIFEST).get("kind") != ResultKind.COHORT.value:
        return
    results = (
        path.parent
        for level in ("*", "*/*")
        for path in sorted(folder.glob(f"{PEOPLE_FOLDER}/{level}/{MANIFEST}"))
    )
    one = next(results, None)
    such = "" if one is None else f", such as {one.as_posix()}"
    message = f"is a cohort; name the result of one person, a folder in its {PEOPLE_FOLDER}/{such}"
    raise InputError(message, source=folder, code=Code.NO_RESULT)


def read_whole(
    folder: Path, names: Iterable[str], read: Callable[[], Content], editable: Iterable[str] = ()
) -> tuple[Content, Snapshot]:
    """Call `read` such that all files that it reads are in one state of the folder.

    Parameters
    ----------
    folder
        Result folder.
    names
        Files that `read` reads.
    read
        Function that reads them.
    editable
        Those of `names` that users may edit; they are listed in the snapshot, not refused.

    Returns
    -------
    content, snapshot
        Result of `read`, and the hashes of the files.

    Raises
    ------
    InputError
        The folder is a cohort, or a file is damaged, missing or changes meanwhile.
    """
    require_person(folder)
    wanted, may_differ = (MANIFEST, *names), set(editable)
    before = {name: compute_sha256(folder / name) for name in wanted}
    fault: InputError | None = None
    try:
        edited = _find_edited(folder, before, may_differ)
        content = read()
    except InputError as error:
        fault = error
    if {name: compute_sha256(folder / name) for name in wanted} != before:
        message = "changed while it was read; run again when nothing writes there"
        raise InputError(message, source=folder, code=Code.CHANGED_FILE)
    if fault is not None:
        raise fault
    return content, Snapshot(
        folder, {name: digest for name, digest in before.items() if name != MANIFEST}, edited
    )


def _find_edited(
    folder: Path, found: Mapping[str, str | None], editable: set[str]
) -> tuple[str, ...]:
    """Find files that differ from the manifest and may; InputError for one that may not."""
    differ = tuple(
        name
        for name, digest in read_listed_hashes(folder).items()
        if name in found and found[name] != digest
    )
    for name in differ:
        if found[name] is None:
            message = "is missing, though manifest.json lists it; calibrate again"
        elif name not in editable:
            message = "is damaged: not as gaitcal wrote it; calibrate again"
        else:
            continue
        raise InputError(message, source=folder / name, code=Code.DAMAGED_RESULT)
    return differ
