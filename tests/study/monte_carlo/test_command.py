"""`gaitcal montecarlo`: what it writes and prints, and what it refuses."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest
from typer.testing import CliRunner

from gaitcal.cli import app
from gaitcal.errors import ConvergenceError, InputError
from gaitcal.study.monte_carlo.case import MonteCarloCase

RUNNER = CliRunner()


@pytest.fixture(autouse=True)
def _nominal(case: MonteCarloCase, monkeypatch: pytest.MonkeyPatch) -> None:
    """The folder holds the nominal subject; figures have a test of their own."""
    monkeypatch.setattr("gaitcal.commands.montecarlo.case_from", lambda folder, trial, step: case)
    monkeypatch.setattr("gaitcal.commands.montecarlo.write_monte_carlo_figures", lambda *a: None)


def run(*words: object) -> str:
    found = RUNNER.invoke(app, ["montecarlo", *map(str, words)], catch_exceptions=False)
    assert found.exit_code == 0
    return found.stdout


def test_a_study_and_its_tables(tmp_path: Path) -> None:
    small = ("--draws", 6, "--levels", "50,100", "--jobs", 1)
    told = run(tmp_path, *small, "--grf", "foot")
    assert "carried with the foot" in told
    assert "joint parameters dominate (lab): holds" in told
    assert "published 4.14, here 0." in told
    assert "draws: 48, of which 48 in this run and 0 not converged" in told
    table = pd.read_csv(tmp_path / "montecarlo" / "montecarlo.csv")
    assert set(table["grf"].dropna()) == {"lab", "foot"}
    assert (tmp_path / "montecarlo" / "contributions.csv").exists()
    assert "of which 0 in this run" in run(tmp_path, *small)
    expected = run(tmp_path, "--expect", 4)
    assert "a marker RMS of 4 mm corresponds to JP at" in expected
    assert "corresponds to NP at" in expected
    assert run(tmp_path, *small, "-q") == ""
    with pytest.raises(InputError, match="seed = 0, not 4"):
        run(tmp_path, *small, "--seed", 4)


def test_not_converged_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gaitcal.study.monte_carlo.study.MOST_DRAWS", 25)
    with pytest.raises(ConvergenceError, match="not converged after 25 draws"):
        run(tmp_path, "--vary", "ip", "--levels", 100, "--draws", 21, "--jobs", 1, "--until-converged")


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--vary", "jp,nois"), "--vary: found 'nois'; allowed: jp, ip, both, noise; did you mean 'noise'"),
        (("--vary", ","), "--vary: found nothing"),
        (("--levels", "0"), "--levels: found '0'"),
        (("--levels", "12.5"), "--levels: found '12.5'"),
        (("--grf", "floor"), "--grf: found 'floor'; allowed: lab, foot"),
        (("--parameters", "30"), "--parameters: found '30'; allowed: 27, 17, 98"),
        (("--jobs", "0"), "--jobs: found 0"),
    ],
)
def test_faults_are_told_before_anything_is_read(tmp_path: Path, words: tuple[str, str], told: str) -> None:
    with pytest.raises(InputError, match=told):
        run(tmp_path, *words)
    assert not (tmp_path / "montecarlo").exists()
