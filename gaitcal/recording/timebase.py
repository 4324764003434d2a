"""Sample times: strictly increasing, and freed of the rounding that text files suffer.

A file that prints 60 Hz times to the millisecond says 0.017, 0.033, 0.050: up to 0.5 ms off, which at 5 m/s is 2.5 mm.
Where all times lie within their own rounding of a uniform grid of a whole number of hertz, that grid is what was
meant, and is put back. Anything else is left as the file says.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gaitcal.errors import InputError
from gaitcal.recording.recording import Array

MOST_DECIMALS = 6
"""Times given more finely than this are as good as exact."""
EXACT_S = 1e-9
"""A grid closer than this to the times given changes nothing."""
UNEVEN = 0.2
"""Relative departure of a time step from the median above which the user is told."""


def require_increasing(time: Array, source: Path | str, lines: tuple[int, ...] | None = None) -> None:
    """InputError unless times are finite and strictly increasing."""

    def place(index: int) -> str:
        return f"line {lines[index]}, time" if lines else f"row {index + 1}, time"

    if len(time) == 0:
        raise InputError("found no row of numbers; at least one frame is needed", source=source)
    bad = np.flatnonzero(~np.isfinite(time))
    if len(bad):
        raise InputError("found no number", source=source, field=place(int(bad[0])))
    back = np.flatnonzero(np.diff(time) <= 0)
    if len(back):
        i = int(back[0]) + 1
        raise InputError(
            f"found {time[i]:.6g} s after {time[i - 1]:.6g} s; time must increase", source=source, field=place(i)
        )


def undo_rounding(time: Array) -> tuple[Array, tuple[str, ...]]:
    """The uniform grid that `time` (ns,) is a rounded copy of, with a note; or `time` itself."""
    if len(time) < 3:
        return time, ()
    steps = np.diff(time)
    decimals = _decimals(time)
    span = float(time[-1] - time[0])
    rate = round((len(time) - 1) / span)
    if decimals is not None and rate > 0:
        unit = 10.0**-decimals
        first = round(float(time[0]) * rate)
        grid = (first + np.arange(len(time))) / rate
        away = float(np.max(np.abs(time - grid)))
        if away <= EXACT_S:
            return time, ()
        if away <= 1.0001 * unit and unit < 0.5 / rate:
            change = f"largest change {1e3 * away:.2g} ms"
            return grid, (f"Times rounded to {unit:g} s were put back on their {rate} Hz grid ({change}).",)
    middle = float(np.median(steps))
    if np.any(np.abs(steps - middle) > UNEVEN * middle):
        return time, (f"Time steps are uneven: {1e3 * steps.min():.3g} to {1e3 * steps.max():.3g} ms.",)
    return time, ()


def _decimals(time: Array) -> int | None:
    """Fewest decimals that write every time exactly, or None where more than MOST_DECIMALS are needed."""
    for decimals in range(1, MOST_DECIMALS + 1):
        if np.all(np.abs(time - np.round(time, decimals)) <= EXACT_S):
            return decimals
    return None
