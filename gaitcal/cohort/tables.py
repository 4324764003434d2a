"""The tables of a cohort, made of what is kept of every person, one at a time, in the order of names and sessions.

The same people give the same bytes, in whatever order, on whatever machine and in however many runs they were computed;
what differs (seconds, memory) is in `times.csv` alone.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from gaitcal.cohort.columns import COLUMNS, NAMES
from gaitcal.cohort.one_person import CommonSettings
from gaitcal.cohort.outcome import Cell, Outcome, Outcomes, state_file
from gaitcal.cohort.page import PAGE, write_page
from gaitcal.cohort.people import CohortPerson
from gaitcal.cohort.task import COMPRESSION, STRIDES
from gaitcal.io.result_folder import FILES, HASHES, MANIFEST, SELF, ResultKind, amended, self_hash, sha256_of
from gaitcal.io.toml import package_version

PEOPLE_CSV, PEOPLE_PARQUET, CYCLES = "people.csv", "people.parquet", "cycles.parquet"
FAILURES, TIMES, MEANINGS = "failures.csv", "times.csv", "columns.csv"
FAILURE_COLUMNS = ("person", "session", "group", "folder", "code", "cause", "what_to_do")
TIME_COLUMNS = ("person", "session", "seconds", "worker_mebibytes")
ROWS = 64
"""People in a row group of `people.parquet`: what is held in memory."""
_ARROW = {str: pa.string(), int: pa.int64(), float: pa.float64()}
_GROUPED = STRIDES.insert(STRIDES.get_field_index("session") + 1, pa.field("group", pa.string()))


@dataclass(frozen=True)
class Written:
    """What the tables are of."""

    verdicts: Mapping[str, int]
    """`trustworthy`, `doubtful`, `refused`, `failed` -> people."""


def write_tables(people: Sequence[CohortPerson], source: Path, ended: Outcomes, common: CommonSettings) -> Written:
    """Write all tables of a cohort into its folder, together. `source`: where the people's folders are."""
    verdicts: dict[str, int] = {}
    out = ended.out
    with amended(out) as stage:
        with ExitStack() as stack:
            writers = _Writers(stage, stack)
            for person in people:
                outcome = ended.of(person)
                verdicts[outcome.verdict] = verdicts.get(outcome.verdict, 0) + 1
                writers.add(person, outcome, _seen_from(source, person.folder), out)
            writers.flush()
        _write_meanings(stage / MEANINGS)
        written = {"people": stage / PEOPLE_PARQUET, "failures": stage / FAILURES}
        write_page(stage / PAGE, written, people, ended, common)
        (stage / MANIFEST).write_text(_manifest(people, common, stage), encoding="utf-8")
    return Written(verdicts)


def mark(out: Path) -> None:
    """Mark a folder as a cohort's, before anything is in it."""
    if not (out / MANIFEST).is_file():
        with amended(out) as stage:
            (stage / MANIFEST).write_text(_text({"kind": ResultKind.COHORT.value}), encoding="utf-8")


def _text(content: Mapping[str, object]) -> str:
    made = {"gaitcal": package_version("gaitcal"), **content}
    return json.dumps({**made, SELF: self_hash(made)}, indent=1, ensure_ascii=False) + "\n"


def _manifest(people: Sequence[CohortPerson], common: CommonSettings, stage: Path) -> str:
    names = sorted(path.name for path in stage.iterdir() if path.name != TIMES)
    settings: dict[str, object] = json.loads(common.calibration.model_dump_json(exclude_unset=True))
    if common.normal is not None:
        settings |= {"normal": common.normal.name, "normal_sha256": sha256_of(common.normal)}
    if common.priors is not None:
        settings |= {"priors": common.priors.name, "priors_sha256": sha256_of(common.priors)}
    return _text(
        {
            "kind": ResultKind.COHORT.value,
            "people": len({person.name for person in people}),
            "sessions": len(people),
            "settings": settings,
            FILES: sorted([*names, TIMES]),
            HASHES: {name: sha256_of(stage / name) for name in names},
        }
    )


def _seen_from(source: Path, folder: Path) -> str:
    """A person's own folder, from that of the cohort where it lies below it, else by its name."""
    try:
        return folder.relative_to(source.resolve()).as_posix()
    except ValueError:
        return folder.name


class _Writers:
    """The open tables: rows go in one by one."""

    def __init__(self, stage: Path, stack: ExitStack) -> None:
        self._people = _csv(stack, stage / PEOPLE_CSV, NAMES)
        self._failures = _csv(stack, stage / FAILURES, FAILURE_COLUMNS)
        self._times = _csv(stack, stage / TIMES, TIME_COLUMNS)
        schema = pa.schema([(column.name, _ARROW[column.kind]) for column in COLUMNS])
        self._rows = stack.enter_context(pq.ParquetWriter(stage / PEOPLE_PARQUET, schema, compression=COMPRESSION))
        self._strides = stack.enter_context(pq.ParquetWriter(stage / CYCLES, _GROUPED, compression=COMPRESSION))
        self._waiting: list[Mapping[str, Cell]] = []
        self._schema = schema

    def add(self, person: CohortPerson, outcome: Outcome, folder: str, out: Path) -> None:
        """Write what is kept of one person."""
        self._times.writerow((*person.key, outcome.seconds, outcome.mebibytes))
        if outcome.failed:
            self._failures.writerow((*person.key, person.group, folder, outcome.code, outcome.cause, outcome.action))
            return
        row = {**outcome.row, "group": person.group}
        self._people.writerow(["" if row.get(name) is None else row[name] for name in NAMES])
        self._waiting.append(row)
        if len(self._waiting) >= ROWS:
            self.flush()
        strides = pq.read_table(state_file(out, person.place, ".parquet"))
        group = pa.array([person.group] * len(strides), pa.string())
        strides = strides.add_column(_GROUPED.get_field_index("group"), "group", group)
        if len(strides):
            self._strides.write_table(strides.cast(_GROUPED), row_group_size=len(strides))

    def flush(self) -> None:
        """Write the rows that wait for a row group."""
        if self._waiting:
            columns = {c.name: [_as(c.kind, row.get(c.name)) for row in self._waiting] for c in COLUMNS}
            self._rows.write_table(pa.table(columns, schema=self._schema))
            self._waiting = []


def _as(kind: type, value: Cell) -> object:
    """A cell as its column has it: a number that is whole came as an integer from JSON."""
    return value if value is None else kind(value)


def _csv(stack: ExitStack, path: Path, names: Sequence[str]) -> Any:
    stream = stack.enter_context(path.open("w", encoding="utf-8", newline=""))
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(names)
    return writer


def _write_meanings(path: Path) -> None:
    with ExitStack() as stack:
        writer = _csv(stack, path, ("column", "unit", "meaning"))
        writer.writerows((column.name, column.unit, column.meaning) for column in COLUMNS)


def failures(out: Path) -> Iterator[dict[str, str]]:
    """The lines of `failures.csv`."""
    with (out / FAILURES).open(encoding="utf-8", newline="") as stream:
        yield from csv.DictReader(stream)
