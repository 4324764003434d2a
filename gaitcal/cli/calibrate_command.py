"""Commands `calibrate` and `dynamics`, and the summary that they print.

`dynamics` takes the options of a trial on the command line; they are parsed here into the values
that a study file would have.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Literal, cast, get_args

import typer
from rich.text import Text

from gaitcal.analysis import truth_comparison
from gaitcal.analysis.result import Calibration, Loads, TrialResult
from gaitcal.cli import options
from gaitcal.cli.console import Console, make_frameless_table
from gaitcal.cli.study_folder import check_person_options, find_or_draft_study
from gaitcal.errors import Code, ConvergenceError, InputError, Severity, UsageError
from gaitcal.gait import events, normal_bands
from gaitcal.intake import drafting
from gaitcal.intake.draft_file import STUDY
from gaitcal.io.csv_recordings import find_event_tables
from gaitcal.io.result_folder import ResultKind, check_output_folder
from gaitcal.model.linkage import LOWER_BODY
from gaitcal.pipeline.further_trials import analyse_trials, make_trial_table
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

LABELS = {Severity.ERROR: "error", Severity.WARNING: "warning", Severity.INFO: "note"}
"""Severity -> first word of a reason."""


def calibrate_study(
    console: Console,
    study: options.StudyPath,
    out: options.Out,
    mass: options.Mass = None,
    height: options.Height = None,
    sex: options.Sex = None,
    age: options.Age = None,
    force: Annotated[
        bool, typer.Option("--force", help="Continue after errors that the checks find.")
    ] = False,
    hold_out: options.HoldOut = False,
    normal: options.Normal = None,
    priors: options.Priors = None,
) -> None:
    """Check and calibrate a study, or a folder of recordings, and write the result folder.

    Parameters
    ----------
    force
        Continue after errors that the checks find, and keep every trial of a drafted study.
    normal
        File of normal bands, or the name of built-in ones.
    priors
        Joint priors of a cohort, for a study file that names none.

    Raises
    ------
    InputError
        The study is invalid or has errors, or the verdict refuses the result or a leg in every
        walk. In the last two cases the result is written.
    ConvergenceError
        A phase did not converge; the result is written.
    """
    normal = None if normal is None else normal_bands.find_bands_file(normal)
    if normal is not None:
        # An invalid file ends the command before recordings are read.
        normal_bands.read_normal_bands(normal)
    source = find_or_draft_study(study, check_person_options(mass, height, sex, age), console)
    # Options are checked before the recordings are read, which takes seconds.
    require_one_prior(source, priors)
    settings = RunSettings(normal=normal, priors=priors, compute_held_out=hold_out, force=force)
    with console.show_progress() as step:
        try:
            run = run_found_study(source, out, settings, step)
        except FaultyStudyError as refused:
            raise FaultyStudyError(refused.errors, study) from None
    calibration = run.calibration
    print_calibration(console, calibration)
    for note in run.study.joint_prior.notes if run.study.joint_prior else ():
        console.print_line(f"priors: {note}")
    # Files that were saved during the run belong to another result.
    _warn_of_changed_inputs(console, run.study.changed_inputs())
    print_kept_folders(console, run.kept)
    if run.was_drafted:
        console.print_line(
            f"study:  {out / STUDY} (drafted; review it, and calibrate again if you change it)"
        )
    console.print_line(f"page:   {out / PAGE}")
    verdict = calibration.verdict
    # The result is written in any case; by the exit code a script knows that it must not be used.
    if verdict.judgement is Judgement.REFUSED and not force:
        raise _make_refusal_error(
            "the result is refused (it was written, with no torque valid)", verdict
        )
    if verdict.trials and all(map(verdict.list_refused_legs, verdict.trials)) and not force:
        raise _make_refusal_error(
            "a leg is refused in every walk (the result was written)", verdict
        )
    if not calibration.converged:
        failed = next(phase for phase in calibration.phases if not phase.converged)
        raise ConvergenceError(
            f"phase {failed.name} did not converge: {failed.message} (the results were written)"
        )


def _make_refusal_error(message: str, verdict: Verdict) -> InputError:
    """Make the error of a refused result from the worst reason of its verdict."""
    return InputError(f"{message}: {verdict.reasons[0].cause}", code=verdict.reasons[0].code)


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
    """Analyse further trials with the model of a result, and write their folder.

    Parameters
    ----------
    forces, plates, time
        Options of a single trial.
    role
        `gait` or `motion`.

    Raises
    ------
    InputError
        A recording is invalid or has errors, or the verdict refuses a trial or a leg. In the last
        two cases the trials are written.
    ConvergenceError
        Tracking did not converge; the trials are written.
    """
    _require_single_trial({"--forces": forces, "--plates": plates, "--time": time}, len(trials))
    if role not in (Role.GAIT.value, Role.MOTION.value):
        raise UsageError(f"found '{role}'; allowed: gait or motion", field="--role")
    names = [path.stem for path in trials]
    # Files of further trials are named by their recordings.
    if len(set(names)) != len(names):
        message = "found two trials of the same name (file names without endings)"
        raise InputError(message, code=Code.PART_OF_TRIAL)
    folder = out or result / "dynamics"
    tables = dict.fromkeys(table for path in trials for table in find_event_tables(path))
    inputs = [*trials, *([forces] if forces else []), *tables]
    check_output_folder(folder, ResultKind.DYNAMICS, inputs)
    saved = load_result(result)
    # Values as in a study file
    given = {
        "role": role,
        "plates": _parse_plates(plates),
        "time": _parse_time(time),
        "filter_hz": _parse_filter(filter_hz),
    }
    with console.show_progress() as step:
        run = analyse_trials(
            saved, [make_trial_table(path, forces, **given) for path in trials], step
        )
        stale = write_trials(run.trials, saved, folder, inputs, run.verdict)
    verdict, not_converged = run.verdict, run.not_converged
    _print_trials(console, run.trials)
    _print_verdict(console, verdict)
    _print_remarks(
        console, [*stale, *_find_non_walks(run.trials)], [n for t in run.trials for n in t.notes]
    )
    console.print_line(f"results: {folder}")
    console.print_line(f"page:    {folder / PAGE}")
    if (
        not not_converged
        and any(map(verdict.list_refused_legs, verdict.trials))
        and not verdict.refused
    ):
        raise _make_refusal_error(
            "a leg is refused (written, with none of its torques valid)", verdict
        )
    if verdict.refused and not not_converged:
        raise _make_refusal_error("refused (written, with no torque valid)", verdict)
    if not_converged:
        raise ConvergenceError(
            f"tracking of {', '.join(not_converged)} did not converge (the results were written)"
        )


def _find_non_walks(trials: Sequence[TrialResult]) -> list[str]:
    """Describe trials with the role `gait` whose movement looks like another activity."""
    repeats = {
        t.name: events.find_activity_events(t.body, t.events).repeats
        for t in trials
        if t.role is Role.GAIT
    }
    out: list[str] = []
    for name, found in repeats.items():
        if found:
            out.append(
                f"{name}: has the role gait, but its feet do not strike in turn and the pelvis "
                "moves down and up; if it is a squat, a rise or a jump, run again with --role "
                "motion"
            )
    return out


def _parse_plates(text: str | None) -> dict[str, Side]:
    """Parse `1=r,2=l` to plate -> foot."""
    out: dict[str, Side] = {}
    for part in [] if text is None else text.split(","):
        name, equals, side = (piece.strip() for piece in part.rpartition("="))
        if not name or not equals or side not in get_args(Side) or name in out:
            allowed = "plate=foot, each plate once, the foot r, l or none, such as 1=r,2=l"
            raise UsageError(f"found '{part.strip()}'; allowed: {allowed}", field="--plates")
        out[name] = cast(Side, side)
    return out


def _parse_time(text: str | None) -> tuple[float, float] | None:
    """Parse `0.4,1.6` to start and end (s)."""
    if text is None:
        return None
    numbers = [_parse_number(part) for part in text.split(",")]
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


def _parse_filter(text: str | None) -> float | Literal["none"] | None:
    """Parse `6` or `none` to a cut-off (Hz); None: that of the calibration."""
    if text is None or text == "none":
        return cast(Literal["none"] | None, text)
    number = _parse_number(text)
    if number is None or number <= 0:
        raise UsageError(f"found '{text}'; allowed: a number above 0, or none", field="--filter-hz")
    return number


def _require_single_trial(options: Mapping[str, object], trials: int) -> None:
    """Raise UsageError if an option of a single trial is given for several trials."""
    for name, value in options.items():
        if value is not None and trials != 1:
            raise UsageError(f"found {trials} trials; allowed: with one trial", field=name)


def _parse_number(text: str) -> float | None:
    """Parse a finite number; None if the text is none."""
    try:
        value = float(text)
    except ValueError:
        return None
    # The comparison is also false for NaN.
    return value if abs(value) < 1e9 else None


def print_calibration(console: Console, calibration: Calibration) -> None:
    """Print the summary of a calibration: fit of every trial, pelvis residuals, verdict."""
    _print_trials(console, calibration.trials)
    if calibration.truth:
        for total in truth_comparison.summarise_errors(calibration, calibration.truth):
            console.print_line(total.sentence)
    _print_verdict(console, calibration.verdict)
    for note in drafting.list_faulty_notes(calibration.left_out):
        console.print_line(note)
    _print_remarks(console, (), calibration.notes)


def _print_verdict(console: Console, verdict: Verdict) -> None:
    """Print the verdict and its reasons."""
    console.print_line(f"verdict: {verdict.judgement.value}. {verdict.sentence}")
    for reason in verdict.reasons:
        console.print_line(f"{LABELS[reason.severity]}: {reason.line} [{reason.code.value}]")
    if verdict.reasons:
        console.print_line(
            f"meaning and remedy of a code: gaitcal explain {verdict.reasons[0].code.value}"
        )


def print_kept_folders(console: Console, kept: Sequence[str]) -> None:
    """Print the folders of an earlier result that were kept."""
    if kept:
        console.print_line(f"kept from the earlier result, with its model: {', '.join(kept)}")


def _warn_of_changed_inputs(console: Console, inputs: Sequence[str]) -> None:
    """Print a warning on input files that changed after they were read."""
    if inputs:
        console.print_line(
            f"warning: {', '.join(inputs)} changed during the run, and the result has the earlier "
            "content; run again"
        )


def _print_remarks(console: Console, warnings: Sequence[str], notes: Sequence[str]) -> None:
    """Print warnings and, with `-v`, assumptions."""
    for warning in warnings:
        console.print_line(f"warning: {warning}")
    if console.verbose:
        for note in notes:
            console.print_line(f"note: {note}")


def _print_trials(console: Console, trials: Sequence[TrialResult]) -> None:
    """Print marker distances of every trial with their floors, held-out errors and residuals.

    The ratio is that of the calibrated distance to the joint floor.
    """
    table = make_frameless_table(())
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
        # Headings wrap between words only.
        table.add_column(name, justify="right", min_width=max(map(len, name.split())))
    for trial in trials:
        rows = (
            {trial.name: ()} if trial.joint else {trial.name: (), "  pelvis and legs": LOWER_BODY}
        )
        for name, segments in rows.items():
            table.add_row(
                Text(name), str(len(trial.calibrated.time)), *_format_fit(trial, segments)
            )
    console.out.print(table)
    for trial in trials:
        held = trial.held_out
        # Held-out errors are the honest ones: frames that the fit did not use.
        if held:
            parts = {"": (held.nominal, held.calibrated)} | (
                {", pelvis and legs": held.legs} if held.legs else {}
            )
            for part, (nominal, calibrated) in parts.items():
                console.print_line(
                    f"{trial.name}{part}: on time blocks left out of the fit ({held.folds} folds), "
                    "nominal "
                    f"{1e3 * nominal:.2f} mm, calibrated {1e3 * calibrated:.2f} mm"
                )
    for trial in trials:
        if trial.loads is not None:
            console.print_line(_format_valid_frames(trial.name, trial.loads))
            if trial.loads.reactions.valid.any():
                console.print_line(_format_residuals(trial.name, trial.loads))


def _format_fit(trial: TrialResult, segments: tuple[str, ...]) -> list[str]:
    """Format the cells of a row: markers, distances (mm) and ratio of these segments."""
    _, calibrated, _ = values = trial.compute_rms_mm(*segments)
    floor = trial.compute_joint_floor_mm(*segments)
    shown = ["-" if v is None else f"{v:.2f}" for v in (*values, floor)]
    ratio = f"{calibrated / floor:.2f}" if calibrated is not None and floor else "-"
    return [str(int(trial.calibrated.errors.select_observed(*segments).sum())), *shown, ratio]


def _format_valid_frames(name: str, loads: Loads) -> str:
    """Format the numbers of frames with valid torques."""
    reactions = loads.reactions
    right, left, both = (
        int(v.sum()) for v in (reactions.valid_r, reactions.valid_l, reactions.valid)
    )
    return (
        f"{name}: frames with valid torques: {right} of the right leg, {left} of the left leg, "
        f"{both} of the whole body"
    )


def _format_residuals(name: str, loads: Loads) -> str:
    """Format the pelvis residual (N, N·m) of each stage."""
    parts = []
    for stage, moments in loads.moments.items():
        force, torque = moments.residual_rms(loads.reactions.valid)
        parts.append(f"{stage.short_label} {force:.1f} N, {torque:.1f} N·m")
    frames = int(loads.reactions.valid.sum())
    return f"{name}: pelvis residual RMS over {frames} valid frames: " + "; ".join(parts)
