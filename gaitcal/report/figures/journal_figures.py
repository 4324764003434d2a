"""Figures for papers: one file for each variable, mean and SD over the strides of each foot.

Fonts are 8 pt (numbers 7 pt), lines at least 0.5 pt thick, width one or two columns. With a single
stride the band is its standard error, as the legend states.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pandas as pd

from gaitcal.arrays import Array
from gaitcal.gait.conventions import Convention, MomentUnit
from gaitcal.gait.cycles import GROUND_REACTION, CurveKind, get_coordinate, get_curve_kind
from gaitcal.gait.moments import SIDE_WORDS, format_count
from gaitcal.model import coordinates, linkage
from gaitcal.model.subject_model import Subject
from gaitcal.report.figures import chart

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LETTERS: Final = chart.Sizes(small=7.0, normal=8.0, title=8.0)
LEGEND_ROW: Final = 0.175  # inches
INCH: Final = 25.4  # mm
TALLEST: Final = 80.0  # mm: a wide figure is no taller
ASPECT: Final = 0.68
LINE, THIN, TOE_OFF = 1.4, 0.5, 0.6
BAND: Final = 0.22
LEAST: Final = {CurveKind.ANGLE: 10.0, CurveKind.FORCE: 0.5}
"""Smallest range of a vertical axis, in deg and N, so that nothing small looks dramatic."""
LEAST_MOMENT: Final = 0.2  # The same of moments and powers, N·m/kg and W/kg
NORMAL_COLOUR: Final = "#CC79A7"
"""Okabe and Ito's purple, with dotted edges."""
HealthyBands = Mapping[str, Mapping[str, tuple[Array, Array]]]
"""Variable of `cycles.csv` -> side -> mean and SD (101,) of healthy people, in its unit, for that
person's size.
"""


@dataclass(frozen=True, kw_only=True)
class Strides:
    """Strides to draw."""

    table: pd.DataFrame  # As `gaitcal.ensemble` gives it, of the strides in `cycles.csv`
    subject: Subject
    offs: Mapping[str, float]  # Side -> mean end of stance, % of the stride
    healthy: HealthyBands = field(default_factory=dict)


def build_paper_charts(
    strides: Strides, convention: Convention, width: float = 85.0
) -> list[chart.Chart]:
    """Build one chart for each variable, in the order of `cycles.csv`, without drawing it.

    Parameters
    ----------
    strides
        Mean curves, subject, toe-off and normative data.
    convention
        Signs, acting body and unit, about the axes of the coordinates.
    width
        mm.

    Returns
    -------
    list of Chart
        One for each variable.
    """
    tables = strides.table.groupby("variable", sort=False)
    return [_build_chart(str(name), table, strides, convention, width) for name, table in tables]


MUSCLES_SHOWN: Final = 9  # Of a coordinate, those whose moment arm changes most
BEFORE, AFTER = chart.SIDE_COLOURS["l"], chart.SIDE_COLOURS["r"]


def build_moment_arm_charts(table: pd.DataFrame, width: float = 85.0) -> list[chart.Chart]:
    """Build one chart of muscle moment arms for each coordinate, before and after calibration.

    Charts show the muscles with the largest changes over the range of the coordinate. With draws,
    the band is ± 1.96 standard deviations.

    Parameters
    ----------
    table
        The file ending in `.muscles.csv`, of `gaitcal export --into --muscles`.
    width
        mm.

    Returns
    -------
    list of Chart
        One for each coordinate.
    """
    return [
        _build_moment_arm_chart(str(name), rows, width)
        for name, rows in table.groupby("coordinate", sort=False)
    ]


