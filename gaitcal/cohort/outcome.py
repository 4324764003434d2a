"""Process one person of a cohort, and store the outcome: a small JSON file, and strides as Parquet.

`state/people/P01/pre.json` and `.parquet` belong to `people/P01/pre`. They are written whole when
the person is done, so that an interrupted run loses only people in progress. All inputs of a result
(files, metadata, settings, version) are in one SHA-256, `fingerprint`: if it has not changed, a
worker does nothing.
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
    make_row,
    pack_mean_curves,
    read_reasons,
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
"""Folder of the outcomes within that of the cohort."""
AGAIN = "run the same command again: it tries this person once more"
"""What to do after a temporary failure."""
FORMAT = 4
"""Format of stored outcomes: after a change of it, everyone is computed again."""
READ = (*MARKER_ENDINGS, *TABLE_ENDINGS, ".csv", ".toml", ".xml")
"""Endings of files that a draft or a study may read."""


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Result or failure of one session of one person; its fields are keys of the stored file."""

    name: str
    session: str
    place: str
    """Folder of the result within that of the cohort."""
    fingerprint: str
    """SHA-256 of its inputs."""
    cause: str = ""
    """Why there is no result; empty if there is one."""
    action: str = ""
    """What to do about it."""
    code: str = ""
    """Kind of the cause, for `gaitcal explain`."""
    passing: bool = False
    """Whether the cause is temporary, as a full disk: the next run tries again."""
    result: str = ""
    """SHA-256 of the manifest of the result."""
    seconds: float = 0.0
    mebibytes: float = 0.0
    """Largest memory of the worker until then."""
    row: Mapping[str, Cell] = field(default_factory=dict)
    """Of the table of people."""
    reasons: Sequence[Mapping[str, str]] = ()
    """Of its verdict, the worst first: severity, cause, action."""
    curves: str = ""
    """Mean curves over the stride (`one_person.pack_mean_curves`)."""
    computed: bool = True
    """Whether this run computed it; False if nothing had changed."""

    @property
    def key(self) -> tuple[str, str]:
        """Name and session: sort key of tables."""
        return self.name, self.session

    @property
    def failed(self) -> bool:
        """Whether there is no result."""
        return bool(self.cause)

    @property
    def verdict(self) -> str:
        """Verdict of the result; `failed` without one."""
        return "failed" if self.failed else str(self.row.get("verdict") or "")

    @property
    def has_no_strides(self) -> bool:
        """Whether there are walks, but no valid stride of either leg."""
        return bool(self.row.get("walks")) and not any(
            self.row.get(f"strides_{side}") for side in SIDES
        )

    @property
    def first_cause(self) -> str:
        """Why it failed, or the worst reason of its verdict."""
        return self.cause or str(self.row.get("first_cause") or "")


def get_state_path(out: Path, place: str, ending: str) -> Path:
    """Get the path of a stored outcome.

    Parameters
    ----------
    out : Path
        Folder of the cohort.
    place : str
        Folder of the person's result within it.
    ending : str
        `.json` or `.parquet`.

    Returns
    -------
    Path
    """
    return out / STATE / f"{place}{ending}"


def write_outcome(out: Path, outcome: Outcome) -> None:
    """Write an outcome into the folder of the cohort, whole or not at all."""
    content = asdict(replace(outcome, row={**outcome.row}))
    atomic.write_text_atomically(
        get_state_path(out, outcome.place, ".json"),
        json.dumps(content, ensure_ascii=False, allow_nan=False) + "\n",
    )


@dataclass(frozen=True)
class Outcomes:
    """Outcomes of everyone at the end of a run."""

    out: Path
    """Folder of the cohort."""
    failed: Mapping[tuple[str, str], Outcome] = field(default_factory=dict)
    """Failures as the run returned them, by name and session; they may not be on the disk."""

    def get_outcome(self, person: CohortPerson) -> Outcome:
        """Get the outcome of a person, as the run returned it or from the disk.

        Parameters
        ----------
        person : CohortPerson
            One session of a person.

        Returns
        -------
        Outcome
            A failure if there is none.
        """
        cause = "its outcome was not found on the disk when the tables were written"
        found = self.failed.get(person.key) or read_outcome(self.out, person)
        return found or _make_failure(person, Code.WORKER, cause, AGAIN, passing=True)


def _make_failure(
    person: CohortPerson, code: Code, cause: str, action: str, *, passing: bool, inputs: str = ""
) -> Outcome:
    """Make the outcome of a failure; `inputs`: fingerprint of the inputs."""
    return Outcome(
        name=person.name,
        session=person.session,
        place=person.subfolder,
        fingerprint=inputs,
        code=code.value,
        cause=cause,
        action=action,
        passing=passing,
    )


def read_outcome(out: Path, person: CohortPerson) -> Outcome | None:
    """Read the outcome of an earlier run.

    Parameters
    ----------
    out : Path
        Folder of the cohort.
    person : CohortPerson
        One session of a person.

    Returns
    -------
    Outcome or None
        None if there is none that can be read.
    """
    content: dict[str, Any] = read_json_object(get_state_path(out, person.subfolder, ".json"))
    try:
        return Outcome(**content)
    except TypeError:
        return None


