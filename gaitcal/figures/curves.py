"""Joint angles and joint moments over the gait cycle or over time, right and left, calibrated and nominal."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from gaitcal.arrays import Array
from gaitcal.figures.chart import Chart, Panel
from gaitcal.figures.style import (
    FAINT,
    INK,
    NOMINAL,
    SIDE_COLOURS,
    SIDE_DASHES,
    SIDE_KEYS,
    STANCE,
    STANCE_ALPHA,
    STANCE_KEY,
    TRUTH_DASHES,
    TRUTH_WORDS,
    Key,
    dress,
    limits,
    line_style,
)
from gaitcal.gait.cycles import POINTS
from gaitcal.gait.moments import moment_names, moment_of
from gaitcal.gait.normal_bands import Bands
from gaitcal.gait.strides import Layout
from gaitcal.gait.variables import Kind, coordinate_of, kind_of
from gaitcal.gait.words import SIDE_WORDS, coordinate_words, split_side
from gaitcal.model.linkage import COORDINATES, is_translation
from gaitcal.person.result import Calibration, LoadedTrial, TrialResult

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LEAST_ANGLE, LEAST_MOMENT = 10.0, 0.2
"""Smallest range of a vertical axis (deg, N·m/kg), so that nothing small looks dramatic."""
TRUTH_WIDTH = 1.1


@dataclass(frozen=True)
class Trace:
    """One side of one signal over all frames of the trial."""

    side: str
    value: Array
    """(nf,); NaN where it must not be drawn."""
    nominal: Array
    """(nf,) with the nominal model."""
    error: Array | None
    """(nf,) standard error."""
    truth: Array | None = None
    """(nf,) where it is known; in frames that are not valid, too."""


NORMAL_COLOUR = "#CC79A7"
"""Okabe and Ito's purple, with dotted edges: the stance is grey."""
NORMAL_KEY = Key(label="normal band (mean ±1 SD, dotted edges)", colour=NORMAL_COLOUR, kind="band")
BAND_KEY = Key(label="±1 standard error", colour=SIDE_COLOURS["r"], kind="band")


def _keys(middle: str, *, bands: bool, truth: bool, normal: bool = False) -> tuple[Key, ...]:
    """The legend; `middle` says what the curves without a side are of, `truth` whether it is drawn."""
    known = (
        Key(label=TRUTH_WORDS, colour=INK, dashes=TRUTH_DASHES["r"], width=TRUTH_WIDTH),
        Key(label="truth, left", colour=INK, dashes=TRUTH_DASHES["l"], width=TRUTH_WIDTH),
    )
    return (
        *SIDE_KEYS,
        Key(label=middle, colour=SIDE_COLOURS[""]),
        *((BAND_KEY,) if bands else ()),
        *((NORMAL_KEY,) if normal else ()),
        Key(label="nominal model", colour=NOMINAL, width=0.9),
        *(known if truth else ()),
        Key(label="stance (toe-off: thin line)", colour=STANCE_KEY, kind="area"),
    )


def angle_chart(
    calibration: Calibration, trial: TrialResult, layout: Layout, stem: str, normal: Bands | None = None
) -> Chart:
    """Joint angles of a whole-body trial; `normal`: bands behind them, where it is drawn over the gait cycle."""
    bands = _normal(calibration, layout, normal, Kind.ANGLE, 1.0)
    frozen = set(calibration.model.frozen)
    before, after = np.degrees(trial.nominal.q), np.degrees(trial.body.q)
    known = calibration.truth.of(trial.name).coordinates if calibration.truth else {}

    def trace(name: str) -> Trace:
        column = trial.body.coordinates.index(name)
        old = trial.nominal.coordinates.index(name)
        error = None if trial.coordinate_errors is None else np.degrees(trial.coordinate_errors[:, column])
        true = known[name].truth if name in known else None
        return Trace(split_side(name)[1], after[:, column], before[:, old], error, true)

    names = [n for n in COORDINATES if not is_translation(n) and n not in frozen]
    return Chart(
        name=f"{stem}_angles",
        title="Joint angles",
        caption="The word in brackets is the direction of positive values, the same for both sides. Pelvis angles are "
        "against the laboratory, trunk angles against the pelvis"
        + (", over the right cycle." if layout.by_cycle else "."),
        panels=_panels(names, trace, layout, "deg", LEAST_ANGLE, bands, moment=False),
        keys=_keys(
            "pelvis and trunk", bands=trial.coordinate_errors is not None, truth=bool(known), normal=bool(bands)
        ),
        subject=trial.name,
    )


def moment_chart(
    calibration: Calibration,
    trial: TrialResult,
    loads: LoadedTrial,
    layout: Layout,
    stem: str,
    normal: Bands | None = None,
) -> Chart:
    """Joint moments per body mass; frames that are not valid stay empty. `normal`: as of the angles."""
    mass = calibration.model.subject.mass
    known = calibration.truth.of(trial.name).forces if calibration.truth else {}
    bands = _normal(calibration, layout, normal, Kind.MOMENT, 1.0 / mass)

    def trace(name: str) -> Trace:
        value, nominal = (
            np.where(loads.reactions.valid_for(name), moment_of(forces, name) / mass, np.nan)
            for forces in (loads.final, loads.nominal)
        )
        errors = None if loads.errors is None else moment_of(loads.errors, name) / mass
        true = known[name].truth / mass if name in known else None
        return Trace(split_side(name)[1], value, nominal, errors, true)

    names = moment_names(calibration.model)
    return Chart(
        name=f"{stem}_moments",
        title="Joint moments",
        caption="Internal, net moments: what muscles, ligaments and bone contact together exert on the distal segment. "
        "The word in brackets is the action of positive values; external moments have the opposite sign. Curves are "
        "interrupted in frames that are not valid: for a leg where its own foot rests beside plates, or shares one."
        + (" The truth goes on through these." if known else ""),
        panels=_panels(names, trace, layout, "N·m/kg", LEAST_MOMENT, bands, moment=True),
        keys=_keys("trunk", bands=loads.errors is not None, truth=bool(known), normal=bool(bands)),
        subject=trial.name,
    )


