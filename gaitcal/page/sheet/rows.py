"""The rows of small multiples: which coordinates belong to which joint, and what their signs mean."""

from __future__ import annotations

from typing import Any

from gaitcal.model.coordinates import COORDINATE_TABLE, GROUPS, Coordinate, is_of_leg
from gaitcal.model.linkage import SIDES


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
