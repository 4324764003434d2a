"""What the result of a person depends on, as one SHA-256: files, what is said, settings, version."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator
from pathlib import Path

from gaitcal.cohort.one_person import CommonSettings
from gaitcal.cohort.people import CohortPerson, is_folder
from gaitcal.errors import InputError
from gaitcal.io.csv import plates_file
from gaitcal.io.external_loads import tables_there
from gaitcal.io.package_data import package_version
from gaitcal.io.snapshot import sha256_of
from gaitcal.io.toml import MAX_BYTES
from gaitcal.io.validation import read_validated
from gaitcal.session.folder import MARKER_ENDINGS, TABLE_ENDINGS
from gaitcal.session.source import study_files
from gaitcal.study.study_file import StudyFile
from gaitcal.study.truth import truth_files

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
