"""Commands of gaitcal as processes of their own, on a small synthetic study.

They are forked from this process, which has loaded every library once; that saves two seconds each. Figures are left
out, and chunks of Monte Carlo draws are small. POSIX only.
"""

from __future__ import annotations

import json
import os
import shutil
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd

from gaitcal import cli
from gaitcal.commands import calibrate, dynamics, other_programs, view
from gaitcal.commands import montecarlo as montecarlo_command
from gaitcal.montecarlo.study import monte_carlo

LOADED = (calibrate, dynamics, other_programs, view)
"""Before anything is forked."""
CHUNK_DRAWS = 2
DRAWS = ("--vary", "jp", "--levels", "100", "--draws", "12", "--jobs", "1")
MASSES = {"first": 69.4, "second": 70.4}
"""kg; of two studies of one person, whose models differ."""
TRIALS = ("walk2", "walk3")
WAIT_S = 300.0
RUNS = 1000
"""No exit code."""


@dataclass
class Process:
    """A command that runs."""

    words: tuple[str, ...]
    number: int
    said: Path
    code: int = field(default=RUNS)

    def ended(self) -> bool:
        """Look whether it has ended."""
        if self.code == RUNS:
            number, status = os.waitpid(self.number, os.WNOHANG)
            if number:
                self.code = os.waitstatus_to_exitcode(status)
        return self.code != RUNS

    def wait(self) -> int:
        """Exit code; negative: the signal that ended it."""
        end = time.monotonic() + WAIT_S
        while not self.ended():
            if time.monotonic() > end:
                os.kill(self.number, 9)
                raise TimeoutError(f"{' '.join(self.words)} hangs: {self.text()}")
            time.sleep(0.002)
        return self.code

    def send(self, number: int) -> None:
        """Send a signal, if it still runs."""
        if not self.ended():
            os.kill(self.number, number)

    def text(self) -> str:
        """What it printed."""
        return self.said.read_text(encoding="utf-8", errors="replace")


def start(words: Sequence[object], said: Path) -> Process:
    """Begin a command in a process of its own."""
    texts = tuple(map(str, words))
    sys.stdout.flush()
    number = os.fork()
    if number == 0:
        _become(texts, said)
    return Process(texts, number, said)


def _become(words: tuple[str, ...], said: Path) -> None:
    """Be that command, in a forked process, and end."""
    code = 70
    try:
        stream = os.open(said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(stream, 1)
        os.dup2(stream, 2)
        montecarlo_command.write_monte_carlo_figures = lambda *_: {}  # type: ignore[assignment]
        montecarlo_command.with_monte_carlo = _with_line  # type: ignore[assignment]
        montecarlo_command.monte_carlo = partial(monte_carlo, chunk_draws=CHUNK_DRAWS)  # type: ignore[assignment]
        sys.argv = ["gaitcal", *words]
        cli.main()
    except SystemExit as ending:
        code = ending.code if isinstance(ending.code, int) else 0 if ending.code is None else 1
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def _with_line(sheet: Mapping[str, Any], *_: object, **__: object) -> dict[str, Any]:
    """Stand-in for the section of the draws: the sheet changes, and stays the same from then on."""
    return {**sheet, "drawn": True}


def run(words: Sequence[object], said: Path) -> Process:
    """Run a command to its end, which must be exit code 0."""
    process = start(words, said)
    if process.wait() != 0:
        raise RuntimeError(f"{' '.join(process.words)}: exit code {process.code}: {process.text()}")
    return process


@dataclass(frozen=True)
class Bench:
    """A study twice, the result of each, and further trials."""

    folder: Path
    seconds: dict[str, float] = field(default_factory=dict)
    """What each command takes alone."""

    def study(self, name: str) -> Path:
        """The study file of this mass."""
        return self.folder / name / "study.toml"

    def result(self, name: str) -> Path:
        """Its untouched result, with `dynamics`, `export` and `montecarlo` in it."""
        return self.folder / f"{name}-result"

    @property
    def said(self) -> Path:
        """Where commands print that nobody reads."""
        return self.folder / "said.txt"

    def trial(self, name: str) -> tuple[object, ...]:
        """Words for `dynamics`: a further trial with its forces."""
        return self.folder / f"{name}.csv", "--forces", self.folder / f"{name}_forces.csv"


def made_bench(folder: Path) -> Bench:
    """Write studies and trials, and run every command on them alone; in a folder that holds all that, nothing."""
    from tests.synthetic_studies import write_synthetic_study

    times = folder / "seconds.json"
    if times.exists():
        return Bench(folder, json.loads(times.read_text(encoding="utf-8")))
    bench = Bench(folder)
    for name, mass in MASSES.items():
        path = write_synthetic_study(folder / name)
        text = path.read_text(encoding="utf-8")
        path.write_text(text.replace("mass_kg = 69.4", f"mass_kg = {mass}"), encoding="utf-8")
    for k, name in enumerate(TRIALS):
        markers = pd.read_csv(folder / "first" / "walk.csv", comment="#").iloc[: 160 + 20 * k]
        markers.to_csv(folder / f"{name}.csv", index=False)
        for part in ("forces", "plates"):
            source = folder / "first" / f"walk_{part}.csv"
            if source.exists():
                shutil.copy(source, folder / f"{name}_{part}.csv")
    for name in MASSES:
        result = bench.result(name)
        for words in (
            ("calibrate", bench.study(name), "--out", result, "--force", "-q"),
            *(("dynamics", result, *bench.trial(trial), "-q") for trial in TRIALS),
            ("export", result, "-q"),
            ("view", result, "--html", result / "view.html", "-q"),
            ("montecarlo", result, *DRAWS, "-q"),
        ):
            began = time.monotonic()
            run(words, bench.said)
            bench.seconds[words[0]] = time.monotonic() - began
    times.write_text(json.dumps(bench.seconds), encoding="utf-8")
    return bench
