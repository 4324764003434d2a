"""The rows of small multiples: which coordinates belong to which joint, and what their signs mean.

The page of a code (`gaitcal explain`) as blocks of the sheet, so that a reason's is there without a network.
"""

from __future__ import annotations

from typing import Any

from gaitcal.codes import Code
from gaitcal.explanations.explanation import explanation_of
from gaitcal.explanations.markdown import Bullets, Paragraph, parts_of
from gaitcal.model.coordinates import COORDINATE_TABLE, GROUPS, Coordinate, is_of_leg
from gaitcal.model.linkage import SIDES
from gaitcal.page.sections.blocks import Block, bullets, heading, text


def sheet_rows() -> list[dict[str, Any]]:
    """Joints with their coordinates: titles, and what positive and negative values mean.

    `angle`, `moment`: words for a positive and a negative value with OpenSim's signs, moments internal. `flips`: the
    clinical signs have the opposite moment. `pelvis`: side of the stride -> sign and word of the clinical angle.
    """
    return [
        {
            "joint": key,
            "title": group.title,
            "power": group.power or None,
            "rows": [_row(row) for row in COORDINATE_TABLE.values() if row.group == key],
        }
        for key, group in GROUPS.items()
    ]


def joint_of(base: str) -> str:
    """The joint of the page that a coordinate, or a power of a joint, belongs to; empty where none."""
    if base in COORDINATE_TABLE:
        return COORDINATE_TABLE[base].group
    return next((key for key, group in GROUPS.items() if group.power == base), "")


def _row(row: Coordinate) -> dict[str, Any]:
    clinical = row.clinical
    return {
        "base": row.name,
        "title": row.title,
        "angle": list(row.senses or (row.angle, f"not {row.angle}")),
        "moment": list(row.senses or (row.moment, f"not {row.moment}")),
        "actor": row.moment,
        "flips": is_of_leg(row.name),
        "pelvis": {s: {"sign": clinical.sign(s), "words": clinical.words} for s in SIDES} if clinical else {},
    }


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
