"""What all readers of files share: faults that name the file, lines, rows of numbers, a column of
times.

Every way in which a file cannot be read ends in one InputError that names file, line and column.

Times increase strictly, and are freed of the rounding that text suffers: a file that prints 60 Hz
to the millisecond says 0.017, 0.033, 0.050, up to 0.5 ms off, which at 5 m/s is 2.5 mm. Where all
times lie within their own rounding of a uniform grid of a whole number of hertz, that grid is what
was meant, and is put back. Else they stay as they are.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import Any, Concatenate, ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray

from gaitcal.arrays import Array
from gaitcal.errors import Code, InputError

MISSING = frozenset(
    [
        "",
        "nan",
        "-nan",
        "+nan",
        "na",
        "n/a",
        "none",
        "null",
        "-nan(ind)",
        "nan(ind)",
        "1.#qnan",
        "-1.#ind",
    ]
)
"""What writers put where there is no number."""
MOST_DECIMALS = 6  # Times given more finely than this are as good as exact
EXACT_S = 1e-9  # A grid closer than this to the times given changes nothing
UNEVEN = 0.2  # Relative departure of a time step from the median above which the user is told

_P = ParamSpec("_P")
_T = TypeVar("_T")


class FileFault(Exception):  # noqa: N818  it never leaves this package: `naming_file` makes an InputError of it
    """What is wrong with the file that is being read or written."""

    def __init__(
        self, message: str, field: str | None = None, code: Code = Code.FILE_FORMAT
    ) -> None:
        super().__init__(message)
        self.field, self.code = field, code


def naming_file(
    function: Callable[Concatenate[Path, _P], _T],
) -> Callable[Concatenate[Path, _P], _T]:
    """A reader or writer whose every FileFault becomes an InputError on the file that is its first
    argument.
    """

    @wraps(function)
    def named(path: Path, /, *args: _P.args, **kwargs: _P.kwargs) -> _T:
        try:
            return function(path, *args, **kwargs)
        except FileFault as fault:
            raise InputError(str(fault), source=path, field=fault.field, code=fault.code) from None

    return named


@naming_file
def readable_size(path: Path) -> int:
    """Size in bytes of a readable, non-empty file; InputError for anything else."""
    try:
        if path.is_dir():
            raise FileFault("found a folder; a file is needed", code=Code.NO_FILE)
        size = path.stat().st_size
    except FileNotFoundError:
        raise FileFault("no such file", code=Code.NO_FILE) from None
    except (OSError, ValueError) as error:
        raise FileFault(f"cannot be read ({error})", code=Code.UNREADABLE) from None
    if size == 0:
        raise FileFault("the file is empty", code=Code.NOT_TEXT)
    return size


def number_lines(values: Array, separator: str, missing: str = "") -> str:
    """Rows of numbers as lines, each number in the shortest form that reads back to the same bits."""
    rows = _number_text(values, missing)[2:-2].replace("],[", "\n").replace(",", separator)
    return rows + "\n" if len(values) else ""


def number_cells(values: NDArray[Any]) -> list[str]:
    """Numbers (n,) one by one in that form; nothing where there is none."""
    return _number_text(values, "")[1:-1].split(",") if len(values) else []


def _number_text(values: NDArray[Any], missing: str) -> str:
    """Write numbers as pydantic does, in a quarter of the time of `repr`."""
    from pydantic_core import (
        to_json,
    )  # the process that parses C3D files does without: it is ready sooner

    return to_json(values.tolist()).decode().replace("NaN", missing).replace("Infinity", "inf")


@naming_file
def read_lines(path: Path) -> list[str]:
    """Lines of a text file, without their ends; UTF-8 (with or without mark), else Latin-1.

    Only CR and LF end a line: `str.splitlines` would also break at separators that may stand inside
    a marker name.
    """
    readable_size(path)
    try:
        content = path.read_bytes()
    except OSError as error:
        raise FileFault(f"cannot be read ({error})", code=Code.UNREADABLE) from None
    start = content[:2000]
    every_other_zero = any(
        start[k::2].count(0) > 0.9 * len(start[k::2]) and 0 not in start[1 - k :: 2] for k in (0, 1)
    )
    if content.startswith((b"\xff\xfe", b"\xfe\xff")) or (0 in content and every_other_zero):
        raise FileFault("found UTF-16 text; save the file as UTF-8", code=Code.NOT_TEXT)
    if 0 in content:
        raise FileFault("found binary data; a text file is needed", code=Code.NOT_TEXT)
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("latin-1")
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    while lines and not lines[-1].strip():
        lines.pop()
    if not lines:
        raise FileFault("the file holds only blank lines", code=Code.NOT_TEXT)
    return lines


@dataclass(frozen=True)
class NumberTable:
    """Numbers as read, before any meaning is given to them."""

    values: Array  # (rows, columns); NaN where a cell is empty or says so
    lines: tuple[int, ...]  # (rows,) line in the file of each row, from 1, for messages
    filled_rows: int
    """How many rows ended before their last columns (whole triples of empty cells left away by the
    writer).
    """


def parse_number(cell: str) -> float:
    """A float, NaN for the usual words for nothing; ValueError for anything else (also for Python's
    `1_000`).
    """
    cell = cell.strip()
    if cell.lower() in MISSING:
        return float("nan")
    if "_" in cell:
        raise ValueError(cell)
    return float(cell)


def parse_rows(
    lines: Sequence[str], start: int, width: int, separator: str | None, short_step: int = 0
) -> NumberTable:
    """Every non-blank line from index `start` on, as `width` numbers.

    `separator` None means any white space. Further cells must be empty. A row, other than the last,
    may lack its last cells if their count is a multiple of `short_step` (0: never): some writers
    drop trailing empty cells.
    """
    rows: list[list[float]] = []
    numbers: list[int] = []
    filled = 0
    for number, line in enumerate(lines[start:], start=start + 1):
        cells = line.split(separator)
        if not any(cell.strip() for cell in cells):
            continue
        lacking = width - len(cells)
        if any(cell.strip() for cell in cells[width:]):
            raise FileFault(f"found {len(cells)} cells; {width} are allowed", f"line {number}")
        if lacking > 0:
            is_last = number == len(lines)
            if not short_step or lacking % short_step or len(cells) < 2 or is_last:
                tail = " (file cut short?)" if is_last else ""
                raise FileFault(
                    f"found {len(cells)} cells{tail}; {width} are needed", f"line {number}"
                )
            cells += [""] * lacking
            filled += 1
        rows.append(_numbers(cells[:width], number))
        numbers.append(number)
    values = np.array(rows, dtype=np.float64).reshape(-1, width)
    for row, column in np.argwhere(np.isinf(values)).tolist():
        raise FileFault(
            "found an infinite number", f"line {numbers[row]}, column {column + 1}", Code.BAD_NUMBER
        )
    return NumberTable(values, tuple(numbers), filled)


def _numbers(cells: list[str], number: int) -> list[float]:
    """The cells of one line: all at once, or one by one where one of them is empty, or no number."""
    try:
        if "_" not in "".join(cells):
            return list(map(float, cells))
    except ValueError:
        pass
    values = []
    for column, cell in enumerate(cells, start=1):
        try:
            values.append(parse_number(cell))
        except ValueError:
            message = f"found '{cell.strip()[:40]}'; a number or an empty cell is needed"
            raise FileFault(message, f"line {number}, column {column}", Code.NOT_TEXT) from None
    return values


def require_increasing(time: Array, lines: Sequence[int]) -> None:
    """FileFault unless times (ns,), which stand in these `lines`, are finite and strictly
    increasing.
    """
    if len(time) == 0:
        raise FileFault(
            "found no row of numbers; at least one frame is needed", code=Code.BAD_NUMBER
        )
    for i in np.flatnonzero(~np.isfinite(time)).tolist():
        raise FileFault("found no number", f"line {lines[i]}, time", Code.BAD_NUMBER)
    for i in (np.flatnonzero(np.diff(time) <= 0) + 1).tolist():
        message = f"found {time[i]:.6g} s after {time[i - 1]:.6g} s; time must increase"
        raise FileFault(message, f"line {lines[i]}, time", Code.BAD_NUMBER)


def undo_rounding(time: Array) -> tuple[Array, tuple[str, ...]]:
    """The uniform grid that `time` (ns,) is a rounded copy of, with a note; or `time` itself."""
    if len(time) < 3:
        return time, ()
    finest = range(1, MOST_DECIMALS + 1)
    decimals = next(
        (n for n in finest if np.all(np.abs(time - np.round(time, n)) <= EXACT_S)), None
    )
    rate = round((len(time) - 1) / float(time[-1] - time[0]))
    if decimals is not None and rate > 0:
        unit = 10.0**-decimals
        grid = (round(float(time[0]) * rate) + np.arange(len(time))) / rate
        away = float(np.max(np.abs(time - grid)))
        if away <= EXACT_S:
            return time, ()
        if away <= 1.0001 * unit and unit < 0.5 / rate:
            change = f"largest change {1e3 * away:.2g} ms"
            return grid, (
                f"Times rounded to {unit:g} s were put back on their {rate} Hz grid ({change}).",
            )
    steps = np.diff(time)
    middle = float(np.median(steps))
    if np.any(np.abs(steps - middle) > UNEVEN * middle):
        return time, (
            f"Time steps are uneven: {1e3 * steps.min():.3g} to {1e3 * steps.max():.3g} ms.",
        )
    return time, ()
