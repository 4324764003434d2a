"""Rows of `tables.csv` and `claims.csv`.

A figure over noise seeds: median and range, and where the published figure lies.

The published study drew its noise once. One draw can only be compared with the range of draws.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum

import numpy as np
import pandas as pd

TABLE_COLUMNS = ("table", "row", "column", "published", "ours", "unit", "note")
CLAIM_COLUMNS = ("claim", "published", "ours", "verdict")
DIGITS = 6
"""Significant digits in the files."""

EXPERIMENT = "needs the unpublished experimental trial; cannot be reproduced"


@dataclass(frozen=True)
class TableRow:
    """One published figure, and ours."""

    table: str
    row: str
    column: str
    published: float | None
    ours: float | None
    unit: str
    note: str = ""


class Verdict(Enum):
    """What became of a claim."""

    HOLDS = "holds"
    FAILS = "does not hold"
    NOT_RUN = "not run"
    NOT_TESTABLE = "not testable"


@dataclass(frozen=True)
class Claim:
    """A claim of the paper, put to the test."""

    claim: str
    published: str
    ours: str
    verdict: Verdict


def verdict(holds: bool) -> Verdict:
    """Of a claim that was tested."""
    return Verdict.HOLDS if holds else Verdict.FAILS


def spread_row(
    table: str, row: str, column: str, published: float | None, ours: Spread, unit: str, note: str = ""
) -> TableRow:
    """A figure that depends on the noise: the median, with range and place of the published figure in the note."""
    told = ours.told(published)
    return TableRow(table, row, column, published, ours.median, unit, f"{told}; {note}" if note else told)


def experiment_row(table: str, row: str, column: str, published: float, unit: str, note: str = "") -> TableRow:
    """A figure that only the unpublished trial could give."""
    return TableRow(table, row, column, published, None, unit, f"{EXPERIMENT}; {note}" if note else EXPERIMENT)


def table_frame(rows: Iterable[TableRow]) -> pd.DataFrame:
    """`tables.csv`: a figure that does not exist is empty."""
    values = [(r.table, r.row, r.column, _number(r.published), _number(r.ours), r.unit, r.note) for r in rows]
    return pd.DataFrame(values, columns=list(TABLE_COLUMNS))


def claim_frame(claims: Iterable[Claim]) -> pd.DataFrame:
    """`claims.csv`."""
    return pd.DataFrame([(c.claim, c.published, c.ours, c.verdict.value) for c in claims], columns=list(CLAIM_COLUMNS))


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.{DIGITS}g}"


@dataclass(frozen=True)
class Spread:
    """A figure over the draws of the noise."""

    median: float
    low: float
    high: float
    draws: int

    def place(self, published: float) -> str:
        """`inside`, `below` or `above` the range."""
        if published < self.low:
            return "below"
        return "above" if published > self.high else "inside"

    def told(self, published: float | None = None) -> str:
        """In words, for the note of a row."""
        words = f"median of {self.draws} noise draws, range {self.low:.3g} to {self.high:.3g}"
        return words if published is None else f"{words}; published value {self.place(published)} the range"


def spread(values: Iterable[float]) -> Spread:
    """Median and range of at least one figure."""
    array = np.array(list(values), dtype=float)
    return Spread(float(np.median(array)), float(array.min()), float(array.max()), len(array))
