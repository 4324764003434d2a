"""CSV files of a result: comment lines above the header, first of them what the verdict says of the numbers."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Final

import pandas as pd

from gaitcal.gait.words import SIDE_WORDS
from gaitcal.person.result import TrialResult

REFUSED_HEADER: Final = ("verdict: refused; these numbers are not to be used, summary.json has the reasons",)
"""Comment line of the tables of a trial that is refused."""
REFUSED_LEG_HEADER: Final = (
    "verdict: the {leg} leg is refused; its numbers are not to be used, summary.json has the reasons"
)
"""The same of one leg."""


def refused_lines(trial: TrialResult) -> tuple[str, ...]:
    """What the verdict says of the numbers of a trial; empty where they count."""
    if trial.is_refused:
        return REFUSED_HEADER
    return tuple(REFUSED_LEG_HEADER.format(leg=SIDE_WORDS[side]) for side in trial.refused_legs)


def write_csv(table: pd.DataFrame, path: Path, comments: Iterable[str] = ()) -> None:
    """Write a table below comment lines."""
    with path.open("w", encoding="utf-8", newline="") as stream:
        stream.writelines(f"# {line}\n" for line in comments)
        table.to_csv(stream, index=False, lineterminator="\n")


def read_csv(path: Path) -> tuple[pd.DataFrame, tuple[str, ...]]:
    """A table as the text that it was written as, and its comment lines."""
    comments = []
    with path.open(encoding="utf-8", newline="") as stream:
        while (line := stream.readline()).startswith("# "):
            comments.append(line.removeprefix("# ").rstrip("\n"))
    table = pd.read_csv(path, skiprows=len(comments), dtype=str, keep_default_na=False, encoding="utf-8")
    return table, tuple(comments)
