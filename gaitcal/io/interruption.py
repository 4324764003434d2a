"""Ctrl-C, SIGTERM and SIGHUP end a run as an error would: folders it was writing are removed, locks are freed.

Without this, SIGTERM (`kill`, a batch system at its time limit) and SIGHUP (a closed terminal) end Python on the spot.
The first signal raises an exception in the main thread; those after it are ignored, so that cleaning up is not itself
cut off. What has to be done in one piece stands in `unbroken()`: a signal then waits until its end.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

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
