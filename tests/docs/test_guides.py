"""Tutorials and how-to pages run as they stand, and every file that they leave is described."""

from functools import partial
from pathlib import Path

import pytest

import gaitcal
from tests.docs.pages import DOCS, follow, needs_recordings
from tests.kept import copied_person
from tests.results.test_described import undescribed_below

PAGES = [page for room in ("tutorials", "how-to") for page in sorted((DOCS / room).glob("*.md"))]


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES, ids=[f"{page.parent.name}/{page.stem}" for page in PAGES])
def test_a_page_runs(
    page: Path,
    kept: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    request: pytest.FixtureRequest,
) -> None:
    if page.stem == "python":
        pytest.importorskip("xarray", reason="no xarray here; it comes with the extra `test`")
    if needs_recordings(page):
        request.getfixturevalue("data_dir")
    monkeypatch.setattr(gaitcal, "synthesize", partial(copied_person, kept))
    folder = tmp_path / "reader"
    folder.mkdir()
    monkeypatch.chdir(folder)
    follow(page, folder, tmp_path, kept)
    assert undescribed_below(folder) == []
