"""The table of strides in long form: its columns, and one that came from a file made whole, with numbers for text."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from gaitcal.codes import Code
from gaitcal.errors import InputError
from gaitcal.gait.variables import unit_of

if TYPE_CHECKING:
    import pandas as pd  # loaded by who asks for a data frame: it takes a third of a second

CYCLE_COLUMNS: Final = (
    *("person", "session", "trial", "side", "stride", "percent", "variable", "value", "se", "valid", "se_stride"),
    "turn",
)
TOLD: Final = ("unit", "positive")
"""Further columns of a table in another convention (`gaitcal export --format cycles`): they say which."""
_NAMES: Final = ("person", "session")
_LACKING: Final = ("se", "se_stride", "turn")
"""Numbers that a table or a stride may lack."""
_WHOLE: Final = ("stride", "percent", "valid")
_NEEDED: Final = tuple(name for name in CYCLE_COLUMNS if name not in (*_NAMES, *_LACKING))
"""Columns without which there is no stride."""


def typed(table: pd.DataFrame, source: object = None) -> pd.DataFrame:
    """A table of strides, which may hold text or be read by pandas alone, made whole.

    Numbers stand where numbers belong; a person or session that is not named is empty text, an error or a turn that the
    table lacks is NaN. Columns: `CYCLE_COLUMNS`, then what else there is.

    Raises
    ------
    InputError
        A column is missing, or holds something else than numbers. `source`: what the message says it is of.
    """
    missing = [name for name in _NEEDED if name not in table]
    if missing:
        found = ", ".join(map(str, table.columns[: len(CYCLE_COLUMNS)]))
        raise InputError(
            f"is no table of strides: found the columns {found}, without {', '.join(missing)}; allowed: those of "
            "cycles.csv, with commas between them",
            source=source,
            code=Code.STRIDE_TABLE,
        )
    numbers = {name: _number(table, name, source) for name in ("value", *_LACKING) if name in table}
    for name in _WHOLE:
        values = _number(table, name, source)
        if not np.isfinite(values).all():
            at = int(np.flatnonzero(~np.isfinite(values))[0]) + 1
            raise InputError(
                f"found nothing in row {at}; allowed: a whole number (a line that is read as if it ended at a # in a "
                "name loses them: gaitcal.read_cycles reads it whole)",
                source=source,
                field=name,
                code=Code.STRIDE_TABLE,
            )
        numbers[name] = values.astype(int)
    names = {name: table[name].where(table[name].notna(), "") if name in table else "" for name in _NAMES}
    unknown = {name: np.nan for name in _LACKING if name not in table}
    whole = table.assign(**names, **numbers, **unknown)
    return whole[[*CYCLE_COLUMNS, *(name for name in table.columns if name not in CYCLE_COLUMNS)]]


def _number(table: pd.DataFrame, name: str, source: object) -> pd.Series:
    import pandas as pd

    text = table[name]
    if pd.api.types.is_numeric_dtype(text):
        return text.astype(np.float64)
    numbers = pd.to_numeric(text, errors="coerce").astype(np.float64)
    wrong = np.flatnonzero(numbers.isna() & text.notna() & (text.astype(str).str.strip() != ""))
    if len(wrong) and (said := str(text.iloc[wrong[0]])).lower() != "nan":
        raise InputError(
            f"found '{said}' in row {wrong[0] + 1}; allowed: a number",
            source=source,
            field=name,
            code=Code.STRIDE_TABLE,
        )
    return numbers


def conventions_of(strides: pd.DataFrame) -> dict[str, tuple[str, str]]:
    """Variable -> its unit and what is positive (nothing where the table does not say it: as in `cycles.csv`).

    Raises
    ------
    InputError
        A variable is there in two conventions.
    """
    if not any(name in strides for name in TOLD):
        return {str(name): (unit_of(str(name)), "") for name in strides["variable"].unique()}
    told = strides.reindex(columns=["variable", *TOLD]).fillna("").drop_duplicates()
    out: dict[str, tuple[str, str]] = {}
    for variable, unit, positive in told.itertuples(index=False, name=None):
        own = (unit or unit_of(variable), positive)
        before = out.setdefault(variable, own)
        if before != own:
            ways = " and as ".join(" ".join(filter(None, (f"[{u}]", p))) for u, p in (before, own))
            raise InputError(
                f"found {variable} as {ways}; allowed: one convention", field="strides", code=Code.STRIDE_TABLE
            )
    return out
