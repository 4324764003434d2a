"""The little Markdown that pages are written in, as data: parts with paragraphs, bullets and verbatim lines."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TypeAlias


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
    """A message as the program prints it; its lines are those of the page, and are one line of the program."""

    lines: tuple[str, ...]


Piece: TypeAlias = Paragraph | Bullets | Verbatim


def parts_of(text: str) -> tuple[tuple[str, tuple[Piece, ...]], ...]:
    """Headings of the second level, each with what stands below it."""
    out = []
    for part in f"\n{text}".split("\n## ")[1:]:
        heading, _, body = part.partition("\n")
        out.append((heading.strip(), tuple(_pieces(body))))
    return tuple(out)


def _pieces(body: str) -> Iterator[Piece]:
    for block in body.strip().split("\n\n"):
        lines = block.strip("\n").split("\n")
        if lines[0].startswith("```"):
            yield Verbatim(tuple(lines[1:-1]))
        elif lines[0].startswith("- "):
            items = " ".join(line.strip() if line.startswith("  ") else f"\n{line}" for line in lines)
            yield Bullets(tuple(item.removeprefix("- ").strip() for item in items.split("\n") if item.strip()))
        else:
            yield Paragraph(" ".join(line.strip() for line in lines))
