"""Run a cohort: calibrate everyone whose inputs or settings changed, and write the tables.

Tables are made from the stored outcomes, one person at a time, in the order of names and sessions.
The same people give the same bytes, in whatever order, on whatever machine and in however many runs
they were computed; only `times.csv` (seconds, memory) differs.
"""

import csv
import json
import shutil
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from gaitcal.cohort import outcome as outcome_files
from gaitcal.cohort.cohort_page import PAGE, write_page
from gaitcal.cohort.cohort_people import Cohort, CohortPerson
from gaitcal.cohort.one_person import COLUMNS, NAMES, Cell, CommonSettings, read_activity_peaks
from gaitcal.errors import Code, InputError
from gaitcal.gait.peaks import PEAK_COLUMNS
from gaitcal.io import atomic, result_folder, toml
from gaitcal.montecarlo.workers import LocalProcesses, Workers, lock_folder

PEOPLE_CSV, PEOPLE_PARQUET, CYCLES = "people.csv", "people.parquet", "cycles.parquet"
FAILURES, TIMES, MEANINGS, PEAKS = "failures.csv", "times.csv", "columns.csv", "activity_peaks.csv"
FAILURE_COLUMNS = ("person", "session", "group", "folder", "code", "cause", "what_to_do")
TIME_COLUMNS = ("person", "session", "seconds", "worker_mebibytes")
WAIT_S = 5.0
"""s, longest time to wait for another run on the same folder."""
EACH = 25
"""People that a process calibrates before it is replaced."""
MOST_MIB = 1500.0
"""MiB, memory of a process from which it is replaced, because it keeps much of it."""
ROWS = 64
"""People in a row group of `people.parquet`, which are in memory together."""
_ARROW = {str: pa.string(), int: pa.int64(), float: pa.float64()}
_GROUPED = outcome_files.STRIDES.insert(
    outcome_files.STRIDES.get_field_index("session") + 1, pa.field("group", pa.string())
)


def run_cohort(
    cohort: Cohort,
    out: Path,
    common: CommonSettings | None = None,
    *,
    engine: Workers | None = None,
    retry: bool = False,
    report: Callable[
        [outcome_files.Outcome, int, float | None], None
    ] = lambda outcome, done, remaining_s: None,
) -> Counter[str]:
    """Calibrate everyone of a cohort into `out/people`, and write its tables.

    Parameters
    ----------
    cohort : Cohort
        From `find_people` or `read_cohort`.
    out : Path
        The folder of the cohort; valid outcomes of an earlier run are kept.
    common : CommonSettings, optional
        Settings of everyone.
    engine : Workers, optional
        What computes; processes of this machine if not given.
    retry : bool
        Try failures again although nothing changed.
    report : callable
        Called when a person is done: outcome, number of people done, remaining seconds (None if
        no person was computed).

    Returns
    -------
    Counter
        `trustworthy`, `doubtful`, `refused`, `failed` -> people.

    Raises
    ------
    InputError
        `out` cannot be written, has other content, or another run works in it.
    """
    out, common = atomic.resolve_path(out), common or CommonSettings()
    engine = engine or make_processes()
    _require_cohort(out)
    with lock_folder(out, "cohort", WAIT_S):
        mark_as_cohort(out)
        # Workers that were killed leave unfinished files.
        for unfinished in (out / outcome_files.STATE).rglob(f"{atomic.UNFINISHED_PREFIX}*"):
            shutil.rmtree(unfinished, ignore_errors=True)
        version = toml.get_package_version("gaitcal")
        tasks = (
            outcome_files.Task(person=person, out=out, common=common, retry=retry, version=version)
            for person in cohort.people
        )
        began, computed = time.monotonic(), 0
        failed: dict[tuple[str, str], outcome_files.Outcome] = {}
        ended = engine.run(outcome_files.process_person, tasks, outcome_files.report_lost_person)
        # Closing the generator stops the workers at once if the run is interrupted.
        with closing(outcome for outcome in ended) as outcomes:
            for done, outcome in enumerate(outcomes, start=1):
                computed += outcome.computed
                if outcome.failed:
                    failed[outcome.key] = outcome
                waiting = len(cohort.people) - done
                # s, from the people that were computed, as stored ones take no time.
                remaining = waiting * (time.monotonic() - began) / computed if computed else None
                report(outcome, done, remaining)
        outcomes_of_all = outcome_files.Outcomes(out, failed)
        return write_tables(cohort.people, cohort.source, outcomes_of_all, common)


