"""What becomes of one person, and how it is kept on disk beside the results: a small file, and the
strides as Parquet.

`state/people/P01/pre.json` and `.parquet` belong to `people/P01/pre`. They are written whole when
the person has ended, so that nothing but people at work is lost, whatever ends the run. What a
result follows from (files, what is said, settings, version) is one SHA-256, `fingerprint`: where it
has not changed, a worker does nothing.
"""

import hashlib
import json
import os
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from gaitcal.cohort.cohort_people import CohortPerson, is_folder
from gaitcal.cohort.one_person import (
    Cell,
    CommonSettings,
    calibrate_person,
    mean_curves,
    reasons_of,
    row_of,
)
from gaitcal.errors import Code, GaitcalError, InputError
from gaitcal.gait.cycles import CYCLE_COLUMNS
from gaitcal.intake.draft_file import list_study_files
from gaitcal.intake.recordings_folder import MARKER_ENDINGS, TABLE_ENDINGS
from gaitcal.io import atomic, opensim_files
from gaitcal.io.csv_recordings import locate_plates_file
from gaitcal.io.result_folder import MANIFEST, SELF_HASH, compute_sha256, read_json_object
from gaitcal.io.toml import MAX_BYTES, get_package_version, read_validated
from gaitcal.model.linkage import SIDES
from gaitcal.results import cycle_tables, stride_files
from gaitcal.runtime import keep_freed_memory, with_one_blas_thread
from gaitcal.study.declared_truth import list_truth_files
from gaitcal.study.study_file import StudyFile

STATE = "state"
AGAIN = "run the same command again: it tries this person once more"


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """How one person ended."""

    name: str
    session: str
    place: str  # Folder of the result within that of the cohort
    fingerprint: str  # Of what it follows from
    cause: str = ""  # Why there is no result; empty where there is one
    action: str = ""  # What to do about it
    code: str = ""  # Kind of the cause: `gaitcal explain` tells of it
    # Whether the cause was of the moment, as a full disk, so that the next run tries again
    passing: bool = False
    result: str = ""  # SHA-256 by which the manifest of the result tells itself
    seconds: float = 0.0
    mebibytes: float = 0.0  # Largest memory of the worker until then
    row: Mapping[str, Cell] = field(default_factory=dict)  # Of the table of people
    reasons: Sequence[
        Mapping[str, str]
    ] = ()  # Of its verdict, the worst first: severity, cause, action
    curves: str = ""  # Mean curves over the stride (`row.mean_curves`)
    computed: bool = True  # Whether this run did it; False where nothing had changed

    @property
    def key(self) -> tuple[str, str]:
        """Name and session, by which tables are sorted."""
        return self.name, self.session

    @property
    def failed(self) -> bool:
        """Whether there is no result."""
        return bool(self.cause)

    @property
    def verdict(self) -> str:
        """Of the result; `failed` where there is none."""
        return "failed" if self.failed else str(self.row.get("verdict") or "")

    @property
    def strideless(self) -> bool:
        """There are walks, and no stride of either leg counts: nothing of their gait is known."""
        return bool(self.row.get("walks")) and not any(
            self.row.get(f"strides_{side}") for side in SIDES
        )

    @property
    def first_cause(self) -> str:
        """Why it failed, or the worst reason of its verdict."""
        return self.cause or str(self.row.get("first_cause") or "")


def state_file(out: Path, place: str, ending: str) -> Path:
    """A file of the state of a person."""
    return out / STATE / f"{place}{ending}"


def keep(out: Path, outcome: Outcome) -> None:
    """Write an outcome, whole or not at all."""
    content = asdict(replace(outcome, row={**outcome.row}))
    atomic.write_text_atomically(
        state_file(out, outcome.place, ".json"),
        json.dumps(content, ensure_ascii=False, allow_nan=False) + "\n",
    )


@dataclass(frozen=True)
class Outcomes:
    """What became of everyone when a run has ended."""

    out: Path  # Folder of the cohort
    failed: Mapping[tuple[str, str], Outcome] = field(default_factory=dict)
    """Those without a result as the run returned them, by name and session: the disk may not have
    taken them.
    """

    def of(self, person: CohortPerson) -> Outcome:
        """As the run returned it, else as it is kept on disk; a failure where it is neither."""
        cause = "what became of it was not found on disk when the tables were written"
        found = self.failed.get(person.key) or kept(self.out, person)
        return found or _failure(person, Code.WORKER, cause, AGAIN, passing=True)


