"""`gaitcal example` with the files of the folder of recordings, found by their SHA-256: tests have
no network.

Of several people in an example there is the first.
"""

import csv
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from gaitcal.errors import InputError
from gaitcal.io import examples
from gaitcal.io.examples import Example, RemoteFile

PEOPLE = 1


@contextmanager
def local_examples() -> Iterator[None]:
    """Find the files of an example among the recordings."""
    data = Path(os.environ["GAITCAL_DATA"])
    with (data / "sources.csv").open(encoding="utf-8") as stream:
        held = {row["sha256"]: data / row["file"] for row in csv.DictReader(stream)}

    def copied(file: RemoteFile, target: Path, *_: object) -> None:
        if file.sha256 not in held:
            raise InputError(f"{file.name} is not among the recordings of these tests", source=data)
        target.write_bytes(held[file.sha256].read_bytes())

    named = examples.find_example

    def smaller(name: str) -> Example:
        whole = named(name)
        people = list(dict.fromkeys(Path(file.name).parent for file in whole.files))[:PEOPLE]
        return whole.model_copy(
            update={"files": tuple(f for f in whole.files if Path(f.name).parent in people)}
        )

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(examples, "download", copied)
        patch.setattr(examples, "find_example", smaller)
        yield
