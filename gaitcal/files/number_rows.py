"""Rows of a text table: every float as `repr` writes it, the shortest digits that read back to the same bits.

The digits come from pydantic's writer of JSON, in a seventh of the time of `repr`: a table is written as JSON, whose
brackets and quotation marks are then taken off. JSON has the same digits, but may place the point elsewhere where
`repr` counts powers of ten; such numbers, and those that JSON does not have, are told by `repr` itself.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from pydantic_core import to_json

_SMALLEST, _LARGEST = 1e-4, 1e15
"""Between them `repr` writes no power of ten, nor does any JSON (`repr` itself: up to 1e16)."""
_AS_IT_IS: Final = re.compile(r'[^\x00-\x1f\\",\[\]]*')
"""Text that JSON leaves as it is, and in which nothing looks like the ends of cells and rows."""


def number_cells(values: NDArray[Any], missing: str = "") -> list[Any]:
    """Numbers of any shape as (nested) lists of cells for `rows_text`; `missing`: the text that stands for NaN."""
    if values.dtype.kind in "iu":
        return values.tolist()  # type: ignore[no-any-return]
    values = np.asarray(values, dtype=np.float64)
    size = np.abs(values)
    odd = ~(((size >= _SMALLEST) & (size < _LARGEST)) | (size == 0.0))
    if not odd.any():
        return values.tolist()  # type: ignore[no-any-return]
    out = values.astype(object)
    out[odd] = [repr(v) if v == v else missing for v in values[odd].tolist()]
    return out.tolist()  # type: ignore[no-any-return]


def rows_text(rows: Sequence[Sequence[Any]], separator: str) -> str:
    """Rows of at least one cell each, numbers from `number_cells` or text, each ended by a line feed."""
    if not rows:
        return ""
    text = "\n".join(to_json(rows).decode()[2:-2].replace('"', "").split("],["))
    return (text if separator == "," else text.replace(",", separator)) + "\n"


def is_plain(text: str) -> bool:
    """Whether text may be a cell of `rows_text`; a table that holds any other is to be joined cell by cell."""
    return _AS_IT_IS.fullmatch(text) is not None
