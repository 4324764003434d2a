"""Figures of a fit: marker errors before and after, beside the floor of rigid segments; how far joint parameters and
joint moments moved; ground reactions, and what they leave unexplained at the pelvis.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.figures import chart
from gaitcal.gait.strides import thinned
from gaitcal.io.recording import runs
from gaitcal.model.coordinates import coordinate_words, split_side
from gaitcal.session.parameter_words import Group, Row
from gaitcal.session.trial_result import RmsErrors

if TYPE_CHECKING:
    from matplotlib.axes import Axes

KEYS = (
    chart.Key(label="nominal model", colour=chart.NOMINAL, kind="ring"),
    chart.Key(label="calibrated model", colour=chart.WHOLE, kind="dot"),
    chart.Key(label="rigid-segment floor", colour=chart.INK, kind="tick"),
)
ROW, LEFT = 0.19, 1.42
WIDTH = 3.6


@dataclass(frozen=True)
class FitSummary:
    """Marker errors of one trial."""

    overall: RmsErrors
    isolated: bool  # Whether it shows one joint alone, whose segments are not told
    legs: tuple[RmsErrors, ...]  # Segments of pelvis and legs that have markers
    rest: tuple[RmsErrors, ...]
    """Those of trunk and arms: on a scale of their own, which would squeeze the errors of legs to nothing."""


def fit_chart(trials: Sequence[FitSummary]) -> chart.Chart | None:
    """All trials, then the segments of each whole-body trial; None without any trial."""
    if not trials:
        return None
    panels = []
    if len(trials) > 1 or trials[0].isolated:
        panels.append(_panel([t.overall for t in trials], "RMS marker error of each trial", "All trials"))
    for trial in trials:
        for title, fits in (("Pelvis and legs", trial.legs), ("Trunk and arms", trial.rest)):
            if fits and not trial.isolated:
                words = f"RMS marker error of each segment, {title.lower()}"
                panels.append(_panel(list(fits), words, f"{title}, {chart.plain(trial.overall.label, 12)}"))
    return chart.Chart(
        name="marker_errors",
        title="Marker errors before and after calibration",
        panels=tuple(panels),
        keys=KEYS,
        columns=2,
    )


def _panel(fits: list[RmsErrors], label: str, title: str) -> chart.Panel:
    shown = [chart.plain(fit.label, 24) for fit in fits]
    size = chart.Size(width=WIDTH, height=0.66 + ROW * max(len(fits), 2), left=LEFT, right=0.12, bottom=0.38, top=0.26)

    def draw(axes: "Axes") -> None:
        chart.dress(axes, xlabel="RMS marker error (mm)", title=title)
        for row, fit in enumerate(fits):
            if fit.nominal is not None and fit.calibrated is not None:
                axes.plot([fit.nominal, fit.calibrated], [row, row], color="#c8c8c8", linewidth=2.2, zorder=1)
            if fit.floor is not None:
                axes.plot([fit.floor], [row], "|", color=chart.INK, markersize=9, markeredgewidth=1.4, zorder=2)
            if fit.nominal is not None:
                axes.plot(
                    [fit.nominal], [row], "o", color=chart.NOMINAL, markerfacecolor="white", markersize=5, zorder=3
                )
            if fit.calibrated is not None:
                axes.plot([fit.calibrated], [row], "o", color=chart.WHOLE, markersize=5.4, zorder=4)
        chart.dress_rows(axes, shown, least=2)
        axes.set_xlim(left=0.0)
        axes.spines["left"].set_visible(False)

    return chart.Panel(label, draw, size)


PARAMETERS_ROW = 0.2
OFFSET = {"r": -0.16, "l": 0.16, "": 0.0}  # Of the right and the left side of one row, in rows


def parameters_chart(groups: tuple[Group, ...], truth: Mapping[str, float] | None = None) -> chart.Chart | None:
    """Changes of positions (mm) and orientations (deg); None where no joint parameter was fitted.

    `truth`: parameter -> true value in the unit of the rows, where it is known.
    """
    known = truth or {}
    panels = [
        panel
        for title, unit in (("Positions", "mm"), ("Orientations", "deg"))
        if (panel := _parameters_panel(groups, title, unit, known)) is not None
    ]
    if not panels:
        return None
    middle = any(g.right and g.right[0].part == "back" for g in groups)
    shown = {"r": "right", "l": "left"} | ({"": "trunk"} if middle else {})
    return chart.Chart(
        name="joint_parameters",
        title="How far each joint parameter moved",
        panels=tuple(panels),
        keys=(
            *(chart.Key(label=label, colour=chart.SIDE_COLOURS[side], kind="dot") for side, label in shown.items()),
            *((chart.Key(label=chart.TRUTH_WORDS, colour=chart.INK, kind="ring"),) if known else ()),
        ),
        columns=2,
    )


def _parameters_panel(
    groups: tuple[Group, ...], title: str, unit: str, truth: Mapping[str, float]
) -> chart.Panel | None:
    rows: dict[str, list[Row]] = {}
    for group in groups:
        for row in (*group.right, *group.left):
            if row.unit == unit and row.status in ("fitted", "at bound"):
                rows.setdefault(row.words, []).append(row)
    if not rows:
        return None
    size = chart.Size(width=3.6, height=0.66 + PARAMETERS_ROW * len(rows), left=1.98, right=0.12, bottom=0.38, top=0.26)

    def draw(axes: "Axes") -> None:
        chart.dress(axes, xlabel=f"change ({unit})", title=title)
        axes.axvline(0.0, color=chart.FAINT, linewidth=0.8)
        for line, sides in enumerate(rows.values()):
            for row in sides:
                y, colour, error = line + OFFSET[row.side], chart.SIDE_COLOURS[row.side], row.error or 0.0
                axes.plot([row.change - error, row.change + error], [y, y], color=colour, linewidth=1.2)
                axes.plot([row.change], [y], "o", color=colour, markersize=3.6)
                if row.name in truth:
                    at = truth[row.name] - row.nominal
                    axes.plot([at], [y], "o", color=colour, markerfacecolor="none", markersize=5.6, markeredgewidth=0.9)
        chart.dress_rows(axes, [words.replace(" in the ", ", ") for words in rows], labelsize=chart.SMALL)

    return chart.Panel(f"{title} of joints: change by calibration, right and left, {unit}", draw, size)


BAR, CHANGE_ROW = 0.36, 0.27


def moment_change_chart(changes: Mapping[str, float], stem: str) -> chart.Chart:
    """A pair of bars for each joint moment; `changes`: coordinate -> % of body weight times height."""
    bases = list(dict.fromkeys(split_side(name)[0] for name in changes))
    size = chart.Size(width=4.4, height=0.7 + CHANGE_ROW * len(bases), left=1.32, right=0.15, bottom=0.38, top=0.26)

    def draw(axes: "Axes") -> None:
        chart.dress(axes, xlabel="RMS change (% of body weight × height)", title="Nominal to calibrated")
        for row, base in enumerate(bases):
            sides = [name for name in changes if split_side(name)[0] == base]
            offsets = np.linspace(-BAR / 2, BAR / 2, len(sides)) if len(sides) > 1 else np.zeros(1)
            for name, offset in zip(sides, offsets, strict=True):
                colour = chart.SIDE_COLOURS[split_side(name)[1]]
                axes.barh(row + offset, changes[name], height=BAR * 0.92, color=colour)
        chart.dress_rows(axes, [coordinate_words(base).title for base in bases])
        axes.set_xlim(left=0.0)

    return chart.Chart(
        name=f"{stem}_moment_change",
        title="Change of the joint moments",
        panels=(
            chart.Panel(
                "RMS change of each joint moment, right and left, percent of body weight times height", draw, size
            ),
        ),
        keys=tuple(
            chart.Key(label=label, colour=chart.SIDE_COLOURS[side], width=4.5)
            for side, label in (("r", "right"), ("l", "left"), ("", "trunk"))
            if any(split_side(name)[1] == side for name in changes)
        ),
        columns=1,
    )


UPWARD = 1
AXES = (("Vertical", "up", UPWARD), ("Fore-aft", "forward", 0), ("Sideways", "to the right", 2))
INVALID = "#f7e3c4"
INVALID_KEY = chart.Key(label="whole body not valid", colour=INVALID, kind="area")
LEG_KEY = chart.Key(label="moments of a leg not valid: right above, left below", colour=INVALID, kind="area")
LIMIT_KEY = chart.Key(label="asked of simulations", colour=chart.INK, dashes=(2.0, 2.0), width=1.0)
LEAST = 0.5  # Smallest range of a vertical axis, N/kg


def forces_chart(time: Array, force: Array, valid_legs: BoolArray, stem: str) -> chart.Chart:
    """Three components over time, right and left foot.

    `time`: (nf,) s.
    `force`: (nf, 2, 3) N/kg, right and left foot: forward, up, to the right.
    `valid_legs`: (nf, 2) torques of the right and the left leg may be used.
    """

    def panel(title: str, word: str, axis: int) -> chart.Panel:
        def draw(axes: "Axes") -> None:
            chart.dress(axes, xlabel="time (s)", ylabel=f"N/kg ({word} +)", title=title)
            for leg, part in ((0, (0.5, 1.0)), (1, (0.0, 0.5))):
                _shade_invalid(axes, time, valid_legs[:, leg], part)
            axes.axhline(0.0, color=chart.FAINT, linewidth=0.5)
            for k, side in enumerate(("r", "l")):
                x, y = thinned(time, np.where(force[:, k, UPWARD] == 0.0, np.nan, force[:, k, axis]))
                axes.plot(
                    x,
                    y,
                    color=chart.SIDE_COLOURS[side],
                    linestyle=chart.line_style(chart.SIDE_DASHES[side]),
                    linewidth=1.4,
                )
            axes.set_xlim(float(time[0]), float(time[-1]))
            axes.set_ylim(*chart.limits([force[:, :, axis], np.zeros(1)], LEAST))

        return chart.Panel(f"{title} ground reaction force on right and left foot, N/kg over time", draw)

    return chart.Chart(
        name=f"{stem}_ground_reactions",
        title="Ground reaction forces",
        panels=tuple(panel(*of) for of in AXES),
        keys=(*chart.SIDE_KEYS, LEG_KEY),
    )


def _shade_invalid(axes: "Axes", time: Array, valid: BoolArray, part: tuple[float, float] = (0.0, 1.0)) -> None:
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


SIZE = chart.Size(width=3.6, height=2.1)
MOST = 0.98  # Share of the frames that the vertical axis is made for; a spike at a trial's end would hide all others


def residuals_chart(
    time: Array,
    valid: BoolArray,
    stages: Sequence[tuple[str, Array, Array]],
    limit: tuple[float, float] | None,
    stem: str,
) -> chart.Chart:
    """Magnitude of residual force and moment; the first step grey, the last one in colour.

    `time`: (nf,) s.
    `valid`: (nf,) torques of the whole body may be used, in one frame at least.
    `stages`: from the nominal model to the last one: its name, N and N·m (nf,), magnitudes.
    `limit`: N and N·m, what is commonly asked for; None: not known.
    """
    colours = [chart.NOMINAL, *([chart.STEP] * (len(stages) - 2)), chart.WHOLE][-len(stages) :]
    widths = [0.9, *([0.9] * (len(stages) - 2)), 1.6][-len(stages) :]
    bounds = limit or (None, None)

    def panel(title: str, unit: str, values: list[Array], bound: float | None) -> chart.Panel:
        def draw(axes: "Axes") -> None:
            chart.dress(axes, xlabel="time (s)", ylabel=unit, title=title)
            _shade_invalid(axes, time, valid)
            for value, colour, width in zip(values, colours, widths, strict=True):
                x, y = thinned(time, np.where(valid, value, np.nan))
                axes.plot(x, y, color=colour, linewidth=width)
            if bound is not None:
                axes.axhline(bound, color=chart.INK, linewidth=1.0, linestyle=(0, (2, 2)))
            axes.set_xlim(float(time[0]), float(time[-1]))
            highest = max(float(v[valid].max()) for v in values)
            typical = max(float(np.quantile(v[valid], MOST)) for v in values)
            top = 1.12 * max(bound or 0.0, highest if highest < 1.5 * typical else 1.25 * typical)
            axes.set_ylim(0.0, top)
            last = np.where(valid, values[-1], -1.0)
            if last.max() > top:
                beyond = f"peak {last.max():.0f} {unit} at {time[last.argmax()]:.2f} s, not drawn"
                chart.write(axes, 0.5, 0.93, beyond, transform=axes.transAxes, ha="center")

        return chart.Panel(f"{title} in {unit} over time, with its limit", draw, SIZE)

    return chart.Chart(
        name=f"{stem}_pelvis_residuals",
        title="Pelvis residuals",
        panels=(
            panel("Residual force", "N", [s[1] for s in stages], bounds[0]),
            panel("Residual moment", "N·m", [s[2] for s in stages], bounds[1]),
        ),
        keys=(
            *(chart.Key(label=s[0], colour=c, width=w) for s, c, w in zip(stages, colours, widths, strict=True)),
            *((LIMIT_KEY,) if limit else ()),
            INVALID_KEY,
        ),
        columns=2,
    )
