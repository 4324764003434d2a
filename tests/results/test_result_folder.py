"""Commands that meet folders of earlier commands: nothing of the user's is lost, and what is old is told."""

import json
import shutil
from pathlib import Path

import pytest

from gaitcal.errors import InputError
from tests.commands import content, run
from tests.kept import copied_person, kept_result

DRAWS = ("--vary", "jp", "--levels", 100, "--draws", 4, "--jobs", 1)


@pytest.fixture(scope="module")
def made(kept: Path) -> Path:
    """A study and its result."""
    return kept_result(kept)


@pytest.fixture
def folder(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "made"))


@pytest.mark.slow
def test_a_study_is_never_replaced_by_its_result(kept: Path, folder: Path, tmp_path: Path) -> None:
    for out in (folder / "study", folder):
        before = content(out)
        with pytest.raises(InputError, match="study.toml', an input of this run"):
            run("calibrate", folder / "study/study.toml", "--out", out)
        assert content(out) == before
    synthetic = tmp_path / "S"
    copied_person(kept, synthetic)
    before = content(synthetic)
    with pytest.raises(InputError, match="an input of this run"):
        run("calibrate", synthetic / "study.toml", "--out", synthetic)
    with pytest.raises(InputError, match="kind of result .synthetic study, this would be calibration."):
        run("calibrate", folder / "study/study.toml", "--out", synthetic)
    with pytest.raises(InputError, match="kind of result .calibration, this would be synthetic study."):
        run("synthesize", "--out", folder / "result")
    with pytest.raises(InputError, match="kind of result .synthetic study, this would be reproduction."):
        run("reproduce", "--out", synthetic)
    with pytest.raises(InputError, match="kind of result .synthetic study, this would be further trials."):
        run("dynamics", folder / "result", folder / "study/walk.csv", "--out", synthetic)
    assert content(synthetic) == before
    demo = tmp_path / "demo"
    (demo / "result").mkdir(parents=True)
    (demo / "result/thesis.tex").touch()
    with pytest.raises(InputError, match="thesis.tex"):
        run("demo", "--out", demo)
    assert sorted(content(demo)) == ["result/thesis.tex"]


def test_refused_before_the_work(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (folder / "result/mynotes.txt").touch()
    monkeypatch.setattr("gaitcal.session.calibrate.calibrate", None)
    with pytest.raises(InputError, match="holds 'mynotes.txt'"):
        run("calibrate", folder / "study/study.toml", "--out", folder / "result")


@pytest.mark.slow
def test_another_calibration_keeps_draws_and_further_trials_and_says_so(folder: Path) -> None:
    study, result = folder / "study/study.toml", folder / "result"
    more = folder / "study/walk.csv", "--forces", folder / "study/walk_forces.csv"
    assert run("dynamics", result, *more).exit_code == 0
    assert run("montecarlo", result, *DRAWS, "-q").exit_code == 0
    assert run("export", result, "--format", "urdf").exit_code == 0
    kept = {name: content(result / name) for name in ("montecarlo", "dynamics", "export")}
    told = run("calibrate", study, "--out", result).stdout
    assert "kept from the earlier result, made with its model: dynamics, export, montecarlo" in told
    assert {name: content(result / name) for name in kept} == kept
    assert "of which 0 in this run" in run("montecarlo", result, *DRAWS).stdout, "the same model: the draws go on"
    study.write_text(study.read_text(encoding="utf-8").replace("mass_kg = 69.4", "mass_kg = 70.0"), encoding="utf-8")
    assert run("calibrate", study, "--out", result, "--force", "-q").exit_code == 0
    assert content(result / "dynamics") == kept["dynamics"]
    for words in (DRAWS, ("--expect", 4)):
        with pytest.raises(InputError, match="made with other .*inertial parameters.* remove the folder"):
            run("montecarlo", result, *words)


@pytest.mark.slow
def test_further_trials_join_those_that_are_there(folder: Path) -> None:
    result, first = folder / "result", folder / "study/walk.csv"
    for name in ("walk2", "walk3"):
        shutil.copy(first, folder / "study" / f"{name}.csv")
    forces = ("--forces", folder / "study/walk_forces.csv")
    run("dynamics", result, folder / "study/walk2.csv", *forces)
    before = content(result / "dynamics")
    run("dynamics", result, folder / "study/walk3.csv")
    now = content(result / "dynamics")
    assert {name: now[name] for name in before if "walk2" in name} == {n: t for n, t in before.items() if "walk2" in n}
    summary = json.loads(now["summary.json"])
    assert list(summary["trials"]) == ["walk2", "walk3"]
    assert summary["trials"]["walk2"] == json.loads(before["summary.json"])["trials"]["walk2"]
    assert any(note.startswith("walk2: ") for note in summary["notes"])
    assert "moments/walk2.csv" in now and "moments/walk3.csv" not in now

    assert (result / "model.toml").read_text(encoding="utf-8").count("\n")
    with (result / "model.toml").open("a", encoding="utf-8") as stream:
        stream.write("\n# edited\n")
    told = run("dynamics", result, folder / "study/walk2.csv").stdout  # without forces now
    now = content(result / "dynamics")
    assert "moments/walk2.csv" not in now, "an earlier run's torques do not stay beside the new motion"
    assert "warning: walk3: made by an earlier run with another model" in told
    summary = json.loads(now["summary.json"])
    assert [w for w in summary["warnings"] if "another model" in w] == [
        "walk3: made by an earlier run with another model than model.toml now is; run it again"
    ]
    run("dynamics", result, folder / "study/walk3.csv")
    assert not any("another model" in w for w in json.loads(content(result / "dynamics")["summary.json"])["warnings"])
    (result / "dynamics/notes.txt").touch()
    with pytest.raises(InputError, match="holds 'notes.txt'"):
        run("dynamics", result, folder / "study/walk3.csv")
