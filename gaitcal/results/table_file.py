"""CSV files of a result: comment lines above the header, first of them what the verdict says of the numbers."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from gaitcal.gait.words import SIDE_WORDS
from gaitcal.person.result import TrialResult

_BLOCK: Final = 50_000
"""Rows that are text in memory at once."""
_QUOTE: Final = '"'
_SPECIAL: Final = (",", _QUOTE, "\n", "\r", "#")
VERDICT: Final = "verdict: "
"""How comment lines begin that tell it, of one trial or of one among several (`walk: verdict: ...`)."""
REFUSED_HEADER: Final = (f"{VERDICT}refused; these numbers are not to be used, summary.json has the reasons",)
"""Comment line of the tables of a trial that is refused."""
REFUSED_LEG_HEADER: Final = (
    VERDICT + "the {leg} leg is refused; its numbers are not to be used, summary.json has the reasons"
)
"""The same of one leg."""


def refused_lines(trial: TrialResult) -> tuple[str, ...]:
    """What the verdict says of the numbers of a trial; empty where they count."""
    if trial.is_refused:
        return REFUSED_HEADER
    return tuple(REFUSED_LEG_HEADER.format(leg=SIDE_WORDS[side]) for side in trial.refused_legs)


def write_csv(table: pd.DataFrame, path: Path, comments: Iterable[str] = ()) -> None:
    """Write a table below comment lines.

    Cells are those of `DataFrame.to_csv`, in a fraction of its time; text with a `#` stands in quotation marks, within
    which readers that take `#` for the start of a comment leave it alone.
    """
    with path.open("w", encoding="utf-8", newline="") as stream:
        stream.writelines(f"# {line}\n" for line in comments)
        stream.write(",".join(map(_cell, table.columns)) + "\n")
        for start in range(0, len(table), _BLOCK):
            part = table.iloc[start : start + _BLOCK]
            columns = [_cells(part.iloc[:, k]) for k in range(len(table.columns))]
            stream.writelines(",".join(row) + "\n" for row in zip(*columns, strict=True))


def _cells(column: pd.Series) -> list[str]:
    """A column as text; empty where there is no value."""
    kind = column.dtype.kind if isinstance(column.dtype, np.dtype) else ""
    if kind and kind in "iu":
        return list(map(str, column.tolist()))
    if kind == "f":
        text = list(map(repr, column.tolist()))
        for k in np.flatnonzero(column.isna()):
            text[k] = ""
        return text
    if isinstance(column.dtype, pd.StringDtype) or pd.api.types.infer_dtype(column, skipna=False) == "string":
        codes, known = pd.factorize(column)  # text repeats itself: each is looked at once
        told = np.array([*map(_cell, known), ""], dtype=object)  # the last: of what is missing, whose code is -1
        return list(told[codes])
    return ["" if pd.isna(value) else _cell(value) for value in column.tolist()]


def _cell(value: object) -> str:
    """Text in quotation marks where it holds what would end a cell, or begin a comment."""
    text = str(value)
    return f'"{text.replace(_QUOTE, 2 * _QUOTE)}"' if any(sign in text for sign in _SPECIAL) else text


def read_csv(path: Path) -> tuple[pd.DataFrame, tuple[str, ...]]:
    """A table as the text that it was written as, and its comment lines."""
    comments = []
    with path.open(encoding="utf-8", newline="") as stream:
        while (line := stream.readline()).startswith("# "):
            comments.append(line.removeprefix("# ").rstrip("\n"))
    table = pd.read_csv(path, skiprows=len(comments), dtype=str, keep_default_na=False, encoding="utf-8")
    return table, tuple(comments)
