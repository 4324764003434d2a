"""Tutorials and how-to pages run as they stand, and every file that they leave is described."""

import shutil
from functools import partial
from pathlib import Path
from typing import Any

import pytest

import gaitcal
from tests.docs.pages import DOCS, ROOT, blocks_of, follow, needs_recordings, run
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
    follow(page, folder, kept)
    assert undescribed_below(folder) == []


@pytest.mark.slow
def test_readme_python_runs(kept: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run README's Python block on a folder with standing and walking, and a further walk beside
    it.
    """
    (block,) = [block for block in blocks_of(ROOT / "README.md") if block.language == "python"]
    monkeypatch.chdir(tmp_path)
    person = copied_person(kept, tmp_path / "person", noise=True).parent
    (tmp_path / "FOLDER").mkdir()
    for name in ("static.c3d", "gait.c3d"):
        shutil.copy(person / name, tmp_path / "FOLDER")
    shutil.copy(person / "gait.c3d", tmp_path / "walk2.c3d")
    names: dict[str, Any] = {}
    run(block, tmp_path, names, kept)
    assert names["calibration"].verdict.sentence == names["further"].verdict.sentence
    assert {"time", "knee_angle_r"} <= set(names["angles"].columns)
