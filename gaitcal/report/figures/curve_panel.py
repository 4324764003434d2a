"""Draw one variable over the gait cycle: the panel of report, figures for papers and comparison."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np

from gaitcal.arrays import Array
from gaitcal.gait.cycles import POINTS, CurveKind
from gaitcal.report.figures import chart

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LINE, THIN, TOE_OFF = 1.4, 0.5, 0.6
"""Widths of mean curves, zero lines and toe-off lines, pt."""
BAND: Final = 0.2  # Opacity
NORM_COLOUR: Final = "#d9d9d9"
LEAST: Final = {
    CurveKind.ANGLE: 20.0,
    CurveKind.MOMENT: 0.4,
    CurveKind.POWER: 1.0,
    CurveKind.FORCE: 2.0,
}
"""Smallest range of a vertical axis, in deg, N·m/kg, W/kg and N/kg: small changes look small."""
BAR: Final = 0.03  # Height of the marks below curves, of the vertical axis


@dataclass(frozen=True, kw_only=True)
class CurvePanel:
    """One variable, in the units and signs that are shown; NaN where it is not valid.

    Mappings are of sides; `mean` decides which sides are drawn, and in which order.
    """

    title: str
    unit: str
    senses: tuple[str, str] = ("", "")
    """What positive and negative values mean, below the title."""
    x: Array = field(default_factory=lambda: np.arange(float(POINTS)))
    x_label: str = "gait cycle (%)"
    mean: Mapping[str, Array]  # (n,)
    error: Mapping[str, Array]  # (n,) half the width of the band about the mean
    strides: Mapping[str, tuple[Array, ...]] = field(default_factory=dict)  # (n,), thin
    thin: tuple[float, float] = (0.4, 0.35)  # Width in points and opacity of the lines of strides
    norms: Mapping[str, tuple[Array, Array]] = field(default_factory=dict)
    """Mean and SD (n,) of healthy people: of one side only where both have the same."""
    marked: Mapping[str, Array] = field(default_factory=dict)  # (n,) bool: marked by bars
    toe_off: Mapping[str, float] = field(default_factory=dict)  # %
    least: float

    @property
    def limits(self) -> tuple[float, float]:
        """Limits of the vertical axis."""
        values = [stride for strides in self.strides.values() for stride in strides]
        for mean, half in (
            *((m, self.error[s]) for s, m in self.mean.items()),
            *self.norms.values(),
        ):
            values += [mean, mean - half, mean + half]
        return chart.compute_limits(values, self.least)

    def make_panel(self, size: chart.Size, letters: chart.Sizes, label: str) -> chart.Panel:
        """Make the panel of a chart.

        Parameters
        ----------
        size
            Of the panel.
        letters
            Sizes of letters.
        label
            What it shows, for readers who cannot see it.
        """
        return chart.Panel(label, partial(_draw, panel=self, letters=letters), size)


def make_side_key(side: str, label: str) -> chart.Key:
    """Make the entry of the legend for the mean curve of a side."""
    return chart.Key(
        label=label, colour=chart.SIDE_COLOURS[side], dashes=chart.SIDE_DASHES[side], width=LINE
    )


def make_norm_key(label: str) -> chart.Key:
    """Make the entry of the legend for normative data."""
    return chart.Key(label=f"{label}, mean ± SD", colour=NORM_COLOUR, kind="band")


def _draw(axes: Axes, panel: CurvePanel, letters: chart.Sizes) -> None:
    senses = (f"{sign} {sense}" for sign, sense in zip("+−", panel.senses, strict=True) if sense)
    chart.format_axes(
        axes,
        xlabel=panel.x_label,
        ylabel=panel.unit,
        title=panel.title,
        senses="   ".join(senses),
        sizes=letters,
    )
    low, high = panel.limits
    for mean, sd in panel.norms.values():
        axes.fill_between(panel.x, mean - sd, mean + sd, color=NORM_COLOUR, linewidth=0)
    axes.axhline(0.0, color=chart.FAINT, linewidth=THIN)
    for side, percent in panel.toe_off.items():
        dashes = chart.make_line_style(chart.SIDE_DASHES[side])
        colour = chart.SIDE_COLOURS[side]
        axes.axvline(percent, color=colour, linewidth=TOE_OFF, linestyle=dashes)
    for k, (side, mean) in enumerate(panel.mean.items()):
        colour, half = chart.SIDE_COLOURS[side], panel.error[side]
        dashes = chart.make_line_style(chart.SIDE_DASHES[side])
        width, opacity = panel.thin
        for stride in panel.strides.get(side, ()):
            axes.plot(
                panel.x, stride, color=colour, linewidth=width, alpha=opacity, linestyle=dashes
            )
        axes.fill_between(panel.x, mean - half, mean + half, color=colour, alpha=BAND, linewidth=0)
        axes.plot(panel.x, mean, color=colour, linewidth=LINE, linestyle=dashes)
        if side in panel.marked:
            # the bars of the sides lie one above the other at the foot of the panel
            axes.fill_between(
                panel.x,
                low + k * BAR * (high - low),
                low + (k + 0.8) * BAR * (high - low),
                where=panel.marked[side],
                color=colour,
                linewidth=0,
            )
    if panel.x_label == CurvePanel.x_label:
        axes.set_xlim(0.0, 100.0)
        axes.set_xticks([0, 20, 40, 60, 80, 100])
    axes.set_ylim(low, high)
    if not any(np.isfinite(mean).any() for mean in panel.mean.values()):
        axes.text(
            0.5,
            0.5,
            "no valid strides",
            transform=axes.transAxes,
            ha="center",
            fontsize=letters.normal,
            family=chart.FONT,
            color=chart.FAINT,
        )
