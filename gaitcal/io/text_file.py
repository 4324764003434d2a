"""Read lines, rows of numbers and times of text files, with errors that name file and line.

Times must increase strictly. Rounding of times in text is removed: a file that prints 60 Hz in
milliseconds has 0.017, 0.033, 0.050, up to 0.5 ms off, which at 5 m/s is 2.5 mm. If all times are
within their rounding of a uniform grid of a whole number of hertz, that grid is restored. Otherwise
they stay as they are.
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
"""Texts that writers use for a missing number."""
MOST_DECIMALS = 6  # Times given more finely than this are as good as exact
EXACT_TOLERANCE_S = 1e-9  # A grid closer than this to the times given changes nothing
# Relative deviation of a time step from the median above which a note is given
UNEVEN_STEP_SHARE = 0.2

_P = ParamSpec("_P")
_T = TypeVar("_T")


class FileFault(Exception):  # noqa: N818  it never leaves this package: `name_file_in_faults` makes an InputError of it
    """Error in the file that is being read or written.

    Parameters
    ----------
    message
        The value found, and the allowed ones.
    field
        Where in the file.
    code
        Code of the error.
    """

    def __init__(
        self, message: str, field: str | None = None, code: Code = Code.FILE_FORMAT
    ) -> None:
        super().__init__(message)
        self.field, self.code = field, code


def name_file_in_faults(
    function: Callable[Concatenate[Path, _P], _T],
) -> Callable[Concatenate[Path, _P], _T]:
    """Decorate a reader or writer: a FileFault becomes an InputError on its first argument."""

    @wraps(function)
    def named(path: Path, /, *args: _P.args, **kwargs: _P.kwargs) -> _T:
        try:
            return function(path, *args, **kwargs)
        except FileFault as fault:
            raise InputError(str(fault), source=path, field=fault.field, code=fault.code) from None

    return named


@name_file_in_faults
def check_readable(path: Path) -> int:
    """Check that a file is readable and not empty.

    Parameters
    ----------
    path
        The file.

    Returns
    -------
    int
        Its size, bytes.

    Raises
    ------
    InputError
        It is missing, a folder, unreadable or empty.
    """
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


def format_number_lines(values: Array, separator: str, missing: str = "") -> str:
    """Format rows of numbers as lines that read back to the same bits.

    Parameters
    ----------
    values : (rows, columns)
        Numbers.
    separator
        Text between two numbers.
    missing
        Text for NaN.

    Returns
    -------
    str
        Lines with ends.
    """
    rows = _format_numbers(values, missing)[2:-2].replace("],[", "\n").replace(",", separator)
    return rows + "\n" if len(values) else ""


def format_number_cells(values: NDArray[Any]) -> list[str]:
    """Format numbers (n,) one by one as by `format_number_lines`; NaN becomes empty."""
    return _format_numbers(values, "")[1:-1].split(",") if len(values) else []


def _format_numbers(values: NDArray[Any], missing: str) -> str:
    """Format numbers with pydantic, which takes a quarter of the time of `repr`."""
    # Imported here, as the process that parses C3D files does not need it and starts sooner
    from pydantic_core import to_json

    return to_json(values.tolist()).decode().replace("NaN", missing).replace("Infinity", "inf")


@name_file_in_faults
def read_lines(path: Path) -> list[str]:
    """Read the lines of a text file: UTF-8 (with or without mark), else Latin-1.

    Only CR and LF end a line. `str.splitlines` would also break at separators that may occur in a
    marker name.

    Parameters
    ----------
    path
        The file.

    Returns
    -------
    list of str
        Lines without ends, without blank lines at the end.

    Raises
    ------
    InputError
        The file is unreadable, blank, binary or UTF-16.
    """
    check_readable(path)
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
        raise FileFault("the file has only blank lines", code=Code.NOT_TEXT)
    return lines


@dataclass(frozen=True)
class NumberTable:
    """Numbers as read, before they are interpreted."""

    values: Array  # (rows, columns); NaN where a number is missing
    lines: tuple[int, ...]  # (rows,) line in the file of each row, from 1, for messages
    filled_rows: int
    """Number of rows that ended before their last columns."""


def parse_number(cell: str) -> float:
    """Parse a number; NaN for the usual texts for a missing one.

    Raises
    ------
    ValueError
        The cell is no number; Python's `1_000` is none.
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
    """Parse every non-blank line from index `start` on as `width` numbers.

    Parameters
    ----------
    lines
        Lines of the file.
    start
        Index of the first line of numbers.
    width
        Number of columns; further cells must be empty.
    separator
        Text between two cells; None for any white space.
    short_step
        A row, other than the last, may lack a multiple of so many last cells (0: none), as some
        writers drop empty cells at the end.

    Returns
    -------
    NumberTable
        NaN for empty cells.

    Raises
    ------
    FileFault
        A row has the wrong number of cells, or a cell is no finite number.
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
        rows.append(_parse_cells(cells[:width], number))
        numbers.append(number)
    values = np.array(rows, dtype=np.float64).reshape(-1, width)
    for row, column in np.argwhere(np.isinf(values)).tolist():
        raise FileFault(
            "found an infinite number", f"line {numbers[row]}, column {column + 1}", Code.BAD_NUMBER
        )
    return NumberTable(values, tuple(numbers), filled)


def _parse_cells(cells: list[str], number: int) -> list[float]:
    """Parse the cells of one line: at once, or one by one if a cell is empty or no number."""
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
    """Require finite, strictly increasing times.

    Parameters
    ----------
    time : (ns,)
        s.
    lines : (ns,)
        Line of each time in the file, for the message.

    Raises
    ------
    FileFault
        There are no times, or one is missing or does not increase.
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
    """Restore the uniform grid of rounded times.

    Parameters
    ----------
    time : (ns,)
        Times as read, s.

    Returns
    -------
    time, notes
        The grid with a note, or `time` itself; a note if steps are uneven.
    """
    if len(time) < 3:
        return time, ()
    finest = range(1, MOST_DECIMALS + 1)
    decimals = next(
        (n for n in finest if np.all(np.abs(time - np.round(time, n)) <= EXACT_TOLERANCE_S)), None
    )
    rate = round((len(time) - 1) / float(time[-1] - time[0]))
    if decimals is not None and rate > 0:
        unit = 10.0**-decimals
        grid = (round(float(time[0]) * rate) + np.arange(len(time))) / rate
        away = float(np.max(np.abs(time - grid)))
        if away <= EXACT_TOLERANCE_S:
            return time, ()
        if away <= 1.0001 * unit and unit < 0.5 / rate:
            change = f"largest change {1e3 * away:.2g} ms"
            return grid, (
                f"Times rounded to {unit:g} s were put back on their {rate} Hz grid ({change}).",
            )
    steps = np.diff(time)
    middle = float(np.median(steps))
    if np.any(np.abs(steps - middle) > UNEVEN_STEP_SHARE * middle):
        return time, (
            f"Time steps are uneven: {1e3 * steps.min():.3g} to {1e3 * steps.max():.3g} ms.",
        )
    return time, ()
