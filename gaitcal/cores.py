"""The processor cores of one command: independent steps side by side, in copies of the process.

A command asks for them (`several_cores`). Anybody's own program, a worker of a cohort and a copy itself compute one
step after the other. What comes out is the same: each step depends on what it is given alone.

The copies are made by `fork`, on Linux only: they begin with all that the process has read and computed, at once,
where a new process would load libraries for a second. They compute, answer through a pipe, and end; they print
nothing and take no lock that another thread may hold. A copy that dies is not missed, as its steps are computed here.
"""

from __future__ import annotations

import ctypes
import faulthandler
import os
import pickle
import signal
import struct
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, NoReturn, TypeVar

Item = TypeVar("Item")
Answer = TypeVar("Answer")

MOST = 8
"""Copies share the memory's bandwidth; more hardly help."""
_END_WITH_PARENT = 1
"""Number of Linux's `prctl`: a signal to this process when its parent ends."""
_NUMBER = struct.Struct("=i")

_asked = 1


_ENDINGS = (signal.SIGINT, signal.SIGTERM, *([signal.SIGHUP] if sys.platform != "win32" else []))
"""Signals by which a user ends a command."""


@contextmanager
def several_cores() -> Iterator[None]:
    """Inside, `each` uses all cores that this process may run on; where there is no safe `fork`, one."""
    with _cores(_available()):
        yield


@contextmanager
def _cores(number: int) -> Iterator[None]:
    global _asked
    before, _asked = _asked, number
    try:
        yield
    finally:
        _asked = before


def _available() -> int:
    if sys.platform != "linux":
        return 1
    return min(len(os.sched_getaffinity(0)), MOST)


def each(
    function: Callable[[Item], Answer], items: Sequence[Item], longest: Callable[[Item], float] | None = None
) -> list[Answer]:
    """`[function(item) for item in items]`, of at most 10 000 items.

    What `function` returns is pickled; what it changes in memory may be lost, what it writes to disk stays. Those for
    which `longest` is largest are begun first.
    """
    copies = min(_asked, len(items)) - 1
    if copies < 1:
        return [function(item) for item in items]
    order = range(len(items)) if longest is None else sorted(range(len(items)), key=lambda k: -longest(items[k]))
    return _Steps(function, items, order).run(copies)


def all_of(*steps: Callable[[], Any]) -> list[Any]:
    """What each of some functions returns, the longest named first."""
    return each(_call, steps)


@contextmanager
def beside(function: Callable[[], Answer]) -> Iterator[Callable[[], Answer]]:
    """Inside, a copy with cores of its own computes `function`, and what this gives waits for its answer; where there
    is no core to spare, what this gives is `function` itself.
    """
    if _asked == 1:
        yield function
        return
    steps = _Steps(_call, (function,), (0,), cores_of_copy=_asked)
    with steps.begun(copies=1):
        yield lambda: steps.finished()[0]


def _call(step: Callable[[], Answer]) -> Answer:
    return step()


@dataclass
class _Steps(Generic[Item, Answer]):
    """Steps of which each process takes the next one that nobody has."""

    function: Callable[[Item], Answer]
    items: Sequence[Item]
    order: Sequence[int]
    cores_of_copy: int = 1
    """How many a step may share its own steps among."""
    answers: dict[int, Answer] = field(default_factory=dict)
    children: list[tuple[int, int]] = field(default_factory=list)
    """Processes, and the ends of their pipes."""

    def run(self, copies: int) -> list[Answer]:
        """The answers in the order of the items, of which this process computes some, too."""
        with self.begun(copies) as queue:
            with _cores(1):
                self._take(queue)
            return self.finished()

    @contextmanager
    def begun(self, copies: int) -> Iterator[int]:
        """Inside, copies take steps from the queue that this gives."""
        queue, fill = os.pipe()
        os.write(fill, b"".join(_NUMBER.pack(k) for k in self.order))
        os.close(fill)
        try:
            with suppress(OSError):  # no more processes are allowed: fewer share the work
                for _ in range(copies):
                    self._copy(queue)
            yield queue
        finally:
            os.close(queue)
            for child, pipe in self.children:
                os.close(pipe)
                with suppress(ProcessLookupError, ChildProcessError):  # the system has buried it already
                    os.kill(child, signal.SIGKILL)
                    os.waitpid(child, 0)

    def finished(self) -> list[Answer]:
        """What the copies answer; what none of them does is computed here."""
        for _, pipe in self.children:
            self._hear(pipe)
        return [self._answer(k) for k in range(len(self.items))]

    def _take(self, queue: int) -> None:
        """Compute until all steps are taken."""
        while taken := os.read(queue, _NUMBER.size):
            (number,) = _NUMBER.unpack(taken)
            with suppress(Exception):
                self.answers[number] = self.function(self.items[number])

    def _copy(self, queue: int) -> None:
        """Add a process that takes steps, too."""
        reader, writer = os.pipe()
        parent = os.getpid()
        with warnings.catch_warnings(), _signals_wait():
            warnings.simplefilter("ignore", DeprecationWarning)  # of threads: see the head of this module
            try:
                child = os.fork()
            except OSError:
                os.close(reader)
                os.close(writer)
                raise
            if child == 0:
                self._serve(queue, writer, parent)
            os.close(writer)
            self.children.append((child, reader))

    def _serve(self, queue: int, writer: int, parent: int) -> NoReturn:
        """In a copy: take steps, answer, and end."""
        try:
            _become_copy(parent, self.cores_of_copy)
            self._take(queue)
            with os.fdopen(writer, "wb") as pipe:
                pickle.dump(self.answers, pipe, protocol=5)
        finally:
            os._exit(0)

    def _hear(self, pipe: int) -> None:
        """Take over what a copy computed; nothing where it died."""
        with os.fdopen(os.dup(pipe), "rb") as stream, suppress(EOFError, pickle.UnpicklingError):
            self.answers |= pickle.load(stream)

    def _answer(self, number: int) -> Answer:
        if number not in self.answers:
            self.answers[number] = self.function(self.items[number])
        return self.answers[number]


@contextmanager
def _signals_wait() -> Iterator[None]:
    """Inside, a signal that ends the command is only noted. One that came inside `fork` would be lost, or unwind a copy
    as if it were the parent.
    """
    if threading.current_thread() is not threading.main_thread():  # no other thread hears any
        yield
        return
    came: list[int] = []
    before = {ending: signal.signal(ending, lambda number, _: came.append(number)) for ending in _ENDINGS}
    try:
        yield
    finally:
        for ending, handler in before.items():
            signal.signal(ending, handler or signal.SIG_DFL)
        for number in came:
            signal.raise_signal(number)


def _become_copy(parent: int, cores: int) -> None:
    """In a new process: its cores, no words, and an end with the parent, which alone hears what the user wants."""
    global _asked
    _asked = cores
    ctypes.CDLL(None).prctl(_END_WITH_PARENT, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for ending in _ENDINGS[1:]:
        signal.signal(ending, signal.SIG_DFL)
    sys.stdout = sys.stderr = Path(os.devnull).open("w")  # noqa: SIM115
    faulthandler.disable()
