"""`gaitcal cohort`."""

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
from gaitcal.gait.normal_bands import bands_file, read_normal_bands
from gaitcal.io.atomic import InterruptedWork, Stopped
from gaitcal.montecarlo.workers import choose_workers
from gaitcal.runtime import Progress
from gaitcal.study.cohort_prior import read_cohort_priors
from gaitcal.study.settings import CalibrationSettings

ORDER = ("refused", "doubtful", "trustworthy")  # Verdicts, those first that somebody should look at
MOST_TOLD = 20  # Failures that are printed at the end; all of them are in the table


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
    """Calibrate everyone who changed, write the tables, print a line for each; exit code 1 where
    somebody failed.
    """
    options_given, engine = (
        study_folder.options_of(mass, height, sex, age),
        choose_workers(jobs, cluster, run_cohort.make_processes),
    )
    normal = None if normal is None else bands_file(normal).resolve()
    if normal is not None:
        read_normal_bands(normal)  # what is wrong with it is told before the night
    if priors is not None:
        _require_none_to_learn("--priors", learn_priors=learn_priors)
        read_cohort_priors(priors)
    cohort, calibration = read_cohort(source, out)
    priors, calibration = _priors(priors, calibration, learn_priors=learn_priors)
    cohort = replace(
        cohort,
        people=tuple(
            replace(p, options=merge_options(options_given, p.options)) for p in cohort.people
        ),
    )
    for name in cohort.ignored:
        console.line(f"not used: {name}: holds no recordings")
    for note in cohort.notes:
        console.line(note)
    if (
        learn_priors
        and (people := len({person.name for person in cohort.people})) < learning.FEWEST
    ):
        console.line(
            f"no priors will be learnt: {people} people, of {learning.FEWEST} or more they can be"
        )
    common = one_person.CommonSettings(calibration=calibration, normal=normal, priors=priors)
    try:
        with console.working() as step:
            written = run_cohort.run_cohort(
                cohort,
                out,
                common,
                engine=engine,
                retry=retry,
                report=_teller(console, step, len(cohort.people)),
            )
    except (KeyboardInterrupt, Stopped) as ending:
        work = "whoever had ended is kept, the same command goes on with the others"
        raise InterruptedWork(ending, work) from None
    _tell_end(console, written, out)
    if learn_priors:
        with console.working() as step:
            lines = learn(cohort, out, step)
        for line in lines:
            console.line(line)
        console.line(
            f"priors: {out / PRIORS} (for 'gaitcal calibrate --priors' and 'gaitcal cohort "
            "--priors')"
        )
    if written["failed"]:
        sys.exit(1)


def _require_none_to_learn(named: str, *, learn_priors: bool) -> None:
    if learn_priors:
        raise UsageError(
            f"not with {named}: priors are learnt of people who lean on none",
            field="--learn-priors",
        )


def _priors(
    said: Path | None, settings: CalibrationSettings, *, learn_priors: bool
) -> tuple[Path | None, CalibrationSettings]:
    """The file of priors for everyone, by the option or the settings of a `cohort.toml`, and the
    other settings.

    Raises UsageError: Both name one, or some are to be learnt.
    Raises InputError: What the settings name is no such file.
    """
    if settings.priors is None:
        return said and said.resolve(), settings
    if said is not None:
        raise UsageError(
            f"not beside the priors that {COHORT} names ([calibration] priors)", field="--priors"
        )
    _require_none_to_learn(f"[calibration] priors of {COHORT}", learn_priors=learn_priors)
    read_cohort_priors(settings.priors)
    others = settings.model_dump(exclude_unset=True, exclude={"priors"})
    return settings.priors.resolve(), CalibrationSettings.model_validate(others)


def _teller(
    console: Console, step: Progress, people: int
) -> Callable[[Outcome, int, float | None], None]:
    step(f"0 of {people} people")

    def tell(outcome: Outcome, done: int, remaining_s: float | None) -> None:
        left = "" if remaining_s is None or done == people else f", {duration(remaining_s)} left"
        far = f"{done} of {people}{left}"
        who = " ".join(filter(None, outcome.key))
        if outcome.computed:
            cause = f": {outcome.first_cause}" if outcome.first_cause else ""
            console.line(f"{who}: {outcome.verdict}{cause} ({outcome.seconds:.1f} s; {far})")
        elif console.verbose:
            console.line(f"{who}: {outcome.verdict}, unchanged ({far})")
        step(far)

    return tell


def duration(seconds: float) -> str:
    """`40 s`, `3 min`, `2 h 05 min`."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60:02d} min"


def _tell_end(console: Console, written: Counter[str], out: Path) -> None:
    counts = ", ".join(f"{written[name]} {name}" for name in ORDER if written[name])
    failed = written["failed"]
    console.line(f"{written.total()} people and sessions: {counts or 'no result'}; {failed} failed")
    for number, line in enumerate(run_cohort.read_failures(out)):
        if number == MOST_TOLD:
            console.line(f"and {failed - MOST_TOLD} more")
            break
        who = " ".join(filter(None, (line["person"], line["session"])))
        console.line(f"failed: {who}: {line['cause']}; {line['what_to_do']}")
    if failed:
        console.line(
            f"failures: {out / run_cohort.FAILURES} (--retry tries them again where nothing "
            "changed)"
        )
    console.line(f"page: {out / PAGE}")
    console.line(
        f"tables: {out / run_cohort.PEOPLE_CSV} and beside it; columns.csv says what they mean"
    )
