"""Rows of the CSV files of a known truth: a header and cells; what follows a `#` in a line is a comment."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gaitcal.arrays import Array
from gaitcal.codes import Code
from gaitcal.errors import InputError
from gaitcal.io.text_file import parse_number


@dataclass(frozen=True)
class TruthRows:
    """A header and the lines of text below it, each of as many cells at most."""

    names: tuple[str, ...]
    lines: tuple[str, ...]

    def cells(self) -> list[list[str]]:
        """The cells of each row; those that a row lacks are empty."""
        rows = list(csv.reader(self.lines))
        return [row + [""] * (len(self.names) - len(row)) for row in rows]

    def numbers(self, names: Sequence[str]) -> Array:
        """(rows, names) of the columns `names`; NaN where there is no number."""
        places = [self.names.index(name) for name in names]
        if not self.lines or not places:
            return np.empty((len(self.lines), len(places)))
        try:
            return np.loadtxt(self.lines, delimiter=",", usecols=places, ndmin=2, comments=None)
        except ValueError:  # an empty cell, quotation marks, or a real fault
            return np.array([[number(row[place]) for place in places] for row in self.cells()])


def number(cell: str) -> float:
    """A cell as a number; NaN where it is none."""
    try:
        return parse_number(cell)
    except ValueError:
        return float("nan")


def read_rows(path: Path) -> TruthRows:
    """The rows of a file; InputError where it is no table."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, ValueError) as error:
        raise _unreadable(path, str(error)) from None
    lines = [part for line in text.splitlines() if (part := line.split("#", 1)[0]).strip()]
    if not lines:
        raise _unreadable(path, "found no header")
    names = tuple(next(csv.reader(lines[:1])))
    if twice := [name for name in names if names.count(name) > 1]:
        raise _unreadable(path, f"found the column {twice[0]} twice")
    for k, line in enumerate(lines[1:], start=1):
        if line.count(",") >= len(names) and (count := len(next(csv.reader([line])))) > len(names):
            raise _unreadable(path, f"found {count} cells in row {k}, below {len(names)} names")
    return TruthRows(names, tuple(lines[1:]))


def _unreadable(path: Path, why: str) -> InputError:
    return InputError(f"cannot be read as CSV: {why}", source=path, code=Code.TRUTH)
