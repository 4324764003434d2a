"""Turn ending signals into exceptions, and write files completely or not at all.

Ctrl-C, SIGTERM (`kill`, a batch system at its time limit) and SIGHUP (a closed terminal) end a
run as an error does: unfinished output is removed and locks are released. The first signal raises
an exception in the main thread. Later signals are ignored, so that they cannot interrupt the
clean-up. A signal within `defer_signals()` takes effect at its end.

A file is first written in a hidden folder beside its target and then renamed.
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

ENDING_SIGNALS = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
)
"""Signals by which a user ends a command; not every system has SIGHUP."""
# Error numbers for no space left, on the disk or in the quota of this user
DISK_FULL = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})
# First part of the hidden names of unfinished files and folders
UNFINISHED_PREFIX = ".gaitcal-tmp-"


class Stopped(BaseException):
    """Request to end the process by a signal other than Ctrl-C (KeyboardInterrupt).

    Parameters
    ----------
    number
        Number of the signal.
    """

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.name = signal.Signals(number).name
        self.exit_code = 128 + number
        """As shells have it: 143 for SIGTERM."""


class InterruptedWork(BaseException):
    """End of an interrupted command that can report the state of its work.

    Parameters
    ----------
    ending
        The exception that interrupted the command.
    work
        Description of the kept files, for the message.
    """

    def __init__(self, ending: KeyboardInterrupt | Stopped, work: str) -> None:
        self.exit_code = ending.exit_code if isinstance(ending, Stopped) else 128 + signal.SIGINT
        how = f"ended by {ending.name}" if isinstance(ending, Stopped) else "interrupted"
        super().__init__(f"{how}; {work}")


@contextmanager
def raise_on_signals() -> Iterator[None]:
    """Raise `Stopped` for SIGTERM and SIGHUP, and KeyboardInterrupt for Ctrl-C, once.

    A signal that was ignored when the process began (`nohup`) stays ignored.

    Raises
    ------
    Stopped, KeyboardInterrupt
        The first of these signals arrived in the context.
    """
    ended = False

    def end(number: int, frame: FrameType | None) -> None:
        nonlocal ended
        if not ended:
            ended = True
            raise KeyboardInterrupt if number == signal.SIGINT else Stopped(number)

    with _handle_signals_with(end):
        try:
            yield
        except Exception as error:
            # A library that was being loaded may have wrapped the signal in another error
            cause: BaseException | None = error
            while cause is not None and not isinstance(cause, (KeyboardInterrupt, Stopped)):
                cause = cause.__cause__ or cause.__context__
            if cause is not None:
                raise cause from None
            raise


@contextmanager
def defer_signals() -> Iterator[None]:
    """Defer the ending signals that arrive in the context to its end."""
    deferred: list[int] = []
    with _handle_signals_with(lambda number, frame: deferred.append(number)):
        yield
    for number in deferred:
        signal.raise_signal(number)


@contextmanager
def _handle_signals_with(handler: Callable[[int, FrameType | None], Any]) -> Iterator[None]:
    """Install `handler` for the signals that are not ignored; only the main thread receives any."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    former_handlers = {
        n: signal.getsignal(n)
        for n in ENDING_SIGNALS
        if signal.getsignal(n) not in (signal.SIG_IGN, None)
    }
    try:
        for number in former_handlers:
            signal.signal(number, handler)
        yield
    finally:
        for number, former in former_handlers.items():
            signal.signal(number, former)


# ------------------------------------------------------------------------------------- single files


def resolve_path(target: Path | str) -> Path:
    """Resolve a path to its absolute form, links followed.

    A link therefore stays where it is, and the file that it points to is replaced.

    Parameters
    ----------
    target
        Path as the user gave it.

    Returns
    -------
    Path
        Absolute path without links.

    Raises
    ------
    InputError
        The text is no usable path.
    """
    try:
        return Path(os.path.realpath(target))
    except (OSError, ValueError) as error:
        raise InputError(
            f"no usable path: {error}", source=repr(str(target)), code=Code.NOT_WRITABLE
        ) from None


@contextmanager
def convert_disk_errors(target: Path, only: frozenset[int] | None = None) -> Iterator[None]:
    """Convert errors of the operating system in the context into an InputError on `target`.

    Parameters
    ----------
    target
        File or folder for the message.
    only
        Error numbers to convert; all of them unless given.

    Raises
    ------
    InputError
        An OSError occurred.
    """
    try:
        yield
    except OSError as error:
        if only is not None and error.errno not in only:
            raise
        raise InputError(
            f"cannot be written: {error.strerror}", source=target, code=Code.NOT_WRITABLE
        ) from error


@contextmanager
def write_atomically(target: Path | str) -> Iterator[Path]:
    """Yield a temporary path; on success the file written there replaces `target`.

    Parameters
    ----------
    target
        File to write. Its folder is created where it does not exist.

    Yields
    ------
    Path
        Path of the same file name in a hidden folder beside `target`.

    Raises
    ------
    InputError
        `target` is a folder or cannot be written, or the disk is full.
    """
    target = resolve_path(target)
    with ExitStack() as stack:
        with convert_disk_errors(target):
            if target.is_dir():
                raise InputError(
                    "is a folder; the name of a file is needed",
                    source=target,
                    code=Code.FOLDER_TAKEN,
                )
            target.parent.mkdir(parents=True, exist_ok=True)
            stage = stack.enter_context(
                tempfile.TemporaryDirectory(prefix=UNFINISHED_PREFIX, dir=target.parent)
            )
        with convert_disk_errors(target, only=DISK_FULL):
            yield Path(stage) / target.name
        with convert_disk_errors(target):
            (Path(stage) / target.name).replace(target)


def write_bytes_atomically(target: Path | str, content: bytes) -> None:
    """Write bytes to a file, completely or not at all.

    Parameters
    ----------
    target
        File to write.
    content
        All bytes of the file.

    Raises
    ------
    InputError
        As `write_atomically`.
    """
    with write_atomically(target) as path:
        path.write_bytes(content)


def write_text_atomically(target: Path | str, text: str) -> None:
    """Write text to a file as UTF-8 with line ends unchanged, completely or not at all.

    Parameters
    ----------
    target
        File to write.
    text
        Content of the file.

    Raises
    ------
    InputError
        As `write_atomically`.
    """
    with write_atomically(target) as path, path.open("w", encoding="utf-8", newline="") as stream:
        stream.write(text)
