"""The blocks that a section of the page is made of: plain data, each of one kind. Every text in them is data.

Numbers are formatted here, so that the page, the print and a test read the same text.
"""

from __future__ import annotations

import unicodedata
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

Block = dict[str, Any]
Cell = str | dict[str, Any]
Sections = dict[str, list[Block]]
"""Preset of the page -> its blocks."""

MISSING: Final = "–"
LONGEST_NAME: Final = 60
NAME_END: Final = 20
"""Characters at the end of a cut name: names of one study often begin alike."""


def number(value: float | None, digits: int = 1, sign: bool = False) -> str:
    """`-1234.5` -> `−1 234.5`, with thin spaces; a dash where there is no value."""
    if value is None or value != value:
        return MISSING
    text = f"{value:{'+' if sign else ''},.{digits}f}"
    if float(text.replace(",", "")) == 0.0:
        text = text.lstrip("+-")
    return text.replace(",", "\u202f").replace("-", "−")


def visible(text: object) -> str:
    """The text with `?` for characters that control the terminal, the layout or the writing direction."""
    return "".join("?" if unicodedata.category(c) in ("Cc", "Cf", "Cs", "Co") else c for c in str(text))


def named(text: object) -> str:
    """A name from the study as a heading or a table shows it: of a very long one the middle is left out."""
    whole = visible(text)
    return whole if len(whole) <= LONGEST_NAME else f"{whole[: LONGEST_NAME - NAME_END - 1]}…{whole[-NAME_END:]}"


def heading(text: str, level: int = 3) -> Block:
    """A heading within a preset: level 3 or 4."""
    return {"kind": "heading", "text": visible(text), "level": level}


def text(words: str, tone: str = "") -> Block:
    """A paragraph. `tone`: `soft`, `warning` or `bad`."""
    return {"kind": "text", "text": visible(words)} | ({"tone": tone} if tone else {})


def bullets(items: Iterable[str], tone: str = "") -> Block:
    """A list."""
    return {"kind": "list", "items": [visible(item) for item in items]} | ({"tone": tone} if tone else {})


def cell(words: object, *, unit: str = "", tone: str = "", side: str = "", align: str = "") -> Cell:
    """One cell of a table; plain text where nothing is to be said of it."""
    extra = {"unit": unit, "tone": tone, "side": side, "align": align}
    told = {key: value for key, value in extra.items() if value}
    return {"t": visible(words), **told} if told else visible(words)


def words_column(title: str) -> Cell:
    """The head of a column of words, which begin at the left."""
    return cell(title, align="text")


def table(
    head: Sequence[Cell],
    rows: Sequence[Sequence[Cell]],
    *,
    caption: str = "",
    fold: str = "",
    total: Sequence[int] = (),
) -> Block:
    """A table; the first column heads the rows.

    Parameters
    ----------
    fold : what stands in its place until it is opened; empty: it is open.
    total : numbers of the rows that sum up the others.
    """
    out: Block = {"kind": "table", "head": list(head), "rows": [list(row) for row in rows]}
    if caption:
        out["caption"] = visible(caption)
    if fold:
        out["fold"] = visible(fold)
    if total:
        out["total"] = list(total)
    return out


def pair(left: Sequence[Block], right: Sequence[Block]) -> Block:
    """Blocks beside each other."""
    return {"kind": "pair", "left": list(left), "right": list(right)}


def fold(title: str, blocks: Sequence[Block]) -> Block:
    """Blocks that are folded away."""
    return {"kind": "fold", "title": visible(title), "blocks": list(blocks)}


def cards(answers: Iterable[Mapping[str, str]]) -> Block:
    """Questions with their answers."""
    return {"kind": "cards", "cards": [dict(answer) for answer in answers]}


def intervals(unit: str, rows: Sequence[Mapping[str, Any]]) -> Block:
    """Dots with whiskers: nominal and fitted values, and the truth where it is known."""
    return {"kind": "intervals", "unit": unit, "rows": [dict(row) for row in rows]}


def bars(unit: str, rows: Sequence[Mapping[str, Any]]) -> Block:
    """Stacked horizontal bars; the parts of a row sum to its total."""
    return {"kind": "bars", "unit": unit, "rows": [dict(row) for row in rows]}


def boxes(unit: str, title: str, groups: Sequence[Mapping[str, Any]]) -> Block:
    """Boxplots in groups."""
    return {"kind": "boxes", "unit": unit, "title": title, "groups": [dict(group) for group in groups]}


def curves(kinds: Sequence[str], limits: Mapping[str, float] | None = None) -> Block:
    """The trial's own curves of some kinds, over time, with limits where there are any."""
    return {"kind": "curves", "kinds": list(kinds), "limits": dict(limits or {})}


def number_rounded(value: float | None, digits: int = 4) -> float | None:
    """A number of a picture, without more digits than can be seen; None where there is none."""
    return None if value is None or value != value else round(float(value), digits)
