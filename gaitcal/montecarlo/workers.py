"""Workers that compute tasks: this process, processes of this machine, or a cluster.

All give the same bits. Processes and clusters are executors as of `concurrent.futures`, served by
one loop (`_Executing.run`). Tasks are taken from their iterator as there is room for them, so that
memory stays bounded. A task whose worker dies is submitted again, a few times, because its cause is
unknown.
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
"""Times that a process of this machine may die in a task before the task is given up."""
CLUSTER_TRIES = 6
"""The same of a cluster, each time after the tries of the scheduler."""
WATCH_S = 1.0
"""s, interval in which a worker process checks that its parent is alive."""
AHEAD = 3
"""Tasks submitted for each worker thread of a cluster: enough to keep it busy, and bounded."""
WAIT_S = 30
"""s, longest time to wait for the scheduler of a cluster, and for its first worker."""

Task = TypeVar("Task")
Result = TypeVar("Result")


class Workers:
    """Maps a picklable function over tasks, in this process; subclasses use other processes."""

    def run(
        self,
        function: Callable[[Task], Result],
        tasks: Iterable[Task],
        lost: Callable[[Task, str], Result] | None = None,
    ) -> Iterator[Result]:
        """Compute a function for every task.

        Parameters
        ----------
        function : callable
            Picklable.
        tasks : iterable
            Its arguments, taken as there is room for them.
        lost : callable, optional
            Called with a task that is given up and the reason; returns its result. Without it, such
            a task ends the run.

        Yields
        ------
        result
            In any order.

        Raises
        ------
        GaitcalError
            A task is given up.
        """
        return map(function, tasks)


@dataclass(frozen=True)
class _Crew:
    """An executor and its properties."""

    name: str
    executor: Executor
    room: Callable[[], int]
    """Number of tasks that it takes at a time."""
    death: type[Exception]
    """Error of a task whose worker died."""
    tries: int
    """Times that a task is submitted."""
    describe: Callable[[BaseException], str]
    """Describes why a task is given up."""


class _Executing(Workers, ABC):
    """Workers behind an executor."""

    @abstractmethod
    def start_crew(self) -> AbstractContextManager[_Crew]:
        """Start the executor; leaving the context ends it, with all its tasks."""

    def run(
        self,
        function: Callable[[Task], Result],
        tasks: Iterable[Task],
        lost: Callable[[Task, str], Result] | None = None,
    ) -> Iterator[Result]:
        """Yield the results as they are ready; see `Workers`."""
        with self.start_crew() as crew:
            # Tasks with the number of tries that they have.
            waiting = ((task, crew.tries) for task in tasks)
            again: list[tuple[Task, int]] = []
            running: dict[Future[Result], tuple[Task, int]] = {}
            while True:
                # Few tasks wait at the workers, so that an interruption loses little.
                for _ in range(crew.room() - len(running)):
                    following = again.pop() if again else next(waiting, None)
                    if following is None:
                        break
                    running[crew.executor.submit(function, following[0])] = following
                if not running:
                    return
                # Results in the order in which they are ready.
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
                            f"{crew.name} could not compute a chunk: {crew.describe(error)}"
                        )
                    else:
                        yield lost(task, crew.describe(error))


@dataclass(frozen=True)
class LocalProcesses(_Executing):
    """Processes of this machine, by loky. A process that dies does not stop the others."""

    jobs: int = -1
    """Number of processes; -1: one for every core."""
    tasks_per_process: int | None = None
    """Tasks after which a process is replaced, so that memory does not grow with their number;
    None: never.
    """
    count_tasks: Callable[[Any], int] = lambda result: 1
    """Number of tasks that a result counts for: 0 if it took no work, `tasks_per_process` if its
    process must be replaced at once.
    """

    @contextmanager
    def start_crew(self) -> Iterator[_Crew]:
        """Start the processes."""
        count = cpu_count() if self.jobs < 0 else self.jobs
        with _Processes(self.tasks_per_process, self.count_tasks) as processes:
            yield _Crew(
                "a process", processes, lambda: count, BrokenProcessPool, TRIES, _describe_death
            )


class _Processes(Executor):
    """A pool of loky for each process.

    A pool ends as a whole if a process dies; with one process in it, the task is known.
    """

    def __init__(self, tasks_per_process: int | None, count_tasks: Callable[[Any], int]) -> None:
        self._tasks_per_process, self._count_tasks = tasks_per_process, count_tasks
        self._last: dict[ProcessPoolExecutor, tuple[Future[Any], int]] = {}
        """The last task of every process, and the number of its tasks before it."""

    def submit(
        self, function: Callable[..., Result], /, *args: Any, **kwargs: Any
    ) -> Future[Result]:
        """Submit a task to a process that has ended its last one, or to a new process."""
        pool, count = None, 0
        for idle, (last, before) in list(self._last.items()):
            # A process that has ended its task is used again, up to its number of tasks.
            if last.done():
                del self._last[idle]
                if last.exception() is not None:
                    idle.shutdown(kill_workers=True)
                    continue
                count = before + self._count_tasks(last.result())
                if self._tasks_per_process is None or count < self._tasks_per_process:
                    pool = idle
                    break
                idle.shutdown()
        if pool is None:
            pool, count = ProcessPoolExecutor(1, initializer=_begin, initargs=(os.getpid(),)), 0
        try:
            future: Future[Result] = pool.submit(function, *args, **kwargs)
        except BrokenProcessPool:
            # The process died while it was idle.
            return self.submit(function, *args, **kwargs)
        self._last[pool] = future, count
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End all processes at once, with their tasks."""
        for pool in self._last:
            pool.shutdown(kill_workers=True)


