"""Whole programs: the main job on the synthetic study, the Monte Carlo study, and what starting up takes."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from itertools import count
from pathlib import Path

from gaitcal.faults.study import check_study
from gaitcal.published.case import nominal_case
from gaitcal.published.protocol import Plan
from gaitcal.published.study import monte_carlo
from gaitcal.published.workers import LocalProcesses, Workers
from gaitcal.study.study import Study
from scripts.tools.benchmark.figure import Timing, temporary_folder

DRAWS = Plan(levels=(100,), draws=100)
IMPORTS = "import gaitcal.cli.calibrate, gaitcal.session.calibrate, gaitcal.results.calibration"
"""The second and third beside reading and checking."""


def _python(*arguments: object) -> Callable[[], object]:
    command = [sys.executable, *map(str, arguments)]
    return lambda: subprocess.run(command, check=True, capture_output=True)


def _gaitcal(*words: object) -> Callable[[], object]:
    return _python("-m", "gaitcal.cli", *words)


def _study() -> Path:
    """The study file of the demo's synthetic person."""
    folder = temporary_folder()
    _gaitcal("synthesize", "-q", "--out", folder / "study")()
    return folder / "study" / "study.toml"


def section_startup() -> list[Timing]:
    """The command line and the import, each in its own process."""
    return [
        Timing("gaitcal --help", _gaitcal("--help")),
        Timing("import gaitcal", _python("-c", "import gaitcal")),
        Timing("import of what calibrate needs", _python("-c", IMPORTS), "below 0.9 s"),
        Timing("python alone", _python("-c", "pass")),
    ]


def section_checks() -> list[Timing]:
    """All checks of the demo's seven trials, files read before; wanted below a second."""
    study = Study.load(_study())
    return [Timing("check_study", lambda: check_study(study), "7 moving trials and the static one, 7408 frames")]


def section_calibrate_study() -> list[Timing]:
    """`gaitcal calibrate` on the demo's synthetic study: files read, everything fitted, all results written."""
    study = _study()
    results = (study.with_name(f"result{k}") for k in count())
    said = "7 trials, 7408 frames: check, JP, IP, dynamics, error bars, page, exports; its own process"
    drawn = "one stride of each foot, a file a variable; 1 run"
    return [
        Timing(
            "gaitcal calibrate study.toml", lambda: _gaitcal("calibrate", "-q", study, "--out", next(results))(), said
        ),
        Timing("gaitcal check study.toml", _gaitcal("check", "-q", study), "its own process"),
        Timing("gaitcal figures result", _gaitcal("figures", "-q", study.with_name("result0")), drawn, runs=1),
    ]


def section_calibrate_walk() -> list[Timing]:
    """`gaitcal calibrate` and `check` on the folder of one real walk; nothing where GAITCAL_DATA has none."""
    walk = Path(os.environ.get("GAITCAL_DATA", "")) / "subject01"
    if not walk.is_dir():
        return []
    person = ("-q", walk, "--mass", "72.6", "--height", "1.8", "--sex", "male")
    said = "one walk over two plates, 151 frames: draft, check, JP, IP, dynamics, error bars, page, exports"
    out = temporary_folder() / "result"
    return [
        Timing("gaitcal calibrate subject01", _gaitcal("calibrate", *person, "--out", out), said),
        Timing("gaitcal check subject01", _gaitcal("check", *person), "wanted below a second"),
        Timing("  of both: imports for calibrate", _python("-c", IMPORTS), "below 0.9 s"),
        Timing("  of both: imports for check", _python("-c", "import gaitcal.cli.folder")),
    ]


def section_montecarlo() -> list[Timing]:
    """Draws of the Monte Carlo study: every set at its highest level, nothing kept on disk."""
    case = nominal_case()

    def of(name: str, workers: Workers, more: str = "") -> Timing:
        def note(seconds: float) -> str:
            return f"{DRAWS.total} draws, {DRAWS.total / seconds:.0f} a second{more}; 3 runs"

        return Timing(name, lambda: monte_carlo(case, plan=DRAWS, workers=workers), note, runs=3)

    return [of("this process", Workers()), of("two worker processes", LocalProcesses(2), ", their start included")]
