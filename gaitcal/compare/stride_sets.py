"""The strides of one variable of one leg: curves, and the errors that all of them share.

The error of a stride has two parts (`gait/ensemble.py`): its own, s_ij, which makes strides differ, and c, which all
strides of one calibrated person share, c^2 = se_ij^2 - s_ij^2. What of c two sessions on one static trial share in
turn, f, are the axes of the segments and, of loads, the masses.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd

from gaitcal.arrays import Array
from gaitcal.compare.session import Session, shared_part
from gaitcal.dynamics.axis_errors import AxisErrors
from gaitcal.gait.cycles import POINTS, Kind, coordinate_of, kind_of
from gaitcal.gait.strides import TURNING
from gaitcal.model.linkage import COORDINATE_INDEX, SIDES

Key = tuple[str, str]
"""Side and variable."""


@dataclass(frozen=True, kw_only=True)
class StrideSet:
    """n strides of one variable, in its unit, at 0 to 100 %; NaN where a sample is not valid."""

    values: Array
    """(n, 101)."""
    own: Array
    """(n, 101) standard error by the stride's own markers."""
    shared: Array
    """(n, 101) c."""
    frames: Array
    """(n, 101) f, at most c."""
    stance: Array
    """(n,) percent at which the foot leaves the ground; NaN where not known."""

    @property
    def count(self) -> int:
        """Strides with a valid sample."""
        return int(np.isfinite(self.values).any(axis=1).sum())


def stride_sets(session: Session) -> dict[Key, StrideSet]:
    """Every variable of both legs; strides that turn are left out."""
    table = session.strides
    table = table[~(table["turn"].abs() > TURNING)]
    if table.empty:
        return {}
    where = ["side", "variable", "trial", "stride"]
    wide = table.set_index([*where, "percent"])[["value", "se", "se_stride", "valid"]].unstack("percent")
    wide = wide.reindex(columns=pd.MultiIndex.from_product([["value", "se", "se_stride", "valid"], range(POINTS)]))
    stance = _stance(session.measures)
    arrays = {name: wide[name].to_numpy(dtype=np.float64) for name in ("value", "se", "se_stride", "valid")}
    arrays["value"] = np.where(arrays["valid"] == 1.0, arrays["value"], np.nan)
    out: dict[Key, StrideSet] = {}
    for (side, variable), rows in wide.groupby(level=["side", "variable"], sort=False).indices.items():
        own, total = arrays["se_stride"][rows], arrays["se"][rows]
        shared = np.sqrt(np.maximum(total**2 - own**2, 0.0))
        of_rows = [stance.get((trial, str(side), stride), np.nan) for _, _, trial, stride in wide.index[rows]]
        out[str(side), str(variable)] = StrideSet(
            values=arrays["value"][rows],
            own=own,
            shared=shared,
            frames=np.zeros_like(shared),
            stance=np.array(of_rows, dtype=np.float64),
        )
    return _with_frames(session, out)


def _stance(measures: pd.DataFrame) -> Mapping[tuple[str, str, int], float]:
    """(trial, side, stride) -> percent at which stance ends."""
    rows = measures[(measures["variable"] == "stance_percent") & measures["stride"].notna()]
    names = zip(rows["trial"], rows["side"], rows["stride"].astype(int), rows["value"], strict=True)
    return {(trial, side, stride): float(value) for trial, side, stride, value in names}


def _with_frames(session: Session, sets: dict[Key, StrideSet]) -> dict[Key, StrideSet]:
    """The same with f: of angles by the axes' own errors at the mean posture, of loads by the summary's shares."""
    angles = _axis_errors(session, sets)
    out = {}
    for (side, variable), found in sets.items():
        if kind_of(variable) is Kind.ANGLE:
            frames = angles.get((side, variable), np.zeros(POINTS))[None]
        else:
            name = coordinate_of(variable)
            part = shared_part(session, name if name.startswith(("pelvis", "lumbar")) else f"{name}_{side}")
            frames = np.sqrt(part) * found.shared
        out[side, variable] = StrideSet(
            values=found.values,
            own=found.own,
            shared=found.shared,
            frames=np.minimum(np.broadcast_to(frames, found.shared.shape), found.shared),
            stance=found.stance,
        )
    return out


def _axis_errors(session: Session, sets: Mapping[Key, StrideSet]) -> dict[Key, Array]:
    """Angle -> (101,) deg that the directions of the segments' axes leave in it."""
    if not session.axis_deviations:
        return {}
    axes = AxisErrors(session.model.parameters, session.axis_deviations)
    out: dict[Key, Array] = {}
    for side in SIDES:
        posture = np.zeros((POINTS, len(COORDINATE_INDEX)))
        here = {}
        for (of, variable), found in sets.items():
            name = variable if variable in COORDINATE_INDEX else f"{variable}_{side}"
            if of == side and name in COORDINATE_INDEX:
                here[variable] = COORDINATE_INDEX[name]
                posture[:, here[variable]] = np.deg2rad(mean_over(found.values))
        errors = np.rad2deg(axes.coordinate_errors(np.nan_to_num(posture)))
        out |= {(side, variable): errors[:, column] for variable, column in here.items()}
    return out


def mean_over(values: Array) -> Array:
    """(m,) mean of rows (n, m) over what is known; NaN where nothing is."""
    known = np.isfinite(values)
    with np.errstate(invalid="ignore", divide="ignore"):
        out: Array = np.where(known, values, 0.0).sum(axis=0) / known.sum(axis=0)
    return out
