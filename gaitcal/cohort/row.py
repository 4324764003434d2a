"""The row of the table of people that a result folder gives, from its files alone.

Fits join the walks: RMS = sqrt(sum n_i rms_i^2 / sum n_i) over n_i frames (residuals: valid frames) of walk i.
Peaks are of the mean over valid strides (`gait/ensemble.py`), where at least `LEAST_VALID` of its percents are valid;
moments and powers by body mass. Their standard error is that of the mean at that percent; of a range, whose ends are
far apart in the stride, it is taken as if their errors were independent: se = sqrt(se_max^2 + se_min^2).

The columns of the table of people: name, unit, what they mean. `columns.csv` says the same beside the tables.

Mean curves of a person over the stride as the page of a cohort takes them: small whole numbers, as text.

Of each variable and leg the mean over its valid straight strides (`gait/ensemble.py`) at every second percent, moments
and powers by body mass, as 16-bit integers in steps of a size that is the same for everybody: people can be packed one
by one. Three bytes are four letters of base64, and a person's bytes are divisible by three, so that people's texts one
behind the other are the text of all.
"""

from __future__ import annotations

import base64
import hashlib
import json
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np
import pandas as pd

from gaitcal.arrays import Array
from gaitcal.codes import Code
from gaitcal.errors import InputError
from gaitcal.faults.verdict import Judgement
from gaitcal.gait.cycles import Kind, kind_of
from gaitcal.gait.spatiotemporal import MEASURES
from gaitcal.gait.symmetry import LEAST_VALID
from gaitcal.io.lock import MANIFEST, read_object
from gaitcal.model.coordinates import COORDINATE_TABLE, LOCKED
from gaitcal.model.linkage import SIDES
from gaitcal.results.stride_files import ENSEMBLE
from gaitcal.results.table_file import read_csv
from gaitcal.results.verdict import SUMMARY

Cell: TypeAlias = str | int | float | None
"""Of the table of people."""
ANGLES: Final = tuple(r.name for r in COORDINATE_TABLE.values() if r.group != "arm" and r.name not in LOCKED)
MOMENTS: Final = tuple(
    f"{name}_moment"
    for name in ("hip_flexion", "hip_adduction", "hip_rotation", "knee_angle", "knee_adduction", "ankle_angle")
)
POWERS: Final = ("hip_power", "knee_power", "ankle_power")
UNITS: Final = {**dict.fromkeys(ANGLES, "deg"), **dict.fromkeys(MOMENTS, "N m/kg"), **dict.fromkeys(POWERS, "W/kg")}
"""Variable of `cycles.csv` -> unit of its peaks."""
PEAKS: Final = ("max", "min", "range")
MEASURED: Final = (
    *("speed", "cadence", "stride_length", "step_length", "step_width", "stride_time", "stance_percent"),
    *("double_support_percent", "single_support_percent"),
)
_FIT: Final = {
    "nominal": "of the model as palpated",
    "calibrated": "of the calibrated model",
    "rigid_floor": "that moving skin leaves to rigid segments without joints",
    "joint_floor": "that it leaves to segments with joints",
}
_WALKS: Final = "over all walks, frames counting alike (isolated trials where there is no walk)"


@dataclass(frozen=True)
class Column:
    """One column."""

    name: str
    kind: type
    """`str`, `int` or `float`."""
    unit: str
    meaning: str


