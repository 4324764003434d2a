"""`gaitcal init` and `gaitcal check`, and what commands do with a folder instead of a study file."""

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table
from rich.text import Text

from gaitcal.cli import options
from gaitcal.cli.console import Console, frameless_table
from gaitcal.errors import Code, Finding, InputError, Severity, UsageError
from gaitcal.intake import draft_file as drafts
from gaitcal.intake.drafting import draft_folder, draft_study, find_rejected_forces
from gaitcal.intake.recordings_folder import Folder, read_folder
from gaitcal.intake.subject_metadata import Options
from gaitcal.io import atomic, formats
from gaitcal.preprocess.study_model import build_nominal_model
from gaitcal.quality.study_checks import check_file, check_study
from gaitcal.study.study_trial import Role

MASS_KG, HEIGHT_M, AGE_YEARS = (2.0, 400.0), (0.3, 2.6), (0.0, 130.0)
SEXES = ("female", "male")
QUESTIONS = {"mass_kg": "body mass in kg", "height_m": "body height in m", "sex": "female or male"}
PLAIN_WIDTH = 170  # Columns of the table where the output is no terminal


def options_of(
    mass: float | None, height: float | None, sex: str | None, age: float | None
) -> Options:
    """What the user says of the person; UsageError where it cannot be."""
    _within("--mass", mass, MASS_KG, "kg")
    hint = {True: f"; {height or 0:g} looks like centimetres: --height {(height or 0) / 100:g}"}
    _within("--height", height, HEIGHT_M, "m", hint.get(30 <= (height or 0) <= 260, ""))
    _within("--age", age, AGE_YEARS, "years")
    if sex is not None and sex not in SEXES:
        raise UsageError(f"found '{sex[:40]}'; allowed: {' or '.join(SEXES)}", field="--sex")
    return Options(mass=mass, height=height, sex=sex, age=age)


def _within(
    option: str, value: float | None, allowed: tuple[float, float], unit: str, hint: str = ""
) -> None:
    if value is not None and not allowed[0] <= value <= allowed[1]:
        raise UsageError(
            f"found {value:g}; allowed: {allowed[0]:g} to {allowed[1]:g} {unit}{hint}", field=option
        )


def draft_study_file(
    console: Console,
    folder: options.Recordings,
    out: options.StudyOut = None,
    mass: options.Mass = None,
    height: options.Height = None,
    sex: options.Sex = None,
    age: options.Age = None,
    force: Annotated[
        bool, typer.Option("--force", help="Replace a study file that is there.")
    ] = False,
) -> None:
    """Draft the study file of a folder; exit code 1 where something in it is missing."""
    options = options_of(mass, height, sex, age)
    target = folder / drafts.STUDY if out is None else out
    if target.suffix.lower() != ".toml":
        raise UsageError(
            f"found '{target.name}'; allowed: the name of a file ending in .toml", field="--out"
        )
    if not force and target.exists():
        message = "is there already; --force replaces it, --out FILE names another"
        raise InputError(message, source=target, code=Code.FOLDER_TAKEN)
    with console.working() as step:
        step("reading the folder")
        read = read_folder(folder)
    draft = _asked(read, options, console)
    print_seen(console, draft)
    if draft.fault:
        raise InputError(draft.fault, source=folder, code=Code.FOLDER)
    atomic.write_text_atomically(
        target, drafts.format_draft(draft, atomic.resolve_path(target).parent)
    )
    console.line(f"study: {target}")
    if draft.problem:
        raise InputError(f"is written, but {draft.problem}", source=target, code=Code.FOLDER)
    if draft.missing:
        give = f"write it there, or run again with --force {drafts.list_missing_options(draft)}"
        message = f"is written, but {drafts.describe_missing_fields(draft)}: {give}"
        raise InputError(message, source=target, code=Code.WHO_IT_IS)
    build_nominal_model(
        drafts.build_study(draft, proposed=True)
    )  # an error of the static trial is told now
    if draft.choice is not None and (proposal := draft.choice.proposal) is not None:
        for label in sorted(proposal.asked):
            console.line(f"asked: is {label} {proposal.rename[label]}?")
        console.line(
            "asked: is each marker what [markers.rename] and [markers.tracking] say? Then "
            "confirmed = true"
        )
    console.line(
        f"next:  look through it, then gaitcal calibrate {target} --out "
        f"{folder.resolve().name}-result"
    )


def study_or_draft(path: Path, options: Options, console: Console) -> Path | drafts.Draft:
    """The study file itself, the one in a folder, or the draft of a folder without one, ready to
    run.

    Raises UsageError: Options of the person beside a study file, which says it.
    Raises InputError: A folder with several study files, or from which no study follows.
    """
    if path.suffix.lower() in formats.MARKER_READERS and path.is_file():
        raise UsageError(
            "is a recording; name its folder, with the static trial in it, or a study file",
            source=path,
        )
    with console.working() as step:
        if path.is_dir():
            step("reading the folder")
        found = drafts.find_study_source(path, options)
    if isinstance(found, Path):
        if found != path:
            console.line(f"the folder's own study is used: {found}")
        return found
    draft = _asked(found, options, console)
    if draft.fault:
        print_seen(console, draft)
    else:
        tell_draft(console, draft)
    drafts.require_runnable(draft, path)
    return draft


