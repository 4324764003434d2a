"""`gaitcal calibrate`."""

from __future__ import annotations

from pathlib import Path

from gaitcal.commands.console import Talk, print_calibration
from gaitcal.errors import ConvergenceError
from gaitcal.output import write_results
from gaitcal.study.person import Study
from gaitcal.study.pipeline import calibrate


def run(study: Path, out: Path, *, quiet: bool, verbose: bool) -> None:
    """Calibrate a study and write its result folder."""
    talk = Talk(quiet=quiet, verbose=verbose)
    with talk.working() as step:
        step("reading the recordings")
        loaded = Study.load(study)
        calibration = calibrate(loaded, step)
        step("writing the results")
        write_results(calibration, out)
    print_calibration(talk, calibration)
    talk.line(f"report: {out / 'report.html'}")
    talk.line(f"view:   {out / 'view.html'}")
    if not calibration.converged:
        late = next(phase for phase in calibration.phases if not phase.converged)
        raise ConvergenceError(f"phase {late.name} did not converge: {late.message} (the results were written)")
