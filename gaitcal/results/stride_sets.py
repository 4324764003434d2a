"""One result of a person, as far as setting it beside another one needs it, and the strides of one
variable of one leg.

The error of a stride has two parts (`gait/ensemble.py`): its own, s_ij, which makes strides differ,
and c, which all strides of one calibrated person share, c^2 = se_ij^2 - s_ij^2. What of c two
sessions on one static trial share in turn, f, are the axes of the segments and, of loads, the
masses.
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
from gaitcal.export.opensim.peer_model import our_leg
from gaitcal.gait.cycles import POINTS, WALKING, CurveKind, coordinate_of, kind_of
from gaitcal.gait.strides import TURNING
from gaitcal.model.linkage import COORDINATE_INDEX, SIDES
from gaitcal.model.subject_model import SubjectModel
from gaitcal.study.cohort_prior import JointPrior


class NotComparableError(InputError):
    """Two results cannot be set side by side as they are."""

    code = Code.NOT_COMPARABLE


@dataclass(frozen=True, kw_only=True)
class RecordedSession:
    """A result folder's tables and model."""

    name: str  # What it is called in words: its folder
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
    verdict: str  # `trustworthy`, `doubtful` or `refused`; empty where none is told
    reasons: tuple[str, ...] = ()  # Why, a sentence each
    remarks: tuple[str, ...] = ()
    """What else to know of its files: edited, or made with another model than lies there now."""
    axis_deviations: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    """Segment -> deg, how far its axes may point elsewhere (`dynamics/measurement_errors.py`)."""
    error_shares: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Torque -> source -> part of the variance of its error, 0 to 1."""
    prior: JointPrior | None = None
    """Of its joint parameters, by its settings; None: anatomy's. A cohort's is not in a result."""
    relative: bool = False  # Joint angles are counted from the static posture


class Common(Enum):
    """What two results have in common, and so no error of a difference. `words`: on the screen."""

    MODEL = "one model: its errors are the same in both, and cancel"
    STATIC = (
        "one static trial, a calibration each: nominal joints, marker places and segment axes are "
        "the same"
    )
    PERSON = "a static trial each: markers were placed anew, and no error is the same in both"

    def __init__(self, words: str) -> None:
        self.words = words


def common_to(a: RecordedSession, b: RecordedSession) -> Common:
    """What two results of one person share."""
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
    """Whether two results are of one person, in words."""

    doubts: tuple[str, ...]
    denied: tuple[str, ...]  # What no two results of one person have


def identity(a: RecordedSession, b: RecordedSession) -> Identity:
    """Compare name, sex, height and the lengths of thighs and shanks."""
    one, other = a.model.subject, b.model.subject
    doubts, denied = list[str](), list[str]()
    if one.name != other.name:
        doubts.append(f"the names differ: '{one.name}' and '{other.name}'")
    if one.sex and other.sex and one.sex != other.sex:
        doubts.append(f"{one.sex} in {a.name}, {other.sex} in {b.name}")
    if abs(other.height - one.height) > DOUBTFUL * one.height:
        doubts.append(f"{one.height:.2f} m tall in {a.name}, {other.height:.2f} m in {b.name}")
    for name, (of_a, of_b) in _lengths(a, b).items():
        apart = abs(of_b - of_a) / max(of_a, 1e-6)
        if apart > DOUBTFUL:
            told = denied if apart > NOT_ONE else doubts
            told.append(
                f"{name} {1e3 * of_a:.0f} mm long in {a.name}, {1e3 * of_b:.0f} mm in {b.name}"
            )
    return Identity(tuple(doubts), tuple(denied))


def _lengths(a: RecordedSession, b: RecordedSession) -> dict[str, tuple[float, float]]:
    """Segment in words -> m in both."""
    out = {}
    for side, word in zip(SIDES, ("right", "left"), strict=True):
        legs = [our_leg(s.model.parameters, side) for s in (a, b)]
        for part in LENGTHS:
            of_a, of_b = (getattr(leg, f"{part}_length") for leg in legs)
            out[f"{word} {part}"] = (of_a, of_b)
    return out


def shared_part(session: RecordedSession, torque: str) -> float:
    """Of the variance that all strides share, the part by sources that two sessions on one static
    trial share: the direction of segment axes and the masses. `torque`: its name with the side of
    its leg.
    """
    shares = session.error_shares.get(torque, {})
    rest = sum(value for source, value in shares.items() if source != "motion")
    return (
        sum(shares.get(source, 0.0) for source in ("frames", "inertia")) / rest
        if rest > 0.0
        else 0.0
    )


Key = tuple[str, str]  # Side and variable


@dataclass(frozen=True, kw_only=True)
class StrideSet:
    """n strides of one variable, in its unit, at 0 to 100 %; NaN where a sample is not valid."""

    values: Array  # (n, 101)
    own: Array  # (n, 101) s
    shared: Array  # (n, 101) c
    frames: Array  # (n, 101) f, at most c
    stance: Array  # (n,) percent at which the foot leaves the ground; NaN where not known


def stride_sets(session: RecordedSession) -> dict[Key, StrideSet]:
    """Every variable of both legs; strides that turn are left out."""
    table = session.strides
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
    stance = _stance(session.measures)
    arrays = {
        name: wide[name].to_numpy(dtype=np.float64)
        for name in ("value", "se", "se_stride", "valid")
    }
    arrays["value"] = np.where(arrays["valid"] == 1.0, arrays["value"], np.nan)
    out: dict[Key, StrideSet] = {}
    for (side, variable), rows in wide.groupby(
        level=["side", "variable"], sort=False
    ).indices.items():
        own, total = arrays["se_stride"][rows], arrays["se"][rows]
        shared = np.sqrt(np.maximum(total**2 - own**2, 0.0))
        of_rows = [
            stance.get((trial, str(side), stride), np.nan)
            for _, _, trial, stride in wide.index[rows]
        ]
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


def _with_frames(session: RecordedSession, sets: dict[Key, StrideSet]) -> dict[Key, StrideSet]:
    """The same with f: of angles by the axes' own errors at the mean posture, of loads by the
    summary's shares.
    """
    angles = _axis_errors(session, sets)
    out = {}
    for (side, variable), found in sets.items():
        if kind_of(variable) is CurveKind.ANGLE:
            frames = angles.get((side, variable), np.zeros(POINTS))[None]
        else:
            name = coordinate_of(variable)
            part = shared_part(
                session, name if name.startswith(("pelvis", "lumbar")) else f"{name}_{side}"
            )
            frames = np.sqrt(part) * found.shared
        everywhere = np.minimum(np.broadcast_to(frames, found.shared.shape), found.shared)
        out[side, variable] = replace(found, frames=everywhere)
    return out


def _axis_errors(session: RecordedSession, sets: Mapping[Key, StrideSet]) -> dict[Key, Array]:
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
        errors = np.rad2deg(axes.compute_coordinate_errors(np.nan_to_num(posture)))
        out |= {(side, variable): errors[:, column] for variable, column in here.items()}
    return out


def mean_over(values: Array) -> Array:
    """(m,) mean of rows (n, m) over what is known; NaN where nothing is."""
    known = np.isfinite(values)
    with np.errstate(invalid="ignore", divide="ignore"):
        out: Array = np.where(known, values, 0.0).sum(axis=0) / known.sum(axis=0)
    return out
