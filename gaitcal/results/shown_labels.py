"""Labels, units and decimals that page, PDF and figures share.

Labels of joints, segments and moments are in `gait/moments.py`, of coordinates in
`model/coordinates.py` and `gait/conventions.py`, of fitted parameters in
`results/parameter_labels.py`.
"""

from typing import Final

from gaitcal.gait.cycles import CurveKind
from gaitcal.model import anthropometry
from gaitcal.model.subject_model import Subject

SHOWN_MEASURES: Final = {
    "speed": ("Walking speed", 2),
    "cadence": ("Cadence", 1),
    "stride_length": ("Stride length", 3),
    "stride_time": ("Stride time", 3),
    "step_length": ("Step length", 3),
    "step_width": ("Step width", 3),
    "step_time": ("Step time", 3),
    "stance_percent": ("Stance", 1),
    "swing_percent": ("Swing", 1),
    "double_support_percent": ("Double support", 1),
    "single_support_percent": ("Single support", 1),
}
"""Measure -> its label and decimals in the table of steps and phases; `spatiotemporal.csv` has all
of them.
"""
PAGE_UNITS: Final = {
    "Nm": {
        CurveKind.ANGLE: ("°", 1, 1.0, ""),
        CurveKind.MOMENT: ("N·m", 1, 1.0, ""),
        CurveKind.POWER: ("W", 0, 1.0, ""),
        CurveKind.FORCE: ("N", 0, 1.0, ""),
    },
    "Nm/kg": {
        CurveKind.ANGLE: ("°", 1, 1.0, ""),
        CurveKind.MOMENT: ("N·m/kg", 2, 1.0, "mass"),
        CurveKind.POWER: ("W/kg", 2, 1.0, "mass"),
        CurveKind.FORCE: ("N/kg", 2, 1.0, "mass"),
    },
    "%BWH": {
        CurveKind.ANGLE: ("°", 1, 1.0, ""),
        CurveKind.MOMENT: ("%BW·H", 2, 100.0, "bwh"),
        CurveKind.POWER: ("W/kg", 2, 1.0, "mass"),
        CurveKind.FORCE: ("%BW", 1, 100.0, "weight"),
    },
}
"""Unit of moments on the page -> of each kind of curve its unit, digits, a factor, and by what of
the person it is divided.
"""
PAPER_UNITS: Final = {
    kind: "deg" if kind is CurveKind.ANGLE else unit
    for kind, (unit, *_) in PAGE_UNITS["Nm/kg"].items()
}
"""Unit of each kind of curve of a printed report."""
TRIAL_CURVES: Final = {
    "residual_force": "Residual force at the pelvis",
    "residual_moment": "Residual moment at the pelvis",
    "marker_error": "Marker error, RMS over the markers",
}
"""Kind of a curve of a whole trial -> its title."""
UNIT_WORDS: Final = {"N m": "N·m"}
"""Unit in tables -> the same on the page, where they differ."""


def list_person_facts(subject: Subject) -> tuple[tuple[str, str], ...]:
    """List label and value of the known data of subject and session, as page and report show it.

    Missing age, sex and date are listed as missing, and so is the use of the adults' mass table.
    """
    record = subject.record
    age = "not given" if subject.age is None else f"{subject.age:.1f} years"
    adults = anthropometry.is_probably_child(subject)
    facts = (
        ("Name or code", subject.name),
        (
            "Session",
            ", ".join(filter(None, dict.fromkeys((record.session_date, subject.session))))
            or "date not recorded",
        ),
        ("Sex", subject.sex or "not given"),
        ("Age", f"{age}, born {record.birth_date}" if record.birth_date else age),
        ("Diagnosis", record.diagnosis),
        ("Affected side", record.affected_side),
        ("Aids", record.aids),
        ("Body mass", f"{subject.mass:.1f} kg"),
        (
            "Height",
            f"{subject.height:.3f} m"
            + (f" ± {subject.height_error:.2f} m" if subject.height_error else ""),
        ),
        ("Segment masses", "adults' table: age not given" if adults else ""),
        ("Laboratory", record.laboratory),
    )
    return tuple((label, value) for label, value in facts if value)
