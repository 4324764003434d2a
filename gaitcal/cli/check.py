"""`gaitcal check`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from rich.table import Table
from rich.text import Text

from gaitcal.cli.console import Console
from gaitcal.cli.init import study_or_draft
from gaitcal.errors import InputError
from gaitcal.faults.study import check_file, check_study
from gaitcal.faults.verdict import stopping
from gaitcal.findings import Finding, Severity
from gaitcal.session.draft import study_of
from gaitcal.session.drafting import rejected_forces
from gaitcal.session.person_facts import NOTHING_SAID, Options

PLAIN_WIDTH = 150
"""Columns of the table where the output is no terminal."""
COLOURS = {Severity.ERROR: "bold red", Severity.WARNING: "yellow", Severity.INFO: "dim"}


def run(path: Path, console: Console, options: Options = NOTHING_SAID) -> None:
    """Print what the checks find in a study, or in what a folder drafts; exit code 1 where there is an error."""
    source = study_or_draft(path, options, console)
    with console.working() as step:
        step("reading and checking the recordings")
        if isinstance(source, Path):
            findings = check_file(source)
        else:
            findings = (*check_study(study_of(source)), *rejected_forces(source))
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


def stop_on_errors(findings: Sequence[Finding], walks: Sequence[str], study: Path | None = None) -> None:
    """InputError with the first error, and how many more there are (`gaitcal check` on the study shows them).

    Errors that leave a leg to each of the `walks` do not stop: the verdict refuses the other leg.
    """
    errors = stopping(findings, walks)
    if not errors:
        return
    shown = f": 'gaitcal check {study}' shows all" if study else ""
    more = f" (and {len(errors) - 1} more errors{shown})" if len(errors) > 1 else ""
    raise InputError(errors[0].line + more, code=errors[0].code)
