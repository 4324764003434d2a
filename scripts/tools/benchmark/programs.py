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


def _python(*arguments: str) -> Callable[[], object]:
    return lambda: subprocess.run([sys.executable, *arguments], check=True, capture_output=True)


def section_startup() -> list[Timing]:
    """The command line and the import, each in its own process."""
    return [
        Timing("gaitcal --help", _python("-m", "gaitcal.cli", "--help")),
        Timing("import gaitcal", _python("-c", "import gaitcal")),
        Timing("import of what calibrate needs", _python("-c", IMPORTS), "below 0.9 s"),
        Timing("python alone", _python("-c", "pass")),
    ]


def section_checks() -> list[Timing]:
    """All checks of the demo's seven trials, files read before; wanted below a second."""
    folder = temporary_folder()
    _python("-m", "gaitcal.cli", "synthesize", "-q", "--out", str(folder / "study"))()
    study = Study.load(folder / "study" / "study.toml")
    return [Timing("check_study", lambda: check_study(study), "7 moving trials and the static one, 7408 frames")]


def section_calibrate_study() -> list[Timing]:
    """`gaitcal calibrate` on the demo's synthetic study: files read, everything fitted, all results written."""
    folder = temporary_folder()
    _python("-m", "gaitcal.cli", "synthesize", "-q", "--out", str(folder / "study"))()
    turn = count()

    def calibrate() -> object:
        out = folder / f"result{next(turn)}"
        return _python(
            "-m", "gaitcal.cli", "calibrate", "-q", str(folder / "study" / "study.toml"), "--out", str(out)
        )()

    def draw() -> object:
        return _python("-m", "gaitcal.cli", "figures", "-q", str(folder / "result0"))()

    study = str(folder / "study" / "study.toml")
    said = "7 trials, 7408 frames: check, JP, IP, dynamics, error bars, page, exports; its own process"
    return [
        Timing("gaitcal calibrate study.toml", calibrate, said),
        Timing("gaitcal check study.toml", _python("-m", "gaitcal.cli", "check", "-q", study), "its own process"),
        Timing("gaitcal figures result", draw, "one stride of each foot, a file a variable; 1 run", runs=1),
    ]


def section_calibrate_walk() -> list[Timing]:
    """`gaitcal calibrate` and `check` on the folder of one real walk; nothing where GAITCAL_DATA has none."""
    walk = Path(os.environ.get("GAITCAL_DATA", "")) / "subject01"
    if not walk.is_dir():
        return []
    person = (str(walk), "--mass", "72.6", "--height", "1.8", "--sex", "male")
    out = str(temporary_folder() / "result")
    calibrate = ("-m", "gaitcal.cli", "calibrate", "-q", *person, "--out", out)
    said = "one walk over two plates, 151 frames: draft, check, JP, IP, dynamics, error bars, page, exports"
    return [
        Timing("gaitcal calibrate subject01", _python(*calibrate), said),
        Timing(
            "gaitcal check subject01", _python("-m", "gaitcal.cli", "check", "-q", *person), "wanted below a second"
        ),
        Timing("  of both: imports for calibrate", _python("-c", IMPORTS), "below 0.9 s"),
        Timing("  of both: imports for check", _python("-c", "import gaitcal.cli.folder")),
    ]


def section_montecarlo() -> list[Timing]:
    """Draws of the Monte Carlo study: every set at its highest level, nothing kept on disk."""
    case = nominal_case()

    def study(workers: Workers) -> Callable[[], object]:
        return lambda: monte_carlo(case, plan=DRAWS, workers=workers)

    def rate(seconds: float) -> str:
        return f"{DRAWS.total} draws, {DRAWS.total / seconds:.0f} a second"

    return [
        Timing("this process", study(Workers()), lambda s: f"{rate(s)}; 3 runs", runs=3),
        Timing(
            "two worker processes",
            study(LocalProcesses(2)),
            lambda s: f"{rate(s)}, their start included; 3 runs",
            runs=3,
        ),
    ]