def _failure(
    person: CohortPerson, code: Code, cause: str, action: str, *, passing: bool, mark: str = ""
) -> Outcome:
    return Outcome(
        name=person.name,
        session=person.session,
        place=person.place,
        fingerprint=mark,
        code=code.value,
        cause=cause,
        action=action,
        passing=passing,
    )


def kept(out: Path, person: CohortPerson) -> Outcome | None:
    """The outcome of an earlier run; None where there is none that can be read."""
    content: dict[str, Any] = read_json_object(state_file(out, person.place, ".json"))
    try:
        return Outcome(**content)
    except TypeError:
        return None


READ = (
    *MARKER_ENDINGS,
    *TABLE_ENDINGS,
    ".csv",
    ".toml",
    ".xml",
)  # Endings of files that a draft or a study may read


def inputs_of(folder: Path) -> dict[str, Path]:
    """The files by names that differ, each once; those that a study names also where they are
    missing.

    Names are as seen from the folder, or the one above it, so that a cohort may be moved; of others
    the whole path.
    """
    folder = folder.absolute()
    out = {}
    for path in _files(folder):
        file, name = Path(os.path.normpath(path)), str(path)
        for above, prefix in ((folder.parent, "../"), (folder, "")):
            if file.is_relative_to(above):
                name = prefix + file.relative_to(above).as_posix()
        out[name] = path
    return out


def _files(folder: Path) -> Iterator[Path]:
    if not is_folder(folder):
        return
    below = [
        path for path in sorted(folder.iterdir()) if path.is_dir() and path.name[0] not in ".~"
    ]
    lying = [file for place in (folder, *below) for file in _read_in(place)]
    yield from lying
    yield from (place for file in lying for place in _drawn_on(file))
    for path in _read_in(folder.parent):
        if (
            path.suffix.lower() == ".toml"
            and path.stat().st_size <= MAX_BYTES
            and b"landmarks" in path.read_bytes()
        ):
            yield path  # a marker set for everyone
    for study in list_study_files(folder):
        yield study
        yield from _named_in(study)


def _named_in(study: Path) -> Iterator[Path]:
    """What a study file names, whether or not it is there."""
    try:
        file = read_validated(StudyFile, study)
    except InputError:
        return  # a fault of the file itself, which is told when it is run
    for named in (file.markers.set_path, file.calibration.priors):
        if named is not None:
            yield study.parent / named
    for trial in file.trials:
        for named in (trial.file, trial.forces):
            if named is not None:
                yield study.parent / named
                yield from _drawn_on(study.parent / named)
    if file.truth is not None:
        at = {
            key: study.parent / path
            for key, path in vars(file.truth).items()
            if isinstance(path, Path)
        }
        yield from list_truth_files(
            file.truth.model_copy(update=at), [trial.name for trial in file.trials]
        )


def _drawn_on(file: Path) -> Iterator[Path]:
    """Files that come into it with a file: tables of an XML of external forces, corners of plates
    beside a table.
    """
    yield from opensim_files.find_existing_tables(file)
    if (corners := locate_plates_file(file)).is_file():
        yield corners


def _read_in(folder: Path) -> list[Path]:
    paths = sorted(folder.iterdir())
    return [p for p in paths if p.suffix.lower() in READ and p.name[0] not in ".~" and p.is_file()]


FORMAT = 4  # Of what a cohort keeps of a person: a change of it makes everyone be computed again


def fingerprint(person: CohortPerson, common: CommonSettings) -> str:
    """SHA-256, hexadecimal, of everything that the result of a person follows from."""
    content = {
        "format": FORMAT,
        "gaitcal": get_package_version("gaitcal"),
        "person": [
            *person.key,
            *(None if value is None else str(value) for value in vars(person.told).values()),
        ],
        "calibration": {name: str(value) for name, value in common.said.items()},
        "normal": None if common.normal is None else compute_sha256(common.normal),
        "files": {
            name: compute_sha256(path) for name, path in sorted(inputs_of(person.folder).items())
        },
    }
    if common.priors is not None:
        content["priors"] = compute_sha256(common.priors)
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


