"""The row of the table of people that a result folder gives, from its files alone.

Fits join the walks: RMS = sqrt(sum n_i rms_i^2 / sum n_i) over n_i frames (residuals: valid frames) of walk i.
Peaks are of the mean over valid strides (`gait/ensemble.py`), where at least `LEAST_VALID` of its percents are valid;
moments and powers by body mass. Their standard error is that of the mean at that percent; of a range, whose ends are
far apart in the stride, it is taken as if their errors were independent: se = sqrt(se_max^2 + se_min^2).
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from gaitcal.arrays import Array
from gaitcal.codes import Code
from gaitcal.cohort.columns import ANGLES, MEASURED, NAMES, UNITS
from gaitcal.cohort.outcome import Cell
from gaitcal.errors import InputError
from gaitcal.faults.verdict import Judgement
from gaitcal.gait.spatiotemporal import LEAST_VALID
from gaitcal.io.lock import MANIFEST, read_object
from gaitcal.model.linkage import SIDES
from gaitcal.results.stride_files import ENSEMBLE
from gaitcal.results.table_file import read_csv
from gaitcal.results.verdict import SUMMARY


def peaks(ensemble: Path, mass: float) -> dict[str, float]:
    """Column -> value, of `ensemble.csv`; nothing of what is not known. `mass`: kg."""
    try:
        table, _ = read_csv(ensemble)
    except (OSError, pd.errors.EmptyDataError):
        return {}
    table = table[table["variable"].isin(UNITS) & table["side"].isin(SIDES)]
    curves = {name: pd.to_numeric(table[name], errors="coerce").to_numpy(np.float64) for name in ("mean", "se")}
    out: dict[str, float] = {}
    for (variable, side), rows in table.groupby(["variable", "side"], sort=False).indices.items():
        scale = 1.0 if variable in ANGLES else 1.0 / mass
        for peak, (value, error) in _peaks(scale * curves["mean"][rows], scale * curves["se"][rows]).items():
            out[f"{variable}_{peak}_{side}"] = value
            out[f"{variable}_{peak}_se_{side}"] = error
    return out


def _peaks(mean: Array, error: Array) -> dict[str, tuple[float, float]]:
    """Of one curve (101,): value and standard error of each kind."""
    if np.isfinite(mean).mean() < LEAST_VALID:
        return {}
    high, low = int(np.nanargmax(mean)), int(np.nanargmin(mean))
    return {
        "max": (float(mean[high]), float(error[high])),
        "min": (float(mean[low]), float(error[low])),
        "range": (float(mean[high] - mean[low]), float(np.hypot(error[high], error[low]))),
    }


PAGE = "result.html"
DIGITS = 6
_FITS = {"marker_rms": "rms_mm", "legs_rms": "pelvis_and_legs_mm"}


def row_of(folder: Path) -> dict[str, Cell]:
    """Column -> value of a result folder, all but those of the cohort itself (group, folder, ...).

    Raises
    ------
    InputError
        It is no result of a calibration.
    """
    manifest: dict[str, Any] = read_object(folder / MANIFEST)
    summary: dict[str, Any] = read_object(folder / SUMMARY)
    if "subject" not in manifest or "trials" not in summary:
        raise InputError("is no result of 'gaitcal calibrate'", source=folder, code=Code.NO_RESULT)
    subject, reasons = manifest["subject"], summary.get("reasons") or [{}]
    trials: dict[str, dict[str, Any]] = summary["trials"]
    walks = [trial for trial in trials.values() if trial.get("role") == "gait"]
    row: dict[str, Cell] = {
        "person": subject["name"],
        "page": PAGE if (folder / PAGE).is_file() else "",
        "verdict": summary["verdict"],
        "first_cause": reasons[0].get("cause", ""),
        "first_action": reasons[0].get("action", ""),
        "reasons": len(summary.get("reasons") or ()),
        "status": summary.get("status", ""),
        **{name: subject.get(name) for name in ("sex", "mass_kg", "height_m", "age_years")},
        "walks": len(walks),
        **_legs(walks),
        **dict(_fits(walks or list(trials.values()))),
        **dict(_residuals(walks)),
        **dict(_spatiotemporal(summary.get("spatiotemporal") or {})),
        **peaks(folder / ENSEMBLE, float(subject["mass_kg"])),
        "gaitcal": manifest["gaitcal"],
        "settings_sha256": _digest(manifest.get("settings")),
        "inputs_sha256": _digest(manifest.get("inputs_sha256")),
    }
    return {name: _cell(row[name]) for name in NAMES if name in row}


def reasons_of(folder: Path) -> tuple[dict[str, str], ...]:
    """Severity, cause and action of every reason of a result folder's verdict, the worst first."""
    summary: dict[str, Any] = read_object(folder / SUMMARY)
    found: Iterable[Mapping[str, Any]] = summary.get("reasons") or ()
    return tuple({name: str(reason.get(name) or "") for name in ("severity", "cause", "action")} for reason in found)