def make_processes(jobs: int = -1) -> LocalProcesses:
    """Make workers of a cohort: processes of this machine.

    A process is replaced after `EACH` people that it calibrated, or when its memory is over
    `MOST_MIB`.

    Parameters
    ----------
    jobs : int
        Number of processes; -1: one for every core.

    Returns
    -------
    LocalProcesses
    """
    return LocalProcesses(jobs, tasks_per_process=EACH, count_tasks=_count_tasks)


def _count_tasks(outcome: outcome_files.Outcome) -> int:
    """Count an outcome: 0 if it was valid already, `EACH` if its process must be replaced."""
    if not outcome.computed:
        return 0
    return EACH if outcome.mebibytes > MOST_MIB else 1


def _require_cohort(out: Path) -> None:
    """Raise InputError if a folder has other content than the results of a cohort."""
    if not out.exists():
        return
    if not out.is_dir():
        raise InputError("is a file; the output needs a folder", source=out, code=Code.FOLDER_TAKEN)
    names = sorted(p.name for p in out.iterdir() if not p.name.startswith("."))
    kind = result_folder.read_json_object(out / result_folder.MANIFEST).get("kind")
    if names and kind != result_folder.ResultKind.COHORT.value:
        message = f"has '{names[0]}' in it, and is no cohort; name a new or an empty folder"
        raise InputError(message, source=out, code=Code.FOLDER_TAKEN)


def mark_as_cohort(out: Path) -> None:
    """Mark a folder as that of a cohort, before any result."""
    if not (out / result_folder.MANIFEST).is_file():
        text = _format_manifest({"kind": result_folder.ResultKind.COHORT.value})
        with result_folder.amend_result(out) as stage:
            (stage / result_folder.MANIFEST).write_text(text, encoding="utf-8")


def _format_manifest(content: Mapping[str, object]) -> str:
    """Format a manifest with version and hash."""
    made = {"gaitcal": toml.get_package_version("gaitcal"), **content}
    hashed = {**made, result_folder.SELF_HASH: result_folder.hash_manifest(made)}
    return json.dumps(hashed, indent=1, ensure_ascii=False) + "\n"


def _describe_cohort(people: Sequence[CohortPerson], common: CommonSettings, stage: Path) -> str:
    """Format the manifest of a cohort: people, settings, files and hashes."""
    # Times differ from run to run, so they have no hash.
    names = sorted(path.name for path in stage.iterdir() if path.name != TIMES)
    settings: dict[str, object] = json.loads(common.calibration.model_dump_json(exclude_unset=True))
    if common.normal is not None:
        settings |= {
            "normal": common.normal.name,
            "normal_sha256": result_folder.compute_sha256(common.normal),
        }
    if common.priors is not None:
        settings |= {
            "priors": common.priors.name,
            "priors_sha256": result_folder.compute_sha256(common.priors),
        }
    return _format_manifest(
        {
            "kind": result_folder.ResultKind.COHORT.value,
            "people": len({person.name for person in people}),
            "sessions": len(people),
            "settings": settings,
            result_folder.FILES: sorted([*names, TIMES]),
            result_folder.HASHES: {
                name: result_folder.compute_sha256(stage / name) for name in names
            },
        }
    )


def write_tables(
    people: Sequence[CohortPerson],
    source: Path,
    ended: outcome_files.Outcomes,
    common: CommonSettings,
) -> Counter[str]:
    """Write all tables of a cohort into its folder, together.

    Parameters
    ----------
    people : sequence of CohortPerson
        In the order of the tables.
    source : Path
        Folder of the people's folders.
    ended : Outcomes
        With the folder of the cohort.
    common : CommonSettings
        Settings of everyone.

    Returns
    -------
    Counter
        Verdict, or `failed` -> people.
    """
    verdicts = Counter[str]()
    with result_folder.amend_result(ended.out) as stage:
        with ExitStack() as stack:
            tables = _Tables(stack, stage)
            # In the order of the list, whatever the order in which they ended.
            for person in people:
                outcome = ended.get_outcome(person)
                verdicts[outcome.verdict] += 1
                tables.add_time(person, outcome)
                if outcome.failed:
                    tables.add_failure(person, outcome, source.resolve())
                else:
                    tables.add_result(person, outcome, ended.out)
            tables.finish()
        written = {"people": stage / PEOPLE_PARQUET, "failures": stage / FAILURES}
        write_page(stage / PAGE, written, people, ended, common)
        manifest = _describe_cohort(people, common, stage)
        (stage / result_folder.MANIFEST).write_text(manifest, encoding="utf-8")
    return verdicts


