"""A calibration held against the truth that its study names: figures, rows, sentences, for files,
page and terminal.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from gaitcal.analysis.parameter_table import parameter_rows
from gaitcal.analysis.result import Calibration, TrialResult
from gaitcal.analysis.truth_errors import (
    INTERVAL,
    CurveTruth,
    CurveTruths,
    FeatureTruth,
    ParameterTruth,
    TruthErrors,
)
from gaitcal.arrays import Array
from gaitcal.dynamics.ground_reactions import get_leg
from gaitcal.gait.moments import describe_joint, get_moment, list_moments
from gaitcal.model import linkage
from gaitcal.model.parameters import (
    IP_NAMES,
    IP_TO_SI,
    JOINT_PARAMETERS,
    JP_INDEX,
    JP_NAMES,
    JP_TO_SI,
)
from gaitcal.model.rotations import make_axis_rotation
from gaitcal.study.declared_truth import TrueCurves, Truth, find_rule_mismatch

_FEATURES: tuple[tuple[str, str, str, str, tuple[str, ...]], ...] = (
    ("hip", "pelvis", "centre", "centre in the pelvis", ("ant", "sup", "lat")),
    ("knee", "thigh", "axis_place", "axis in the thigh: its place", ("ant", "sup")),
    ("knee", "thigh", "axis_direction", "axis in the thigh: its direction", ("front", "trans")),
    ("talocrural", "shank", "axis_place", "axis in the shank: its place", ("ant", "sup")),
    (
        "talocrural",
        "shank",
        "axis_direction",
        "axis in the shank: its direction",
        ("front", "trans"),
    ),
    ("subtalar", "foot", "axis_direction", "axis in the foot: its direction", ("trans", "sag")),
)
"""Joint, segment, part, words and the parameters of one joint centre or axis. The place of an axis
is told in the plane across it; a point along it means nothing by itself."""


def with_truth(calibration: Calibration) -> Calibration:
    """The same with `truth`, where the study names one: computed once, for files, page and terminal
    alike.

    Where settings or static trial were changed since the study was read so that frames are others,
    there is no `truth` but a note. Trials whose true curves have other times than their recording
    are noted, and not compared.
    """
    known, study = calibration.study.truth, calibration.study
    if known is None:
        return calibration
    if (rule := find_rule_mismatch(known.rules, study.settings, study.marker_set.name)) is not None:
        why = f"truth.{rule.rule}: {rule.message}"
    elif (words := study.describe_truth_mismatch()) is not None:
        why = f"truth.landmarks: {words}"
    else:
        why = ""
    if why:
        note = f"the truth that the study names is not compared: {why}"
        return replace(calibration, notes=(*calibration.notes, note))
    truth = _errors(calibration, known)
    notes = tuple(
        f"{name}: not held against the truth, as {why}" for name, why in truth.not_compared.items()
    )
    return replace(calibration, truth=truth, notes=(*calibration.notes, *notes))


def _errors(calibration: Calibration, known: Truth) -> TruthErrors:
    parameters = _parameters(parameter_rows(calibration), known.parameters)
    trials, why_not = {}, {}
    for trial in calibration.trials:
        curves = {"motion": known.motions.get(trial.name), "moments": known.moments.get(trial.name)}
        there = {what: c for what, c in curves.items() if c is not None}
        beside = {what: c for what, c in there.items() if not c.find_covered(trial.body.time).any()}
        if not there and (known.motions or known.moments):
            why_not[trial.name] = "no true curves of it are known"
        elif beside:
            times = (f"{what}, {c.time[0]:.2f} to {c.time[-1]:.2f} s" for what, c in beside.items())
            recorded = f"{trial.body.time[0]:.2f} to {trial.body.time[-1]:.2f} s"
            why_not[trial.name] = (
                f"its true curves ({'; '.join(times)}) have no frame of the result ({recorded})"
            )
        if len(beside) < len(there):
            trials[trial.name] = _trial(
                trial, *(None if what in beside else c for what, c in curves.items())
            )
    return TruthErrors(
        parameters=parameters,
        features=_features({p.name: p for p in parameters}),
        trials=trials,
        not_compared=why_not,
    )


def _parameters(
    rows: Sequence[Mapping[str, Any]], true: Mapping[str, float]
) -> tuple[ParameterTruth, ...]:
    to_si = dict(zip((*JP_NAMES, *IP_NAMES), (*JP_TO_SI, *IP_TO_SI), strict=True))
    kept = ("name", "kind", "unit", "nominal", "fitted", "status")
    return tuple(
        ParameterTruth(
            **{key: row[key] for key in kept},
            truth=true[row["name"]] / to_si[row["name"]],
            error_bar=row["standard_error"],
        )
        for row in rows
        if row["name"] in true
    )


def _features(parameters: Mapping[str, ParameterTruth]) -> tuple[FeatureTruth, ...]:
    out = []
    for joint, segment, part, words, directions in _FEATURES:
        for side in linkage.SIDES:
            names = [f"{joint}_{side}.{segment}.{direction}" for direction in directions]
            rows = [parameters[name] for name in names if name in parameters]
            if len(rows) < len(names) or all(row.status == "fixed" for row in rows):
                continue
            nominal, fitted, true = (
                np.array([getattr(row, which) for row in rows])
                for which in ("nominal", "fitted", "truth")
            )
            gap = _distance if rows[0].unit == "mm" else partial(_angle, directions)
            out.append(
                FeatureTruth(
                    joint=f"{joint}_{side}",
                    part=part,
                    words=f"{describe_joint(joint)} {words}",
                    unit=rows[0].unit,
                    nominal=gap(nominal, true),
                    fitted=gap(fitted, true),
                    within=tuple(bool(abs(row.z) <= INTERVAL) for row in rows if row.z is not None),
                )
            )
    return tuple(out)


def _distance(one: Array, other: Array) -> float:
    return float(np.linalg.norm(one - other))


def _angle(directions: tuple[str, ...], one: Array, other: Array) -> float:
    """Degrees between two joint axes, each given by two angles: z of Rx(front) Ry(trans), x of
    Ry(trans) Rz(sag).
    """
    turns, axis = ((0, 1), 2) if directions == ("front", "trans") else ((1, 2), 0)
    a, b = (
        (
            make_axis_rotation(turns[0], np.deg2rad(first))
            @ make_axis_rotation(turns[1], np.deg2rad(second))
        )[:, axis]
        for first, second in (one, other)
    )
    return float(np.rad2deg(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))


def _trial(
    trial: TrialResult, motions: TrueCurves | None, moments: TrueCurves | None
) -> CurveTruths:
    time, coordinates, forces = trial.body.time, {}, {}
    now, before = trial.body.columns(trial.coordinate_errors), trial.nominal.columns()
    for name, true in ({} if motions is None else motions.interpolate(time)).items():
        if name in now:
            coordinates[name] = CurveTruth(
                name=name,
                truth=true * (1.0 if linkage.is_translation(name) else 180.0 / np.pi),
                fitted=now[name],
                nominal=before.get(name, np.full(len(time), np.nan)),
                error_bar=now.get(f"{name}_se"),
                counts=np.ones(len(time), dtype=bool),
            )
    if moments is not None and (loads := trial.loads) is not None:
        for name, true in moments.interpolate(time).items():
            forces[name] = CurveTruth(
                name=name,
                truth=true,
                fitted=get_moment(loads.final, name),
                nominal=get_moment(loads.nominal, name),
                error_bar=None if loads.errors is None else get_moment(loads.errors, name),
                counts=loads.reactions.valid_for(name),
            )
    return CurveTruths(time, coordinates, forces)


LEGS, ARMS, TURNING = "legs", "back and arms", "arms, in segments of two markers"
"""Which joint parameters are told together."""
UNDETERMINED = "unidentifiable"


@dataclass(frozen=True, kw_only=True)
class TruthSum:
    """One number for many: RMS error before and after calibration, and how often the truth lies
    within.
    """

    words: str
    unit: str
    count: int  # Parameters, or curves
    undetermined: int = 0
    """Of these parameters: such as the trials do not show, which their prior holds; they have no
    part in `bars`.
    """
    nominal: float
    fitted: float
    within: int  # Parameters or frames with a standard error whose truth lies within 1.96 of it
    bars: int  # Parameters or frames with a standard error

    @property
    def share(self) -> float | None:
        """Part (0 to 1) that lies within; None without standard errors."""
        return self.within / self.bars if self.bars else None

    @property
    def farther(self) -> bool:
        """Calibration led away from the truth, by as much as is shown."""
        return round(self.fitted, 2) > round(self.nominal, 2)

    @property
    def over(self) -> str:
        """`58, 2 of them undetermined`."""
        return (
            f"{self.count}, {self.undetermined} of them undetermined"
            if self.undetermined
            else str(self.count)
        )

    @property
    def sentence(self) -> str:
        """`joint positions against the truth (RMS over 58): nominal 5.6 mm, calibrated 1.2 mm;
        ...`.
        """
        text = (
            f"{self.words} against the truth (RMS over {self.over}): nominal {self.nominal:.2f} "
            f"{self.unit}, "
        )
        text += f"calibrated {self.fitted:.2f} {self.unit}"
        return (
            text
            if self.share is None
            else f"{text}; within 1.96 standard errors: {100 * self.share:.0f} %"
        )


@dataclass(frozen=True, kw_only=True)
class CurveRow:
    """One leg coordinate of one trial: its angle and its moment beside the true ones; what is
    unknown is None.
    """

    name: str
    angle: CurveTruth | None
    moment: CurveTruth | None


def sums(calibration: Calibration, truth: TruthErrors) -> tuple[TruthSum, ...]:
    """Joint parameters that were sought, of legs and of the others; masses; angles and moments of
    legs in each walk.
    """
    turning = two_marker_segments(calibration)
    groups = [
        (f"{kind}s, {part}", tuple(p for p in truth.sought(kind) if _part(p.name, turning) == part))
        for part in (LEGS, ARMS, TURNING)
        for kind in ("joint position", "joint orientation")
    ]
    groups.append(("segment masses", tuple(p for p in truth.parameters if p.kind == "mass")))
    out = [_of_parameters(words, group) for words, group in groups if group]
    for trial in calibration.trials:
        rows = curve_rows(calibration, truth, trial.name) if trial.joint is None else ()
        for words, unit, curves in (
            (f"{trial.name}: leg angles", "deg", [row.angle for row in rows]),
            (f"{trial.name}: leg moments", "N·m", [row.moment for row in rows]),
        ):
            compared = [curve for curve in curves if curve is not None and curve.rms is not None]
            if compared:
                out.append(_of_curves(words, unit, compared))
    return tuple(out)


def curve_rows(calibration: Calibration, truth: TruthErrors, trial: str) -> tuple[CurveRow, ...]:
    """The coordinates and moments of both legs, in the order of the result."""
    known = truth.of(trial)
    names = [name for name in list_moments(calibration.model) if get_leg(name)]
    rows = (
        CurveRow(name=n, angle=known.coordinates.get(n), moment=known.forces.get(n)) for n in names
    )
    return tuple(row for row in rows if row.angle is not None or row.moment is not None)


def compared_trials(calibration: Calibration, truth: TruthErrors) -> tuple[str, ...]:
    """Walks of which true curves are known."""
    return tuple(t.name for t in calibration.trials if t.joint is None and t.name in truth.trials)


def two_marker_segments(calibration: Calibration) -> tuple[str, ...]:
    """Segments outside of the legs that two markers or fewer track: how these turn about their
    line, none shows.
    """
    markers = calibration.model.markers
    counted = Counter(s for s, w in zip(markers.segments, markers.weight, strict=True) if w > 0)
    known = dict.fromkeys(
        p.segment for p in JOINT_PARAMETERS if p.joint.split("_")[0] not in linkage.LEG_JOINTS
    )
    return tuple(s for s in known if 0 < counted[s] <= 2)


def turning_sentence(calibration: Calibration) -> str:
    """What is to be known of the parameters in such segments; empty where there are none."""
    segments = [s.replace("_", " ") for s in two_marker_segments(calibration)]
    if not segments:
        return ""
    return (
        f"Two markers track {', '.join(segments)}: how such a segment is turned about the line "
        "through them no motion "
        "shows, and an axis that is turned with it meets the markers as well. There the nominal "
        "value decides, which "
        "the landmarks of the static trial may place tens of degrees off."
    )


def _part(name: str, turning: Sequence[str]) -> str:
    parameter = JOINT_PARAMETERS[JP_INDEX[name]]
    if parameter.joint.split("_")[0] in linkage.LEG_JOINTS:
        return LEGS
    return TURNING if parameter.segment in turning else ARMS


def settings_sentence(calibration: Calibration) -> str:
    """With which knowledge it was calibrated: settings that are not the default ones."""
    own = calibration.study.settings.model_dump(exclude_defaults=True, mode="json")
    if not own:
        return "It was calibrated with the default settings, every one."
    told = "; ".join(f"{name}: {_shown(value)}" for name, value in own.items())
    return f"It was calibrated with the default settings, but for what its study file says: {told}."


def _shown(value: object) -> str:
    return (
        ", ".join(f"{k} {_shown(v)}" for k, v in value.items())
        if isinstance(value, dict)
        else str(value)
    )


def not_compared_sentence(truth: TruthErrors) -> str:
    """Trials whose curves are not, or not all, held against true ones; empty where all are."""
    trials = [f"{name}: {why}" for name, why in truth.not_compared.items()]
    return f"Not compared: {'; '.join(trials)}." if trials else ""


def truth_sentence(truth: TruthErrors) -> str:
    """What the error bars are held to."""
    unknown = "" if truth.trials else " No true curves are known."
    return (
        f"Of honest error bars, ±{INTERVAL} standard errors hold the truth in 95 of 100 cases; "
        "neighbouring frames of "
        "a curve err together, so that the share of one person scatters widely about "
        f"that.{unknown}"
    )


def _of_parameters(words: str, group: Sequence[ParameterTruth]) -> TruthSum:
    z = [p.z for p in group if p.z is not None and p.status != UNDETERMINED]
    return TruthSum(
        words=words,
        unit=group[0].unit,
        count=len(group),
        undetermined=sum(p.status == UNDETERMINED for p in group),
        nominal=_rms([p.nominal_error for p in group]),
        fitted=_rms([p.error for p in group]),
        within=sum(abs(value) <= INTERVAL for value in z),
        bars=len(z),
    )


def _of_curves(words: str, unit: str, curves: Sequence[CurveTruth]) -> TruthSum:
    within = np.concatenate([c.within for c in curves])
    return TruthSum(
        words=words,
        unit=unit,
        count=len(curves),
        nominal=_rms(np.concatenate([(c.nominal - c.truth)[c.compared] for c in curves])),
        fitted=_rms(np.concatenate([(c.fitted - c.truth)[c.compared] for c in curves])),
        within=int(within.sum()),
        bars=len(within),
    )


def _rms(errors: Sequence[float] | Array) -> float:
    return float(np.sqrt(np.mean(np.square(errors))))
