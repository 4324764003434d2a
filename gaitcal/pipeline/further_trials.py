"""Analyse further trials with the model of a result: checks, motions, torques, verdict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

from gaitcal.analysis import trial_result
from gaitcal.analysis.result import TrialResult
from gaitcal.display import Displayed, shorten
from gaitcal.errors import Code, Finding, InputError, Severity
from gaitcal.io.csv_recordings import find_event_tables
from gaitcal.io.result_folder import ResultKind, check_output_folder
from gaitcal.pipeline.run_study import FaultyStudyError
from gaitcal.pipeline.write_trials import write_trials
from gaitcal.preprocess.preprocessed_study import find_possible_moves_of_trial, preprocess_trial
from gaitcal.preprocess.trial_evidence import TrialEvidence
from gaitcal.quality.study_checks import check_further
from gaitcal.quality.verdict import Verdict, judge, remove_consequences, select_stopping_errors
from gaitcal.results.saved_result import SavedResult, load_result
from gaitcal.runtime import Progress, silent, with_one_blas_thread
from gaitcal.study.study_file import Side, TrialTable
from gaitcal.study.study_trial import Role, Trial, read_trial


@dataclass(frozen=True, kw_only=True, repr=False)
class FurtherTrials(Displayed):
    """Trials that were analysed with the model of a result."""

    trials: tuple[TrialResult, ...]
    """In the given order."""
    verdict: Verdict
    """Verdict on each trial, with its reasons."""
    not_converged: tuple[str, ...]
    """Names of the trials for which tracking did not converge."""

    def _description(self) -> tuple[str, list[tuple[str, str]]]:
        rows = [
            ("trials", shorten([trial.name for trial in self.trials])),
            ("verdict", self.verdict.judgement.value),
        ]
        rows += [("because", reason.line) for reason in self.verdict.reasons[:3]]
        return "Further trials", rows


@with_one_blas_thread
def analyse_trial(
    result: Path | str,
    recording: Path | str,
    *,
    forces: Path | str | None = None,
    plates: dict[str, Side] | None = None,
    time: tuple[float, float] | None = None,
    filter_hz: float | Literal["none"] | None = None,
    role: Literal["gait", "motion"] = "gait",
    out: Path | str | None = None,
) -> FurtherTrials:
    """Analyse a further recording of a calibrated person, as `gaitcal dynamics` does.

    Parameters
    ----------
    result
        Result folder of a calibration.
    recording
        C3D, TRC or CSV file of the same session, with the markers of the model.
    forces
        Table of forces, if the recording has none.
    plates
        Plate -> `r`, `l` or `none`; detected unless given.
    time
        Start and end (s) of the part to use.
    filter_hz
        Cut-off of the force filter (Hz), or `none`; that of the calibration unless given.
    role
        `gait` for a walk, `motion` for any other activity.
    out
        Folder to write to, as `gaitcal dynamics --out` does; nothing is written unless given.

    Returns
    -------
    FurtherTrials
        One trial (motion, torques, standard errors) and the verdict on it.

    Raises
    ------
    InputError
        One line: file, field, the value found and the allowed ones.
    """
    if role not in (Role.GAIT.value, Role.MOTION.value):
        raise InputError(
            f"found '{role}'; allowed: gait or motion", field="role", code=Code.ARGUMENT
        )
    for side in (plates or {}).values():
        if side not in get_args(Side):
            raise InputError(
                f"found '{side}'; allowed: r, l or none", field="plates", code=Code.ARGUMENT
            )
    file, table = Path(recording), None if forces is None else Path(forces)
    trial = make_trial_table(
        file, table, role=role, plates=plates or {}, time=time, filter_hz=filter_hz
    )
    inputs = [file, *([table] if table else []), *find_event_tables(file)]
    if out is not None:
        check_output_folder(Path(out), ResultKind.DYNAMICS, inputs)
    saved = load_result(Path(result))
    done = analyse_trials(saved, [trial])
    if out is not None:
        write_trials(done.trials, saved, Path(out), inputs, done.verdict)
    return done


def make_trial_table(file: Path, forces: Path | None, **given: object) -> TrialTable:
    """Make the entry of a further recording, as in a study file.

    Parameters
    ----------
    file
        Recording, whose name without ending becomes the name of the trial.
    forces
        Table of forces.
    given
        Further fields of the entry.

    Returns
    -------
    TrialTable
    """
    table = TrialTable(name="trial", role="gait", file=file, forces=forces)
    return table.model_copy(update={"name": file.stem, **given})


def analyse_trials(
    saved: SavedResult, tables: Sequence[TrialTable], progress: Progress = silent
) -> FurtherTrials:
    """Check further trials, and find their motions, torques, standard errors and verdict.

    Parameters
    ----------
    saved
        Result with the model.
    tables
        Entries of the trials.
    progress
        Called with a line of text at the beginning of each step.

    Returns
    -------
    FurtherTrials

    Raises
    ------
    FaultyStudyError
        The checks found errors.
    InputError
        A recording cannot be read, or has none of the model's markers.
    """
    evidence = []
    for table in tables:
        progress(f"{table.file.name}: reading and checking")
        evidence.append(_preprocess(read_trial(table, saved.rename, saved.marker_set), saved))
    findings = list(saved.doubts)
    # Doubts about the calibration are doubts about everything computed with it.
    for trial in evidence:
        findings += check_further(trial)
    errors = select_stopping_errors(findings, [trial.name for trial in evidence])
    if errors:
        raise FaultyStudyError(errors)
    # Nothing is tracked if a trial has errors.
    results = []
    for preprocessed in evidence:
        progress(f"{preprocessed.name}: tracking and inverse dynamics")
        moves = find_possible_moves_of_trial(preprocessed)
        results.append(
            trial_result.analyse(
                saved.model, preprocessed.trial, saved.settings, saved.uncertainty, moves
            )
        )
    not_converged = [trial.name for trial in results if not trial.calibrated.converged]
    findings += _report_edited_files(saved, results)
    findings += map(_report_untracked, not_converged)
    for result in results:
        findings += result.findings
    # One verdict for all further trials, by the same rules as for a calibration.
    verdict = judge(remove_consequences(findings), [trial.name for trial in results])
    return FurtherTrials(
        trials=tuple(
            trial.exclude_legs(verdict.list_refused_legs(trial.name)) for trial in results
        ),
        verdict=verdict,
        not_converged=tuple(not_converged),
    )


def _report_edited_files(saved: SavedResult, trials: Sequence[TrialResult]) -> list[Finding]:
    """Report files of the result that changed since it was written, for every trial."""
    return [
        Finding(
            severity=Severity.WARNING,
            topic="result folder",
            where=trial.name,
            cause="a file of the result is not as it was written",
            found=remark,
            cure="",
            code=Code.RESULT_EDITED,
        )
        for trial in trials
        for remark in saved.files.remarks
    ]


def _report_untracked(name: str) -> Finding:
    """Report a trial for which tracking did not converge."""
    return Finding(
        severity=Severity.ERROR,
        topic="convergence",
        where=name,
        cause="tracking did not converge",
        found="its angles and torques are not those of the best fit",
        cure="check its markers",
        code=Code.NOT_CONVERGED,
    )


def _preprocess(trial: Trial, saved: SavedResult) -> TrialEvidence:
    """Preprocess a trial; raise InputError if it has no marker of the model."""
    labels = saved.model.markers.labels
    if not set(labels) & set(trial.recording.labels):
        message = f"found none of the model's {len(labels)} markers, such as {labels[0]}"
        raise InputError(
            message, source=trial.recording.source, field="markers", code=Code.UNKNOWN_LABEL
        )
    return preprocess_trial(trial, saved.model, saved.marker_set, saved.settings)
