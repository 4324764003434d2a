"""Results are written whole or not at all: into a hidden sibling, which takes the target's place when it is complete.

An error, a full disk, Ctrl-C or SIGKILL at any moment leaves the old result, or none where there was none.

How. The sibling is a folder `.gaitcal-tmp-DIGEST-RANDOM`, DIGEST being of the target's name, and its writer holds a
lock on it (`flock`, which the system drops when the process dies). A folder of that name without a lock is what a
killed run left: the next run on the same target removes it. An existing target folder changes places with the sibling
in one step (Linux, `renameat2` with RENAME_EXCHANGE). Where system or file system cannot do that, two renames do it,
the old folder waiting as `.gaitcal-old-DIGEST`; killed between the two, the next run on this target puts it back.

What may be replaced at all is told in `ownership`. Folders of the old result that are kept are in both until the
exchange, by hard links (copies, where the file system has none), so that at no moment they are in neither.
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
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from gaitcal.codes import Code
from gaitcal.errors import InputError
from gaitcal.files.amend import finish_amending
from gaitcal.files.interruption import unbroken
from gaitcal.files.lock import locked
from gaitcal.files.ownership import OLD, UNFINISHED, ResultKind, refuse_others
from gaitcal.files.places import FULL, disk_errors, real_path
from gaitcal.files.snapshot import sign

_AT_FDCWD, _RENAME_EXCHANGE = -100, 2
_WINDOWS_LEFTOVER_S = 86_400.0  # no flock there: what nobody touched for a day belongs to nobody


@contextlib.contextmanager
def atomic_directory(
    target: Path | str, kind: ResultKind, inputs: Iterable[Path] = (), carried: Mapping[str, str] | None = None
) -> Iterator[Path]:
    """Yield an empty folder; on success it becomes `target`, replacing what an earlier run of this kind wrote there.

    To the `manifest.json` that the body writes are added the kind and the list of files with their SHA-256. Folders
    that later commands put into the earlier result (`ownership.KEPT`) go on into the new one. The lock of the target
    is held while it is looked at and replaced; a body that reads the earlier result must hold it (`lock.locked`).

    Parameters
    ----------
    carried : SHA-256 of files that the body carries over from the earlier result, as that one listed them; may be
        filled by the body.

    Raises
    ------
    InputError
        `target` is a file, or a folder that holds one of the `inputs`, another kind of result, or files that gaitcal
        did not write there; it cannot be written; the disk is full; another process writes it.
    """
    target, inputs = real_path(target), tuple(inputs)
    with contextlib.ExitStack() as stack:
        with disk_errors(target):
            with _recovered(target):
                refuse_others(target, kind, inputs)
            content = stack.enter_context(_sibling(target)) / "content"
            content.mkdir()
        with disk_errors(target, only=FULL):
            yield content
        with disk_errors(target), _recovered(target):
            kept = refuse_others(target, kind, inputs)
            sign(content, kind, [name for name in kept if not name.startswith(OLD)], carried or {})
            for name in kept:
                also_at(target / name, content / name)
            with unbroken():
                _put(content, target)


def require_room(target: Path | str, kind: ResultKind, inputs: Iterable[Path] = ()) -> tuple[str, ...]:
    """Tell before long work what `atomic_directory` would tell after it; leaves nothing behind.

    An exchange that was killed half way is put back first. Returns the names of the folders of an earlier result that
    the new one will keep.

    Raises
    ------
    InputError
        As of `atomic_directory`.
    """
    target = real_path(target)
    with disk_errors(target):
        with _recovered(target):
            kept = refuse_others(target, kind, inputs)
        with contextlib.suppress(FileNotFoundError):
            target.lstat()  # a name too long, a file where a folder should be
        if target.parent.is_dir():
            with _sibling(target):
                pass
        else:
            parent = next(folder for folder in target.parents if folder.exists())
            with tempfile.TemporaryDirectory(prefix=UNFINISHED, dir=parent):
                pass
    return tuple(name for name in kept if not name.startswith(OLD))


def also_at(source: Path, target: Path) -> None:
    """Make the file or folder `source` be at `target` too: by hard links, or copies where there are none."""
    if source.is_symlink():
        target.symlink_to(source.readlink())
    elif source.is_dir():
        shutil.copytree(source, target, symlinks=True, copy_function=_link_or_copy)
    else:
        target.parent.mkdir(parents=True, exist_ok=True)
        _link_or_copy(str(source), str(target))


def _link_or_copy(source: str, target: str) -> None:
    try:
        os.link(source, target, follow_symlinks=False)
    except (OSError, NotImplementedError):
        shutil.copy2(source, target, follow_symlinks=False)


@contextlib.contextmanager
def atomic_file(target: Path | str) -> Iterator[Path]:
    """Yield a path of the same file name in a hidden folder; the file written there becomes `target` on success.

    Raises
    ------
    InputError
        `target` is a folder, cannot be written, or the disk is full.
    """
    target = real_path(target)
    with contextlib.ExitStack() as stack:
        with disk_errors(target):
            if target.is_dir():
                raise InputError("is a folder; the name of a file is needed", source=target, code=Code.FOLDER_TAKEN)
            content = stack.enter_context(_sibling(target)) / target.name
        with disk_errors(target, only=FULL):
            yield content
        with disk_errors(target):
            content.replace(target)


def atomic_text(target: Path | str, text: str) -> None:
    """Write `text` to the file `target` as UTF-8, line ends as they are, whole or not at all."""
    with atomic_file(target) as path, path.open("w", encoding="utf-8", newline="") as stream:
        stream.write(text)


# ------------------------------------------------------------------------------------------------------- sibling


def _digest(target: Path) -> str:
    return hashlib.sha256(os.fsencode(target.name)).hexdigest()[:12]


@contextlib.contextmanager
def _sibling(target: Path) -> Iterator[Path]:
    """A new hidden folder beside `target`, locked by this process, gone afterwards."""
    target.parent.mkdir(parents=True, exist_ok=True)
    _remove_leftovers(target)
    with contextlib.ExitStack() as stack:
        with unbroken():
            folder, lock = _locked_folder(target)
            stack.callback(_remove, folder, lock)
        yield folder


def _remove(folder: Path, lock: int | None) -> None:
    with unbroken():
        shutil.rmtree(folder, ignore_errors=True)
        if lock is not None:
            os.close(lock)


def _locked_folder(target: Path) -> tuple[Path, int | None]:
    while True:
        folder = target.parent / f"{UNFINISHED}{_digest(target)}-{secrets.token_hex(6)}"
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
    for folder in target.parent.glob(f"{UNFINISHED}{_digest(target)}-*"):
        try:
            lock = _lock(folder)
        except OSError:
            continue  # in use, or already gone
        if lock is not None or time.time() - folder.stat().st_mtime > _WINDOWS_LEFTOVER_S:
            shutil.rmtree(folder, ignore_errors=True)
        if lock is not None:
            os.close(lock)


# ------------------------------------------------------------------------------------------------------ exchange


@contextlib.contextmanager
def _recovered(target: Path) -> Iterator[None]:
    """Hold the lock of the target, with what killed runs began on it finished; nothing to do where it cannot be."""
    if not target.parent.is_dir():
        yield
        return
    with locked(target):
        _recover(target)
        if target.is_dir():
            finish_amending(target)
        yield


def _old(target: Path) -> Path:
    return target.parent / f"{OLD}{_digest(target)}"


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
