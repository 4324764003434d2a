"""Damaged files end in a result or in one clear error: never in another exception, a hang or a dead
process.

`python -m scripts.validation readers` does this with thousands of files; here at a small size, and
that it would see a failure.
"""

from pathlib import Path
from typing import Any

import pytest

from gaitcal.io.c3d import reader as parser
from scripts.validation import readers as fuzzing

FEW, MANY = 10, 40
RECORDINGS = ("markers .c3d", "markers .trc", "markers .csv", "forces .mot", "forces .csv")
REAL = ("real TYPE-1.C3D", "real TYPE-4.C3D", "real Eb015vi.c3d")


@pytest.fixture(autouse=True)
def short_patience(monkeypatch: pytest.MonkeyPatch) -> None:
    """Some damage makes the C3D parser loop; one second shows that as well as six."""
    monkeypatch.setattr(parser, "BASE_SECONDS", 1.0)


@pytest.fixture
def kinds(tmp_path: Path) -> dict[str, Any]:
    return {kind.name: kind for kind in (*fuzzing.made_kinds(tmp_path), *fuzzing.real_kinds())}


@pytest.mark.slow
@pytest.mark.parametrize("name", [*RECORDINGS, *REAL])
def test_recordings(
    kinds: dict[str, Any], tmp_path: Path, name: str, request: pytest.FixtureRequest
) -> None:
    if name in REAL:
        request.getfixturevalue("data_dir")
    count = fuzzing.fuzz(kinds[name], tmp_path, MANY, 5)
    assert count.failures == []
    assert count.results > 0  # not all damage is fatal: values are looked at too
    assert count.errors > 0


@pytest.mark.slow
def test_every_other_reader(kinds: dict[str, Any], tmp_path: Path) -> None:
    others = [kind for name, kind in kinds.items() if name not in (*RECORDINGS, *REAL)]
    counts = [fuzzing.fuzz(kind, tmp_path, FEW, 5) for kind in others]
    assert [failure for count in counts for failure in count.failures] == []
    assert sum(count.results for count in counts) > len(others)
