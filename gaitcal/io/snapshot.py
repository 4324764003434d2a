"""What was read is what was written, and still is there when the work is done: SHA-256 of files, when and where read.

The manifest of a result lists the SHA-256 of every file written, and that of its own content (`SELF`). A file that
does not match was damaged (a flipped bit, a half copied folder) or edited, and is named before it is used. A
`Snapshot` of the files that a command has read tells at its end whether they are still the same.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from gaitcal.codes import Code
from gaitcal.errors import InputError
from gaitcal.io.lock import MANIFEST, ResultKind, files_of, put_back, read_object, refuse_cohort

FILES, HASHES, SELF = "files", "sha256", "own_sha256"
"""Entries of a manifest: names of files, file -> SHA-256, and SHA-256 of all other entries."""
_TRIES = 20
_AGAIN_S = 0.1
"""A result that is being replaced while it is read is read again, for two seconds."""

Content = TypeVar("Content")


def sha256_of(path: Path) -> str | None:
    """SHA-256 of a file, hexadecimal; None where there is none, or it cannot be read."""
    try:
        with path.open("rb") as stream:
            digest = hashlib.sha256()
            while block := stream.read(1 << 20):
                digest.update(block)
    except (OSError, ValueError):
        return None
    return digest.hexdigest()


def self_hash(manifest: Mapping[str, object]) -> str:
    """SHA-256 of a manifest's entries, but for the one that tells it."""
    entries = {name: value for name, value in manifest.items() if name != SELF}
    return hashlib.sha256(json.dumps(entries, sort_keys=True).encode()).hexdigest()


def sign(content: Path, kind: ResultKind, kept: Iterable[str], carried: Mapping[str, str]) -> None:
    """Put the kind, the files with their hashes, and what was kept of an earlier result into a manifest in `content`.

    `carried`: hashes of files that come from an earlier result, as that one listed them: what was damaged there stays
    damaged here.
    """
    files = [name for name in files_of(content) if name != MANIFEST]
    hashes = {name: carried.get(name) or sha256_of(content / name) for name in files}
    written = read_object(content / MANIFEST)
    manifest: dict[str, object] = {"gaitcal": "", **written, "kind": kind.value, FILES: files, HASHES: hashes}
    if names := list(kept):
        manifest["kept_from_earlier_result"] = names
    manifest[SELF] = self_hash(manifest)
    (content / MANIFEST).write_text(json.dumps(manifest, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def listed(folder: Path) -> dict[str, str]:
    """File -> SHA-256, as the manifest of a folder lists them; empty where there is none.

    Raises
    ------
    InputError
        The manifest is not as it was written.
    """
    manifest = read_object(folder / MANIFEST)
    unreadable = not manifest and (folder / MANIFEST).exists()
    if unreadable or ((SELF in manifest or HASHES in manifest) and manifest.get(SELF) != self_hash(manifest)):
        message = "is damaged, or was edited: not as gaitcal wrote it; run again what wrote it"
        raise InputError(message, source=folder / MANIFEST, code=Code.DAMAGED_RESULT)
    hashes = manifest.get(HASHES)
    return {str(k): str(v) for k, v in hashes.items()} if isinstance(hashes, dict) else {}


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
            f"{name} is not as 'gaitcal calibrate' wrote it: these results are of the edited file; if you did not edit "
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
    """What every reader of the result of one person begins with: a hidden earlier one is put back.

    Raises
    ------
    InputError
        It is a cohort.
    """
    put_back(folder)
    refuse_cohort(folder)


def read_whole(
    folder: Path, names: Iterable[str], read: Callable[[], Content], editable: Iterable[str] = ()
) -> tuple[Content, Snapshot]:
    """Call `read`, which reads these files of a result, such that all of them are of one state of the folder.

    Parameters
    ----------
    editable : those of `names` that people may edit; they are told of in the snapshot and not refused.

    Raises
    ------
    InputError
        It is a cohort, a file is damaged or missing, or the folder goes on changing; and what `read` raises.
    """
    require_person(folder)
    wanted, may_differ = tuple(names), set(editable)
    for _ in range(_TRIES):
        before = _hashes(folder, wanted)
        found: Content | None = None
        fault: InputError | None = None
        edited: tuple[str, ...] = ()
        try:
            edited = _edited(folder, before, may_differ)
            found = read()
        except InputError as error:
            fault = error
        if _hashes(folder, wanted) == before:
            if fault is not None:
                raise fault
            known = {name: digest for name, digest in before.items() if name != MANIFEST}
            return found, Snapshot(folder, known, edited)  # type: ignore[return-value]
        time.sleep(_AGAIN_S)
    raise InputError(
        "goes on changing while it is read; run again when nothing writes there", source=folder, code=Code.CHANGED_FILE
    )


def _hashes(folder: Path, names: Iterable[str]) -> dict[str, str | None]:
    return {name: sha256_of(folder / name) for name in (MANIFEST, *names)}


def _edited(folder: Path, found: Mapping[str, str | None], editable: set[str]) -> tuple[str, ...]:
    """Files that differ from what the manifest lists and may; InputError for one that may not."""
    differ = [name for name, digest in listed(folder).items() if name in found and found[name] != digest]
    for name in differ:
        if found[name] is None:
            raise InputError(
                "is missing, though manifest.json lists it; calibrate again",
                source=folder / name,
                code=Code.DAMAGED_RESULT,
            )
        if name not in editable:
            raise InputError(
                "is damaged: not as gaitcal wrote it; calibrate again", source=folder / name, code=Code.DAMAGED_RESULT
            )
    return tuple(differ)
