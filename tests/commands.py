"""The command line in the process of the tests, and what is in the folders that it writes."""

import io
import sys
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path

import pytest
from click.testing import Result
from typer.testing import CliRunner

from gaitcal import cli
from gaitcal.cli.application import app


@dataclass(frozen=True)
class Done:
    """What a shell would see of a program that has ended."""

    returncode: int
    stdout: str
    stderr: str


def gaitcal(*words: object) -> Done:
    """The whole program: errors are its one line on stderr, and its exit code."""
    out, err = io.StringIO(), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        patch.setattr(sys, "argv", ["gaitcal", *map(str, words)])
        try:
            cli.main()
            code = 0
        except SystemExit as ending:
            code = int(ending.code or 0)
    return Done(code, out.getvalue(), err.getvalue())


def run(*words: object) -> Result:
    """One command; its errors are raised."""
    return CliRunner().invoke(app, list(map(str, words)), catch_exceptions=False)


def content(folder: Path) -> dict[str, bytes]:
    """Every file in a folder and below."""
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}
