"""Build and read `cycles.csv`: every complete stride over 0 to 100 %, in long form.

The comment lines above its header begin with the verdict on the numbers.
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
    normalise,
    read_conventions,
    validate_stride_table,
)
from gaitcal.gait.strides import TURNING, get_pelvis_angles, is_turning, list_strides
from gaitcal.model.coordinates import FOOT_PROGRESSION
from gaitcal.model.linkage import PELVIS_ANGLES
from gaitcal.model.subject_model import Subject, SubjectModel
from gaitcal.results.table_files import Column, read_csv
from gaitcal.results.trial_curves import Curve, build_curves, find_joint
from gaitcal.results.trial_tables import express_foot_in_stride, express_pelvis_in_stride
from gaitcal.runtime import with_one_blas_thread

if TYPE_CHECKING:
    import pandas as pd  # loaded by who asks for a data frame: it takes a third of a second


# ----------------------------------------------------------------------------- the table of strides

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
    "angles of the pelvis: relative to the line of progression of each stride, from strike to next "
    "strike (if that foot",
    "is not visible then: of the nearest stride, else the laboratory's forward axis), so that they "
    "have the same meaning",
    "in any walking direction; motion/TRIAL.csv has them relative to the laboratory",
    "foot_progression: angle of the foot's long axis, heel to toe, to the vertical plane along "
    "that line; toe-in is",
    "positive",
    "se: standard error, empty if unknown; se_stride: its part due to the markers of the trial, "
    "which differs between",
    "strides; the rest, sqrt(se^2 - se_stride^2), is the same error in all strides",
    "valid: 1 where the value may be used: moments of a leg require its foot on plates, moments of "
    "the trunk both feet;",
    "angles of a leg require visible markers on both segments; 0 for a refused leg and, with it, "
    "the trunk, and for",
    f"pelvis angles and foot progression of a stride that turns by more than {TURNING:g} deg",
    "turn: rotation of the pelvis to the left over the stride of a walk, deg",
    "activity: gait for strides of walks; else the name of the trial, with its strides, or with "
    "repetitions of the",
    "pelvis motion from rest to rest; means never mix activities",
    "phase: stance or swing of a stride; for a repetition lowering, rising and flight of the "
    "pelvis, push-off: rising",
    "before a flight, landing: lowering after one",
)
"""Comment lines above the header."""
CYCLES = "cycles.csv"
DIGITS = 6
TURN_DIGITS = 1


@with_one_blas_thread
def cycles(calibration: Calibration) -> pd.DataFrame:
    """Return angles, moments and ground reactions of every stride, 0 to 100 %, in long form.

    Columns as in `cycles.csv`: person, session, trial, side (`r`, `l`), stride (from 1), percent,
    variable (units: `gaitcal/gait/cycles.py`), value, se, valid (1: usable), se_stride (the part
    of se that differs between strides), turn (deg to the left over the stride), activity (`gait`,
    or the name of a trial of another activity with its repetitions), phase (`CYCLE_HEADER`).

    Parameters
    ----------
    calibration
        From `gaitcal.calibrate`.

    Returns
    -------
    pandas.DataFrame
        Pelvis angles are relative to the line of progression of each stride.
    """
    return build_cycle_table(calibration.model, calibration.trials, calibration.relative_to)


def read_cycles(path: Path | str) -> pd.DataFrame:
    """Read the table of strides of a result.

    Parameters
    ----------
    path
        `cycles.csv`, or the result folder that contains it.

    Returns
    -------
    pandas.DataFrame
        Columns as of `gaitcal.cycles`; a table of `gaitcal export` also has `unit` and `positive`.

    Raises
    ------
    InputError
        The file is missing or is not a table of strides.
    """
    source = Path(path)
    source = source / CYCLES if source.is_dir() else source
    try:
        table, _ = read_csv(source)
    except (OSError, UnicodeError, ValueError) as error:
        message = f"cannot be read as a table of strides: {error}"
        raise InputError(message, source=source, code=Code.DAMAGED_RESULT) from None
    return validate_stride_table(table, source)


def build_cycle_table(
    model: SubjectModel,
    trials: Sequence[TrialResult],
    relative_to: Mapping[str, float] | None = None,
) -> pd.DataFrame:
    """Return `build_cycle_columns` as a data frame."""
    import pandas as pd

    curves = {t.name: build_curves(model, t, relative_to, None) for t in trials}
    return pd.DataFrame(build_cycle_columns(model.subject, trials, curves))


def build_cycle_columns(
    subject: Subject, trials: Sequence[TrialResult], curves: Mapping[str, Sequence[Curve]]
) -> dict[str, Column]:
    """Build the columns of `cycles.csv`: every variable of every complete stride.

    Parameters
    ----------
    subject
        Gives person and session.
    trials
        Trials with strides; single-joint ones have none.
    curves
        Trial -> its curves (`build_curves`).

    Returns
    -------
    dict
        `CYCLE_COLUMNS` by name; empty columns if there is no complete stride.
    """
    parts = []
    for trial in trials:
        if trial.joint is None:
            for side, cycles in list_strides(trial.events).items():
                shown = _select_curves(curves[trial.name], side)
                measured = {s.number: s for s in trial.strides if s.side == side}
                for number, cycle in enumerate(cycles, start=1):
                    stride = measured.get(number)
                    of_stride = _express_along_line(trial, side, cycle, stride, shown)
                    parts.append(
                        _build_rows(subject, trial, side, number, cycle, of_stride, stride)
                    )
    columns = {}
    for name in CYCLE_COLUMNS:
        columns[name] = _join_columns([part[name] for part in parts])
    return columns


def _join_columns(parts: Sequence[Column]) -> Column:
    if all(isinstance(part, np.ndarray) for part in parts):
        return np.concatenate(parts) if parts else np.empty(0)
    return [value for part in parts for value in part]


def _select_curves(curves: Iterable[Curve], side: str) -> list[Curve]:
    """Select the curves of one leg, pelvis and trunk; no arms, residuals or other forces."""
    return [
        c
        for c in curves
        if c.side in (side, "")
        and (c.kind in ("angle", "moment", "power") or c.base == GROUND_REACTION)
        and (
            find_joint(c.base) != "arm" and (c.kind != "moment" or not c.base.startswith("pelvis"))
        )
    ]


def _express_along_line(
    trial: TrialResult,
    side: str,
    cycle: GaitCycle,
    stride: spatiotemporal.Stride | None,
    curves: Sequence[Curve],
) -> list[Curve]:
    """Express the pelvis and foot angles of one stride along its line of progression."""
    # A turning person has no line of progression: these angles are then not valid.
    straight = stride is None or not is_turning(stride.turn)
    along_line = dict(
        zip(
            PELVIS_ANGLES,
            express_pelvis_in_stride(trial, get_pelvis_angles(trial.body), cycle, stride).T,
            strict=True,
        )
    )
    foot = express_foot_in_stride(trial, side, cycle, stride)
    if foot is not None:
        along_line[FOOT_PROGRESSION] = foot
    return [
        replace(c, value=along_line[c.base], valid=c.valid & straight)
        if c.variable in along_line
        else c
        for c in curves
    ]


def _build_rows(
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

    def normalise_all(values: Sequence[Array]) -> Array:
        out: Array = normalise(time, np.stack(values, axis=1), cycle).T.ravel()
        return out

    unknown = np.full(len(time), np.nan)
    # NaN in invalid frames, so that a point is valid only if both of its neighbours are.
    usable = normalise_all([np.where(c.valid, 1.0, np.nan) for c in curves])
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
        "value": _round_values(normalise_all([c.value for c in curves])),
        "se": _round_values(
            normalise_all([unknown if c.error is None else c.error for c in curves])
        ),
        "valid": np.isfinite(usable).astype(int),
        "se_stride": _round_values(
            normalise_all([unknown if c.stride_error is None else c.stride_error for c in curves])
        ),
        "turn": np.full(rows, turn, dtype=np.float64),
        "activity": [trial.activity] * rows,
        "phase": cycle.phases * count,
    }


def _round_values(values: Array) -> Array:
    """Round to a millionth of a degree or newton metre."""
    out: Array = np.round(values, DIGITS)
    return out


def cycles_to_xarray(strides: pd.DataFrame) -> Any:
    """Convert a table of strides to an `xarray.Dataset`.

    Dimensions are `trial`, `side`, `stride`, `percent`, and `person` and `session` if there are
    several. Data variables are `hip_flexion`, `hip_flexion_se` (standard error) and
    `hip_flexion_valid` (1: usable), with the attribute `units`. The attribute `positive` describes
    positive values if the table has it, as exports do. Values are NaN if a trial lacks a stride.

    Parameters
    ----------
    strides
        From `gaitcal.cycles` or `gaitcal.read_cycles`.

    Returns
    -------
    xarray.Dataset
        Empty if there is no stride.

    Raises
    ------
    InputError
        xarray is not installed, a stride occurs twice, or a variable has two conventions.
    """
    import pandas as pd

    try:
        import xarray
    except ImportError:
        raise InputError(
            "xarray is not installed; pip install xarray", code=Code.INSTALLATION
        ) from None
    # Without a stride there are no dimensions.
    if strides.empty:
        return xarray.Dataset()
    strides = validate_stride_table(strides)
    ensemble.require_unique_strides(strides)
    conventions = read_conventions(strides)
    # Person and session are dimensions only if there are several of them.
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
        # Unit and positive direction follow the variable, also for its standard error.
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
