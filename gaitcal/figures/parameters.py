"""What calibration changed: how far each joint parameter moved, with its standard error, and each joint moment."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from gaitcal.figures.chart import Chart, Panel, Size
from gaitcal.figures.style import FAINT, INK, SIDE_COLOURS, SMALL, TRUTH_WORDS, Key, dress, dress_rows
from gaitcal.model.coordinates import coordinate_words, split_side
from gaitcal.session.parameter_words import Group, Row

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ROW = 0.2
OFFSET = {"r": -0.16, "l": 0.16, "": 0.0}
"""Of the right and the left side of one row, in rows."""


def parameters_chart(groups: tuple[Group, ...], truth: Mapping[str, float] | None = None) -> Chart | None:
    """Changes of positions (mm) and orientations (deg); None where no joint parameter was fitted.

    `truth`: parameter -> true value in the unit of the rows, where it is known.
    """
    known = truth or {}
    panels = [
        panel
        for title, unit in (("Positions", "mm"), ("Orientations", "deg"))
        if (panel := _panel(groups, title, unit, known)) is not None
    ]
    if not panels:
        return None
    middle = any(g.right and g.right[0].part == "back" for g in groups)
    shown = {"r": "right", "l": "left"} | ({"": "trunk"} if middle else {})
    return Chart(
        name="joint_parameters",
        title="How far each joint parameter moved",
        panels=tuple(panels),
        keys=(
            *(Key(label=label, colour=SIDE_COLOURS[side], kind="dot") for side, label in shown.items()),
            *((Key(label=TRUTH_WORDS, colour=INK, kind="ring"),) if known else ()),
        ),
        columns=2,
    )


def _panel(groups: tuple[Group, ...], title: str, unit: str, truth: Mapping[str, float]) -> Panel | None:
    rows: dict[str, list[Row]] = {}
    for group in groups:
        for row in (*group.right, *group.left):
            if row.unit == unit and row.status in ("fitted", "at bound"):
                rows.setdefault(row.words, []).append(row)
    if not rows:
        return None
    size = Size(width=3.6, height=0.66 + ROW * len(rows), left=1.98, right=0.12, bottom=0.38, top=0.26)

    def draw(axes: Axes) -> None:
        dress(axes, xlabel=f"change ({unit})", title=title)
        axes.axvline(0.0, color=FAINT, linewidth=0.8)
        for line, sides in enumerate(rows.values()):
            for row in sides:
                y, colour, error = line + OFFSET[row.side], SIDE_COLOURS[row.side], row.error or 0.0
                axes.plot([row.change - error, row.change + error], [y, y], color=colour, linewidth=1.2)
                axes.plot([row.change], [y], "o", color=colour, markersize=3.6)
                if row.name in truth:
                    at = truth[row.name] - row.nominal
                    axes.plot([at], [y], "o", color=colour, markerfacecolor="none", markersize=5.6, markeredgewidth=0.9)
        dress_rows(axes, [words.replace(" in the ", ", ") for words in rows], labelsize=SMALL)

    return Panel(f"{title} of joints: change by calibration, right and left, {unit}", draw, size)


BAR, CHANGE_ROW = 0.36, 0.27


def moment_change_chart(changes: Mapping[str, float], stem: str) -> Chart:
    """A pair of bars for each joint moment; `changes`: coordinate -> % of body weight times height."""
    bases = list(dict.fromkeys(split_side(name)[0] for name in changes))
    size = Size(width=4.4, height=0.7 + CHANGE_ROW * len(bases), left=1.32, right=0.15, bottom=0.38, top=0.26)

    def draw(axes: Axes) -> None:
        dress(axes, xlabel="RMS change (% of body weight × height)", title="Nominal to calibrated")
        for row, base in enumerate(bases):
            sides = [name for name in changes if split_side(name)[0] == base]
            offsets = np.linspace(-BAR / 2, BAR / 2, len(sides)) if len(sides) > 1 else np.zeros(1)
            for name, offset in zip(sides, offsets, strict=True):
                colour = SIDE_COLOURS[split_side(name)[1]]
                axes.barh(row + offset, changes[name], height=BAR * 0.92, color=colour)
        dress_rows(axes, [coordinate_words(base).title for base in bases])
        axes.set_xlim(left=0.0)

    return Chart(
        name=f"{stem}_moment_change",
        title="Change of the joint moments",
        panels=(
            Panel("RMS change of each joint moment, right and left, percent of body weight times height", draw, size),
        ),
        keys=tuple(
            Key(label=label, colour=SIDE_COLOURS[side], width=4.5)
            for side, label in (("r", "right"), ("l", "left"), ("", "trunk"))
            if any(split_side(name)[1] == side for name in changes)
        ),
        columns=1,
    )
