"""Read one result for a comparison, and collect the strides of one variable of one leg.

The error of a stride has two parts (`gait/ensemble.py`): s_ij of the single stride, and c, which
all strides of one calibrated subject share, c^2 = se_ij^2 - s_ij^2. The part f of c is common to
two sessions on one static trial: axes of the segments and, for loads, masses.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np
import pandas as pd

from gaitcal.arrays import Array
from gaitcal.calibration.error_sources import ErrorSources
from gaitcal.dynamics.measurement_errors import AxisErrors
from gaitcal.errors import Code, InputError
from gaitcal.export.opensim.peer_model import measure_our_leg
from gaitcal.gait.cycles import POINTS, WALKING, CurveKind, get_coordinate, get_curve_kind
from gaitcal.gait.strides import TURNING
from gaitcal.model.linkage import COORDINATE_INDEX, SIDES
from gaitcal.model.subject_model import SubjectModel
from gaitcal.study.normal_prior import JointPrior


class NotComparableError(InputError):
    """Two results that cannot be compared."""

    code = Code.NOT_COMPARABLE


@dataclass(frozen=True, kw_only=True)
class RecordedSession:
    """Tables and model of a result."""

    name: str  # Of its folder
    model: SubjectModel
    model_key: str  # SHA-256 of the model: the same in two results of one calibration
    statics: tuple[
        str, ...
    ]  # SHA-256 of the files that its model was made of while the person stood
    recordings: frozenset[str]  # SHA-256 of the files of its walks
    influence: (
        ErrorSources | None
    )  # Errors of the joint parameters by source; None where they were not calibrated
    strides: pd.DataFrame  # `cycles.csv`, with numbers for text
    measures: pd.DataFrame  # `spatiotemporal.csv`, with numbers for text
    verdict: str  # `trustworthy`, `doubtful` or `refused`; empty if there is none
    reasons: tuple[str, ...] = ()  # Why, a sentence each
    remarks: tuple[str, ...] = ()
    """Remarks on its files: edited, or made with another model than the present one."""
    axis_deviations: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    """Segment -> deg, standard errors of its axes (`dynamics/measurement_errors.py`)."""
    error_shares: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Torque -> source -> part of the variance of its error, 0 to 1."""
    prior: JointPrior | None = None
    """Of its joint parameters, by its settings; None: anatomy's. A cohort's is not in a result."""
    relative: bool = False  # Joint angles are counted from the static posture


class Common(Enum):
    """What two results share, and therefore no error of a difference; with a description."""

    MODEL = "one model: its errors are the same in both, and cancel"
    STATIC = (
        "one static trial, a calibration each: nominal joints, marker positions and segment axes "
        "are the same"
    )
    PERSON = "a static trial each: markers were placed again, and no error is the same in both"

    def __init__(self, description: str) -> None:
        self.description = description


def find_common(a: RecordedSession, b: RecordedSession) -> Common:
    """Find what two results of one subject share."""
    if a.model_key == b.model_key:
        return Common.MODEL
    same_files = bool(a.statics) and a.statics == b.statics
    nominal = a.model.nominal.joint, b.model.nominal.joint
    return (
        Common.STATIC
        if same_files and np.allclose(*nominal, rtol=0.0, atol=SAME)
        else Common.PERSON
    )


SAME = 1e-9  # m, rad: nominal joints that differ by less are the same
LENGTHS = ("thigh", "shank")
NOT_ONE, DOUBTFUL = 0.15, 0.06
"""Relative difference of a length from which two results are not of one person, and from which that
is doubtful: joint centres of two sessions are some 10 to 20 mm apart on segments of 400."""


@dataclass(frozen=True)
class Identity:
    """Evidence that two results are not of one subject."""

    doubts: tuple[str, ...]
    denied: tuple[str, ...]  # What no two results of one person have


def check_identity(a: RecordedSession, b: RecordedSession) -> Identity:
    """Compare name, sex, height and the lengths of thighs and shanks."""
    subject_a, subject_b = a.model.subject, b.model.subject
    doubts, denied = list[str](), list[str]()
    if subject_a.name != subject_b.name:
        doubts.append(f"the names differ: '{subject_a.name}' and '{subject_b.name}'")
    if subject_a.sex and subject_b.sex and subject_a.sex != subject_b.sex:
        doubts.append(f"{subject_a.sex} in {a.name}, {subject_b.sex} in {b.name}")
    if abs(subject_b.height - subject_a.height) > DOUBTFUL * subject_a.height:
        doubts.append(
            f"{subject_a.height:.2f} m tall in {a.name}, {subject_b.height:.2f} m in {b.name}"
        )
    # Bones do not change between sessions: the lengths of thighs and shanks identify a person.
    for name, (of_a, of_b) in _measure_lengths(a, b).items():
        change = abs(of_b - of_a) / max(of_a, 1e-6)
        if change > DOUBTFUL:
            doubts_or_denied = denied if change > NOT_ONE else doubts
            doubts_or_denied.append(
                f"{name} {1e3 * of_a:.0f} mm long in {a.name}, {1e3 * of_b:.0f} mm in {b.name}"
            )
    return Identity(tuple(doubts), tuple(denied))


def _measure_lengths(a: RecordedSession, b: RecordedSession) -> dict[str, tuple[float, float]]:
    """Measure each segment in both sessions: name -> m."""
    out = {}
    for side, word in zip(SIDES, ("right", "left"), strict=True):
        legs = [measure_our_leg(s.model.parameters, side) for s in (a, b)]
        for part in LENGTHS:
            of_a, of_b = (getattr(leg, f"{part}_length") for leg in legs)
            out[f"{word} {part}"] = (of_a, of_b)
    return out


