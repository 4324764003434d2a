"""Take further trials through the model of a result: check, track, torques with error bars,
verdict.
"""

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
from gaitcal.preprocess.preprocessed_study import further_moves, preprocess_trial
from gaitcal.preprocess.trial_evidence import TrialEvidence
from gaitcal.quality.study_checks import check_further
from gaitcal.quality.verdict import Verdict, judge, remove_consequences, select_stopping_errors
from gaitcal.results.saved_result import SavedResult, load_result
from gaitcal.runtime import Progress, silent, with_one_blas_thread
from gaitcal.study.study_file import Side, TrialTable
from gaitcal.study.study_trial import Role, Trial, read_trial


@dataclass(frozen=True, kw_only=True, repr=False)
class FurtherTrials(Displayed):
    """Trials that were taken through the model of a result."""

    trials: tuple[TrialResult, ...]
    """In the order in which they were given."""
    verdict: Verdict
    """How far each of them can be believed, and why."""
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
    """Take a further recording of a calibrated person through the model, as `gaitcal dynamics`
    does.

    Parameters
    ----------
    result
        Result folder of a calibration.
    recording
        C3D, TRC or CSV file of the same session, with the markers of the model.
    forces
        Table of forces, where they are not in the recording.
    plates
        Plate -> `r`, `l` or `none`, where feet and plates are not found from the data.
    time
        Start and end (s) of the part to use.
    filter_hz
        Cut-off of the force filter (Hz), or `none`; as in the calibration unless given.
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
        One line: file, field, what was found, what is allowed.
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
    trial = trial_table(file, table, role=role, plates=plates or {}, time=time, filter_hz=filter_hz)
    inputs = [file, *([table] if table else []), *find_event_tables(file)]
    if out is not None:
        check_output_folder(Path(out), ResultKind.DYNAMICS, inputs)
    saved = load_result(Path(result))
    done = analyse_trials(saved, [trial])
    if out is not None:
        write_trials(done.trials, saved, Path(out), inputs, done.verdict)
    return done


def trial_table(file: Path, forces: Path | None, **given: object) -> TrialTable:
    """Describe a further recording as a study file would, under the name of its file, which may be
    any.
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
        The result that has the model.
    tables
        The trials as a study file would have them.

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
        evidence.append(_evidence(read_trial(table, saved.rename, saved.marker_set), saved))
    checked = [finding for one in evidence for finding in check_further(one)]
    findings = [*saved.doubts, *checked]
    if errors := select_stopping_errors(findings, [one.name for one in evidence]):
        raise FaultyStudyError(errors)
    done = []
    for one in evidence:
        progress(f"{one.name}: tracking and inverse dynamics")
        moves = further_moves(one)
        done.append(
            trial_result.analyse(saved.model, one.trial, saved.settings, saved.uncertainty, moves)
        )
    late = [trial.name for trial in done if not trial.calibrated.converged]
    findings += [
        *_edited(saved, done),
        *map(_not_tracked, late),
        *(f for t in done for f in t.findings),
    ]
    verdict = judge(remove_consequences(findings), [trial.name for trial in done])
    trials = tuple(trial.refused(verdict.list_refused_legs(trial.name)) for trial in done)
    return FurtherTrials(trials=trials, verdict=verdict, not_converged=tuple(late))


def _edited(saved: SavedResult, trials: Sequence[TrialResult]) -> list[Finding]:
    """Files of the result that somebody changed since it was written, said of every trial made with
    them.
    """
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


def _not_tracked(name: str) -> Finding:
    return Finding(
        severity=Severity.ERROR,
        topic="convergence",
        where=name,
        cause="tracking did not converge",
        found="its angles and torques are no minimum",
        cure="look at its markers",
        code=Code.NOT_CONVERGED,
    )


def _evidence(trial: Trial, saved: SavedResult) -> TrialEvidence:
    labels = saved.model.markers.labels
    if not set(labels) & set(trial.recording.labels):
        message = f"found none of the model's {len(labels)} markers, such as {labels[0]}"
        raise InputError(
            message, source=trial.recording.source, field="markers", code=Code.UNKNOWN_LABEL
        )
    return preprocess_trial(trial, saved.model, saved.marker_set, saved.settings)
