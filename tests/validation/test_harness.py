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

import pytest

from scripts.validation import harness

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
