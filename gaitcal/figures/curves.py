"""Joint angles and joint moments over the gait cycle or over time, right and left, calibrated and nominal."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum
from typing import TYPE_CHECKING

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.figures import chart
from gaitcal.gait import moments, strides
from gaitcal.model.coordinates import coordinate_words, split_side

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LEAST_ANGLE, LEAST_MOMENT, LEAST_POWER = 10.0, 0.2, 0.5
"""Smallest range of a vertical axis (deg, N·m/kg, W/kg), so that nothing small looks dramatic."""
TRUTH_WIDTH = 1.1


@dataclass(frozen=True)
class Trace:
    """One side of one variable over all frames of the trial, (nf,) each."""

    base: str
    side: str
    kind: str
    value: Array
    valid: BoolArray
    error: Array | None
    nominal: Array | None
    truth: Array | None

    @property
    def name(self) -> str:
        """`hip_flexion_r`."""
        return f"{self.base}_{self.side}" if self.side else self.base

    def scaled(self, factor: float) -> "Trace":
        """As it is drawn, with gaps where values do not count; the truth is drawn there, too."""
        error, nominal, truth = (None if x is None else factor * x for x in (self.error, self.nominal, self.truth))
        value = np.where(self.valid, factor * self.value, np.nan)
        nominal = None if nominal is None else np.where(self.valid, nominal, np.nan)
        return replace(self, value=value, error=error, nominal=nominal, truth=truth)


NORMAL_COLOUR = "#CC79A7"
"""Okabe and Ito's purple, with dotted edges: the stance is grey."""
NORMAL_KEY = chart.Key(label="normal band (mean ±1 SD, dotted edges)", colour=NORMAL_COLOUR, kind="band")
NOMINAL_KEY = chart.Key(label="nominal model", colour=chart.NOMINAL, width=0.9)
BAND_KEY = chart.Key(label="±1 standard error", colour=chart.SIDE_COLOURS["r"], kind="band")


def _keys(middle: str, curves: "Curves") -> tuple[chart.Key, ...]:
    """The legend; `middle` says what the curves without a side are of."""
    traces = curves.traces.values()
    known = (
        chart.Key(label=chart.TRUTH_WORDS, colour=chart.INK, dashes=chart.TRUTH_DASHES["r"], width=TRUTH_WIDTH),
        chart.Key(label="truth, left", colour=chart.INK, dashes=chart.TRUTH_DASHES["l"], width=TRUTH_WIDTH),
    )
    return (
        *chart.SIDE_KEYS,
        chart.Key(label=middle, colour=chart.SIDE_COLOURS[""]),
        *((BAND_KEY,) if any(trace.error is not None for trace in traces) else ()),
        *((NORMAL_KEY,) if curves.bands else ()),
        *((NOMINAL_KEY,) if any(trace.nominal is not None for trace in traces) else ()),
        *(known if curves.truth else ()),
        chart.Key(label="stance (toe-off: thin line)", colour=chart.STANCE_KEY, kind="area"),
    )


@dataclass(frozen=True, kw_only=True)
class Curves:
    """What is drawn of one trial in one kind of chart."""

    layout: strides.Layout
    traces: Mapping[str, Trace]
    """Coordinate (`hip_flexion_r`) or joint of a power (`hip_r`) -> its curve, in deg, N·m/kg or W/kg."""
    normal: Mapping[str, tuple[Array, Array]]
    """Coordinate or joint, without a side -> mean and SD (101,) of healthy people, in the same unit."""

    @property
    def truth(self) -> bool:
        """Whether the truth of any of them is known."""
        return any(trace.truth is not None for trace in self.traces.values())

    @property
    def bands(self) -> Mapping[str, tuple[Array, Array]]:
        """Of healthy people, where the horizontal axis is one that they have."""
        return self.normal if self.layout.by_cycle else {}


class CurveKind(Enum):
    """What a chart is of: end of its name, title, unit, least range of the axis, and what the middle curves are of."""

    ANGLE = ("angles", "Joint angles", "deg", LEAST_ANGLE, "pelvis and trunk")
    MOMENT = ("moments", "Joint moments", "N·m/kg", LEAST_MOMENT, "trunk")
    POWER = ("powers", "Joint powers", "W/kg", LEAST_POWER, "trunk")

    def positive(self, base: str) -> str:
        """Word for values of a coordinate above zero."""
        words = coordinate_words(base)
        return {CurveKind.ANGLE: words.angle, CurveKind.MOMENT: words.moment}.get(self, "generated")


