"""Write and read CSV and JSON files of a result.

Comment lines above a CSV header give the verdict on its numbers.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from gaitcal.analysis.result import TrialResult
from gaitcal.errors import Code, InputError
from gaitcal.gait import moments
from gaitcal.io.text_file import format_number_cells

if TYPE_CHECKING:
    import pandas as pd  # loaded by who asks for a data frame: it takes a third of a second

Column: TypeAlias = (
    NDArray[Any] | list[Any]
)  # Values of one column; None or NaN where there is none
Content = TypeVar("Content")
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


def format_refused_lines(trial: TrialResult) -> tuple[str, ...]:
    """Format the comment lines on the refused numbers of a trial.

    Parameters
    ----------
    trial
        A trial.

    Returns
    -------
    tuple of str
        Empty if nothing is refused.
    """
    if trial.is_refused:
        return REFUSED_HEADER
    return tuple(
        REFUSED_LEG_HEADER.format(leg=moments.SIDE_WORDS[side]) for side in trial.refused_legs
    )


def write_csv(table: Table, path: Path, comments: Iterable[str] = ()) -> None:
    """Write a table below comment lines.

    Cells are those of `DataFrame.to_csv`, with shorter exponents of small numbers (`1e-5`). Text
    that contains `#` is quoted, so that readers do not take it for a comment.

    Parameters
    ----------
    table
        Columns by name, or a data frame.
    path
        The file.
    comments
        Lines, written with `# ` in front.
    """
    if isinstance(table, Mapping):
        names, columns = list(table), list(table.values())
    else:
        names, columns = (
            list(table.columns),
            [_convert_column(table.iloc[:, k]) for k in range(len(table.columns))],
        )
    rows = len(columns[0]) if columns else 0
    with path.open("w", encoding="utf-8", newline="") as stream:
        stream.writelines(f"# {line}\n" for line in comments)
        stream.write(",".join(map(_format_cell, names)) + "\n")
        # Block by block: the text of a long table would need much memory at once.
        for start in range(0, rows, _BLOCK):
            cells = [_format_cells(column[start : start + _BLOCK]) for column in columns]
            stream.writelines(",".join(row) + "\n" for row in zip(*cells, strict=True))


def convert_to_columns(rows: Sequence[Mapping[str, object]]) -> dict[str, list[Any]]:
    """Convert rows with the same names to columns.

    Parameters
    ----------
    rows
        Name -> value.

    Returns
    -------
    dict
        Name -> values; empty without rows.
    """
    columns: dict[str, list[Any]] = {}
    for row in rows:
        for name in rows[0]:
            columns.setdefault(name, []).append(row[name])
    return columns


def _convert_column(column: pd.Series) -> Column:
    """Convert a column of a data frame; missing values become None, except NaN among numbers."""
    if isinstance(column.dtype, np.dtype) and column.dtype.kind in "iuf":
        return np.asarray(column)
    return column.astype(object).where(column.notna(), None).tolist()


def _format_cells(column: Column) -> list[str]:
    """Format numbers in the shortest exact form, and text; missing values are empty."""
    if isinstance(column, np.ndarray) and column.dtype.kind in "iuf":
        return format_number_cells(column)
    text_of = {
        value: "" if value is None or value != value else _format_cell(value)
        for value in set(column)
    }
    return [text_of[value] for value in column]  # text repeats itself: each is looked at once


def _format_cell(value: object) -> str:
    """Format text, quoted if it contains a separator or a comment sign."""
    text = str(value)
    return (
        f'"{text.replace(_QUOTE, 2 * _QUOTE)}"' if any(sign in text for sign in _SPECIAL) else text
    )


def read_csv(path: Path) -> tuple[pd.DataFrame, tuple[str, ...]]:
    """Read a table as text, with its comment lines.

    Parameters
    ----------
    path
        The file.

    Returns
    -------
    pandas.DataFrame
        All cells are text.
    tuple of str
        Comment lines without `# `.
    """
    import pandas as pd

    comments = []
    with path.open(encoding="utf-8", newline="") as stream:
        while (line := stream.readline()).startswith("# "):
            comments.append(line.removeprefix("# ").rstrip("\n"))
    table = pd.read_csv(
        path, skiprows=len(comments), dtype=str, keep_default_na=False, encoding="utf-8"
    )
    return table, tuple(comments)


def read_rows(
    path: Path, columns: Sequence[str], parse: Callable[[Iterable[Mapping[str, str]]], Content]
) -> Content:
    """Read a table of a result row by row.

    Parameters
    ----------
    path
        The file.
    columns
        Those that it must have.
    parse
        Called with column -> text of each row; raises KeyError or ValueError for a wrong cell.

    Returns
    -------
    Content
        What `parse` returns.

    Raises
    ------
    InputError
        The file is missing or damaged.
    """
    try:
        return parse(read_csv(path)[0][[*columns]].to_dict("records"))
    except (OSError, UnicodeError, ValueError, KeyError) as error:
        message = f"cannot be read: {error}; calibrate again"
        raise InputError(message, source=path, code=Code.DAMAGED_RESULT) from None


Json: TypeAlias = "bool | int | float | str | list[Json] | dict[str, Json] | None"


def format_json(content: Json) -> str:
    """Format the text of a JSON file of a result.

    Parameters
    ----------
    content
        Plain data; no NaN.

    Returns
    -------
    str
        With a line break at the end.
    """
    return json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
