"""The truth in a result, of a person of whom it is known: `truth/`, and the entry `truth` of `summary.json`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from gaitcal.arrays import Array
from gaitcal.results.table_file import Json, columns_of, write_csv
from gaitcal.session.truth_errors import CurveTruth, FeatureTruth, TruthErrors
from gaitcal.study.truth import MOMENTS, MOTION

FOLDER = "truth"
PARAMETERS_HEADER = (
    "what is known to be true beside what was calibrated, told in the same segment frames; error: fitted minus truth",
    "z: error in standard errors; of honest ones 95 of 100 are below 1.96",
)
MOTION_HEADER = (
    "true coordinates in degrees and m at the frames of motion/TRIAL.csv, from the anatomical zero",
    "_error: calibrated minus true; empty: the truth has no such instant",
)
MOMENTS_HEADER = (
    "true generalised forces in N m (pelvis_tx, _ty, _tz: N) at the frames of moments/TRIAL.csv",
    "_error: calibrated minus true, empty in frames that do not count (valid_r, valid_l, valid)",
)


def write_truth(truth: TruthErrors | None, out: Path) -> None:
    """Write `truth/parameters.csv`, `truth/TRIAL_motion.csv` and `truth/TRIAL_moments.csv`; nothing if None."""
    if truth is None:
        return
    folder = out / FOLDER
    folder.mkdir(exist_ok=True)
    rows = [
        {
            "name": p.name,
            "kind": p.kind,
            "unit": p.unit,
            "truth": p.truth,
            "nominal": p.nominal,
            "fitted": p.fitted,
            "standard_error": p.error_bar,
            "error": p.error,
            "z": p.z,
            "status": p.status,
        }
        for p in truth.parameters
    ]
    write_csv(columns_of(rows), folder / "parameters.csv", PARAMETERS_HEADER)
    for name, trial in truth.trials.items():
        for curves, time, ending, header in (
            (trial.coordinates, trial.time, MOTION, MOTION_HEADER),
            (trial.forces, trial.time, MOMENTS, MOMENTS_HEADER),
        ):
            if curves:
                write_csv(_curve_table(time, curves), folder / (name + ending), header)


def _curve_table(time: Array, curves: Mapping[str, CurveTruth]) -> dict[str, Array]:
    columns = {"time": time}
    for name, curve in curves.items():
        columns[name] = curve.truth
        columns[f"{name}_error"] = np.where(curve.compared, curve.fitted - curve.truth, np.nan)
    return columns


def truth_summary(truth: TruthErrors) -> dict[str, Json]:
    """Fitted parameters, joint centres and axes, and curves of each trial; units as in the files of the result."""
    return {
        "parameters": {
            p.name: _known(unit=p.unit, nominal_error=p.nominal_error, error=p.error, standard_error=p.error_bar, z=p.z)
            for p in truth.parameters
            if p.status == "fitted"
        },
        "undetermined": [p.name for p in truth.parameters if p.status == "unidentifiable"],
        "not_compared": dict(truth.not_compared),
        "joints": {
            joint: {f.part: _feature(f) for f in truth.features if f.joint == joint}
            for joint in dict.fromkeys(f.joint for f in truth.features)
        },
        "trials": {
            name: {"coordinates": _curves(trial.coordinates), "forces": _curves(trial.forces)}
            for name, trial in truth.trials.items()
        },
    }


def _feature(f: FeatureTruth) -> dict[str, Json]:
    """`within`: how many `of` its parameters with standard errors hold the truth."""
    held = (sum(f.within), len(f.within)) if f.within else (None, None)
    return _known(unit=f.unit, nominal_error=f.nominal, error=f.fitted, within=held[0], of=held[1])


def _curves(curves: Mapping[str, CurveTruth]) -> dict[str, Json]:
    return {
        name: _known(rms_error=c.rms, nominal_rms_error=c.nominal_rms, share_within=c.share_within)
        for name, c in curves.items()
        if c.rms is not None
    }


def _known(**figures: Json) -> dict[str, Json]:
    """Figures that exist; the others are absent."""
    return {key: round(v, 6) if isinstance(v, float) else v for key, v in figures.items() if v is not None}
