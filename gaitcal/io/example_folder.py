"""An example's folder: recordings that are checked, study.toml, and SOURCE.txt, which says whose they are.

Files that are right are kept, whatever ends a run: what was fetched before a fault or Ctrl-C counts, and the next run
asks for the rest only. A folder with anything else in it is refused (`files/ownership`).
"""

from __future__ import annotations

import json
import textwrap
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

from gaitcal.codes import Code
from gaitcal.errors import InputError
from gaitcal.io.atomic import also_at, atomic_directory
from gaitcal.io.example_download import Connection, download
from gaitcal.io.example_registry import Example, RemoteFile
from gaitcal.io.interruption import InterruptedWork, Stopped
from gaitcal.io.ownership import MANIFEST, ResultKind, read_object
from gaitcal.io.package_data import package_version
from gaitcal.io.snapshot import sha256_of

SOURCE, STUDY = "SOURCE.txt", "study.toml"


@dataclass(frozen=True)
class Step:
    """How far it is."""

    name: str
    """Of the file that is being fetched."""
    done: int
    """Bytes of all files so far."""
    total: int


def right_files(example: Example, folder: Path) -> tuple[RemoteFile, ...]:
    """Those that lie in `folder` as the registry has them."""
    return tuple(file for file in example.files if sha256_of(folder / file.name) == file.sha256)


def is_complete(example: Example, folder: Path) -> bool:
    """Whether nothing is left to fetch."""
    own = read_object(folder / MANIFEST).get("example") == example.name
    return own and len(right_files(example, folder)) == len(example.files)


def fetch_example(example: Example, folder: Path, connection: Connection, told: Callable[[Step], None]) -> None:
    """Fetch what is not there, and put all of it into `folder`.

    Raises
    ------
    InputError
        The folder holds something else; a file cannot be had, or is not the registered one. What was fetched before
        is kept.
    InterruptedWork
        Ctrl-C or a signal; the same.
    """
    if is_complete(example, folder):
        return
    _require_same(example, folder)
    fault: InputError | KeyboardInterrupt | Stopped | None = None
    with atomic_directory(folder, ResultKind.EXAMPLE) as content:
        for file in right_files(example, folder):
            also_at(folder / file.name, content / file.name)
        try:
            _fetch_rest(example, content, connection, told)
        except (InputError, KeyboardInterrupt, Stopped) as ending:
            fault = ending
        there = right_files(example, content)
        if fault is not None and not there:
            raise fault
        _write_words(example, folder, content)
    if fault is not None:
        _tell(fault, f"{len(there)} of {len(example.files)} files are in {folder}; run again for the rest")


def _require_same(example: Example, folder: Path) -> None:
    other = read_object(folder / MANIFEST).get("example", example.name)
    if other != example.name:
        raise InputError(
            f"holds the example '{other}'; name a new or an empty folder", source=folder, code=Code.FOLDER_TAKEN
        )


def _fetch_rest(example: Example, content: Path, connection: Connection, told: Callable[[Step], None]) -> None:
    done = sum(file.bytes for file in example.files if (content / file.name).exists())
    for file in example.files:
        target = content / file.name
        if target.exists():
            continue
        target.parent.mkdir(parents=True, exist_ok=True)

        def progress(size: int, name: str = file.name, before: int = done) -> None:
            told(Step(name, before + size, example.size))

        download(file, target, connection, progress)
        done += file.bytes


def _write_words(example: Example, folder: Path, content: Path) -> None:
    """What stands beside the recordings. A study file that is there stays as its user left it."""
    if (folder / STUDY).is_file():
        also_at(folder / STUDY, content / STUDY)
    elif example.study:
        (content / STUDY).write_text(example.study.lstrip("\n"), encoding="utf-8")
    (content / SOURCE).write_text(source_text(example), encoding="utf-8")
    manifest = {"gaitcal": package_version("gaitcal"), "example": example.name}
    (content / MANIFEST).write_text(json.dumps(manifest), encoding="utf-8")


def source_text(example: Example) -> str:
    """Whose the recordings are, and under which licence."""
    words = (
        f"{example.title}. Fetched by 'gaitcal example {example.name}'; the recordings are no part of gaitcal.",
        f"From: {example.of}",
        f"Repository: {example.repository}, commit {example.commit}",
        f"Licence: {example.licence}, {example.licence_text}",
        f"Cite: {example.cite}",
        f"Note: {example.remark}",
    )
    files = "\n".join(f"{file.name}\n  {file.url}\n  SHA-256 {file.sha256}" for file in example.files)
    wrapped = (textwrap.fill(line, 100, break_long_words=False, break_on_hyphens=False) for line in words)
    return "\n".join(wrapped) + f"\n\n{files}\n"


def _tell(fault: InputError | KeyboardInterrupt | Stopped, kept: str) -> NoReturn:
    if isinstance(fault, InputError):
        raise InputError(f"{fault}; {kept}", code=fault.code) from fault
    raise InterruptedWork(fault, kept) from fault
