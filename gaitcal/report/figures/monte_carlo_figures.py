"""Figures of a Monte Carlo study: the published figures 3 and 4, and contributions of parameters.

Boxes as published: 25, 50 and 75 %, whiskers 10 and 90 %, a dot for the average. Colours are those
of Okabe and Ito.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from gaitcal.gait.moments import SIDE_WORDS
from gaitcal.io.atomic import write_atomically
from gaitcal.montecarlo import draw, draw_statistics
from gaitcal.montecarlo.protocol import ReactionFrame, Varied
from gaitcal.report.figures.chart import GRID, INK, create_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SET_COLOURS = {
    Varied.JP: "#0072B2",
    Varied.IP: "#E69F00",
    Varied.BOTH: "#009E73",
    Varied.NOISE: "#CC79A7",
}
SET_WORDS = {
    Varied.JP: "joint parameters (JP)",
    Varied.IP: "inertial parameters (IP)",
    Varied.BOTH: "JP and IP",
    Varied.NOISE: "marker noise (NP)",
}
FRAME_WORDS = {
    ReactionFrame.LAB: "ground reactions fixed in the laboratory",
    ReactionFrame.FOOT: "ground reactions carried with the foot",
}
MEASURE_WORDS = {"rms": "RMS error", "mean": "Mean (signed) error"}
SMALL, NORMAL = 7.0, 8.0
DPI = 150
SHOWN_SHARE = (
    1.0  # Per cent of a torque's variance from which a contribution is written into its cell
)


def draw_boxplots(
    table: pd.DataFrame, frame: ReactionFrame, measure: str = "rms", side: str = "l"
) -> "Figure":
    """Draw torque errors and marker distances of one leg over the levels.

    Columns are the varied sets, rows the quantities. `table`: from `statistics`; `measure`: `rms`
    (figure 3) or `mean` (figure 4).
    """
    sets = [varied for varied in Varied if (table["set"] == varied.value).any()]
    quantities = [
        *((f"{torque}_{side}", frame) for torque in draw.TORQUES),
        (f"markers_{side}", None),
    ]
    width, height = 1.25 + 1.75 * len(sets), 1.3 + 1.25 * len(quantities)
    figure = create_figure(width, height, DPI)
    axes = figure.subplots(len(quantities), len(sets), sharex="col", sharey="row", squeeze=False)
    figure.subplots_adjust(
        left=1.05 / width,
        right=1 - 0.1 / width,
        bottom=0.5 / height,
        top=1 - 0.8 / height,
        hspace=0.16,
        wspace=0.06,
    )
    for row, (quantity, reactions) in enumerate(quantities):
        for column, varied in enumerate(sets):
            _draw_boxes(
                axes[row, column],
                draw_statistics.select_levels(table, varied, quantity, reactions, measure),
                SET_COLOURS[varied],
            )
        _scale(axes[row], measure)
        title = draw.TORQUE_LABELS.get(quantity[:-2])
        unit = "marker\ndistance, mm" if title is None else title.replace(" ", "\n", 1) + ",\n%BW·H"
        axes[row, 0].set_ylabel(unit, fontsize=NORMAL, color=INK)
        axes[row, 0].yaxis.set_label_coords(-0.55 / 1.65, 0.5)
    for column, varied in enumerate(sets):
        axes[0, column].set_title(SET_WORDS[varied], fontsize=NORMAL, color=INK, fontweight="bold")
        axes[-1, column].set_xlabel("level, % of bounds", fontsize=NORMAL, color=INK)
    figure.suptitle(
        f"{MEASURE_WORDS[measure]}, {SIDE_WORDS[side]} leg; {FRAME_WORDS[frame]}\n"
        "boxes 25, 50, 75 %; whiskers 10 and 90 %; dots: average",
        fontsize=NORMAL + 1,
        color=INK,
        y=1 - 0.12 / height,
    )
    return figure


def _draw_boxes(axes: "Axes", rows: pd.DataFrame, colour: str) -> None:
    places = np.arange(1, len(rows) + 1)
    boxes = [
        {
            "whislo": r.p10,
            "q1": r.p25,
            "med": r.p50,
            "q3": r.p75,
            "whishi": r.p90,
            "mean": r.average,
            "fliers": [],
        }
        for r in rows.itertuples()
    ]
    axes.bxp(
        boxes,
        positions=places,
        widths=0.55,
        showfliers=False,
        showmeans=True,
        patch_artist=True,
        boxprops={"facecolor": colour, "alpha": 0.45, "edgecolor": colour, "linewidth": 0.9},
        medianprops={"color": INK, "linewidth": 1.1},
        meanprops={
            "marker": "o",
            "markersize": 2.6,
            "markerfacecolor": INK,
            "markeredgecolor": "none",
        },
        whiskerprops={"color": colour, "linewidth": 0.9},
        capprops={"color": colour, "linewidth": 0.9},
    )
    axes.set_xticks(places, [f"{level:g}" for level in rows["level"]])
    axes.tick_params(labelsize=SMALL, colors=INK, length=2.5, width=0.6)
    axes.grid(axis="y", color=GRID, linewidth=0.6)
    axes.set_axisbelow(True)
    for edge in ("top", "right"):
        axes.spines[edge].set_visible(False)


def _scale(row: np.ndarray, measure: str) -> None:
    """Scale the axes of a row: distances begin at zero, signed errors have a zero line."""
    from matplotlib.ticker import MaxNLocator

    for axes in row:
        axes.yaxis.set_major_locator(MaxNLocator(4))
    if measure == "rms":
        row[0].set_ylim(bottom=0.0)
        return
    for axes in row:
        axes.axhline(0.0, color=INK, linewidth=0.5)


def draw_contributions(contributions: pd.DataFrame, side: str = "l") -> "Figure":
    """Draw the share of every parameter in the variance of the seven torques of a leg.

    Parameters of the other leg, of the rest of the body and inertial ones share one row each.
    """
    panels = {frame: _collect_shares(contributions, frame, side) for frame in ReactionFrame}
    rows = list(next(iter(panels.values())).index)
    width, height = 9.2, 1.5 + 0.2 * len(rows)
    figure = create_figure(width, height, DPI)
    axes = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    figure.subplots_adjust(
        left=1.75 / width, right=0.91, bottom=0.85 / height, top=1 - 0.6 / height, wspace=0.04
    )
    for panel, (frame, shares) in zip(axes, panels.items(), strict=True):
        values = shares.to_numpy()
        image = panel.imshow(
            np.sqrt(values), cmap="Blues", vmin=0.0, vmax=np.sqrt(60.0), aspect="auto"
        )
        for (i, j), value in np.ndenumerate(values):
            if value >= SHOWN_SHARE:
                ink = "white" if value > 25.0 else INK
                panel.text(
                    j, i, f"{value:.0f}", ha="center", va="center", fontsize=SMALL, color=ink
                )
        titles = [draw.TORQUE_LABELS[t].replace(" ", "\n") for t in draw.TORQUES]
        panel.set_xticks(range(len(draw.TORQUES)), titles, fontsize=SMALL, rotation=90)
        panel.set_title(FRAME_WORDS[frame], fontsize=NORMAL, color=INK)
        panel.tick_params(length=0)
        panel.set_frame_on(False)
    axes[0].set_yticks(range(len(rows)), rows, fontsize=SMALL)
    bar_axes = figure.add_axes((0.925, 0.3, 0.016, 0.4))
    bar = figure.colorbar(image, cax=bar_axes, ticks=np.sqrt([0, 1, 5, 10, 25, 50]))
    bar.ax.set_yticklabels(["0", "1", "5", "10", "25", "50"], fontsize=SMALL)
    bar.set_label("% of the variance of the torque error", fontsize=NORMAL)
    figure.suptitle(
        f"Which parameter matters, {SIDE_WORDS[side]} leg: share of the variance of each torque, "
        "linearised",
        fontsize=NORMAL + 1,
        color=INK,
        y=1 - 0.12 / height,
    )
    return figure


def _collect_shares(contributions: pd.DataFrame, frame: ReactionFrame, side: str) -> pd.DataFrame:
    """Collect `variance_shares` in one table, with parameters as `hip: pelvis ant`."""
    of_leg, groups = draw_statistics.compute_variance_shares(contributions, frame, side)
    return pd.concat(
        [of_leg.rename(index=lambda n: n.replace(f"_{side}.", ": ").replace(".", " ")), groups]
    )


def write_monte_carlo_figures(
    table: pd.DataFrame, contributions: pd.DataFrame | None, folder: Path | str, side: str = "l"
) -> Mapping[str, Path]:
    """Write figures 3 (RMS) and 4 (mean) for both reaction frames, and contributions.

    Parameters
    ----------
    table
        From `statistics`.
    contributions
        From `variance_contributions`; None: no such figure.
    folder
        Output folder.
    side
        `r` or `l`.

    Returns
    -------
    dict
        Name -> path of the PNG; there is also an SVG.
    """
    figures = {
        f"figure_{number}_{frame.value}": (frame, measure)
        for number, measure in ((3, "rms"), (4, "mean"))
        for frame in ReactionFrame
    }
    out = {}
    for name, (frame, measure) in figures.items():
        out[name] = _write(draw_boxplots(table, frame, measure, side), Path(folder) / name)
    if contributions is not None:
        out["contributions"] = _write(
            draw_contributions(contributions, side), Path(folder) / "contributions"
        )
    return out


def _write(figure: "Figure", stem: Path) -> Path:
    for suffix in ("svg", "png"):
        with write_atomically(stem.with_suffix(f".{suffix}")) as path:
            figure.savefig(path, metadata={"Date": None} if suffix == "svg" else None)
    return stem.with_suffix(".png")
