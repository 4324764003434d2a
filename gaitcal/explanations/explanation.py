"""The page of a code, as it lies in `pages/GC-nnn.md`."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from importlib.resources import files
from typing import Final

from gaitcal.codes import Code

PARTS: Final = (
    "What it means",
    "What it looks like",
    "Why it matters",
    "How it is found",
    "What to do",
    "What it cannot see",
)
"""Headings of every page, in their order."""


@dataclass(frozen=True, kw_only=True)
class Explanation:
    """What one code means."""

    code: Code
    title: str
    """What is wrong, in a clause."""
    severity: str
    """How bad it can be: `Error`, `Warning`, `Note`, or several of them: `Error or warning`."""
    text: str
    """Markdown below the title and the severity: a heading of the second level for each of `PARTS`."""

    @property
    def markdown(self) -> str:
        """The whole page, as its file holds it."""
        return f"# {self.code.value}: {self.title}\n\n*{self.severity}*\n\n{self.text}\n"


@functools.cache
def explanation_of(code: Code) -> Explanation:
    """The page of a code."""
    page = files(__package__).joinpath("pages", f"{code.value}.md").read_text(encoding="utf-8")
    head, severity, text = page.strip().split("\n\n", 2)
    title = head.removeprefix(f"# {code.value}: ")
    return Explanation(code=code, title=title, severity=severity.strip("*"), text=text)


def all_explanations() -> tuple[Explanation, ...]:
    """The pages of all codes, in the order of their numbers."""
    return tuple(explanation_of(code) for code in Code)
