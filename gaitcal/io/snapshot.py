"""Reading a result as it was written, all files of one state, and whether they still are the same
when work is done.

A file that does not match the SHA-256 in the manifest was damaged (a flipped bit, a half copied
folder) or edited, and is named before it is used.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from gaitcal.errors import Code, InputError
from gaitcal.io.result_folder import MANIFEST, ResultKind, listed, read_object, sha256_of

PEOPLE = "people"
"""Folder of the results of all people within that of a cohort."""

Content = TypeVar("Content")


@dataclass(frozen=True)
class Snapshot:
    """Files of a folder as they were when they were read."""

    folder: Path
    sha256: Mapping[str, str | None]
    """File -> SHA-256; None: it was not there."""
    edited: tuple[str, ...] = ()
    """Those that are made to be edited, and are not as gaitcal wrote them."""

    @property
    def remarks(self) -> tuple[str, ...]:
        """What a reader of results that come from these files should know, a line for each."""
        return tuple(
            f"{name} is not as 'gaitcal calibrate' wrote it: these results are of the edited file; "
            "if you did not edit "
            "it, it is damaged: calibrate again"
            for name in self.edited
        )

    def require_unchanged(self) -> None:
        """InputError where a file is no longer what was read."""
        for name, digest in self.sha256.items():
            if sha256_of(self.folder / name) != digest:
                message = "changed while this ran; nothing was written, run again"
                raise InputError(message, source=self.folder / name, code=Code.CHANGED_FILE)


def require_person(folder: Path) -> None:
    """Raise InputError where the folder is a cohort, and name the result of one of its people."""
    if read_object(folder / MANIFEST).get("kind") != ResultKind.COHORT.value:
        return
    results = (
        path.parent
        for level in ("*", "*/*")
        for path in sorted(folder.glob(f"{PEOPLE}/{level}/{MANIFEST}"))
    )
    one = next(results, None)
    such = "" if one is None else f", such as {one.as_posix()}"
    message = f"is a cohort; name the result of one person, a folder in its {PEOPLE}/{such}"
    raise InputError(message, source=folder, code=Code.NO_RESULT)


def read_whole(
    folder: Path, names: Iterable[str], read: Callable[[], Content], editable: Iterable[str] = ()
) -> tuple[Content, Snapshot]:
    """Call `read`, which reads these files of a result, such that all of them are of one state of
    the folder.

    `editable` are those of `names` that people may edit; the snapshot lists them, and they are not
    refused. InputError where it is a cohort, a file is damaged, missing or changes meanwhile; and
    what `read` raises.
    """
    require_person(folder)
    wanted, may_differ = (MANIFEST, *names), set(editable)
    before = {name: sha256_of(folder / name) for name in wanted}
    fault: InputError | None = None
    try:
        edited = _edited(folder, before, may_differ)
        content = read()
    except InputError as error:
        fault = error
    if {name: sha256_of(folder / name) for name in wanted} != before:
        message = "changed while it was read; run again when nothing writes there"
        raise InputError(message, source=folder, code=Code.CHANGED_FILE)
    if fault is not None:
        raise fault
    return content, Snapshot(
        folder, {name: digest for name, digest in before.items() if name != MANIFEST}, edited
    )


def _edited(folder: Path, found: Mapping[str, str | None], editable: set[str]) -> tuple[str, ...]:
    """Files that differ from what the manifest lists and may; InputError for one that may not."""
    differ = tuple(
        name for name, digest in listed(folder).items() if name in found and found[name] != digest
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
