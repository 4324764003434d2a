"""A calibration held against the truth that its study names."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np

from gaitcal.arrays import Array
from gaitcal.gait.moments import joint_words, moment_of
from gaitcal.model.chain import axis_rotation
from gaitcal.model.linkage import FILE_COORDINATES, REACTIONS, SIDES, is_translation
from gaitcal.model.parameters import IP_NAMES, IP_TO_SI, JP_NAMES, JP_TO_SI
from gaitcal.session.result import Calibration, TrialResult
from gaitcal.session.tables import parameter_rows
from gaitcal.session.truth_errors import INTERVAL, CurveTruth, FeatureTruth, ParameterTruth, TrialTruth, TruthErrors
from gaitcal.study.truth import TrueCurves, Truth, other_rule

_Gap: TypeAlias = Callable[[Array, Array], float]
_FRONT, _TRANS, _SAG = 0, 1, 2
"""Axes that the angles of a joint axis turn about."""
_FEATURES: tuple[tuple[str, str, str, str, tuple[str, ...]], ...] = (
    ("hip", "pelvis", "centre", "centre in the pelvis", ("ant", "sup", "lat")),
    ("knee", "thigh", "axis_place", "axis in the thigh: its place", ("ant", "sup")),
    ("knee", "thigh", "axis_direction", "axis in the thigh: its direction", ("front", "trans")),
    ("talocrural", "shank", "axis_place", "axis in the shank: its place", ("ant", "sup")),
    ("talocrural", "shank", "axis_direction", "axis in the shank: its direction", ("front", "trans")),
    ("subtalar", "foot", "axis_direction", "axis in the foot: its direction", ("trans", "sag")),
)
"""Joint, segment, part, words and the parameters of one joint centre or axis. The place of an axis is told in the plane
across it; a point along it means nothing by itself."""


def with_truth(calibration: Calibration) -> Calibration:
    """The same with `truth`, where the study names one: computed once, for files, page and terminal alike.

    Where settings or static trial were changed since the study was read so that frames are others, there is no
    `truth` but a note. Trials whose true curves have other times than their recording are noted, and not compared.
    """
    known, study = calibration.study.truth, calibration.study
    if known is None:
        return calibration
    if (other := other_rule(known.told, study.settings, study.marker_set.name)) is not None:
        note = f"the truth that the study names is not compared: truth.{other.rule}: {other.words}"
        return replace(calibration, notes=(*calibration.notes, note))
    if (words := study.other_truth()) is not None:
        note = f"the truth that the study names is not compared: truth.landmarks: {words}"
        return replace(calibration, notes=(*calibration.notes, note))
    truth = _errors(calibration, known)
    notes = tuple(f"{name}: not held against the truth, as {why}" for name, why in truth.not_compared.items())
    return replace(calibration, truth=truth, notes=(*calibration.notes, *notes))


def _errors(calibration: Calibration, known: Truth) -> TruthErrors:
    parameters = _parameters(parameter_rows(calibration), known.parameters)
    trials, why_not = {}, {}
    for trial in calibration.trials:
        curves = {"motion": known.motions.get(trial.name), "moments": known.moments.get(trial.name)}
        there = {what: c for what, c in curves.items() if c is not None}
        beside = {what: c for what, c in there.items() if not c.covers(trial.body.time).any()}
        if not there and (known.motions or known.moments):
            why_not[trial.name] = "no true curves of it are known"
        elif beside:
            times = (f"{what}, {c.time[0]:.2f} to {c.time[-1]:.2f} s" for what, c in beside.items())
            recorded = f"{trial.body.time[0]:.2f} to {trial.body.time[-1]:.2f} s"
            why_not[trial.name] = f"its true curves ({'; '.join(times)}) have no frame of the result ({recorded})"
        if len(beside) < len(there):
            trials[trial.name] = _trial(trial, *(None if what in beside else c for what, c in curves.items()))
    return TruthErrors(
        parameters=parameters, features=_features({p.name: p for p in parameters}), trials=trials, not_compared=why_not
    )


def _parameters(rows: Sequence[Mapping[str, Any]], true: Mapping[str, float]) -> tuple[ParameterTruth, ...]:
    to_si = dict(zip((*JP_NAMES, *IP_NAMES), (*JP_TO_SI, *IP_TO_SI), strict=True))
    return tuple(
        ParameterTruth(
            name=row["name"],
            kind=row["kind"],
            unit=row["unit"],
            truth=true[row["name"]] / to_si[row["name"]],
            nominal=row["nominal"],
            fitted=row["fitted"],
            error_bar=row["standard_error"],
            status=row["status"],
        )
        for row in rows
        if row["name"] in true
    )


def _features(parameters: Mapping[str, ParameterTruth]) -> tuple[FeatureTruth, ...]:
    out = []
    for joint, segment, part, words, directions in _FEATURES:
        for side in SIDES:
            names = [f"{joint}_{side}.{segment}.{direction}" for direction in directions]
            if not all(name in parameters for name in names):
                continue
            rows = [parameters[name] for name in names]
            if all(row.status == "fixed" for row in rows):
                continue
            nominal, fitted, true = (
                np.array([getattr(row, which) for row in rows]) for which in ("nominal", "fitted", "truth")
            )
            gap = _distance if rows[0].unit == "mm" else _angle(directions)
            out.append(
                FeatureTruth(
                    joint=f"{joint}_{side}",
                    part=part,
                    words=f"{joint_words(joint)} {words}",
                    unit=rows[0].unit,
                    nominal=gap(nominal, true),
                    fitted=gap(fitted, true),
                    within=tuple(bool(abs(row.z) <= INTERVAL) for row in rows if row.z is not None),
                )
            )
    return tuple(out)


def _distance(one: Array, other: Array) -> float:
    return float(np.linalg.norm(one - other))


def _angle(directions: tuple[str, ...]) -> _Gap:
    """Degrees between two joint axes, each told by its two angles: z of Rx(front) Ry(trans), x of Ry(trans) Rz(sag)."""
    turns, axis = ((_FRONT, _TRANS), 2) if directions == ("front", "trans") else ((_TRANS, _SAG), 0)

    def direction(angles: Array) -> Array:
        first, second = (axis_rotation(turn, np.deg2rad(a)) for turn, a in zip(turns, angles, strict=True))
        out: Array = (first @ second)[:, axis]
        return out

    def gap(one: Array, other: Array) -> float:
        a, b = direction(one), direction(other)
        return float(np.rad2deg(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))

    return gap


def _trial(trial: TrialResult, motions: TrueCurves | None, moments: TrueCurves | None) -> TrialTruth:
    coordinates, forces = {}, {}
    motion, time = trial.body, trial.body.time
    if motions is not None:
        true = motions.at(time)
        for name in (n for n in FILE_COORDINATES if n in true and n in motion.coordinates):
            scale, column = 1.0 if is_translation(name) else 180.0 / np.pi, motion.coordinates.index(name)
            before = trial.nominal
            old = (
                before.q[:, before.coordinates.index(name)]
                if name in before.coordinates
                else np.full(len(time), np.nan)
            )
            coordinates[name] = CurveTruth(
                name=name,
                truth=scale * true[name],
                fitted=scale * motion.q[:, column],
                nominal=scale * old,
                error_bar=None if trial.coordinate_errors is None else scale * trial.coordinate_errors[:, column],
                counts=np.ones(len(time), dtype=bool),
            )
    if moments is not None and (loads := trial.loads) is not None:
        true = moments.at(time)
        for name in (n for n in (*FILE_COORDINATES, *REACTIONS) if n in true):
            forces[name] = CurveTruth(
                name=name,
                truth=true[name],
                fitted=moment_of(loads.final, name),
                nominal=moment_of(loads.nominal, name),
                error_bar=None if loads.errors is None else moment_of(loads.errors, name),
                counts=loads.reactions.valid_for(name),
            )
    return TrialTruth(time, coordinates, forces)
