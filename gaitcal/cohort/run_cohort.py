"""A cohort from its folder to its tables: everyone whose inputs or settings changed is calibrated,
the others stay.

Tables are made of what is kept of every person, one at a time, in the order of names and sessions.
The same people give the same bytes, in whatever order, on whatever machine and in however many runs
they were computed; what differs (seconds, memory) is in `times.csv` alone.
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
from gaitcal.cohort.one_person import COLUMNS, NAMES, Cell, CommonSettings, activity_peaks
from gaitcal.errors import Code, InputError
from gaitcal.gait.peaks import PEAK_COLUMNS
from gaitcal.io import atomic, result_folder, toml
from gaitcal.montecarlo.workers import LocalProcesses, Workers, lock_folder

PEOPLE_CSV, PEOPLE_PARQUET, CYCLES = "people.csv", "people.parquet", "cycles.parquet"
FAILURES, TIMES, MEANINGS, PEAKS = "failures.csv", "times.csv", "columns.csv", "activity_peaks.csv"
FAILURE_COLUMNS = ("person", "session", "group", "folder", "code", "cause", "what_to_do")
TIME_COLUMNS = ("person", "session", "seconds", "worker_mebibytes")
WAIT_S = 5.0  # For another run on the same folder that is about to end
EACH = 25  # People that a process calibrates before another takes its place
MOST_MIB = 1500.0  # A process that once needed more keeps much of it: it makes room for another one
ROWS = 64  # People in a row group of `people.parquet`: what is held in memory
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
    told: Callable[
        [outcome_files.Outcome, int, float | None], None
    ] = lambda outcome, done, remaining_s: None,
) -> Counter[str]:
    """Calibrate everyone of a cohort into `out/people`, and write its tables.

    Returns `trustworthy`, `doubtful`, `refused`, `failed` -> people.

    Parameters
    ----------
    cohort
        Of `people.people_in` or `people.read_cohort`.
    out
        The folder of the cohort; what is there of an earlier run, and still holds, is kept.
    common
        Settings of everyone.
    engine
        Who computes; processes of this machine unless given.
    retry
        Try again who failed before though nothing changed.
    told
        Called whenever somebody has ended: how, how many have, seconds that are left (None: nobody
        was computed).

    Raises InputError: `out` cannot be written, holds something else, or another run works in it.
    """
    out, common, engine = (
        atomic.resolve_path(out),
        common or CommonSettings(),
        engine or processes(),
    )
    require_cohort(out)
    with lock_folder(out, "cohort", WAIT_S):
        mark(out)
        for unfinished in (out / outcome_files.STATE).rglob(
            f"{atomic.UNFINISHED_PREFIX}*"
        ):  # of workers that were killed
            shutil.rmtree(unfinished, ignore_errors=True)
        version = toml.get_package_version("gaitcal")
        tasks = (
            outcome_files.Task(person=person, out=out, common=common, retry=retry, version=version)
            for person in cohort.people
        )
        began, computed = time.monotonic(), 0
        failed: dict[tuple[str, str], outcome_files.Outcome] = {}
        ended = engine.run(outcome_files.end_person, tasks, outcome_files.lost_person)
        with closing(outcome for outcome in ended) as outcomes:  # interrupted, workers end at once
            for done, outcome in enumerate(outcomes, start=1):
                computed += outcome.computed
                if outcome.failed:
                    failed[outcome.key] = outcome
                left = len(cohort.people) - done
                remaining = left * (time.monotonic() - began) / computed if computed else None
                told(outcome, done, remaining)
        return write_tables(
            cohort.people, cohort.source, outcome_files.Outcomes(out, failed), common
        )


def processes(jobs: int = -1) -> LocalProcesses:
    """Processes of this machine, -1: one for every core; whoever is unchanged costs them nothing.

    One is replaced after `EACH` people, or when it has grown over `MOST_MIB`.
    """
    return LocalProcesses(jobs, tasks_per_process=EACH, count_tasks=_count_tasks)


def _count_tasks(outcome: outcome_files.Outcome) -> int:
    """As how many people one counts."""
    if not outcome.computed:
        return 0
    return EACH if outcome.mebibytes > MOST_MIB else 1


def require_cohort(out: Path) -> None:
    """InputError where a folder holds something else than a cohort's results."""
    if not out.exists():
        return
    if not out.is_dir():
        raise InputError("is a file; the output needs a folder", source=out, code=Code.FOLDER_TAKEN)
    names = sorted(p.name for p in out.iterdir() if not p.name.startswith("."))
    if (
        names
        and result_folder.read_json_object(out / result_folder.MANIFEST).get("kind")
        != result_folder.ResultKind.COHORT.value
    ):
        message = f"holds '{names[0]}', and is no cohort; name a new or an empty folder"
        raise InputError(message, source=out, code=Code.FOLDER_TAKEN)


