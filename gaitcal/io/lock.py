"""One writer at a time for each result folder: a lock across processes, which the system drops when its holder dies.

The lock is one of `filelock` on a file `.gaitcal-lock-NAME` beside the folder (inside it where nobody may write beside
it), so that the folder itself can be replaced under it. `dynamics`, `montecarlo` and `export` inside a result are parts
of it and have its lock.

Whoever is killed between the two renames that replace a result leaves the old one hidden beside its place. It belongs
to nobody while the lock is free, and is put back by whoever writes or reads there next.
"""

from __future__ import annotations

import errno
import logging
import os
import shutil
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout

from gaitcal.codes import Code
from gaitcal.errors import InputError
from gaitcal.io.ownership import LOCK, MANIFEST, OLD, PARTS, read_object

WAIT_S = 60.0
"""A result of many trials with all its figures is written in less."""
TELL_S = 1.0
"""Waiting for longer is told."""
LOOK_S = 0.05
_NO_LOCKS = frozenset({errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.EINVAL, errno.ENOSYS})
"""What `flock` answers on a file system that has none."""

_log = logging.getLogger(__name__)


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
        Another process holds it for longer.
    OSError
        No file can be made beside or in the folder.
    """
    folder = Path(os.path.realpath(folder))
    place = _place(_whole_result(folder), purpose)
    os.close(os.open(place, os.O_RDWR | os.O_CREAT, 0o644))  # filelock waits in vain where no file can be made
    lock = FileLock(place, is_singleton=True)
    _take(lock, folder, WAIT_S if wait_s is None else wait_s)
    try:
        yield
    finally:
        if lock.lock_counter <= 1:
            with suppress(OSError):  # on Windows, where another one has it open
                os.unlink(lock.lock_file)  # noqa: PTH108  who waits for the removed file begins again
        lock.release()


def recover(target: Path) -> list[Path]:
    """Put back an old result, or a part of one, whose replacement was killed between the two renames; returns which.

    The lock of `target` is held.
    """
    back = []
    for place, old in _places(target):
        if place.exists():
            shutil.rmtree(old, ignore_errors=True)
        elif old.exists():
            old.rename(place)
            back.append(place)
    return back


def put_back(folder: Path) -> None:
    """As `recover`, for who wants to read the result `folder`; where nobody may write, it stays as it is.

    Raises
    ------
    InputError
        Another process writes it, for longer than `WAIT_S`.
    """
    target = Path(os.path.realpath(folder))
    if not any(old.exists() and not place.exists() for place, old in _places(target)):
        return
    with suppress(OSError), locked(target):  # who holds it may be about to put the new one in the place
        for place in recover(target):
            _log.warning("gaitcal: %s: the run that was to replace it was killed; the earlier result is back", place)


def _places(target: Path) -> list[tuple[Path, Path]]:
    """Of a result and its parts: where it belongs, and where it waits while it is replaced."""
    return [(place, place.with_name(OLD + place.name)) for place in (target, *(target / name for name in PARTS))]


def _take(lock: FileLock, folder: Path, longest_s: float) -> None:
    try:
        with _no_file_as_lock():
            try:
                lock.acquire(timeout=min(TELL_S, longest_s), poll_interval=LOOK_S)
            except Timeout:
                if longest_s > TELL_S:
                    words = "gaitcal: %s is being written by another process; waiting up to %.0f s"
                    _log.warning(words, folder, longest_s)
                lock.acquire(timeout=max(longest_s - TELL_S, 0.0), poll_interval=LOOK_S)
    except Timeout:
        raise InputError(
            "is being written by another process; run again when that has ended", source=folder, code=Code.LOCKED
        ) from None
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise
        _log.warning("gaitcal: this file system has no locks; run one command at a time on this folder")


@contextmanager
def _no_file_as_lock() -> Iterator[None]:
    """Where the system has no locks, filelock warns and takes a file for one, which outlives who is killed.

    Raises OSError instead.
    """
    words = "flock not supported"
    with warnings.catch_warnings():
        warnings.filterwarnings("error", words, UserWarning)
        try:
            yield
        except UserWarning as warning:
            raise OSError(errno.ENOSYS, str(warning)) from None


def _whole_result(folder: Path) -> Path:
    """The result that `folder`, an absolute path, is or is a part of."""
    if folder.name in PARTS and "gaitcal" in read_object(folder.parent / MANIFEST):
        return folder.parent
    return folder


def _place(result: Path, purpose: str) -> Path:
    name = f"{LOCK}{result.name}{'-' if purpose else ''}{purpose.replace(' ', '-')}"
    beside = result.with_name(name)
    if result.is_dir() and not beside.exists() and not os.access(result.parent, os.W_OK):
        return result / name
    return beside
