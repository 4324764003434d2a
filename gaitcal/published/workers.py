"""Who computes the chunks: this process, processes of this machine, or a cluster. All give the same bits.

A kind of workers is anything with `run(function, tasks)` that yields the results in any order. Tasks are taken from
their iterator as workers become free, so that memory stays bounded however many there are.

A cluster is one of `dask.distributed` (extra `gaitcal[cluster]`). Its scheduler gives a dead worker's chunks to others
by itself; a chunk that it gives up because several workers died over it (they may have been killed from outside, one
after the other) is handed in anew a few times.

How long the parts of a run take, by the clock.
"""

from __future__ import annotations

import os
import re
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass
from importlib import import_module
from itertools import islice
from typing import Any, Protocol, TypeVar

from joblib.externals.loky import ProcessPoolExecutor, cpu_count
from joblib.externals.loky.process_executor import BrokenProcessPool

from gaitcal.codes import Code
from gaitcal.errors import GaitcalError, InputError

TRIES = 3
"""Processes that may die over a task before it is given up."""
WATCH_S = 1.0
"""How often a worker process looks whether its parent is still there."""
AHEAD = 3
"""Chunks handed in for each worker thread of a cluster: enough to keep it busy, and bounded."""
HANDED_IN_AGAIN = 5
WAIT_S = 30
"""For the scheduler of a cluster, and for its first worker."""

Task = TypeVar("Task")
Result = TypeVar("Result")


class Workers(Protocol):
    """Anything that maps a picklable function over tasks."""

    def run(self, function: Callable[[Task], Result], tasks: Iterable[Task]) -> Iterator[Result]:
        """Yield `function(task)` for every task, in any order."""
        ...


@dataclass(frozen=True)
class ThisProcess:
    """One after the other, here."""

    def run(self, function: Callable[[Task], Result], tasks: Iterable[Task]) -> Iterator[Result]:
        """Yield the results in the order of the tasks."""
        return map(function, tasks)


@dataclass(frozen=True)
class LocalProcesses:
    """Processes of this machine, by loky, each with one task at a time. One that dies stops nobody: its task is handed
    to another one, and given up after `TRIES`.

    A pool of loky ends as a whole where one of its processes dies; here every process is a pool of its own, so that it
    is known over which task it died.
    """

    jobs: int = -1
    """How many; -1: one for every core."""
    each: int | None = None
    """Tasks after which a process is replaced, so that memory does not grow with their number; None: never."""
    ages: Callable[[Any], int] = lambda result: 1
    """As how many tasks a result counts: 0 where it cost no work, `each` where its process has to go at once."""

    def run(
        self,
        function: Callable[[Task], Result],
        tasks: Iterable[Task],
        lost: Callable[[Task, str], Result] | None = None,
    ) -> Iterator[Result]:
        """Yield the results as they are ready.

        Parameters
        ----------
        lost : what stands for a task over which `TRIES` processes died, and how; None: that ends the run.
        """
        left = ((task, TRIES) for task in tasks)
        again: list[tuple[Task, int]] = []
        idle: list[ProcessPoolExecutor | None] = [None] * (cpu_count() if self.jobs < 0 else self.jobs)
        ages: dict[ProcessPoolExecutor, int] = {}
        running: dict[Future[Result], tuple[ProcessPoolExecutor, Task, int]] = {}
        try:
            while True:
                while idle and (given := again.pop() if again else next(left, None)):
                    pool = idle.pop() or ProcessPoolExecutor(1, initializer=_begin, initargs=(os.getpid(),))
                    ages.setdefault(pool, 0)
                    try:
                        running[pool.submit(function, given[0])] = pool, *given
                    except BrokenProcessPool:  # it died while it had nothing to do
                        ages.pop(pool)
                        idle.append(None)
                        again.append(given)
                if not running:
                    return
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    pool, task, tries = running.pop(future)
                    try:
                        result = future.result()
                    except BrokenProcessPool as death:
                        ages.pop(pool)
                        idle.append(None)
                        if tries > 1:
                            again.append((task, tries - 1))
                            continue
                        words = f"{_how(death)}, {TRIES} times"
                        if lost is None:
                            raise GaitcalError(f"a process could not compute a chunk: {words}") from None
                        yield lost(task, words)
                        continue
                    ages[pool] += self.ages(result)
                    if self.each is not None and ages[pool] >= self.each:
                        ages.pop(pool)
                        pool.shutdown()
                        idle.append(None)
                    else:
                        idle.append(pool)
                    yield result
        finally:
            for pool in ages:
                pool.shutdown(kill_workers=True)


