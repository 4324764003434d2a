"""Freed memory that is kept for the next array.

Dask starts its workers with MALLOC_TRIM_THRESHOLD_=65536, so that glibc gives every freed array of some size back to
the system and gets it again, page by page, for the next: draws then take more than twice their time. What glibc does
by itself, up to a bound, is asked for here once in each worker process.
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
