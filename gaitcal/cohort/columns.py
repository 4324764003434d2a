"""The columns of the table of people: name, unit, what they mean. `columns.csv` says the same beside the tables."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from gaitcal.gait.spatiotemporal import MEASURES
from gaitcal.model.coordinates import COORDINATE_TABLE, LOCKED
from gaitcal.model.linkage import SIDES

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
