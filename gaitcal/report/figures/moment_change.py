"""How much calibration changed each joint moment, and how sure that moment is."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from gaitcal.report.figures.chart import Chart, Panel, Size
from gaitcal.report.figures.style import NORMAL, SIDE_COLOURS, Key, dress
from gaitcal.report.moments import MomentNumbers
from gaitcal.report.words import coordinate_words, split_side
from gaitcal.study.result import TrialResult

BAR, ROW = 0.36, 0.27


def moment_change_chart(trial: TrialResult, numbers: tuple[MomentNumbers, ...], stem: str) -> Chart:
    """A pair of bars for each joint moment."""
    bases = list(dict.fromkeys(split_side(n.name)[0] for n in numbers))
    size = Size(4.4, 0.7 + ROW * len(bases), left=1.32, right=0.15, bottom=0.38, top=0.26)

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
