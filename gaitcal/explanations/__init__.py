"""What every code means: one page each, in Markdown, brought with the package and read without a
network.

A page has a title, says how bad it can be, and has the parts `PARTS`. The program, the page of a
result and the documentation show the same text.
"""

import functools
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.resources import files
from typing import Final, TypeAlias

from gaitcal.errors import Code

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
    title: str  # What is wrong, in a clause
    severity: (
        str  # How bad it can be: `Error`, `Warning`, `Note`, or several of them: `Error or warning`
    )
    # Markdown below the title and the severity: a heading of the second level for each of `PARTS`
    text: str

    @property
    def markdown(self) -> str:
        """The whole page, as its file holds it."""
        return f"# {self.code.value}: {self.title}\n\n*{self.severity}*\n\n{self.text}\n"


@functools.cache
def load_explanation(code: Code) -> Explanation:
    """The page of a code."""
    page = files(__package__).joinpath("pages", f"{code.value}.md").read_text(encoding="utf-8")
    head, severity, text = page.strip().split("\n\n", 2)
    title = head.removeprefix(f"# {code.value}: ")
    return Explanation(code=code, title=title, severity=severity.strip("*"), text=text)


def load_all_explanations() -> tuple[Explanation, ...]:
    """The pages of all codes, in the order of their numbers."""
    return tuple(load_explanation(code) for code in Code)


@dataclass(frozen=True)
class Paragraph:
    """Words to be wrapped."""

    text: str


@dataclass(frozen=True)
class Bullets:
    """A list."""

    items: tuple[str, ...]


@dataclass(frozen=True)
class Verbatim:
    """A message as the program prints it; its lines are those of the page, and are one line of the
    program.
    """

    lines: tuple[str, ...]


Piece: TypeAlias = Paragraph | Bullets | Verbatim


def split_parts(text: str) -> tuple[tuple[str, tuple[Piece, ...]], ...]:
    """Headings of the second level, each with what stands below it."""
    out = []
    for part in f"\n{text}".split("\n## ")[1:]:
        heading, _, body = part.partition("\n")
        out.append((heading.strip(), tuple(_parse_pieces(body))))
    return tuple(out)


def _parse_pieces(body: str) -> Iterator[Piece]:
    for block in body.strip().split("\n\n"):
        lines = block.strip("\n").split("\n")
        if lines[0].startswith("```"):
            yield Verbatim(tuple(lines[1:-1]))
        elif lines[0].startswith("- "):
            items = " ".join(
                line.strip() if line.startswith("  ") else f"\n{line}" for line in lines
            )
            yield Bullets(
                tuple(item.removeprefix("- ").strip() for item in items.split("\n") if item.strip())
            )
        else:
            yield Paragraph(" ".join(line.strip() for line in lines))
