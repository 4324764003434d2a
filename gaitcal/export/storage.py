"""Tables as OpenSim's Storage reads them (`.mot`, `.sto`): a header, `endheader`, column names, rows; tab separated.

Storage stops reading at the first NaN, without a word; so a row that holds one is left out, and the header says so.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gaitcal.atomic import atomic_text
from gaitcal.errors import InputError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class StorageTable:
    """What stands in one file."""

    title: str
    """First line."""
    comments: tuple[str, ...]
    """Free lines of the header; a line that would end the header or be taken for an entry is made harmless."""
    in_degrees: bool
    names: tuple[str, ...]
    """Of the columns, `time` left out."""
    time: Array
    """(nf,) s."""
    values: Array
    """(nf, len(names))."""


def write_storage(path: Path | str, table: StorageTable) -> None:
    """Write a table, every number in the shortest form that reads back to the same bits, rows with NaN left out.

    Raises
    ------
    InputError
        Time does not increase or shapes do not agree.
    """
    nf, columns = len(table.time), len(table.names)
    if table.values.shape != (nf, columns):
        raise InputError(f"found values of shape {table.values.shape}, expected {(nf, columns)}", source=path)
    if not (np.isfinite(table.time).all() and (np.diff(table.time) > 0).all()):
        raise InputError("must be finite and increase from row to row", source=path, field="time")
    known = np.isfinite(table.values).all(axis=1)
    missing = nf - int(known.sum())
    left_out = (f"{missing} of {nf} rows are left out: they hold no value.",) if missing else ()
    header = [
        _one_line(table.title),
        "version=1",
        f"nRows={nf - missing}",
        f"nColumns={columns + 1}",
        f"inDegrees={'yes' if table.in_degrees else 'no'}",
        *(_one_line(comment) for comment in (*table.comments, *left_out)),
        "endheader",
        "\t".join(("time", *table.names)),
    ]
    kept = np.column_stack([table.time, table.values])[known]
    rows = ["\t".join(map(repr, row)) for row in kept.tolist()]
    atomic_text(path, "\n".join([*header, *rows]) + "\n")


def _one_line(text: str) -> str:
    return " ".join(text.split()).replace("=", ":").replace("endheader", "end of header") or "gaitcal"
