"""Commands `init` and `check`, and the study of a folder or file that other commands use."""

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table
from rich.text import Text

from gaitcal.cli import options
from gaitcal.cli.console import Console, make_frameless_table
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
"""Allowed ranges of the options."""
CENTIMETRES = (30.0, 260.0)
"""Range of a height that was probably given in centimetres."""
SEXES = ("female", "male")
QUESTIONS = {"mass_kg": "body mass in kg", "height_m": "body height in m", "sex": "female or male"}
PLAIN_WIDTH = 170
"""Width (columns) of tables if the output is not a terminal."""


def check_person_options(
    mass: float | None, height: float | None, sex: str | None, age: float | None
) -> Options:
    """Check the options that describe the person.

    Parameters
    ----------
    mass, height, age
        kg, m, years; None: not given.
    sex
        `female` or `male`; None: not given.

    Returns
    -------
    Options

    Raises
    ------
    UsageError
        A value is out of range.
    """
    _require_within("--mass", mass, MASS_KG, "kg")
    hint = ""
    if height is not None and CENTIMETRES[0] <= height <= CENTIMETRES[1]:
        hint = f"; {height:g} looks like centimetres: --height {height / 100:g}"
    _require_within("--height", height, HEIGHT_M, "m", hint)
    _require_within("--age", age, AGE_YEARS, "years")
    if sex is not None and sex not in SEXES:
        raise UsageError(f"found '{sex[:40]}'; allowed: {' or '.join(SEXES)}", field="--sex")
    return Options(mass=mass, height=height, sex=sex, age=age)


def _require_within(
    option: str, value: float | None, allowed: tuple[float, float], unit: str, hint: str = ""
) -> None:
    """Raise UsageError if an option is outside of its range."""
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
    force: Annotated[bool, typer.Option("--force", help="Replace an existing study file.")] = False,
) -> None:
    """Draft the study file of a folder.

    Raises
    ------
    UsageError
        An option is invalid.
    InputError
        The study file exists, no study can be drafted, or the draft is incomplete. In the last
        case it is written.
    """
    options = check_person_options(mass, height, sex, age)
    target = folder / drafts.STUDY if out is None else out
    if target.suffix.lower() != ".toml":
        raise UsageError(
            f"found '{target.name}'; allowed: a file name ending in .toml", field="--out"
        )
    # A study file may hold hours of a user's work.
    if not force and target.exists():
        message = "exists already; --force replaces it, --out FILE names another"
        raise InputError(message, source=target, code=Code.FOLDER_TAKEN)
    with console.show_progress() as step:
        step("reading the folder")
        read = read_folder(folder)
    draft = _complete_draft(read, options, console)
    _print_files(console, draft)
    if draft.fault:
        raise InputError(draft.fault, source=folder, code=Code.FOLDER)
    atomic.write_text_atomically(
        target, drafts.format_draft(draft, atomic.resolve_path(target).parent)
    )
    console.print_line(f"study: {target}")
    if draft.problem:
        raise InputError(f"is written, but {draft.problem}", source=target, code=Code.FOLDER)
    # The file is complete but for these fields, which are never guessed.
    if draft.missing:
        give = f"write it there, or run again with --force {drafts.list_missing_options(draft)}"
        message = f"is written, but {drafts.describe_missing_fields(draft)}: {give}"
        raise InputError(message, source=target, code=Code.WHO_IT_IS)
    # Building the nominal model raises the errors of the static trial now.
    build_nominal_model(drafts.build_study(draft, proposed=True))
    proposal = None if draft.choice is None else draft.choice.proposal
    if proposal is not None:
        for label in sorted(proposal.asked):
            console.print_line(f"confirm: is {label} {proposal.rename[label]}?")
        console.print_line(
            "confirm: are all markers as in [markers.rename] and [markers.tracking]? Then set "
            "confirmed = true"
        )
    console.print_line(
        f"next:  review it, then gaitcal calibrate {target} --out {folder.resolve().name}-result"
    )


def find_or_draft_study(path: Path, options: Options, console: Console) -> Path | drafts.Draft:
    """Find the study file of a path, or draft a study from a folder.

    Parameters
    ----------
    path
        Study file, or folder of recordings.
    options
        Options that describe the person.

    Returns
    -------
    Path or Draft
        The study file, or a complete draft.

    Raises
    ------
    UsageError
        The path is a recording, or options describe a person whom the study file describes.
    InputError
        The folder has several study files, or no study can be drafted from it.
    """
    # A single recording cannot be calibrated: it lacks the static trial.
    if path.suffix.lower() in formats.MARKER_READERS and path.is_file():
        raise UsageError(
            "is a recording; give its folder, which must contain the static trial, or a study file",
            source=path,
        )
    with console.show_progress() as step:
        if path.is_dir():
            step("reading the folder")
        # A study file, or what was read of a folder without one
        found = drafts.find_study_source(path, options)
    if isinstance(found, Path):
        if found != path:
            console.print_line(f"study of the folder: {found}")
        return found
    draft = _complete_draft(found, options, console)
    if draft.fault:
        _print_files(console, draft)
    else:
        _print_draft(console, draft)
    drafts.require_runnable(draft, path)
    return draft


