"""What a worker does with one person: nothing, where nothing changed; else a calibration, and what is kept of it."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from gaitcal.codes import Code
from gaitcal.cohort.mean_curves import mean_curves
from gaitcal.cohort.one_person import CommonSettings, calibrate_person
from gaitcal.cohort.outcome import AGAIN, Outcome, fingerprint, forget, keep, kept, state_file
from gaitcal.cohort.people import CohortPerson
from gaitcal.cohort.row import reasons_of, row_of
from gaitcal.errors import GaitcalError
from gaitcal.gait.cycles import CYCLE_COLUMNS
from gaitcal.io.atomic import atomic_file
from gaitcal.io.result_folder import MANIFEST, SELF, read_object
from gaitcal.io.toml import package_version
from gaitcal.results.cycles import read_cycles
from gaitcal.results.stride_files import ENSEMBLE
from gaitcal.runtime import keep_freed_memory, with_one_blas_thread

STRIDE_TYPES = {
    **dict.fromkeys(("person", "session", "trial", "side", "variable"), pa.string()),
    **dict.fromkeys(("stride", "percent"), pa.int32()),
    "valid": pa.int8(),
    **dict.fromkeys(("value", "se", "se_stride", "turn"), pa.float64()),
}
"""Column of `cycles.parquet` -> type."""
STRIDES = pa.schema([(name, STRIDE_TYPES[name]) for name in CYCLE_COLUMNS])
COMPRESSION = "zstd"


@dataclass(frozen=True, kw_only=True)
class Task:
    """One person, and what a worker needs to know."""

    person: CohortPerson
    out: Path
    """Folder of the cohort."""
    common: CommonSettings
    retry: bool
    """Whether what failed is tried again though nothing changed."""
    version: str
    """Of gaitcal, which all workers must have."""


def end_person(task: Task) -> Outcome:
    """Calibrate a person where anything changed, and keep the outcome on disk; no exception leaves it.

    What is returned has neither row nor curves: they stay on disk. Where nothing can be written there, it is a failure
    that says so.
    """
    began = time.monotonic()
    try:
        outcome = _ended(task)
    except Exception as error:  # noqa: BLE001 - one person's failure never stops the others
        outcome = _failure(task, error)
    if outcome.computed:
        outcome = replace(outcome, seconds=round(time.monotonic() - began, 3), mebibytes=_peak())
        outcome = _kept(task, outcome)
    row = {name: outcome.row[name] for name in ("verdict", "first_cause") if name in outcome.row}
    return replace(outcome, row=row, reasons=(), curves="")


def lost_person(task: Task, words: str) -> Outcome:
    """The outcome of a person over whom a worker died several times."""
    lost = Outcome(
        name=task.person.name,
        session=task.person.session,
        place=task.person.place,
        fingerprint="",
        code=Code.WORKER.value,
        cause=f"its worker process died: {words}",
        action=f"too little memory for so many --jobs does this; {AGAIN}",
        passing=True,
    )
    return _kept(task, lost)


def _kept(task: Task, outcome: Outcome) -> Outcome:
    """The outcome, kept on disk; a failure where the disk does not take it."""
    try:
        keep(task.out, outcome)
    except Exception as error:  # noqa: BLE001 - a full disk
        forget(task.out, outcome.place)
        if not outcome.failed:
            outcome = replace(_failure(task, error), seconds=outcome.seconds, mebibytes=outcome.mebibytes)
    return outcome


@with_one_blas_thread
def _ended(task: Task) -> Outcome:
    if package_version("gaitcal") != task.version:
        raise _PassingError(f"the worker has gaitcal {package_version('gaitcal')}, not {task.version}")
    person, result = task.person, task.out / task.person.place
    mark = fingerprint(person, task.common)
    before = kept(task.out, person)
    if before is not None and before.fingerprint == mark and _stands(before, task):
        return replace(before, computed=False)
    keep_freed_memory()
    calibrate_person(person, result, task.common)
    _keep_strides(task)
    row = row_of(result) | {"person": person.name, "session": person.session, "folder": person.place}
    row |= {"page": f"{person.place}/{row['page']}" if row["page"] else "", "age_years": person.told.age}
    return Outcome(
        name=person.name,
        session=person.session,
        place=person.place,
        fingerprint=mark,
        result=_own_hash(result),
        row=row,
        reasons=reasons_of(result),
        curves=mean_curves(result / ENSEMBLE, float(row["mass_kg"] or 1.0)),
    )


def _stands(before: Outcome, task: Task) -> bool:
    """Whether an earlier outcome of the same inputs still holds."""
    if before.failed:
        return not (before.passing or task.retry)
    strides = state_file(task.out, before.place, ".parquet")
    return strides.is_file() and _own_hash(task.out / before.place) == before.result


def _own_hash(result: Path) -> str:
    return str(read_object(result / MANIFEST).get(SELF) or "")


def _keep_strides(task: Task) -> None:
    person = task.person
    strides = read_cycles(task.out / person.place)
    strides = strides.assign(person=person.name, session=person.session)
    table = pa.Table.from_pandas(strides[list(CYCLE_COLUMNS)], schema=STRIDES, preserve_index=False)
    with atomic_file(state_file(task.out, person.place, ".parquet")) as target:
        pq.write_table(table.replace_schema_metadata(), target, compression=COMPRESSION)


class _PassingError(GaitcalError):
    """A cause of the moment."""

    code = Code.WORKER


def _failure(task: Task, error: Exception) -> Outcome:
    person = task.person
    said = str(error)
    for known in (f"{person.folder}: ", f"{person.folder}/", f"{task.out}/"):
        said = said.replace(known, "")
    if not isinstance(error, GaitcalError):
        said = f"internal error: {type(error).__name__}: {said}"
    passing = isinstance(error, (_PassingError, MemoryError, OSError)) or isinstance(error.__cause__, OSError)
    default = "gaitcal check on this folder shows more" if isinstance(error, GaitcalError) else "please report it"
    try:
        mark = fingerprint(person, task.common)
    except OSError:
        mark = ""
    return Outcome(
        name=person.name,
        session=person.session,
        place=person.place,
        fingerprint=mark,
        code=_code_of(error).value,
        cause=" ".join("".join(c if c.isprintable() else " " for c in said).split()),
        action=getattr(error, "action", "") or (AGAIN if passing else default),
        passing=passing,
    )


def _code_of(error: Exception) -> Code:
    """The code of a failure; of what was not raised on purpose, the machine's or our own."""
    if isinstance(error, GaitcalError):
        return error.code
    return Code.WORKER if isinstance(error, (MemoryError, OSError)) else Code.INTERNAL


def _peak() -> float:
    """Largest resident memory of this process, MiB; 0 where the system does not tell."""
    if sys.platform == "win32":
        return 0.0
    import resource

    unit = 1 << 20 if sys.platform == "darwin" else 1 << 10
    return round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit, 1)
