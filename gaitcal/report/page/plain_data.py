"""Plain data for the page's scripts: packed arrays, JSON text, blocks of sections.

Arrays are base64 of small integers or 32-bit floats, little-endian; `scripts/unpack.js` reads them.
Every text in a block is data, never markup. Numbers are formatted here, so that page, print and
tests have the same text.
"""

import base64
import json
import unicodedata
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

GAP: Final = -32768  # Where a packed length has no value
LARGEST: Final = 32767  # Integer of a packed length
Block = dict[str, Any]
Cell = str | dict[str, Any]
Sections = dict[str, list[Block]]  # Preset of the page -> its blocks
MISSING: Final = "–"
LONGEST_NAME: Final = 60
NAME_END: Final = 20  # Characters at the end of a cut name: names of one study often begin alike
_CURVE_PARTS: Final = ("value", "se", "own", "nominal", "truth")


def dump_script_json(content: object) -> str:
    """Dump JSON that may be placed inside a `<script>` element: ASCII without `<`.

    Parameters
    ----------
    content
        Plain data; no NaN.

    Returns
    -------
    str
        JSON.
    """
    return json.dumps(content, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")


def encode_base64(values: NDArray[Any]) -> str:
    """Encode the bytes of an array, row by row."""
    return base64.b64encode(np.ascontiguousarray(values).tobytes()).decode("ascii")


def pack_floats(values: NDArray[Any]) -> str:
    """Pack values as 32-bit floats.

    Parameters
    ----------
    values
        Any shape.

    Returns
    -------
    str
        Base64.
    """
    return encode_base64(values.astype("<f4"))


def pack_lengths(values: NDArray[Any]) -> dict[str, Any]:
    """Pack values as 16-bit integers: value = low + step * (integer + `LARGEST`).

    Parameters
    ----------
    values
        Any shape; gaps and infinities become `GAP`.

    Returns
    -------
    dict
        `low`, `step` and `data` (base64).
    """
    known = np.isfinite(values)
    low = float(values[known].min()) if known.any() else 0.0
    high = float(values[known].max()) if known.any() else 0.0
    step = max(high - low, 1e-9) / (2 * LARGEST)
    packed = np.full(values.shape, GAP, dtype="<i2")
    packed[known] = np.rint((values[known].astype(float) - low) / step) - LARGEST
    return {"low": low, "step": step, "data": encode_base64(packed)}


def count_curve_letters(trial: Mapping[str, Any]) -> int:
    """Count the characters of all packed curves of a trial."""
    parts = (curve[name] for curve in trial["curves"] for name in _CURVE_PARTS)
    return sum(len(part["data"]) for part in parts if part is not None)


def thin_trial(trial: Mapping[str, Any], every: int) -> dict[str, Any]:
    """Thin the curves of a trial to one frame in `every`."""

    def kept(data: str, numbers: str) -> str:
        return encode_base64(np.frombuffer(base64.b64decode(data), dtype=numbers)[::every])

    def part(packed: Mapping[str, Any] | None) -> dict[str, Any] | None:
        return None if packed is None else {**packed, "data": kept(packed["data"], "<i2")}

    return {
        **trial,
        "every": trial["every"] * every,
        "time": kept(trial["time"], "<f4"),
        "masks": [kept(mask, "<u1") for mask in trial["masks"]],
        "curves": [
            {**curve, **{name: part(curve[name]) for name in _CURVE_PARTS}}
            for curve in trial["curves"]
        ],
    }


def format_number(value: float | None, digits: int = 1, sign: bool = False) -> str:
    """Format `-1234.5` as `−1 234.5`, with thin spaces; a dash for missing values."""
    if value is None or value != value:
        return MISSING
    text = f"{value:{'+' if sign else ''},.{digits}f}"
    if float(text.replace(",", "")) == 0.0:
        text = text.lstrip("+-")
    return text.replace(",", "\u202f").replace("-", "−")


def round_number(value: float | None) -> float | None:
    """Round a number of a picture to four decimals; None for missing values."""
    return None if value is None or value != value else round(float(value), 4)


def replace_control_characters(text: object) -> str:
    """Replace characters that control the terminal, the layout or the writing direction by `?`."""
    return "".join(
        "?" if unicodedata.category(c) in ("Cc", "Cf", "Cs", "Co") else c for c in str(text)
    )


def format_name(text: object) -> str:
    """Format a name from the study; the middle of a very long one is omitted."""
    visible = replace_control_characters(text)
    return (
        visible
        if len(visible) <= LONGEST_NAME
        else f"{visible[: LONGEST_NAME - NAME_END - 1]}…{visible[-NAME_END:]}"
    )


def make_heading(text: str, level: int = 3) -> Block:
    """Make a heading within a preset: level 3 or 4."""
    return {"kind": "heading", "text": replace_control_characters(text), "level": level}


def make_text(sentence: str, tone: str = "") -> Block:
    """Make a paragraph; `tone`: `soft`, `warning` or `bad`."""
    return {"kind": "text", "text": replace_control_characters(sentence)} | (
        {"tone": tone} if tone else {}
    )


def make_list(items: Iterable[str], tone: str = "") -> Block:
    """Make a list; `tone` as of a paragraph."""
    return {"kind": "list", "items": [replace_control_characters(item) for item in items]} | (
        {"tone": tone} if tone else {}
    )


def make_cell(
    content: object, *, unit: str = "", tone: str = "", side: str = "", align: str = ""
) -> Cell:
    """Make one cell of a table; plain text if it has no attribute."""
    extra = {"unit": unit, "tone": tone, "side": side, "align": align}
    given = {key: value for key, value in extra.items() if value}
    return (
        {"t": replace_control_characters(content), **given}
        if given
        else replace_control_characters(content)
    )


def make_text_column(title: str) -> Cell:
    """Make the head of a text column, aligned left."""
    return make_cell(title, align="text")


def make_table(
    head: Sequence[Cell],
    rows: Sequence[Sequence[Cell]],
    *,
    caption: str = "",
    fold: str = "",
    total: Sequence[int] = (),
) -> Block:
    """Make a table; the first column heads the rows.

    `fold`: title shown until the table is opened; empty: it is open. `total`: numbers of summary
    rows.
    """
    extra = {
        "caption": replace_control_characters(caption),
        "fold": replace_control_characters(fold),
        "total": list(total),
    }
    given = {key: value for key, value in extra.items() if value}
    return {"kind": "table", "head": list(head), "rows": [list(row) for row in rows], **given}


def pair_blocks(sides: Sequence[Sequence[Block]]) -> list[Block]:
    """Put two groups of blocks side by side; fewer or more below each other."""
    if len(sides) == 2:
        return [{"kind": "pair", "left": list(sides[0]), "right": list(sides[1])}]
    return [block for blocks in sides for block in blocks]


def fold_blocks(title: str, blocks: Sequence[Block]) -> Block:
    """Fold blocks below a title."""
    return {"kind": "fold", "title": replace_control_characters(title), "blocks": list(blocks)}


def make_picture(kind: str, unit: str, rows: Sequence[Mapping[str, Any]]) -> Block:
    """Make a picture of rows.

    `kind`: `intervals`: dots with whiskers of nominal and fitted values, and of the truth if known.
    """
    return {"kind": kind, "unit": unit, "rows": [dict(row) for row in rows]}


def make_curves(kinds: Sequence[str]) -> Block:
    """Make a plot of the trial's curves of some kinds, over time."""
    return {"kind": "curves", "kinds": list(kinds)}
