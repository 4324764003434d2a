"""Who computes the chunks: this process, processes of this machine, or a cluster. All give the same
bits.

Processes and clusters are executors as of `concurrent.futures`, served by one loop
(`_Executing.run`). Tasks are taken from their iterator as there is room for them, so that memory
stays bounded. One over which a worker dies is handed in again, a few times: who killed the worker
is not known.
"""

import os
import re
import signal
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, CancelledError, Executor, Future, wait
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar

from joblib.externals.loky import ProcessPoolExecutor, cpu_count
from joblib.externals.loky.process_executor import BrokenProcessPool

from gaitcal.errors import Code, GaitcalError, InputError, UsageError
from gaitcal.io import atomic, result_folder

TRIES = 3
"""Processes of this machine that may die over a task before it is given up."""
CLUSTER_TRIES = 6
"""The same of a cluster, each time after the scheduler's own tries."""
WATCH_S = 1.0
"""How often a worker process looks whether its parent is still there."""
AHEAD = 3
"""Tasks handed in for each worker thread of a cluster: enough to keep it busy, and bounded."""
WAIT_S = 30
"""For the scheduler of a cluster, and for its first worker."""

Task = TypeVar("Task")
Result = TypeVar("Result")


class Workers:
    """Whoever maps a picklable function over tasks: this process, one after the other; others run
    them elsewhere.
    """

    def run(
        self,
        function: Callable[[Task], Result],
        tasks: Iterable[Task],
        lost: Callable[[Task, str], Result] | None = None,
    ) -> Iterator[Result]:
        """Yield `function(task)` for every task, in any order; without `lost`, one that is given up
        ends the run.
        """
        return map(function, tasks)


@dataclass(frozen=True)
class _Crew:
    """An executor, and what it is like."""

    name: str
    executor: Executor
    room: Callable[[], int]
    """How many tasks it takes at a time."""
    death: type[Exception]
    """Error of a task whose worker died."""
    tries: int
    words: Callable[[BaseException], str]
    """Why a task is given up."""


class _Executing(Workers, ABC):
    """Workers behind an executor."""

    @abstractmethod
    def crew(self) -> AbstractContextManager[_Crew]:
        """The executor, ended with the context whatever it is at."""

    def run(
        self,
        function: Callable[[Task], Result],
        tasks: Iterable[Task],
        lost: Callable[[Task, str], Result] | None = None,
    ) -> Iterator[Result]:
        """Yield the results as they are ready; see `Workers`."""
        with self.crew() as crew:
            left = ((task, crew.tries) for task in tasks)
            again: list[tuple[Task, int]] = []
            running: dict[Future[Result], tuple[Task, int]] = {}
            while True:
                for _ in range(crew.room() - len(running)):
                    given = again.pop() if again else next(left, None)
                    if given is None:
                        break
                    running[crew.executor.submit(function, given[0])] = given
                if not running:
                    return
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    task, tries = running.pop(future)
                    error = (
                        CancelledError("cancelled") if future.cancelled() else future.exception()
                    )
                    if error is None:
                        yield future.result()
                    elif isinstance(error, (crew.death, CancelledError)) and tries > 1:
                        again.append((task, tries - 1))
                    elif lost is None:
                        raise GaitcalError(
                            f"{crew.name} could not compute a chunk: {crew.words(error)}"
                        )
                    else:
                        yield lost(task, crew.words(error))


@dataclass(frozen=True)
class LocalProcesses(_Executing):
    """Processes of this machine, by loky. One that dies stops nobody."""

    jobs: int = -1
    """How many; -1: one for every core."""
    each: int | None = None
    """Tasks after which a process is replaced, so that memory does not grow with their number;
    None: never.
    """
    ages: Callable[[Any], int] = lambda result: 1
    """As how many tasks a result counts: 0 where it cost no work, `each` where its process has to
    go at once.
    """

    @contextmanager
    def crew(self) -> Iterator[_Crew]:
        """As many processes."""
        count = cpu_count() if self.jobs < 0 else self.jobs
        with _Processes(self.each, self.ages) as processes:
            yield _Crew("a process", processes, lambda: count, BrokenProcessPool, TRIES, _death)


