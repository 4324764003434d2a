"""What a fit asks of the process it runs in, the type of a callable that is told how long work goes on, and what is
computed once.

Freed memory is kept for the next array. A fit passes over a few megabytes of arrays again and again. As long as a
process has freed none larger, glibc gives those back to the system and gets them again, page by page, for the next
pass: tracking a walk then takes half as long again, and a draw in a dask worker (started with
MALLOC_TRIM_THRESHOLD_=65536) more than twice its time. What glibc does by itself in a process that has once freed a
large array is asked for here, once in each process, before it fits.

BLAS uses one thread. The matrices here are small, and threads would only wait for each other: with two, tracking a walk
takes more than twice its time, and the last bits depend on how many there are. The command line asks for one thread
before NumPy is loaded; in anybody's own program NumPy may have been loaded before.
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, wraps
from importlib import import_module
from typing import ParamSpec, TypeAlias, TypeVar

from threadpoolctl import ThreadpoolController

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
"""Numbers of glibc's `mallopt`."""
KEPT_BYTES = 64 << 20
LARGEST_BYTES = 16 << 20
"""Arrays below this come from the heap."""


@cache
def keep_freed_memory() -> bool:
    """Let this process keep up to 64 MiB that it has freed; False where the system's allocator cannot be asked."""
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
def _controller() -> ThreadpoolController:
    """Looks for libraries once in each process, as that takes milliseconds."""
    for owner in ("numpy", "scipy.linalg"):
        import_module(owner)  # each brings a BLAS of its own
    return ThreadpoolController()


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """BLAS uses one thread inside, and as many as before afterwards."""
    with _controller().limit(limits=1, user_api="blas"):
        yield


def with_one_blas_thread(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """The same function, run with one BLAS thread."""

    @wraps(function)
    def run(*args: _P.args, **kwargs: _P.kwargs) -> _R:
        with one_blas_thread():
            return function(*args, **kwargs)

    return run


_T = TypeVar("_T")


def remembered(function: Callable[[_T], _R]) -> Callable[[_T], _R]:
    """The same function of an object that does not change, computed once: the object keeps what it gives."""
    name = f"_{function.__module__}.{function.__name__}"

    @wraps(function)
    def run(of: _T) -> _R:
        if name not in vars(of):
            vars(of)[name] = function(of)
        kept: _R = vars(of)[name]
        return kept

    return run


Progress: TypeAlias = Callable[[str], None]
"""Takes a line of text that tells what is being done."""


def silent(text: str) -> None:
    """Say nothing."""
