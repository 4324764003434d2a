"""How far each joint parameter moved, with its standard error."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from gaitcal.report.figures.chart import Chart, Panel, Size
from gaitcal.report.figures.style import FAINT, SIDE_COLOURS, SMALL, Key, dress
from gaitcal.report.parameters import Group, Row

ROW = 0.2
OFFSET = 0.16


def parameters_chart(groups: tuple[Group, ...]) -> Chart | None:
    """Changes of positions (mm) and orientations (deg); None where no joint parameter was fitted."""
    panels = [
        panel
        for title, unit in (("Positions", "mm"), ("Orientations", "deg"))
        if (panel := _panel(groups, title, unit)) is not None
    ]
    if not panels:
        return None
    moved = any(g.right and g.right[0].name.startswith("back.") for g in groups)
    trunk = (Key("trunk", SIDE_COLOURS[""], kind="dot"),) if moved else ()
    return Chart(
        "joint_parameters",
        "How far each joint parameter moved",
        "Fitted minus nominal value, with ±1 standard error where there is one. Positions are in the axes of the named "
        "segment: forward, up, to the right.",
        tuple(panels),
        (
            Key("right", SIDE_COLOURS["r"], kind="dot"),
            Key("left", SIDE_COLOURS["l"], kind="dot"),
            *trunk,
        ),
        columns=2,
    )


def _panel(groups: tuple[Group, ...], title: str, unit: str) -> Panel | None:
    rows: dict[str, list[tuple[str, Row]]] = {}
    for group in groups:
        for side, own in (("r", group.right), ("l", group.left)):
            for row in own:
                if row.unit == unit and row.status in ("fitted", "at bound"):
                    real = side if row.name.split(".")[0].endswith(("_r", "_l")) else ""
                    rows.setdefault(row.words, []).append((real, row))
    if not rows:
        return None
    size = Size(3.6, 0.66 + ROW * len(rows), left=1.98, right=0.12, bottom=0.38, top=0.26)

    def draw(axes: Axes) -> None:
        dress(axes, xlabel=f"change ({unit})", title=title)
        axes.axvline(0.0, color=FAINT, linewidth=0.8)
        for place, entries in enumerate(rows.values()):
            for side, row in entries:
                at = place + {"r": -OFFSET, "l": OFFSET, "": 0.0}[side]
                error = row.error or 0.0
                axes.plot([row.change - error, row.change + error], [at, at], color=SIDE_COLOURS[side], linewidth=1.2)
                axes.plot([row.change], [at], "o", color=SIDE_COLOURS[side], markersize=3.6)
        axes.set_yticks(np.arange(len(rows)), labels=[_short(words) for words in rows])
        axes.tick_params(axis="y", length=0, labelsize=SMALL)
        axes.set_ylim(len(rows) - 0.4, -0.6)
        axes.grid(visible=False, axis="y")

    return Panel(f"{title} of joints: change by calibration, right and left, {unit}", draw, size)


def _short(words: str) -> str:
    return words.replace(" in the ", ", ")
