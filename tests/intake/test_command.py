"""`gaitcal init`, and `check` and `calibrate` with a folder."""

from pathlib import Path
from types import SimpleNamespace

import pytest

from gaitcal.errors import Code
from gaitcal.study.study import Study
from tests.commands import run
from tests.intake.folders import other_person, recordings, write
from tests.messages import check_text, refuses

WHO = ("--mass", "69.4", "--height", "1.70", "--sex", "male")


@pytest.fixture
def person(tmp_path: Path) -> Path:
    return write(tmp_path / "person", recordings(), forces="grf")


def test_init_writes_what_loads_and_replaces_nothing_unasked(person: Path) -> None:
    said = run("init", person, *WHO).stdout
    check_text(said, "walk.csv")
    study = person / "study.toml"
    assert [t.name for t in Study.load(study).trials] == ["static", "walk"]
    before = study.read_bytes()
    with refuses(Code.FOLDER_TAKEN, source="study.toml"):
        run("init", person, *WHO)
    run("init", person, *WHO, "--force")
    assert study.read_bytes() == before, "the same folder, the same study"
    with refuses(Code.OPTION, "walk.csv", field="--out"):
        run("init", person, "--out", person / "walk.csv", "--force")


def test_missing_fields_are_named(person: Path) -> None:
    with refuses(Code.WHO_IT_IS, "subject.mass_kg", source="study.toml"):
        run("init", person, "--height", 1.7)
    with refuses(Code.MISSING_FIELD, field="subject.mass_kg", source="study.toml"):
        Study.load(person / "study.toml")
    (person / "study.toml").unlink()
    with refuses(Code.WHO_IT_IS, "subject.mass_kg", source="person"):
        run("calibrate", person, "--out", person.parent / "result")
    assert not (person.parent / "result").exists()


@pytest.mark.parametrize(
    ("options", "field"),
    [
        (("--height", "170"), "--height"),
        (("--mass", "0.5"), "--mass"),
        (("--sex", "m"), "--sex"),
        (("--age", "200"), "--age"),
    ],
)
def test_impossible_options(person: Path, options: tuple[str, str], field: str) -> None:
    with refuses(Code.OPTION, field=field):
        run("init", person, *options)


def test_a_folder_with_a_study_uses_it(person: Path) -> None:
    run("init", person, *WHO)
    check_text(run("check", person).stdout)
    with refuses(Code.OPTION, source="study.toml"):
        run("check", person, "--sex", "male")
    (person / "second.toml").write_bytes((person / "study.toml").read_bytes())
    with refuses(Code.FOLDER, "second.toml", "study.toml", 2, source="person"):
        run("check", person)


def test_folders_of_which_no_study_follows(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write(tmp_path / "person", {"walk": recordings()["walk"]})
    for command in (
        ("init", folder),
        ("check", folder),
        ("calibrate", folder, "--out", tmp_path / "r"),
    ):
        with refuses(Code.FOLDER, source="person"):
            run(*command)
    assert not (folder / "study.toml").exists()
    both = recordings("hip_r")
    two = write(
        tmp_path / "two", both | {f"b_{n}": other_person(both[n]) for n in ("static", "walk")}
    )
    with refuses(Code.FOLDER, source="two"):
        run("calibrate", two, "--out", tmp_path / "r", *WHO)


def test_questions_on_a_terminal(person: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    answers = iter(["170", "1.70", "m", "male"])
    terminal = SimpleNamespace(isatty=lambda: True)
    monkeypatch.setattr(
        "gaitcal.cli.study_folder.sys", SimpleNamespace(stdin=terminal, stderr=terminal)
    )
    monkeypatch.setattr("gaitcal.cli.study_folder.typer.prompt", lambda *_, **__: next(answers))
    run("init", person, "--mass", 69.4)
    assert Study.load(person / "study.toml").subject.height == 1.70


@pytest.mark.slow
def test_calibrate_keeps_the_drafted_study_and_leaves_a_faulty_walk_out(tmp_path: Path) -> None:
    folder, result = write(tmp_path / "person", recordings(), forces="grf"), tmp_path / "result"
    said = run("calibrate", folder, "--out", result, *WHO).stdout
    check_text(said, f"{result / 'study.toml'}")
    kept = Study.load(result / "study.toml")
    assert [t.name for t in kept.trials] == ["static", "walk"]
    assert (result / "moments/walk.csv").exists()
    assert "marker set: gait2354" in (result / "result.html").read_text(encoding="utf-8")
    again = run("calibrate", folder, "--out", result, *WHO)
    assert again.exit_code == 0, "the study in the result is ours, and may be replaced"
