"""What all tables of numbers in text files share: lines, rows of numbers, a column of times.

Every way in which a file cannot be read ends in one InputError that names line and column.

Times increase strictly, and are freed of the rounding that text suffers: a file that prints 60 Hz to the millisecond
says 0.017, 0.033, 0.050, up to 0.5 ms off, which at 5 m/s is 2.5 mm. Where all times lie within their own rounding of
a uniform grid of a whole number of hertz, that grid is what was meant, and is put back. Else they stay as they are.
"""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gaitcal.arrays import Array
from gaitcal.codes import Code
from gaitcal.errors import InputError

MISSING = frozenset(
    ["", "nan", "-nan", "+nan", "na", "n/a", "none", "null", "-nan(ind)", "nan(ind)", "1.#qnan", "-1.#ind"]
)
"""What writers put where there is no number."""
UTF_16 = (b"\xff\xfe", b"\xfe\xff")
"""Marks that Windows programs put before it."""
MOST_DECIMALS = 6
"""Times given more finely than this are as good as exact."""
EXACT_S = 1e-9
"""A grid closer than this to the times given changes nothing."""
UNEVEN = 0.2
"""Relative departure of a time step from the median above which the user is told."""


def _every_other_zero(content: bytes) -> bool:
    """Whether plain letters and digits stand two bytes each, as in UTF-16 without a mark."""
    start = content[:2000]
    return any(start[k::2].count(0) > 0.9 * len(start[k::2]) and start[1 - k :: 2].count(0) == 0 for k in (0, 1))


def readable_size(path: Path) -> int:
    """Size in bytes of a readable, non-empty file; InputError for anything else."""
    try:
        if path.is_dir():
            raise InputError("found a folder; a file is needed", source=path, code=Code.NO_FILE)
        size = path.stat().st_size
    except FileNotFoundError:
        raise InputError("no such file", source=path, code=Code.NO_FILE) from None
    except (OSError, ValueError) as error:
        raise InputError(f"cannot be read ({error})", source=path, code=Code.UNREADABLE) from None
    if size == 0:
        raise InputError("the file is empty", source=path, code=Code.NOT_TEXT)
    return size


def number_lines(values: Array, separator: str, missing: str = "") -> str:
    """Rows of numbers as lines, each number in the shortest form that reads back to the same bits."""
    lines = [separator.join(map(repr, row)) + "\n" for row in values.tolist()]
    return "".join(lines).replace("nan", missing)


def read_lines(path: Path) -> list[str]:
    """Lines of a text file, without their ends; UTF-8 (with or without mark), else Latin-1.

    Only CR and LF end a line: `str.splitlines` would also break at separators that may stand inside a marker name.
    """
    readable_size(path)
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot be read ({error})", source=path, code=Code.UNREADABLE) from None
    if content.startswith(UTF_16):
        raise InputError("found UTF-16 text; save the file as UTF-8", source=path, code=Code.NOT_TEXT)
    if b"\0" in content:
        if _every_other_zero(content):
            raise InputError("found UTF-16 text; save the file as UTF-8", source=path, code=Code.NOT_TEXT)
        raise InputError("found binary data; a text file is needed", source=path, code=Code.NOT_TEXT)
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("latin-1")
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    while lines and not lines[-1].strip():
        lines.pop()
    if not lines:
        raise InputError("the file holds only blank lines", source=path, code=Code.NOT_TEXT)
    return lines


@dataclass(frozen=True)
class NumberTable:
    """Numbers as read, before any meaning is given to them."""

    values: Array
    """(rows, columns); NaN where a cell is empty or says so."""
    lines: tuple[int, ...]
    """(rows,) line in the file of each row, from 1, for messages."""
    filled_rows: int
    """How many rows ended before their last columns (whole triples of empty cells left away by the writer)."""


def parse_number(cell: str) -> float:
    """A float, NaN for the usual words for nothing; ValueError for anything else (also for Python's `1_000`)."""
    cell = cell.strip()
    if cell.lower() in MISSING:
        return float("nan")
    if "_" in cell:
        raise ValueError(cell)
    return float(cell)


def parse_rows(
    lines: Sequence[str], start: int, width: int, *, source: Path, separator: str | None, short_step: int = 0
) -> NumberTable:
    """Every non-blank line from index `start` on, as `width` numbers.

    `separator` None means any white space. Further cells must be empty. A row, other than the last, may lack its last
    cells if their count is a multiple of `short_step` (0: never): some writers drop trailing empty cells.
    """
    values = array("d")
    line_numbers: list[int] = []
    filled = 0
    last = len(lines) - 1
    for index in range(start, len(lines)):
        line = lines[index]
        cells = line.split(separator)
        if not any(cell.strip() for cell in cells):
            continue
        if len(cells) != width:
            extra = cells[width:]
            if any(cell.strip() for cell in extra):
                raise InputError(
                    f"found {len(cells)} cells; {width} are allowed",
                    source=source,
                    field=f"line {index + 1}",
                    code=Code.FILE_FORMAT,
                )
            missing = width - len(cells)
            if missing > 0:
                if not short_step or missing % short_step or len(cells) < 2 or index == last:
                    tail = " (file cut short?)" if index == last else ""
                    raise InputError(
                        f"found {len(cells)} cells{tail}; {width} are needed",
                        source=source,
                        field=f"line {index + 1}",
                        code=Code.FILE_FORMAT,
                    )
                cells = cells + [""] * missing
                filled += 1
            cells = cells[:width]
        values.extend(_numbers(cells, line, source, index))
        line_numbers.append(index + 1)
    table = np.array(values, dtype=np.float64).reshape(-1, width)
    infinite = np.argwhere(np.isinf(table))
    if len(infinite):
        row, column = (int(i) for i in infinite[0])
        raise InputError(
            "found an infinite number",
            source=source,
            field=f"line {line_numbers[row]}, column {column + 1}",
            code=Code.BAD_NUMBER,
        )
    return NumberTable(table, tuple(line_numbers), filled)


def _numbers(cells: list[str], line: str, source: Path, index: int) -> list[float]:
    """The cells of one line as numbers: all at once, or one by one where that fails."""
    if "_" not in line:
        try:
            return list(map(float, cells))
        except ValueError:
            pass  # an empty cell, or a real fault: cell by cell below
    numbers = []
    for column, cell in enumerate(cells):
        try:
            numbers.append(parse_number(cell))
        except ValueError:
            raise InputError(
                f"found '{cell.strip()[:40]}'; a number or an empty cell is needed",
                source=source,
                field=f"line {index + 1}, column {column + 1}",
                code=Code.NOT_TEXT,
            ) from None
    return numbers


def require_increasing(time: Array, source: Path | str, lines: tuple[int, ...] | None = None) -> None:
    """InputError unless times are finite and strictly increasing."""

    def place(index: int) -> str:
        return f"line {lines[index]}, time" if lines else f"row {index + 1}, time"

    if len(time) == 0:
        raise InputError("found no row of numbers; at least one frame is needed", source=source, code=Code.BAD_NUMBER)
    bad = np.flatnonzero(~np.isfinite(time))
    if len(bad):
        raise InputError("found no number", source=source, field=place(int(bad[0])), code=Code.BAD_NUMBER)
    back = np.flatnonzero(np.diff(time) <= 0)
    if len(back):
        i = int(back[0]) + 1
        raise InputError(
            f"found {time[i]:.6g} s after {time[i - 1]:.6g} s; time must increase",
            source=source,
            field=place(i),
            code=Code.BAD_NUMBER,
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
