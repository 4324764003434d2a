"""`gaitcal check` and `gaitcal calibrate --force` on a study that is at fault."""

import json
from pathlib import Path

import pandas as pd
import pytest

from gaitcal.errors import Code
from tests.commands import Done, gaitcal
from tests.messages import check_text
from tests.synthetic_studies import write_synthetic_study


@pytest.fixture
def study(tmp_path: Path) -> Path:
    return write_synthetic_study(tmp_path / "study")


def spoil(study: Path, sides: str = "R") -> None:
    """Swap two markers of two segments of a leg throughout."""
    table = pd.read_csv(study.parent / "walk.csv")
    swap = [(f"{s}.{one}", f"{s}.{other}") for s in sides for one, other in (PAIR, PAIR[::-1])]
    names = {f"{a}_{axis}": f"{b}_{axis}" for a, b in swap for axis in "xyz"}
    table.rename(columns=names).to_csv(study.parent / "walk.csv", index=False)


PAIR = ("Thigh.Front", "Shank.Front")


def test_sound_study(study: Path) -> None:
    check_text(gaitcal("check", study).stdout, 0)
    assert len(gaitcal("check", study, "-v").stdout) > len(gaitcal("check", study).stdout)
    assert gaitcal("check", study, "-q") == Done(0, "", "")


def test_table_of_errors(study: Path) -> None:
    spoil(study)
    done = gaitcal("check", study)
    assert (done.returncode, done.stderr) == (1, "")
    assert Code.EXCHANGED_LABELS.value in done.stdout
    check_text(done.stdout, 1)
    assert gaitcal("check", study, "-q").returncode == 1


@pytest.mark.slow
def test_refused_walk_is_left_out_of_the_study(study: Path, tmp_path: Path) -> None:
    sound = (study.parent / "walk.csv").read_bytes()
    spoil(study, "RL")
    (study.parent / "again.csv").write_bytes(sound)
    text = study.read_text(encoding="utf-8")
    walk = next(block for block in text.split("[[trial]]") if 'name = "walk"' in block).partition(
        "\n["
    )[0]
    again = walk.replace('name = "walk"', 'name = "again"').replace("walk.csv", "again.csv")
    study.write_text(f"{text}jp = false\n\n[[trial]]{again}\n", encoding="utf-8")
    done = gaitcal("calibrate", study, "--out", tmp_path / "result")
    assert done.returncode == 0, done
    _, after = done.stdout.split("verdict:")  # where readers end
    assert "R.Thigh.Front" in after
    reported = json.loads((tmp_path / "result" / "summary.json").read_text(encoding="utf-8"))
    assert "again" in reported["trials"] and "walk" not in reported["trials"]
    assert any("'walk'" in note for note in reported["notes"])


@pytest.mark.slow
def test_force_continues_with_a_note(study: Path, tmp_path: Path) -> None:
    spoil(study, "RL")  # what is wrong with one leg alone would leave the other
    with study.open("a", encoding="utf-8") as stream:
        stream.write("jp = false\n")  # under such data joints would be sought for a minute
    result = tmp_path / "result"
    assert gaitcal("calibrate", study, "--out", result).returncode == 1
    assert not result.exists()
    done = gaitcal("calibrate", study, "--out", result, "--force")
    assert done.returncode in (0, 3), "such data may not converge"
    reported = json.loads((result / "summary.json").read_text(encoding="utf-8"))
    assert (reported["verdict"], reported["forced"]) == ("refused", True)
    assert any("R.Thigh.Front" in w for w in reported["warnings"])
    page = (result / "result.html").read_text(encoding="utf-8")
    assert "--force" in done.stdout and "--force" in page
