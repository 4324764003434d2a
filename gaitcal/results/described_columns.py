"""What every column of every table is, for the documentation; tests hold it against tables that were written.

A column's name may have `*` for a coordinate, a joint, a torque or a marker.
"""

from __future__ import annotations

from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Final

from gaitcal.gait.spatiotemporal import MEASURES


@dataclass(frozen=True)
class Described:
    """One column, or those of one pattern."""

    name: str
    unit: str
    text: str


def _columns(*rows: tuple[str, str, str]) -> tuple[Described, ...]:
    return tuple(Described(*row) for row in rows)


_TIME: Final = ("time", "s", "of the recording")
_VALID: Final = (
    ("valid", "0 or 1", "both legs count and a plate carries the body: pelvis, trunk and arms may be used"),
    ("valid_r", "0 or 1", "the right leg's values may be used"),
    ("valid_l", "0 or 1", "the left leg's values may be used"),
)
_WHO: Final = (
    ("person", "", "name in the study file"),
    ("session", "", "day or label in the study file; empty where there is none"),
)
_STRIDE: Final = (
    *_WHO,
    ("trial", "", "name of the walk"),
    ("side", "r or l", "foot whose stride it is"),
    ("stride", "", "number within trial and side; empty where the recording holds a part of the stride alone"),
)
_CYCLE: Final = (
    *_STRIDE,
    ("percent", "%", "0 at the strike of that foot, 100 at its next one"),
    ("variable", "", "what the value is; below"),
    ("value", "by variable", ""),
    ("se", "as the value", "standard error; empty where unknown"),
    ("valid", "0 or 1", "the value may be used"),
    ("se_stride", "as the value", "the part of `se` that differs from stride to stride"),
    ("turn", "deg", "how far the pelvis turns over the stride, to the left"),
)
_DIFFERENCE: Final = (
    ("difference", "unit", "b - a"),
    ("se", "unit", "standard error of the difference"),
    ("mdc95", "unit", "minimal detectable change, 1.96 standard errors"),
    ("exceeds", "0 or 1", "the difference is more than that"),
    ("strides_a", "", "strides of the first session"),
    ("strides_b", "", "strides of the second session"),
)

