"""Files of result folders and the columns of their tables, as `result_files.toml` beside this module tells them."""

from __future__ import annotations

from fnmatch import fnmatchcase
from pathlib import Path
from typing import Final, NamedTuple

from gaitcal.cohort.one_person import COLUMNS
from gaitcal.io.toml import tomllib
from scripts.tools.documentation.tables import table_of


class ResultFile(NamedTuple):
    """A file, or those of one name in each trial (`motion/*.csv`); `table`: key of `TABLES`, empty for what is none."""

    pattern: str
    text: str
    table: str = ""


class Described(NamedTuple):
    """One column, or those of one pattern."""

    name: str
    unit: str
    text: str


_READ = tomllib.loads(Path(__file__).with_name("result_files.toml").read_text(encoding="utf-8"))
FILES: Final = {kind: tuple(ResultFile(*row) for row in rows) for kind, rows in _READ["files"].items()}
"""Kind of folder -> its files."""
SUMMARY: Final[dict[str, str]] = _READ["summary"]
"""Keys of `summary.json`."""
TABLES: Final = {table: tuple(Described(*row) for row in rows) for table, rows in _READ["tables"].items()}
"""Key of a table -> its columns, in order."""


def file_of(kind: str, name: str) -> ResultFile | None:
    """What is said of a file (`motion/walk.csv`) of a kind of folder; None where nothing is."""
    return next((file for file in FILES[kind] if fnmatchcase(name, file.pattern)), None)


def column_of(table: str, name: str) -> Described | None:
    """What is said of a column; None where nothing is."""
    return next((column for column in TABLES[table] if fnmatchcase(name, column.name)), None)


def files_markdown(kind: str) -> str:
    """A table of the files of a kind of folder; tables among them lead to their columns."""

    def row(file: ResultFile) -> tuple[str, str]:
        name = f"`{file.pattern.replace('*', 'NAME')}`"
        where = "result-files.md#summaryjson" if file.table == "summary" else f"columns.md#{file.table}"
        return f"[{name}]({where})" if file.table else name, file.text

    return table_of(("file", "holds"), map(row, FILES[kind]))


def columns_markdown(table: str) -> str:
    """A table of columns: of one table, of `summary.json`, or of `people` with all its measures."""
    if table == "summary":
        return table_of(("key", "", "meaning"), ((f"`{name}`", "", text) for name, text in SUMMARY.items()))
    if table == "people":
        rows = [(f"`{c.name}`", c.unit, c.meaning) for c in COLUMNS]
    else:
        rows = [(f"`{c.name.replace('*', 'NAME')}`", c.unit, c.text) for c in TABLES[table]]
    return table_of(("column", "unit", "meaning"), rows)
