"""One figure of a benchmark: a task to be timed, or an amount to be measured; and how figures grow with size."""

from __future__ import annotations

import atexit
import shutil
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np


@dataclass(frozen=True)
class Timing:
    """A task to be timed."""

    name: str
    task: Callable[[], object]
    note: str | Callable[[float], str] = ""
    """What to say beside it; may depend on the seconds it took."""
    runs: int | None = None
    """Timed runs, if not as many as asked for. A single one has no warm-up before it."""
    series: str = ""
    """Figures of one series differ in size alone."""
    size: float = 0.0
    share: Callable[[], float] | None = None
    """What to divide the seconds by where a series is compared: iterations, where their number differs."""


@dataclass(frozen=True)
class Amount:
    """Something other than time, measured once."""

    name: str
    measure: Callable[[], float]
    unit: str
    note: str = ""
    series: str = ""
    size: float = 0.0


def exponent(sizes: Sequence[float], values: Sequence[float]) -> float:
    """E of  value = c size^e, by least squares in logarithms."""
    return float(np.polyfit(np.log(sizes), np.log(values), 1)[0])


def temporary_folder() -> Path:
    """A new folder, removed when Python ends."""
    folder = Path(tempfile.mkdtemp(prefix="gaitcal-benchmark-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder
