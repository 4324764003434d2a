"""One writer at a time for each result folder: a lock across processes, which the system drops when its holder dies.

The lock is one of `filelock` on a file `.gaitcal-lock-NAME` beside the folder (inside it where nobody may write beside
it), so that the folder itself can be replaced under it. `dynamics`, `montecarlo` and `export` inside a result are parts
of it and have its lock.

Whoever is killed between the two renames that replace a result leaves the old one hidden beside its place. It belongs
to nobody while the lock is free, and is put back by whoever writes or reads there next.

Whose files lie in an output folder: what a run may replace, what it keeps, and what it must not touch.

The manifest of a folder says what kind of result it is and lists the files that were written. A folder may be replaced
only by a result of the same kind, only while every file in it is in that list, and never while it holds an input of
the run. What later commands added to it (`KEPT`) is not replaced but goes on into the new result.
"""

from __future__ import annotations

import errno
import json
import logging
import os
import shutil
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from enum import Enum
from pathlib import Path

from filelock import FileLock, Timeout

from gaitcal.codes import Code
from gaitcal.errors import InputError

MANIFEST = "manifest.json"
"""The file that marks a folder as a result of gaitcal."""
PEOPLE = "people"
"""Folder of the results of all people within that of a cohort."""
OLD, UNFINISHED, LOCK = ".gaitcal-old-", ".gaitcal-tmp-", ".gaitcal-lock-"
"""Beginnings of hidden names beside or in a folder: what is being replaced, what is being written, and that somebody
writes now."""
_LITTER = frozenset({".DS_Store", "Thumbs.db", "desktop.ini"})  # written by file browsers, into any folder they show


class ResultKind(Enum):
    """What an output folder holds."""

    CALIBRATION = "calibration"
    DYNAMICS = "further trials"
    SYNTHETIC = "synthetic study"
    REPRODUCTION = "reproduction"
    EXPORT = "files for other programs"
    COHORT = "cohort"
    COMPARISON = "comparison of two results"
    EXAMPLE = "example recordings"


KEPT: dict[ResultKind, tuple[str, ...]] = {
    ResultKind.CALIBRATION: ("montecarlo", "dynamics", "export", "figures"),
    ResultKind.DYNAMICS: ("figures",),
    ResultKind.SYNTHETIC: ("montecarlo",),
    ResultKind.REPRODUCTION: (),
    ResultKind.EXPORT: (),
    ResultKind.COHORT: (),
    ResultKind.COMPARISON: (),
    ResultKind.EXAMPLE: (),
}
"""Folders that later commands put into a result: another run of the first command keeps them."""
PARTS = frozenset(name for names in KEPT.values() for name in names)


def refuse_others(target: Path, kind: ResultKind, inputs: Iterable[Path] = ()) -> tuple[str, ...]:
    """Make sure that `target` may become a result of this kind; returns the folders in it that are to be kept.

    Raises
    ------
    InputError
        It is a file, holds one of the inputs, another kind of result, or a file that gaitcal did not write there.
    """
    if not target.exists():
        return ()
    if not target.is_dir():
        raise InputError("is a file; the output needs a folder", source=target, code=Code.FOLDER_TAKEN)
    for path in inputs:
        if path.resolve().is_relative_to(target.resolve()):
            shown = path.resolve().relative_to(target.resolve()).as_posix()
            raise InputError(
                f"holds '{shown}', an input of this run; name another folder", source=target, code=Code.FOLDER_TAKEN
            )
    kept = tuple(sorted(entry.name for entry in target.iterdir() if entry.is_dir() and entry.name in KEPT[kind]))
    files = list(_files(target, kept))
    if not files and not kept:
        return ()
    manifest = read_object(target / MANIFEST)
    old_kind = next((k for k in ResultKind if "gaitcal" in manifest and k.value == manifest.get("kind")), None)
    if old_kind is None:
        raise InputError(_foreign((*files, *kept)[0]), source=target, code=Code.FOLDER_TAKEN)
    if old_kind is not kind:
        message = f"holds another kind of result ({old_kind.value}, this would be {kind.value})"
        raise InputError(f"{message}; name a new or an empty folder", source=target, code=Code.FOLDER_TAKEN)
    listed = manifest.get("files")
    ours = {MANIFEST, *(listed if isinstance(listed, list) else ())}
    for name in files:
        if name not in ours:
            raise InputError(_foreign(name), source=target, code=Code.FOLDER_TAKEN)
    return kept


def refuse_cohort(folder: Path) -> None:
    """InputError, naming the result of one of its people, where a cohort is taken for the result of one person."""
    if read_object(folder / MANIFEST).get("kind") != ResultKind.COHORT.value:
        return
    results = (path.parent for level in ("*", "*/*") for path in sorted(folder.glob(f"{PEOPLE}/{level}/{MANIFEST}")))
    one = next(results, None)
    such = "" if one is None else f", such as {one.as_posix()}"
    raise InputError(
        f"is a cohort; name the result of one person, a folder in its {PEOPLE}/{such}",
        source=folder,
        code=Code.NO_RESULT,
    )


def _foreign(name: str) -> str:
    return f"holds '{name}', which gaitcal did not write there; move it away, or name a new or an empty folder"


def read_object(path: Path) -> dict[str, object]:
    """The JSON object in a manifest or summary; empty where there is none, which is then no result of ours."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}


def _files(folder: Path, besides: Iterable[str], prefix: str = "") -> Iterator[str]:
    """Every file below `folder` as `motion/walk.mot`; a link is a file, whatever it points to."""
    left_out = set(besides)
    for entry in sorted(folder.iterdir()):
        if entry.name in left_out or entry.name in _LITTER or entry.name.startswith((UNFINISHED, LOCK)):
            continue
        if entry.is_dir() and not entry.is_symlink():
            yield from _files(entry, (), f"{prefix}{entry.name}/")
        else:
            yield prefix + entry.name


def files_of(folder: Path) -> tuple[str, ...]:
    """Every file below a folder of ours, as `motion/walk.mot`."""
    return tuple(_files(folder, ()))


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
