"""Figures for papers: one file for each variable, mean and SD over the strides of each foot.

Fonts are 8 pt (numbers 7 pt), lines at least 0.5 pt thick, width one or two columns. With a single
stride the band is its standard error, as the legend states.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np
import pandas as pd

from gaitcal.arrays import Array
from gaitcal.gait.conventions import Convention, MomentUnit
from gaitcal.gait.cycles import GROUND_REACTION, CurveKind, get_coordinate, get_curve_kind
from gaitcal.gait.moments import SIDE_WORDS, format_count
from gaitcal.model import coordinates, linkage
from gaitcal.model.subject_model import Subject
from gaitcal.report.figures import chart
from gaitcal.report.figures.curve_panel import (
    LEAST,
    TOE_OFF,
    CurvePanel,
    make_norm_key,
    make_side_key,
)

LETTERS: Final = chart.Sizes(small=7.0, normal=8.0, title=8.0)
LEGEND_ROW: Final = 0.175  # inches
INCH: Final = 25.4  # mm
TALLEST: Final = 80.0  # mm: a wide figure is no taller
ASPECT: Final = 0.68
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
BEFORE, AFTER = "l", "r"
"""Sides with the same colours and dashes."""
LEAST_ARM: Final = 5.0  # Smallest range of a vertical axis, mm


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
    columns = max(1, round(width / 60.0))
    inches = width / columns / INCH
    size = chart.Size(
        width=inches, height=ASPECT * inches, left=0.5, right=0.1, bottom=0.42, top=0.26, label=0.2
    )
    panels = []
    for name in shown:
        deg, before, after, sd = (
            table.loc[table["muscle"] == name, column].to_numpy(float)
            for column in ("deg", "arm_before_mm", "arm_after_mm", "arm_sd_mm")
        )
        arms = CurvePanel(
            title=chart.clean_name(str(name)),
            unit="mm",
            x=deg,
            x_label=f"{chart.clean_name(coordinate)} (deg)",
            mean={BEFORE: before, AFTER: after},
            error={BEFORE: np.zeros_like(before), AFTER: 1.96 * np.nan_to_num(sd)},
            least=LEAST_ARM,
        )
        panels.append(arms.make_panel(size, LETTERS, f"moment arm of {name} about {coordinate}"))
    hidden = table["muscle"].nunique() - len(shown)
    keys = [
        make_side_key(BEFORE, "before"),
        make_side_key(AFTER, "after" + (", ± 1.96 SD of the draws" if known else "")),
    ]
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


def _build_chart(
    variable: str, table: pd.DataFrame, strides: Strides, convention: Convention, width: float
) -> chart.Chart:
    kind, title = get_curve_kind(variable), format_variable_title(variable, convention)
    factor = _get_force_unit(convention, strides.subject)[0] if variable == GROUND_REACTION else 1.0
    means, spreads, keys = {}, {}, []
    norms: dict[str, tuple[Array, Array]] = {}
    for side in linkage.SIDES:
        rows = table[table["side"] == side].sort_values("percent")
        if rows.empty:
            continue
        count = int(rows["n"].max())
        healthy = strides.healthy.get(variable, {}).get(side)
        found = [rows["mean"], rows["sd" if count > 1 else "se"], *(healthy or ())]
        means[side], spread, *band = (
            factor * convention.values(variable, np.asarray(values, float), side, strides.subject)
            for values in found
        )
        spreads[side] = np.abs(spread)
        keys.append(make_side_key(side, _label_mean(side, count, spreads[side])))
        # Bands of the sides differ where their signs do: clinical angles of the pelvis have one
        # sense for both sides, OpenSim's have not.
        if band:
            norm = (band[0], np.abs(band[1]))
            if not any(np.array_equal(norm, other, equal_nan=True) for other in norms.values()):
                norms[side] = norm
    panel = CurvePanel(
        title=title,
        unit=_format_label(variable, convention, strides.subject),
        mean=means,
        error=spreads,
        norms=norms,
        toe_off={side: strides.offs[side] for side in means if side in strides.offs},
        least=_compute_least_range(kind, convention, strides.subject),
    )
    for side in norms:
        side_label = f", {SIDE_WORDS[side]}" if len(norms) > 1 else ""
        keys.append(make_norm_key(f"healthy{side_label}"))
    if strides.offs:
        keys.append(
            chart.Key(label="thin upright lines: toe-off", colour=chart.FAINT, width=TOE_OFF)
        )
    inches = width / INCH
    height = min(ASPECT * width, TALLEST) / INCH
    size = chart.Size(
        width=inches, height=height, left=0.76, right=0.14, bottom=0.42, top=0.26, label=0.29
    )
    return chart.Chart(
        name=name_paper_file(variable),
        title=title,
        panels=(panel.make_panel(size, LETTERS, f"{title} over the gait cycle, right and left"),),
        keys=tuple(keys),
        columns=1,
        sizes=LETTERS,
        legend_row=LEGEND_ROW,
    )


def _label_mean(side: str, strides: int, spread: Array) -> str:
    if strides > 1:
        return f"{SIDE_WORDS[side]}, mean ± SD of {strides} strides"
    error = " ± standard error" if np.isfinite(spread).any() else ""
    return f"{SIDE_WORDS[side]}, {format_count(strides, 'stride')}{error}"


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
    quantity = f"{convention.acting.key}, " if kind is CurveKind.MOMENT else ""
    force = _get_force_unit(convention, subject)[1]
    unit = {
        CurveKind.ANGLE: "deg",
        CurveKind.MOMENT: moment,
        CurveKind.POWER: convention.unit.power,
        CurveKind.FORCE: force,
    }[kind]
    return f"{unit}\n({quantity}{convention.senses(variable, 'r')[0]} +)"


def _compute_least_range(kind: CurveKind, convention: Convention, subject: Subject) -> float:
    least = np.array([LEAST[kind] * (1.0 if kind is CurveKind.ANGLE else subject.mass)])
    if kind is CurveKind.ANGLE:
        return float(least[0])
    if kind is CurveKind.FORCE:
        return float(least[0] * _get_force_unit(convention, subject)[0])
    if kind is CurveKind.MOMENT:
        return float(np.abs(convention.moment("", least, subject))[0])
    return float(convention.power(least, subject)[0])