def _complete_draft(folder: Folder, options: Options, console: Console) -> drafts.Draft:
    """Draft a study, and ask at the terminal for values of the person that no file contains.

    No question is asked if the output is quiet, or if input or output is not a terminal.
    """
    draft = draft_folder(folder, options)
    if (
        draft.fault
        or draft.problem
        or not (draft.missing or draft.estimated)
        or console.quiet
        or not (sys.stdin.isatty() and sys.stderr.isatty())
    ):
        return draft
    # A question is repeated until its answer is valid; an estimated value may be left open.
    for field in (*draft.missing, *draft.estimated):
        while True:
            question, optional = f"{QUESTIONS[field]} (in no file)", field in draft.estimated
            question += " (Enter: estimated, with wider errors)" if optional else ""
            answer = str(
                typer.prompt(
                    question, default="" if optional else None, show_default=False, err=True
                )
            ).strip()
            if optional and not answer:
                break
            try:
                options = _add_answer(options, field, answer)
            except (UsageError, ValueError) as fault:
                console.err.print(Text(str(fault)))
                continue
            break
    return draft_study(draft.folder, options)


def _add_answer(options: Options, field: str, answer: str) -> Options:
    """Add an answer to the options; raise UsageError or ValueError if it is invalid."""
    value: object = answer.lower() if field == "sex" else float(answer.replace(",", "."))
    out = replace(options, **{field.partition("_")[0]: value})  # type: ignore[arg-type]
    return check_person_options(out.mass, out.height, out.sex, out.age)


def _print_files(console: Console, draft: drafts.Draft) -> None:
    """Print a row for every file of the folder: type, content, use in the study and reason."""
    if not draft.rows:
        return
    table = make_frameless_table(("file", "type"), ("frames",))
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


def _print_draft(console: Console, draft: drafts.Draft) -> None:
    """Print the marker set, the trials by role and the doubts of a draft."""
    line = drafts.describe_marker_set(draft)
    if line:
        console.print_line(line)
    for role in Role:
        names = [
            f"{trial.name} ({trial.joint})" if trial.joint else trial.name
            for trial in draft.trials
            if trial.role == role
        ]
        if names:
            console.print_line(f"{role.value}: {', '.join(names)}")
    for line in drafts.list_uncertain_choices(draft):
        console.print_line(line)


COLOURS = {Severity.ERROR: "bold red", Severity.WARNING: "yellow", Severity.INFO: "dim"}


def check_recordings(
    console: Console,
    study: options.StudyPath,
    mass: options.Mass = None,
    height: options.Height = None,
    sex: options.Sex = None,
    age: options.Age = None,
) -> None:
    """Print the findings of a study or of a folder; exit with code 1 if there is an error.

    Raises InputError: the study is invalid, or no study can be drafted from the folder.
    """
    source = find_or_draft_study(study, check_person_options(mass, height, sex, age), console)
    with console.show_progress() as step:
        step("reading and checking the recordings")
        if isinstance(source, Path):
            findings = check_file(source)
        else:
            findings = (*check_study(drafts.build_study(source)), *find_rejected_forces(source))
    shown = [f for f in findings if console.verbose or f.severity is not Severity.INFO]
    if shown:
        if not console.out.is_terminal:
            console.out.width = PLAIN_WIDTH
        console.out.print(_build_table(shown))
    # Notes are many on clean recordings: they are counted, and listed with -v.
    counts = {severity: sum(f.severity is severity for f in findings) for severity in Severity}
    hidden = counts[Severity.INFO] if not console.verbose else 0
    more = f" (-v shows {hidden} notes)" if hidden else ""
    console.print_line(
        f"{counts[Severity.ERROR]} errors, {counts[Severity.WARNING]} warnings{more}"
    )
    if shown:
        console.print_line(f"meaning and remedy of a code: gaitcal explain {shown[0].code.value}")
    if counts[Severity.ERROR]:
        sys.exit(1)


def _build_table(findings: Sequence[Finding]) -> Table:
    """Build the table of findings."""
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
