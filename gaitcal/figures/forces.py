"""Ground reaction forces on each foot, and what they leave unexplained at the pelvis."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.figures.chart import Chart, Panel, Size
from gaitcal.figures.style import (
    FAINT,
    INK,
    NOMINAL,
    SIDE_COLOURS,
    SIDE_DASHES,
    SIDE_KEYS,
    STEP,
    WHOLE,
    Key,
    dress,
    limits,
    line_style,
    write,
)
from gaitcal.gait.strides import thinned
from gaitcal.io.intervals import runs

if TYPE_CHECKING:
    from matplotlib.axes import Axes

UPWARD = 1
AXES = (("Vertical", "up", UPWARD), ("Fore-aft", "forward", 0), ("Sideways", "to the right", 2))
INVALID = "#f7e3c4"
INVALID_KEY = Key(label="whole body not valid", colour=INVALID, kind="area")
LEG_KEY = Key(label="moments of a leg not valid: right above, left below", colour=INVALID, kind="area")
LIMIT_KEY = Key(label="asked of simulations", colour=INK, dashes=(2.0, 2.0), width=1.0)
LEAST = 5.0
"""Smallest range of a vertical axis, % of body weight."""


@dataclass(frozen=True, kw_only=True)
class Forces:
    """Ground reactions of one trial."""

    time: Array
    """(nf,) s."""
    force: Array
    """(nf, 2, 3) % of body weight, right and left foot: forward, up, to the right."""
    valid_legs: BoolArray
    """(nf, 2) torques of the right and the left leg may be used."""


def forces_chart(forces: Forces, stem: str) -> Chart:
    """Three components over time, right and left foot."""
    return Chart(
        name=f"{stem}_ground_reactions",
        title="Ground reaction forces",
        panels=tuple(_panel(title, word, forces, k) for title, word, k in AXES),
        keys=(*SIDE_KEYS, LEG_KEY),
    )


def shade_invalid(axes: Axes, time: Array, valid: BoolArray, part: tuple[float, float] = (0.0, 1.0)) -> None:
    """Tint the stretches in which torques are not known, over a part of the height of the axes."""
    for run in runs(~valid):
        axes.axvspan(
            float(time[max(run.start - 1, 0)]),
            float(time[min(run.stop, len(time) - 1)]),
            *part,
            color=INVALID,
            linewidth=0,
            zorder=0,
        )


def _panel(title: str, word: str, forces: Forces, axis: int) -> Panel:
    time, force = forces.time, forces.force[:, :, axis]

    def draw(axes: Axes) -> None:
        dress(axes, xlabel="time (s)", ylabel=f"% body weight ({word} +)", title=title)
        for leg, part in ((0, (0.5, 1.0)), (1, (0.0, 0.5))):
            shade_invalid(axes, time, forces.valid_legs[:, leg], part)
        axes.axhline(0.0, color=FAINT, linewidth=0.5)
        for k, side in enumerate(("r", "l")):
            x, y = thinned(time, np.where(forces.force[:, k, UPWARD] == 0.0, np.nan, force[:, k]))
            axes.plot(x, y, color=SIDE_COLOURS[side], linestyle=line_style(SIDE_DASHES[side]), linewidth=1.4)
        axes.set_xlim(float(time[0]), float(time[-1]))
        axes.set_ylim(*limits([force, np.zeros(1)], LEAST))

    return Panel(f"{title} ground reaction force on right and left foot, percent of body weight over time", draw)


SIZE = Size(width=3.6, height=2.1)
MOST = 0.98
"""Share of the frames that the vertical axis is made for; a spike at a trial's end would hide all others."""


@dataclass(frozen=True)
class Stage:
    """Pelvis residuals with one model."""

    name: str
    """Which, in words."""
    force: Array
    """(nf,) N, magnitude."""
    moment: Array
    """(nf,) N·m."""


@dataclass(frozen=True, kw_only=True)
class Residuals:
    """Pelvis residuals of one trial with at least one valid frame."""

    time: Array
    """(nf,) s."""
    valid: BoolArray
    """(nf,) torques of the whole body may be used."""
    stages: tuple[Stage, ...]
    """From the nominal model to the last one."""
    limit: tuple[float, float] | None = None
    """N and N·m: what is commonly asked for; None: not known."""


def residuals_chart(residuals: Residuals, stem: str) -> Chart:
    """Magnitude of residual force and moment; the first step grey, the last one in colour."""
    steps, time, valid = residuals.stages, residuals.time, residuals.valid
    colours = [NOMINAL, *([STEP] * (len(steps) - 2)), WHOLE][-len(steps) :]
    widths = [0.9, *([0.9] * (len(steps) - 2)), 1.6][-len(steps) :]
    bounds = residuals.limit or (None, None)

    def panel(title: str, unit: str, values: list[Array], bound: float | None) -> Panel:
        def draw(axes: Axes) -> None:
            dress(axes, xlabel="time (s)", ylabel=unit, title=title)
            shade_invalid(axes, time, valid)
            for value, colour, width in zip(values, colours, widths, strict=True):
                x, y = thinned(time, np.where(valid, value, np.nan))
                axes.plot(x, y, color=colour, linewidth=width)
            if bound is not None:
                axes.axhline(bound, color=INK, linewidth=1.0, linestyle=(0, (2, 2)))
            axes.set_xlim(float(time[0]), float(time[-1]))
            highest = max(float(v[valid].max()) for v in values)
            usual = max(float(np.quantile(v[valid], MOST)) for v in values)
            top = 1.12 * max(bound or 0.0, highest if highest < 1.5 * usual else 1.25 * usual)
            axes.set_ylim(0.0, top)
            last = np.where(valid, values[-1], -1.0)
            if last.max() > top:
                beyond = f"peak {last.max():.0f} {unit} at {time[last.argmax()]:.2f} s, not drawn"
                write(axes, 0.5, 0.93, beyond, transform=axes.transAxes, ha="center")

        return Panel(f"{title} in {unit} over time, with its limit", draw, SIZE)

    return Chart(
        name=f"{stem}_pelvis_residuals",
        title="Pelvis residuals",
        panels=(
            panel("Residual force", "N", [s.force for s in steps], bounds[0]),
            panel("Residual moment", "N·m", [s.moment for s in steps], bounds[1]),
        ),
        keys=(
            *(Key(label=s.name, colour=c, width=w) for s, c, w in zip(steps, colours, widths, strict=True)),
            *((LIMIT_KEY,) if residuals.limit else ()),
            INVALID_KEY,
        ),
        columns=2,
    )
