"""Run a study: read, check, leave out faulty trials, calibrate, and write the result folder.

The source is a study file or the draft of a folder of recordings. The command line, cohorts and
Python programs run the same steps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from gaitcal.analysis.calibrate import calibrate_preprocessed
from gaitcal.analysis.result import Calibration
from gaitcal.errors import Finding, InputError, UsageError
from gaitcal.gait import normal_bands
from gaitcal.intake import draft_file as drafts
from gaitcal.intake import drafting
from gaitcal.intake.draft_file import Draft
from gaitcal.intake.subject_metadata import Options
from gaitcal.io.result_folder import ResultKind, check_output_folder, compute_sha256
from gaitcal.pipeline.write_results import write_results
from gaitcal.preprocess.preprocessed_study import preprocess_study
from gaitcal.quality.study_checks import check_preprocessed
from gaitcal.quality.verdict import select_stopping_errors
from gaitcal.runtime import Progress, silent, with_one_blas_thread
from gaitcal.study import cohort_prior
from gaitcal.study.settings import CalibrationSettings
from gaitcal.study.study import Study, add_cohort_priors, list_input_files
from gaitcal.study.study_file import load_study_file


class FaultyStudyError(InputError):
    """A study has errors that leave nothing to calibrate.

    Parameters
    ----------
    errors
        Errors, the worst first; the message has the first.
    study
        Path for the hint on `gaitcal check`.
    """

    def __init__(self, errors: Sequence[Finding], study: Path | None = None) -> None:
        shown = f": 'gaitcal check {study}' shows all" if study else ""
        more = f" (and {len(errors) - 1} more errors{shown})" if len(errors) > 1 else ""
        super().__init__(errors[0].line + more, code=errors[0].code)
        self.errors = tuple(errors)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle by the errors: the message follows from them."""
        return type(self), (self.errors,)


@dataclass(frozen=True, kw_only=True)
class RunSettings:
    """Settings of a run that the study file does not contain."""

    normal: Path | None = None
    """File of normal bands, drawn behind the curves of the page."""
    priors: Path | None = None
    """Joint priors of a cohort, for a study that names none."""
    calibration: CalibrationSettings = field(default_factory=CalibrationSettings)
    """Settings given outside the study file; those that the study file gives come first."""
    compute_held_out: bool = False
    """Whether the marker error in frames left out of the fit is computed, too."""
    force: bool = False
    """Whether to continue after errors of the checks, with every trial."""


@dataclass(frozen=True, kw_only=True)
class StudyRun:
    """A study that was run, with its calibration."""

    study: Study
    """The study without the trials that were left out."""
    calibration: Calibration
    kept: tuple[str, ...]
    """Folders of an earlier result that were kept."""
    was_drafted: bool
    """Whether the study was drafted from a folder."""


def find_study(path: Path, person: Options) -> Path | Draft:
    """Find the study file of a path, or draft a study from a folder.

    `path`: study file, or folder of recordings. `person`: data of the person that the files do not
    contain; for a folder without a study file only. Raises InputError: no study can be drafted from
    the folder, or data of the person are missing.
    """
    found = drafts.find_study_source(path, person)
    if isinstance(found, Path):
        return found
    draft = drafting.draft_folder(found, person)
    drafts.require_runnable(draft, path)
    return draft


def require_one_prior(source: Path | Draft, priors: Path | None) -> None:
    """Raise UsageError if priors are given although the study file names some."""
    if (
        isinstance(source, Path)
        and priors is not None
        and load_study_file(source).calibration.priors is not None
    ):
        raise UsageError(
            f"not together with the priors of {source} ([calibration] priors)", field="--priors"
        )


@with_one_blas_thread
def run_study(
    source: Path | str,
    out: Path | str,
    *,
    mass: float | None = None,
    height: float | None = None,
    sex: str | None = None,
    age: float | None = None,
    normal: Path | str | None = None,
    priors: Path | str | None = None,
    force: bool = False,
    progress: Progress = silent,
) -> Calibration:
    """Calibrate a study or a folder of recordings, as `gaitcal calibrate` does.

    Parameters
    ----------
    source
        Study file, or folder of recordings from which a study is drafted.
    out
        The result folder; an earlier result is replaced.
    mass, height, sex, age
        kg, m, `female` or `male`, years: for a folder whose files do not contain them.
    normal
        File of normal bands, or the name of built-in ones.
    priors
        Joint priors of a cohort (`priors.json`), for a study that names none.
    force
        Continue after errors of the checks.
    progress
        Called with a line of text at the beginning of each step.

    Returns
    -------
    Calibration
        As written, with its `verdict`.

    Raises
    ------
    InputError
        One line: file, field, the value found and the allowed ones.
    """
    found = find_study(Path(source), Options(mass=mass, height=height, sex=sex, age=age))
    require_one_prior(found, None if priors is None else Path(priors))
    settings = RunSettings(
        normal=None if normal is None else normal_bands.find_bands_file(normal),
        priors=None if priors is None else Path(priors),
        force=force,
    )
    return run_found_study(found, Path(out), settings, progress).calibration


