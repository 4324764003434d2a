"""Colours, line styles and axes that every figure shares.

The colours are Okabe and Ito's, which colour-blind eyes tell apart. Nothing here touches matplotlib's global state:
figures are drawn in threads and beside a user's own plots. matplotlib is loaded when something is drawn, not before.
"""

from __future__ import annotations

import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Final, Literal

import numpy as np

from gaitcal.gait.words import SIDE_WORDS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

RIGHT, LEFT, WHOLE = "#0072B2", "#D55E00", "#009E73"
STEP = "#E69F00"
NOMINAL, INK, FAINT, GRID = "#7f7f7f", "#222222", "#666666", "#e6e6e6"
STANCE, STANCE_KEY = "#000000", "#e4e4e4"
STANCE_ALPHA = 0.055
"""Of one side; where both feet are down the two tints add up."""
SIDE_COLOURS = {"r": RIGHT, "l": LEFT, "": WHOLE}
SIDE_DASHES: dict[str, tuple[float, ...]] = {"r": (), "l": (5.0, 1.6), "": ()}
"""The left side is dashed too: a print in grey stays readable."""

TRUTH_DASHES: dict[str, tuple[float, ...]] = {"r": (1.3, 1.3), "l": (5.0, 1.3, 1.3, 1.3), "": (1.3, 1.3)}
"""The truth is black, and of no dashes that another line has."""

FONT = "DejaVu Sans"
"""Comes with matplotlib: the same figure on every machine."""
SMALL, NORMAL, TITLE = 6.6, 7.2, 8.2
LONGEST_NAME = 26


@dataclass(frozen=True)
class Sizes:
    """Of letters, pt."""

    small: float = SMALL
    """Numbers at axes."""
    normal: float = NORMAL
    """Labels of axes, legends."""
    title: float = TITLE


SCREEN: Final = Sizes()


@dataclass(frozen=True, kw_only=True)
class Key:
    """One entry of a figure's legend."""

    label: str
    colour: str
    dashes: tuple[float, ...] = ()
    """Lengths of dashes and gaps, in line widths; none: a full line."""
    width: float = 1.6
    kind: str = "line"
    """`line`, `band` (see-through), `area`, `dot`, `ring` or `tick`."""


SIDE_KEYS = tuple(
    Key(label=SIDE_WORDS[side], colour=SIDE_COLOURS[side], dashes=SIDE_DASHES[side]) for side in ("r", "l")
)
"""Right and left in the legend of curves."""
TRUTH_WORDS = "truth (known: this person is made up)"
"""In legends."""


def line_style(dashes: tuple[float, ...]) -> Literal["-"] | tuple[float, tuple[float, ...]]:
    """Dashes as matplotlib wants them."""
    return (0.0, dashes) if dashes else "-"


@lru_cache(maxsize=1)
def _characters() -> frozenset[int]:
    from matplotlib.font_manager import FontProperties, findfont, get_font

    return frozenset(get_font(findfont(FontProperties(family=FONT))).get_charmap())


def plain(text: str, limit: int = LONGEST_NAME) -> str:
    """A name from the user's data as matplotlib shows it: no markup, only printable characters, not too long.

    `$` begins matplotlib's own markup and is escaped; what the font cannot draw, and all that controls the direction
    or flow of text, becomes a middle dot.
    """
    known = _characters()
    shown = [c if c == " " or (ord(c) in known and unicodedata.category(c)[0] not in "CZ") else "·" for c in text]
    if len(shown) > limit:
        shown = shown[: limit - 1] + ["…"]
    return "".join(shown).replace("$", r"\$")


def dress(axes: Axes, *, xlabel: str = "", ylabel: str = "", title: str = "", sizes: Sizes = SCREEN) -> None:
    """Give axes their common look: labels in ink, no frame above and at the right, light grid lines."""
    from matplotlib.ticker import MaxNLocator

    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color(FAINT)
        axes.spines[side].set_linewidth(0.6)
    axes.tick_params(colors=INK, labelsize=sizes.small, labelfontfamily=FONT, width=0.6, length=2.5, color=FAINT, pad=2)
    axes.grid(color=GRID, linewidth=0.5)
    axes.set_axisbelow(True)
    axes.set_facecolor("white")
    axes.set_xlabel(xlabel, fontsize=sizes.normal, family=FONT, color=INK, labelpad=2)
    axes.set_ylabel(ylabel, fontsize=sizes.normal, family=FONT, color=INK, labelpad=2)
    if title:
        axes.set_title(title, fontsize=sizes.title, family=FONT, color=INK, loc="left", fontweight="bold", pad=4)
    axes.yaxis.set_major_locator(MaxNLocator(5))


def dress_rows(axes: Axes, labels: Sequence[str], *, labelsize: float = NORMAL, least: int = 0) -> None:
    """A row for each label, the first on top, room for at least `least`: no ticks and no lines between them."""
    axes.set_yticks(range(len(labels)), labels=labels)
    axes.tick_params(axis="y", length=0, labelsize=labelsize)
    axes.set_ylim(max(len(labels), least) - 0.4, -0.6)
    axes.grid(visible=False, axis="y")


def write(axes: Axes, x: float, y: float, text: str, **options: object) -> None:
    """Small text in axes, `text` already `plain` where it comes from data."""
    style: dict[str, object] = {"fontsize": SMALL, "family": FONT, "color": FAINT}
    axes.text(x, y, text, **(style | options))  # type: ignore[arg-type]


def limits(values: list[np.ndarray], least: float, margin: float = 0.06) -> tuple[float, float]:
    """Limits of an axis that hold all finite `values` and span at least `least`."""
    finite = np.concatenate([v[np.isfinite(v)].ravel() for v in values] or [np.empty(0)])
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 0.0)
    middle, half = (low + high) / 2, max((high - low) * (0.5 + margin), least / 2)
    return middle - half, middle + half