def _asked(folder: Folder, options: Options, console: Console) -> drafts.Draft:
    """The draft, after a question at the terminal for each thing that nobody tells."""
    draft = draft_folder(folder, options)
    if (
        draft.fault
        or draft.problem
        or not (draft.missing or draft.estimated)
        or console.quiet
        or not (sys.stdin.isatty() and sys.stderr.isatty())
    ):
        return draft
    for field in (*draft.missing, *draft.estimated):
        while True:
            question, spare = f"no file says the {QUESTIONS[field]}", field in draft.estimated
            question += " (Enter: estimated, with wider errors)" if spare else ""
            answer = str(
                typer.prompt(question, default="" if spare else None, show_default=False, err=True)
            ).strip()
            if spare and not answer:
                break
            try:
                options = _answered(options, field, answer)
            except (UsageError, ValueError) as fault:
                console.err.print(Text(str(fault)))
                continue
            break
    return draft_study(draft.folder, options)


def _answered(options: Options, field: str, answer: str) -> Options:
    value: object = answer.lower() if field == "sex" else float(answer.replace(",", "."))
    out = replace(options, **{field.partition("_")[0]: value})  # type: ignore[arg-type]
    return options_of(out.mass, out.height, out.sex, out.age)


def print_seen(console: Console, draft: drafts.Draft) -> None:
    """A row for every file of the folder: what it is, what it shows, what it is used as, why."""
    if not draft.rows:
        return
    table = frameless_table(("file", "is"), ("frames",))
    for head in ("labels", "shows", "used as", "reason"):
        table.add_column(head)
    for row in draft.rows:
        frames = "" if row.frames is None else str(row.frames)
        cells = (
            row.name,
            row.kind,
            frames,
            row.labels,
            row.shows,
            row.used or "not used",
            row.reason,
        )
        table.add_row(*(Text(cell) for cell in cells))
    if not console.out.is_terminal:
        console.out.width = PLAIN_WIDTH
    console.out.print(table)


def tell_draft(console: Console, draft: drafts.Draft) -> None:
    """In some lines, what was made of a folder."""
    if line := drafts.describe_marker_set(draft):
        console.line(line)
    for role in Role:
        names = [
            f"{trial.name} ({trial.joint})" if trial.joint else trial.name
            for trial in draft.trials
            if trial.role == role
        ]
        if names:
            console.line(f"{role.value}: {', '.join(names)}")
    for line in drafts.list_uncertain_choices(draft):
        console.line(line)


COLOURS = {Severity.ERROR: "bold red", Severity.WARNING: "yellow", Severity.INFO: "dim"}


def check_recordings(
    console: Console,
    study: options.StudyPath,
    mass: options.Mass = None,
    height: options.Height = None,
    sex: options.Sex = None,
    age: options.Age = None,
) -> None:
    """Print what the checks find in a study, or in what a folder drafts; exit code 1 where there is
    an error.
    """
    source = study_or_draft(study, options_of(mass, height, sex, age), console)
    with console.working() as step:
        step("reading and checking the recordings")
        if isinstance(source, Path):
            findings = check_file(source)
        else:
            findings = (*check_study(drafts.build_study(source)), *find_rejected_forces(source))
    shown = [f for f in findings if console.verbose or f.severity is not Severity.INFO]
    if shown:
        if not console.out.is_terminal:
            console.out.width = PLAIN_WIDTH
        console.out.print(_table(shown))
    counts = {severity: sum(f.severity is severity for f in findings) for severity in Severity}
    hidden = counts[Severity.INFO] if not console.verbose else 0
    more = f" (-v shows {hidden} more facts)" if hidden else ""
    console.line(f"{counts[Severity.ERROR]} errors, {counts[Severity.WARNING]} warnings{more}")
    if shown:
        console.line(f"what a code means and what to do: gaitcal explain {shown[0].code.value}")
    if counts[Severity.ERROR]:
        sys.exit(1)


def _table(findings: Sequence[Finding]) -> Table:
    table = Table(show_edge=False, pad_edge=False, show_lines=True)
    for name in ("severity", "where", "about"):
        table.add_column(name)
    table.add_column("found", ratio=3)
    table.add_column("what to do", ratio=2)
    for f in findings:
        table.add_row(
            Text(f"{f.severity.value}\n{f.code.value}", COLOURS[f.severity]),
            Text(f.where),
            Text(f.topic),
            Text(f.evidence),
            Text(f.cure),
        )
    return table