STRIDE_TYPES = {
    **dict.fromkeys(
        ("person", "session", "trial", "side", "variable", "activity", "phase"), pa.string()
    ),
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
    out: Path  # Folder of the cohort
    common: CommonSettings
    retry: bool  # Whether what failed is tried again though nothing changed
    version: str  # Of gaitcal, which all workers must have


def end_person(task: Task) -> Outcome:
    """Calibrate a person where anything changed, and keep the outcome on disk; no exception leaves
    it.

    What is returned has neither row nor curves: they stay on disk. Where nothing can be written
    there, it is a failure that says so.
    """
    began = time.monotonic()
    try:
        outcome = _ended(task)
    except Exception as error:  # noqa: BLE001 - one person's failure never stops the others
        outcome = _failed_by(task, error)
    if outcome.computed:
        outcome = replace(outcome, seconds=round(time.monotonic() - began, 3), mebibytes=_peak())
        outcome = _kept(task, outcome)
    row = {name: outcome.row[name] for name in ("verdict", "first_cause") if name in outcome.row}
    return replace(outcome, row=row, reasons=(), curves="")


def lost_person(task: Task, words: str) -> Outcome:
    """The outcome of a person over whom a worker died several times."""
    cause, action = (
        f"its worker process died: {words}",
        f"too little memory for so many --jobs does this; {AGAIN}",
    )
    return _kept(task, _failure(task.person, Code.WORKER, cause, action, passing=True))


def _kept(task: Task, outcome: Outcome) -> Outcome:
    """The outcome, kept on disk; a failure where the disk does not take it: an earlier one no
    longer holds.
    """
    try:
        keep(task.out, outcome)
    except Exception as error:  # noqa: BLE001 - a full disk
        with suppress(OSError):
            state_file(task.out, outcome.place, ".json").unlink(missing_ok=True)
        if not outcome.failed:
            outcome = replace(
                _failed_by(task, error), seconds=outcome.seconds, mebibytes=outcome.mebibytes
            )
    return outcome


@with_one_blas_thread
def _ended(task: Task) -> Outcome:
    if get_package_version("gaitcal") != task.version:
        raise _PassingError(
            f"the worker has gaitcal {get_package_version('gaitcal')}, not {task.version}"
        )
    person, result = task.person, task.out / task.person.place
    mark = fingerprint(person, task.common)
    before = kept(task.out, person)
    if before is not None and before.fingerprint == mark and _stands(before, task):
        return replace(before, computed=False)
    keep_freed_memory()
    calibrate_person(person, result, task.common)
    strides = cycle_tables.read_cycles(result).assign(person=person.name, session=person.session)
    table = pa.Table.from_pandas(strides[list(CYCLE_COLUMNS)], schema=STRIDES, preserve_index=False)
    with atomic.write_atomically(state_file(task.out, person.place, ".parquet")) as target:
        pq.write_table(table.replace_schema_metadata(), target, compression=COMPRESSION)
    row = row_of(result) | {
        "person": person.name,
        "session": person.session,
        "folder": person.place,
    }
    row |= {"page": f"{person.place}/{row['page']}" if row["page"] else ""}
    return Outcome(
        name=person.name,
        session=person.session,
        place=person.place,
        fingerprint=mark,
        result=_own_hash(result),
        row=row,
        reasons=reasons_of(result),
        curves=mean_curves(result / stride_files.ENSEMBLE, float(row["mass_kg"] or 1.0)),
    )


def _stands(before: Outcome, task: Task) -> bool:
    """Whether an earlier outcome of the same inputs still holds."""
    if before.failed:
        return not (before.passing or task.retry)
    strides = state_file(task.out, before.place, ".parquet")
    return strides.is_file() and _own_hash(task.out / before.place) == before.result


def _own_hash(result: Path) -> str:
    return str(read_json_object(result / MANIFEST).get(SELF_HASH) or "")


class _PassingError(GaitcalError):
    """A cause of the moment."""

    code = Code.WORKER


def _failed_by(task: Task, error: Exception) -> Outcome:
    """The failure that an exception is; of one that was not raised on purpose, the machine's or our
    own.
    """
    person, cause = task.person, str(error)
    for known in (f"{person.folder}: ", f"{person.folder}/", f"{task.out}/"):
        cause = cause.replace(known, "")
    code, default = Code.INTERNAL, "please report it"
    if isinstance(error, GaitcalError):
        code, default = error.code, "gaitcal check on this folder shows more"
    else:
        cause = f"internal error: {type(error).__name__}: {cause}"
        if isinstance(error, (MemoryError, OSError)):
            code = Code.WORKER
    passing = isinstance(error, (_PassingError, MemoryError, OSError)) or isinstance(
        error.__cause__, OSError
    )
    action = getattr(error, "action", "") or (AGAIN if passing else default)
    try:
        mark = fingerprint(person, task.common)
    except OSError:
        mark = ""
    cause = " ".join("".join(c if c.isprintable() else " " for c in cause).split())
    return _failure(person, code, cause, action, passing=passing, mark=mark)


def _peak() -> float:
    """Largest resident memory of this process, MiB; 0 where the system does not tell."""
    if sys.platform == "win32":
        return 0.0
    import resource

    unit = 1 << 20 if sys.platform == "darwin" else 1 << 10
    return round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit, 1)