def _build_moment_arm_chart(coordinate: str, table: pd.DataFrame, width: float) -> chart.Chart:
    change = (table["arm_after_mm"] - table["arm_before_mm"]).abs().groupby(table["muscle"]).max()
    shown = change.sort_values(ascending=False, kind="stable").index[:MUSCLES_SHOWN]
    known = bool(table["arm_sd_mm"].notna().any())

    def draw_of(rows: pd.DataFrame) -> "Callable[[Axes], None]":
        def draw(axes: "Axes") -> None:
            muscle = chart.clean_name(str(rows["muscle"].iloc[0]))
            chart.format_axes(
                axes,
                xlabel=f"{chart.clean_name(coordinate)} (deg)",
                ylabel="mm",
                title=muscle,
                sizes=LETTERS,
            )
            deg, before, after = (
                rows[name].to_numpy(float) for name in ("deg", "arm_before_mm", "arm_after_mm")
            )
            width_of_band = 1.96 * np.nan_to_num(rows["arm_sd_mm"].to_numpy(float))
            axes.axhline(0.0, color=chart.FAINT, linewidth=THIN)
            axes.fill_between(
                deg,
                after - width_of_band,
                after + width_of_band,
                color=AFTER,
                alpha=BAND,
                linewidth=0,
            )
            axes.plot(
                deg,
                before,
                color=BEFORE,
                linewidth=LINE,
                linestyle=chart.make_line_style(chart.SIDE_DASHES["l"]),
            )
            axes.plot(deg, after, color=AFTER, linewidth=LINE)
            axes.set_ylim(
                *chart.compute_limits([before, after - width_of_band, after + width_of_band], 5.0)
            )

        return draw

    columns = max(1, round(width / 60.0))
    inches = width / columns / INCH
    size = chart.Size(
        width=inches, height=ASPECT * inches, left=0.5, right=0.1, bottom=0.42, top=0.26, label=0.2
    )
    panels = [
        chart.Panel(
            f"moment arm of {name} about {coordinate}",
            draw_of(table[table["muscle"] == name]),
            size,
        )
        for name in shown
    ]
    hidden = table["muscle"].nunique() - len(shown)
    keys = [chart.Key(label="before", colour=BEFORE, dashes=chart.SIDE_DASHES["l"], width=LINE)]
    keys.append(
        chart.Key(
            label="after" + (", ± 1.96 SD of the draws" if known else ""), colour=AFTER, width=LINE
        )
    )
    if hidden:
        keys.append(
            chart.Key(
                label=f"{hidden} muscles more, which change less", colour=chart.FAINT, width=0.0
            )
        )
    file_name = "".join(c if c.isascii() and c.isalnum() else "_" for c in coordinate)
    return chart.Chart(
        name=f"moment_arms_{file_name}",
        title=f"Moment arms about {chart.clean_name(coordinate)}",
        panels=tuple(panels),
        keys=tuple(keys),
        columns=columns,
        sizes=LETTERS,
        legend_row=LEGEND_ROW,
    )


def name_paper_file(variable: str) -> str:
    """Name the file of a variable: `hip_flexion_angle`, `knee_angle`, `knee_adduction_moment`."""
    return (
        f"{variable.removesuffix('_angle')}_angle"
        if get_curve_kind(variable) is CurveKind.ANGLE
        else variable
    )


@dataclass(frozen=True, kw_only=True)
class _Line:
    """One side of one variable."""

    side: str
    mean: Array  # (101,)
    spread: Array  # (101,) SD over strides, or the standard error of a single one
    strides: int
    healthy: tuple[Array, Array] | None  # Mean and SD (101,)

    @property
    def label(self) -> str:
        """In the legend."""
        description = (
            f"mean ± SD of {self.strides} strides"
            if self.strides > 1
            else format_count(self.strides, "stride")
        )
        error = " ± standard error" if self.strides == 1 and np.isfinite(self.spread).any() else ""
        return f"{SIDE_WORDS[self.side]}, {description}{error}"


def _build_chart(
    variable: str, table: pd.DataFrame, strides: Strides, convention: Convention, width: float
) -> chart.Chart:
    lines = [
        line
        for side in linkage.SIDES
        if (line := _build_line(variable, side, table, strides, convention)) is not None
    ]
    kind, title = get_curve_kind(variable), format_variable_title(variable, convention)
    # Bands of the two sides differ where their signs do: clinical angles of the pelvis have one
    # sense for both sides, OpenSim's have not.
    bands = _drop_equal_bands([line for line in lines if line.healthy is not None])

    def draw(axes: "Axes") -> None:
        chart.format_axes(
            axes,
            xlabel="gait cycle (%)",
            ylabel=_format_label(variable, convention, strides.subject),
            title=title,
            sizes=LETTERS,
        )
        axes.axhline(0.0, color=chart.FAINT, linewidth=THIN)
        drawn: list[Array] = []
        for line in bands:
            drawn += _draw_normal_band(axes, *line.healthy) if line.healthy else ()
        for line in lines:
            drawn += _draw_mean(axes, line)
            if line.side in strides.offs:
                dashes = chart.make_line_style(chart.SIDE_DASHES[line.side])
                colour = chart.SIDE_COLOURS[line.side]
                axes.axvline(
                    strides.offs[line.side], color=colour, linewidth=TOE_OFF, linestyle=dashes
                )
        axes.set_xlim(0.0, 100.0)
        axes.set_xticks([0, 20, 40, 60, 80, 100])
        axes.set_ylim(
            *chart.compute_limits(drawn, _compute_least_range(kind, convention, strides.subject))
        )
        if not any(np.isfinite(values).any() for values in drawn):
            axes.text(
                0.5,
                0.5,
                "no valid strides",
                transform=axes.transAxes,
                ha="center",
                fontsize=LETTERS.normal,
            )

    inches = width / INCH
    height = min(ASPECT * width, TALLEST) / INCH
    size = chart.Size(
        width=inches, height=height, left=0.76, right=0.14, bottom=0.42, top=0.26, label=0.29
    )
    return chart.Chart(
        name=name_paper_file(variable),
        title=title,
        panels=(chart.Panel(f"{title} over the gait cycle, right and left", draw, size),),
        keys=tuple(_build_keys(lines, bands, strides.offs)),
        columns=1,
        sizes=LETTERS,
        legend_row=LEGEND_ROW,
    )


