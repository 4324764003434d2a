"""The one exception root of gaitcal, and what the command line makes of it."""

import difflib
import re
from collections.abc import Iterable

from gaitcal.codes import Code


class GaitcalError(Exception):
    """Root of every error that gaitcal raises on purpose. `exit_code` is what the command line returns."""

    exit_code = 1
    """1: the input is at fault."""
    code: Code = Code.INSTALLATION
    """Its kind: `gaitcal explain` tells what it means."""


class InputError(GaitcalError):
    """The input is at fault. The message is one line: file, field, what was found, what is allowed."""

    code = Code.INPUT
    """Unless whoever raises it says a nearer one."""

    def __init__(
        self, message: str, *, source: object = None, field: str | None = None, code: Code | None = None
    ) -> None:
        self.code = code or type(self).code
        where = ": ".join(str(part) for part in (source, field) if part is not None)
        text = " ".join(str(message).split())
        super().__init__(f"{where}: {text}" if where else text)


class UsageError(InputError):
    """An option of the command line is at fault. The message is one line: option, what was found, what is allowed."""

    code = Code.OPTION
    exit_code = 2
    """2: usage, as for options that the command line's own parser refuses."""


class ConvergenceError(GaitcalError):
    """An iteration ended without reaching its tolerance and without a usable result."""

    code = Code.NOT_CONVERGED
    """Of every fit."""
    exit_code = 3
    """3: did not converge."""


_SIDE = re.compile(
    r"(?i:(?<![a-z])(right|left)(?![a-z]))|(?i:(?:^|(?<=[._ :-]))([rl])(?=[._ -]|$))|^([RL])(?=[A-Z])|"
    r"(?<=[a-z0-9])([RL])$|"
    r"^([rl])(?=[A-Z])|^(Right|Left)(?=[A-Z_.])"
)
"""Where a label names its side: right or left as a word; R or L alone between separators, or before a capital, or last
after a small letter or digit."""


def side_named(label: str) -> str:
    """`r` or `l` where a label names its side; empty where it names none."""
    found = _SIDE.search(label)
    return found.group(0)[0].lower() if found else ""


def alike(name: str, allowed: Iterable[str]) -> list[str]:
    """The one of `allowed` that `name` may be a misspelling of; never one of the other side.

    Names that differ by capitals, blanks, dots, dashes and underscores alone come first: `l_asis` for `L.ASIS`.
    """
    side = side_named(name)
    there = [other for other in allowed if not side or side_named(other) in ("", side)]
    there = [other for other in there if not other_side(name, other)]
    same = [other for other in there if other != name and _plain(other) == _plain(name)]
    return [*same, *(m for m in difflib.get_close_matches(name, there, n=1, cutoff=0.6) if m not in same)][:1]


def _plain(name: str) -> str:
    """A name without what people write differently: capitals and separators."""
    return re.sub(r"[\s._-]+", "", name).casefold() or name


def other_side(name: str, other: str) -> bool:
    """Whether two names differ only by r and l at one place, or by right and left."""
    a, b = name.lower(), other.lower()
    if len(a) == len(b):
        different = [{x, y} for x, y in zip(a, b, strict=True) if x != y]
        return different == [{"r", "l"}]
    return a.replace("right", "left") == b.replace("right", "left")


def nearest(name: str, allowed: Iterable[str]) -> str:
    """`; did you mean 'X'?`, or the empty string where nothing is close. For the end of an error message."""
    return "".join(f"; did you mean '{close}'?" for close in alike(name, allowed))