def _columns() -> tuple[Column, ...]:
    out = [
        Column("person", str, "", "name"),
        Column("session", str, "", "empty where there is one only"),
        Column("group", str, "", "as people.csv or cohort.toml says"),
        Column("folder", str, "", "result folder, from where this table lies"),
        Column("page", str, "", "the result's page, from where this table lies"),
        Column("verdict", str, "", "trustworthy, doubtful or refused"),
        Column("verdict_r", str, "", "of the right leg: refused in every walk, or the worst of the other walks"),
        Column("verdict_l", str, "", "of the left leg"),
        Column("first_cause", str, "", "the worst reason of the verdict"),
        Column("first_action", str, "", "what to do about it"),
        Column("reasons", int, "", "number of reasons of the verdict"),
        Column("status", str, "", "converged or not converged"),
        Column("sex", str, "", "female or male"),
        Column("mass_kg", float, "kg", "body mass"),
        Column("height_m", float, "m", "body height"),
        Column("age_years", float, "years", "as told"),
        Column("walks", int, "", "walks that were used"),
        *(
            Column(f"walks_refused_{side}", int, "", f"walks in which the {word} leg is refused")
            for side, word in _LEGS
        ),
    ]
    for where, words in (("marker_rms", "all markers"), ("legs_rms", "markers of pelvis and legs")):
        for name, what in _FIT.items():
            out.append(Column(f"{where}_{name}_mm", float, "mm", f"RMS distance of {words} {what}, {_WALKS}"))
    for stage in ("nominal", "calibrated"):
        words = f"pelvis residual of the {stage} model, RMS over valid frames of all walks"
        out.append(Column(f"residual_force_{stage}_N", float, "N", words))
        out.append(Column(f"residual_moment_{stage}_Nm", float, "N m", words))
    words = "largest pelvis residual that errors explain, RMS over valid frames of all walks"
    out.append(Column("residual_force_limit_N", float, "N", words))
    out.append(Column("residual_moment_limit_Nm", float, "N m", words))
    for name in MEASURED:
        for side, word in _LEGS:
            where = f"{name} of the {word} leg's valid straight strides"
            out.append(Column(f"{name}_{side}", float, MEASURES[name], f"mean {where}"))
            out.append(Column(f"{name}_sd_{side}", float, MEASURES[name], f"standard deviation, {where}"))
    out += [Column(f"strides_{side}", int, "", f"valid straight strides of the {word} leg") for side, word in _LEGS]
    for variable, unit in UNITS.items():
        for peak in PEAKS:
            for side, word in _LEGS:
                words = f"{peak} of the mean curve of {variable} over strides of the {word} foot"
                out.append(Column(f"{variable}_{peak}_{side}", float, unit, words))
                out.append(Column(f"{variable}_{peak}_se_{side}", float, unit, f"standard error: {words}"))
    return (
        *out,
        Column("gaitcal", str, "", "version"),
        Column("settings_sha256", str, "", "of the settings in manifest.json"),
        Column("inputs_sha256", str, "", "of the SHA-256 of all inputs in manifest.json"),
    )


_LEGS: Final = tuple(zip(SIDES, ("right", "left"), strict=True))
COLUMNS: Final = _columns()
NAMES: Final = tuple(column.name for column in COLUMNS)


def peaks(ensemble: Path, mass: float) -> dict[str, float]:
    """Column -> value, of `ensemble.csv`; nothing of what is not known. `mass`: kg."""
    try:
        table, _ = read_csv(ensemble)
    except (OSError, pd.errors.EmptyDataError):
        return {}
    table = table[table["variable"].isin(UNITS) & table["side"].isin(SIDES)]
    curves = {name: pd.to_numeric(table[name], errors="coerce").to_numpy(np.float64) for name in ("mean", "se")}
    out: dict[str, float] = {}
    for (variable, side), rows in table.groupby(["variable", "side"], sort=False).indices.items():
        scale = 1.0 if variable in ANGLES else 1.0 / mass
        for peak, (value, error) in _peaks(scale * curves["mean"][rows], scale * curves["se"][rows]).items():
            out[f"{variable}_{peak}_{side}"] = value
            out[f"{variable}_{peak}_se_{side}"] = error
    return out


def _peaks(mean: Array, error: Array) -> dict[str, tuple[float, float]]:
    """Of one curve (101,): value and standard error of each kind."""
    if np.isfinite(mean).mean() < LEAST_VALID:
        return {}
    high, low = int(np.nanargmax(mean)), int(np.nanargmin(mean))
    return {
        "max": (float(mean[high]), float(error[high])),
        "min": (float(mean[low]), float(error[low])),
        "range": (float(mean[high] - mean[low]), float(np.hypot(error[high], error[low]))),
    }


