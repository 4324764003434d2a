"""What pages hold and what their blocks say, as plain rows: for tests."""

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from gaitcal.analysis.result import Calibration
from gaitcal.report.page.page_data import build_calibration_page_data

Block = dict[str, Any]
KINDS = {
    "heading": {"text", "level"},
    "text": {"text", "tone"},
    "list": {"items", "tone"},
    "table": {"head", "rows", "caption", "fold", "total"},
    "intervals": {"unit", "rows"},
    "curves": {"kinds"},
    "pair": {"left", "right"},
    "fold": {"title", "blocks"},
}
"""Kind of a block -> what it may hold; `part` marks the blocks of a study."""


def walked(blocks: Sequence[Block]) -> Iterator[Block]:
    """Every block, those within others too."""
    for block in blocks:
        yield block
        for part in ("left", "right", "blocks"):
            yield from walked(block.get(part, ()))


def every(sheet: dict[str, Any]) -> list[Block]:
    """Every block of a sheet and of its trials."""
    holders = [sheet, *sheet["trials"]]
    return [
        block
        for holder in holders
        for blocks in holder["sections"].values()
        for block in walked(blocks)
    ]


def shown(cell: Any) -> str:
    """The text of a cell."""
    return str(cell if isinstance(cell, str) else cell["t"])


def rows_of(block: Block) -> dict[str, list[str]]:
    """First cell of each row of a table, with its unit -> the other cells."""

    def first(cell: Any) -> str:
        return (
            cell
            if isinstance(cell, str)
            else " ".join(filter(None, (cell["t"], cell.get("unit", ""))))
        )

    return {first(row[0]): [shown(cell) for cell in row[1:]] for row in block["rows"]}


def tables(blocks: Sequence[Block], head: str) -> list[Block]:
    """Tables whose first column is called so."""
    return [b for b in walked(blocks) if b["kind"] == "table" and shown(b["head"][0]) == head]


def headings(blocks: Sequence[Block]) -> list[str]:
    return [b["text"] for b in walked(blocks) if b["kind"] == "heading"]


def words(blocks: Sequence[Block]) -> str:
    """All sentences, items and cells."""
    out: list[str] = []
    for b in walked(blocks):
        out += [b.get(key, "") for key in ("text", "title", "caption", "fold")]
        out += b.get("items", [])
        out += [
            shown(cell)
            for row in (b.get("head", []), *b.get("rows", []))
            if b["kind"] == "table"
            for cell in row
        ]
    return "\n".join(filter(None, out))


def page_words(calibration: Calibration) -> str:
    """Everything that its page says in words and formatted numbers, a line for each piece."""
    sheet = build_calibration_page_data(calibration)
    parts = (
        sheet["verdict"],
        sheet["lines"],
        sheet["sections"],
        [trial["sections"] for trial in sheet["trials"]],
    )
    return "\n".join(_pieces(parts))


def _pieces(data: Any) -> Iterator[str]:
    if isinstance(data, str):
        yield data
    elif isinstance(data, Mapping):
        for value in data.values():
            yield from _pieces(value)
    elif isinstance(data, list | tuple):
        for value in data:
            yield from _pieces(value)


def scripts(html: str) -> list[tuple[str, str]]:
    """Attributes and contents of the script elements, found as a browser does."""
    return re.findall(r"<script([^>]*)>(.*?)</script", html, flags=re.DOTALL | re.IGNORECASE)


def held(html: str, element: str = "result") -> dict[str, Any]:
    """What the script element of this id holds."""
    (found,) = (text for attributes, text in scripts(html) if f'id="{element}"' in attributes)
    data: dict[str, Any] = json.loads(found)
    return data
