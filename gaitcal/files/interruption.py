"""Ctrl-C, SIGTERM and SIGHUP end a run as an error would: folders it was writing are removed, locks are freed.

Without this, SIGTERM (`kill`, a batch system at its time limit) and SIGHUP (a closed terminal) end Python on the spot.
The first signal raises an exception in the main thread; those after it are ignored, so that cleaning up is not itself
cut off. What has to be done in one piece stands in `unbroken()`: a signal then waits until its end.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_NAMES = ("SIGINT", "SIGTERM", "SIGHUP")  # not every system has the last


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


class _State:
    """Of the one main thread that signals come to."""

    depth = 0
    """Pieces of work, one within another, that are not to be broken."""
    waiting: int | None = None
    ended = False


@contextmanager
def ended_by_signals() -> Iterator[None]:
    """Inside, SIGTERM and SIGHUP raise `Stopped`, and Ctrl-C raises KeyboardInterrupt, once.

    A signal that was ignored when the process began (`nohup`) stays ignored.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    _State.depth, _State.waiting, _State.ended = 0, None, False
    numbers = [number for name in _NAMES if (number := getattr(signal, name, None)) is not None]
    before = {n: signal.getsignal(n) for n in numbers if signal.getsignal(n) not in (signal.SIG_IGN, None)}
    try:
        for number in before:
            signal.signal(number, _arrived)
        yield
    except Exception as error:
        if ending := _signal_behind(error):
            raise ending from None
        raise
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _signal_behind(error: BaseException) -> KeyboardInterrupt | Stopped | None:
    """What a library that was loading made an error of its own from."""
    behind = error.__cause__ or error.__context__
    while behind is not None and not isinstance(behind, (KeyboardInterrupt, Stopped)):
        behind = behind.__cause__ or behind.__context__
    return behind


@contextmanager
def unbroken() -> Iterator[None]:
    """Inside, none of these signals is felt; one that came is felt at the end."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    _State.depth += 1
    try:
        yield
    finally:
        _State.depth -= 1
        if _State.depth == 0 and _State.waiting is not None:
            _end(_State.waiting)


def _arrived(number: int, frame: FrameType | None) -> None:
    if _State.ended:
        return
    if _State.depth:
        _State.waiting = number
    else:
        _end(number)


def _end(number: int) -> None:
    _State.ended, _State.waiting = True, None
    if number == signal.SIGINT:
        raise KeyboardInterrupt
    raise Stopped(number)