TABLES: Final[dict[str, tuple[Described, ...]]] = {
    "parameters": _columns(
        ("name", "", "as `hip_r.pelvis.ant` or `thigh_r.mass`"),
        ("kind", "", "joint position, joint orientation, mass, mass centre, moment of inertia"),
        ("segment", "", "segment that it lies in"),
        ("joint", "", "joint that it belongs to; empty for inertial parameters"),
        ("unit", "", "unit of the next three"),
        ("nominal", "unit", "from landmarks and anthropometric tables"),
        ("fitted", "unit", "after calibration"),
        ("standard_error", "unit", "empty where it was not fitted"),
        ("status", "", "`fitted`, `fixed` or `unidentifiable`"),
    ),
    "motion": _columns(
        _TIME,
        ("*_velocity", "deg/s, m/s", "exact derivative of the spline"),
        ("*_acceleration", "deg/s², m/s²", "exact second derivative"),
        ("*_se", "deg, m", "standard error, in gait trials"),
        ("*", "deg; pelvis_tx, _ty, _tz: m", "a coordinate"),
    ),
    "moments": _columns(
        _TIME,
        *_VALID,
        ("*_se", "N·m", "standard error; empty where unknown or not valid"),
        ("*_bwh", "%", "of body weight times height"),
        ("*", "N·m; pelvis_tx, _ty, _tz: N", "internal net torque about a coordinate; of the pelvis: the residual"),
    ),
    "powers": _columns(
        _TIME,
        *_VALID,
        ("*_se", "W", "standard error, of torque and velocity together"),
        ("*_per_kg", "W/kg", "by body mass"),
        ("*", "W", "power of a joint (`hip_power_r`) or of a coordinate (`hip_flexion_power_r`); generated: positive"),
    ),
    "moment_vectors": _columns(
        _TIME,
        *_VALID,
        ("*_se_stride", "N·m", "the part of the standard error that differs from stride to stride"),
        ("*_se", "N·m", "standard error"),
        ("*_proximal", "N·m", "along an axis of the proximal segment (ISB)"),
        ("*_distal", "N·m", "along an axis of the distal segment (ISB)"),
        ("*_jcs", "N·m", "projected on an axis of the joint coordinate system (Grood and Suntay 1983)"),
    ),
    "marker_errors": _columns(_TIME, ("*", "mm", "distance between measured and model marker; empty: not seen")),
    "cycles": _columns(*_CYCLE),
    "export_cycles": _columns(
        *_CYCLE, ("unit", "", "of the value"), ("positive", "", "what a positive value of this variable means")
    ),
    "ensemble": _columns(
        *_WHO,
        ("side", "r or l", "foot whose strides they are"),
        ("variable", "", "as in `cycles.csv`"),
        ("percent", "%", "of the stride"),
        ("n", "", "strides"),
        ("trials", "", "trials that they come from"),
        ("mean", "by variable", ""),
        ("sd", "by variable", "standard deviation over strides"),
        ("sd_within", "by variable", "between strides of a trial; empty where no trial has two"),
        ("sd_between", "by variable", "between trials"),
        ("sd_error", "by variable", "what of `sd` is measurement error, at most"),
        ("se", "by variable", "standard error of the mean, with the errors that all strides share"),
    ),
    "spatiotemporal": _columns(
        *_STRIDE,
        ("start", "s", "strike that begins it"),
        ("stop", "s", "strike that ends it"),
        ("source", "", "what told the events: file, plates or motion"),
        ("variable", "", ", ".join(f"`{name}`" for name in MEASURES)),
        ("unit", "", "of the value"),
        ("value", "unit", ""),
        ("valid", "0 or 1", "0 of a leg that is refused, and of steps and supports beside one"),
        ("turn", "deg", "how far the pelvis turns over the stride, to the left"),
    ),
    "montecarlo": _columns(
        ("set", "", "what was disturbed: `jp`, `ip`, `both`, `noise`"),
        ("level", "%", "of the bounds"),
        ("quantity", "", "torque, or markers"),
        ("grf", "", "ground reactions fixed in the laboratory (`lab`) or on the foot (`foot`)"),
        ("measure", "", "`rms`, `max` and others of the error over the frames"),
        ("unit", "", "of the distribution"),
        ("draws", "", "that count"),
        ("failed", "", "that did not converge, and are left out"),
        ("average", "unit", "mean over draws"),
        ("sd", "unit", "standard deviation over draws"),
        ("p*", "unit", "percentiles 10, 25, 50, 75, 90"),
        ("mean_settles", "%", "how much the mean still changes over the last draws"),
        ("cv_settles", "%", "the same of the coefficient of variation"),
    ),
    "contributions": _columns(
        ("torque", "", "which"),
        ("grf", "", "as in `montecarlo.csv`"),
        ("parameter", "", "as in `parameters.csv`"),
        ("kind", "", "joint position, joint orientation, mass, ..."),
        ("rms", "%BW·H", "torque error that this parameter alone makes, linearised"),
        ("share", "%", "of the variance"),
    ),
    "truth_parameters": _columns(
        ("name", "", "as in `parameters.csv`"),
        ("kind", "", "as there"),
        ("unit", "", "of the figures"),
        ("truth", "unit", "what the made-up person has"),
        ("nominal", "unit", "before calibration"),
        ("fitted", "unit", "after it"),
        ("standard_error", "unit", ""),
        ("error", "unit", "fitted minus truth"),
        ("z", "", "error in standard errors"),
        ("status", "", "as in `parameters.csv`"),
    ),
    "truth_curves": _columns(
        _TIME,
        ("*_error", "as the value", "calibrated minus true"),
        ("*_velocity", "deg/s, m/s", "true velocity"),
        ("*_acceleration", "deg/s², m/s²", "true acceleration"),
        ("*_bwh", "%", "of body weight times height"),
        ("*", "deg, m; torques N·m", "true value of a coordinate or torque"),
    ),
    "truth_values": _columns(
        ("name", "", "as in `parameters.csv`"), ("unit", "", "mm, deg, kg, ..."), ("value", "unit", "the truth")
    ),
    "landmarks": _columns(("name", "", "landmark"), ("[xyz]", "m", "in the laboratory, y up")),
    "column_meanings": _columns(("column", "", "its name"), ("unit", "", ""), ("meaning", "", "")),
    "failures": _columns(
        *_WHO,
        ("group", "", "as told in `people.csv` or `cohort.toml`"),
        ("folder", "", "with the recordings"),
        ("code", "", "code of the fault; `gaitcal explain CODE` tells more"),
        ("cause", "", "what is wrong"),
        ("what_to_do", "", "about it"),
    ),
    "times": _columns(
        *_WHO, ("seconds", "s", "of the calibration"), ("worker_mebibytes", "MiB", "most memory of the process so far")
    ),
    "priors": _columns(
        ("name", "", "joint parameter, as in `parameters.csv`"),
        ("unit", "", "mm or deg"),
        ("mean", "unit", "expected difference from the nominal value"),
        ("sd", "unit", "standard deviation of people about it"),
        ("default_sd", "unit", "standard deviation without a cohort"),
        ("learnt", "", "what of them was learnt, and what was not"),
    ),
    "differences": _columns(
        ("kind", "", "angle, moment, power, step, joint position, ..."),
        ("side", "r or l", ""),
        ("name", "", "variable, measure or joint parameter"),
        ("measure", "", "largest, smallest, range or mean, and in which phase"),
        ("unit", "", "of the figures"),
        ("a", "unit", "first session"),
        ("b", "unit", "second session"),
        *_DIFFERENCE,
        ("times", "", "absolute difference over `mdc95`"),
        ("se_strides", "unit", "by how strides vary"),
        ("se_shared", "unit", "by errors that all strides of a session share"),
    ),
    "curve_differences": _columns(
        ("kind", "", "angle, moment, power or force"),
        ("side", "r or l", "foot whose strides they are"),
        ("variable", "", "as in `cycles.csv`"),
        ("percent", "%", "of the stride"),
        ("unit", "", "of the figures"),
        ("a", "unit", "mean of the first session"),
        ("b", "unit", "mean of the second session"),
        *_DIFFERENCE,
    ),
    "shared_parameters": _columns(
        ("name", "", "joint parameter, as in `parameters.csv`"),
        ("unit", "", "mm or deg"),
        ("[ab]_alone", "unit", "of each session, by its own trials alone"),
        ("[ab]_shared", "unit", "of each session, by the trials of both"),
        ("*_se", "unit", "standard error"),
    ),
    "reproduced_tables": _columns(
        ("table", "", "of the paper"),
        ("row", "", ""),
        ("column", "", ""),
        ("published", "unit", "as printed"),
        ("ours", "unit", "in this run"),
        ("unit", "", ""),
        ("note", "", "range over draws, and where the printed figure lies"),
    ),
    "claims": _columns(
        ("kind", "", "`paper`, or `sensitivity`: ours, on what the paper does not say"),
        ("claim", "", "in words"),
        ("published", "", "the figure it stands on"),
        ("ours", "", "in this run"),
        ("verdict", "", "holds, does not hold, undecided, not run or not testable"),
    ),
}
"""Key of a table -> its columns, in order; the first pattern that fits a name is its own."""


def column_of(table: str, name: str) -> Described | None:
    """What is said of a column; None where nothing is."""
    return next((column for column in TABLES[table] if fnmatchcase(name, column.name)), None)
