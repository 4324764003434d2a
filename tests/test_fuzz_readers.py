"""`scripts/fuzz_readers.py` at a small size, and that it would see a failure."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import ModuleType

import pytest

from tests.scripts import script

FILES = 300


@pytest.fixture(scope="module")
def fuzzing() -> ModuleType:
    return script("fuzz_readers")


def test_every_reader_ends_well(fuzzing: ModuleType, tmp_path: Path) -> None:
    kinds = [*fuzzing.made_kinds(tmp_path), *fuzzing.real_kinds()]
    counts = [fuzzing.fuzz(kind, tmp_path, -(-FILES // len(kinds)), 5) for kind in kinds]
    assert sum(c.results + c.errors for c in counts) >= FILES
    assert sum(c.results for c in counts) > FILES // 10  # not all damage is fatal: values are looked at too
    assert [f for c in counts for f in c.failures] == []


def test_a_failure_is_seen(fuzzing: ModuleType, tmp_path: Path) -> None:
    def careless(path: Path) -> object:
        return float(path.read_bytes())

    kind = next(iter(fuzzing.made_kinds(tmp_path)))
    count = fuzzing.fuzz(replace(kind, read=careless), tmp_path, 5, 0)
    assert len(count.failures) == 5 and "ValueError" in count.failures[0]
