"""The one command line of the validation: what it lists, refuses, runs and writes."""

import json
import subprocess
import sys
from dataclasses import dataclass
from enum import Enum
from functools import partial
from importlib import import_module
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from gaitcal.io.labels import FootEvent, FootMoment
from gaitcal.study.study_file import load_study_file
from scripts.validation import events as check
from scripts.validation import harness
from scripts.validation.harness import results
from scripts.validation.recordings import CHILDREN, CLINICS, EVERYBODY, JOINTS, PEOPLE
from tests.real_studies import write_study

ROOT = Path(__file__).parents[2]


class Ending(Enum):
    GOOD = "good"


@dataclass(frozen=True)
class Outcome:
    ending: Ending
    figures: dict[str, float]


@pytest.fixture
def member(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """A member that returns how large its numbers are, and is passed while they are small."""
    made = ModuleType("scripts.validation.made_up_member", "Made up.")
    made.SHARED = ("--set", "--json", "--jobs")  # type: ignore[attr-defined]
    made.add_options = lambda parser: parser.add_argument("--size", type=float, default=0.0)  # type: ignore[attr-defined]
    made.run = lambda chosen: [Outcome(Ending.GOOD, {"size, mm": chosen.size, **chosen.settings})]  # type: ignore[attr-defined]
    made.passed = lambda found: found[0].figures["size, mm"] < 1.0  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, made.__name__, made)
    monkeypatch.setitem(harness.MEMBERS, "made", "made_up_member")
    return made


@pytest.mark.usefixtures("member")
def test_the_exit_code_is_what_the_member_says_and_json_what_it_returns(tmp_path: Path) -> None:
    file = tmp_path / "found.json"
    assert harness.main(["made", "--size", "0.5", "--json", str(file), "--set", "nodes=8"]) == 0
    assert harness.main(["made", "--size", "2"]) == 1
    told = json.loads(file.read_text(encoding="utf-8"))
    assert told == [{"ending": "good", "figures": {"size, mm": 0.5, "nodes": 8}}]


@pytest.mark.parametrize("name", list(harness.MEMBERS))
def test_every_member_is_one(name: str) -> None:
    found = import_module(f"scripts.validation.{harness.MEMBERS[name]}")
    assert set(found.SHARED) <= set(harness.OPTIONS) and callable(found.run)
    assert found.__doc__ and f"\n    {name} " in found.__doc__, "its docstring shows how it is called"


@pytest.mark.parametrize(
    "words",
    [
        ("people", "--parts", "imagined"),
        ("people", "--kinds", "silk"),
        ("truth", "--parts", "nonsense"),
        ("priors", "--populations", "imagined"),
        ("sessions", "--parts", "imagined"),
    ],
)
def test_words_that_it_does_not_know_are_refused(words: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        harness.main(words)
    assert stopped.value.code == 2
    assert f"found '{words[-1]}'; allowed: " in capsys.readouterr().err


def test_names_are_matched_and_none_is_an_error() -> None:
    names = ("kad", "multi", "p01", "p18")
    assert harness.matching("", names) == list(names)
    assert harness.matching("kad,P0", names) == ["kad", "p01"]
    with pytest.raises(SystemExit, match="found 'nobody'; allowed: kad, multi"):
        harness.matching("nobody", names)


def test_tasks_run_side_by_side_and_keep_their_order() -> None:
    tasks = [partial(pow, 2, exponent) for exponent in range(5)]
    assert list(harness.side_by_side(tasks, 1)) == [1, 2, 4, 8, 16]


def test_it_runs_from_a_checkout_in_one_blas_thread() -> None:
    code = "import scripts.validation, os; print(os.environ['OPENBLAS_NUM_THREADS'])"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "1"
    command = [
        sys.executable,
        "-m",
        "scripts.validation",
        "attacks",
        "--list",
        "--only",
        "mass in pounds",
        "--base",
        "uf3",
    ]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "uf3: subject: mass in pounds" in done.stdout or "0 attacks" in done.stdout  # without recordings


def test_every_listed_file_is_there(data_dir: Path) -> None:
    missing = [file for person in EVERYBODY.values() for file in person.files if not (data_dir / file).is_file()]
    assert missing == []
    assert set(CHILDREN) < set(PEOPLE) < set(EVERYBODY) and "p01" not in CLINICS


def test_a_study_names_static_trial_walk_forces_and_the_joints_asked_for(data_dir: Path, tmp_path: Path) -> None:
    trials = load_study_file(EVERYBODY["subject01"].recorded()(tmp_path)).trials
    assert [(t.name, t.file.stem, t.forces and t.forces.stem) for t in trials] == [
        ("static", "subject01_static", None),
        ("walk", "subject01_walk1", "subject01_walk1_grf"),
    ]
    trials = load_study_file(EVERYBODY["uf3"].recorded(joints=JOINTS)(tmp_path)).trials
    assert [t.joint for t in trials] == [None, *JOINTS, None] and trials[-1].file.stem == "gait"
    turn = load_study_file(EVERYBODY["HC002D"].recorded("turn")(tmp_path))
    assert (turn.trials[-1].file.stem, turn.subject.mass_kg) == ("turn", 32.1)


def test_what_no_file_holds_is_told_to_the_command() -> None:
    assert EVERYBODY["pig"].options == ("--sex", "male")
    assert EVERYBODY["pig"].facts == ("--mass", "66.5", "--height", "1.79")
    assert EVERYBODY["uf3"].options[::2] == ("--mass", "--height", "--sex") and EVERYBODY["uf3"].facts == ()


NEAR_MS = 35.0
"""ms: `subject01` walks on a treadmill, recorded at 60 Hz; its feet slide a little after each contact."""


def test_motion_is_measured_against_plates(data_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    labs = results("events", str(write_study("subject01", data_dir, tmp_path)))
    for moment in FootMoment:
        found = 1e3 * check.all_differences(labs["subject01"], moment)
        assert len(found) == 3 and np.isfinite(found).all()
        assert np.abs(found).max() < NEAR_MS and found.std() < 0.2 * NEAR_MS
    said = capsys.readouterr().out.splitlines()
    assert said[1].startswith("subject01   foot strike") and " plates " in said[1] and "(3)" in said[1]


def test_differences_are_found_less_true_and_missing_ones_are_counted() -> None:
    strike, time = FootMoment.STRIKE, np.arange(0.0, 5.0, 0.01)
    truth = [FootEvent(strike, side, t) for side, t in (("r", 1.0), ("l", 2.0), ("r", 3.0), ("r", 4.9))]
    found = [FootEvent(strike, "r", 1.02), FootEvent(FootMoment.OFF, "l", 2.0), FootEvent(strike, "r", 2.99)]
    differences = np.array(check.differences(found, truth, strike, time))
    np.testing.assert_allclose(differences, [0.02, np.nan, -0.01])
    assert check.told(differences) == "   5 ± 15 (2, 1 missed)"
    assert check.told(np.array([])) == "-"
