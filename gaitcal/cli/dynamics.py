"""`gaitcal dynamics`: further recordings through the model of a result folder.

Options of a further trial are written on the command line as in a study file; each is read here into what that file
would hold.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, cast, get_args

from gaitcal.cli.check import stop_on_errors
from gaitcal.cli.console import Console, print_remarks, print_trials, print_verdict
from gaitcal.codes import Code
from gaitcal.errors import ConvergenceError, InputError, UsageError
from gaitcal.faults.study import check_further
from gaitcal.faults.verdict import judge, without_consequences
from gaitcal.findings import Finding, Severity
from gaitcal.io.atomic import require_room
from gaitcal.io.lock import ResultKind
from gaitcal.results.page_files import PAGE
from gaitcal.results.saved import SavedResult, load_result
from gaitcal.results.trials import write_trials
from gaitcal.session.result import TrialResult
from gaitcal.session.trial_result import analyse
from gaitcal.study.study_file import Side, Trial
from gaitcal.study.study_trial import StudyTrial, read_trial


@dataclass(frozen=True)
class Options:
    """The options of the command line, as they were written."""

    forces: Path | None = None
    plates: str | None = None
    time: str | None = None
    filter_hz: str | None = None


def run(result: Path, trials: list[Path], options: Options, out: Path | None, console: Console) -> None:
    """Check further trials and take them through the model of a result folder."""
    _only_for_one({"--forces": options.forces, "--plates": options.plates, "--time": options.time}, len(trials))
    names = [path.stem for path in trials]
    if len(set(names)) != len(names):
        raise InputError(
            "found two trials with one name; a trial's name is its file's, without the ending", code=Code.PART_OF_TRIAL
        )
    folder = out or result / "dynamics"
    inputs = [*trials, *([options.forces] if options.forces else [])]
    require_room(folder, ResultKind.DYNAMICS, inputs)
    saved = load_result(result)
    with console.working() as step:
        read = []
        for path in trials:
            step(f"{path.name}: reading and checking")
            read.append(_read(path, options, saved))
        checked = [finding for trial in read for finding in _check(trial, saved)]
        stop_on_errors([*saved.doubts, *checked], [trial.name for trial in read])
        findings = [*saved.doubts, *checked]
        done = []
        for trial in read:
            step(f"{trial.name}: tracking and inverse dynamics")
            done.append(analyse(saved.model, trial, saved.settings, saved.uncertainty))
        late = [trial.name for trial in done if not trial.calibrated.converged]
        findings += [*_edited(saved, done), *map(_not_tracked, late), *(f for t in done for f in t.findings)]
        verdict = judge(without_consequences(findings), [trial.name for trial in done])
        done = [trial.refused(verdict.refused_legs(trial.name)) for trial in done]
        stale = write_trials(done, saved, folder, inputs, verdict)
    print_trials(console, done)
    print_verdict(console, verdict)
    print_remarks(console, stale, [n for t in done for n in t.notes])
    console.line(f"results: {folder}")
    console.line(f"page:    {folder / PAGE}")
    if not late and any(map(verdict.refused_legs, verdict.trials)) and not verdict.refused:
        raise InputError(
            f"a leg is refused (written, with none of its torques valid): {verdict.reasons[0].cause}",
            code=verdict.reasons[0].code,
        )
    if verdict.refused and not late:
        raise InputError(
            f"refused (written, with no torque valid): {verdict.reasons[0].cause}", code=verdict.reasons[0].code
        )
    if late:
        raise ConvergenceError(f"tracking of {', '.join(late)} did not converge (the results were written)")


def _edited(saved: SavedResult, trials: Sequence[TrialResult]) -> list[Finding]:
    """Files of the result that somebody changed since it was written, said of every trial made with them."""
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


def _read(path: Path, options: Options, saved: SavedResult) -> StudyTrial:
    """A recording as a study would have it: labels renamed, time cut out, plates given to feet."""
    trial = Trial(name="trial", role="gait", file=path, forces=options.forces).model_copy(
        update={
            "name": path.stem,
            "plates": _plates_of(options.plates),
            "time": _time_of(options.time),
            "filter_hz": _filter_of(options.filter_hz),
        }
    )
    return read_trial(trial, saved.rename, saved.marker_set)


def _check(trial: StudyTrial, saved: SavedResult) -> tuple[Finding, ...]:
    labels = saved.model.markers.labels
    if not set(labels) & set(trial.recording.labels):
        raise InputError(
            f"found none of the model's {len(labels)} markers, such as {labels[0]}",
            source=trial.recording.source,
            field="markers",
            code=Code.UNKNOWN_LABEL,
        )
    return check_further(trial, saved.model, saved.marker_set, saved.settings)


def _plates_of(text: str | None) -> dict[str, Side]:
    """`1=r,2=l` -> plate and foot."""
    out: dict[str, Side] = {}
    for part in [] if text is None else text.split(","):
        name, equals, side = (word.strip() for word in part.rpartition("="))
        if not name or not equals or side not in get_args(Side) or name in out:
            allowed = "plate=foot, each plate once, the foot r, l or none, such as 1=r,2=l"
            raise UsageError(f"found '{part.strip()}'; allowed: {allowed}", field="--plates")
        out[name] = cast(Side, side)
    return out


def _time_of(text: str | None) -> tuple[float, float] | None:
    """`0.4,1.6` -> start and end in s."""
    if text is None:
        return None
    numbers = [_number(part) for part in text.split(",")]
    if len(numbers) == 2 and numbers[0] is not None and numbers[1] is not None and numbers[0] < numbers[1]:
        return numbers[0], numbers[1]
    raise UsageError(f"found '{text}'; allowed: two increasing numbers, start,end in seconds", field="--time")


def _filter_of(text: str | None) -> float | Literal["none"] | None:
    """`6` or `none` -> cut-off in Hz; None: as in the calibration."""
    if text is None or text == "none":
        return cast(Literal["none"] | None, text)
    number = _number(text)
    if number is None or number <= 0:
        raise UsageError(f"found '{text}'; allowed: a number above 0, or none", field="--filter-hz")
    return number


def _only_for_one(options: Mapping[str, object], trials: int) -> None:
    """Refuse options that say something of one recording where there are several."""
    for name, value in options.items():
        if value is not None and trials != 1:
            raise UsageError(f"found {trials} trials; allowed: one, of which it speaks", field=name)


def _number(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if abs(value) < 1e9 else None  # neither infinite nor NaN
