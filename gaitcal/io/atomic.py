"""What ends a run, and files that are written whole or not at all.

Ctrl-C, SIGTERM (`kill`, a batch system at its time limit) and SIGHUP (a closed terminal) end a run
as an error would: what it was writing is removed, locks are freed. The first signal raises an
exception in the main thread; those after it are ignored, so that cleaning up is not itself cut off.
A signal within `unbroken()` waits until its end.

A file is written under its own name in a hidden folder beside its place, and then renamed.
"""

import errno
import os
import signal
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

from gaitcal.errors import Code, InputError

ENDINGS = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
)
"""Signals by which a user ends a command; not every system has the last."""
FULL = frozenset(
    {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
)  # No room is left, on the disk or for this user
UNFINISHED = ".gaitcal-tmp-"  # Beginning of the hidden names of what is being written


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
        how = f"ended by {ending.name}" if isinstance(ending, Stopped) else "interrupted"
        super().__init__(f"{how}; {work}")


@contextmanager
def ended_by_signals() -> Iterator[None]:
    """Inside, SIGTERM and SIGHUP raise `Stopped`, and Ctrl-C raises KeyboardInterrupt, once.

    A signal that was ignored when the process began (`nohup`) stays ignored.
    """
    ended = False

    def end(number: int, frame: FrameType | None) -> None:
        nonlocal ended
        if not ended:
            ended = True
            raise KeyboardInterrupt if number == signal.SIGINT else Stopped(number)

    with _answered_by(end):
        try:
            yield
        except Exception as error:
            cause: BaseException | None = error
            while cause is not None and not isinstance(cause, (KeyboardInterrupt, Stopped)):
                cause = cause.__cause__ or cause.__context__
            if (
                cause is not None
            ):  # a library that was loading made an error of its own of the signal
                raise cause from None
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
    """Inside, `handler` answers the signals that are not ignored; nothing to do in a thread, which
    hears none.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {
        n: signal.getsignal(n) for n in ENDINGS if signal.getsignal(n) not in (signal.SIG_IGN, None)
    }
    try:
        for number in before:
            signal.signal(number, handler)
        yield
    finally:
        for number, former in before.items():
            signal.signal(number, former)


# -------------------------------------------------------------------------------------------------- single files


def real_path(target: Path | str) -> Path:
    """Absolute, links followed: a link keeps pointing where it does, and what it points to is
    replaced.
    """
    try:
        return Path(os.path.realpath(target))
    except (OSError, ValueError) as error:
        raise InputError(
            f"no usable path: {error}", source=repr(str(target)), code=Code.NOT_WRITABLE
        ) from None


@contextmanager
def disk_errors(target: Path, only: frozenset[int] | None = None) -> Iterator[None]:
    """Raise errors of the system as an InputError on `target`; `only` those of these numbers."""
    try:
        yield
    except OSError as error:
        if only is not None and error.errno not in only:
            raise
        raise InputError(
            f"cannot be written: {error.strerror}", source=target, code=Code.NOT_WRITABLE
        ) from error


@contextmanager
def atomic_file(target: Path | str) -> Iterator[Path]:
    """Yield a path of the same file name in a hidden folder; the file written there becomes
    `target` on success.

    InputError where `target` is a folder, cannot be written, or the disk is full.
    """
    target = real_path(target)
    with ExitStack() as stack:
        with disk_errors(target):
            if target.is_dir():
                raise InputError(
                    "is a folder; the name of a file is needed",
                    source=target,
                    code=Code.FOLDER_TAKEN,
                )
            target.parent.mkdir(parents=True, exist_ok=True)
            stage = stack.enter_context(
                tempfile.TemporaryDirectory(prefix=UNFINISHED, dir=target.parent)
            )
        with disk_errors(target, only=FULL):
            yield Path(stage) / target.name
        with disk_errors(target):
            (Path(stage) / target.name).replace(target)


def atomic_bytes(target: Path | str, content: bytes) -> None:
    """Write `content` to the file `target`, whole or not at all."""
    with atomic_file(target) as path:
        path.write_bytes(content)


def atomic_text(target: Path | str, text: str) -> None:
    """Write `text` to the file `target` as UTF-8, line ends as they are, whole or not at all."""
    with atomic_file(target) as path, path.open("w", encoding="utf-8", newline="") as stream:
        stream.write(text)
