"""What became of a person, as it is kept on disk beside the results: a small file each, and the strides as Parquet.

`state/people/P01/pre.json` and `.parquet` belong to `people/P01/pre`. They are written whole when the person has ended,
so that nothing but people at work is lost, whatever ends the run.

What the result of a person depends on, as one SHA-256: files, what is said, settings, version.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, TypeAlias

from gaitcal.codes import Code
from gaitcal.cohort.one_person import CommonSettings
from gaitcal.cohort.people import CohortPerson, is_folder
from gaitcal.errors import InputError
from gaitcal.io.atomic import atomic_text
from gaitcal.io.csv import plates_file
from gaitcal.io.external_loads import tables_there
from gaitcal.io.lock import read_object
from gaitcal.io.snapshot import sha256_of
from gaitcal.io.toml import MAX_BYTES, package_version
from gaitcal.io.validation import read_validated
from gaitcal.model.linkage import SIDES
from gaitcal.session.draft import study_files
from gaitcal.session.folder import MARKER_ENDINGS, TABLE_ENDINGS
from gaitcal.study.study_file import StudyFile
from gaitcal.study.truth import truth_files

STATE = "state"
AGAIN = "run the same command again: it tries this person once more"
Cell: TypeAlias = str | int | float | None
"""Of the table of people."""


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """How one person ended."""

    name: str
    session: str
    place: str
    """Folder of the result within that of the cohort."""
    fingerprint: str
    """Of what it follows from."""
    cause: str = ""
    """Why there is no result; empty where there is one."""
    action: str = ""
    """What to do about it."""
    code: str = ""
    """Kind of the cause: `gaitcal explain` tells of it."""
    passing: bool = False
    """Whether the cause was of the moment, as a full disk, so that the next run tries again."""
    result: str = ""
    """SHA-256 by which the manifest of the result tells itself."""
    seconds: float = 0.0
    mebibytes: float = 0.0
    """Largest memory of the worker until then."""
    row: Mapping[str, Cell] = field(default_factory=dict)
    """Of the table of people."""
    reasons: Sequence[Mapping[str, str]] = ()
    """Of its verdict, the worst first: severity, cause, action."""
    curves: str = ""
    """Mean curves over the stride (`mean_curves.py`)."""
    computed: bool = True
    """Whether this run did it; False where nothing had changed."""

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
        return bool(self.row.get("walks")) and not any(self.row.get(f"strides_{side}") for side in SIDES)

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
    atomic_text(
        state_file(out, outcome.place, ".json"), json.dumps(content, ensure_ascii=False, allow_nan=False) + "\n"
    )


def forget(out: Path, place: str) -> None:
    """Remove the outcome of an earlier run, as far as the disk lets us: it no longer holds."""
    with suppress(OSError):
        state_file(out, place, ".json").unlink(missing_ok=True)


@dataclass(frozen=True)
class Outcomes:
    """What became of everyone when a run has ended."""

    out: Path
    """Folder of the cohort."""
    failed: Mapping[tuple[str, str], Outcome] = field(default_factory=dict)
    """Those without a result as the run returned them, by name and session: the disk may not have taken them."""

    def of(self, person: CohortPerson) -> Outcome:
        """As the run returned it, else as it is kept on disk; a failure where it is neither."""
        return self.failed.get(person.key) or kept(self.out, person) or _not_kept(person)


def _not_kept(person: CohortPerson) -> Outcome:
    return Outcome(
        name=person.name,
        session=person.session,
        place=person.place,
        fingerprint="",
        code=Code.WORKER.value,
        cause="what became of it was not found on disk when the tables were written",
        action=AGAIN,
        passing=True,
    )


def kept(out: Path, person: CohortPerson) -> Outcome | None:
    """The outcome of an earlier run; None where there is none that can be read."""
    content: dict[str, Any] = read_object(state_file(out, person.place, ".json"))
    try:
        return Outcome(**content)
    except TypeError:
        return None


READ = (*MARKER_ENDINGS, *TABLE_ENDINGS, ".csv", ".toml", ".xml")
"""Endings of files that a draft or a study may read."""


def inputs_of(folder: Path) -> dict[str, Path]:
    """The files by names that differ, each once; those that a study names also where they are missing."""
    folder = folder.absolute()
    return {_name(Path(os.path.normpath(file)), folder): file for file in _files(folder)}


def _name(file: Path, folder: Path) -> str:
    """As seen from the folder, the one above it included, so that a cohort may be moved; else the whole path."""
    for above, prefix in ((folder, ""), (folder.parent, "../")):
        if file.is_relative_to(above):
            return prefix + file.relative_to(above).as_posix()
    return str(file)


def _files(folder: Path) -> Iterator[Path]:
    lying = [*_read_in(folder)]
    for below in _entries(folder):
        if below.is_dir() and below.name[0] not in ".~":
            lying += _read_in(below)
    yield from lying
    yield from (place for file in lying for place in _drawn_on(file))
    for path in _read_in(folder.parent):
        if path.suffix.lower() == ".toml" and path.stat().st_size <= MAX_BYTES and b"landmarks" in path.read_bytes():
            yield path  # a marker set for everyone
    for study in study_files(folder) if is_folder(folder) else ():
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
        at = {key: study.parent / path for key, path in vars(file.truth).items() if isinstance(path, Path)}
        yield from truth_files(file.truth.model_copy(update=at), [trial.name for trial in file.trials])


def _drawn_on(file: Path) -> Iterator[Path]:
    """Files that come into it with a file: tables of an XML of external forces, corners of plates beside a table."""
    yield from tables_there(file)
    if (corners := plates_file(file)).is_file():
        yield corners


def _read_in(folder: Path) -> list[Path]:
    return [p for p in _entries(folder) if p.suffix.lower() in READ and p.name[0] not in ".~" and p.is_file()]


def _entries(folder: Path) -> list[Path]:
    return sorted(folder.iterdir()) if is_folder(folder) else []


FORMAT = 2
"""Of what a cohort keeps of a person: a change of it makes everyone be computed again."""


def fingerprint(person: CohortPerson, common: CommonSettings) -> str:
    """SHA-256, hexadecimal, of everything that the result of a person follows from."""
    content = {
        "format": FORMAT,
        "gaitcal": package_version("gaitcal"),
        "person": [*person.key, *(None if value is None else str(value) for value in vars(person.told).values())],
        "calibration": {name: str(value) for name, value in common.said.items()},
        "normal": None if common.normal is None else sha256_of(common.normal),
        "files": {name: sha256_of(path) for name, path in sorted(inputs_of(person.folder).items())},
    }
    if common.priors is not None:
        content["priors"] = sha256_of(common.priors)
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
