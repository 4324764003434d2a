"""Normative curves of a result: mean and SD of healthy people for this person's size.

They have the units and signs of `cycles.csv` for strides of each side, and are drawn behind the
curves of the page, the PDF and the figures.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from gaitcal.arrays import Array
from gaitcal.errors import Code, InputError
from gaitcal.gait.cycles import POINTS
from gaitcal.gait.normal_bands import Norm
from gaitcal.model.linkage import SIDES
from gaitcal.model.subject_model import Subject
from gaitcal.results.table_files import Column, read_csv, write_csv

NORMAL_CURVES: Final = "normal_curves.csv"
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
    words: str = ""  # Who they are: for legends
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
            mean, sd = band.for_person(subject, side)
            sides[side] = np.round(mean, DIGITS), np.round(sd, DIGITS)
        curves[name] = NormalCurve(source=band.source, sides=sides)
    steps = {
        name: (round(mean, DIGITS), round(sd, DIGITS)) for name, (mean, sd) in norm.steps.items()
    }
    return NormTables(curves=curves, steps=steps, words=norm.words, remark=norm.remark)


def write_normal_curves(norm: NormTables, folder: Path) -> None:
    """Write `normal_curves.csv`; nothing if there are no curves."""
    blocks = [
        (name, side, curve.source, *curve.sides[side])
        for name, curve in norm.curves.items()
        for side in SIDES
    ]
    if not blocks:
        return
    names, sides, sources, means, sds = zip(*blocks, strict=True)
    table: dict[str, Column] = {
        "variable": np.repeat(names, POINTS).tolist(),
        "side": np.repeat(sides, POINTS).tolist(),
        "percent": np.tile(np.arange(POINTS), len(blocks)),
        "mean": np.concatenate(means),
        "sd": np.concatenate(sds),
        "source": np.repeat(sources, POINTS).tolist(),
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
    stored, path = summary.get("norm") or {}, folder / NORMAL_CURVES
    curves: dict[str, NormalCurve] = {}
    try:
        rows = read_csv(path)[0].replace("", "nan") if path.exists() else None
        for name, of_name in () if rows is None else rows.groupby("variable", sort=False):
            sides = {}
            for side, of_side in of_name.groupby("side", sort=False):
                mean, sd = (of_side[column].to_numpy(np.float64) for column in ("mean", "sd"))
                sides[str(side)] = mean, sd
            source = of_name["source"].iloc[0].replace("nan", "")
            curves[str(name)] = NormalCurve(source=source, sides=sides)
        steps = {name: (mean, sd) for name, (mean, sd) in stored.get("steps", {}).items()}
    except (OSError, UnicodeError, ValueError, KeyError) as error:
        message = f"cannot be read as normative curves: {error}"
        raise InputError(message, source=path, code=Code.DAMAGED_RESULT) from None
    return NormTables(
        curves=curves,
        steps=steps,
        words=str(stored.get("words", "")),
        remark=str(stored.get("remark", "")),
    )