def _build_line(
    variable: str, side: str, table: pd.DataFrame, strides: Strides, convention: Convention
) -> _Line | None:
    rows = table[table["side"] == side].sort_values("percent")
    if rows.empty:
        return None

    def convert(values: Any) -> Array:
        factor = (
            _get_force_unit(convention, strides.subject)[0] if variable == GROUND_REACTION else 1.0
        )
        return factor * convention.values(
            variable, np.asarray(values, dtype=np.float64), side, strides.subject
        )

    count = int(rows["n"].max())
    band = strides.healthy.get(variable, {}).get(side)
    return _Line(
        side=side,
        mean=convert(rows["mean"]),
        spread=np.abs(convert(rows["sd" if count > 1 else "se"])),
        strides=count,
        healthy=None if band is None else (convert(band[0]), np.abs(convert(band[1]))),
    )


def _drop_equal_bands(lines: list[_Line]) -> list[_Line]:
    """Drop lines whose normative band equals that of an earlier line."""
    out: list[_Line] = []
    for line in lines:
        if not any(
            np.array_equal(np.array(line.healthy), np.array(o.healthy), equal_nan=True) for o in out
        ):
            out.append(line)
    return out


def _draw_mean(axes: "Axes", line: _Line) -> list[Array]:
    percent, colour = np.arange(float(len(line.mean))), chart.SIDE_COLOURS[line.side]
    ends = (line.mean - line.spread, line.mean + line.spread)
    axes.fill_between(percent, *ends, color=colour, alpha=BAND, linewidth=0)
    dashes = chart.make_line_style(chart.SIDE_DASHES[line.side])
    axes.plot(percent, line.mean, color=colour, linewidth=LINE, linestyle=dashes)
    return [line.mean, *ends]


def _draw_normal_band(axes: "Axes", mean: Array, sd: Array) -> tuple[Array, Array]:
    """Draw the normative mean +- SD (101,) with dotted edges, and return the edges."""
    percent, ends = np.arange(float(len(mean))), (mean - sd, mean + sd)
    axes.fill_between(percent, *ends, color=NORMAL_COLOUR, alpha=0.25, linewidth=0)
    for edge in ends:
        axes.plot(percent, edge, color=NORMAL_COLOUR, linewidth=0.8, linestyle=":")
    return ends


def _build_keys(
    lines: list[_Line], bands: list[_Line], offs: Mapping[str, float]
) -> Iterator[chart.Key]:
    for line in lines:
        yield chart.Key(
            label=line.label,
            colour=chart.SIDE_COLOURS[line.side],
            dashes=chart.SIDE_DASHES[line.side],
            width=LINE,
        )
    for line in bands:
        whose = f", {SIDE_WORDS[line.side]}" if len(bands) > 1 else ""
        yield chart.Key(
            label=f"healthy{whose}, mean ± SD (dotted edges)", colour=NORMAL_COLOUR, kind="band"
        )
    if offs:
        yield chart.Key(label="thin upright lines: toe-off", colour=chart.FAINT, width=TOE_OFF)


def format_variable_title(variable: str, convention: Convention) -> str:
    """Format the title of a variable, named by its positive direction: `Hip extension moment`."""
    return (
        "Vertical ground reaction force"
        if variable == GROUND_REACTION
        else convention.title(variable)
    )


def _get_force_unit(convention: Convention, subject: Subject) -> tuple[float, str]:
    """Get the factor for newtons and the unit, to accompany moments of that convention."""
    return {
        MomentUnit.NM: (1.0, "N"),
        MomentUnit.NM_PER_KG: (1.0 / subject.mass, "N/kg"),
        MomentUnit.PERCENT_BWH: (100.0 / subject.weight, "% body weight"),
    }[convention.unit]


def _format_label(variable: str, convention: Convention, subject: Subject) -> str:
    """Format the unit and the positive direction."""
    kind, moment = (
        get_curve_kind(variable),
        convention.unit.key.replace("Nm", "N·m").replace("*", "·"),
    )
    if kind is CurveKind.MOMENT and coordinates.get_senses(get_coordinate(variable)) is None:
        return moment
    whose = f"{convention.acting.key}, " if kind is CurveKind.MOMENT else ""
    force = _get_force_unit(convention, subject)[1]
    unit = {
        CurveKind.ANGLE: "deg",
        CurveKind.MOMENT: moment,
        CurveKind.POWER: convention.unit.power,
        CurveKind.FORCE: force,
    }[kind]
    return f"{unit}\n({whose}{convention.senses(variable, 'r')[0]} +)"


def _compute_least_range(kind: CurveKind, convention: Convention, subject: Subject) -> float:
    if kind in LEAST:
        return LEAST[kind]
    one = np.array([LEAST_MOMENT * subject.mass])
    if kind is CurveKind.MOMENT:
        return float(np.abs(convention.moment("", one, subject))[0])
    return float(convention.power(one, subject)[0])
