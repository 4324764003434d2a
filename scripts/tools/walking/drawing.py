"""The built-in person's walk beside the normal bands, drawn."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from gaitcal.arrays import Array
from gaitcal.dynamics.foot_contact import FootPoints
from gaitcal.dynamics.sole import HEEL_M, SHAPE
from gaitcal.figures.chart import new_figure
from gaitcal.figures.style import FAINT, FONT, NORMAL, SIDE_COLOURS, SIDE_DASHES, TITLE, dress, line_style, write
from gaitcal.gait.words import SIDE_WORDS
from gaitcal.model.linkage import SIDES
from scripts.tools.walking.true_walk import ADULT_PEAKS, MOMENTS, Walk, normal_bands, outside_sole

SOURCES = "Bands: Schwartz et al. 2008, free speed, children and adolescents; models/normal_walking.csv tells more."


def draw(walk: Walk) -> Figure:
    """All of it in one figure."""
    bands = normal_bands()
    figure = new_figure(9.0, 8.8, dpi=150)
    cells = figure.add_gridspec(
        4, 3, height_ratios=(1, 1, 1, 0.62), left=0.07, right=0.985, top=0.935, bottom=0.085, hspace=0.4, wspace=0.24
    )
    for k, stem in enumerate(MOMENTS):
        axes = figure.add_subplot(cells[divmod(k, 3)])
        title, low, high = MOMENTS[stem]
        dress(axes, title=title, ylabel=f"{low}  ·  {high}" if k % 3 else f"N·m/kg   {low}  ·  {high}")
        if stem in bands:
            _band(axes, bands[stem])
        for name in (low, high):
            if (stem, name) in ADULT_PEAKS:
                _peak_band(axes, *ADULT_PEAKS[stem, name])
        for foot, side in enumerate(SIDES):
            _curve(axes, walk.percent(foot), walk.moments[f"{stem}_{side}"], side)
        axes.set_xlim(0, 100)
    for k, directions in enumerate(((1,), (0, 2))):
        axes = figure.add_subplot(cells[2, 1 + k])
        dress(axes, title=("Vertical ground reaction", "Horizontal ground reaction")[k], ylabel="body weights")
        for direction in directions:
            for foot, side in enumerate(SIDES):
                inward = -1.0 if direction == 2 and side == "r" else 1.0  # both sides alike: towards the other foot
                values = inward * walk.force[:, foot, direction]
                _curve(axes, walk.percent(foot), values, side, width=0.8 if direction == 2 else 1.6)
        axes.set_xlim(0, 100)
        if len(directions) > 1:
            write(axes, 99, axes.get_ylim()[1] * 0.95, "thick: forward\nthin: inward", ha="right", va="top")
    _soles(figure.add_subplot(cells[3, :]), walk)
    handles: list[Line2D | Patch] = [
        Line2D([], [], color=SIDE_COLOURS[s], ls=line_style(SIDE_DASHES[s]), label=SIDE_WORDS[s]) for s in SIDES
    ]
    handles += [
        Patch(color=FAINT, alpha=alpha, label=f"normal, mean ± {n} SD", lw=0) for n, alpha in ((1, 0.34), (2, 0.16))
    ]
    figure.legend(handles=handles, loc="upper right", ncols=4, frameon=False, prop={"family": FONT, "size": NORMAL})
    figure.text(0.012, 0.978, "The built-in person's walk", family=FONT, fontsize=TITLE + 2, fontweight="bold")
    figure.text(
        0.012, 0.012, f"Over each leg's stride (%). Moments are internal. {SOURCES}", family=FONT, fontsize=NORMAL - 1
    )
    return figure


def _band(axes: Axes, band: pd.DataFrame) -> None:
    for width, alpha in ((2.0, 0.16), (1.0, 0.2)):
        low, high = (band["mean"] + sign * width * band["sd"] for sign in (-1.0, 1.0))
        axes.fill_between(band["percent"], low, high, color=FAINT, alpha=alpha, linewidth=0)


def _peak_band(axes: Axes, mean: float, sd: float) -> None:
    """A peak whose time is not published: over single support, in which it is."""
    for width, alpha in ((2.0, 0.16), (1.0, 0.2)):
        axes.fill_between((12, 50), mean - width * sd, mean + width * sd, color=FAINT, alpha=alpha, linewidth=0)
    write(axes, 52, mean, "peak of adults", va="center")


def _curve(axes: Axes, percent: Array, values: Array, side: str, width: float = 1.6) -> None:
    """A curve over the stride, one line for each: they begin where the percent falls."""
    for stride in np.split(np.arange(len(percent)), np.flatnonzero(np.diff(percent) < 0) + 1):
        axes.plot(percent[stride], values[stride], color=SIDE_COLOURS[side], ls=line_style(SIDE_DASHES[side]), lw=width)


def _soles(axes: Axes, walk: Walk) -> None:
    """From above: the sole of every step in the middle of its stance, and the way of the centre of pressure."""
    dress(axes, title="Centres of pressure in the soles, from above", xlabel="forward (m)", ylabel="right (m)")
    for foot, side in enumerate(SIDES):
        frames = np.flatnonzero(walk.loaded[:, foot])
        for step in np.split(frames, np.flatnonzero(np.diff(frames) > 1) + 1):
            outline = _outline(walk.feet, foot, int(step[np.argmin(walk.feet.toe_speed[step, foot])]))
            axes.fill(*outline.T, facecolor=SIDE_COLOURS[side], alpha=0.12, linewidth=0)
            axes.plot(*outline.T, color=SIDE_COLOURS[side], linewidth=0.8)
            x, z = walk.centre[step, foot][:, [0, 2]].T
            away = outside_sole(walk, foot)[step] > 0
            axes.plot(x, z, color=SIDE_COLOURS[side], linewidth=0.7)
            axes.scatter(x[~away], z[~away], s=5, color=SIDE_COLOURS[side], linewidth=0)
            axes.scatter(x[away], z[away], s=9, marker="x", color="#c00000", linewidth=0.7)
    axes.set_aspect("equal", adjustable="datalim")
    axes.invert_yaxis()


def _outline(feet: FootPoints, foot: int, frame: int) -> Array:
    """(n, 2) m, forward and right: the edge of a sole."""
    heel, tip = (p[frame, foot][[0, 2]] for p in (feet.heel, feet.tip))
    forward = (tip - heel) / np.linalg.norm(tip - heel)
    aside = np.array([-forward[1], forward[0]])
    part = np.linspace(0.0, 1.0, 40)
    middle = heel + np.outer(HEEL_M + part * (np.linalg.norm(tip - heel) - HEEL_M), forward)
    half = np.outer(feet.width * np.interp(part, *SHAPE) / 2, aside)
    return np.vstack([middle + half, (middle - half)[::-1], middle[:1] + half[:1]])
