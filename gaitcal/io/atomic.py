"""Results are written whole or not at all: into a hidden folder beside the target, which is then renamed to it.

An error, a full disk or Ctrl-C at any moment leaves the old result, or none where there was none. What SIGKILL leaves
is removed by the next run on the same target: the hidden folder `.gaitcal-tmp-NAME`. Killed between the two renames
that replace an old result, the old one waits as `.gaitcal-old-NAME`, and the next run or reader puts it back (`lock`).
All of this happens under the lock of the target, so that what lies there by these names belongs to nobody else.

What may be replaced at all is told in `ownership`. Folders of the old result that are kept are in both until the old
one goes, by hard links (copies, where the file system has none), so that at no moment they are in neither.

Ctrl-C, SIGTERM and SIGHUP end a run as an error would: folders it was writing are removed, locks are freed.

Without this, SIGTERM (`kill`, a batch system at its time limit) and SIGHUP (a closed terminal) end Python on the spot.
The first signal raises an exception in the main thread; those after it are ignored, so that cleaning up is not itself
cut off. What has to be done in one piece stands in `unbroken()`: a signal then waits until its end.
"""

from __future__ import annotations

import errno
import json
import os
import shutil
import signal
import tempfile
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import Any

from gaitcal.codes import Code
from gaitcal.errors import InputError
from gaitcal.io.lock import MANIFEST, OLD, UNFINISHED, ResultKind, files_of, locked, read_object, recover, refuse_others
from gaitcal.io.snapshot import HASHES, SELF, self_hash, sha256_of, sign

ENDINGS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
"""Signals by which a user ends a command; not every system has the last."""


class Stopped(BaseException):
    """The process was asked to end by a signal other than Ctrl-C, which stays a KeyboardInterrupt."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.name = signal.Signals(number).name
        self.exit_code = 128 + number
        """As shells have it: 143 for SIGTERM."""


class InterruptedWork(BaseException):
    """The end of a command that was interrupted and knows what became of its work."""

    def __init__(self, ending: KeyboardInterrupt | Stopped, work: str) -> None:
        self.exit_code = ending.exit_code if isinstance(ending, Stopped) else 128 + signal.SIGINT
        told = f"ended by {ending.name}" if isinstance(ending, Stopped) else "interrupted"
        super().__init__(f"{told}; {work}")


@contextmanager
def ended_by_signals() -> Iterator[None]:
    """Inside, SIGTERM and SIGHUP raise `Stopped`, and Ctrl-C raises KeyboardInterrupt, once.

    A signal that was ignored when the process began (`nohup`) stays ignored.
    """
    ended = False

    def end(number: int, frame: FrameType | None) -> None:
        nonlocal ended
        if ended:
            return
        ended = True
        raise KeyboardInterrupt if number == signal.SIGINT else Stopped(number)

    with _answered_by(end):
        try:
            yield
        except Exception as error:
            if ending := _signal_behind(error):
                raise ending from None
            raise


@contextmanager
def unbroken() -> Iterator[None]:
    """Inside, none of these signals is felt; one that came is felt at the end."""
    came: list[int] = []
    with _answered_by(lambda number, frame: came.append(number)):
        yield
    for number in came:
        signal.raise_signal(number)


@contextmanager
def _answered_by(handler: Callable[[int, FrameType | None], Any]) -> Iterator[None]:
    """Inside, `handler` answers the signals that are not ignored; nothing to do in a thread, which hears none."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {n: signal.getsignal(n) for n in ENDINGS if signal.getsignal(n) not in (signal.SIG_IGN, None)}
    try:
        for number in before:
            signal.signal(number, handler)
        yield
    finally:
        for number, former in before.items():
            signal.signal(number, former)


def _signal_behind(error: BaseException) -> KeyboardInterrupt | Stopped | None:
    """What a library that was loading made an error of its own from."""
    behind = error.__cause__ or error.__context__
    while behind is not None and not isinstance(behind, (KeyboardInterrupt, Stopped)):
        behind = behind.__cause__ or behind.__context__
    return behind


FULL = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})
"""No room is left, on the disk or for this user."""


def real_path(target: Path | str) -> Path:
    """Absolute, links followed: a link keeps pointing where it does, and what it points to is replaced."""
    try:
        return Path(os.path.realpath(target))
    except (OSError, ValueError) as error:
        raise InputError(f"no usable path: {error}", source=repr(str(target)), code=Code.NOT_WRITABLE) from None


@contextmanager
def disk_errors(target: Path, only: frozenset[int] | None = None) -> Iterator[None]:
    """Tell errors of the system as an InputError on `target`; `only` those of these numbers."""
    try:
        yield
    except OSError as error:
        if only is not None and error.errno not in only:
            raise
        raise InputError(f"cannot be written: {error.strerror}", source=target, code=Code.NOT_WRITABLE) from error


# ------------------------------------------------------------------------------------------------ a whole folder