def _normal(
    calibration: Calibration, layout: Layout, normal: Bands | None, kind: Kind, factor: float
) -> dict[str, tuple[Array, Array]]:
    """Coordinate, without a side -> mean and SD (101,) of healthy people, in the unit that is drawn.

    The whole body is drawn over the right stride, and both legs of healthy people are alike.
    """
    if not layout.by_cycle:
        return {}
    of_kind = {coordinate_of(name): band for name, band in (normal or {}).items() if kind_of(name) is kind}
    found = {name: band.for_person(calibration.model.subject, "r") for name, band in of_kind.items()}
    return {name: (factor * mean, factor * sd) for name, (mean, sd) in found.items()}


def _panels(
    names: list[str],
    trace: Callable[[str], Trace],
    layout: Layout,
    unit: str,
    least: float,
    normal: Mapping[str, tuple[Array, Array]],
    *,
    moment: bool,
) -> tuple[Panel, ...]:
    """One panel a coordinate, right and left together."""
    sides: dict[str, list[Trace]] = {}
    for name in names:
        sides.setdefault(split_side(name)[0], []).append(trace(name))
    return tuple(
        _panel(words.title, unit, words.moment if moment else words.angle, traces, layout, least, normal.get(base))
        for base, words, traces in ((base, coordinate_words(base), traces) for base, traces in sides.items())
    )


def _panel(
    title: str,
    unit: str,
    positive: str,
    traces: list[Trace],
    layout: Layout,
    least: float,
    normal: tuple[Array, Array] | None,
) -> Panel:
    def draw(axes: Axes) -> None:
        dress(axes, xlabel=layout.xlabel, ylabel=f"{unit} ({positive} +)", title=title)
        axes.axhline(0.0, color=FAINT, linewidth=0.5)
        drawn: list[Array] = []
        for trace in traces:
            _stance(axes, layout, trace.side)
        if normal is not None:
            ends = (normal[0] - normal[1], normal[0] + normal[1])
            percent = np.arange(float(POINTS))
            axes.fill_between(percent, *ends, color=NORMAL_COLOUR, alpha=0.25, linewidth=0)
            for edge in ends:
                axes.plot(percent, edge, color=NORMAL_COLOUR, linewidth=0.8, linestyle=":")
            drawn += ends
        for trace in traces:
            drawn += _trace(axes, layout, trace)
        axes.set_xlim(*layout.xlimits)
        axes.set_ylim(*limits(drawn, least))
        if layout.by_cycle:
            axes.set_xticks([0, 20, 40, 60, 80, 100])
        if not any(np.isfinite(d).any() for d in drawn):
            axes.text(0.5, 0.5, "no valid frames", transform=axes.transAxes, ha="center", fontsize=7, color=FAINT)

    sides = " and ".join(SIDE_WORDS[t.side] or "whole body" for t in traces)
    return Panel(f"{title}, {sides}, {unit} over {layout.xlabel}", draw)


def _trace(axes: Axes, layout: Layout, trace: Trace) -> list[Array]:
    """Draw one side; the values that the vertical axis must hold."""
    colour, dashes = SIDE_COLOURS[trace.side], line_style(SIDE_DASHES[trace.side])
    for x, y in layout.others(trace.side, trace.value):
        axes.plot(x, y, color=colour, linewidth=0.6, alpha=0.35)
    x, nominal = layout.lay(trace.side, trace.nominal)
    axes.plot(x, nominal, color=NOMINAL, linewidth=0.9, linestyle=dashes)
    x, y = layout.lay(trace.side, trace.value)
    drawn = [nominal, y]
    if trace.error is not None:
        spread = layout.lay(trace.side, trace.error)[1]
        axes.fill_between(x, y - spread, y + spread, color=colour, alpha=0.25, linewidth=0)
        drawn += [y - spread, y + spread]
    axes.plot(x, y, color=colour, linewidth=1.5, linestyle=dashes)
    if trace.truth is not None:
        x, true = layout.lay(trace.side, trace.truth)
        axes.plot(x, true, color=INK, linewidth=TRUTH_WIDTH, linestyle=line_style(TRUTH_DASHES[trace.side]))
        drawn.append(true)
    return drawn


def _stance(axes: Axes, layout: Layout, side: str) -> None:
    for start, stop in layout.stances(side):
        axes.axvspan(start, stop, color=STANCE, alpha=STANCE_ALPHA, linewidth=0)
        if layout.by_cycle and side:
            axes.axvline(stop, color=SIDE_COLOURS[side], linewidth=0.7, linestyle=line_style(SIDE_DASHES[side]))
