"""Plain data that the page's scripts read: packed arrays, JSON text, and the blocks that its
sections are made of.

Arrays are base64 of small integers or of 32-bit floats, little-endian; `scripts/unpack.js` reads
them back. Every text in a block is data, never markup. Numbers are formatted here, so that the
page, the print and a test read the same text.
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
    """JSON that is all ASCII and may stand inside a `<script>` element whatever the names are: it
    holds no `<`.
    """
    return json.dumps(content, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")


def encode_base64(values: NDArray[Any]) -> str:
    """The bytes of an array, row by row."""
    return base64.b64encode(np.ascontiguousarray(values).tobytes()).decode("ascii")


def pack_floats(values: NDArray[Any]) -> str:
    """As 32-bit floats."""
    return encode_base64(values.astype("<f4"))


def pack_lengths(values: NDArray[Any]) -> dict[str, Any]:
    """Values as 16-bit integers: value = low + step * (integer + 32767); gaps and infinities as
    `GAP`.
    """
    known = np.isfinite(values)
    low = float(values[known].min()) if known.any() else 0.0
    high = float(values[known].max()) if known.any() else 0.0
    step = max(high - low, 1e-9) / (2 * LARGEST)
    packed = np.full(values.shape, GAP, dtype="<i2")
    packed[known] = np.rint((values[known].astype(float) - low) / step) - LARGEST
    return {"low": low, "step": step, "data": encode_base64(packed)}


def count_curve_letters(trial: Mapping[str, Any]) -> int:
    """Letters of all packed curves of a trial's page data."""
    parts = (curve[name] for curve in trial["curves"] for name in _CURVE_PARTS)
    return sum(len(part["data"]) for part in parts if part is not None)


def thin_trial(trial: Mapping[str, Any], every: int) -> dict[str, Any]:
    """A trial's page data with every so manieth frame of its curves."""

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
    """`-1234.5` -> `−1 234.5`, with thin spaces; a dash where there is no value."""
    if value is None or value != value:
        return MISSING
    text = f"{value:{'+' if sign else ''},.{digits}f}"
    if float(text.replace(",", "")) == 0.0:
        text = text.lstrip("+-")
    return text.replace(",", "\u202f").replace("-", "−")


def round_number(value: float | None) -> float | None:
    """A number of a picture, without more digits than can be seen; None where there is none."""
    return None if value is None or value != value else round(float(value), 4)


def replace_control_characters(text: object) -> str:
    """The text with `?` for characters that control the terminal, the layout or the writing
    direction.
    """
    return "".join(
        "?" if unicodedata.category(c) in ("Cc", "Cf", "Cs", "Co") else c for c in str(text)
    )


def format_name(text: object) -> str:
    """A name from the study as a heading or a table shows it: of a very long one the middle is left
    out.
    """
    whole = replace_control_characters(text)
    return (
        whole
        if len(whole) <= LONGEST_NAME
        else f"{whole[: LONGEST_NAME - NAME_END - 1]}…{whole[-NAME_END:]}"
    )


def make_heading(text: str, level: int = 3) -> Block:
    """A heading within a preset: level 3 or 4."""
    return {"kind": "heading", "text": replace_control_characters(text), "level": level}


def make_text(words: str, tone: str = "") -> Block:
    """A paragraph. `tone`: `soft`, `warning` or `bad`."""
    return {"kind": "text", "text": replace_control_characters(words)} | (
        {"tone": tone} if tone else {}
    )


def make_list(items: Iterable[str], tone: str = "") -> Block:
    """A list; `tone` as of a paragraph."""
    return {"kind": "list", "items": [replace_control_characters(item) for item in items]} | (
        {"tone": tone} if tone else {}
    )


def make_cell(
    words: object, *, unit: str = "", tone: str = "", side: str = "", align: str = ""
) -> Cell:
    """One cell of a table; plain text where nothing is to be said of it."""
    extra = {"unit": unit, "tone": tone, "side": side, "align": align}
    given = {key: value for key, value in extra.items() if value}
    return (
        {"t": replace_control_characters(words), **given}
        if given
        else replace_control_characters(words)
    )


def make_text_column(title: str) -> Cell:
    """The head of a column of words, which begin at the left."""
    return make_cell(title, align="text")


def make_table(
    head: Sequence[Cell],
    rows: Sequence[Sequence[Cell]],
    *,
    caption: str = "",
    fold: str = "",
    total: Sequence[int] = (),
) -> Block:
    """A table; the first column heads the rows.

    `fold`: what stands in its place until it is opened; empty: it is open.
    `total`: numbers of the rows that sum up the others.
    """
    extra = {
        "caption": replace_control_characters(caption),
        "fold": replace_control_characters(fold),
        "total": list(total),
    }
    given = {key: value for key, value in extra.items() if value}
    return {"kind": "table", "head": list(head), "rows": [list(row) for row in rows], **given}


def pair_blocks(sides: Sequence[Sequence[Block]]) -> list[Block]:
    """Two groups of blocks beside each other; fewer or more below each other."""
    if len(sides) == 2:
        return [{"kind": "pair", "left": list(sides[0]), "right": list(sides[1])}]
    return [block for blocks in sides for block in blocks]


def fold_blocks(title: str, blocks: Sequence[Block]) -> Block:
    """Blocks that are folded away."""
    return {"kind": "fold", "title": replace_control_characters(title), "blocks": list(blocks)}


def make_picture(kind: str, unit: str, rows: Sequence[Mapping[str, Any]]) -> Block:
    """Rows of a picture.

    `kind`: `intervals`: dots with whiskers, of nominal and fitted values, and the truth where it is
    known.
    """
    return {"kind": kind, "unit": unit, "rows": [dict(row) for row in rows]}


def make_curves(kinds: Sequence[str]) -> Block:
    """The trial's own curves of some kinds, over time."""
    return {"kind": "curves", "kinds": list(kinds)}
