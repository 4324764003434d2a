"""Who computes the chunks: this process, processes of this machine, or a cluster. All give the same bits.

A kind of workers is anything with `run(function, tasks)` that yields the results in any order. Tasks are taken from
their iterator as workers become free, so that memory stays bounded however many there are.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Protocol, TypeVar

from joblib import Parallel, delayed, parallel_config

WATCH_S = 1.0
"""How often a worker process looks whether its parent is still there."""

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
    """Processes of this machine, by joblib, BLAS with one thread each."""

    jobs: int = -1
    """How many; -1: one for every core."""

    def run(self, function: Callable[[Task], Result], tasks: Iterable[Task]) -> Iterator[Result]:
        """Yield the results as they are ready."""
        with parallel_config(backend="loky", inner_max_num_threads=1):
            pool = Parallel(
                n_jobs=self.jobs,
                return_as="generator_unordered",
                pre_dispatch="2 * n_jobs",
                batch_size=1,
                max_nbytes=None,
            )
            results = pool(delayed(_while_parent_lives)(os.getpid(), function, task) for task in tasks)
        yield from results


_watched: set[int] = set()


def _while_parent_lives(parent: int, function: Callable[[Task], Result], task: Task) -> Result:
    """Run a task in a worker process that ends soon after its parent: joblib's would wait for work for minutes."""
    if parent not in _watched and os.getpid() != parent:
        _watched.add(parent)
        threading.Thread(target=_end_with, args=(parent,), daemon=True).start()
    return function(task)


def _end_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(WATCH_S)
    os._exit(1)
