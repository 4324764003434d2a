"""`gaitcal calibrate`."""

from __future__ import annotations

from pathlib import Path

from gaitcal.checks import check_study
from gaitcal.commands.check import stop_on_errors
from gaitcal.commands.console import Talk, print_calibration, tell_changed, tell_kept
from gaitcal.errors import ConvergenceError, InputError
from gaitcal.files.atomic import require_room
from gaitcal.files.ownership import ResultKind
from gaitcal.person.calibrate import calibrate
from gaitcal.results.calibration import write_results
from gaitcal.study.study import Study, input_files
from gaitcal.study.study_file import load_study_file
from gaitcal.verdict.verdict import Judgement


def run(study: Path, out: Path, talk: Talk, *, force: bool = False, hold_out: bool = False) -> None:
    """Check and calibrate a study and write its result folder; `force` goes on past errors that the checks find."""
    kept = require_room(out, ResultKind.CALIBRATION, input_files(load_study_file(study), study))
    with talk.working() as step:
        step("reading the recordings")
        loaded = Study.load(study)
        step("checking the recordings")
        findings = check_study(loaded)
        if not force:
            stop_on_errors(findings, study)
        calibration = calibrate(loaded, step, leave_out=hold_out, checked=findings)
        step("writing the results")
        write_results(calibration, out)
    print_calibration(talk, calibration)
    tell_changed(talk, loaded.changed_inputs())
    tell_kept(talk, kept)
    talk.line(f"report: {out / 'report.html'}")
    talk.line(f"view:   {out / 'view.html'}")
    verdict = calibration.verdict
    if verdict.judgement is Judgement.REFUSED and not force:
        raise InputError(f"the result is refused (it was written, with no torque valid): {verdict.reasons[0].cause}")
    if verdict.trials and all(map(verdict.refused_legs, verdict.trials)) and not force:
        raise InputError(f"a leg is refused in every walk (the result was written): {verdict.reasons[0].cause}")
    if not calibration.converged:
        late = next(phase for phase in calibration.phases if not phase.converged)
        raise ConvergenceError(f"phase {late.name} did not converge: {late.message} (the results were written)")
