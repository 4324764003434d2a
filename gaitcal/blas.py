"""BLAS with one thread: the matrices here are small, and threads would only wait for each other.

With two threads tracking a walk takes more than twice its time, and the last bits depend on how many there are. The
command line asks for one thread before NumPy is loaded; in anybody's own program NumPy may have been loaded before.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, wraps
from importlib import import_module
from typing import ParamSpec, TypeVar

from threadpoolctl import ThreadpoolController

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