def run_found_study(
    source: Path | Draft,
    out: Path,
    settings: RunSettings,
    progress: Progress = silent,
    *,
    notes_on: Callable[[Study], Sequence[str]] = lambda _: (),
) -> StudyRun:
    """Calibrate a study file or a draft, and write the result folder.

    Parameters
    ----------
    source
        Study file or draft.
    out
        The result folder; an earlier result is replaced.
    settings
        Settings of the run.
    progress
        Called with a line of text at the beginning of each step.
    notes_on
        Gives further notes on the study for the result.

    Returns
    -------
    StudyRun

    Raises
    ------
    FaultyStudyError
        The checks found errors, and `settings.force` is not set.
    InputError
        The study or a recording cannot be read, or `out` cannot be written.
    """
    draft = source if isinstance(source, Draft) else None
    read = (
        drafts.list_files(source)
        if isinstance(source, Draft)
        else list_input_files(load_study_file(source), source)
    )
    # An invalid file ends the run before anything is computed.
    bands = None if settings.normal is None else normal_bands.read_normal_bands(settings.normal)
    further = [file for file in (settings.normal, settings.priors) if file is not None]
    kept = check_output_folder(out, ResultKind.CALIBRATION, [*read, *further])

    progress("reading and checking the recordings")
    study = _with_settings(
        Study.load(source) if isinstance(source, Path) else drafts.build_study(source), settings
    )
    preprocessed = preprocess_study(study)
    findings = check_preprocessed(preprocessed)
    # Trials with errors are left out of a draft always, of a study file only if it could not run.
    faulty: dict[str, str] = {}
    if not settings.force and (draft is not None or select_stopping_errors(findings, study.walks)):
        faulty = drafting.find_faulty_trials(study, findings)
        draft = draft and draft.drop_trials(faulty)
    if faulty:
        # Reconstructed static markers depend on all trials, so everything is preprocessed again.
        study = replace(study, trials=tuple(t for t in study.trials if t.name not in faulty))
        preprocessed = preprocess_study(study)
        findings = check_preprocessed(preprocessed)
    if draft is not None:
        findings = (*findings, *drafting.find_rejected_forces(draft))
    errors = () if settings.force else select_stopping_errors(findings, study.walks)
    if errors:
        raise FaultyStudyError(errors, source if isinstance(source, Path) else source.folder.path)

    calibration = calibrate_preprocessed(
        preprocessed, findings, progress, compute_held_out=settings.compute_held_out
    )
    source_notes = (
        drafts.list_draft_notes(draft) if draft is not None else drafting.list_faulty_notes(faulty)
    )
    calibration = replace(
        calibration,
        notes=(*notes_on(study), *source_notes, *calibration.notes),
        left_out={**faulty, **calibration.left_out},
    )

    # The result has the drafted study file, so that it can be edited and run again.
    progress("writing the results")
    normal = settings.normal
    bands_entries = (
        {} if normal is None else {"normal": normal.name, "normal_sha256": compute_sha256(normal)}
    )
    study_text = None
    if draft is not None:
        study_text = drafts.format_draft(draft, out) + drafts.format_settings(
            settings.calibration, settings.priors, out
        )
    write_results(calibration, out, bands_entries, drafted=study_text, normal=bands)
    return StudyRun(
        study=study, calibration=calibration, kept=tuple(kept), was_drafted=draft is not None
    )


def _with_settings(study: Study, settings: RunSettings) -> Study:
    """Apply settings and priors that the study itself does not give."""
    given = settings.calibration.model_fields_set - study.settings.model_fields_set
    if given:
        update = {name: getattr(settings.calibration, name) for name in sorted(given)}
        study = replace(study, settings=study.settings.model_copy(update=update))
        cohort_prior.require_joint_prior(study.settings, study.source)
    if settings.priors is not None and study.joint_prior is None:
        study = add_cohort_priors(study, settings.priors)
    return study
