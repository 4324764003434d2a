"""A cohort from its folder to its tables: everyone whose inputs or settings changed is calibrated, the others stay."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from gaitcal.codes import Code
from gaitcal.cohort.one_person import CommonSettings
from gaitcal.cohort.outcome import STATE, Outcome, Outcomes
from gaitcal.cohort.people import Cohort
from gaitcal.cohort.tables import Written, mark, write_tables
from gaitcal.cohort.task import Task, end_person, lost_person
from gaitcal.errors import InputError
from gaitcal.io.atomic import UNFINISHED, disk_errors, real_path
from gaitcal.io.result_folder import MANIFEST, ResultKind, locked, read_object
from gaitcal.io.toml import package_version
from gaitcal.published.workers import LocalProcesses

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
