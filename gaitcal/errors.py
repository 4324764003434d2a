"""The one exception root of gaitcal, and what the command line makes of it."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class GaitcalError(Exception):
    """Root of every error that gaitcal raises on purpose. `exit_code` is what the command line returns."""

    exit_code = 1
    """1: the input is at fault."""


class InputError(GaitcalError):
    """The input is at fault. The message is one line: file, field, what was found, what is allowed."""

    def __init__(self, message: str, *, source: object = None, field: str | None = None) -> None:
        where = ": ".join(str(part) for part in (source, field) if part is not None)
        text = " ".join(str(message).split())
        super().__init__(f"{where}: {text}" if where else text)


class UsageError(InputError):
    """An option of the command line is at fault. The message is one line: option, what was found, what is allowed."""

    exit_code = 2
    """2: usage, as for options that the command line's own parser refuses."""


class ConvergenceError(GaitcalError):
    """An iteration ended without reaching its tolerance and without a usable result."""

    exit_code = 3
    """3: did not converge."""


def nearest(name: str, allowed: Iterable[str], count: int = 1) -> str:
    """`; did you mean 'X'?`, or the empty string where nothing is close. For the end of an error message."""
    close = difflib.get_close_matches(name, list(allowed), n=count, cutoff=0.6)
    return "; did you mean " + " or ".join(f"'{c}'" for c in close) + "?" if close else ""