@contextmanager
def atomic_directory(
    target: Path | str, kind: ResultKind, inputs: Iterable[Path] = (), carried: Mapping[str, str] | None = None
) -> Iterator[Path]:
    """Yield an empty folder; on success it becomes `target`, replacing what an earlier run of this kind wrote there.

    To the `manifest.json` that the body writes are added the kind and the list of files with their SHA-256. Folders
    that later commands put into the earlier result (`ownership.KEPT`) go on into the new one. The lock of the target
    is held.

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
    with ExitStack() as stack:
        with disk_errors(target):
            target.parent.mkdir(parents=True, exist_ok=True)
            stack.enter_context(locked(target))
            recover(target)
            refuse_others(target, kind, inputs)
            content = stack.enter_context(_empty(target.with_name(UNFINISHED + target.name)))
        with disk_errors(target, only=FULL):
            yield content
        with disk_errors(target):
            kept = refuse_others(target, kind, inputs)
            sign(content, kind, kept, carried or {})
            for name in kept:
                also_at(target / name, content / name)
            with unbroken():
                _put(content, target)


def require_room(target: Path | str, kind: ResultKind, inputs: Iterable[Path] = ()) -> tuple[str, ...]:
    """Tell before long work what `atomic_directory` would tell after it; leaves nothing behind.

    Returns the names of the folders of an earlier result that the new one will keep.

    Raises
    ------
    InputError
        As of `atomic_directory`.
    """
    target = real_path(target)
    with disk_errors(target), ExitStack() as stack:
        with suppress(FileNotFoundError):
            target.lstat()  # a name too long, a file where a folder should be
        if target.parent.is_dir():
            stack.enter_context(locked(target))
            recover(target)
        kept = refuse_others(target, kind, inputs)
        parent = next(folder for folder in target.parents if folder.exists())
        stack.enter_context(tempfile.TemporaryDirectory(prefix=UNFINISHED, dir=parent))
    return kept


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


@contextmanager
def _empty(folder: Path) -> Iterator[Path]:
    """A new folder, in the place of one that a killed run left; gone afterwards."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    try:
        yield folder
    finally:
        with unbroken():
            shutil.rmtree(folder, ignore_errors=True)


def _put(content: Path, target: Path) -> None:
    """Put the folder `content` in the place of `target`."""
    old = target.with_name(OLD + target.name)
    if target.exists():
        target.rename(old)
    try:
        content.rename(target)
    except OSError:
        if old.exists():
            old.rename(target)
        raise
    shutil.rmtree(old, ignore_errors=True)


# ------------------------------------------------------------------------------------------------- single files


@contextmanager
def atomic_file(target: Path | str) -> Iterator[Path]:
    """Yield a path of the same file name in a hidden folder; the file written there becomes `target` on success.

    Raises
    ------
    InputError
        `target` is a folder, cannot be written, or the disk is full.
    """
    target = real_path(target)
    with ExitStack() as stack:
        with disk_errors(target):
            if target.is_dir():
                raise InputError("is a folder; the name of a file is needed", source=target, code=Code.FOLDER_TAKEN)
            target.parent.mkdir(parents=True, exist_ok=True)
            stage = stack.enter_context(tempfile.TemporaryDirectory(prefix=UNFINISHED, dir=target.parent))
        with disk_errors(target, only=FULL):
            yield Path(stage) / target.name
        with disk_errors(target):
            (Path(stage) / target.name).replace(target)


def atomic_text(target: Path | str, text: str) -> None:
    """Write `text` to the file `target` as UTF-8, line ends as they are, whole or not at all."""
    with atomic_file(target) as path, path.open("w", encoding="utf-8", newline="") as stream:
        stream.write(text)


@contextmanager
def amended(folder: Path | str) -> Iterator[Path]:
    """Yield an empty folder; on success the files in it take their places in `folder`, which need not be there.

    They are moved when all are written, one rename each, and no signal is felt meanwhile. A manifest of `folder` that
    lists one of them gets its new SHA-256, and is moved last: killed between two renames (some milliseconds), what
    does not belong together is told as damaged, and the same command makes it anew.

    Raises
    ------
    InputError
        The folder cannot be written, the disk is full, or another process writes it.
    """
    folder = real_path(folder)
    with ExitStack() as stack:
        with disk_errors(folder):
            if not folder.is_dir():
                folder.mkdir(parents=True)
                stack.callback(_remove_if_empty, folder)
            stack.enter_context(locked(folder))
            stage = stack.enter_context(_empty(folder / f"{UNFINISHED}files"))
        with disk_errors(folder, only=FULL):
            yield stage
        with disk_errors(folder), unbroken():
            _list_anew(folder, stage)
            names = sorted(files_of(stage), key=lambda name: name == MANIFEST)
            for name in names:
                if (folder / name).is_dir():
                    raise InputError(
                        "is a folder; the name of a file is needed", source=folder / name, code=Code.NOT_WRITABLE
                    )
            for name in names:
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                (stage / name).replace(folder / name)


@contextmanager
def file_in_place(target: Path | str) -> Iterator[Path]:
    """Yield a path of the same name for a file that is written whole; beside a manifest, that file is an amendment."""
    target = real_path(target)
    if "gaitcal" in read_object(target.parent / MANIFEST):
        with amended(target.parent) as stage:
            yield stage / target.name
    else:
        yield target


def _remove_if_empty(folder: Path) -> None:
    with suppress(OSError):
        folder.rmdir()


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
        (stage / MANIFEST).write_text(json.dumps(manifest, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