PAGES = ("result.html", "report.html")
"""The first of them that is there is the person's page."""
DIGITS = 6
_FITS = {"marker_rms": "rms_mm", "legs_rms": "pelvis_and_legs_mm"}


def row_of(folder: Path) -> dict[str, Cell]:
    """Column -> value of a result folder, all but those of the cohort itself (group, folder, ...).

    Raises
    ------
    InputError
        It is no result of a calibration.
    """
    manifest: dict[str, Any] = read_object(folder / MANIFEST)
    summary: dict[str, Any] = read_object(folder / SUMMARY)
    if "subject" not in manifest or "trials" not in summary:
        raise InputError("is no result of 'gaitcal calibrate'", source=folder, code=Code.NO_RESULT)
    subject, reasons = manifest["subject"], summary.get("reasons") or [{}]
    trials: dict[str, dict[str, Any]] = summary["trials"]
    walks = [trial for trial in trials.values() if trial.get("role") == "gait"]
    row: dict[str, Cell] = {
        "person": subject["name"],
        "page": next((name for name in PAGES if (folder / name).is_file()), ""),
        "verdict": summary["verdict"],
        "first_cause": reasons[0].get("cause", ""),
        "first_action": reasons[0].get("action", ""),
        "reasons": len(summary.get("reasons") or ()),
        "status": summary.get("status", ""),
        **{name: subject.get(name) for name in ("sex", "mass_kg", "height_m", "age_years")},
        "walks": len(walks),
        **_legs(walks),
        **dict(_fits(walks or list(trials.values()))),
        **dict(_residuals(walks)),
        **dict(_spatiotemporal(summary.get("spatiotemporal") or {})),
        **peaks(folder / ENSEMBLE, float(subject["mass_kg"])),
        "gaitcal": manifest["gaitcal"],
        "settings_sha256": _digest(manifest.get("settings")),
        "inputs_sha256": _digest(manifest.get("inputs_sha256")),
    }
    return {name: _cell(row[name]) for name in NAMES if name in row}


def reasons_of(folder: Path) -> tuple[dict[str, str], ...]:
    """Severity, cause and action of every reason of a result folder's verdict, the worst first."""
    summary: dict[str, Any] = read_object(folder / SUMMARY)
    found: Iterable[Mapping[str, Any]] = summary.get("reasons") or ()
    return tuple({name: str(reason.get(name) or "") for name in ("severity", "cause", "action")} for reason in found)


def _cell(value: Cell) -> Cell:
    if isinstance(value, float):
        return round(value, DIGITS) if math.isfinite(value) else None
    return value


def _digest(content: object) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _legs(walks: Iterable[Mapping[str, Any]]) -> dict[str, Cell]:
    """Verdict of each leg, and in how many walks it is refused."""
    out: dict[str, Cell] = {}
    for side in SIDES:
        said = [Judgement(walk[f"verdict_{side}"]) for walk in walks if f"verdict_{side}" in walk]
        left = [judgement for judgement in said if judgement is not Judgement.REFUSED]
        judged = Judgement.worst(left) if left else Judgement.REFUSED
        out[f"verdict_{side}"] = judged.value if said else ""
        out[f"walks_refused_{side}"] = len(said) - len(left)
    return out


def _fits(trials: Iterable[Mapping[str, Any]]) -> Iterator[tuple[str, Cell]]:
    found = list(trials)
    for where, entry in _FITS.items():
        for name in ("nominal", "calibrated", "rigid_floor", "joint_floor"):
            pairs = [(t["frames"], (t.get(entry) or t.get("rms_mm") or {}).get(name)) for t in found if "frames" in t]
            yield f"{where}_{name}_mm", _together(pairs)