def compute_shared_part(session: RecordedSession, torque: str) -> float:
    """Compute the part of the shared variance that two sessions on one static trial have in common.

    This is the part of segment axes and masses. `torque`: its name with the side of its leg.
    """
    shares = session.error_shares.get(torque, {})
    total = sum(value for source, value in shares.items() if source != "motion")
    return (
        sum(shares.get(source, 0.0) for source in ("frames", "inertia")) / total
        if total > 0.0
        else 0.0
    )


Key = tuple[str, str]  # Side and variable


@dataclass(frozen=True, kw_only=True)
class StrideSet:
    """n strides of one variable, in its unit, at 0 to 100 %; NaN where a sample is not valid."""

    values: Array  # (n, 101)
    stride_error: Array  # (n, 101) s, errors of the single stride
    shared: Array  # (n, 101) c
    frames: Array  # (n, 101) f, at most c
    stance: Array  # (n,) percent at which the foot leaves the ground; NaN where not known


def collect_stride_sets(session: RecordedSession) -> dict[Key, StrideSet]:
    """Collect every variable of both legs without turning strides."""
    table = session.strides
    # Turning strides have other angles and moments than straight ones.
    table = table[~(table["turn"].abs() > TURNING) & (table["activity"] == WALKING)]
    if table.empty:
        return {}
    where = ["side", "variable", "trial", "stride"]
    wide = table.set_index([*where, "percent"])[["value", "se", "se_stride", "valid"]].unstack(
        "percent"
    )
    wide = wide.reindex(
        columns=pd.MultiIndex.from_product([["value", "se", "se_stride", "valid"], range(POINTS)])
    )
    stance = _read_stance(session.measures)
    arrays = {
        name: wide[name].to_numpy(dtype=np.float64)
        for name in ("value", "se", "se_stride", "valid")
    }
    # An invalid value takes part in no mean.
    arrays["value"] = np.where(arrays["valid"] == 1.0, arrays["value"], np.nan)
    out: dict[Key, StrideSet] = {}
    for (side, variable), rows in wide.groupby(
        level=["side", "variable"], sort=False
    ).indices.items():
        stride_error, total = arrays["se_stride"][rows], arrays["se"][rows]
        # c of the module docstring; rounding in the file may make the difference negative
        shared = np.sqrt(np.maximum(total**2 - stride_error**2, 0.0))
        of_rows = [
            stance.get((trial, str(side), stride), np.nan)
            for _, _, trial, stride in wide.index[rows]
        ]
        out[str(side), str(variable)] = StrideSet(
            values=arrays["value"][rows],
            stride_error=stride_error,
            shared=shared,
            frames=np.zeros_like(shared),
            stance=np.array(of_rows, dtype=np.float64),
        )
    return _add_axis_errors(session, out)


def _read_stance(measures: pd.DataFrame) -> Mapping[tuple[str, str, int], float]:
    """Read (trial, side, stride) -> percent at the end of stance."""
    rows = measures[(measures["variable"] == "stance_percent") & measures["stride"].notna()]
    names = zip(rows["trial"], rows["side"], rows["stride"].astype(int), rows["value"], strict=True)
    return {(trial, side, stride): float(value) for trial, side, stride, value in names}


def _add_axis_errors(session: RecordedSession, sets: dict[Key, StrideSet]) -> dict[Key, StrideSet]:
    """Add f: axis errors at the mean posture for angles, shares of the summary for loads."""
    angles = _compute_axis_errors(session, sets)
    out = {}
    for (side, variable), found in sets.items():
        if get_curve_kind(variable) is CurveKind.ANGLE:
            frames = angles.get((side, variable), np.zeros(POINTS))[None]
        else:
            name = get_coordinate(variable)
            part = compute_shared_part(
                session, name if name.startswith(("pelvis", "lumbar")) else f"{name}_{side}"
            )
            frames = np.sqrt(part) * found.shared
        # A part cannot exceed the whole.
        everywhere = np.minimum(np.broadcast_to(frames, found.shared.shape), found.shared)
        out[side, variable] = replace(found, frames=everywhere)
    return out


def _compute_axis_errors(
    session: RecordedSession, sets: Mapping[Key, StrideSet]
) -> dict[Key, Array]:
    """Compute angle -> (101,) deg error due to the directions of segment axes."""
    if not session.axis_deviations:
        return {}
    axes = AxisErrors(session.model.parameters, session.axis_deviations)
    out: dict[Key, Array] = {}
    for side in SIDES:
        # The error of an axis depends on the posture: rows are percents of the mean stride, rad.
        posture = np.zeros((POINTS, len(COORDINATE_INDEX)))
        columns = {}
        for (side_of_set, variable), found in sets.items():
            name = variable if variable in COORDINATE_INDEX else f"{variable}_{side}"
            if side_of_set == side and name in COORDINATE_INDEX:
                columns[variable] = COORDINATE_INDEX[name]
                posture[:, columns[variable]] = np.deg2rad(average_known(found.values))
        errors = np.rad2deg(axes.compute_coordinate_errors(np.nan_to_num(posture)))
        out |= {(side, variable): errors[:, column] for variable, column in columns.items()}
    return out


def average_known(values: Array) -> Array:
    """Average rows (n, m) over known values: (m,); NaN if there are none."""
    known = np.isfinite(values)
    with np.errstate(invalid="ignore", divide="ignore"):
        out: Array = np.where(known, values, 0.0).sum(axis=0) / known.sum(axis=0)
    return out
