"""Several files of a folder that stays replaced together: all of them or none, whatever ends the run.

They are written into a hidden folder inside, which is renamed when it is complete; from then on they count, and are
moved to their places. A run killed while they are moved leaves them for the next run on the folder, which moves the
rest; a run killed before leaves a folder that the next one removes. All of this under the lock of the folder.
"""

from __future__ import annotations

import errno
import json
import os
import shutil
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from gaitcal.codes import Code
from gaitcal.errors import InputError
from gaitcal.files.interruption import unbroken
from gaitcal.files.lock import locked
from gaitcal.files.ownership import AMENDED, AMENDING, MANIFEST, files_of, read_object
from gaitcal.files.places import FULL, disk_errors, real_path
from gaitcal.files.snapshot import HASHES, SELF, self_hash, sha256_of


@contextmanager
def amended(folder: Path | str) -> Iterator[Path]:
    """Yield an empty folder; on success the files in it take their places in `folder`, which need not be there.

    A manifest of `folder` that lists one of them gets its new SHA-256.

    Raises
    ------
    InputError
        The folder cannot be written, the disk is full, or another process writes it.
    """
    folder = real_path(folder)
    stage = folder / AMENDING
    with ExitStack() as stack:
        with disk_errors(folder):
            stack.enter_context(_made(folder))
            stack.enter_context(locked(folder))
            finish_amending(folder)
            stack.callback(shutil.rmtree, stage, ignore_errors=True)
            stage.mkdir()
        with disk_errors(folder, only=FULL):
            yield stage
        with disk_errors(folder), unbroken():
            for name in files_of(stage):
                if (folder / name).is_dir():
                    raise InputError(
                        "is a folder; the name of a file is needed", source=folder / name, code=Code.NOT_WRITABLE
                    )
            _list_anew(folder, stage)
            stage.rename(folder / AMENDED)
            finish_amending(folder)


@contextmanager
def file_in_place(target: Path | str) -> Iterator[Path]:
    """Yield a path of the same name for a file that is written whole; beside a manifest, that file is an amendment."""
    target = real_path(target)
    if "gaitcal" in read_object(target.parent / MANIFEST):
        with amended(target.parent) as stage:
            yield stage / target.name
    else:
        yield target


def finish_amending(folder: Path) -> None:
    """Move what a killed run had ready to its place, and remove what it had not; the lock must be held."""
    ready = folder / AMENDED
    if ready.is_dir():
        for name in files_of(ready):
            target = real_path(folder / name)
            target.parent.mkdir(parents=True, exist_ok=True)
            _move(ready / name, target)
        shutil.rmtree(ready)
    if (folder / AMENDING).is_dir():
        shutil.rmtree(folder / AMENDING)


@contextmanager
def _made(folder: Path) -> Iterator[None]:
    """Make the folder, and remove it again where it stayed empty."""
    there = folder.is_dir()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        yield
    finally:
        if not there:
            try:
                folder.rmdir()
            except OSError:
                pass  # it holds something now


def _move(source: Path, target: Path) -> None:
    try:
        source.replace(target)
    except OSError as error:
        if error.errno != errno.EXDEV:
            raise
        beside = target.with_name(f"{AMENDING}-{target.name}")  # a part of the folder is a link to another disk
        shutil.copyfile(source, beside)
        beside.replace(target)
        source.unlink()


def _list_anew(folder: Path, stage: Path) -> None:
    """Put a manifest with the new hashes among the files, where the folder has one that lists any of them.

    Files that bring a manifest of their own have listed themselves.
    """
    if (stage / MANIFEST).exists():
        return
    manifest = read_object(folder / MANIFEST)
    hashes = manifest.get(HASHES)
    if not isinstance(hashes, dict) or manifest.get(SELF) != self_hash(manifest):
        return
    new = {name: sha256_of(stage / name) for name in files_of(stage) if name in hashes}
    if new:
        manifest[HASHES] = {**hashes, **new}
        manifest[SELF] = self_hash(manifest)
        text = json.dumps(manifest, indent=1, ensure_ascii=False) + "\n"
        with (stage / MANIFEST).open("w", encoding="utf-8") as stream:
            stream.write(text)
            stream.flush()
            os.fsync(stream.fileno())