def _residuals(walks: Iterable[Mapping[str, Any]]) -> Iterator[tuple[str, Cell]]:
    told = [
        (walk["valid_frames"], list(walk["pelvis_residual"].values())) for walk in walks if "pelvis_residual" in walk
    ]
    for name, k in (("nominal", 0), ("calibrated", -1)):
        yield f"residual_force_{name}_N", _together([(n, stages[k]["force_N"]) for n, stages in told])
        yield f"residual_moment_{name}_Nm", _together([(n, stages[k]["torque_Nm"]) for n, stages in told])
    limits = [
        (walk["valid_frames"], walk["pelvis_residual_limit"]) for walk in walks if "pelvis_residual_limit" in walk
    ]
    yield "residual_force_limit_N", _together([(n, limit["force_N"]) for n, limit in limits])
    yield "residual_moment_limit_Nm", _together([(n, limit["torque_Nm"]) for n, limit in limits])


def _together(pairs: Iterable[tuple[int, float | None]]) -> float | None:
    """RMS over trials of so many frames; None where none tells it."""
    known = [(n, value) for n, value in pairs if value is not None]
    frames = sum(n for n, _ in known)
    return math.sqrt(sum(n * value**2 for n, value in known) / frames) if frames else None


def _spatiotemporal(means: Mapping[str, Mapping[str, Any]]) -> Iterator[tuple[str, Cell]]:
    for side in SIDES:
        for name in MEASURED:
            found = means.get(name, {}).get(side) or {}
            yield f"{name}_{side}", found.get("mean")
            yield f"{name}_sd_{side}", found.get("sd")
        yield f"strides_{side}", (means.get("stride_time", {}).get(side) or {}).get("strides", 0)


EVERY: Final = 2
"""% of the stride between two points."""
POINTS: Final = 100 // EVERY + 1
GAP: Final = -32768
STEPS: Final = {Kind.ANGLE: 0.01, Kind.MOMENT: 0.0005, Kind.POWER: 0.002}
"""What one of the whole numbers is: deg, N m/kg, W/kg."""
VARIABLES: Final = (
    *("hip_flexion", "hip_flexion_moment", "hip_power", "hip_adduction", "hip_adduction_moment", "hip_rotation"),
    *("knee_angle", "knee_angle_moment", "knee_power", "knee_adduction_moment"),
    *("ankle_angle", "ankle_angle_moment", "ankle_power"),
)
"""Of `cycles.csv`, in the order of the packed curves; right before left."""
SHAPE: Final = (len(VARIABLES), len(SIDES), POINTS)


def mean_curves(ensemble: Path, mass: float) -> str:
    """Base64 of the curves of `ensemble.csv`, little-endian integers of `SHAPE`; empty where there is none.

    Parameters
    ----------
    mass : kg.
    """
    try:
        table, _ = read_csv(ensemble)
    except (OSError, pd.errors.EmptyDataError):
        return ""
    packed = np.full(SHAPE, GAP, dtype="<i2")
    table = table[table["variable"].isin(VARIABLES) & table["side"].isin(SIDES)]
    values = pd.to_numeric(table["mean"], errors="coerce").to_numpy(np.float64)
    percent = pd.to_numeric(table["percent"], errors="coerce").to_numpy(np.float64)
    for (variable, side), rows in table.groupby(["variable", "side"], sort=False).indices.items():
        kind = kind_of(variable)
        mean = values[rows] / (1.0 if kind is Kind.ANGLE else mass)
        packed[VARIABLES.index(variable), SIDES.index(side)] = _whole(percent[rows], mean, STEPS[kind])
    if (packed == GAP).all():
        return ""
    return base64.b64encode(packed.tobytes()).decode("ascii")


def no_curves() -> str:
    """The curves of somebody who has none."""
    return base64.b64encode(np.full(SHAPE, GAP, dtype="<i2").tobytes()).decode("ascii")


def _whole(percent: Array, mean: Array, step: float) -> Array:
    out = np.full(POINTS, GAP, dtype="<i2")
    here = np.isfinite(mean) & (percent % EVERY == 0)
    limit = -GAP - 1
    out[(percent[here] / EVERY).astype(int)] = np.clip(np.rint(mean[here] / step), -limit, limit)
    return out
