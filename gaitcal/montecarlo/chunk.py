"""A chunk: a run of draws of one cell, the unit that is computed, stored, and lost when a process dies.

Workers get the case and the settings with every chunk (some ten kilobytes) and keep what they made of them, so that a
worker can join or be replaced at any time.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from gaitcal.montecarlo.case import MonteCarloCase
from gaitcal.montecarlo.context import MonteCarloContext
from gaitcal.montecarlo.draw import draw
from gaitcal.montecarlo.settings import MonteCarloSettings, Varied
from gaitcal.runtime import one_blas_thread

Array = NDArray[np.float64]

CHUNK_DRAWS = 250
"""Some seconds of work."""


@dataclass(frozen=True)
class Chunk:
    """Draws first, first + 1, ..., stop - 1 of a set at a level."""

    varied: Varied
    level: int
    first: int
    stop: int

    @property
    def draws(self) -> int:
        """How many."""
        return self.stop - self.first


@dataclass(frozen=True)
class ChunkTask:
    """A chunk and all that it depends on."""

    case: MonteCarloCase
    settings: MonteCarloSettings
    chunk: Chunk


@dataclass(frozen=True)
class ChunkResult:
    """The records of a chunk's draws, in order."""

    chunk: Chunk
    values: Array
    """(n, 60), columns as in `draw.COLUMNS`."""
    evaluations: NDArray[np.int64]
    """(n,) of the gradient."""
    failures: tuple[str, ...]
    """(n,) reason, or empty."""


_kept = threading.local()


def run_chunk(task: ChunkTask) -> ChunkResult:
    """Compute a chunk. BLAS works with one thread, wherever this runs: more would change the last bits."""
    chunk = task.chunk
    with one_blas_thread():
        context = _context(task.case, task.settings)
        results = [draw(context, chunk.varied, chunk.level, k) for k in range(chunk.first, chunk.stop)]
    return ChunkResult(
        chunk,
        np.array([r.values for r in results]),
        np.array([r.evaluations for r in results], dtype=np.int64),
        tuple(r.failure for r in results),
    )


def _context(case: MonteCarloCase, settings: MonteCarloSettings) -> MonteCarloContext:
    """The context of a case, made once per thread and kept until another case comes."""
    key: tuple[Mapping[str, str], MonteCarloSettings] = (case.fingerprint(), settings)
    if getattr(_kept, "key", None) != key:
        _kept.context = MonteCarloContext(case, settings)
        _kept.key = key
    context: MonteCarloContext = _kept.context
    return context


def cut(first: int, stop: int, size: int = CHUNK_DRAWS) -> list[tuple[int, int]]:
    """Runs [first, stop) cut at multiples of `size`."""
    edges = [first, *range((first // size + 1) * size, stop, size), stop]
    return [(a, b) for a, b in pairwise(edges) if a < b]
