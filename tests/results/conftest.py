"""Result folders that a test may change."""

import shutil
from pathlib import Path

import pytest

from tests.kept import kept_result


@pytest.fixture(scope="module")
def made(kept: Path) -> Path:
    """A study and its result; other modules make another one."""
    return kept_result(kept)


@pytest.fixture
def folder(made: Path, tmp_path: Path) -> Path:
    """A copy of it."""
    return Path(shutil.copytree(made, tmp_path / "made"))