def curve_chart(curves: Curves, kind: CurveKind, stem: str) -> chart.Chart:
    """One panel a coordinate, right and left together; frames that are not valid stay empty."""
    ending, title, unit, least, middle = kind.value
    sides: dict[str, list[Trace]] = {}
    for name, trace in curves.traces.items():
        sides.setdefault(split_side(name)[0], []).append(trace)
    panels = tuple(
        _panel(
            moments.capitalised(coordinate_words(base).title),
            unit,
            kind.positive(base),
            traces,
            curves.layout,
            least,
            curves.bands.get(base),
        )
        for base, traces in sides.items()
    )
    return chart.Chart(name=f"{stem}_{ending}", title=title, panels=panels, keys=_keys(middle, curves))


def normal_band(axes: "Axes", mean: Array, sd: Array) -> tuple[Array, Array]:
    """Draw healthy people's mean +- SD (101,) with dotted edges, and return the edges."""
    percent, ends = np.arange(float(len(mean))), (mean - sd, mean + sd)
    axes.fill_between(percent, *ends, color=NORMAL_COLOUR, alpha=0.25, linewidth=0)
    for edge in ends:
        axes.plot(percent, edge, color=NORMAL_COLOUR, linewidth=0.8, linestyle=":")
    return ends


def _panel(
    title: str,
    unit: str,
    positive: str,
    traces: list[Trace],
    layout: strides.Layout,
    least: float,
    normal: tuple[Array, Array] | None,
) -> chart.Panel:
    def draw(axes: "Axes") -> None:
        chart.dress(axes, xlabel=layout.xlabel, ylabel=f"{unit} ({positive} +)", title=title)
        axes.axhline(0.0, color=chart.FAINT, linewidth=0.5)
        drawn: list[Array] = []
        for trace in traces:
            if layout.has(trace.side):
                _stance(axes, layout, trace.side)
        if normal is not None:
            drawn += normal_band(axes, *normal)
        for trace in traces:
            if layout.has(trace.side):
                drawn += _trace(axes, layout, trace)
        axes.set_xlim(*layout.xlimits)
        axes.set_ylim(*chart.limits(drawn, least))
        if layout.by_cycle:
            axes.set_xticks([0, 20, 40, 60, 80, 100])
        if not any(np.isfinite(d).any() for d in drawn):
            axes.text(0.5, 0.5, "no valid frames", transform=axes.transAxes, ha="center", fontsize=7, color=chart.FAINT)

    sides = " and ".join(moments.SIDE_WORDS[t.side] or "whole body" for t in traces)
    return chart.Panel(f"{title}, {sides}, {unit} over {layout.xlabel}", draw)


def _trace(axes: "Axes", layout: strides.Layout, trace: Trace) -> list[Array]:
    """Draw one side; the values that the vertical axis must hold."""
    colour, dashes = chart.SIDE_COLOURS[trace.side], chart.line_style(chart.SIDE_DASHES[trace.side])
    for x, y in layout.others(trace.side, trace.value):
        axes.plot(x, y, color=colour, linewidth=0.6, alpha=0.35)
    x, y = layout.lay(trace.side, trace.value)
    drawn = [y]
    if trace.nominal is not None:
        x, nominal = layout.lay(trace.side, trace.nominal)
        axes.plot(x, nominal, color=chart.NOMINAL, linewidth=0.9, linestyle=dashes)
        drawn.append(nominal)
    if trace.error is not None:
        spread = layout.lay(trace.side, trace.error)[1]
        axes.fill_between(x, y - spread, y + spread, color=colour, alpha=0.25, linewidth=0)
        drawn += [y - spread, y + spread]
    axes.plot(x, y, color=colour, linewidth=1.5, linestyle=dashes)
    if trace.truth is not None:
        x, true = layout.lay(trace.side, trace.truth)
        axes.plot(
            x, true, color=chart.INK, linewidth=TRUTH_WIDTH, linestyle=chart.line_style(chart.TRUTH_DASHES[trace.side])
        )
        drawn.append(true)
    return drawn


def _stance(axes: "Axes", layout: strides.Layout, side: str) -> None:
    for start, stop in layout.stances(side):
        axes.axvspan(start, stop, color=chart.STANCE, alpha=chart.STANCE_ALPHA, linewidth=0)
        if layout.by_cycle and side:
            axes.axvline(
                stop, color=chart.SIDE_COLOURS[side], linewidth=0.7, linestyle=chart.line_style(chart.SIDE_DASHES[side])
            )
