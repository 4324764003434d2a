"""`gaitcal check` and `gaitcal calibrate --force` on a study that is at fault."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pandas as pd
import pytest

from gaitcal import cli
from tests.synthetic_studies import write_synthetic_study


@pytest.fixture
def study(tmp_path: Path) -> Path:
    return write_synthetic_study(tmp_path / "study")


def spoil(study: Path, sides: str = "R") -> None:
    """The trajectories of two markers in two segments of a leg under each other's label, all the time."""
    table = pd.read_csv(study.parent / "walk.csv")
    swap = [(f"{s}.{one}", f"{s}.{other}") for s in sides for one, other in (PAIR, PAIR[::-1])]
    names = {f"{a}_{axis}": f"{b}_{axis}" for a, b in swap for axis in "xyz"}
    table.rename(columns=names).to_csv(study.parent / "walk.csv", index=False)


PAIR = ("Thigh.Front", "Shank.Front")


def run(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    monkeypatch.setattr(sys, "argv", ["gaitcal", *map(str, arguments)])
    with pytest.raises(SystemExit) as ending:
        cli.main()
    return int(ending.value.code or 0)


def test_sound_study(study: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(monkeypatch, "check", study) == 0
    assert capsys.readouterr().out.startswith("0 errors, 0 warnings (-v shows")
    assert run(monkeypatch, "check", study, "-v") == 0
    assert "plate to foot" in capsys.readouterr().out
    assert run(monkeypatch, "check", study, "-q") == 0
    assert capsys.readouterr().out == ""


def test_table_of_errors(study: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    spoil(study)
    assert run(monkeypatch, "check", study) == 1
    printed = capsys.readouterr()
    assert "exchanged" in printed.out and "1 errors" in printed.out
    assert printed.err == ""
    assert run(monkeypatch, "check", study, "-q") == 1


@pytest.mark.slow
def test_force_goes_on_and_says_so(
    study: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    spoil(study, "RL")  # what is wrong with one leg alone would leave the other
    with study.open("a", encoding="utf-8") as stream:
        stream.write("jp = false\n")  # under such data joints would be sought for a minute
    result = tmp_path / "result"
    assert run(monkeypatch, "calibrate", study, "--out", result) == 1
    assert not result.exists()
    capsys.readouterr()
    assert run(monkeypatch, "calibrate", study, "--out", result, "--force") in (0, 3)  # such data may not converge
    printed = capsys.readouterr().out
    assert "verdict: refused" in printed and "made with --force, past errors" in printed
    told = json.loads((result / "summary.json").read_text(encoding="utf-8"))
    assert (told["verdict"], told["forced"]) == ("refused", True)
    assert any("R.Thigh.Front" in w for w in told["warnings"])
    assert "made with --force, past errors" in (result / "result.html").read_text(encoding="utf-8")
