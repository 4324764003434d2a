"""Rows of numbers in a text file, as one array; faults are named by line and column."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gaitcal.errors import InputError
from gaitcal.recording.recording import Array

MISSING = frozenset(
    ["", "nan", "-nan", "+nan", "na", "n/a", "none", "null", "-nan(ind)", "nan(ind)", "1.#qnan", "-1.#ind"]
)
"""What writers put where there is no number."""


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
    lines: Sequence[str],
    start: int,
    width: int,
    *,
    source: Path,
    separator: str | None,
    short_step: int = 0,
) -> NumberTable:
    """Every non-blank line from index `start` on, as `width` numbers.

    `separator` None means any white space. Further cells must be empty. A row, other than the last, may lack its last
    cells if their count is a multiple of `short_step` (0: never): some writers drop trailing empty cells.
    """
    values = array("d")
    where: list[int] = []
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
                    f"found {len(cells)} cells; {width} are allowed", source=source, field=f"line {index + 1}"
                )
            missing = width - len(cells)
            if missing > 0:
                if not short_step or missing % short_step or len(cells) < 2 or index == last:
                    tail = " (file cut short?)" if index == last else ""
                    raise InputError(
                        f"found {len(cells)} cells{tail}; {width} are needed", source=source, field=f"line {index + 1}"
                    )
                cells = cells + [""] * missing
                filled += 1
            cells = cells[:width]
        values.extend(_numbers(cells, line, source, index))
        where.append(index + 1)
    table = np.array(values, dtype=np.float64).reshape(-1, width)
    infinite = np.argwhere(np.isinf(table))
    if len(infinite):
        row, column = (int(i) for i in infinite[0])
        raise InputError("found an infinite number", source=source, field=f"line {where[row]}, column {column + 1}")
    return NumberTable(table, tuple(where), filled)


def _numbers(cells: list[str], line: str, source: Path, index: int) -> list[float]:
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
            ) from None
    return numbers
