"""Results are written whole or not at all: into a hidden sibling, which takes the target's place when it is complete.

An error, a full disk, Ctrl-C or SIGKILL at any moment leaves the old result, or none where there was none.

How. The sibling is a folder `.gaitcal-tmp-DIGEST-RANDOM`, DIGEST being of the target's name, and its writer holds a
lock on it (`flock`, which the system drops when the process dies). A folder of that name without a lock is what a
killed run left: the next run on the same target removes it. An existing target folder changes places with the sibling
in one step (Linux, `renameat2` with RENAME_EXCHANGE). Where system or file system cannot do that, two renames do it,
the old folder waiting as `.gaitcal-old-DIGEST`; killed between the two, the next run on this target puts it back.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import hashlib
import os
import secrets
import shutil
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from gaitcal.errors import InputError

MANIFEST = "manifest.json"
"""The file that marks a folder as a result of gaitcal; it holds the text `"gaitcal"`, quotes included."""

_FULL = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})
_AT_FDCWD, _RENAME_EXCHANGE = -100, 2
_WINDOWS_LEFTOVER_S = 86_400.0  # no flock there: what nobody touched for a day belongs to nobody


@contextlib.contextmanager
def atomic_directory(target: Path | str) -> Iterator[Path]:
    """Yield an empty folder; on success it becomes `target`, replacing what an earlier run wrote there.

    The body should write `manifest.json` (see `MANIFEST`): without it the next run refuses to replace the folder.

    Raises
    ------
    InputError
        `target` is a file, or a folder that holds other files than gaitcal's; it cannot be written; the disk is full.
    """
    target = _real(target)
    with contextlib.ExitStack() as stack:
        with _disk_errors(target):
            _recover(target)
            _refuse_foreign(target)
            content = stack.enter_context(_sibling(target)) / "content"
            content.mkdir()
        with _disk_errors(target, only=_FULL):
            yield content
        with _disk_errors(target):
            _refuse_foreign(target)
            _put(content, target)


@contextlib.contextmanager
def atomic_file(target: Path | str) -> Iterator[Path]:
    """Yield a path of the same file name in a hidden folder; the file written there becomes `target` on success.

    Raises
    ------
    InputError
        `target` is a folder, cannot be written, or the disk is full.
    """
    target = _real(target)
    with contextlib.ExitStack() as stack:
        with _disk_errors(target):
            if target.is_dir():
                raise InputError("is a folder; the name of a file is needed", source=target)
            content = stack.enter_context(_sibling(target)) / target.name
        with _disk_errors(target, only=_FULL):
            yield content
        with _disk_errors(target):
            content.replace(target)


def atomic_text(target: Path | str, text: str) -> None:
    """Write `text` to the file `target` as UTF-8, line ends as they are, whole or not at all."""
    with atomic_file(target) as path, path.open("w", encoding="utf-8", newline="") as stream:
        stream.write(text)


def _real(target: Path | str) -> Path:
    """Absolute, links followed: a link keeps pointing where it does, and what it points to is replaced."""
    try:
        return Path(os.path.realpath(target))
    except (OSError, ValueError) as error:
        raise InputError(f"no usable path: {error}", source=repr(str(target))) from None


@contextlib.contextmanager
def _disk_errors(target: Path, only: frozenset[int] | None = None) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        if only is not None and error.errno not in only:
            raise
        raise InputError(f"cannot be written: {error.strerror}", source=target) from error


def _refuse_foreign(target: Path) -> None:
    if not target.exists():
        return
    if not target.is_dir():
        raise InputError("is a file; the output needs a folder", source=target)
    if not any(target.iterdir()):
        return
    try:
        with (target / MANIFEST).open(encoding="utf-8") as stream:
            ours = '"gaitcal"' in stream.read()
    except (OSError, UnicodeDecodeError):
        ours = False
    if not ours:
        raise InputError(
            "folder exists and holds other files than results of gaitcal; name a new or an empty folder", source=target
        )


# ------------------------------------------------------------------------------------------------------- sibling


def _digest(target: Path) -> str:
    return hashlib.sha256(os.fsencode(target.name)).hexdigest()[:12]


@contextlib.contextmanager
def _sibling(target: Path) -> Iterator[Path]:
    """A new hidden folder beside `target`, locked by this process, gone afterwards."""
    target.parent.mkdir(parents=True, exist_ok=True)
    _remove_leftovers(target)
    folder, lock = _locked_folder(target)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        if lock is not None:
            os.close(lock)


def _locked_folder(target: Path) -> tuple[Path, int | None]:
    while True:
        folder = target.parent / f".gaitcal-tmp-{_digest(target)}-{secrets.token_hex(6)}"
        folder.mkdir()
        try:
            return folder, _lock(folder)
        except (BlockingIOError, FileNotFoundError):
            # Another run, looking for leftovers, came between mkdir and the lock: it removes this folder.
            continue


def _lock(folder: Path) -> int | None:
    """Lock `folder` and return the descriptor that holds the lock; None where the system has no `flock`.

    Raises
    ------
    BlockingIOError
        Another process holds the lock.
    """
    if sys.platform == "win32":
        return None
    import fcntl

    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(descriptor)
        if error.errno in {errno.ENOLCK, errno.ENOTSUP, errno.EINVAL, errno.ENOSYS}:
            return None  # a file system without locks
        raise
    if not folder.exists():
        os.close(descriptor)
        raise FileNotFoundError(folder)
    return descriptor


def _remove_leftovers(target: Path) -> None:
    for folder in target.parent.glob(f".gaitcal-tmp-{_digest(target)}-*"):
        try:
            lock = _lock(folder)
        except OSError:
            continue  # in use, or already gone
        if lock is not None or time.time() - folder.stat().st_mtime > _WINDOWS_LEFTOVER_S:
            shutil.rmtree(folder, ignore_errors=True)
        if lock is not None:
            os.close(lock)


# ------------------------------------------------------------------------------------------------------ exchange


def _old(target: Path) -> Path:
    return target.parent / f".gaitcal-old-{_digest(target)}"


def _recover(target: Path) -> None:
    """Finish what a run killed between its two renames began."""
    old = _old(target)
    if not old.is_dir():
        return
    if target.exists():
        shutil.rmtree(old, ignore_errors=True)
    else:
        old.rename(target)


def _put(content: Path, target: Path) -> None:
    """Put the folder `content` in the place of `target`. Afterwards `content` is the old folder, or gone."""
    if not target.exists():
        content.rename(target)
        return
    if _exchange(content, target):
        return
    old = _old(target)
    try:
        target.rename(old)
        content.rename(target)
    except BaseException:  # also Ctrl-C between the two
        if old.exists() and not target.exists():
            old.rename(target)
        raise
    shutil.rmtree(old, ignore_errors=True)


def _exchange(one: Path, other: Path) -> bool:
    """Let two folders change places in one step; False where that does not exist."""
    if not sys.platform.startswith("linux"):
        return False
    try:
        renameat2 = ctypes.CDLL(None, use_errno=True).renameat2
    except (OSError, AttributeError):
        return False
    done: int = renameat2(_AT_FDCWD, os.fsencode(one), _AT_FDCWD, os.fsencode(other), _RENAME_EXCHANGE)
    return done == 0
