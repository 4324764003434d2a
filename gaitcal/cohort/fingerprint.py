"""What the result of a person depends on, as one SHA-256: files, what is said, settings, version."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path

from gaitcal.cohort.one_person import CommonSettings
from gaitcal.cohort.people import CohortPerson
from gaitcal.errors import InputError
from gaitcal.files.package_data import package_version
from gaitcal.files.snapshot import sha256_of
from gaitcal.files.toml import MAX_BYTES
from gaitcal.intake.draft_text import STUDY
from gaitcal.intake.folder import MARKER_ENDINGS, TABLE_ENDINGS
from gaitcal.study.study import input_files
from gaitcal.study.study_file import load_study_file

FORMAT = 2
"""Of what a cohort keeps of a person: a change of it makes everyone be computed again."""
READ = (*MARKER_ENDINGS, *TABLE_ENDINGS, ".csv", ".toml", ".xml")
"""Endings of files that a draft or a study may read."""


def fingerprint(person: CohortPerson, common: CommonSettings) -> str:
    """SHA-256, hexadecimal, of everything that the result of a person follows from."""
    content = {
        "format": FORMAT,
        "gaitcal": package_version("gaitcal"),
        "person": [*person.key, *(None if value is None else str(value) for value in vars(person.told).values())],
        "calibration": {name: str(value) for name, value in common.said.items()},
        "normal": None if common.normal is None else sha256_of(common.normal),
        "files": {name: sha256_of(path) for name, path in sorted(_files(person.folder))},
    }
    if common.priors is not None:
        content["priors"] = sha256_of(common.priors)
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _files(folder: Path) -> Iterator[tuple[str, Path]]:
    """Files that a study or a draft of the folder may read, by names that differ."""
    yield from _read_in(folder, "")
    if folder.is_dir():
        for below in folder.iterdir():
            if below.is_dir() and below.name[0] not in ".~":
                yield from _read_in(below, f"{below.name}/")
    for name, path in _read_in(folder.parent, ""):
        if path.suffix.lower() == ".toml" and path.stat().st_size <= MAX_BYTES and b"landmarks" in path.read_bytes():
            yield f"../{name}", path  # a marker set for everyone
    study = folder / STUDY
    if study.is_file():
        try:
            named = input_files(load_study_file(study), study)
        except InputError:
            return  # it is told when it is run
        yield from ((str(path), path) for path in named if not path.is_relative_to(folder))


def _read_in(folder: Path, prefix: str) -> Iterator[tuple[str, Path]]:
    if not folder.is_dir():
        return
    for path in folder.iterdir():
        if path.suffix.lower() in READ and path.name[0] not in ".~" and path.is_file():
            yield prefix + path.name, path