def _cell(value: Cell) -> Cell:
    if isinstance(value, float):
        return round(value, DIGITS) if math.isfinite(value) else None
    return value


def _digest(content: object) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _legs(walks: Iterable[Mapping[str, Any]]) -> dict[str, Cell]:
    """Verdict of each leg, and in how many walks it is refused."""
    out: dict[str, Cell] = {}
    for side in SIDES:
        said = [Judgement(walk[f"verdict_{side}"]) for walk in walks if f"verdict_{side}" in walk]
        left = [judgement for judgement in said if judgement is not Judgement.REFUSED]
        judged = Judgement.worst(left) if left else Judgement.REFUSED
        out[f"verdict_{side}"] = judged.value if said else ""
        out[f"walks_refused_{side}"] = len(said) - len(left)
    return out


def _fits(trials: Iterable[Mapping[str, Any]]) -> Iterator[tuple[str, Cell]]:
    found = list(trials)
    for where, entry in _FITS.items():
        for name in ("nominal", "calibrated", "rigid_floor", "joint_floor"):
            pairs = [(t["frames"], (t.get(entry) or t.get("rms_mm") or {}).get(name)) for t in found if "frames" in t]
            yield f"{where}_{name}_mm", _together(pairs)


def _residuals(walks: Iterable[Mapping[str, Any]]) -> Iterator[tuple[str, Cell]]:
    told = [
        (walk["valid_frames"], list(walk["pelvis_residual"].values())) for walk in walks if "pelvis_residual" in walk
    ]
    for name, k in (("nominal", 0), ("calibrated", -1)):
        yield f"residual_force_{name}_N", _together([(n, stages[k]["force_N"]) for n, stages in told])
        yield f"residual_moment_{name}_Nm", _together([(n, stages[k]["torque_Nm"]) for n, stages in told])
    limits = [
        (walk["valid_frames"], walk["pelvis_residual_limit"]) for walk in walks if "pelvis_residual_limit" in walk
    ]
    yield "residual_force_limit_N", _together([(n, limit["force_N"]) for n, limit in limits])
    yield "residual_moment_limit_Nm", _together([(n, limit["torque_Nm"]) for n, limit in limits])


def _together(pairs: Iterable[tuple[int, float | None]]) -> float | None:
    """RMS over trials of so many frames; None where none tells it."""
    known = [(n, value) for n, value in pairs if value is not None]
    frames = sum(n for n, _ in known)
    return math.sqrt(sum(n * value**2 for n, value in known) / frames) if frames else None


def _spatiotemporal(means: Mapping[str, Mapping[str, Any]]) -> Iterator[tuple[str, Cell]]:
    for side in SIDES:
        for name in MEASURED:
            found = means.get(name, {}).get(side) or {}
            yield f"{name}_{side}", found.get("mean")
            yield f"{name}_sd_{side}", found.get("sd")
        yield f"strides_{side}", (means.get("stride_time", {}).get(side) or {}).get("strides", 0)
