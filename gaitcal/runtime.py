"""What a fit asks of the process it runs in, and the type of a callable that is told how long work
goes on.

Freed memory is kept for the next array. A fit passes over a few megabytes of arrays again and
again. As long as a process has freed none larger, glibc gives those back to the system and gets
them again, page by page, for the next pass: tracking a walk then takes half as long again, and a
draw in a dask worker (started with MALLOC_TRIM_THRESHOLD_=65536) more than twice its time. What
glibc does by itself in a process that has once freed a large array is asked for here, once in each
process, before it fits.

BLAS uses one thread. The matrices here are small, and threads would only wait for each other: with
two, tracking a walk takes more than twice its time, and the last bits depend on how many there are.
Whatever computes and may be called from outside (the names of `import gaitcal`, what a worker is
handed, the parts of a study that are compared bit for bit) is therefore `with_one_blas_thread`. The
number belongs to the whole process, so the first that enters sets it and the last that leaves gives
the user's own back: neither two threads that calibrate at once nor one call within another restore
it too early. A call costs microseconds, one within another less. The command line asks for one
thread before NumPy is loaded.
"""

import ctypes
import sys
import threading
from collections.abc import Callable, Iterator
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
    """Let this process keep up to 64 MiB that it has freed; False where the system's allocator
    cannot be asked.
    """
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
    """Looked for once in each process, as that takes milliseconds."""
    for owner in ("numpy", "scipy.linalg"):
        import_module(owner)  # each brings a BLAS of its own
    return tuple(
        library for library in ThreadpoolController().lib_controllers if library.user_api == "blas"
    )


_entering = threading.Lock()
_inside = 0  # How many threads of the process are in `one_blas_thread` at present
_users_own: tuple[int, ...] = ()  # Threads of each library before the first of them
_here = threading.local()  # `depth`: calls of this thread, one within another


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """BLAS uses one thread inside, and as many as before afterwards."""
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
    global _inside, _users_own
    libraries = _blas_libraries()
    with _entering:
        before = tuple(library.get_num_threads() for library in libraries)
        _users_own = before if _inside == 0 else _users_own
        _inside += 1
        for library in libraries:
            _set_threads(library, 1)
    return before


def _leave(before: tuple[int, ...]) -> None:
    global _inside
    with _entering:
        _inside -= 1
        for library, own, of_process in zip(_blas_libraries(), before, _users_own, strict=True):
            if getattr(library, "threading_layer", "") == "openmp":  # a number for every thread
                _set_threads(library, own)
            elif _inside == 0:
                _set_threads(library, of_process)


def _set_threads(library: Any, number: int) -> None:
    """Set it whichever thread did so before, which threadpoolctl 3.8 refuses by itself; `_entering`
    orders them.
    """
    let_all = getattr(library, "clear_controlling_thread", lambda **_: None)
    let_all(force=True)
    library.set_num_threads(number)
    let_all(force=True)


def with_one_blas_thread(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """The same function, run with one BLAS thread."""

    @wraps(function)
    def run(*args: _P.args, **kwargs: _P.kwargs) -> _R:
        with one_blas_thread():
            return function(*args, **kwargs)

    return run


Progress: TypeAlias = Callable[[str], None]  # Takes a line of text that tells what is being done


def silent(text: str) -> None:
    """Say nothing."""
