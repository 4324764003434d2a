"""`gaitcal calibrate`, and `dynamics`: further recordings through the model of a result.

Options of a further trial are written on the command line as in a study file; each is read here into what that file
would hold.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal, cast, get_args

import typer
from rich.text import Text

from gaitcal.cli import options
from gaitcal.cli.console import Console, frameless_table
from gaitcal.cli.folder import options_of, stop_on_errors, study_or_draft
from gaitcal.errors import Code, ConvergenceError, Finding, InputError, Severity, UsageError
from gaitcal.faults.evidence import MarkerEvidence
from gaitcal.faults.study import check_further, check_study, further_evidence, further_moves
from gaitcal.faults.verdict import Judgement, Verdict, judge, stopping, without_consequences
from gaitcal.gait import events, normal_bands
from gaitcal.io.csv import events_beside
from gaitcal.io.result_folder import ResultKind, require_room, sha256_of
from gaitcal.model.linkage import LOWER_BODY
from gaitcal.results.calibration import PAGE, write_results
from gaitcal.results.saved import SavedResult, load_result
from gaitcal.results.trials import write_trials
from gaitcal.session import drafting, trial_result, truth_comparison
from gaitcal.session.calibrate import calibrate
from gaitcal.session.draft import STUDY, Draft, draft_notes, draft_text, files_of, settings_text, study_of
from gaitcal.session.result import Calibration, Loads, TrialResult
from gaitcal.study.settings import CalibrationSettings
from gaitcal.study.study import Study, input_files, with_cohort_priors
from gaitcal.study.study_file import Side, TrialTable, load_study_file
from gaitcal.study.study_trial import Role, Trial, read_trial

LABELS = {Severity.ERROR: "error", Severity.WARNING: "warning", Severity.INFO: "note"}  # How a reason begins


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


def calibrate_study(
    console: Console,
    study: options.StudyPath,
    out: options.Out,
    mass: options.Mass = None,
    height: options.Height = None,
    sex: options.Sex = None,
    age: options.Age = None,
    force: Annotated[bool, typer.Option("--force", help="Go on past errors that the checks find.")] = False,
    hold_out: options.HoldOut = False,
    normal: options.Normal = None,
    priors: options.Priors = None,
) -> None:
    """Check and calibrate a study, or what a folder of recordings drafts, and write the result folder.

    `force` goes on past errors that the checks find, and keeps every trial of a drafted study. `normal`: file of normal
    bands, or the name of those that gaitcal brings. `priors`: file of a cohort, on which joint parameters lean
    where the study file names none.
    """
    normal = None if normal is None else normal_bands.bands_file(normal)
    bands = None if normal is None else normal_bands.read_normal_bands(normal)
    source = study_or_draft(study, options_of(mass, height, sex, age), console)
    drafted = source if isinstance(source, Draft) else None
    inputs = _inputs(source, priors)
    kept = require_room(out, ResultKind.CALIBRATION, [*inputs, *(file for file in (normal, priors) if file)])
    with console.working() as step:
        step("reading and checking the recordings")
        loaded, findings = _checked(source, priors)
        faulty: dict[str, str] = {}
        if not force and (drafted is not None or stopping(findings, loaded.walks)):
            loaded, findings, faulty = drafting.without_faulty_trials(loaded, findings)
            drafted = drafted and drafted.without(faulty)
        if drafted is not None:
            findings = (*findings, *drafting.rejected_forces(drafted))
        if not force:
            stop_on_errors(findings, loaded.walks, study)
        calibration = calibrate(loaded, step, leave_out=hold_out, checked=findings)
        notes = draft_notes(drafted) if drafted is not None else drafting.faulty_notes(faulty)
        calibration = replace(
            calibration, notes=(*notes, *calibration.notes), left_out={**faulty, **calibration.left_out}
        )
        step("writing the results")
        made_with = {} if normal is None else {"normal": normal.name, "normal_sha256": sha256_of(normal)}
        text = None if drafted is None else draft_text(drafted, out) + settings_text(CalibrationSettings(), priors, out)
        write_results(calibration, out, made_with, drafted=text, normal=bands)
    print_calibration(console, calibration)
    for note in loaded.joint_prior.notes if loaded.joint_prior else ():
        console.line(f"priors: {note}")
    _tell_changed(console, loaded.changed_inputs())
    tell_kept(console, kept)
    if drafted is not None:
        console.line(f"study:  {out / STUDY} (drafted; look at it, and calibrate it again where you change it)")
    console.line(f"page:   {out / PAGE}")
    verdict = calibration.verdict
    if verdict.judgement is Judgement.REFUSED and not force:
        raise _refused("the result is refused (it was written, with no torque valid)", verdict)
    if verdict.trials and all(map(verdict.refused_legs, verdict.trials)) and not force:
        raise _refused("a leg is refused in every walk (the result was written)", verdict)
    if not calibration.converged:
        late = next(phase for phase in calibration.phases if not phase.converged)
        raise ConvergenceError(f"phase {late.name} did not converge: {late.message} (the results were written)")


def _refused(words: str, verdict: Verdict) -> InputError:
    return InputError(f"{words}: {verdict.reasons[0].cause}", code=verdict.reasons[0].code)


def analyse_further(
    console: Console,
    result: options.Result,
    trials: Annotated[list[Path], typer.Argument(metavar="TRIAL...", help="Further recordings: .c3d, .trc or .csv.")],
    forces: options.Forces = None,
    plates: options.Plates = None,
    time: options.Part = None,
    filter_hz: options.FilterHz = None,
    role: options.TrialRole = Role.GAIT.value,
    out: options.DynamicsOut = None,
) -> None:
    """Check further trials and take them through the model of a result folder."""
    _only_for_one({"--forces": forces, "--plates": plates, "--time": time}, len(trials))
    if role not in (Role.GAIT.value, Role.MOTION.value):
        raise UsageError(f"found '{role}'; allowed: gait or motion", field="--role")
    names = [path.stem for path in trials]
    if len(set(names)) != len(names):
        message = "found two trials with one name; a trial's name is its file's, without the ending"
        raise InputError(message, code=Code.PART_OF_TRIAL)
    folder = out or result / "dynamics"
    tables = dict.fromkeys(table for path in trials for table in events_beside(path))
    inputs = [*trials, *([forces] if forces else []), *tables]
    require_room(folder, ResultKind.DYNAMICS, inputs)
    saved = load_result(result)
    with console.working() as step:
        read = []
        for path in trials:
            step(f"{path.name}: reading and checking")
            given: dict[str, object] = {"role": role, "plates": _plates_of(plates), "time": _time_of(time)}
            given["filter_hz"] = _filter_of(filter_hz)
            read.append(_read(path, forces, given, saved))
        evidence = [_evidence(trial, saved) for trial in read]
        checked = [finding for one in evidence for finding in check_further(one)]
        stop_on_errors([*saved.doubts, *checked], [trial.name for trial in read])
        findings = [*saved.doubts, *checked]
        done = []
        for one in evidence:
            step(f"{one.name}: tracking and inverse dynamics")
            done.append(
                trial_result.analyse(saved.model, one.trial, saved.settings, saved.uncertainty, further_moves(one))
            )
        late = [trial.name for trial in done if not trial.calibrated.converged]
        findings += [*_edited(saved, done), *map(_not_tracked, late), *(f for t in done for f in t.findings)]
        verdict = judge(without_consequences(findings), [trial.name for trial in done])
        done = [trial.refused(verdict.refused_legs(trial.name)) for trial in done]
        stale = write_trials(done, saved, folder, inputs, verdict)
    _print_trials(console, done)
    _print_verdict(console, verdict)
    _print_remarks(console, [*stale, *_no_walks(done)], [n for t in done for n in t.notes])
    console.line(f"results: {folder}")
    console.line(f"page:    {folder / PAGE}")
    if not late and any(map(verdict.refused_legs, verdict.trials)) and not verdict.refused:
        raise _refused("a leg is refused (written, with none of its torques valid)", verdict)
    if verdict.refused and not late:
        raise _refused("refused (written, with no torque valid)", verdict)
    if late:
        raise ConvergenceError(f"tracking of {', '.join(late)} did not converge (the results were written)")


def _no_walks(trials: Sequence[TrialResult]) -> list[str]:
    """What a trial that was taken as a walk looks like, where its feet do not strike in turn."""
    repeats = {t.name: events.activity_events(t.body, t.events).repeats for t in trials if t.role is Role.GAIT}
    return [
        f"{name}: taken as a walk, but its feet do not strike in turn and the pelvis goes down and up: "
        "if it is a squat, a rise or a jump, run again with --role motion"
        for name, found in repeats.items()
        if found
    ]


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


def _read(path: Path, forces: Path | None, given: Mapping[str, object], saved: SavedResult) -> Trial:
    """A recording as a study would have it: labels renamed, time cut out, plates given to feet."""
    trial = TrialTable(name="trial", role="gait", file=path, forces=forces).model_copy(
        update={"name": path.stem, **given}
    )
    return read_trial(trial, saved.rename, saved.marker_set)


def _evidence(trial: Trial, saved: SavedResult) -> MarkerEvidence:
    labels = saved.model.markers.labels
    if not set(labels) & set(trial.recording.labels):
        message = f"found none of the model's {len(labels)} markers, such as {labels[0]}"
        raise InputError(message, source=trial.recording.source, field="markers", code=Code.UNKNOWN_LABEL)
    return further_evidence(trial, saved.model, saved.marker_set, saved.settings)


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


# ------------------------------------------------------------------------------------------------ what is printed


def print_calibration(console: Console, calibration: Calibration) -> None:
    """The summary of a calibration: fit of every trial, pelvis residuals, verdict."""
    _print_trials(console, calibration.trials)
    for total in truth_comparison.sums(calibration, calibration.truth) if calibration.truth else ():
        console.line(total.sentence)
    _print_verdict(console, calibration.verdict)
    for note in drafting.faulty_notes(calibration.left_out):
        console.line(note)
    _print_remarks(console, (), calibration.notes)


def _print_verdict(console: Console, verdict: Verdict) -> None:
    """How far the result can be believed, and why."""
    console.line(f"verdict: {verdict.judgement.value}. {verdict.sentence}")
    for reason in verdict.reasons:
        console.line(f"{LABELS[reason.severity]}: {reason.line} [{reason.code.value}]")
    if verdict.reasons:
        console.line(f"what a code means and what to do: gaitcal explain {verdict.reasons[0].code.value}")


def tell_kept(console: Console, kept: Sequence[str]) -> None:
    """Which folders of an earlier result are still there."""
    if kept:
        console.line(f"kept from the earlier result, made with its model: {', '.join(kept)}")


def _tell_changed(console: Console, inputs: Sequence[str]) -> None:
    """Which inputs are no longer those that were read: the result is of what they held before."""
    if inputs:
        console.line(f"warning: changed while this ran, the result is of what was read: {', '.join(inputs)}; run again")


def _print_remarks(console: Console, warnings: Sequence[str], notes: Sequence[str]) -> None:
    """Warnings, and with -v what was assumed."""
    for warning in warnings:
        console.line(f"warning: {warning}")
    if console.verbose:
        for note in notes:
            console.line(f"note: {note}")


def _print_trials(console: Console, trials: Sequence[TrialResult]) -> None:
    """Fit of every trial beside its floors, its ratio to that of the joints, and pelvis residuals."""
    table = frameless_table(())
    table.add_column("trial", no_wrap=True)
    for name in ("frames", "markers", "nominal mm", "calibrated mm", "rigid floor mm", "joint floor mm", "ratio"):
        table.add_column(name, justify="right", min_width=max(map(len, name.split())))  # no word of it is cut
    for trial in trials:
        rows = {trial.name: ()} if trial.joint else {trial.name: (), "  pelvis and legs": LOWER_BODY}
        for name, segments in rows.items():
            table.add_row(Text(name), str(len(trial.calibrated.time)), *_fit(trial, segments))
    console.out.print(table)
    for trial in trials:
        if held := trial.held_out:
            parts = {"": (held.nominal, held.calibrated)} | ({", pelvis and legs": held.legs} if held.legs else {})
            for part, (nominal, calibrated) in parts.items():
                console.line(
                    f"{trial.name}{part}: on time blocks left out of the fit ({held.folds} folds), nominal "
                    f"{1e3 * nominal:.2f} mm, calibrated {1e3 * calibrated:.2f} mm"
                )
    for trial in trials:
        if trial.loads is not None:
            console.line(_valid(trial.name, trial.loads))
            if trial.loads.reactions.valid.any():
                console.line(_residuals(trial.name, trial.loads))


def _fit(trial: TrialResult, segments: tuple[str, ...]) -> list[str]:
    _, calibrated, _ = values = trial.rms_mm(*segments)
    floor = trial.joint_floor_mm(*segments)
    shown = ["-" if v is None else f"{v:.2f}" for v in (*values, floor)]
    ratio = f"{calibrated / floor:.2f}" if calibrated is not None and floor else "-"
    return [str(int(trial.calibrated.errors.kept(*segments).sum())), *shown, ratio]


def _valid(name: str, loads: Loads) -> str:
    reactions = loads.reactions
    right, left, both = (int(v.sum()) for v in (reactions.valid_r, reactions.valid_l, reactions.valid))
    return f"{name}: torques are valid in {right} frames of the right leg, {left} of the left, {both} of the whole body"


def _residuals(name: str, loads: Loads) -> str:
    parts = []
    for stage, moments in loads.moments.items():
        force, torque = moments.residual_rms(loads.reactions.valid)
        parts.append(f"{stage.short} {force:.1f} N, {torque:.1f} N·m")
    frames = int(loads.reactions.valid.sum())
    return f"{name}: pelvis residual RMS over {frames} valid frames: " + "; ".join(parts)
