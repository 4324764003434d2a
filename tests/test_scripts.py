"""The scripts are thin programs over the public API: they are imported and run."""

from __future__ import annotations

import importlib
import json
import sys
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).parents[1] / "scripts"


def test_benchmark_runs_a_section_and_writes_its_figures(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.syspath_prepend(str(SCRIPTS))
    benchmark = importlib.import_module("benchmark")
    out = tmp_path / "figures.json"
    benchmark.main(["ip", "inverse-dynamics", "--runs", "1", "--json", str(out)])
    figures = json.loads(out.read_text(encoding="utf-8"))
    assert figures["machine"]["blas_threads"] == 1
    assert all(f["seconds"] > 0 for section in ("ip", "inverse-dynamics") for f in figures[section].values())
    assert "physically consistent" in capsys.readouterr().out


def test_benchmark_refuses_an_unknown_section(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(SCRIPTS))
    benchmark = importlib.import_module("benchmark")
    with pytest.raises(SystemExit) as stopped:
        benchmark.main(["nonsense"])
    assert stopped.value.code == 2
    assert "benchmark" in sys.modules
