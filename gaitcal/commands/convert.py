"""`gaitcal convert`."""

from __future__ import annotations

from pathlib import Path

from gaitcal.commands.console import Talk
from gaitcal.recording import convert


def run(source: Path, target: Path, *, quiet: bool, verbose: bool) -> None:
    """Convert one recording and say which files were written."""
    talk = Talk(quiet=quiet, verbose=verbose)
    for path in convert(source, target):
        talk.line(f"wrote {path}")
