"""Files of result folders and the columns of their tables, as `gaitcal/results/described.py` tells them."""

from __future__ import annotations

from gaitcal.cohort.row import COLUMNS
from gaitcal.results.described import FILES, SUMMARY, TABLES


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


def files_markdown(kind: str) -> str:
    """A table of the files of a kind of folder; tables among them lead to their columns."""
    lines = ["| file | holds |", "|---|---|"]
    for file in FILES[kind]:
        name = f"`{file.pattern.replace('*', 'NAME')}`"
        where = "result-files.md#summaryjson" if file.table == "summary" else f"columns.md#{file.table}"
        lines.append(f"| {f'[{name}]({where})' if file.table else name} | {_cell(file.text)} |")
    return "\n".join(lines)


def columns_markdown(table: str) -> str:
    """A table of columns: of one table, of `summary.json`, or of `people` with all its measures."""
    if table == "summary":
        rows = [(f"`{name}`", "", text) for name, text in SUMMARY.items()]
    elif table == "people":
        rows = [(f"`{c.name}`", c.unit, c.meaning) for c in COLUMNS]
    else:
        rows = [(f"`{c.name.replace('*', 'NAME')}`", c.unit, c.text) for c in TABLES[table]]
    head = ["| key | | meaning |" if table == "summary" else "| column | unit | meaning |", "|---|---|---|"]
    return "\n".join([*head, *(f"| {name} | {_cell(unit)} | {_cell(text)} |" for name, unit, text in rows)])
