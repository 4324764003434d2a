"""The tutorials run as they stand, and every file that they leave is described."""

from pathlib import Path

import pytest

from tests.docs.pages import DOCS, follow, needs_recordings
from tests.results.test_described import undescribed_below

PAGES = sorted((DOCS / "tutorials").glob("*.md"))


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES, ids=[page.stem for page in PAGES])
def test_a_tutorial_runs(
    page: Path, kept: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> None:
    if needs_recordings(page):
        request.getfixturevalue("data_dir")
    folder = tmp_path / "reader"
    folder.mkdir()
    monkeypatch.chdir(folder)
    follow(page, folder, tmp_path, kept)
    assert undescribed_below(folder) == []
