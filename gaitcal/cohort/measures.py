"""What a clinician asks of a person first, as the page of a cohort names it: joined from columns of the table."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any, Final

from gaitcal.records import dataclass


@dataclass(frozen=True, kw_only=True)
class Measure:
    """One measure."""

    name: str
    title: str
    unit: str
    digits: int
    column: str
    """Of the table of people; `{}` stands for the leg, `r` or `l`, where it has one for each."""
    error: str = ""
    """Column of its standard error."""
    sign: int = 1
    """-1: it is the column's opposite."""
    joined: str = ""
    """How the legs' columns become one number: `mean`, or `asymmetry` = 200 % (r - l) / (r + l); empty: each has its
    own."""


def _peak(name: str, title: str, unit: str, variable: str, peak: str) -> Measure:
    column, error = f"{variable}_{peak}_{{}}", f"{variable}_{peak}_se_{{}}"
    digits, sign = (1 if unit == "deg" else 2), (-1 if peak == "min" else 1)
    title = f"{title}, peak of mean curve"
    return Measure(name=name, title=title, unit=unit, digits=digits, column=column, error=error, sign=sign)


MEASURES: Final = (
    Measure(name="mass", title="Mass", unit="kg", digits=1, column="mass_kg"),
    Measure(name="height", title="Height", unit="m", digits=2, column="height_m"),
    Measure(
        name="marker_rms", title="Marker RMS, pelvis and legs", unit="mm", digits=1, column="legs_rms_calibrated_mm"
    ),
    Measure(name="residual", title="Pelvis residual", unit="N", digits=1, column="residual_force_calibrated_N"),
    Measure(name="speed", title="Speed", unit="m/s", digits=2, column="speed_{}", joined="mean"),
    Measure(name="cadence", title="Cadence", unit="steps/min", digits=0, column="cadence_{}", joined="mean"),
    Measure(
        name="step_asymmetry",
        title="Step length asymmetry",
        unit="%",
        digits=1,
        column="step_length_{}",
        joined="asymmetry",
    ),
    _peak("knee_flexion", "Knee flexion", "deg", "knee_angle", "max"),
    _peak("hip_extension", "Hip extension", "deg", "hip_flexion", "min"),
    _peak("plantarflexion_moment", "Ankle plantarflexor moment", "N m/kg", "ankle_angle_moment", "min"),
    _peak("ankle_power", "Ankle power", "W/kg", "ankle_power", "max"),
    _peak("adduction_moment", "Knee adduction moment (external)", "N m/kg", "knee_adduction_moment", "min"),
)


def measures() -> list[dict[str, Any]]:
    """As plain data."""
    return [asdict(measure) for measure in MEASURES]