class _Tables:
    """The open tables of a cohort, which get one person after the other."""

    def __init__(self, stack: ExitStack, folder: Path) -> None:
        self._people = _open_csv(stack, folder / PEOPLE_CSV, NAMES)
        self._failures = _open_csv(stack, folder / FAILURES, FAILURE_COLUMNS)
        self._times = _open_csv(stack, folder / TIMES, TIME_COLUMNS)
        names = ("person", "session", "group", *PEAK_COLUMNS)
        self._peaks = _open_csv(stack, folder / PEAKS, names)
        self._schema = pa.schema([(column.name, _ARROW[column.kind]) for column in COLUMNS])
        self._rows = _open_parquet(stack, folder / PEOPLE_PARQUET, self._schema)
        self._strides = _open_parquet(stack, folder / CYCLES, _GROUPED)
        self._meanings = _open_csv(stack, folder / MEANINGS, ("column", "unit", "meaning"))
        self._waiting: list[Mapping[str, Cell]] = []

    def add_time(self, person: CohortPerson, outcome: outcome_files.Outcome) -> None:
        """Add seconds and memory of a person."""
        self._times.writerow((*person.key, outcome.seconds, outcome.mebibytes))

    def add_failure(
        self, person: CohortPerson, outcome: outcome_files.Outcome, source: Path
    ) -> None:
        """Add a failure, with the folder relative to `source` if it is below it."""
        is_below = person.folder.is_relative_to(source)
        folder = person.folder.relative_to(source).as_posix() if is_below else person.folder.name
        cause = (outcome.code, outcome.cause, outcome.action)
        self._failures.writerow((*person.key, person.group, folder, *cause))

    def add_result(self, person: CohortPerson, outcome: outcome_files.Outcome, out: Path) -> None:
        """Add the row, activity peaks and strides of a person; `out`: folder of the cohort."""
        row = {**outcome.row, "group": person.group}
        self._people.writerow(["" if row.get(name) is None else row[name] for name in NAMES])
        for peak in read_activity_peaks(out / person.subfolder):
            self._peaks.writerow((*person.key, person.group, *peak))
        self._waiting.append(row)
        if len(self._waiting) == ROWS:
            self._write_waiting()
        path = outcome_files.get_state_path(out, person.subfolder, ".parquet")
        strides = pq.read_table(path)
        group = pa.array([person.group] * len(strides), pa.string())
        strides = strides.add_column(_GROUPED.get_field_index("group"), "group", group)
        if len(strides):
            self._strides.write_table(strides.cast(_GROUPED), row_group_size=len(strides))

    def finish(self) -> None:
        """Write the remaining rows, and the meanings of columns."""
        if self._waiting:
            self._write_waiting()
        self._meanings.writerows((c.name, c.unit, c.meaning) for c in COLUMNS)

    def _write_waiting(self) -> None:
        self._rows.write_table(_convert_rows(self._waiting, self._schema))
        self._waiting = []


def _convert_rows(waiting: Sequence[Mapping[str, Cell]], schema: pa.Schema) -> pa.Table:
    """Convert cells to the type of their columns: whole numbers come as integers from JSON."""
    columns = {}
    for column in COLUMNS:
        cells = (row.get(column.name) for row in waiting)
        columns[column.name] = [None if cell is None else column.kind(cell) for cell in cells]
    return pa.table(columns, schema=schema)


def _open_parquet(stack: ExitStack, path: Path, schema: pa.Schema) -> Any:
    """Open a Parquet file for writing."""
    writer = pq.ParquetWriter(path, schema, compression=outcome_files.COMPRESSION)
    return stack.enter_context(writer)


def _open_csv(stack: ExitStack, path: Path, names: Sequence[str]) -> Any:
    """Open a CSV table for writing, with its header."""
    stream = stack.enter_context(path.open("w", encoding="utf-8", newline=""))
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(names)
    return writer


def read_failures(out: Path) -> Iterator[dict[str, str]]:
    """Read the lines of `failures.csv`.

    Parameters
    ----------
    out : Path
        Folder of the cohort.

    Yields
    ------
    dict
        Column -> cell.
    """
    with (out / FAILURES).open(encoding="utf-8", newline="") as stream:
        yield from csv.DictReader(stream)
