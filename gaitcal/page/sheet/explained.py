"""The page of a code (`gaitcal explain`) as blocks of the sheet, so that a reason's is there without a network."""

from __future__ import annotations

from typing import Any

from gaitcal.codes import Code
from gaitcal.explanations.explanation import explanation_of
from gaitcal.explanations.markdown import Bullets, Paragraph, parts_of
from gaitcal.page.sections.blocks import Block, bullets, heading, text

PLAIN = str.maketrans("", "", "`")


def explained_code(code: Code) -> dict[str, Any]:
    """Entries `code`, `title` and `page` (blocks) of a reason."""
    told = explanation_of(code)
    blocks: list[Block] = []
    for part, pieces in parts_of(told.text):
        blocks.append(heading(part, 3))
        for piece in pieces:
            if isinstance(piece, Paragraph):
                blocks.append(text(piece.text.translate(PLAIN)))
            elif isinstance(piece, Bullets):
                blocks.append(bullets(item.translate(PLAIN) for item in piece.items))
            else:
                blocks.append(text(" ".join(piece.lines), "soft"))
    return {"code": code.value, "title": told.title, "page": blocks}