def _how(death: BrokenProcessPool) -> str:
    """How a process ended, of loky's words on it."""
    code = re.search(r"\{(\w+)\(-?\d+\)\}", str(death))
    return f"ended by {code[1]}" if code and code[1].startswith("SIG") else "it ended"


def _begin(parent: int) -> None:
    """In a worker process: Ctrl-C is the parent's to answer, and its end is this one's, whatever is done here then."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(WATCH_S)
    os._exit(1)


@dataclass(frozen=True)
class Cluster:
    """The workers of a scheduler."""

    address: str
    """For example tcp://10.0.0.1:8786."""

    def run(
        self,
        function: Callable[[Task], Result],
        tasks: Iterable[Task],
        lost: Callable[[Task, str], Result] | None = None,
    ) -> Iterator[Result]:
        """Yield the results as they are ready.

        Parameters
        ----------
        lost : what stands for a task that the cluster gives up, and why it did; None: that ends the run.

        Raises
        ------
        InputError
            No scheduler at the address, or one without workers.
        GaitcalError
            The workers cannot do it: another version of gaitcal, or none.
        """
        with _connected(self.address) as client:
            yield from _run(client, function, iter(tasks), lost)


def _library() -> Any:
    """The package `distributed`."""
    try:
        return import_module("distributed")
    except ImportError:
        raise InputError(
            "a cluster needs the packages of the extra 'cluster': pip install 'gaitcal[cluster]'",
            field="--cluster",
            code=Code.CLUSTER,
        ) from None


def _connected(address: str) -> Any:
    try:
        client = _library().Client(address, timeout=WAIT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(
            f"found '{address}': {error}; allowed: the address of a running dask scheduler, as tcp://host:port",
            field="--cluster",
            code=Code.CLUSTER,
        ) from None
    try:
        client.wait_for_workers(1, timeout=WAIT_S)
    except TimeoutError:
        client.close()
        raise InputError(f"the scheduler at {address} has no workers", field="--cluster", code=Code.CLUSTER) from None
    return client


def _run(
    client: Any, function: Callable[[Task], Result], tasks: Iterator[Task], lost: Callable[[Task, str], Result] | None
) -> Iterator[Result]:
    again: dict[str, tuple[Task, int]] = {}
    running = _library().as_completed(loop=client.loop, raise_errors=False)

    def hand_in(task: Task, left: int) -> None:
        future = client.submit(function, task, pure=False)
        again[future.key] = (task, left)
        running.add(future)

    for task in islice(tasks, _room(client)):
        hand_in(task, HANDED_IN_AGAIN)
    for future in running:
        task, left = again.pop(future.key)
        if future.status != "finished":
            words = _given_up(future, left)
            if not words:
                hand_in(task, left - 1)
                continue
            if lost is None:
                raise GaitcalError(f"the cluster could not compute a chunk: {words}")
            yield lost(task, words)
        else:
            result: Result = future.result()
            future.release()
            yield result
        for new in islice(tasks, max(_room(client) - len(again), 0)):
            hand_in(new, HANDED_IN_AGAIN)


def _room(client: Any) -> int:
    threads: int = sum(client.nthreads().values())
    return AHEAD * max(threads, 1)


def _given_up(future: Any, left: int) -> str:
    """Why a task that was its own fault, or was tried too often, is not tried again; empty where it may be."""
    error = future.exception() if future.status == "error" else None
    if (error is None or isinstance(error, _library().KilledWorker)) and left > 0:
        return ""
    return f"{future.status}: {type(error).__name__}: {error}"


class StopWatch:
    """Runs from the moment it is made."""

    def __init__(self) -> None:
        self._began = time.perf_counter()
        self.laps: dict[str, float] = {}
        """Part -> seconds, in order."""

    def lap(self, part: str) -> None:
        """A part is done, and the next one begins."""
        now = time.perf_counter()
        self.laps[part] = now - self._began
        self._began = now
