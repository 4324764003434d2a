"""`gaitcal explain`."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterator

from gaitcal.cli.console import Console
from gaitcal.codes import Code
from gaitcal.errors import UsageError, nearest
from gaitcal.explanations.explanation import Explanation, all_explanations, explanation_of
from gaitcal.explanations.markdown import Bullets, Paragraph, parts_of

WIDEST = 100
"""Columns: longer lines are hard to read."""
NARROWEST = 30
SERIES = {"0": "Found in recordings", "1": "Told of a result", "2": "What stops a command"}
"""First digit of a code -> what its codes are of."""


def explain_code(name: str | None, console: Console) -> None:
    """Print what a code means; without a name, a list of all codes."""
    width = max(NARROWEST, min(WIDEST, console.out.width))
    lines = listing() if name is None else page(explanation_of(code_named(name)), width)
    for line in lines:
        console.line(line)


def code_named(name: str) -> Code:
    """The code that somebody means: `GC-012`, `gc-12`, `12`; UsageError with the nearest for one that is not there."""
    said = re.fullmatch(r"\[?(?:gc)?[-_ ]?(\d{1,3})\]?", name.strip(), re.IGNORECASE)
    known = [code.value for code in Code]
    wanted = f"GC-{int(said.group(1)):03d}" if said else name.strip()[:40]
    if wanted not in known:
        hint = nearest(wanted.upper(), known)
        message = f"found '{wanted}'; allowed: a code as {known[0]} ('gaitcal explain' lists all){hint}"
        raise UsageError(message, field="explain")
    return Code(wanted)


def listing() -> Iterator[str]:
    """All codes with their titles, under a heading for each series."""
    series = ""
    for told in all_explanations():
        if (own := told.code.value[3]) != series:
            yield from ([] if not series else [""])
            yield f"{SERIES[own]}:"
            series = own
        yield f"  {told.code.value}  {told.title}"
    yield ""
    yield "The page of one: gaitcal explain GC-020"


def page(told: Explanation, width: int) -> Iterator[str]:
    """The page of a code as lines of a terminal."""
    yield from textwrap.wrap(f"{told.code.value}: {told.title}", width)
    yield f"({told.severity.lower()})"
    for heading, pieces in parts_of(told.text):
        yield ""
        yield heading
        for piece in pieces:
            if isinstance(piece, Paragraph):
                yield from _wrapped(piece.text, width)
            elif isinstance(piece, Bullets):
                for item in piece.items:
                    yield from _wrapped(item, width, "- ")
            else:
                yield from _wrapped(" ".join(piece.lines), width)


def _wrapped(text: str, width: int, mark: str = "") -> list[str]:
    """Lines indented below their heading, without the marks of Markdown."""
    plain = re.sub(r"[`*]", "", text) if "`" in text or "**" in text else text
    indent = "  " + " " * len(mark)
    return textwrap.wrap(plain, width, initial_indent=f"  {mark}", subsequent_indent=indent, break_long_words=False)
