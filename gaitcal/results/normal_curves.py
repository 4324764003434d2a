"""Normative curves of a result: mean and SD of healthy people for this person's size.

They have the units and signs of `cycles.csv` for strides of each side, and are drawn behind the
curves of the page, the PDF and the figures.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from gaitcal.arrays import Array
from gaitcal.gait.cycles import POINTS
from gaitcal.gait.normal_bands import Norm
from gaitcal.model.linkage import SIDES
from gaitcal.model.subject_model import Subject
from gaitcal.results.summary import get_table
from gaitcal.results.table_files import read_rows, write_csv

NORMAL_CURVES: Final = "normal_curves.csv"
NORMAL_CURVES_COLUMNS: Final = ("variable", "side", "percent", "mean", "sd", "source")
NORMAL_CURVES_HEADER: Final = (
    "mean and SD of healthy people over the stride, for a body of this mass and height; variables, "
    "units and signs",
    "of strides of each side as in cycles.csv; empty where unknown; source: who they are",
)
"""Comment lines above the header."""
DIGITS: Final = 6


@dataclass(frozen=True, kw_only=True)
class NormalCurve:
    """One variable of healthy people."""

    source: str
    sides: Mapping[str, tuple[Array, Array]]  # `r`, `l` -> mean and SD (101,)


@dataclass(frozen=True, kw_only=True)
class NormTables:
    """Healthy people to compare somebody with; empty where none fit."""

    curves: Mapping[str, NormalCurve] = field(default_factory=dict)  # Variable of `cycles.csv` ->
    steps: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Measure of `spatiotemporal.csv` -> mean and SD, in its unit."""
    label: str = ""  # Who they are: for legends
    remark: str = ""  # Why these, or why none: a sentence


NO_NORM: Final = NormTables()


def build_norm_tables(norm: Norm, subject: Subject) -> NormTables:
    """Build the normative curves and steps for one person.

    Parameters
    ----------
    norm
        Normative data.
    subject
        Gives mass and height.

    Returns
    -------
    NormTables
        In the units of `cycles.csv` and `spatiotemporal.csv`.
    """
    curves = {}
    for name, band in norm.bands.items():
        sides = {}
        for side in SIDES:
            mean, sd = band.scale_to_person(subject, side)
            sides[side] = np.round(mean, DIGITS), np.round(sd, DIGITS)
        curves[name] = NormalCurve(source=band.source, sides=sides)
    steps = {
        name: (round(mean, DIGITS), round(sd, DIGITS)) for name, (mean, sd) in norm.steps.items()
    }
    return NormTables(curves=curves, steps=steps, label=norm.label, remark=norm.remark)


def write_normal_curves(norm: NormTables, folder: Path) -> None:
    """Write `normal_curves.csv`; nothing if there are no curves."""
    rows = [
        (name, side, percent, mean[percent], sd[percent], curve.source)
        for name, curve in norm.curves.items()
        for side, (mean, sd) in curve.sides.items()
        for percent in range(POINTS)
    ]
    if not rows:
        return
    columns = zip(*rows, strict=True)
    table = {
        name: list(column) for name, column in zip(NORMAL_CURVES_COLUMNS, columns, strict=True)
    }
    write_csv(table, folder / NORMAL_CURVES, NORMAL_CURVES_HEADER)


def read_norm_tables(folder: Path, summary: Mapping[str, Any]) -> NormTables:
    """Read the normative curves and steps of a result.

    Parameters
    ----------
    folder
        A result of `gaitcal calibrate`.
    summary
        Its `summary.json`, whose entry `norm` has the words and the steps.

    Returns
    -------
    NormTables
        As they were written; without curves if the file does not exist.

    Raises
    ------
    InputError
        The file is damaged.
    """
    stored, path = get_table(summary, "norm"), folder / NORMAL_CURVES
    curves = read_rows(path, NORMAL_CURVES_COLUMNS, _parse_curves) if path.exists() else {}
    return NormTables(
        curves=curves,
        steps={name: tuple(figures) for name, figures in stored.get("steps", {}).items()},
        label=str(stored.get("words", "")),
        remark=str(stored.get("remark", "")),
    )


def _parse_curves(rows: Iterable[Mapping[str, str]]) -> dict[str, NormalCurve]:
    """Parse the rows of `normal_curves.csv`, variable by variable and side by side."""
    values: dict[tuple[str, str], list[tuple[float, float]]] = {}
    sources: dict[str, str] = {}
    for row in rows:
        numbers = float(row["mean"] or "nan"), float(row["sd"] or "nan")
        values.setdefault((row["variable"], row["side"]), []).append(numbers)
        sources[row["variable"]] = row["source"]
    out = {}
    for name, source in sources.items():
        sides = {}
        for side in SIDES:
            mean, sd = np.array(values[name, side]).T
            sides[side] = mean, sd
        out[name] = NormalCurve(source=source, sides=sides)
    return out
