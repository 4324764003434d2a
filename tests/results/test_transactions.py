"""A result folder is changed by one command at a time, from files that are whole and still are what
was read.
"""

import json
import shutil
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

import gaitcal.pipeline.write_trials as trials_module
from gaitcal.analysis import trial_result
from gaitcal.cli import export_commands
from gaitcal.cli import montecarlo_command as montecarlo_command
from gaitcal.errors import Code, InputError
from gaitcal.io.result_folder import compute_sha256, lock_result, read_listed_hashes
from gaitcal.pipeline import run_study
from gaitcal.results.saved_result import load_result
from gaitcal.study import study as study_module
from gaitcal.study.study import Study
from tests.commands import content, run
from tests.kept import kept_result
from tests.messages import check_text, refuses

DRAWS = ("--vary", "jp", "--levels", 100, "--draws", 2, "--jobs", 1)


@pytest.fixture(scope="module")
def made(kept: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = Path(
        shutil.copytree(kept_result(kept), tmp_path_factory.mktemp("made"), dirs_exist_ok=True)
    )
    assert run("dynamics", folder / "result", folder / "study/walk.csv", "-q").exit_code == 0
    return folder


def second_trial(folder: Path) -> Path:
    return Path(shutil.copy(folder / "study/walk.csv", folder / "study/walk2.csv"))


def spoil(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


def edit(path: Path) -> None:
    with path.open("a", encoding="utf-8") as stream:
        stream.write("\n# by hand\n")


def last_digit(path: Path) -> None:
    data = path.read_bytes().rstrip()
    path.write_bytes(data[:-1] + (b"1" if data[-1:] != b"1" else b"2"))


def after(function: Callable[..., object], then: Callable[[], object]) -> Callable[..., object]:
    def both(*words: object, **more: object) -> object:
        found = function(*words, **more)
        then()
        return found

    return both


def test_no_other_command_comes_between_reading_and_writing(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[str] = []

    def other() -> None:
        try:
            with lock_result(folder / "result", wait_s=0.0):
                told.append("came between")
        except InputError as error:
            told.append(str(error))

    def between() -> None:
        thread = threading.Thread(target=other)
        thread.start()
        thread.join()

    monkeypatch.setattr(
        trials_module, "summarise_trial", after(trials_module.summarise_trial, between)
    )
    assert run("dynamics", folder / "result", second_trial(folder)).exit_code == 0
    assert told
    assert all("is being written by another process" in line for line in told)
    summary = json.loads((folder / "result/dynamics/summary.json").read_text(encoding="utf-8"))
    assert list(summary["trials"]) == ["walk", "walk2"]


@pytest.mark.parametrize("name", ["model.toml", "marker_set.toml"])
def test_dynamics_of_a_model_that_changes_meanwhile(
    name: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = content(folder / "result/dynamics")
    path = folder / "result" / name
    monkeypatch.setattr(trial_result, "analyse", after(trial_result.analyse, lambda: edit(path)))
    with refuses(Code.CHANGED_FILE, name):
        run("dynamics", folder / "result", second_trial(folder))
    assert content(folder / "result/dynamics") == before


def test_export_of_a_model_that_changes_meanwhile(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write, name = export_commands.WRITERS["urdf"]
    changing = after(write, lambda: edit(folder / "result/model.toml"))
    monkeypatch.setitem(export_commands.WRITERS, "urdf", (changing, name))
    with refuses(Code.CHANGED_FILE):
        run("export", folder / "result")
    assert not (folder / "result/export").exists()


@pytest.mark.slow
def test_draws_of_a_model_that_changes_meanwhile(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    changing = after(montecarlo_command.monte_carlo, lambda: edit(folder / "result/model.toml"))
    monkeypatch.setattr(montecarlo_command, "monte_carlo", changing)
    monkeypatch.setattr(montecarlo_command, "write_monte_carlo_figures", lambda *a: {})
    page = (folder / "result/result.html").read_bytes()
    with refuses(Code.CHANGED_FILE):
        run("montecarlo", folder / "result", *DRAWS)
    assert not (folder / "result/montecarlo/contributions.csv").exists()
    assert (folder / "result/result.html").read_bytes() == page


@pytest.mark.slow
def test_inputs_that_change_while_calibrating_are_told(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = folder / "study/walk.csv"
    was = compute_sha256(path)
    monkeypatch.setattr(
        run_study,
        "calibrate_preprocessed",
        after(run_study.calibrate_preprocessed, lambda: edit(path)),
    )
    told = run("calibrate", folder / "study/study.toml", "--out", folder / "new").stdout
    check_text(told, "walk.csv")
    manifest = json.loads((folder / "new/manifest.json").read_text(encoding="utf-8"))
    assert manifest["inputs_sha256"]["walk.csv"] == was
    assert manifest["inputs_changed_while_it_ran"] == ["walk.csv"]


@pytest.mark.parametrize("name", ["walk.csv", "study.toml"])
def test_inputs_that_change_while_they_are_read(
    name: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = folder / "study" / name
    change = edit if name == "study.toml" else last_digit
    monkeypatch.setattr(
        study_module, "read_trial", after(study_module.read_trial, lambda: change(path))
    )
    with refuses(Code.CHANGED_FILE, name, source="study.toml"):
        Study.load(folder / "study/study.toml")


def test_inputs_of_one_name_in_two_folders_both_count(folder: Path) -> None:
    for day in ("monday", "tuesday"):
        (folder / day).mkdir()
    shutil.move(folder / "study/walk.csv", folder / "monday/trial.csv")
    shutil.move(folder / "study/static.csv", folder / "tuesday/trial.csv")
    path = folder / "study/study.toml"
    text = path.read_text(encoding="utf-8").replace('"walk.csv"', '"../monday/trial.csv"')
    path.write_text(text.replace('"static.csv"', '"../tuesday/trial.csv"'), encoding="utf-8")
    study = Study.load(path)
    assert {"trial.csv", "monday/trial.csv"} <= set(study.inputs)
    assert study.changed_inputs() == ()
    edit(folder / "monday/trial.csv")
    assert study.changed_inputs() == ("monday/trial.csv",)


def test_a_damaged_file_of_the_result_is_named_by_every_command(folder: Path) -> None:
    result, trial = folder / "result", folder / "study/walk.csv"
    commands: dict[str, tuple[object, ...]] = {
        "uncertainty.npz": ("dynamics", result, trial),
        "splines.npz": ("montecarlo", result, *DRAWS),
        "marker_errors/walk.csv": ("montecarlo", result, *DRAWS),
        "scene.npz": ("view", result, "--html", folder / "view.html"),
    }
    for name, words in commands.items():
        sound = (result / name).read_bytes()
        spoil(result / name)
        with refuses(Code.DAMAGED_RESULT, name):
            run(*words)
        (result / name).write_bytes(sound)
    spoil(result / "manifest.json")
    for words in (*commands.values(), ("export", result)):
        with refuses(Code.DAMAGED_RESULT, source="manifest.json"):
            run(*words)


def test_an_edited_model_is_told_with_every_result_of_it(folder: Path) -> None:
    result = folder / "result"
    edit(result / "model.toml")
    words = (
        "model.toml is not as 'gaitcal calibrate' wrote it: these results are of the edited file"
    )
    assert load_result(result).files.edited == ("model.toml",)
    assert words in run("dynamics", result, second_trial(folder)).stdout
    summary = json.loads((result / "dynamics/summary.json").read_text(encoding="utf-8"))
    assert any(line.startswith("walk2: ") and words in line for line in summary["warnings"])
    assert words in run("export", result).stdout


@pytest.mark.slow
def test_a_damaged_further_trial_is_named_until_it_is_made_again(folder: Path) -> None:
    result, damaged = folder / "result", folder / "result/dynamics/motion/walk.csv"
    spoil(damaged)
    told = (
        "warning: walk: motion/walk.csv is damaged, or was edited: not as gaitcal wrote it; run it "
        "again"
    )
    for _ in range(2):
        assert told in run("dynamics", result, second_trial(folder)).stdout
        assert read_listed_hashes(result / "dynamics")["motion/walk.csv"] != compute_sha256(damaged)
    assert "is damaged" not in run("dynamics", result, folder / "study/walk.csv").stdout
    assert all(
        compute_sha256(result / "dynamics" / name) == digest
        for name, digest in read_listed_hashes(result / "dynamics").items()
    )
    spoil(result / "dynamics/summary.json")
    before = content(result / "dynamics")
    with refuses(Code.DAMAGED_RESULT, source="summary.json"):
        run("dynamics", result, second_trial(folder))
    assert content(result / "dynamics") == before


def test_what_commands_change_in_a_result_is_listed_anew(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = folder / "result"
    monkeypatch.setattr(montecarlo_command, "write_monte_carlo_figures", lambda *a: {})
    page = (result / "result.html").read_bytes()
    assert "preset Trust" in run("montecarlo", result, *DRAWS).stdout
    assert (result / "result.html").read_bytes() != page
    (result / "result.html").write_text("old")
    run("view", result, "--html", result / "result.html")
    hashes = read_listed_hashes(result)
    assert {"result.html", "page.json", "model.toml"} <= set(hashes)
    assert all(compute_sha256(result / name) == digest for name, digest in hashes.items())
    assert not list(result.rglob(".gaitcal-*")) and not list(folder.glob(".gaitcal-*"))
