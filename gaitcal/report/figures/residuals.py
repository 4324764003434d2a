"""The force and moment at the pelvis that no ground reaction explains, over time, against common limits."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from gaitcal.report.figures.chart import Chart, Panel, Size
from gaitcal.report.figures.forces import INVALID_KEY, shade_invalid, thinned
from gaitcal.report.figures.style import INK, NOMINAL, STEP, WHOLE, Key, dress, write
from gaitcal.study.residual_limits import Limits, Stage
from gaitcal.study.result import LoadedTrial, TrialResult

Array = NDArray[np.float64]

SIZE = Size(width=3.6, height=2.1)
MOST = 0.98
"""Share of the frames that the vertical axis is made for; a spike at a trial's end would hide all others."""


def residuals_chart(
    trial: TrialResult, loads: LoadedTrial, found: tuple[Stage, ...], limit: Limits, stem: str
) -> Chart:
    """Magnitude of residual force and moment; the first step grey, the last one in colour."""
    colours = [NOMINAL, *([STEP] * (len(found) - 2)), WHOLE][: len(found)]
    widths = [0.9, *([0.9] * (len(found) - 2)), 1.6][: len(found)]
    time, valid = trial.body.time, loads.reactions.valid

    def panel(title: str, unit: str, values: list[Array], bound: float) -> Panel:
        def draw(axes: Axes) -> None:
            dress(axes, xlabel="time (s)", ylabel=unit, title=title)
            shade_invalid(axes, time, valid)
            for value, colour, width in zip(values, colours, widths, strict=True):
                x, y = thinned(time, np.where(valid, value, np.nan))
                axes.plot(x, y, color=colour, linewidth=width)
            axes.axhline(bound, color=INK, linewidth=1.0, linestyle=(0, (2, 2)))
            axes.set_xlim(float(time[0]), float(time[-1]))
            highest = max(float(v[valid].max()) for v in values)
            usual = max(float(np.quantile(v[valid], MOST)) for v in values)
            top = 1.12 * max(bound, highest if highest < 1.5 * usual else 1.25 * usual)
            axes.set_ylim(0.0, top)
            last = np.where(valid, values[-1], -1.0)
            if last.max() > top:
                told = f"peak {last.max():.0f} {unit} at {time[last.argmax()]:.2f} s, not drawn"
                write(axes, 0.5, 0.93, told, transform=axes.transAxes, ha="center")

        return Panel(f"{title} in {unit} over time, with its limit", draw, SIZE)

    return Chart(
        f"{stem}_pelvis_residuals",
        "Pelvis residuals",
        "Magnitude of the force and the moment at the pelvis that the measured motion needs and the measured ground "
        "reactions do not supply. Perfect data and a perfect model would give zero.",
        (
            panel("Residual force", "N", [s.force for s in found], limit.force),
            panel("Residual moment", "N·m", [s.moment for s in found], limit.moment),
        ),
        (
            *(Key(s.name, c, width=w) for s, c, w in zip(found, colours, widths, strict=True)),
            Key("common limit", INK, (2.0, 2.0), 1.0),
            INVALID_KEY,
        ),
        columns=2,
        subject=trial.name,
    )
