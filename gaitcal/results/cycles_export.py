"""The strides of a result in a convention of the user's choice: one table, each row with its unit and what is positive.

Angles, powers, moments of the coordinates and which of them count are those of `cycles.csv`; moments in the frames of
segments or of the joint coordinate system come from `moment_vectors/TRIAL.csv`, over the same strides.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from gaitcal.arrays import Array
from gaitcal.codes import Code
from gaitcal.dynamics.ground_contact import leg_of
from gaitcal.dynamics.joint_moments import MomentFrame
from gaitcal.errors import InputError
from gaitcal.gait.conventions import Convention
from gaitcal.gait.cycles import POINTS, FootEvents, GaitCycle, gait_cycles, normalise
from gaitcal.gait.events import times_of
from gaitcal.io.metadata import FootMoment
from gaitcal.io.ownership import MANIFEST, read_object
from gaitcal.io.snapshot import Snapshot, read_whole
from gaitcal.model.linkage import SIDES
from gaitcal.model.subject_model import Subject, SubjectModel
from gaitcal.results.cycles import CYCLES, DIGITS
from gaitcal.results.kinetics import VECTOR_FOLDER, read_vectors
from gaitcal.results.saved_trial import saved_events
from gaitcal.results.table_file import VERDICT, read_csv, write_csv
from gaitcal.results.verdict import SUMMARY
from gaitcal.session.kinetic_tables import told_components, vector_column

MOMENT, POWER, FORCE = "_moment", "_power", "ground_reaction_vertical"
NUMBERS = ("value", "se", "se_stride")
"""Columns that a convention changes; the second part of the error where the table has it."""
HEADER = (
    "strides of each foot, from its strike (0 %) to its next one (100 %), numbered from 1 in each trial and side",
    "se: standard error, se_stride: the part of it that strides do not share, empty where unknown; valid: 1 where the",
    "value may be used; as in cycles.csv of the result",
)
"""Comment lines above the header, before those of the convention."""
RELATIVE = ("joint angles are relative", "static trial, deg")
"""How the comment lines begin that tell of angles from the static posture."""


@dataclass(frozen=True)
class _Result:
    """What is read of a result."""

    model: SubjectModel
    table: pd.DataFrame
    """`cycles.csv`, as text."""
    comments: tuple[str, ...]
    strides: Mapping[tuple[str, str], tuple[GaitCycle, ...]]
    """Trial and side -> strides."""
    vectors: Mapping[str, pd.DataFrame]
    """Trial -> table of moment vectors."""


def write_cycles_export(
    folder: Path, convention: Convention, target: Path, model: SubjectModel
) -> tuple[int, Snapshot]:
    """Write the strides of the result in `folder` to `target`; returns how many rows, and what was read.

    `model`: of the result, or of that which further trials in `folder` (`gaitcal dynamics`) were made with.

    Raises
    ------
    InputError
        The result is damaged, or has no strides.
    """
    frame = convention.frame
    names = [CYCLES, SUMMARY]
    if frame is not MomentFrame.COORDINATES:
        names += sorted(path.relative_to(folder).as_posix() for path in (folder / VECTOR_FOLDER).glob("*.csv"))
    if not (folder / CYCLES).exists():
        raise InputError(f"has no {CYCLES}; calibrate again", source=folder, code=Code.NO_RESULT)
    found, snapshot = read_whole(folder, names, lambda: _read(folder, frame, model))
    table = in_convention(found, convention)
    write_csv(table, target, (*found.comments, *HEADER, *convention.lines))
    return len(table), snapshot


def made_with_another_model(folder: Path, digest: str | None) -> tuple[str, ...]:
    """Further trials in `folder` that were made with another model than that of this SHA-256."""
    made = read_object(folder / MANIFEST).get("model_sha256")
    return tuple(str(trial) for trial, of in made.items() if of != digest) if isinstance(made, dict) else ()


def _read(folder: Path, frame: MomentFrame, model: SubjectModel) -> _Result:
    table, comments = read_csv(folder / CYCLES)
    trials = read_object(folder / SUMMARY).get("trials")
    strides: dict[tuple[str, str], tuple[GaitCycle, ...]] = {}
    vectors = {}
    for name in dict.fromkeys(table["trial"]):
        about = trials.get(name) if isinstance(trials, dict) else None
        events = saved_events(about.get("events") if isinstance(about, dict) else None)
        right, left = (
            FootEvents(
                np.array(times_of(events, side, FootMoment.STRIKE)), np.array(times_of(events, side, FootMoment.OFF))
            )
            for side in SIDES
        )
        strides |= {(name, "r"): gait_cycles(right, left), (name, "l"): gait_cycles(left, right)}
        of_trial = None if frame is MomentFrame.COORDINATES else read_vectors(folder, name)
        if of_trial is not None:
            vectors[name] = of_trial
        elif frame is not MomentFrame.COORDINATES and _has_moments(table, name):
            message = f"has no {VECTOR_FOLDER}/{name}.csv, which moments in this frame need; calibrate again"
            raise InputError(message, source=folder, code=Code.DAMAGED_RESULT)
    # the head of cycles.csv says how trials stand, and OpenSim's convention, which is no longer true
    told = (*(f"{name}: {VERDICT}" for name, _ in strides), *RELATIVE)
    kept = tuple(line for line in comments if line.startswith(told))
    return _Result(model, table, kept, strides, vectors)


def _has_moments(table: pd.DataFrame, trial: str) -> bool:
    return bool((table["trial"].eq(trial) & table["variable"].str.endswith(MOMENT)).any())


def in_convention(found: _Result, convention: Convention) -> pd.DataFrame:
    """The rows of `cycles.csv` in another convention, with `unit` and `positive` at the end."""
    numbers = [name for name in NUMBERS if name in found.table]
    table = found.table.assign(**{name: pd.to_numeric(found.table[name]) for name in numbers})
    if convention.frame is not MomentFrame.COORDINATES:
        kept = table[~table["variable"].str.endswith(MOMENT)]
        table = pd.concat([kept, *_vector_rows(found, convention.frame)], ignore_index=True)
    subject, parts = found.model.subject, []
    for (variable, side), rows in table.groupby(["variable", "side"], sort=False):
        parts.append(_converted(rows, str(variable), str(side), convention, subject, numbers))
    whole = pd.concat(parts).sort_index() if parts else table.assign(unit="", positive="")
    whole[numbers] = whole[numbers].round(DIGITS)
    return whole


def _converted(
    rows: pd.DataFrame, variable: str, side: str, convention: Convention, subject: Subject, numbers: list[str]
) -> pd.DataFrame:
    """Rows of one variable of strides of one side."""

    def told(values: Array) -> Array:
        if variable.endswith(MOMENT):
            return convention.moment(variable.removesuffix(MOMENT), values, subject)
        if variable.endswith(POWER):
            return convention.power(values, subject)
        return values if variable == FORCE else convention.angle(variable, values, side)

    changed = {name: told(rows[name].to_numpy(dtype=np.float64)) for name in numbers}
    changed |= {name: np.abs(values) for name, values in changed.items() if name != "value"}
    if variable.endswith(MOMENT):
        unit, positive = convention.unit.words, convention.positive_moment(variable.removesuffix(MOMENT))
    elif variable.endswith(POWER):
        unit, positive = convention.unit.power, "generated"
    elif variable == FORCE:
        unit, positive = "N", "upward"
    else:
        unit, positive = "deg", convention.positive_angle(variable, side)
    return rows.assign(**changed, unit=unit, positive=positive)


def _vector_rows(found: _Result, frame: MomentFrame) -> list[pd.DataFrame]:
    """Rows of the moments in a frame of segments or of the joint coordinate system, stride by stride."""
    same = [name for name in ("person", "session") if name in found.table]
    parts = []
    for (trial, side), cycles in found.strides.items():
        table = found.vectors.get(trial)
        of_trial = found.table[(found.table["trial"] == trial) & (found.table["side"] == side)]
        if table is None or of_trial.empty:
            continue
        if len(cycles) != of_trial["stride"].nunique():
            raise InputError(
                f"{CYCLES} and {SUMMARY} differ in the strides of '{trial}'; calibrate again", code=Code.DAMAGED_RESULT
            )
        first = of_trial.iloc[0]
        time, unknown = table["time"].to_numpy(dtype=np.float64), np.full(len(table), np.nan)
        names = [name for name in told_components(found.model.frozen) if leg_of(name) in (side, "")]
        with_turn = of_trial.drop_duplicates("stride") if "turn" in of_trial else of_trial.iloc[:0]
        turn_of = {str(row["stride"]): {"turn": row["turn"]} for _, row in with_turn.iterrows()}
        for stride, cycle in enumerate(cycles, start=1):
            for name in names:
                own = leg_of(name)
                column, counts = vector_column(name, frame), f"valid_{own}" if own else "valid"
                usable = np.where(table[counts].to_numpy() == 1, 1.0, np.nan)
                told = (table.get(f"{column}{ending}", unknown) for ending in ("", "_se", "_se_stride"))
                value, error, differing, valid = (
                    normalise(time, np.asarray(values, dtype=np.float64), cycle) for values in (*told, usable)
                )
                parts.append(
                    pd.DataFrame(
                        {
                            **{key: first[key] for key in same},
                            "trial": trial,
                            "side": side,
                            "stride": str(stride),
                            "percent": np.arange(POINTS).astype(str),
                            "variable": f"{name[:-2] if own else name}{MOMENT}",
                            "value": value,
                            "se": error,
                            "valid": np.isfinite(valid).astype(int).astype(str),
                            **({"se_stride": differing} if "se_stride" in found.table else {}),
                            **turn_of.get(str(stride), {}),
                        }
                    )
                )
    return parts
