"""What the result of a person depends on, as one SHA-256: files, what is said, settings, version."""

from __future__ import annotations

import hashlib
import json

from gaitcal.cohort.inputs import inputs_of
from gaitcal.cohort.one_person import CommonSettings
from gaitcal.cohort.people import CohortPerson
from gaitcal.files.package_data import package_version
from gaitcal.files.snapshot import sha256_of

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
