"""Limit BLAS to one thread, keep freed memory, and define the type of progress callables.

*Memory.* A fit passes over a few megabytes of arrays again and again. Until a process has freed a
larger array, glibc returns them to the system and requests them again, page by page, for the next
pass. Tracking a walk then takes 1.5 times as long, and a draw in a dask worker (started with
MALLOC_TRIM_THRESHOLD_=65536) more than twice as long. `keep_freed_memory` changes that, once in
each process.

*Threads.* The matrices are small: with two BLAS threads, tracking a walk takes more than twice as
long, and the last bits depend on the number of threads. Everything that computes and may be called
from outside (the names of `import gaitcal`, tasks of workers) is therefore `with_one_blas_thread`.
The number of threads belongs to the whole process: the first call that enters sets it, and the last
one that leaves restores the number before. Nested calls and parallel threads are counted. A call
costs microseconds. The command line sets one thread before NumPy is loaded.
"""

import ctypes
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache, wraps
from importlib import import_module
from typing import Any, ParamSpec, TypeAlias, TypeVar

from threadpoolctl import ThreadpoolController

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # Numbers of glibc's `mallopt`
KEPT_BYTES = 64 << 20
LARGEST_BYTES = 16 << 20  # Arrays below this come from the heap


@cache
def keep_freed_memory() -> bool:
    """Let this process keep up to 64 MiB of freed memory; False if the allocator refuses."""
    if not sys.platform.startswith("linux"):
        return False
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):
        return False
    wanted = ((_TRIM_THRESHOLD, KEPT_BYTES), (_MMAP_THRESHOLD, LARGEST_BYTES))
    return all(mallopt(which, size) == 1 for which, size in wanted)


_P = ParamSpec("_P")
_R = TypeVar("_R")


@cache
def _blas_libraries() -> tuple[Any, ...]:
    """Find the loaded BLAS libraries, once in each process, as that takes milliseconds."""
    # NumPy and SciPy each load a separate BLAS.
    for owner in ("numpy", "scipy.linalg"):
        import_module(owner)
    return tuple(
        library for library in ThreadpoolController().lib_controllers if library.user_api == "blas"
    )


_entering = threading.Lock()
# Number of threads of the process that are in `one_blas_thread`
_inside = 0
# Number of threads of each library before the first of them entered
_threads_before: tuple[int, ...] = ()
# `depth`: nested calls of this thread
_here = threading.local()


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limit BLAS to one thread inside the context, and restore the number afterwards."""
    depth = getattr(_here, "depth", 0)
    before = () if depth else _enter()
    _here.depth = depth + 1
    try:
        yield
    finally:
        _here.depth = depth
        if not depth:
            _leave(before)


def _enter() -> tuple[int, ...]:
    global _inside, _threads_before
    libraries = _blas_libraries()
    with _entering:
        before = tuple(library.get_num_threads() for library in libraries)
        _threads_before = before if _inside == 0 else _threads_before
        _inside += 1
        for library in libraries:
            _set_threads(library, 1)
    return before


def _leave(before: tuple[int, ...]) -> None:
    global _inside
    with _entering:
        _inside -= 1
        for library, before_here, of_process in zip(
            _blas_libraries(), before, _threads_before, strict=True
        ):
            if getattr(library, "threading_layer", "") == "openmp":  # a number for every thread
                _set_threads(library, before_here)
            elif _inside == 0:
                _set_threads(library, of_process)


def _set_threads(library: Any, number: int) -> None:
    """Set the number of threads, also if another thread set it before.

    threadpoolctl 3.8 refuses that by itself; here `_entering` serialises the calls.
    """
    let_all = getattr(library, "clear_controlling_thread", lambda **_: None)
    let_all(force=True)
    library.set_num_threads(number)
    let_all(force=True)


def with_one_blas_thread(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Return the function as one that runs with one BLAS thread."""

    @wraps(function)
    def run(*args: _P.args, **kwargs: _P.kwargs) -> _R:
        with one_blas_thread():
            return function(*args, **kwargs)

    return run


_Item = TypeVar("_Item")


def map_in_pairs(function: Callable[[_Item], _R], items: Iterable[_Item]) -> list[_R]:
    """Apply a function to each item, two at a time: matrix products release the other thread."""
    items = list(items)
    if len(items) < 2:
        return [function(item) for item in items]
    with ThreadPoolExecutor(2) as pool:
        return list(pool.map(with_one_blas_thread(function), items))


# Called with a line of text at the beginning of each step
Progress: TypeAlias = Callable[[str], None]


def silent(text: str) -> None:
    """Report nothing."""
