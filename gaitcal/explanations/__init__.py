"""Explanations of all codes: one Markdown page each, part of the package.

A page has a title, a severity and the sections `PARTS`; *Detection* is missing if there is nothing
to add. The program, the page of a result and the documentation show the same text.
"""

import functools
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.resources import files
from typing import Final, TypeAlias

from gaitcal.errors import Code

PARTS: Final = ("Meaning", "Detection", "Remedy")
"""Headings of the sections of a page, in order."""


@dataclass(frozen=True, kw_only=True)
class Explanation:
    """Explanation of a code."""

    code: Code
    title: str
    """The fault, in a clause."""
    severity: str
    """Possible severities: `Error`, `Warning`, `Note`, or several: `Error or warning`."""
    text: str
    """Markdown of the sections `PARTS`, with headings of the second level."""

    @property
    def markdown(self) -> str:
        """The whole page, as in its file."""
        return f"# {self.code.value}: {self.title}\n\n*{self.severity}*\n\n{self.text}\n"


@functools.cache
def load_explanation(code: Code) -> Explanation:
    """Load the explanation of a code.

    Parameters
    ----------
    code
        Code of a finding or an error.

    Returns
    -------
    Explanation
    """
    page = files(__package__).joinpath("pages", f"{code.value}.md").read_text(encoding="utf-8")
    head, severity, text = page.strip().split("\n\n", 2)
    title = head.removeprefix(f"# {code.value}: ")
    return Explanation(code=code, title=title, severity=severity.strip("*"), text=text)


def load_all_explanations() -> tuple[Explanation, ...]:
    """Load the explanations of all codes, in the order of their numbers."""
    return tuple(load_explanation(code) for code in Code)


@dataclass(frozen=True)
class Paragraph:
    """A paragraph of running text."""

    text: str


@dataclass(frozen=True)
class Bullets:
    """A list of items."""

    items: tuple[str, ...]


@dataclass(frozen=True)
class Verbatim:
    """A message that the program prints in one line; `lines` are the wrapped lines of the page."""

    lines: tuple[str, ...]


Piece: TypeAlias = Paragraph | Bullets | Verbatim


def split_parts(text: str) -> tuple[tuple[str, tuple[Piece, ...]], ...]:
    """Split a page into its sections.

    Parameters
    ----------
    text
        Markdown, as in `Explanation.text`.

    Returns
    -------
    tuple of (heading, pieces)
        Heading of each section, and its paragraphs, lists and messages.
    """
    out = []
    for part in f"\n{text}".split("\n## ")[1:]:
        heading, _, body = part.partition("\n")
        out.append((heading.strip(), tuple(_parse_pieces(body))))
    return tuple(out)


def _parse_pieces(body: str) -> Iterator[Piece]:
    """Parse the blocks of a section, which empty lines separate."""
    for block in body.strip().split("\n\n"):
        lines = block.strip("\n").split("\n")
        if lines[0].startswith("```"):
            yield Verbatim(tuple(lines[1:-1]))
        elif lines[0].startswith("- "):
            # An indented line continues the item above it.
            items: list[str] = []
            for line in lines:
                if line.startswith("  ") and items:
                    items[-1] += f" {line.strip()}"
                else:
                    items.append(line.removeprefix("- ").strip())
            yield Bullets(tuple(items))
        else:
            yield Paragraph(" ".join(line.strip() for line in lines))
