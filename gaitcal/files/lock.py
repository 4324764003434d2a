"""One writer at a time for each result folder: a lock across processes, which the system drops when its holder dies.

The lock is one on a file `.gaitcal-lock-DIGEST` beside the folder, DIGEST being of the folder's name (inside the
folder where nobody may write beside it), so that the folder itself can be replaced under it. `dynamics`, `montecarlo`
and `export` inside a result are parts of it and have its lock. The file says who holds it, and is removed when the lock
is freed; what a killed process left is taken over and removed by the next.

POSIX: `flock`; freed files are removed while locked, and whoever waited for the removed one sees that another, or none,
is in its place and begins again. Windows: one byte far behind the text is locked; an open file cannot be removed there.
"""

from __future__ import annotations

import errno
import hashlib
import json
import logging
import os
import socket
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from datetime import datetime
from pathlib import Path

from gaitcal.codes import Code
from gaitcal.errors import InputError
from gaitcal.files.interruption import unbroken
from gaitcal.files.ownership import KEPT, LOCK, MANIFEST, read_object

WAIT_S = 60.0
"""A result of many trials with all its figures is written in less."""
TELL_S = 1.0
"""Waiting for longer is told."""
LOOK_S = 0.05
_TRIES = 5
_FAR = 1 << 30
"""Byte that is locked on Windows: locked bytes cannot be read there."""
_NO_LOCKS = frozenset({errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.EINVAL, errno.ENOSYS})
_PARTS = frozenset(name for names in KEPT.values() for name in names)

_log = logging.getLogger(__name__)
_held = threading.local()


def whole_result(folder: Path) -> Path:
    """The result that `folder`, an absolute path, is or is a part of."""
    if folder.name in _PARTS and "gaitcal" in read_object(folder.parent / MANIFEST):
        return folder.parent
    return folder


@contextmanager
def locked(folder: Path, purpose: str = "", *, wait_s: float | None = None) -> Iterator[None]:
    """Hold the lock of the result that `folder` is or is a part of; within it, taking it again does nothing.

    Parameters
    ----------
    purpose : another lock on the same folder, such as that of a Monte Carlo study which goes on for hours.
    wait_s : how long to wait for another process; `WAIT_S` unless given.

    Raises
    ------
    InputError
        Another process holds it for longer; the message says which, where and since when.
    OSError
        No file can be made beside or in the folder.
    """
    folder = Path(os.path.realpath(folder))
    place = _place(whole_result(folder), purpose)
    mine: set[Path] = _held.__dict__.setdefault("places", set())
    if place in mine:
        yield
        return
    with ExitStack() as stack:
        for _ in _waiting(place, folder, WAIT_S if wait_s is None else wait_s):
            with unbroken():
                descriptor = _taken(place)
                if descriptor is not None:
                    mine.add(place)
                    stack.callback(_free, descriptor, place, mine)
                    break
        yield


def _place(result: Path, purpose: str) -> Path:
    name = LOCK + hashlib.sha256(os.fsencode(f"{result.name}/{purpose}")).hexdigest()[:12]
    beside = result.parent / name
    if result.is_dir() and not beside.exists() and not os.access(result.parent, os.W_OK):
        return result / name
    return beside


def _waiting(place: Path, folder: Path, longest_s: float) -> Iterator[None]:
    """Go on until the lock is taken, with a pause between; InputError when that lasts too long."""
    began, told = time.monotonic(), False
    while True:
        yield
        waited = time.monotonic() - began
        if waited > longest_s:
            raise InputError(
                f"is being written by {_holder(place)}; run again when that has ended", source=folder, code=Code.LOCKED
            )
        if waited > TELL_S and not told:
            _log.warning("gaitcal: %s is being written by %s; waiting up to %.0f s", folder, _holder(place), longest_s)
            told = True
        time.sleep(LOOK_S)


def _taken(place: Path) -> int | None:
    """Descriptor that holds the lock; None where another process has it, or had it until now."""
    descriptor = _open(place)
    taken = False
    try:
        taken = _try(descriptor) and _is_at(descriptor, place)
        if taken:
            _sign(descriptor)
    finally:
        if not taken:
            os.close(descriptor)
    return descriptor if taken else None


def _open(place: Path) -> int:
    for _ in range(_TRIES):
        try:
            return os.open(place, os.O_RDWR | os.O_CREAT, 0o666)
        except PermissionError:
            # Another user's file: to read it is enough for a lock, not for a name on it. On Windows also a file that
            # its last holder is about to remove.
            with suppress(OSError):
                return os.open(place, os.O_RDONLY)
        time.sleep(LOOK_S)
    return os.open(place, os.O_RDWR | os.O_CREAT, 0o666)


def _try(descriptor: int) -> bool:
    """Take the lock if it is free. A file system without locks is told of, and nothing is locked."""
    try:
        if sys.platform == "win32":
            import msvcrt

            os.lseek(descriptor, _FAR, os.SEEK_SET)
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in _NO_LOCKS:
            _log.warning("gaitcal: this file system has no locks; run one command at a time on this folder")
            return True
        if error.errno in (errno.EACCES, errno.EAGAIN, errno.EWOULDBLOCK, errno.EDEADLK):
            return False
        raise
    return True


def _is_at(descriptor: int, place: Path) -> bool:
    """Whether the open file is still the one of this name."""
    try:
        return os.path.samestat(os.fstat(descriptor), place.stat())
    except FileNotFoundError:
        return False


def _sign(descriptor: int) -> None:
    """Say in the file who holds it; a disk without room for that line is no reason to stop."""
    since = datetime.now().astimezone().isoformat(timespec="seconds")
    words = json.dumps({"process": os.getpid(), "host": socket.gethostname(), "since": since})
    with suppress(OSError):
        os.ftruncate(descriptor, 0)
        os.lseek(descriptor, 0, os.SEEK_SET)
        os.write(descriptor, words.encode())


def _holder(place: Path) -> str:
    try:
        held = json.loads(place.read_bytes())
        return f"process {held['process']} on {held['host']} since {held['since']}"
    except (OSError, ValueError, TypeError, KeyError):
        return "another process"


def _free(descriptor: int, place: Path, mine: set[Path]) -> None:
    with unbroken():
        mine.discard(place)
        if sys.platform == "win32":
            os.close(descriptor)
            with suppress(OSError):  # the next one has it open
                place.unlink()
        else:
            with suppress(OSError):
                if _is_at(descriptor, place):
                    place.unlink()
            os.close(descriptor)
