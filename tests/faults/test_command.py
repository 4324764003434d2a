"""`gaitcal check` and `gaitcal calibrate --force` on a study that is at fault."""

import json
from pathlib import Path

import pandas as pd
import pytest

from tests.commands import Done, gaitcal
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


def test_sound_study(study: Path) -> None:
    assert gaitcal("check", study).stdout.startswith("0 errors, 0 warnings (-v shows")
    assert "plate to foot" in gaitcal("check", study, "-v").stdout
    assert gaitcal("check", study, "-q") == Done(0, "", "")


def test_table_of_errors(study: Path) -> None:
    spoil(study)
    done = gaitcal("check", study)
    assert (done.returncode, done.stderr) == (1, "")
    assert "exchanged" in done.stdout and "1 errors" in done.stdout
    assert gaitcal("check", study, "-q").returncode == 1


@pytest.mark.slow
def test_force_goes_on_and_says_so(study: Path, tmp_path: Path) -> None:
    spoil(study, "RL")  # what is wrong with one leg alone would leave the other
    with study.open("a", encoding="utf-8") as stream:
        stream.write("jp = false\n")  # under such data joints would be sought for a minute
    result = tmp_path / "result"
    assert gaitcal("calibrate", study, "--out", result).returncode == 1
    assert not result.exists()
    done = gaitcal("calibrate", study, "--out", result, "--force")
    assert done.returncode in (0, 3), "such data may not converge"
    assert "verdict: refused" in done.stdout and "made with --force, past errors" in done.stdout
    told = json.loads((result / "summary.json").read_text(encoding="utf-8"))
    assert (told["verdict"], told["forced"]) == ("refused", True)
    assert any("R.Thigh.Front" in w for w in told["warnings"])
    assert "made with --force, past errors" in (result / "result.html").read_text(encoding="utf-8")
