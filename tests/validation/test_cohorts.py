"""Member `cohorts`, small: killed and on a cluster, a cohort ends with the tables of one left alone."""

from pathlib import Path

import pytest

from scripts.validation.harness import main
from tests.page.browser import chromium


@pytest.mark.slow
def test_kills_do_not_show(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["cohorts", "--parts", "kills", "--kills", "1", "--people", "3", "--folder", str(tmp_path)]) == 0
    assert "met: killed: all tables are the same, bit for bit" in capsys.readouterr().out


@pytest.mark.slow
def test_two_dask_workers_write_the_same(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("distributed", reason="no dask here; it comes with the extra `cluster`")
    assert main(["cohorts", "--parts", "cluster", "--people", "3", "--folder", str(tmp_path)]) == 0
    assert "met: two dask workers: all tables are the same, bit for bit" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.browser
def test_the_page_of_many_is_soon_ready(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    if chromium() is None:
        pytest.skip("no Chromium on this machine")
    assert main(["cohorts", "--parts", "page", "--people", "40", "120", "--folder", str(tmp_path)]) == 0
    assert "met: cohort.html: " in capsys.readouterr().out