def list_input_files(folder: Path) -> dict[str, Path]:
    """List the files that the result of a person depends on.

    Parameters
    ----------
    folder : Path
        The person's folder.

    Returns
    -------
    dict
        Name -> path, each file once; files that a study names even if they are missing. Names are
        relative to the folder, or the one above it, so that a cohort may be moved; else the whole
        path.
    """
    folder = folder.absolute()
    out = {}
    for path in _find_files(folder):
        file, name = Path(os.path.normpath(path)), str(path)
        for above, prefix in ((folder.parent, "../"), (folder, "")):
            if file.is_relative_to(above):
                name = prefix + file.relative_to(above).as_posix()
        out[name] = path
    return out


def _find_files(folder: Path) -> Iterator[Path]:
    """Find the files of a person's folder, the marker sets above it, and what studies name."""
    if not is_folder(folder):
        return
    # One level below, as in a person's folder with a folder for each session.
    below = [
        path for path in sorted(folder.iterdir()) if path.is_dir() and path.name[0] not in ".~"
    ]
    files = list[Path]()
    for directory in (folder, *below):
        files += _list_readable(directory)
    yield from files
    for file in files:
        yield from _find_companions(file)
    for path in _list_readable(folder.parent):
        # A marker set for everyone.
        if (
            path.suffix.lower() == ".toml"
            and path.stat().st_size <= MAX_BYTES
            and b"landmarks" in path.read_bytes()
        ):
            yield path
    for study in list_study_files(folder):
        yield study
        yield from _find_named_files(study)


def _find_named_files(study: Path) -> Iterator[Path]:
    """Find the files that a study file names, existing or not."""
    try:
        file = read_validated(StudyFile, study)
    except InputError:
        # The fault is reported when the study is run.
        return
    for named in (file.markers.set_path, file.calibration.priors):
        if named is not None:
            yield study.parent / named
    for trial in file.trials:
        for named in (trial.file, trial.forces):
            if named is not None:
                yield study.parent / named
                yield from _find_companions(study.parent / named)
    if file.truth is not None:
        # Paths in a study file are relative to it.
        absolute = {
            key: study.parent / path
            for key, path in vars(file.truth).items()
            if isinstance(path, Path)
        }
        truth = file.truth.model_copy(update=absolute)
        yield from list_truth_files(truth, [trial.name for trial in file.trials])


def _find_companions(file: Path) -> Iterator[Path]:
    """Find the files that are read with a file: tables of an XML, plate corners of a table."""
    yield from opensim_files.find_existing_tables(file)
    corners = locate_plates_file(file)
    if corners.is_file():
        yield corners


def _list_readable(folder: Path) -> list[Path]:
    """List the files of a folder that a draft or a study may read."""
    paths = sorted(folder.iterdir())
    return [p for p in paths if p.suffix.lower() in READ and p.name[0] not in ".~" and p.is_file()]


