"""Write and read CSV and JSON files of a result; comment lines above a CSV header give the verdict
of its numbers.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from gaitcal.analysis.result import TrialResult
from gaitcal.gait import moments
from gaitcal.io.text_file import format_number_cells

if TYPE_CHECKING:
    import pandas as pd  # loaded by who asks for a data frame: it takes a third of a second

Column: TypeAlias = (
    NDArray[Any] | list[Any]
)  # Values of one column; None or NaN where there is none
Table: TypeAlias = "Mapping[str, Column] | pd.DataFrame"  # Columns by name, or a data frame
_BLOCK: Final = 50_000  # Rows that are text in memory at once
_QUOTE: Final = '"'
_SPECIAL: Final = (",", _QUOTE, "\n", "\r", "#")
VERDICT: Final = "verdict: "
"""How comment lines begin that tell it, of one trial or of one among several (`walk: verdict:
...`).
"""
REFUSED_HEADER: Final = (
    f"{VERDICT}refused; these numbers are not to be used, summary.json has the reasons",
)
"""Comment line of the tables of a trial that is refused."""
REFUSED_LEG_HEADER: Final = (
    VERDICT
    + "the {leg} leg is refused; its numbers are not to be used, summary.json has the reasons"
)
"""The same of one leg."""


def refused_lines(trial: TrialResult) -> tuple[str, ...]:
    """What the verdict says of the numbers of a trial; empty where they count."""
    if trial.is_refused:
        return REFUSED_HEADER
    return tuple(
        REFUSED_LEG_HEADER.format(leg=moments.SIDE_WORDS[side]) for side in trial.refused_legs
    )


def write_csv(table: Table, path: Path, comments: Iterable[str] = ()) -> None:
    """Write a table below comment lines; columns by name, or a data frame.

    Cells are those of `DataFrame.to_csv`, small numbers (`1e-5`) with shorter exponents; text with
    a `#` stands in quotation marks, within which readers that take `#` for the start of a comment
    leave it alone.
    """
    if isinstance(table, Mapping):
        names, columns = list(table), list(table.values())
    else:
        names, columns = (
            list(table.columns),
            [_plain(table.iloc[:, k]) for k in range(len(table.columns))],
        )
    rows = len(columns[0]) if columns else 0
    with path.open("w", encoding="utf-8", newline="") as stream:
        stream.writelines(f"# {line}\n" for line in comments)
        stream.write(",".join(map(_cell, names)) + "\n")
        for start in range(0, rows, _BLOCK):
            cells = [_cells(column[start : start + _BLOCK]) for column in columns]
            stream.writelines(",".join(row) + "\n" for row in zip(*cells, strict=True))


def columns_of(rows: Sequence[Mapping[str, object]]) -> dict[str, list[Any]]:
    """Rows with the same names as columns by name."""
    return {name: [row[name] for row in rows] for name in rows[0]} if rows else {}


def _plain(column: pd.Series) -> Column:
    """A column of a data frame without pandas; None where there is no value, but for NaN among
    numbers.
    """
    if isinstance(column.dtype, np.dtype) and column.dtype.kind in "iuf":
        return np.asarray(column)
    return column.astype(object).where(column.notna(), None).tolist()


def _cells(column: Column) -> list[str]:
    """Numbers in the shortest form that reads back the same, and text; empty where there is no
    value.
    """
    if isinstance(column, np.ndarray) and column.dtype.kind in "iuf":
        return format_number_cells(column)
    text_of = {
        value: "" if value is None or value != value else _cell(value) for value in set(column)
    }
    return [text_of[value] for value in column]  # text repeats itself: each is looked at once


def _cell(value: object) -> str:
    """Text in quotation marks where it holds what would end a cell, or begin a comment."""
    text = str(value)
    return (
        f'"{text.replace(_QUOTE, 2 * _QUOTE)}"' if any(sign in text for sign in _SPECIAL) else text
    )


def read_csv(path: Path) -> tuple[pd.DataFrame, tuple[str, ...]]:
    """A table as the text that it was written as, and its comment lines."""
    import pandas as pd

    comments = []
    with path.open(encoding="utf-8", newline="") as stream:
        while (line := stream.readline()).startswith("# "):
            comments.append(line.removeprefix("# ").rstrip("\n"))
    table = pd.read_csv(
        path, skiprows=len(comments), dtype=str, keep_default_na=False, encoding="utf-8"
    )
    return table, tuple(comments)


Json: TypeAlias = "bool | int | float | str | list[Json] | dict[str, Json] | None"


def json_text(content: Json) -> str:
    """The text of a JSON file, as results have it."""
    return json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
