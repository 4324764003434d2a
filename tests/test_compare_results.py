"""The comparison of two result folders: what must be the same, what may differ, and that nothing is passed over."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from scripts.tools import compare_results

ROWS = "time,knee_angle_r\n0.0,10.0\n0.1,{}\n"


@pytest.fixture
def folders(tmp_path: Path) -> tuple[Path, Path]:
    before = tmp_path / "before"
    before.mkdir()
    (before / "walk.csv").write_text(ROWS.format(20.0))
    (before / "summary.json").write_text(json.dumps({"seconds": 1.5, "status": "converged", "rms": 5.5}, indent=1))
    np.savez(before / "splines.npz", nodes=np.arange(4.0), trials=np.array(["walk"]))
    (before / "report.html").write_text("<p>before</p>")
    shutil.copytree(before, tmp_path / "after")
    return before, tmp_path / "after"


def test_the_same_is_the_same_whatever_time_it_took(folders: tuple[Path, Path], capsys: pytest.CaptureFixture) -> None:
    before, after = folders
    (after / "summary.json").write_text(json.dumps({"seconds": 9.0, "status": "converged", "rms": 5.5}, indent=1))
    (after / "walk.csv").write_text(ROWS.format(20.0 * (1 + 1e-10)))
    (after / "report.html").write_text("<p>after</p>")
    assert compare_results.main([str(before), str(after)]) == 0
    assert "1 pages" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("walk.csv", ROWS.format(20.0 * (1 + 1e-8))),
        ("walk.csv", ROWS.format("")),
        ("walk.csv", ROWS.format(20.0).replace("_r", "_l")),
        ("summary.json", json.dumps({"seconds": 1.5, "status": "not converged", "rms": 5.5}, indent=1)),
        ("summary.json", json.dumps({"seconds": 1.5, "status": "converged", "rms": 5.5001}, indent=1)),
    ],
)
def test_other_numbers_gaps_and_words_are_told(folders: tuple[Path, Path], name: str, content: str) -> None:
    before, after = folders
    (after / name).write_text(content)
    (line,) = compare_results.differences(before, after)
    assert line.startswith(f"{name}: ")


def test_arrays_and_missing_files_are_told(folders: tuple[Path, Path]) -> None:
    before, after = folders
    np.savez(after / "splines.npz", nodes=np.arange(4.0) + 1e-6, trials=np.array(["walk"]))
    (after / "walk.csv").unlink()
    lines = list(compare_results.differences(before, after))
    assert [line.split(":")[0] for line in lines] == ["walk.csv", "splines.npz"]
