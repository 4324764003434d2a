"""Ground reaction forces on each foot, as part of body weight."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from gaitcal.dynamics.ground_contact import GroundReactions
from gaitcal.report.figures.chart import Chart, Panel
from gaitcal.report.figures.style import FAINT, SIDE_COLOURS, SIDE_DASHES, Key, dress, limits, line_style
from gaitcal.report.gait_cycle import resample, runs
from gaitcal.report.strides import MOST_POINTS
from gaitcal.study.result import Calibration, LoadedTrial, TrialResult

Array = NDArray[np.float64]

AXES = (("Vertical", "up", 1), ("Fore-aft", "forward", 0), ("Sideways", "to the right", 2))
INVALID = "#f7e3c4"
INVALID_KEY = Key("moments not valid", INVALID, kind="area")
LEAST = 5.0
"""Smallest range of a vertical axis, % of body weight."""


def forces_chart(calibration: Calibration, trial: TrialResult, loads: LoadedTrial, stem: str) -> Chart:
    """Three components over time, right and left foot."""
    force = 100.0 * loads.reactions.wrench[:, :, :3] / calibration.model.subject.weight
    panels = tuple(_panel(title, word, trial.body.time, force[:, :, k], loads.reactions) for title, word, k in AXES)
    return Chart(
        f"{stem}_ground_reactions",
        "Ground reaction forces",
        "Force of the ground on each foot, in percent of body weight. In calm walking each step has two vertical peaks "
        "of about 110 %.",
        panels,
        (
            Key("right", SIDE_COLOURS["r"], SIDE_DASHES["r"]),
            Key("left", SIDE_COLOURS["l"], SIDE_DASHES["l"]),
            INVALID_KEY,
        ),
        subject=trial.name,
    )


def shade_invalid(axes: Axes, time: Array, valid: NDArray[np.bool_]) -> None:
    """Tint the stretches in which torques are not known."""
    for run in runs(~valid):
        axes.axvspan(
            float(time[max(run.start - 1, 0)]),
            float(time[min(run.stop, len(time) - 1)]),
            color=INVALID,
            linewidth=0,
            zorder=0,
        )


def thinned(time: Array, values: Array) -> tuple[Array, Array]:
    """At most `MOST_POINTS` samples."""
    if len(time) <= MOST_POINTS:
        return time, values
    at = np.linspace(time[0], time[-1], MOST_POINTS)
    return at, resample(time, values, at)


def _panel(title: str, word: str, time: Array, force: Array, reactions: GroundReactions) -> Panel:
    def draw(axes: Axes) -> None:
        dress(axes, xlabel="time (s)", ylabel=f"% body weight ({word} +)", title=title)
        shade_invalid(axes, time, reactions.valid)
        axes.axhline(0.0, color=FAINT, linewidth=0.5)
        for k, side in enumerate(("r", "l")):
            x, y = thinned(time, np.where(reactions.wrench[:, k, 1] == 0.0, np.nan, force[:, k]))
            axes.plot(x, y, color=SIDE_COLOURS[side], linestyle=line_style(SIDE_DASHES[side]), linewidth=1.4)
        axes.set_xlim(float(time[0]), float(time[-1]))
        axes.set_ylim(*limits([force, np.zeros(1)], LEAST))

    return Panel(f"{title} ground reaction force on right and left foot, percent of body weight over time", draw)
