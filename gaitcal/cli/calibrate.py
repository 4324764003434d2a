"""`gaitcal calibrate`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from gaitcal.cli.check import stop_on_errors
from gaitcal.cli.console import Console, print_calibration, tell_changed, tell_kept
from gaitcal.cli.init import study_or_draft, tell_faulty
from gaitcal.errors import ConvergenceError, InputError, UsageError
from gaitcal.faults.study import check_study
from gaitcal.faults.verdict import Judgement
from gaitcal.findings import Finding
from gaitcal.gait.normal_bands import bands_file, read_normal_bands
from gaitcal.io.result_folder import ResultKind, require_room, sha256_of
from gaitcal.session.draft import STUDY, Draft, draft_text, settings_text, study_of
from gaitcal.session.draft_lines import draft_notes
from gaitcal.session.drafting import rejected_forces, without_faulty_trials
from gaitcal.session.person_facts import NOTHING_SAID, Options
from gaitcal.session.source import files_of
from gaitcal.study.joint_prior import with_cohort_priors
from gaitcal.study.settings import CalibrationSettings
from gaitcal.study.study import Study, input_files
from gaitcal.study.study_file import load_study_file


def _inputs(source: Path | Draft, priors: Path | None) -> tuple[Path, ...]:
    """The files that a study reads; UsageError where it names priors, and `priors` are given, too."""
    if isinstance(source, Draft):
        return files_of(source)
    file = load_study_file(source)
    if priors is not None and file.calibration.priors is not None:
        raise UsageError(f"not beside the priors that {source} names ([calibration] priors)", field="--priors")
    return input_files(file, source)


def _checked(source: Path | Draft, priors: Path | None) -> tuple[Study, tuple[Finding, ...]]:
    """The study, read, and what the checks find in it."""
    study = Study.load(source) if isinstance(source, Path) else study_of(source)
    if priors is not None:
        study = with_cohort_priors(study, priors)
    return study, check_study(study)


def run(
    path: Path,
    out: Path,
    console: Console,
    options: Options = NOTHING_SAID,
    *,
    force: bool = False,
    hold_out: bool = False,
    normal: Path | None = None,
    priors: Path | None = None,
) -> None:
    """Check and calibrate a study, or what a folder of recordings drafts, and write the result folder.

    `force` goes on past errors that the checks find, and keeps every trial of a drafted study. `normal`: file of normal
    bands, or the name of those that gaitcal brings. `priors`: file of a cohort, on which joint parameters lean
    where the study file names none.
    """
    normal = None if normal is None else bands_file(normal)
    bands = None if normal is None else read_normal_bands(normal)
    source = study_or_draft(path, options, console)
    drafted = source if isinstance(source, Draft) else None
    inputs = _inputs(source, priors)
    kept = require_room(out, ResultKind.CALIBRATION, [*inputs, *(file for file in (normal, priors) if file)])
    with console.working() as step:
        step("reading and checking the recordings")
        loaded, findings = _checked(source, priors)
        from gaitcal.results.calibration import write_results
        from gaitcal.results.page_files import PAGE
        from gaitcal.session.calibrate import calibrate

        if drafted is not None and not force:
            loaded, findings, faulty = without_faulty_trials(loaded, findings)
            drafted = drafted.without(faulty)
            tell_faulty(console, faulty)
        if drafted is not None:
            findings = (*findings, *rejected_forces(drafted))
        if not force:
            stop_on_errors(findings, loaded.walks, path)
        calibration = calibrate(loaded, step, leave_out=hold_out, checked=findings)
        if drafted is not None:
            calibration = replace(calibration, notes=(*draft_notes(drafted), *calibration.notes))
        step("writing the results")
        made_with = {} if normal is None else {"normal": normal.name, "normal_sha256": sha256_of(normal)}
        text = None if drafted is None else draft_text(drafted, out) + settings_text(CalibrationSettings(), priors, out)
        write_results(calibration, out, made_with, drafted=text, normal=bands)
    print_calibration(console, calibration)
    for note in loaded.joint_prior.notes if loaded.joint_prior else ():
        console.line(f"priors: {note}")
    tell_changed(console, loaded.changed_inputs())
    tell_kept(console, kept)
    if drafted is not None:
        console.line(f"study:  {out / STUDY} (drafted; look at it, and calibrate it again where you change it)")
    console.line(f"page:   {out / PAGE}")
    verdict = calibration.verdict
    if verdict.judgement is Judgement.REFUSED and not force:
        raise InputError(
            f"the result is refused (it was written, with no torque valid): {verdict.reasons[0].cause}",
            code=verdict.reasons[0].code,
        )
    if verdict.trials and all(map(verdict.refused_legs, verdict.trials)) and not force:
        raise InputError(
            f"a leg is refused in every walk (the result was written): {verdict.reasons[0].cause}",
            code=verdict.reasons[0].code,
        )
    if not calibration.converged:
        late = next(phase for phase in calibration.phases if not phase.converged)
        raise ConvergenceError(f"phase {late.name} did not converge: {late.message} (the results were written)")
