"""The table of strides, `cycles.csv`: angles and torques of each complete one over 0 to 100 % of it, in long form."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from gaitcal.arrays import Array, BoolArray
from gaitcal.dynamics.ground_contact import leg_of
from gaitcal.gait.cycles import POINTS, GaitCycle, normalise
from gaitcal.gait.moments import moment_names, moment_of
from gaitcal.gait.strides import strides_of
from gaitcal.model.linkage import SIDES, is_translation
from gaitcal.model.subject_model import SubjectModel
from gaitcal.person.result import TrialResult
from gaitcal.person.tables import taken_off

CYCLE_COLUMNS = ("trial", "side", "stride", "percent", "variable", "value", "se", "valid")
CYCLE_HEADER = (
    "strides of each foot, from its strike (0 %) to its next one (100 %), numbered from 1 in each trial and side",
    "variable: a coordinate of the leg of that side (without the side in its name), of pelvis or trunk: its angle in",
    "degrees; with _moment its internal moment in N m; se: standard error, empty where unknown",
    "valid: 1 where the value may be used: moments of a leg by its own foot, of the trunk by both",
)
"""Comment lines above the header."""
DIGITS = 6


@dataclass(frozen=True)
class _Signal:
    """One variable over the frames of a trial."""

    name: str
    value: Array
    error: Array | None
    valid: BoolArray


def cycle_table(
    model: SubjectModel, trials: Sequence[TrialResult], relative_to: Mapping[str, float] | None = None
) -> pd.DataFrame:
    """Every variable of every complete stride of the gait trials, with `CYCLE_COLUMNS`; no row where there is none.

    `relative_to`: coordinate -> rad in the static posture, taken off the joint angles; None: they are anatomical.
    """
    parts = []
    for trial in trials:
        if trial.joint is None:
            for side, cycles in strides_of(trial.events).items():
                signals = list(_signals(model, trial, side, taken_off(relative_to)))
                parts += [_rows(trial, side, k, cycle, signals) for k, cycle in enumerate(cycles, start=1)]
    return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame(columns=list(CYCLE_COLUMNS))


def _signals(model: SubjectModel, trial: TrialResult, side: str, static: Mapping[str, float]) -> Iterator[_Signal]:
    """Of the leg of one side, and of what belongs to neither; arms are left out."""
    body, frozen, loads = trial.body, set(model.frozen), trial.loads
    other = next(s for s in SIDES if s != side)
    wanted = [name for name in body.coordinates if leg_of(name) == side or name.startswith(("pelvis", "lumbar"))]
    for k, name in enumerate(body.coordinates):
        if name in wanted and name not in frozen and not is_translation(name):
            error = None if trial.coordinate_errors is None else np.degrees(trial.coordinate_errors[:, k])
            usable = np.full(len(body.time), leg_of(name) not in trial.refused_legs)
            yield _Signal(_plain(name), np.degrees(body.q[:, k] - static.get(name, 0.0)), error, usable)
    if loads is None:
        return
    for name in moment_names(model):
        if leg_of(name) == other or not (leg_of(name) or name.startswith("lumbar")):
            continue
        error = None if loads.errors is None else moment_of(loads.errors, name)
        valid = loads.reactions.valid_for(name)
        yield _Signal(f"{_plain(name)}_moment", moment_of(loads.final, name), error, valid)


def _plain(name: str) -> str:
    """A coordinate's name without the side of its leg."""
    return name[:-2] if leg_of(name) else name


def _rows(trial: TrialResult, side: str, stride: int, cycle: GaitCycle, signals: Sequence[_Signal]) -> pd.DataFrame:
    time, count = trial.body.time, len(signals)

    def laid(values: Sequence[Array]) -> Array:
        out: Array = normalise(time, np.stack(values, axis=1), cycle).T.ravel()
        return out

    unknown = np.full(len(time), np.nan)
    usable = laid([np.where(s.valid, 1.0, np.nan) for s in signals])
    return pd.DataFrame(
        {
            "trial": trial.name,
            "side": side,
            "stride": stride,
            "percent": np.tile(np.arange(POINTS), count),
            "variable": np.repeat([s.name for s in signals], POINTS),
            "value": _short(laid([s.value for s in signals])),
            "se": _short(laid([unknown if s.error is None else s.error for s in signals])),
            "valid": np.isfinite(usable).astype(int),
        }
    )


def _short(values: Array) -> Array:
    """Rounded to a millionth of a degree or newton metre."""
    out: Array = np.round(values, DIGITS)
    return out
