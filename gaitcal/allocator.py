"""Freed memory that is kept for the next array.

A fit passes over a few megabytes of arrays again and again. As long as a process has freed none larger, glibc gives
those back to the system and gets them again, page by page, for the next pass: tracking a walk then takes half as long
again, and a draw in a dask worker (started with MALLOC_TRIM_THRESHOLD_=65536) more than twice its time. What glibc does
by itself in a process that has once freed a large array is asked for here, once in each process, before it fits.
"""

from __future__ import annotations

import ctypes
import sys
from functools import cache

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
