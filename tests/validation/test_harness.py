"""The one command line of the validation: what it lists, refuses, runs and writes."""

import json
import re
import subprocess
import sys
from dataclasses import dataclass
from enum import Enum
from importlib import import_module
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from gaitcal.io.labels import FootMoment
from scripts.validation import events as check
from scripts.validation import harness
from scripts.validation.harness import results
from scripts.validation.recordings import CHILDREN, CLINICS, EVERYBODY, PEOPLE
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
    made.OWN = {"--size": harness.option(0.0, "of the numbers")}  # type: ignore[attr-defined]
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
    assert set(found.SHARED) <= set(harness.OPTIONS) and (
        callable(getattr(found, "run", None)) or found.PARTS
    )
    assert found.__doc__ and f"\n    {name} " in found.__doc__, (
        "its docstring shows how it is called"
    )


def test_commands_that_pages_cite_are_understood() -> None:
    pages = (*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("gaitcal/**/*.py"))
    text = "".join(page.read_text(encoding="utf-8") for page in pages)
    cited = re.findall(r"`python -m\s+scripts\.validation\s+([a-z_]+)([^`]*)`", text)
    for name, options in cited:
        harness.parsed(
            import_module(f"scripts.validation.{harness.MEMBERS[name]}"), name, options.split()
        )
    assert len(cited) > 20


def test_it_runs_from_a_checkout_in_one_blas_thread() -> None:
    code = "import scripts.validation, os; print(os.environ['OPENBLAS_NUM_THREADS'])"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    )
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
    assert (
        "uf3: subject: mass in pounds" in done.stdout or "0 attacks" in done.stdout
    )  # without recordings


def test_every_listed_file_is_there(data_dir: Path) -> None:
    missing = [
        file
        for person in EVERYBODY.values()
        for file in person.files
        if not (data_dir / file).is_file()
    ]
    assert missing == []
    assert set(CHILDREN) < set(PEOPLE) < set(EVERYBODY) and "p01" not in CLINICS


NEAR_MS = 35.0
"""ms: `subject01` walks on a treadmill, recorded at 60 Hz; its feet slide a little after each
contact.
"""


def test_motion_is_measured_against_plates(
    data_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    labs = results("events", str(write_study("subject01", data_dir, tmp_path)))
    for moment in FootMoment:
        found = 1e3 * check.all_differences(labs["subject01"], moment)
        assert len(found) == 3 and np.isfinite(found).all()
        assert np.abs(found).max() < NEAR_MS and found.std() < 0.2 * NEAR_MS
    said = capsys.readouterr().out.splitlines()
    assert (
        said[1].startswith("subject01   foot strike") and " plates " in said[1] and "(3)" in said[1]
    )


def test_names_are_matched_and_none_is_an_error() -> None:
    names = ("kad", "multi", "p01", "p18")
    assert harness.matching("", names) == list(names)
    assert harness.matching("kad,P0", names) == ["kad", "p01"]
    with pytest.raises(SystemExit, match="found 'nobody'; allowed: kad, multi"):
        harness.matching("nobody", names)
