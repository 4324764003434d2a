"""CSV files of a result: comment lines above the header, first of them what the verdict says of the
numbers.

Above all the table of strides, `cycles.csv`: angles and torques of each complete one over 0 to 100
%, in long form.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gaitcal.analysis.result import Calibration, TrialResult
from gaitcal.arrays import Array
from gaitcal.errors import Code, InputError
from gaitcal.gait import ensemble, spatiotemporal
from gaitcal.gait.cycles import (
    CYCLE_COLUMNS,
    GROUND_REACTION,
    POINTS,
    GaitCycle,
    conventions_of,
    normalise,
    typed,
)
from gaitcal.gait.strides import TURNING, pelvis_angles, strides_of, turns
from gaitcal.model.coordinates import FOOT_PROGRESSION
from gaitcal.model.linkage import PELVIS_ANGLES
from gaitcal.model.subject_model import Subject, SubjectModel
from gaitcal.results.table_files import Column, Table, read_csv, refused_lines, write_csv
from gaitcal.results.trial_curves import Curve, curves_of, joint_of
from gaitcal.results.trial_tables import foot_in_stride, pelvis_in_stride, relative_header
from gaitcal.runtime import with_one_blas_thread

if TYPE_CHECKING:
    import pandas as pd  # loaded by who asks for a data frame: it takes a third of a second


# ----------------------------------------------------------------------------------------- the table of strides

DIMENSIONS = ("person", "session", "trial", "side", "stride", "percent")
COLUMNS = {
    "": "value",
    "_se": "se",
    "_valid": "valid",
}  # Ending of a data variable -> column of the table
CYCLE_HEADER = (
    "strides of each foot, from its strike (0 %) to its next one (100 %), numbered from 1 in each "
    "trial and side",
    "variable: a coordinate of the leg of that side (without the side in its name), of pelvis or "
    "trunk: its angle in",
    "degrees; with _moment its internal moment in N m; with _power its power in W, of a joint "
    "(hip_power) or of one of",
    "several coordinates of a joint (hip_flexion_power), positive: generated; "
    "ground_reaction_vertical: upward force",
    "on that foot, N",
    "angles of the pelvis: against a laboratory turned into the line of progression of each "
    "stride, from strike to",
    "next strike (where that foot is not seen then: of the nearest stride, else the room's forward "
    "axis), so that they",
    "mean the same in any direction of the room; motion/TRIAL.csv has them against the room",
    "foot_progression: how far the foot's long axis, heel to toe, points out of the vertical plane "
    "along that line;",
    "toes in is positive",
    "se: standard error, empty where unknown; se_stride: the part of it that a trial's own markers "
    "make, and that",
    "differs from stride to stride; what is left, sqrt(se^2 - se_stride^2), is the same error in "
    "all strides",
    "valid: 1 where the value may be used: moments of a leg by its own foot, of the trunk by both; "
    "angles of a leg",
    "where markers show the segments that they are between; nothing of a refused leg, nor of the "
    "trunk with it,",
    f"nor pelvis angles and foot progression of a stride that turns by more than {TURNING:g} deg",
    "turn: deg to the left by which the pelvis turns over the stride of a walk",
    "activity: gait of strides of walks; of a trial of any other activity its name: its strides, "
    "or what the pelvis",
    "repeats from rest to rest; means never mix activities",
    "phase: stance or swing of a stride; of a repetition lowering, rising, flight as the pelvis "
    "does, push-off: rising",
    "before a flight, landing: lowering after one",
)
"""Comment lines above the header."""
CYCLES = "cycles.csv"
DIGITS = 6
TURN_DIGITS = 1


def write_cycles(
    path: Path,
    model: SubjectModel,
    trials: Sequence[TrialResult],
    relative_to: Mapping[str, float] | None = None,
    earlier: pd.DataFrame | None = None,
    earlier_lines: Iterable[str] = (),
) -> Table:
    """Write `cycle_table` with its comment lines, after the rows and the lines of `earlier` trials,
    as text.

    Returns the table that is written: columns by name, or a data frame where there are earlier
    rows.
    """
    refused = (f"{t.name}: {line}" for t in trials if t.joint is None for line in refused_lines(t))
    relative = () if relative_to is None else relative_header(relative_to)
    table: Table = cycle_columns(model, trials, relative_to)
    if earlier is not None and not earlier.empty:
        import pandas as pd

        table = (
            pd.concat([earlier, pd.DataFrame(table)], ignore_index=True)
            if len(table["value"])
            else earlier
        )
    write_csv(table, path, (*earlier_lines, *refused, *CYCLE_HEADER, *relative))
    return table


@with_one_blas_thread
def cycles(calibration: Calibration) -> pd.DataFrame:
    """Angles, moments and vertical ground reaction of every stride of a calibration's walks, 0 to
    100 %, in long form.

    Columns as in `cycles.csv`: person, session, trial, side (`r`, `l`), stride (from 1), percent,
    variable (units: `gaitcal/gait/cycles.py`), value, se, valid (1: may be used), se_stride (the
    part of se that differs from stride to stride), turn (deg to the left over the stride), activity
    (`gait`, or the name of a trial of another activity, whose repetitions these are), phase
    (`CYCLE_HEADER`). Pelvis angles are against each stride's line of progression.
    """
    return cycle_table(calibration.model, calibration.trials, calibration.relative_to)


def read_cycles(path: Path | str) -> pd.DataFrame:
    """The table of strides of a result: `cycles.csv`, or the folder that holds it; columns as of
    `gaitcal.cycles`.

    One that `gaitcal export` wrote has `unit` and `positive` beside them.

    Raises
    ------
    InputError
        It is not there, or is no such table.
    """
    source = Path(path)
    source = source / CYCLES if source.is_dir() else source
    try:
        table, _ = read_csv(source)
    except (OSError, UnicodeError, ValueError) as error:
        message = f"cannot be read as a table of strides: {error}"
        raise InputError(message, source=source, code=Code.DAMAGED_RESULT) from None
    return typed(table, source)


def cycle_table(
    model: SubjectModel,
    trials: Sequence[TrialResult],
    relative_to: Mapping[str, float] | None = None,
) -> pd.DataFrame:
    """`cycle_columns` as a data frame."""
    import pandas as pd

    return pd.DataFrame(cycle_columns(model, trials, relative_to))


def cycle_columns(
    model: SubjectModel,
    trials: Sequence[TrialResult],
    relative_to: Mapping[str, float] | None = None,
) -> dict[str, Column]:
    """Every variable of every complete stride of the gait trials, with `CYCLE_COLUMNS`; no row
    where there is none.

    `relative_to`: coordinate -> rad in the static posture, taken off the joint angles; None: they
    are anatomical.
    """
    parts = []
    for trial in trials:
        if trial.joint is None:
            curves = curves_of(model, trial, relative_to, None)
            for side, cycles in strides_of(trial.events).items():
                shown = _shown(curves, side)
                measured = {s.number: s for s in trial.strides if s.side == side}
                for number, cycle in enumerate(cycles, start=1):
                    stride = measured.get(number)
                    of_stride = _against_line(trial, side, cycle, stride, shown)
                    parts.append(
                        _rows(model.subject, trial, side, number, cycle, of_stride, stride)
                    )
    return {name: _joined([part[name] for part in parts]) for name in CYCLE_COLUMNS}


def _joined(parts: Sequence[Column]) -> Column:
    if all(isinstance(part, np.ndarray) for part in parts):
        return np.concatenate(parts) if parts else np.empty(0)
    return [value for part in parts for value in part]


def _shown(curves: Iterable[Curve], side: str) -> list[Curve]:
    """Of the leg of one side, and of what belongs to neither; arms, residuals and the other forces
    are left out.
    """
    return [
        c
        for c in curves
        if c.side in (side, "")
        and (c.kind in ("angle", "moment", "power") or c.base == GROUND_REACTION)
        and (joint_of(c.base) != "arm" and (c.kind != "moment" or not c.base.startswith("pelvis")))
    ]


def _against_line(
    trial: TrialResult,
    side: str,
    cycle: GaitCycle,
    stride: spatiotemporal.Stride | None,
    curves: Sequence[Curve],
) -> list[Curve]:
    """The curves of one stride: angles of the pelvis and the foot against its line of progression."""
    straight = stride is None or not turns(stride.turn)
    turned = dict(
        zip(
            PELVIS_ANGLES,
            pelvis_in_stride(trial, pelvis_angles(trial.body), cycle, stride).T,
            strict=True,
        )
    )
    turned |= (
        {FOOT_PROGRESSION: foot}
        if (foot := foot_in_stride(trial, side, cycle, stride)) is not None
        else {}
    )
    return [
        replace(c, value=turned[c.base], valid=c.valid & straight) if c.variable in turned else c
        for c in curves
    ]


def _rows(
    subject: Subject,
    trial: TrialResult,
    side: str,
    stride: int,
    cycle: GaitCycle,
    curves: Sequence[Curve],
    measured: spatiotemporal.Stride | None,
) -> dict[str, Column]:
    time, count = trial.body.time, len(curves)
    rows = count * POINTS

    def laid(values: Sequence[Array]) -> Array:
        out: Array = normalise(time, np.stack(values, axis=1), cycle).T.ravel()
        return out

    unknown = np.full(len(time), np.nan)
    usable = laid([np.where(c.valid, 1.0, np.nan) for c in curves])
    turn = (
        np.nan if measured is None or measured.turn is None else round(measured.turn, TURN_DIGITS)
    )
    return {
        "person": [subject.name] * rows,
        "session": [subject.session] * rows,
        "trial": [trial.name] * rows,
        "side": [side] * rows,
        "stride": np.full(rows, stride),
        "percent": np.tile(np.arange(POINTS), count),
        "variable": [c.variable for c in curves for _ in range(POINTS)],
        "value": _short(laid([c.value for c in curves])),
        "se": _short(laid([unknown if c.error is None else c.error for c in curves])),
        "valid": np.isfinite(usable).astype(int),
        "se_stride": _short(laid([unknown if c.own is None else c.own for c in curves])),
        "turn": np.full(rows, turn, dtype=np.float64),
        "activity": [trial.activity] * rows,
        "phase": cycle.phases * count,
    }


def _short(values: Array) -> Array:
    """Rounded to a millionth of a degree or newton metre."""
    out: Array = np.round(values, DIGITS)
    return out


def cycles_to_xarray(strides: pd.DataFrame) -> Any:
    """A `xarray.Dataset` of strides as `gaitcal.cycles` and `gaitcal.read_cycles` give them.

    Dimensions `trial`, `side`, `stride`, `percent`; `person` and `session`, too, where there are
    several. Data variables `hip_flexion`, `hip_flexion_se` (standard error), `hip_flexion_valid`
    (1: may be used), with `units` as attribute, and with `positive` (what a positive value means)
    where the table says it, as exports do; NaN where a trial has no such stride. Without any stride
    it is empty.

    Raises
    ------
    InputError
        xarray is not installed, a stride is there twice, or a variable in two conventions.
    """
    import pandas as pd

    try:
        import xarray
    except ImportError:
        raise InputError(
            "xarray is not installed; pip install xarray", code=Code.INSTALLATION
        ) from None
    if strides.empty:
        return xarray.Dataset()
    strides = typed(strides)
    ensemble.require_once(strides)
    conventions = conventions_of(strides)
    several = [
        name
        for name in DIMENSIONS
        if name not in ("person", "session") or strides[name].nunique() > 1
    ]
    wide = strides.set_index([*several, "variable"])[list(COLUMNS.values())].unstack("variable")
    columns: dict[str, pd.Series] = {}
    for variable in dict.fromkeys(strides["variable"]):
        columns |= {
            f"{variable}{ending}": wide[column, variable] for ending, column in COLUMNS.items()
        }
    dataset = xarray.Dataset.from_dataframe(pd.DataFrame(columns))
    for name in dataset.data_vars:
        variable = str(name).removesuffix("_se").removesuffix("_valid")
        unit, positive = conventions[variable]
        dataset[name].attrs["units"] = "1" if str(name).endswith("_valid") else unit
        if positive and str(name) == variable:
            dataset[name].attrs["positive"] = positive
    dataset["percent"].attrs["units"] = "%"
    for name in ("person", "session"):
        if name not in several:
            dataset.attrs[name] = strides[name].iloc[0]
    return dataset