def compute_fingerprint(person: CohortPerson, common: CommonSettings) -> str:
    """Compute the hash of all inputs of a person's result.

    Parameters
    ----------
    person : CohortPerson
        One session of a person.
    common : CommonSettings
        Settings of everyone.

    Returns
    -------
    str
        SHA-256, hexadecimal, of files, metadata, settings and version.
    """
    files = {
        name: compute_sha256(path) for name, path in sorted(list_input_files(person.folder).items())
    }
    # All that changes a result: an unchanged person is not computed again.
    content = {
        "format": FORMAT,
        "gaitcal": get_package_version("gaitcal"),
        "person": [
            *person.key,
            *(None if value is None else str(value) for value in vars(person.options).values()),
        ],
        "calibration": {name: str(value) for name, value in common.given_settings.items()},
        "normal": None if common.normal is None else compute_sha256(common.normal),
        "files": files,
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
    """One person, with what a worker needs."""

    person: CohortPerson
    out: Path
    """Folder of the cohort."""
    common: CommonSettings
    retry: bool
    """Whether a failure is tried again although nothing changed."""
    version: str
    """Of gaitcal, which all workers must have."""


def process_person(task: Task) -> Outcome:
    """Calibrate a person if an input changed, and store the outcome; raises nothing.

    Parameters
    ----------
    task : Task
        The person.

    Returns
    -------
    Outcome
        Without row and curves, which stay on the disk; a failure if nothing can be written there.
    """
    began = time.monotonic()
    try:
        outcome = _compute_outcome(task)
    except Exception as error:  # noqa: BLE001 - one person's failure never stops the others
        outcome = _convert_error(task, error)
    if outcome.computed:
        seconds = round(time.monotonic() - began, 3)
        outcome = replace(outcome, seconds=seconds, mebibytes=_measure_peak_memory())
        outcome = _store(task, outcome)
    row = {name: outcome.row[name] for name in ("verdict", "first_cause") if name in outcome.row}
    return replace(outcome, row=row, reasons=(), curves="")


def report_lost_person(task: Task, reason: str) -> Outcome:
    """Make and store the failure of a person in whose task a worker died several times.

    Parameters
    ----------
    task : Task
        The person.
    reason : str
        How the worker died.

    Returns
    -------
    Outcome
    """
    cause = f"its worker process died: {reason}"
    action = f"use fewer --jobs, if memory is short; {AGAIN}"
    return _store(task, _make_failure(task.person, Code.WORKER, cause, action, passing=True))


def _store(task: Task, outcome: Outcome) -> Outcome:
    """Store an outcome; if the disk cannot be written, return a failure, remove an earlier one."""
    try:
        write_outcome(task.out, outcome)
    except Exception as error:  # noqa: BLE001 - a full disk
        with suppress(OSError):
            get_state_path(task.out, outcome.place, ".json").unlink(missing_ok=True)
        if not outcome.failed:
            failure = _convert_error(task, error)
            outcome = replace(failure, seconds=outcome.seconds, mebibytes=outcome.mebibytes)
    return outcome


@with_one_blas_thread
def _compute_outcome(task: Task) -> Outcome:
    """Calibrate a person, or return the stored outcome if it is still valid."""
    version = get_package_version("gaitcal")
    # A worker of another version would mix two programs in one cohort.
    if version != task.version:
        raise _PassingError(f"the worker has gaitcal {version}, not {task.version}")
    person, result = task.person, task.out / task.person.subfolder
    inputs = compute_fingerprint(person, task.common)
    before = read_outcome(task.out, person)
    if before is not None and before.fingerprint == inputs and _is_valid(before, task):
        return replace(before, computed=False)
    # Many people in one process: returning memory to the system after each costs time.
    keep_freed_memory()
    calibrate_person(person, result, task.common)
    strides = cycle_tables.read_cycles(result).assign(person=person.name, session=person.session)
    table = pa.Table.from_pandas(strides[list(CYCLE_COLUMNS)], schema=STRIDES, preserve_index=False)
    with atomic.write_atomically(get_state_path(task.out, person.subfolder, ".parquet")) as target:
        pq.write_table(table.replace_schema_metadata(), target, compression=COMPRESSION)
    row = make_row(result) | {
        "person": person.name,
        "session": person.session,
        "folder": person.subfolder,
    }
    # Paths of the table are relative to the folder of the cohort.
    row |= {"page": f"{person.subfolder}/{row['page']}" if row["page"] else ""}
    return Outcome(
        name=person.name,
        session=person.session,
        place=person.subfolder,
        fingerprint=inputs,
        result=_read_manifest_hash(result),
        row=row,
        reasons=read_reasons(result),
        curves=pack_mean_curves(result / stride_files.ENSEMBLE, float(row["mass_kg"] or 1.0)),
    )


def _is_valid(before: Outcome, task: Task) -> bool:
    """Return whether an earlier outcome of the same inputs is still valid."""
    if before.failed:
        return not (before.passing or task.retry)
    strides = get_state_path(task.out, before.place, ".parquet")
    return strides.is_file() and _read_manifest_hash(task.out / before.place) == before.result


def _read_manifest_hash(result: Path) -> str:
    """Read the hash that the manifest of a result has of itself."""
    return str(read_json_object(result / MANIFEST).get(SELF_HASH) or "")


class _PassingError(GaitcalError):
    """A temporary cause."""

    code = Code.WORKER


def _convert_error(task: Task, error: Exception) -> Outcome:
    """Convert an exception to a failure: of the input, of the machine, or an internal error."""
    person, cause = task.person, str(error)
    # Absolute paths differ between machines and may name people.
    for known in (f"{person.folder}: ", f"{person.folder}/", f"{task.out}/"):
        cause = cause.replace(known, "")
    code, default = Code.INTERNAL, "please report it"
    if isinstance(error, GaitcalError):
        code, default = error.code, "gaitcal check on this folder shows more"
    else:
        cause = f"internal error: {type(error).__name__}: {cause}"
        if isinstance(error, (MemoryError, OSError)):
            code = Code.WORKER
    # Errors of the machine may pass: such a person is tried again in the next run.
    passing = isinstance(error, (_PassingError, MemoryError, OSError)) or isinstance(
        error.__cause__, OSError
    )
    action = getattr(error, "action", "") or (AGAIN if passing else default)
    try:
        inputs = compute_fingerprint(person, task.common)
    except OSError:
        inputs = ""
    cause = " ".join("".join(c if c.isprintable() else " " for c in cause).split())
    return _make_failure(person, code, cause, action, passing=passing, inputs=inputs)


def _measure_peak_memory() -> float:
    """Measure the largest resident memory of this process, MiB; 0 on Windows."""
    if sys.platform == "win32":
        return 0.0
    import resource

    unit = 1 << 20 if sys.platform == "darwin" else 1 << 10
    return round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit, 1)
