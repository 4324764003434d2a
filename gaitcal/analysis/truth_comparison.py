"""Compare a calibration with the truth that its study declares.

The comparison is computed once; files, page and terminal show the same figures, rows and sentences.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gaitcal.analysis.parameter_table import list_parameter_rows
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

UNDETERMINED = "unidentifiable"
"""Status of a parameter that the trials do not determine."""
LEGS, ARMS, TWO_MARKER_ARMS = "legs", "back and arms", "arms, in segments of two markers"
"""Groups of joint parameters that are summarised together."""


@dataclass(frozen=True)
class _Feature:
    """A joint centre or axis, with the parameters that define it.

    An axis has a position in the plane across it; a position along it has no meaning.
    """

    joint: str
    segment: str
    part: str
    label: str
    directions: tuple[str, ...]

    def list_parameter_names(self, side: str) -> list[str]:
        """List the names of its parameters on one side (`r` or `l`)."""
        joint = f"{self.joint}_{side}"
        return [f"{joint}.{self.segment}.{direction}" for direction in self.directions]


_FEATURES = (
    _Feature("hip", "pelvis", "centre", "centre in the pelvis", ("ant", "sup", "lat")),
    _Feature("knee", "thigh", "axis_place", "axis in the thigh: position", ("ant", "sup")),
    _Feature("knee", "thigh", "axis_direction", "axis in the thigh: direction", ("front", "trans")),
    _Feature("talocrural", "shank", "axis_place", "axis in the shank: position", ("ant", "sup")),
    _Feature(
        "talocrural", "shank", "axis_direction", "axis in the shank: direction", ("front", "trans")
    ),
    _Feature("subtalar", "foot", "axis_direction", "axis in the foot: direction", ("trans", "sag")),
)


def compare_with_truth(calibration: Calibration) -> Calibration:
    """Compare a calibration with the truth that its study declares, if it declares one.

    There is a note instead if settings or static trial were changed since the study was written, so
    that segment frames differ. Trials whose true curves have other times than their recording are
    noted and not compared.

    `calibration`: without `truth`. Returns: with `truth`, or with a note, or unchanged.
    """
    truth, study = calibration.study.truth, calibration.study
    if truth is None:
        return calibration
    rule_mismatch = find_rule_mismatch(truth.rules, study.settings, study.marker_set.name)
    why = ""
    if rule_mismatch is not None:
        why = f"truth.{rule_mismatch.rule}: {rule_mismatch.message}"
    else:
        landmark_mismatch = study.other_truth()
        if landmark_mismatch is not None:
            why = f"truth.landmarks: {landmark_mismatch}"
    if why:
        note = f"not compared with the truth of the study: {why}"
        return replace(calibration, notes=(*calibration.notes, note))
    errors = _compute_errors(calibration, truth)
    notes = tuple(
        f"{name}: not compared with the truth: {why}" for name, why in errors.not_compared.items()
    )
    return replace(calibration, truth=errors, notes=(*calibration.notes, *notes))


def _compute_errors(calibration: Calibration, truth: Truth) -> TruthErrors:
    """Compute errors of parameters, joint centres, axes and curves."""
    parameters = _compare_parameters(list_parameter_rows(calibration), truth.parameters)
    trials, not_compared = {}, {}
    for trial in calibration.trials:
        known = {}
        for quantity, curves in (("motion", truth.motions), ("moments", truth.moments)):
            if trial.name in curves:
                known[quantity] = curves[trial.name]
        outside = {
            quantity: curves
            for quantity, curves in known.items()
            if not curves.find_covered(trial.body.time).any()
        }
        if not known and (truth.motions or truth.moments):
            not_compared[trial.name] = "the truth has no curves of it"
        elif outside:
            times = (f"{q}, {c.time[0]:.2f} to {c.time[-1]:.2f} s" for q, c in outside.items())
            recorded = f"{trial.body.time[0]:.2f} to {trial.body.time[-1]:.2f} s"
            not_compared[trial.name] = (
                f"its true curves ({'; '.join(times)}) have no frame of the result ({recorded})"
            )
        inside = {q: c for q, c in known.items() if q not in outside}
        if inside:
            trials[trial.name] = _compare_curves(trial, inside.get("motion"), inside.get("moments"))
    return TruthErrors(
        parameters=parameters,
        features=_compare_features({p.name: p for p in parameters}),
        trials=trials,
        not_compared=not_compared,
    )


def _compare_parameters(
    rows: Sequence[Mapping[str, Any]], true: Mapping[str, float]
) -> tuple[ParameterTruth, ...]:
    """Compare the rows of the parameter table with parameter -> true value (SI)."""
    to_si = dict(zip((*JP_NAMES, *IP_NAMES), (*JP_TO_SI, *IP_TO_SI), strict=True))
    return tuple(
        ParameterTruth(
            name=row["name"],
            kind=row["kind"],
            unit=row["unit"],
            nominal=row["nominal"],
            fitted=row["fitted"],
            status=row["status"],
            truth=true[row["name"]] / to_si[row["name"]],
            error_bar=row["standard_error"],
        )
        for row in rows
        if row["name"] in true
    )


def _compare_features(parameters: Mapping[str, ParameterTruth]) -> tuple[FeatureTruth, ...]:
    """Compare joint centres and axes whose parameters are all in the truth, any of them fitted."""
    out = []
    for feature in _FEATURES:
        for side in linkage.SIDES:
            names = feature.list_parameter_names(side)
            rows = [parameters[name] for name in names if name in parameters]
            if len(rows) < len(names) or all(row.status == "fixed" for row in rows):
                continue
            unit, true = rows[0].unit, np.array([row.truth for row in rows])
            nominal = np.array([row.nominal for row in rows])
            fitted = np.array([row.fitted for row in rows])
            scores = [row.z for row in rows if row.z is not None]
            out.append(
                FeatureTruth(
                    joint=f"{feature.joint}_{side}",
                    part=feature.part,
                    label=f"{describe_joint(feature.joint)} {feature.label}",
                    unit=unit,
                    nominal=_compute_gap(feature, unit, nominal, true),
                    fitted=_compute_gap(feature, unit, fitted, true),
                    within=tuple(bool(abs(z) <= INTERVAL) for z in scores),
                )
            )
    return tuple(out)


def _compute_gap(feature: _Feature, unit: str, one: Array, other: Array) -> float:
    """Compute the distance (mm) or angle (deg) between two values of a feature."""
    if unit == "mm":
        return float(np.linalg.norm(one - other))
    a, b = (_make_axis(feature.directions, angles) for angles in (one, other))
    return float(np.rad2deg(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))


def _make_axis(directions: tuple[str, ...], angles: Array) -> Array:
    """Compute the unit vector (3,) of a joint axis from its two angles (deg).

    It is z of Rx(front) Ry(trans), or x of Ry(trans) Rz(sag).
    """
    axes, column = ((0, 1), 2) if directions == ("front", "trans") else ((1, 2), 0)
    first, second = (
        make_axis_rotation(axis, np.deg2rad(angle))
        for axis, angle in zip(axes, angles, strict=True)
    )
    vector: Array = (first @ second)[:, column]
    return vector


def _compare_curves(
    trial: TrialResult, motions: TrueCurves | None, moments: TrueCurves | None
) -> CurveTruths:
    """Compare the coordinates and generalised forces of a trial with true ones."""
    time, coordinates, forces = trial.body.time, {}, {}
    fitted, nominal = trial.body.columns(trial.coordinate_errors), trial.nominal.columns()
    for name, true in ({} if motions is None else motions.interpolate(time)).items():
        if name in fitted:
            # Coordinates are in m or deg, as in the files.
            unit = 1.0 if linkage.is_translation(name) else 180.0 / np.pi
            coordinates[name] = CurveTruth(
                name=name,
                truth=true * unit,
                fitted=fitted[name],
                nominal=nominal.get(name, np.full(len(time), np.nan)),
                error_bar=fitted.get(f"{name}_se"),
                counts=np.ones(len(time), dtype=bool),
            )
    loads = trial.loads
    if moments is not None and loads is not None:
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


@dataclass(frozen=True, kw_only=True)
class TruthSum:
    """RMS error of a group of parameters or curves, and how often the error bars hold the truth."""

    label: str
    unit: str
    count: int
    """Parameters, or curves."""
    undetermined: int = 0
    """Parameters that the trials do not determine, so that their prior does; not in `bars`."""
    nominal: float
    fitted: float
    within: int
    """Parameters or frames with a standard error whose truth lies within 1.96 of it."""
    bars: int
    """Parameters or frames with a standard error."""

    @property
    def share(self) -> float | None:
        """Part (0 to 1) with the truth within; None without standard errors."""
        return self.within / self.bars if self.bars else None

    @property
    def is_worse(self) -> bool:
        """Whether the calibrated error is larger than the nominal one, as printed."""
        return round(self.fitted, 2) > round(self.nominal, 2)

    @property
    def count_label(self) -> str:
        """`58, 2 of them undetermined`."""
        if self.undetermined:
            return f"{self.count}, {self.undetermined} of them undetermined"
        return str(self.count)

    @property
    def sentence(self) -> str:
        """`joint positions against the truth (RMS over 58): nominal 5.6 mm, calibrated 1.2 mm`."""
        text = (
            f"{self.label} against the truth (RMS over {self.count_label}): "
            f"nominal {self.nominal:.2f} {self.unit}, calibrated {self.fitted:.2f} {self.unit}"
        )
        if self.share is None:
            return text
        return f"{text}; within 1.96 standard errors: {100 * self.share:.0f} %"


@dataclass(frozen=True, kw_only=True)
class CurveRow:
    """Angle and moment of one leg coordinate of one trial, with the true ones; None if unknown."""

    name: str
    angle: CurveTruth | None
    moment: CurveTruth | None


def summarise_errors(calibration: Calibration, truth: TruthErrors) -> tuple[TruthSum, ...]:
    """Summarise errors of joint parameters, masses, and angles and moments of legs in each walk.

    Parameters
    ----------
    calibration : Calibration
        The calibration.
    truth : TruthErrors
        Its errors.

    Returns
    -------
    tuple of TruthSum
        Fitted and undetermined joint parameters of legs, and of back and arms; segment masses;
        curves of each walk.
    """
    out = [_summarise_parameters(label, group) for label, group in _group(calibration, truth)]
    for trial in calibration.trials:
        if trial.joint is not None:
            continue
        rows = list_curve_rows(calibration, truth, trial.name)
        for label, unit, curves in (
            (f"{trial.name}: leg angles", "deg", [row.angle for row in rows]),
            (f"{trial.name}: leg moments", "N·m", [row.moment for row in rows]),
        ):
            compared = [curve for curve in curves if curve is not None and curve.rms is not None]
            if compared:
                out.append(_summarise_curves(label, unit, compared))
    return tuple(out)


def _group(
    calibration: Calibration, truth: TruthErrors
) -> Iterator[tuple[str, Sequence[ParameterTruth]]]:
    """Group the parameters by kind and part of the body; without empty groups."""
    two_marker_segments = find_two_marker_segments(calibration)
    for part in (LEGS, ARMS, TWO_MARKER_ARMS):
        for kind in ("joint position", "joint orientation"):
            group = [
                p
                for p in truth.select_sought(kind)
                if _choose_part(p.name, two_marker_segments) == part
            ]
            if group:
                yield f"{kind}s, {part}", group
    masses = [p for p in truth.parameters if p.kind == "mass"]
    if masses:
        yield "segment masses", masses


def _choose_part(name: str, two_marker_segments: Sequence[str]) -> str:
    """Choose the group of a joint parameter."""
    parameter = JOINT_PARAMETERS[JP_INDEX[name]]
    if parameter.joint.split("_")[0] in linkage.LEG_JOINTS:
        return LEGS
    return TWO_MARKER_ARMS if parameter.segment in two_marker_segments else ARMS


def list_curve_rows(
    calibration: Calibration, truth: TruthErrors, trial: str
) -> tuple[CurveRow, ...]:
    """List the coordinates and moments of both legs that the truth has, in the order of the result.

    Parameters
    ----------
    calibration : Calibration
        The calibration.
    truth : TruthErrors
        Its errors.
    trial : str
        Name of the trial.

    Returns
    -------
    tuple of CurveRow
    """
    known = truth.get_curves(trial)
    names = [name for name in list_moments(calibration.model) if get_leg(name)]
    rows = (
        CurveRow(name=n, angle=known.coordinates.get(n), moment=known.forces.get(n)) for n in names
    )
    return tuple(row for row in rows if row.angle is not None or row.moment is not None)


def list_compared_trials(calibration: Calibration, truth: TruthErrors) -> tuple[str, ...]:
    """List the walks with true curves."""
    return tuple(t.name for t in calibration.trials if t.joint is None and t.name in truth.trials)


def find_two_marker_segments(calibration: Calibration) -> tuple[str, ...]:
    """Find segments other than those of the legs that one or two markers track.

    Their rotation about the line through the markers is not observable.

    Returns: in the order of the joint parameters.
    """
    markers = calibration.model.markers
    counts = Counter(s for s, w in zip(markers.segments, markers.weight, strict=True) if w > 0)
    segments = dict.fromkeys(
        p.segment for p in JOINT_PARAMETERS if p.joint.split("_")[0] not in linkage.LEG_JOINTS
    )
    return tuple(s for s in segments if 0 < counts[s] <= 2)


def describe_two_marker_segments(calibration: Calibration) -> str:
    """Explain the errors of parameters in two-marker segments; empty if there are none."""
    segments = [s.replace("_", " ") for s in find_two_marker_segments(calibration)]
    if not segments:
        return ""
    return (
        f"Two markers track {', '.join(segments)}. No motion shows the rotation of such a segment "
        "about the line through its markers, and an axis that rotates with it fits the markers as "
        "well. Its nominal value remains, which depends on the landmarks of the static trial and "
        "may be tens of degrees off."
    )


def describe_settings(calibration: Calibration) -> str:
    """Describe the settings of the calibration that are not the default ones."""
    changed = calibration.study.settings.model_dump(exclude_defaults=True, mode="json")
    if not changed:
        return "It was calibrated with the default settings."
    settings = "; ".join(f"{name}: {_format_value(value)}" for name, value in changed.items())
    return f"It was calibrated with the default settings and these of its study file: {settings}."


def _format_value(value: object) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{key} {_format_value(part)}" for key, part in value.items())
    return str(value)


def describe_not_compared(truth: TruthErrors) -> str:
    """List trials whose curves are not all compared with the truth; empty if all are."""
    trials = [f"{name}: {why}" for name, why in truth.not_compared.items()]
    return f"Not compared: {'; '.join(trials)}." if trials else ""


def describe_error_bars(truth: TruthErrors) -> str:
    """Describe how error bars are compared with the truth."""
    unknown = "" if truth.trials else " There are no true curves."
    return (
        f"Of correct error bars, ±{INTERVAL} standard errors contain the truth in 95 of 100 cases. "
        "Errors of neighbouring frames are correlated, so that the share of one person scatters "
        f"widely about that.{unknown}"
    )


def _summarise_parameters(label: str, group: Sequence[ParameterTruth]) -> TruthSum:
    """Summarise the errors of parameters."""
    scores = [p.z for p in group if p.z is not None and p.status != UNDETERMINED]
    return TruthSum(
        label=label,
        unit=group[0].unit,
        count=len(group),
        undetermined=sum(p.status == UNDETERMINED for p in group),
        nominal=_compute_rms([p.nominal_error for p in group]),
        fitted=_compute_rms([p.error for p in group]),
        within=sum(abs(z) <= INTERVAL for z in scores),
        bars=len(scores),
    )


def _summarise_curves(label: str, unit: str, curves: Sequence[CurveTruth]) -> TruthSum:
    """Summarise the errors of curves over their compared frames."""
    within = np.concatenate([c.within for c in curves])
    nominal = np.concatenate([(c.nominal - c.truth)[c.compared] for c in curves])
    fitted = np.concatenate([(c.fitted - c.truth)[c.compared] for c in curves])
    return TruthSum(
        label=label,
        unit=unit,
        count=len(curves),
        nominal=_compute_rms(nominal),
        fitted=_compute_rms(fitted),
        within=int(within.sum()),
        bars=len(within),
    )


def _compute_rms(errors: Sequence[float] | Array) -> float:
    return float(np.sqrt(np.mean(np.square(errors))))
