"""`gaitcal synthesize`, a synthetic person as a study folder, and `gaitcal demo`, that person calibrated end to end."""

from __future__ import annotations

from pathlib import Path

from gaitcal.cli.console import Console, print_calibration, tell_kept
from gaitcal.io.atomic import require_room
from gaitcal.io.lock import ResultKind
from gaitcal.results.calibration import write_results
from gaitcal.results.page_files import PAGE
from gaitcal.session.calibrate import calibrate
from gaitcal.study.study import Study
from gaitcal.synthetic.subject import synthesize
from gaitcal.synthetic.truth import CURVES, PARAMETERS

SEED = 2009
"""Of the demonstration's noise and of its subject's true parameters: the first from 2007 on (the year of the method)
whose true moments have their peaks within 2 standard deviations of people's (`scripts/tools/walking_person.py`)."""


def write_subject(out: Path, console: Console, *, seed: int, noise: bool, perturb: bool) -> None:
    """Write a synthetic subject as a study folder."""
    kept = require_room(out, ResultKind.SYNTHETIC)
    with console.working() as step:
        step("writing C3D files of the synthetic subject")
        study = synthesize(out, seed=seed, noise=noise, perturb=perturb)
    tell_kept(console, kept)
    console.line(f"study: {study}")
    console.line(f"truth: {study.parent / PARAMETERS}, {study.parent / CURVES}")
    console.line(f"next:  gaitcal calibrate {study} --out {out}-result")


def demonstrate(out: Path, console: Console) -> None:
    """Write a noisy synthetic subject as C3D, and calibrate it: the truth that its study names is in the result."""
    folder, result = out / "subject", out / "result"
    require_room(folder, ResultKind.SYNTHETIC)
    kept = require_room(result, ResultKind.CALIBRATION)
    with console.working() as step:
        step("writing C3D files of a synthetic subject with marker noise and wrong nominal parameters")
        path = synthesize(folder, seed=SEED, noise=True, perturb=True)
        step("reading them back")
        study = Study.load(path)
        calibration = calibrate(study, step)
        step("writing the results")
        write_results(calibration, result)
    console.line(
        "A synthetic subject (markers with up to 10 mm of noise, two force plates), calibrated from its C3D files:"
    )
    print_calibration(console, calibration)
    tell_kept(console, kept)
    console.line(f"page:   {result / PAGE}")
