"""`gaitcal calibrate`, and `dynamics`: further recordings through the model of a result.

Options of a further trial are written on the command line as in a study file; each is read here
into what that file would hold.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Literal, cast, get_args

import typer
from rich.text import Text

from gaitcal.analysis import truth_comparison
from gaitcal.analysis.result import Calibration, Loads, TrialResult
from gaitcal.cli import options
from gaitcal.cli.console import Console, frameless_table
from gaitcal.cli.study_folder import options_of, study_or_draft
from gaitcal.errors import Code, ConvergenceError, InputError, Severity, UsageError
from gaitcal.gait import events, normal_bands
from gaitcal.intake import drafting
from gaitcal.intake.draft_file import STUDY
from gaitcal.io.csv_recordings import find_event_tables
from gaitcal.io.result_folder import ResultKind, check_output_folder
from gaitcal.model.linkage import LOWER_BODY
from gaitcal.pipeline.further_trials import analyse_trials, trial_table
from gaitcal.pipeline.run_study import (
    FaultyStudyError,
    RunSettings,
    require_one_prior,
    run_found_study,
)
from gaitcal.pipeline.write_trials import write_trials
from gaitcal.quality.verdict import Judgement, Verdict
from gaitcal.report.page.page_folder import PAGE
from gaitcal.results.saved_result import load_result
from gaitcal.study.study_file import Side
from gaitcal.study.study_trial import Role

LABELS = {
    Severity.ERROR: "error",
    Severity.WARNING: "warning",
    Severity.INFO: "note",
}  # How a reason begins


def calibrate_study(
    console: Console,
    study: options.StudyPath,
    out: options.Out,
    mass: options.Mass = None,
    height: options.Height = None,
    sex: options.Sex = None,
    age: options.Age = None,
    force: Annotated[
        bool, typer.Option("--force", help="Go on past errors that the checks find.")
    ] = False,
    hold_out: options.HoldOut = False,
    normal: options.Normal = None,
    priors: options.Priors = None,
) -> None:
    """Check and calibrate a study, or what a folder of recordings drafts, and write the result
    folder.

    `force` goes on past errors that the checks find, and keeps every trial of a drafted study.
    `normal`: file of normal bands, or the name of those that gaitcal brings. `priors`: file of a
    cohort, on which joint parameters lean where the study file names none.
    """
    normal = None if normal is None else normal_bands.bands_file(normal)
    if normal is not None:
        normal_bands.read_normal_bands(
            normal
        )  # a wrong file ends the command before recordings are read
    source = study_or_draft(study, options_of(mass, height, sex, age), console)
    require_one_prior(source, priors)
    settings = RunSettings(normal=normal, priors=priors, leave_out=hold_out, force=force)
    with console.working() as step:
        try:
            run = run_found_study(source, out, settings, step)
        except FaultyStudyError as refused:
            raise FaultyStudyError(refused.errors, study) from None
    calibration = run.calibration
    print_calibration(console, calibration)
    for note in run.study.joint_prior.notes if run.study.joint_prior else ():
        console.line(f"priors: {note}")
    _tell_changed(console, run.study.find_changed_inputs())
    tell_kept(console, run.kept)
    if run.drafted:
        console.line(
            f"study:  {out / STUDY} (drafted; look at it, and calibrate it again where you change "
            "it)"
        )
    console.line(f"page:   {out / PAGE}")
    verdict = calibration.verdict
    if verdict.judgement is Judgement.REFUSED and not force:
        raise _refused("the result is refused (it was written, with no torque valid)", verdict)
    if verdict.trials and all(map(verdict.list_refused_legs, verdict.trials)) and not force:
        raise _refused("a leg is refused in every walk (the result was written)", verdict)
    if not calibration.converged:
        late = next(phase for phase in calibration.phases if not phase.converged)
        raise ConvergenceError(
            f"phase {late.name} did not converge: {late.message} (the results were written)"
        )


def _refused(words: str, verdict: Verdict) -> InputError:
    return InputError(f"{words}: {verdict.reasons[0].cause}", code=verdict.reasons[0].code)


def analyse_further(
    console: Console,
    result: options.Result,
    trials: Annotated[
        list[Path],
        typer.Argument(metavar="TRIAL...", help="Further recordings: .c3d, .trc or .csv."),
    ],
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
    tables = dict.fromkeys(table for path in trials for table in find_event_tables(path))
    inputs = [*trials, *([forces] if forces else []), *tables]
    check_output_folder(folder, ResultKind.DYNAMICS, inputs)
    saved = load_result(result)
    given = {
        "role": role,
        "plates": _plates_of(plates),
        "time": _time_of(time),
        "filter_hz": _filter_of(filter_hz),
    }
    with console.working() as step:
        run = analyse_trials(saved, [trial_table(path, forces, **given) for path in trials], step)
        stale = write_trials(run.trials, saved, folder, inputs, run.verdict)
    verdict, late = run.verdict, run.not_converged
    _print_trials(console, run.trials)
    _print_verdict(console, verdict)
    _print_remarks(
        console, [*stale, *_no_walks(run.trials)], [n for t in run.trials for n in t.notes]
    )
    console.line(f"results: {folder}")
    console.line(f"page:    {folder / PAGE}")
    if not late and any(map(verdict.list_refused_legs, verdict.trials)) and not verdict.refused:
        raise _refused("a leg is refused (written, with none of its torques valid)", verdict)
    if verdict.refused and not late:
        raise _refused("refused (written, with no torque valid)", verdict)
    if late:
        raise ConvergenceError(
            f"tracking of {', '.join(late)} did not converge (the results were written)"
        )


def _no_walks(trials: Sequence[TrialResult]) -> list[str]:
    """What a trial that was taken as a walk looks like, where its feet do not strike in turn."""
    repeats = {
        t.name: events.activity_events(t.body, t.events).repeats
        for t in trials
        if t.role is Role.GAIT
    }
    return [
        f"{name}: taken as a walk, but its feet do not strike in turn and the pelvis goes down and "
        "up: "
        "if it is a squat, a rise or a jump, run again with --role motion"
        for name, found in repeats.items()
        if found
    ]


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
    if (
        len(numbers) == 2
        and numbers[0] is not None
        and numbers[1] is not None
        and numbers[0] < numbers[1]
    ):
        return numbers[0], numbers[1]
    raise UsageError(
        f"found '{text}'; allowed: two increasing numbers, start,end in seconds", field="--time"
    )


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
        console.line(
            f"what a code means and what to do: gaitcal explain {verdict.reasons[0].code.value}"
        )


def tell_kept(console: Console, kept: Sequence[str]) -> None:
    """Which folders of an earlier result are still there."""
    if kept:
        console.line(f"kept from the earlier result, made with its model: {', '.join(kept)}")


def _tell_changed(console: Console, inputs: Sequence[str]) -> None:
    """Which inputs are no longer those that were read: the result is of what they held before."""
    if inputs:
        console.line(
            "warning: changed while this ran, the result is of what was read: "
            f"{', '.join(inputs)}; run again"
        )


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
    for name in (
        "frames",
        "markers",
        "nominal mm",
        "calibrated mm",
        "rigid floor mm",
        "joint floor mm",
        "ratio",
    ):
        table.add_column(
            name, justify="right", min_width=max(map(len, name.split()))
        )  # no word of it is cut
    for trial in trials:
        rows = (
            {trial.name: ()} if trial.joint else {trial.name: (), "  pelvis and legs": LOWER_BODY}
        )
        for name, segments in rows.items():
            table.add_row(Text(name), str(len(trial.calibrated.time)), *_fit(trial, segments))
    console.out.print(table)
    for trial in trials:
        if held := trial.held_out:
            parts = {"": (held.nominal, held.calibrated)} | (
                {", pelvis and legs": held.legs} if held.legs else {}
            )
            for part, (nominal, calibrated) in parts.items():
                console.line(
                    f"{trial.name}{part}: on time blocks left out of the fit ({held.folds} folds), "
                    "nominal "
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
    return [str(int(trial.calibrated.errors.select_observed(*segments).sum())), *shown, ratio]


def _valid(name: str, loads: Loads) -> str:
    reactions = loads.reactions
    right, left, both = (
        int(v.sum()) for v in (reactions.valid_r, reactions.valid_l, reactions.valid)
    )
    return (
        f"{name}: torques are valid in {right} frames of the right leg, {left} of the left, {both} "
        "of the whole body"
    )


def _residuals(name: str, loads: Loads) -> str:
    parts = []
    for stage, moments in loads.moments.items():
        force, torque = moments.residual_rms(loads.reactions.valid)
        parts.append(f"{stage.short} {force:.1f} N, {torque:.1f} N·m")
    frames = int(loads.reactions.valid.sum())
    return f"{name}: pelvis residual RMS over {frames} valid frames: " + "; ".join(parts)