def _describe_death(error: BaseException) -> str:
    """Describe how a process ended, from loky's message; raise an error of the function itself."""
    if not isinstance(error, BrokenProcessPool):
        raise error
    code = re.search(r"\{(SIG\w+)\(-?\d+\)\}", str(error))
    return f"{f'ended by {code[1]}' if code else 'it ended'}, {TRIES} times"


def _begin(parent: int) -> None:
    """Begin a worker process: the parent handles Ctrl-C, and this process ends with the parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_exit_with_parent, args=(parent,), daemon=True).start()


def _exit_with_parent(parent: int) -> None:
    """Exit once the parent process has ended."""
    while os.getppid() == parent:
        time.sleep(WATCH_S)
    os._exit(1)


@dataclass(frozen=True)
class DaskCluster(_Executing):
    """The workers of a scheduler of `dask.distributed` (extra `gaitcal[cluster]`)."""

    address: str
    """For example tcp://10.0.0.1:8786."""

    @contextmanager
    def start_crew(self) -> Iterator[_Crew]:
        """Connect to all workers that the scheduler has at the time.

        Raises InputError: no scheduler at the address, or one without workers.
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
                "scheduler, as tcp://host:port"
            )
            raise InputError(message, field="--cluster", code=Code.CLUSTER) from None
        with client:
            try:
                client.wait_for_workers(1, timeout=WAIT_S)
            except TimeoutError:
                message = f"the scheduler at {self.address} has no workers"
                raise InputError(message, field="--cluster", code=Code.CLUSTER) from None

            def count_room() -> int:
                threads: int = sum(client.nthreads().values())
                return AHEAD * max(threads, 1)

            executor = client.get_executor(pure=False)
            death = library.KilledWorker
            yield _Crew(
                "the cluster",
                executor,
                count_room,
                death,
                CLUSTER_TRIES,
                lambda e: f"error: {type(e).__name__}: {e}",
            )


def choose_workers(
    jobs: int, cluster: str | None, local: Callable[[int], Workers] = LocalProcesses
) -> Workers:
    """Choose workers by the options `--jobs` and `--cluster`.

    Parameters
    ----------
    jobs : int
        Number of processes; -1: one for every core.
    cluster : str or None
        Address of a dask scheduler; takes precedence.
    local : callable
        Makes the workers of this machine from `jobs`.

    Returns
    -------
    Workers

    Raises
    ------
    UsageError
        `jobs` is 0 or below -1.
    """
    if cluster is not None:
        return DaskCluster(cluster)
    if jobs == 0 or jobs < -1:
        raise UsageError(f"found {jobs}; allowed: 1, 2, ..., or -1 for every core", field="--jobs")
    return local(jobs)


@contextmanager
def lock_folder(folder: Path, purpose: str, wait_s: float | None = None) -> Iterator[None]:
    """Lock a folder against other runs of the same purpose, which would compute the same again.

    Parameters
    ----------
    folder : Path
        Made if missing.
    purpose : str
        Name of the lock.
    wait_s : float, optional
        s, longest time to wait for another run.

    Raises
    ------
    InputError
        Another run works in the folder, or it cannot be written.
    """
    with ExitStack() as stack:
        with atomic.convert_disk_errors(folder):
            folder.parent.mkdir(parents=True, exist_ok=True)
            stack.enter_context(result_folder.lock_result(folder, purpose, wait_s=wait_s))
        yield
