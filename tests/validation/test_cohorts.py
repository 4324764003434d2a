"""Member `cohorts`, small: killed and on a cluster, a cohort ends with the tables of one left
alone.
"""

from pathlib import Path

import pytest

from scripts.validation.harness import main
from tests.report.page.browser import chromium


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where all parts work: who has been calibrated is not calibrated again."""
    return tmp_path_factory.mktemp("cohorts")


@pytest.mark.slow
@pytest.mark.parametrize("part, words", [("kills", "killed"), ("cluster", "two dask workers")])
def test_neither_kills_nor_other_workers_show(
    part: str, words: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Both are set beside the same cohort that was left alone."""
    if part == "cluster":
        pytest.importorskip("distributed", reason="no dask here; it comes with the extra `cluster`")
    assert (
        main(["cohorts", "--parts", part, "--kills", "1", "--people", "3", "--folder", str(folder)])
        == 0
    )
    assert f"met: {words}: all tables are the same, bit for bit" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.browser
def test_the_page_of_many_is_soon_ready(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    if chromium() is None:
        pytest.skip("no Chromium on this machine")
    assert (
        main(["cohorts", "--parts", "page", "--people", "40", "120", "--folder", str(folder)]) == 0
    )
    assert "met: cohort.html: " in capsys.readouterr().out
