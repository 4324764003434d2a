"""Processes of this machine, each with one person at a time. One that dies stops nobody, and its person is retried.

A pool of joblib ends as a whole where one of its processes dies. Here every process has a pipe of its own, so that it
is known over whom it died; that person is handed to another one, and given up after `TRIES`. A process is replaced
after `EACH` people that it computed, or when it has grown over `MOST_MIB`, so that memory does not grow with the number
of people.
"""

from __future__ import annotations

import os
import signal
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from typing import Any, Generic

from joblib import cpu_count

from gaitcal.montecarlo.workers import Result, Task, end_with

TRIES = 3
EACH = 25
MOST_MIB = 1500.0
END_S = 5.0
"""For a process that is to end by itself."""
_PAGE = 4096


@dataclass
class _Worker(Generic[Task]):
    """One process, its pipe, and what it is working on."""

    process: Any
    pipe: Connection
    task: Task | None = None
    done: int = 0


@dataclass
class ReplacedProcesses:
    """Workers of this machine."""

    jobs: int = -1
    """How many; -1: one for every core."""
    each: int = EACH
    ages: Callable[[Any], bool] = lambda result: True
    """Whether a result cost the work by which a process ages."""

    @property
    def count(self) -> int:
        """How many processes work side by side."""
        return cpu_count() if self.jobs < 0 else self.jobs

    def run(
        self, function: Callable[[Task], Result], tasks: Iterable[Task], lost: Callable[[Task, str], Result]
    ) -> Iterator[Result]:
        """Yield `function(task)` for every task as it is ready; `lost(task, why)` where processes died over it."""
        left, again = iter(tasks), deque[tuple[Task, int]]()
        workers: dict[Connection, _Worker[tuple[Task, int]]] = {}

        def following() -> tuple[Task, int] | None:
            if again:
                return again.popleft()
            new = next(left, None)
            return None if new is None else (new, TRIES)

        try:
            for _ in range(self.count):
                self._give(workers, following(), function)
            while workers:
                for pipe in wait(list(workers)):
                    worker = workers[pipe]  # type: ignore[index]  # of Connections alone
                    (task, tries), worker.task = worker.task or _nothing(), None
                    answer = _received(worker)
                    if answer is not None:
                        result, tired = answer
                        worker.done += self.ages(result)
                        yield result
                        if not tired and worker.done < self.each:
                            self._give(workers, following(), function, worker)
                            continue
                        _end(workers.pop(worker.pipe))
                    else:
                        words = _death(workers.pop(worker.pipe))
                        if tries > 1:
                            again.append((task, tries - 1))
                        else:
                            yield lost(task, f"{words}, {TRIES} times")
                    self._give(workers, following(), function)
        finally:
            for worker in workers.values():
                worker.process.kill()
            for worker in workers.values():
                worker.process.join(END_S)

    def _give(
        self,
        workers: dict[Connection, _Worker[tuple[Task, int]]],
        task: tuple[Task, int] | None,
        function: Callable[[Task], Result],
        worker: _Worker[tuple[Task, int]] | None = None,
    ) -> None:
        """Hand a task to a worker, or to a new one; without a task the worker ends."""
        if task is None:
            if worker is not None:
                _end(workers.pop(worker.pipe))
            return
        worker = worker or _started()
        worker.task = task
        workers[worker.pipe] = worker
        try:
            worker.pipe.send((function, task[0]))
        except OSError:
            pass  # it has died meanwhile: reading from it tells


def _nothing() -> Any:
    raise RuntimeError("a worker without a task answered")


def _started() -> _Worker[Any]:
    context = get_context("spawn")
    here, there = context.Pipe()
    process = context.Process(target=_work, args=(there, os.getpid()), daemon=True)
    process.start()
    there.close()
    return _Worker(process, here)


def _received(worker: _Worker[Any]) -> Any:
    """Result, and whether the process has grown too large; None where it has died."""
    try:
        return worker.pipe.recv()
    except (EOFError, OSError):
        return None


def _death(worker: _Worker[Any]) -> str:
    worker.pipe.close()
    worker.process.join(END_S)
    code = worker.process.exitcode
    return f"ended by {signal.Signals(-code).name}" if code is not None and code < 0 else f"exit code {code}"


def _end(worker: _Worker[Any]) -> None:
    """Let an idle process end: it sees its pipe closed."""
    worker.pipe.close()
    worker.process.join(END_S)
    if worker.process.is_alive():
        worker.process.kill()


def _work(pipe: Connection, parent: int) -> None:
    """The life of a process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to answer
    end_with(parent)
    while True:
        try:
            function, task = pipe.recv()
        except EOFError:
            return
        result = function(task)
        pipe.send((result, _mebibytes() > MOST_MIB))


def _mebibytes() -> float:
    """Resident memory of this process now; 0 where the system does not tell."""
    try:
        with open("/proc/self/statm", encoding="ascii") as stream:  # noqa: PTH123 - no file of ours
            return int(stream.read().split()[1]) * _PAGE / (1 << 20)
    except (OSError, ValueError, IndexError):
        return 0.0
