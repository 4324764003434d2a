"""`scripts/check_cohort.py`, small: killed and on a cluster, a cohort ends with the tables of one left alone."""

from __future__ import annotations

import importlib
from pathlib import Path

import pytest

from tests.page.browser import chromium

SCRIPTS = Path(__file__).parents[1] / "scripts"


def ended(monkeypatch: pytest.MonkeyPatch, *words: object) -> object:
    monkeypatch.syspath_prepend(str(SCRIPTS))
    with pytest.raises(SystemExit) as end:
        importlib.import_module("check_cohort").main([str(word) for word in words])
    return end.value.code


@pytest.mark.slow
def test_kills_do_not_show(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    assert ended(monkeypatch, "kills", "--kills", 1, "--people", 3, "--folder", tmp_path) == 0
    assert "met: killed: all tables are the same, bit for bit" in capsys.readouterr().out


@pytest.mark.slow
def test_two_dask_workers_write_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("distributed", reason="no dask here; it comes with the extra `cluster`")
    assert ended(monkeypatch, "cluster", "--people", 3, "--folder", tmp_path) == 0
    assert "met: two dask workers: all tables are the same, bit for bit" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.browser
def test_the_page_of_many_is_soon_ready(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if chromium() is None:
        pytest.skip("no Chromium on this machine")
    assert ended(monkeypatch, "page", "--people", 40, 120, "--folder", tmp_path) == 0
    assert "met: cohort.html: " in capsys.readouterr().out
