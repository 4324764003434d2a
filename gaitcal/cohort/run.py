"""A cohort from its folder to its tables: everyone whose inputs or settings changed is calibrated, the others stay.

The tables of a cohort, made of what is kept of every person, one at a time, in the order of names and sessions.

The same people give the same bytes, in whatever order, on whatever machine and in however many runs they were computed;
what differs (seconds, memory) is in `times.csv` alone.
"""

from __future__ import annotations

import csv
import json
import shutil
import time
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import pyarrow as pa
import pyarrow.parquet as pq

from gaitcal.codes import Code
from gaitcal.cohort.one_person import CommonSettings
from gaitcal.cohort.outcome import (
    COMPRESSION,
    STATE,
    STRIDES,
    Cell,
    Outcome,
    Outcomes,
    Task,
    end_person,
    lost_person,
    state_file,
)
from gaitcal.cohort.page import PAGE, write_page
from gaitcal.cohort.people import Cohort, CohortPerson
from gaitcal.cohort.row import COLUMNS, NAMES
from gaitcal.errors import InputError
from gaitcal.io.atomic import amended, disk_errors, real_path
from gaitcal.io.lock import MANIFEST, UNFINISHED, ResultKind, locked, read_object
from gaitcal.io.snapshot import FILES, HASHES, SELF, self_hash, sha256_of
from gaitcal.io.toml import package_version
from gaitcal.published.workers import LocalProcesses

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


WAIT_S = 5.0
"""For another run on the same folder that is about to end."""
EACH = 25
"""People that a process calibrates before another takes its place."""
MOST_MIB = 1500.0
"""A process that once needed more keeps much of it: it makes room for another one."""


class Engine(Protocol):
    """Who computes: `LocalProcesses` of this machine, or a `Cluster`."""

    def run(
        self, function: Callable[[Task], Outcome], tasks: Iterator[Task], lost: Callable[[Task, str], Outcome]
    ) -> Iterator[Outcome]:
        """Yield what becomes of every task, in any order."""
        ...


@dataclass(frozen=True, kw_only=True)
class Ended:
    """One person has ended, and how far the cohort is."""

    outcome: Outcome
    done: int
    todo: int
    remaining_s: float | None
    """None until somebody was computed."""


def run_cohort(
    cohort: Cohort,
    out: Path,
    common: CommonSettings | None = None,
    *,
    engine: Engine | None = None,
    retry: bool = False,
    told: Callable[[Ended], None] = lambda ended: None,
) -> Written:
    """Calibrate everyone of a cohort into `out/people`, and write its tables.

    Parameters
    ----------
    cohort : of `people.people_in` or `cohort_file.read_cohort`.
    out : the folder of the cohort; what is there of an earlier run, and still holds, is kept.
    common : settings of everyone.
    engine : who computes; processes of this machine unless given.
    retry : try again who failed before though nothing changed.
    told : called whenever somebody has ended.

    Raises
    ------
    InputError
        `out` cannot be written, holds something else, or another run works in it.
    """
    out, common, engine = real_path(out), common or CommonSettings(), engine or processes()
    require_cohort(out)
    with alone(out):
        mark(out)
        for unfinished in (out / STATE).rglob(f"{UNFINISHED}*"):  # of workers that were killed
            shutil.rmtree(unfinished, ignore_errors=True)
        version = package_version("gaitcal")
        tasks = (Task(person=person, out=out, common=common, retry=retry, version=version) for person in cohort.people)
        began, done, computed = time.monotonic(), 0, 0
        failed: dict[tuple[str, str], Outcome] = {}
        with closing(_generator(engine.run(end_person, tasks, lost_person))) as outcomes:
            for outcome in outcomes:
                done, computed = done + 1, computed + outcome.computed
                if outcome.failed:
                    failed[outcome.key] = outcome
                left = len(cohort.people) - done
                remaining = left * (time.monotonic() - began) / computed if computed else None
                told(Ended(outcome=outcome, done=done, todo=len(cohort.people), remaining_s=remaining))
        return write_tables(cohort.people, cohort.source, Outcomes(out, failed), common)


def processes(jobs: int = -1) -> LocalProcesses:
    """Processes of this machine, -1: one for every core; whoever is unchanged costs them nothing.

    One is replaced after `EACH` people, or when it has grown over `MOST_MIB`.
    """
    return LocalProcesses(jobs, each=EACH, ages=_ages)


def _ages(outcome: Outcome) -> int:
    """As how many people one counts."""
    if not outcome.computed:
        return 0
    return EACH if outcome.mebibytes > MOST_MIB else 1


def _generator(outcomes: Iterator[Outcome]) -> Generator[Outcome, None, None]:
    """The same, to be closed where the run is interrupted: workers then end at once."""
    yield from outcomes


def require_cohort(out: Path) -> None:
    """InputError where a folder holds something else than a cohort's results."""
    if not out.exists():
        return
    if not out.is_dir():
        raise InputError("is a file; the output needs a folder", source=out, code=Code.FOLDER_TAKEN)
    names = sorted(p.name for p in out.iterdir() if not p.name.startswith("."))
    if names and read_object(out / MANIFEST).get("kind") != ResultKind.COHORT.value:
        raise InputError(
            f"holds '{names[0]}', and is no cohort; name a new or an empty folder", source=out, code=Code.FOLDER_TAKEN
        )


@contextmanager
def alone(out: Path) -> Iterator[None]:
    """No other run works on the same cohort meanwhile."""
    with ExitStack() as stack:
        with disk_errors(out):
            out.parent.mkdir(parents=True, exist_ok=True)
            stack.enter_context(locked(out, "cohort", wait_s=WAIT_S))
        yield
