"""Curves of every second, third, ... frame only, where all trials together would be more than a page may hold."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from gaitcal.page.packing import base64_of

MOST_LETTERS: Final = 7_000_000
"""Packed curves of all trials of a page together, of the 25 MB that it may have."""
_PARTS: Final = ("value", "se", "own", "nominal", "truth")


def thinned(sheet: Mapping[str, Any], most: int = MOST_LETTERS) -> Mapping[str, Any]:
    """The sheet with at most so many letters of packed curves; as it is where it has no more."""
    letters = sum(_letters(trial) for trial in sheet["trials"])
    every = max(1, -(-letters // most))
    return sheet if every == 1 else {**sheet, "trials": [_thinned(trial, every) for trial in sheet["trials"]]}


def curves_left_out(sheet: Mapping[str, Any]) -> tuple[str, ...]:
    """A sentence for every trial whose curves hold some frames only."""
    return tuple(
        f"{trial['name']}: its curves hold one frame in {trial['every']} of {trial['frames']}; a short peak may be "
        "lower in the page than in the tables"
        for trial in sheet["trials"]
        if trial["every"] > 1
    )


def _letters(trial: Mapping[str, Any]) -> int:
    return sum(len(part["data"]) for curve in trial["curves"] for name in _PARTS if (part := curve[name]) is not None)


def _thinned(trial: Mapping[str, Any], every: int) -> dict[str, Any]:
    def part(packed: Mapping[str, Any] | None) -> dict[str, Any] | None:
        return None if packed is None else {**packed, "data": _kept(packed["data"], "<i2", every)}

    return {
        **trial,
        "every": trial["every"] * every,
        "time": _kept(trial["time"], "<f4", every),
        "masks": [_kept(mask, "<u1", every) for mask in trial["masks"]],
        "curves": [{**curve, **{name: part(curve[name]) for name in _PARTS}} for curve in trial["curves"]],
    }


def _kept(data: str, numbers: str, every: int) -> str:
    return base64_of(np.frombuffer(base64.b64decode(data), dtype=numbers)[::every])
