"""`result.html` of a result and of its further trials: all of them, none mixed up, whatever befalls
the files.
"""

import json
import shutil
from pathlib import Path

import pytest

from gaitcal.cli.console import Console
from gaitcal.cli.view_command import view_result
from gaitcal.errors import InputError, UsageError
from gaitcal.io.result_folder import compute_sha256, read_listed_hashes
from gaitcal.pipeline.write_results import write_results
from gaitcal.report.page.page_data import build_peak_rows, read_page_data
from gaitcal.report.page.page_folder import PAGE, SCENE, read_page, read_result_page
from gaitcal.results.saved_result import OTHER_MODEL
from tests.commands import edited, run, sign
from tests.kept import kept_result, kept_synthetic
from tests.report.page.walked_blocks import held

PAGE_DATA = "page.json"


@pytest.fixture(scope="module")
def made(kept: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A result with one further trial, `walk2`."""
    folder = Path(
        shutil.copytree(kept_result(kept), tmp_path_factory.mktemp("made"), dirs_exist_ok=True)
    )
    assert run("dynamics", folder / "result", trial(folder, "walk2"), "-q").exit_code == 0
    return folder


def trial(folder: Path, name: str) -> Path:
    return Path(shutil.copy(folder / "study/walk.csv", folder / f"study/{name}.csv"))


def trials(page: Path) -> list[str]:
    """Names of the trials in a page; bodies and curves must be of the same."""
    result = held(page.read_text(encoding="utf-8"))
    names = [t["name"] for t in result["scene"]["trials"]]
    assert names == [t["name"] for t in result["sheet"]["trials"]]
    return names


def with_another_model(result: Path) -> None:
    with (result / "model.toml").open("a", encoding="utf-8") as stream:
        stream.write("\n# by hand\n")


def test_a_result_holds_its_page_and_what_it_is_made_of(folder: Path) -> None:
    result = folder / "result"
    assert {PAGE, PAGE_DATA, SCENE} <= set(read_listed_hashes(result))
    assert not (result / "figures").exists()
    assert trials(result / PAGE) == ["walk"]
    shown = held((result / PAGE).read_text(encoding="utf-8"))
    data = read_page_data(result / PAGE_DATA)
    assert shown["sheet"] == {**data, "peaks": build_peak_rows(data)}
    assert {PAGE, PAGE_DATA, SCENE} <= set(read_listed_hashes(result / "dynamics"))
    assert trials(result / "dynamics" / PAGE) == ["walk2"]


def test_further_trials_tell_of_the_model_behind_them(folder: Path) -> None:
    sheet = read_page_data(folder / "result/dynamics" / PAGE_DATA)
    assert len(sheet["lines"]) == 3 and sheet["lines"][1]["text"].startswith("Marker fit ")
    whole = json.dumps(sheet["sections"]["provenance"])
    assert "from walk. It is not fitted again to these trials. Verdict on it: " in whole
    assert "was edited since" not in whole
    assert (
        sheet["sections"]["joints"][1:]
        == read_page_data(folder / "result" / PAGE_DATA)["sections"]["joints"]
    )
    assert "walk2.csv" in json.dumps(sheet["trials"][0]["sections"]["provenance"])
    with_another_model(folder / "result")
    assert run("dynamics", folder / "result", trial(folder, "walk3"), "-q").exit_code == 0
    sheet = read_page_data(folder / "result/dynamics" / PAGE_DATA)
    assert [line["text"][:6] for line in sheet["lines"]][2] == "walk3:"
    assert "was edited since" in json.dumps(sheet["sections"]["provenance"])


@pytest.mark.slow
def test_two_runs_write_the_same_bytes(kept: Path, tmp_path: Path) -> None:
    calibration = kept_synthetic(kept)
    folders = [write_results(calibration, tmp_path / name) for name in ("one", "two")]
    assert len({compute_sha256(folder / SCENE) for folder in folders}) == 1
    one, two = (read_page_data(folder / PAGE_DATA) for folder in folders)
    assert one | {"made": ""} == two | {"made": ""}
    assert list(one) == list(two)
    pages = [(folder / PAGE).read_text(encoding="utf-8") for folder in folders]
    assert pages[0].replace(one["made"], "") == pages[1].replace(two["made"], "")


# ----------------------------------------------------------------------------------- further trials


@pytest.mark.slow
def test_the_page_of_further_trials_has_those_of_every_run(folder: Path) -> None:
    result = folder / "result"
    page = result / "dynamics" / PAGE
    before = read_page(result / "dynamics")
    run("dynamics", result, trial(folder, "walk3"), "-q")
    assert trials(page) == ["walk2", "walk3"]
    after = read_page(result / "dynamics")
    assert after.data["trials"][0] == before.data["trials"][0]
    assert after.scene.trials[0].origins.tobytes() == before.scene.trials[0].origins.tobytes()
    run("dynamics", result, folder / "study/walk2.csv", "-q")
    assert trials(page) == ["walk3", "walk2"], "as in summary.json"
    summary = json.loads((result / "dynamics/summary.json").read_text(encoding="utf-8"))
    assert list(summary["trials"]) == ["walk3", "walk2"]


def test_its_verdict_is_on_all_of_them(folder: Path) -> None:
    result = folder / "result"
    with edited(result / "dynamics", PAGE_DATA) as sheet:
        sheet["verdict"]["reasons"] = [
            {
                "severity": "error",
                "cause": "odd",
                "evidence": "",
                "action": "",
                "trials": [name],
                "leg": "r",
            }
            for name in ("walk2", "gone")
        ]
        sheet["trials"][0]["verdict"] = {
            "judgement": "doubtful",
            "r": "refused",
            "l": "trustworthy",
        }
    run("dynamics", result, trial(folder, "walk3"), "-q")
    verdict = read_page_data(result / "dynamics" / PAGE_DATA)["verdict"]
    assert verdict["judgement"] == "doubtful"
    assert [reason["trials"] for reason in verdict["reasons"] if reason["cause"] == "odd"] == [
        ["walk2"]
    ]
    assert verdict["sentence"].endswith("Refused: the right leg of walk2.")


@pytest.mark.slow
def test_trials_of_another_model_stay_and_are_told(folder: Path) -> None:
    result = folder / "result"
    with_another_model(result)
    told = f"walk2: {OTHER_MODEL}; run it again"
    assert told in run("view", result, "--html", folder / "own.html").stdout
    shown = held((folder / "own.html").read_text(encoding="utf-8"))
    assert shown["sheet"]["verdict"]["judgement"] == "doubtful"
    assert ["walk2"] in [reason["trials"] for reason in shown["sheet"]["verdict"]["reasons"]]

    def of_another_model() -> tuple[list[list[str]], list[str]]:
        """Trials of such reasons on the page, and warnings of the summary."""
        reasons = read_page_data(result / "dynamics" / PAGE_DATA)["verdict"]["reasons"]
        warnings = json.loads((result / "dynamics/summary.json").read_text(encoding="utf-8"))[
            "warnings"
        ]
        return [r["trials"] for r in reasons if r["cause"] == OTHER_MODEL], [
            w for w in warnings if OTHER_MODEL in w
        ]

    for _ in range(2):
        assert told in run("dynamics", result, trial(folder, "walk3")).stdout
        assert of_another_model() == ([["walk2"]], [told])
    assert told not in run("dynamics", result, folder / "study/walk2.csv").stdout
    assert of_another_model() == ([], [])


@pytest.mark.slow
@pytest.mark.parametrize("name", [PAGE_DATA, SCENE])
def test_a_damaged_page_is_told_and_begun_anew(name: str, folder: Path) -> None:
    result = folder / "result"
    path = result / "dynamics" / name
    path.write_bytes(path.read_bytes()[:-1])
    told = run("view", result, "--html", folder / "own.html").stdout
    assert "its page is missing or damaged; run its trials again to see them" in told
    assert trials(folder / "own.html") == ["walk"]
    told = run("dynamics", result, trial(folder, "walk3")).stdout
    assert (
        f"warning: walk2: {name} is damaged, or was edited: not as gaitcal wrote it: the page "
        "omits this trial" in told
    )
    assert trials(result / "dynamics" / PAGE) == ["walk3"]
    assert (result / "dynamics/motion/walk2.csv").exists(), "its tables stay"
    assert "omits this trial" not in run("dynamics", result, folder / "study/walk2.csv").stdout
    assert trials(result / "dynamics" / PAGE) == ["walk3", "walk2"]


# --------------------------------------------------------------------------------------------- view


def test_the_view_of_a_result_has_all_of_its_trials(folder: Path) -> None:
    result = folder / "result"
    run("dynamics", result, folder / "study/walk.csv", "-q")
    run("view", result, "--html", folder / "own.html")
    assert trials(folder / "own.html") == ["walk", "walk2", "walk (dynamics)"]
    shown, lines = read_result_page(result)
    assert lines == () and [t.name for t in shown.scene.trials] == trials(folder / "own.html")
    run("view", result / "dynamics", "--html", folder / "own.html")
    assert trials(folder / "own.html") == ["walk2", "walk"]


def test_the_view_of_two_results_is_their_comparison(folder: Path) -> None:
    other = folder / "later"
    shutil.copytree(folder / "result", other)
    run("view", folder / "result", other, "--html", folder / "own.html")
    run("compare", folder / "result", other, "--out", folder / "comparison", "-q")
    assert (folder / "own.html").read_text() == (folder / "comparison/comparison.html").read_text()
    with pytest.raises(UsageError, match="--geometry: found with two results"):
        view_result(Console(quiet=True, verbose=False), folder / "result", other, geometry=folder)


def test_a_sheet_of_other_trials_than_its_scene_is_refused(folder: Path) -> None:
    result = folder / "result"
    shutil.copy(result / "dynamics" / PAGE_DATA, result / PAGE_DATA)
    sign(result)
    with pytest.raises(InputError, match="has other trials"):
        run("view", result, "--html", folder / "own.html")
