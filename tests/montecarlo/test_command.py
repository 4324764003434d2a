"""`gaitcal montecarlo`: what it writes and prints, and what it refuses."""

import json
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from gaitcal.errors import ConvergenceError, UsageError
from gaitcal.io.snapshot import Snapshot
from gaitcal.montecarlo.case import MonteCarloCase
from gaitcal.montecarlo.protocol import MonteCarloSettings, ParameterChoice
from gaitcal.report.page.monte_carlo_sections import PART
from gaitcal.report.page.page_data import PAGE_DATA, build_calibration_page_data, read_page_data
from gaitcal.report.page.page_folder import PAGE, SCENE, write_page
from tests import commands
from tests.fake_result import fake_calibration
from tests.refusal import refusal
from tests.report.page.people import walking_scene

NO_TRIALS = [
    {"name": trial.name, "curves": [], "every": 1, "strides": []}
    for trial in walking_scene().trials
]
"""Nothing is drawn here."""


@pytest.fixture(autouse=True)
def _nominal(case: MonteCarloCase, monkeypatch: pytest.MonkeyPatch) -> None:
    """The folder holds the nominal subject; figures have a test of their own."""
    monkeypatch.setattr(
        "gaitcal.cli.montecarlo_command.read_case",
        lambda folder, trial, step: (case, Snapshot(Path(folder), {})),
    )
    monkeypatch.setattr("gaitcal.cli.montecarlo_command.write_monte_carlo_figures", lambda *a: None)


def run(*words: object) -> str:
    found = commands.run("montecarlo", *words)
    assert found.exit_code == 0
    return found.stdout


@pytest.mark.slow
def test_a_study_and_its_tables(tmp_path: Path) -> None:
    small = ("--draws", 3, "--levels", "50,100", "--jobs", 1)
    output = run(tmp_path, *small, "--grf", "foot")
    for words in (
        "carried with the foot",
        "draws: 24, of which 24 in this run and 0 not converged",
    ):
        assert words in output
    assert "left out of" not in output
    table = pd.read_csv(tmp_path / "montecarlo" / "montecarlo.csv")
    assert set(table["grf"].dropna()) == {"lab", "foot"}
    assert (tmp_path / "montecarlo" / "contributions.csv").exists()
    assert "of which 0 in this run" in run(tmp_path, *small)
    expected = run(tmp_path, "--expect", 4)
    assert (
        "a marker RMS of 4 mm corresponds to JP at" in expected
        and "corresponds to NP at" in expected
    )
    assert run(tmp_path, *small, "-q") == ""
    assert "seed = 0, not 4" in refusal(run, tmp_path, *small, "--seed", 4)


@pytest.mark.slow
def test_the_page_beside_it_gets_the_study(case: MonteCarloCase, tmp_path: Path) -> None:
    small = ("--draws", 2, "--levels", "100", "--vary", "jp", "--jobs", 1)
    assert "page:" not in run(tmp_path, *small)
    whole = fake_calibration()
    write_page(
        tmp_path, walking_scene(), build_calibration_page_data(whole) | {"trials": NO_TRIALS}
    )
    scene = (tmp_path / SCENE).read_bytes()
    assert f"page: {tmp_path / PAGE}, preset Trust" in run(tmp_path, *small)
    before, own = trust(tmp_path)
    assert own
    summary = {
        "trials": {
            case.name: {"rms_mm": {"calibrated": 9.0}, "pelvis_and_legs_mm": {"calibrated": 5.8}}
        }
    }
    (tmp_path / "summary.json").write_text(json.dumps(summary), encoding="utf-8")
    run(tmp_path, *small)
    after, own = trust(tmp_path)
    assert after == before and "5.8 mm" in json.dumps(own)
    assert "5.8 mm" in (tmp_path / PAGE).read_text(encoding="utf-8")
    assert (tmp_path / SCENE).read_bytes() == scene
    (tmp_path / PAGE_DATA).write_text("{}", encoding="utf-8")
    assert "warning: the page was not updated: " in (output := run(tmp_path, *small))
    assert "tables and figures:" in output


@pytest.mark.slow
def test_draws_left_out_and_other_libraries_are_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    small = ("--draws", 3, "--levels", "100", "--vary", "jp,ip", "--jobs", 1)
    hasty = MonteCarloSettings(refit_most_evaluations=2)
    monkeypatch.setattr("gaitcal.cli.montecarlo_command.MonteCarloSettings", lambda **_: hasty)
    output = run(tmp_path, *small)
    assert "jp 100 %: 3 of 3 draws" in output
    assert "scipy" not in output
    assert "scipy" not in run(tmp_path, *small)
    path = tmp_path / "montecarlo" / "settings.json"
    content = json.loads(path.read_text(encoding="utf-8"))
    now = content["versions"]["scipy"]
    content["versions"]["scipy"] = "0.1"
    del content["own_sha256"]
    path.write_text(json.dumps(content), encoding="utf-8")
    output = run(tmp_path, *small)
    assert "scipy 0.1" in output and now in output


@pytest.mark.slow
def test_not_converged_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gaitcal.montecarlo.draw_study.MOST_DRAWS", 25)
    with pytest.raises(ConvergenceError, match="not converged after 25 draws"):
        run(
            tmp_path,
            "--vary",
            "ip",
            "--levels",
            100,
            "--draws",
            21,
            "--jobs",
            1,
            "--until-converged",
        )


def trust(folder: Path) -> tuple[list[Any], list[Any]]:
    """Blocks of the page's section Trust: the others, and those of the study."""
    blocks = read_page_data(folder / PAGE_DATA)["sections"]["trust"]
    return [b for b in blocks if b.get("part") != PART], [
        b for b in blocks if b.get("part") == PART
    ]


CHOICES = ", ".join(str(choice.value) for choice in ParameterChoice)


@pytest.mark.parametrize(
    ("words", "output"),
    [
        (
            ("--vary", "jp,nois"),
            "--vary: found 'nois'; allowed: jp, ip, both, noise; did you mean 'noise'",
        ),
        (("--vary", ","), "--vary: found nothing"),
        (("--levels", "0"), "--levels: found '0'"),
        (("--levels", "12.5"), "--levels: found '12.5'"),
        (("--grf", "floor"), "--grf: found 'floor'; allowed: lab, foot"),
        (("--parameters", "30"), f"--parameters: found '30'; allowed: {CHOICES}"),
        (("--jobs", "0"), "--jobs: found 0"),
    ],
)
def test_faults_are_told_before_anything_is_read(
    tmp_path: Path, words: tuple[str, str], output: str
) -> None:
    with pytest.raises(UsageError, match=output):
        run(tmp_path, *words)
    assert not (tmp_path / "montecarlo").exists()