class _Processes(Executor):
    """A pool of loky for each process: such a pool ends as a whole where a process dies, and the
    task must be known.
    """

    def __init__(self, each: int | None, ages: Callable[[Any], int]) -> None:
        self._each, self._ages = each, ages
        self._last: dict[ProcessPoolExecutor, tuple[Future[Any], int]] = {}
        """The last task of every process, and the process's age before it."""

    def submit(
        self, function: Callable[..., Result], /, *args: Any, **kwargs: Any
    ) -> Future[Result]:
        """As of `concurrent.futures`, to a process that has ended its last task, or to a new one."""
        pool, age = None, 0
        for idle, (last, before) in list(self._last.items()):
            if last.done():
                del self._last[idle]
                if last.exception() is not None:
                    idle.shutdown(kill_workers=True)
                    continue
                age = before + self._ages(last.result())
                if self._each is None or age < self._each:
                    pool = idle
                    break
                idle.shutdown()
        if pool is None:
            pool, age = ProcessPoolExecutor(1, initializer=_begin, initargs=(os.getpid(),)), 0
        try:
            future: Future[Result] = pool.submit(function, *args, **kwargs)
        except BrokenProcessPool:  # it died while it had nothing to do
            return self.submit(function, *args, **kwargs)
        self._last[pool] = future, age
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End all processes at once, whatever they are at."""
        for pool in self._last:
            pool.shutdown(kill_workers=True)


def _death(error: BaseException) -> str:
    """How a process ended, of loky's words on it; raises what was no death but the function's own
    error.
    """
    if not isinstance(error, BrokenProcessPool):
        raise error
    code = re.search(r"\{(SIG\w+)\(-?\d+\)\}", str(error))
    return f"{f'ended by {code[1]}' if code else 'it ended'}, {TRIES} times"


def _begin(parent: int) -> None:
    """In a worker process: Ctrl-C is the parent's to answer, and its end is this one's, whatever is
    done here then.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(WATCH_S)
    os._exit(1)


@dataclass(frozen=True)
class DaskCluster(_Executing):
    """The workers of a scheduler of `dask.distributed` (extra `gaitcal[cluster]`)."""

    address: str
    """For example tcp://10.0.0.1:8786."""

    @contextmanager
    def crew(self) -> Iterator[_Crew]:
        """All workers that the scheduler has at the time.

        Raises InputError: No scheduler at the address, or one without workers.
        """
        try:
            library = import_module("distributed")
        except ImportError:
            message = (
                "a cluster needs the packages of the extra 'cluster': pip install "
                "'gaitcal[cluster]'"
            )
            raise InputError(message, field="--cluster", code=Code.CLUSTER) from None
        try:
            client = library.Client(self.address, timeout=WAIT_S, set_as_default=False)
        except (OSError, ValueError) as error:
            message = (
                f"found '{self.address}': {error}; allowed: the address of a running dask "
                "scheduler, as "
            )
            raise InputError(
                f"{message}tcp://host:port", field="--cluster", code=Code.CLUSTER
            ) from None
        with client:
            try:
                client.wait_for_workers(1, timeout=WAIT_S)
            except TimeoutError:
                message = f"the scheduler at {self.address} has no workers"
                raise InputError(message, field="--cluster", code=Code.CLUSTER) from None

            def room() -> int:
                threads: int = sum(client.nthreads().values())
                return AHEAD * max(threads, 1)

            executor = client.get_executor(pure=False)
            death = library.KilledWorker
            yield _Crew(
                "the cluster",
                executor,
                room,
                death,
                CLUSTER_TRIES,
                lambda e: f"error: {type(e).__name__}: {e}",
            )


def workers_of(
    jobs: int, cluster: str | None, local: Callable[[int], Workers] = LocalProcesses
) -> Workers:
    """Who computes by the options `--jobs` and `--cluster`; UsageError where these cannot be."""
    if cluster is not None:
        return DaskCluster(cluster)
    if jobs == 0 or jobs < -1:
        raise UsageError(f"found {jobs}; allowed: 1, 2, ..., or -1 for every core", field="--jobs")
    return local(jobs)


@contextmanager
def alone(folder: Path, purpose: str, wait_s: float | None = None) -> Iterator[None]:
    """No other run of this purpose works in the folder meanwhile: it would compute the same a
    second time.
    """
    with ExitStack() as stack:
        with atomic.convert_disk_errors(folder):
            folder.parent.mkdir(parents=True, exist_ok=True)
            stack.enter_context(result_folder.lock_result(folder, purpose, wait_s=wait_s))
        yield
