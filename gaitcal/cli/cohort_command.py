"""Command `cohort`: calibrate many people and print a line for each."""

import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from gaitcal.cli import options, study_folder
from gaitcal.cli.console import Console
from gaitcal.cohort import learning, one_person, run_cohort
from gaitcal.cohort.cohort_page import PAGE
from gaitcal.cohort.cohort_people import COHORT, merge_options, read_cohort
from gaitcal.cohort.learn_priors import PRIORS
from gaitcal.cohort.learn_priors import learn_priors as learn
from gaitcal.cohort.outcome import Outcome
from gaitcal.errors import UsageError
from gaitcal.gait.normal_bands import find_bands_file, read_normal_bands
from gaitcal.io.atomic import InterruptedWork, Stopped
from gaitcal.montecarlo.workers import choose_workers
from gaitcal.runtime import Progress
from gaitcal.study.cohort_prior import read_cohort_priors
from gaitcal.study.settings import CalibrationSettings

VERDICT_ORDER = ("refused", "doubtful", "trustworthy")
"""Order of verdicts in the summary: those that need attention first."""
MAX_PRINTED_FAILURES = 20
"""Number of failures printed at the end; the table has all of them."""


def run_people(
    console: Console,
    source: options.People,
    out: options.CohortOut,
    jobs: options.Jobs = -1,
    cluster: options.Scheduler = None,
    retry: options.Retry = False,
    mass: options.Mass = None,
    height: options.Height = None,
    sex: options.Sex = None,
    age: options.Age = None,
    normal: options.Normal = None,
    priors: options.Priors = None,
    learn_priors: options.LearnPriors = False,
) -> None:
    """Calibrate the people whose inputs changed, write the tables, and print a line for each.

    Exits with code 1 if a person failed.

    Raises
    ------
    UsageError
        Options exclude each other.
    InputError
        The list of people, the normal bands or the priors are invalid.
    InterruptedWork
        The run was interrupted; finished people are kept.
    """
    options_given, engine = (
        study_folder.check_person_options(mass, height, sex, age),
        choose_workers(jobs, cluster, run_cohort.make_processes),
    )
    normal = None if normal is None else find_bands_file(normal).resolve()
    if normal is not None:
        # An invalid file ends the command before the first person is calibrated.
        read_normal_bands(normal)
    # Learning from results that lean on a cohort would count it twice.
    if priors is not None:
        _refuse_with_learn_priors("--priors", learn_priors=learn_priors)
        read_cohort_priors(priors)
    cohort, calibration = read_cohort(source, out)
    priors, calibration = _choose_priors(priors, calibration, learn_priors=learn_priors)
    # Options apply to everyone; those of a person in people.csv or cohort.toml come first.
    cohort = replace(
        cohort,
        people=tuple(
            replace(p, options=merge_options(options_given, p.options)) for p in cohort.people
        ),
    )
    for name in cohort.ignored:
        console.print_line(f"not used: {name}: contains no recordings")
    for note in cohort.notes:
        console.print_line(note)
    people = len({person.name for person in cohort.people})
    if learn_priors and people < learning.FEWEST:
        console.print_line(
            f"no priors will be learnt: found {people} people, of at least {learning.FEWEST} needed"
        )
    common = one_person.CommonSettings(calibration=calibration, normal=normal, priors=priors)
    try:
        with console.show_progress() as step:
            written = run_cohort.run_cohort(
                cohort,
                out,
                common,
                engine=engine,
                retry=retry,
                report=_make_progress_printer(console, step, len(cohort.people)),
            )
    except (KeyboardInterrupt, Stopped) as ending:
        work = "finished people are kept; the same command continues with the others"
        raise InterruptedWork(ending, work) from None
    _print_summary(console, written, out)
    if learn_priors:
        with console.show_progress() as step:
            lines = learn(cohort, out, step)
        for line in lines:
            console.print_line(line)
        console.print_line(
            f"priors: {out / PRIORS} (for 'gaitcal calibrate --priors' and 'gaitcal cohort "
            "--priors')"
        )
    # A script notices that some people have no result.
    if written["failed"]:
        sys.exit(1)


def _refuse_with_learn_priors(source: str, *, learn_priors: bool) -> None:
    """Raise UsageError if priors are to be learnt although `source` gives some."""
    if learn_priors:
        raise UsageError(
            f"not with {source}: people from whom priors are learnt must have the default priors",
            field="--learn-priors",
        )


def _choose_priors(
    given: Path | None, settings: CalibrationSettings, *, learn_priors: bool
) -> tuple[Path | None, CalibrationSettings]:
    """Choose the file of priors: that of the option `--priors` or that of `cohort.toml`.

    `given`: file of the option. `settings`: `[calibration]` of `cohort.toml`. `learn_priors`:
    whether priors are to be learnt from the cohort. Returns: file of priors; the settings without
    their priors. Raises UsageError: both give a file, or priors are to be learnt. Raises
    InputError: the file of the settings is invalid.
    """
    if settings.priors is None:
        return given and given.resolve(), settings
    if given is not None:
        raise UsageError(
            f"not together with the priors of {COHORT} ([calibration] priors)", field="--priors"
        )
    _refuse_with_learn_priors(f"[calibration] priors of {COHORT}", learn_priors=learn_priors)
    read_cohort_priors(settings.priors)
    others = settings.model_dump(exclude_unset=True, exclude={"priors"})
    return settings.priors.resolve(), CalibrationSettings.model_validate(others)


def _make_progress_printer(
    console: Console, step: Progress, people: int
) -> Callable[[Outcome, int, float | None], None]:
    """Make the function that prints the outcome of each person, and the progress on a terminal."""
    step(f"0 of {people} people")

    def print_outcome(outcome: Outcome, done: int, remaining_s: float | None) -> None:
        remaining = ""
        if remaining_s is not None and done != people:
            remaining = f", {format_duration(remaining_s)} left"
        # Unchanged people are printed only with --verbose, as a second run has many of them.
        progress = f"{done} of {people}{remaining}"
        name = " ".join(filter(None, outcome.key))
        if outcome.computed:
            cause = f": {outcome.first_cause}" if outcome.first_cause else ""
            console.print_line(
                f"{name}: {outcome.verdict}{cause} ({outcome.seconds:.1f} s; {progress})"
            )
        elif console.verbose:
            console.print_line(f"{name}: {outcome.verdict}, unchanged ({progress})")
        step(progress)

    return print_outcome


def format_duration(seconds: float) -> str:
    """Format a time as `40 s`, `3 min` or `2 h 05 min`."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60:02d} min"


def _print_summary(console: Console, written: Counter[str], out: Path) -> None:
    """Print the numbers of verdicts, the failures, and the files that were written."""
    counts = ", ".join(f"{written[name]} {name}" for name in VERDICT_ORDER if written[name])
    failed = written["failed"]
    console.print_line(
        f"{written.total()} people and sessions: {counts or 'no result'}; {failed} failed"
    )
    for number, line in enumerate(run_cohort.read_failures(out)):
        if number == MAX_PRINTED_FAILURES:
            console.print_line(f"and {failed - MAX_PRINTED_FAILURES} more")
            break
        name = " ".join(filter(None, (line["person"], line["session"])))
        console.print_line(f"failed: {name}: {line['cause']}; {line['what_to_do']}")
    if failed:
        console.print_line(
            f"failures: {out / run_cohort.FAILURES} (--retry runs them again, also unchanged ones)"
        )
    console.print_line(f"page: {out / PAGE}")
    console.print_line(
        f"tables: {out / run_cohort.PEOPLE_CSV} and others; columns.csv describes the columns"
    )
