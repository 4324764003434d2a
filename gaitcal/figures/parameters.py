"""How far each joint parameter moved, with its standard error.

How much calibration changed each joint moment, and how sure that moment is.
"""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from gaitcal.figures.chart import Chart, Panel, Size
from gaitcal.figures.style import FAINT, NORMAL, SIDE_COLOURS, SMALL, Key, dress
from gaitcal.gait.moments import MomentNumbers
from gaitcal.gait.words import coordinate_words, split_side
from gaitcal.person.parameter_words import Group, Row
from gaitcal.person.result import TrialResult

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


BAR, CHANGE_ROW = 0.36, 0.27


def moment_change_chart(trial: TrialResult, numbers: tuple[MomentNumbers, ...], stem: str) -> Chart:
    """A pair of bars for each joint moment."""
    bases = list(dict.fromkeys(split_side(n.name)[0] for n in numbers))
    size = Size(4.4, 0.7 + CHANGE_ROW * len(bases), left=1.32, right=0.15, bottom=0.38, top=0.26)

    def draw(axes: Axes) -> None:
        dress(axes, xlabel="RMS change (% of body weight × height)", title="Nominal to calibrated")
        for row, base in enumerate(bases):
            own = [n for n in numbers if split_side(n.name)[0] == base]
            places = np.linspace(-BAR / 2, BAR / 2, len(own)) if len(own) > 1 else np.zeros(1)
            for number, place in zip(own, places, strict=True):
                axes.barh(row + place, number.change_bwh, height=BAR * 0.92, color=SIDE_COLOURS[number.side])
        axes.set_yticks(range(len(bases)), labels=[coordinate_words(b).title for b in bases])
        axes.tick_params(axis="y", length=0, labelsize=NORMAL)
        axes.set_ylim(len(bases) - 0.4, -0.6)
        axes.set_xlim(left=0.0)
        axes.grid(visible=False, axis="y")

    return Chart(
        f"{stem}_moment_change",
        "Change of the joint moments",
        "RMS difference over the valid frames between the moments of the nominal and of the calibrated model. Where "
        "the bars are small against the effect you study, calibration did not matter for it.",
        (Panel("RMS change of each joint moment, right and left, percent of body weight times height", draw, size),),
        tuple(
            Key(label, SIDE_COLOURS[side], width=4.5)
            for side, label in (("r", "right"), ("l", "left"), ("", "trunk"))
            if any(n.side == side for n in numbers)
        ),
        columns=1,
        subject=trial.name,
    )