def mark(out: Path) -> None:
    """Mark a folder as a cohort's, before anything is in it."""
    if not (out / result_folder.MANIFEST).is_file():
        with result_folder.amend_result(out) as stage:
            (stage / result_folder.MANIFEST).write_text(
                _text({"kind": result_folder.ResultKind.COHORT.value}), encoding="utf-8"
            )


def _text(content: Mapping[str, object]) -> str:
    made = {"gaitcal": toml.get_package_version("gaitcal"), **content}
    return (
        json.dumps(
            {**made, result_folder.SELF_HASH: result_folder.hash_manifest(made)},
            indent=1,
            ensure_ascii=False,
        )
        + "\n"
    )


def _manifest(people: Sequence[CohortPerson], common: CommonSettings, stage: Path) -> str:
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
    return _text(
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
    """Write all tables of a cohort into its folder, together. `source`: where the people's folders
    are.
    """
    verdicts = Counter[str]()
    schema, home = (
        pa.schema([(column.name, _ARROW[column.kind]) for column in COLUMNS]),
        source.resolve(),
    )
    with result_folder.amend_result(ended.out) as stage:
        with ExitStack() as stack:
            of_tables = {
                PEOPLE_CSV: NAMES,
                FAILURES: FAILURE_COLUMNS,
                TIMES: TIME_COLUMNS,
                PEAKS: ("person", "session", "group", *PEAK_COLUMNS),
            }
            table, failed, times, peaks = (
                _csv(stack, stage / name, of) for name, of in of_tables.items()
            )
            rows = stack.enter_context(
                pq.ParquetWriter(
                    stage / PEOPLE_PARQUET, schema, compression=outcome_files.COMPRESSION
                )
            )
            strides = stack.enter_context(
                pq.ParquetWriter(stage / CYCLES, _GROUPED, compression=outcome_files.COMPRESSION)
            )
            waiting: list[Mapping[str, Cell]] = []
            for person in people:
                outcome = ended.of(person)
                verdicts[outcome.verdict] += 1
                times.writerow((*person.key, outcome.seconds, outcome.mebibytes))
                if outcome.failed:
                    below = person.folder.is_relative_to(home)
                    folder = (
                        person.folder.relative_to(home).as_posix() if below else person.folder.name
                    )
                    cause = (outcome.code, outcome.cause, outcome.action)
                    failed.writerow((*person.key, person.group, folder, *cause))
                    continue
                row = {**outcome.row, "group": person.group}
                table.writerow(["" if row.get(name) is None else row[name] for name in NAMES])
                peaks.writerows(
                    (*person.key, person.group, *of)
                    for of in activity_peaks(ended.out / person.place)
                )
                waiting.append(row)
                if len(waiting) == ROWS:
                    rows.write_table(_rows(waiting, schema))
                    waiting = []
                of_person = pq.read_table(
                    outcome_files.state_file(ended.out, person.place, ".parquet")
                )
                group = pa.array([person.group] * len(of_person), pa.string())
                of_person = of_person.add_column(_GROUPED.get_field_index("group"), "group", group)
                if len(of_person):
                    strides.write_table(of_person.cast(_GROUPED), row_group_size=len(of_person))
            if waiting:
                rows.write_table(_rows(waiting, schema))
            meanings = _csv(stack, stage / MEANINGS, ("column", "unit", "meaning"))
            meanings.writerows((column.name, column.unit, column.meaning) for column in COLUMNS)
        written = {"people": stage / PEOPLE_PARQUET, "failures": stage / FAILURES}
        write_page(stage / PAGE, written, people, ended, common)
        (stage / result_folder.MANIFEST).write_text(
            _manifest(people, common, stage), encoding="utf-8"
        )
    return verdicts


def _rows(waiting: Sequence[Mapping[str, Cell]], schema: pa.Schema) -> pa.Table:
    """Cells as their columns have them: a number that is whole came as an integer from JSON."""
    columns = {}
    for column in COLUMNS:
        cells = (row.get(column.name) for row in waiting)
        columns[column.name] = [None if cell is None else column.kind(cell) for cell in cells]
    return pa.table(columns, schema=schema)


def _csv(stack: ExitStack, path: Path, names: Sequence[str]) -> Any:
    stream = stack.enter_context(path.open("w", encoding="utf-8", newline=""))
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(names)
    return writer


def failures(out: Path) -> Iterator[dict[str, str]]:
    """The lines of `failures.csv`."""
    with (out / FAILURES).open(encoding="utf-8", newline="") as stream:
        yield from csv.DictReader(stream)
