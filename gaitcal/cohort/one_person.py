"""One person of a cohort, from the folder of recordings to the result folder: what `gaitcal
calibrate FOLDER` does, with nobody to ask; and the row and curves that a result gives.

A result folder's row of the table of people, and its mean curves for the page, come from its files
alone. Fits join the walks: RMS = sqrt(sum n_i rms_i^2 / sum n_i) over n_i frames (residuals: valid
frames) of walk i. Peaks are those of the phases of the stride (`gait/peaks.py`); loads are by body
mass.

Curves are means over valid strides (`gait/ensemble.py`) at every second percent, as 16-bit integers
in steps of a size that is the same for everybody: people can be packed one by one. Three bytes are
four letters of base64, and a person's bytes are divisible by three, so that people's texts one
behind the other are the text of all.
"""

import base64
import hashlib
import json
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np
import pandas as pd

from gaitcal.cohort.cohort_people import CohortPerson, is_folder, no_folder
from gaitcal.errors import STUDY, Code, InputError
from gaitcal.gait import profile_score, spatiotemporal
from gaitcal.gait.cycles import WALKING, CurveKind, get_curve_kind
from gaitcal.gait.peaks import PEAK_COLUMNS, PEAKS
from gaitcal.intake import draft_file as drafts
from gaitcal.intake.drafting import draft_folder
from gaitcal.intake.recordings_folder import read_folder
from gaitcal.io.result_folder import MANIFEST, compute_sha256, read_json_object
from gaitcal.model.linkage import SIDES
from gaitcal.pipeline.run_study import FaultyStudyError, RunSettings, run_found_study
from gaitcal.quality.verdict import Judgement
from gaitcal.report.page.plain_data import GAP
from gaitcal.results.stride_files import PEAKS as PEAKS_FILE
from gaitcal.results.summary import SUMMARY
from gaitcal.results.table_files import read_csv
from gaitcal.study.settings import CalibrationSettings
from gaitcal.study.study import Study

ANYWAY = 0.005
"""Relative difference of a study file's mass or height from what else is said of the person, from
which it is told.
"""


@dataclass(frozen=True, kw_only=True)
class CommonSettings:
    """What is the same for everyone of a cohort."""

    calibration: CalibrationSettings = field(default_factory=CalibrationSettings)
    """Of it, what was said; a study file of a person's own comes before."""
    normal: Path | None = None  # File of normal bands
    priors: Path | None = None  # `priors.json` of a cohort, on which joint parameters lean

    @property
    def said(self) -> dict[str, object]:
        """The settings that were said."""
        return {
            name: getattr(self.calibration, name)
            for name in sorted(self.calibration.model_fields_set)
        }


class PersonError(InputError):
    """Why a person has no result, and what to do."""

    def __init__(self, cause: str, action: str = "", *, code: Code) -> None:
        super().__init__(cause, code=code)
        self.action = " ".join(action.split())


def calibrate_person(person: CohortPerson, out: Path, common: CommonSettings) -> None:
    """Calibrate a person and write the result folder `out`; a refused verdict is a result, too.

    Raises InputError: No study follows from the folder, or the checks find an error: a
    `PersonError` says what to do.
    """
    if not is_folder(person.folder):
        raise PersonError(
            no_folder(person),
            "put the recordings there, or take the person out of the list",
            code=Code.FOLDER,
        )
    folder = read_folder(person.folder)
    source = drafts.find_study_in_folder(folder) or _ready(draft_folder(folder, person.told))
    del folder  # the recordings of all files, also of those that are not used
    settings = RunSettings(
        normal=common.normal, priors=common.priors, calibration=common.calibration
    )

    def contradictions(study: Study) -> tuple[str, ...]:
        return _contradictions(person, study, common) if isinstance(source, Path) else ()

    try:
        run_found_study(source, out, settings, notes_on=contradictions)
    except FaultyStudyError as refused:
        first, more = refused.errors[0], len(refused.errors) - 1
        place = "" if first.where == STUDY else f"trial '{first.where}': "
        cause = f"{place}{first.topic}: {first.evidence}" + (
            f" (and {more} more errors)" if more else ""
        )
        raise PersonError(
            cause, first.cure or "gaitcal check shows all of it", code=first.code
        ) from None


def _ready(draft: drafts.Draft) -> drafts.Draft:
    """The draft; PersonError where it cannot be run."""
    if draft.fault or draft.problem:
        cause, put, action = (draft.fault or draft.problem).partition(": put each")
        action = f"{put[2:]}{action}" if action else "gaitcal init on this folder shows every file"
        raise PersonError(cause, action, code=Code.FOLDER)
    if draft.missing:
        fields = ", ".join(draft.missing)
        raise PersonError(
            drafts.describe_missing_fields(draft),
            f"give {fields} in people.csv or cohort.toml",
            code=Code.WHO_IT_IS,
        )
    return draft


def _contradictions(person: CohortPerson, study: Study, common: CommonSettings) -> tuple[str, ...]:
    """What was said of a person whose own study file says otherwise, and is used."""
    said = (
        ("mass_kg", person.told.mass, study.subject.mass),
        ("height_m", person.told.height, study.subject.height),
    )
    found = [
        f"{field} = {other:g} was said for the cohort; the study file's {value:g} is used"
        for field, other, value in said
        if other is not None and abs(other / value - 1) > ANYWAY
    ]
    own = study.joint_prior
    if (
        own is not None
        and common.priors is not None
        and own.sha256 != compute_sha256(common.priors)
    ):
        found.append(
            f"priors = {common.priors.name} was said for the cohort; the study file's {own.file} "
            "is used"
        )
    return tuple(found)


RECORD: Final = ("session_date", "diagnosis", "affected_side", "aids", "laboratory")
"""Of what a clinic writes down, the columns of the table of people."""
Cell: TypeAlias = str | int | float | None  # Of the table of people
PER_KG: Final = {
    CurveKind.ANGLE: "deg",
    CurveKind.MOMENT: "N m/kg",
    CurveKind.POWER: "W/kg",
    CurveKind.FORCE: "N/kg",
}
"""Unit of what is by body mass, but for angles."""
MEASURED: Final = (
    *(
        "speed",
        "cadence",
        "stride_length",
        "step_length",
        "step_width",
        "stride_time",
        "stance_percent",
    ),
    *("double_support_percent", "single_support_percent"),
)
_FIT: Final = {
    "nominal": "of the model as palpated",
    "calibrated": "of the calibrated model",
    "rigid_floor": "that moving skin leaves to rigid segments without joints",
    "joint_floor": "that it leaves to segments with joints",
}
_WALKS: Final = "over all walks, frames counting alike (isolated trials where there is no walk)"


@dataclass(frozen=True)
class Column:
    """One column."""

    name: str
    kind: type  # `str`, `int` or `float`
    unit: str
    meaning: str


def _columns() -> tuple[Column, ...]:
    def words(*columns: tuple[str, str]) -> list[Column]:
        return [Column(name, str, "", meaning) for name, meaning in columns]

    out = [
        *words(
            ("person", "name"),
            ("session", "empty where there is one only"),
            ("group", "as people.csv or cohort.toml says"),
            ("folder", "result folder, from where this table lies"),
            ("page", "the result's page, from where this table lies"),
            ("verdict", "trustworthy, doubtful or refused"),
            (
                "verdict_r",
                "of the right leg: refused in every walk, or the worst of the other walks",
            ),
            ("verdict_l", "of the left leg"),
            ("first_cause", "the worst reason of the verdict"),
            ("first_action", "what to do about it"),
        ),
        Column("reasons", int, "", "number of reasons of the verdict"),
        *words(("status", "converged or not converged"), ("sex", "female or male")),
        Column("mass_kg", float, "kg", "body mass"),
        Column("height_m", float, "m", "body height"),
        Column("age_years", float, "years", "as told"),
        *words(
            ("session_date", "of the recordings"),
            ("diagnosis", "as the study file says"),
            ("affected_side", "of the diagnosis: right, left, both or none"),
            ("aids", "orthoses, shoes, crutches, walkers, as the study file says"),
            ("laboratory", "as the study file says"),
        ),
        Column("walks", int, "", "walks that were used"),
        Column(
            "activities",
            str,
            "",
            "trials of any other activity; activity_peaks.csv has what they repeat",
        ),
        *(
            Column(f"walks_refused_{s}", int, "", f"walks in which the {leg} leg is refused")
            for s, leg in _LEGS
        ),
    ]
    for where, markers in (
        ("marker_rms", "all markers"),
        ("legs_rms", "markers of pelvis and legs"),
    ):
        for name, what in _FIT.items():
            out.append(
                Column(
                    f"{where}_{name}_mm", float, "mm", f"RMS distance of {markers} {what}, {_WALKS}"
                )
            )
    for stage, meaning in (
        ("nominal", "pelvis residual of the nominal model"),
        ("calibrated", "pelvis residual of the calibrated model"),
        ("limit", "largest pelvis residual that errors explain"),
    ):
        for quantity, name, unit in (("force", "N", "N"), ("moment", "Nm", "N m")):
            meant = f"{meaning}, RMS over valid frames of all walks"
            out.append(Column(f"residual_{quantity}_{stage}_{name}", float, unit, meant))
    for name in MEASURED:
        for side, leg in _LEGS:
            where = f"{name} of the {leg} leg's valid straight strides"
            out.append(
                Column(f"{name}_{side}", float, spatiotemporal.MEASURES[name], f"mean {where}")
            )
            out.append(
                Column(
                    f"{name}_sd_{side}",
                    float,
                    spatiotemporal.MEASURES[name],
                    f"standard deviation, {where}",
                )
            )
    out += [
        Column(f"strides_{side}", int, "", f"valid straight strides of the {leg} leg")
        for side, leg in _LEGS
    ]
    for peak in PEAKS.values():
        for side, leg in _LEGS:
            meant = f"{peak.make_title()} ({peak.window_label}): mean over straight strides of the {leg} foot"
            unit = PER_KG[get_curve_kind(peak.variable)]
            out.append(Column(f"{peak.name}_{side}", float, unit, meant))
            out.append(Column(f"{peak.name}_se_{side}", float, unit, f"standard error: {meant}"))
    for side, leg in (*_LEGS, (profile_score.BOTH, "both legs")):
        meant = f"Gait Profile Score of {leg}, against healthy people of that age and speed"
        out.append(Column(f"gait_profile_score_{side}", float, "deg", meant))
        out.append(
            Column(f"gait_profile_score_se_{side}", float, "deg", f"standard error: {meant}")
        )
    out += words(
        ("gaitcal", "version"),
        ("settings_sha256", "of the settings in manifest.json"),
        ("inputs_sha256", "of the SHA-256 of all inputs in manifest.json"),
    )
    return tuple(out)


_LEGS: Final = tuple(zip(SIDES, ("right", "left"), strict=True))
COLUMNS: Final = _columns()
NAMES: Final = tuple(column.name for column in COLUMNS)
EVERY: Final = 2  # % of the stride between two points of a curve
STEPS: Final = {CurveKind.ANGLE: 0.01, CurveKind.MOMENT: 0.0005, CurveKind.POWER: 0.002}
"""What one of the whole numbers is: deg, N m/kg, W/kg."""
VARIABLES: Final = (
    *(
        "hip_flexion",
        "hip_flexion_moment",
        "hip_power",
        "hip_adduction",
        "hip_adduction_moment",
        "hip_rotation",
    ),
    *("knee_angle", "knee_angle_moment", "knee_power", "knee_adduction_moment"),
    *("ankle_angle", "ankle_angle_moment", "ankle_power"),
)
"""Of `cycles.csv`, in the order of the packed curves; right before left."""
SHAPE: Final = (len(VARIABLES), len(SIDES), 100 // EVERY + 1)
PAGE = "result.html"
DIGITS = 6
_FITS = {"marker_rms": "rms_mm", "legs_rms": "pelvis_and_legs_mm"}


def _table(path: Path, *, walking: bool = True) -> pd.DataFrame | None:
    """A table of a result, as text, of walking, or of other activities, alone; None where there is
    none.
    """
    try:
        table, _ = read_csv(path)
    except (OSError, pd.errors.EmptyDataError):
        return None
    return table[(table["activity"] == WALKING) == walking] if "activity" in table else table


def activity_peaks(folder: Path) -> list[list[str]]:
    """The rows of `peaks.csv` of a result folder that are of other activities than walking."""
    table = _table(folder / PEAKS_FILE, walking=False)
    return [] if table is None else table[[*PEAK_COLUMNS]].to_numpy().tolist()


def _by_mass(variable: str, mass: float) -> float:
    """Factor of a curve: all but angles are by body mass (kg)."""
    return 1.0 if get_curve_kind(variable) is CurveKind.ANGLE else 1.0 / mass


def _peaks(peaks: Path, mass: float) -> Iterator[tuple[str, float]]:
    """Column and value; nothing of what is not known."""
    table = _table(peaks)
    for row in () if table is None else table.to_dict("records"):
        for column, name in (("mean", row["peak"]), ("se", f"{row['peak']}_se")):
            yield (
                f"{name}_{row['side']}",
                _by_mass(row["variable"], mass) * float(row[column] or "nan"),
            )


def mean_curves(ensemble: Path, mass: float) -> str:
    """Base64 of the curves of `ensemble.csv`, little-endian integers of `SHAPE`; empty where there
    is none.

    `mass`: kg.
    """
    packed, table = np.full(SHAPE, GAP, dtype="<i2"), _table(ensemble)
    known = (
        []
        if table is None
        else table[table["variable"].isin(VARIABLES)].groupby(["variable", "side"], sort=False)
    )
    for (variable, side), rows in known:
        percent, mean = (
            pd.to_numeric(rows[name], errors="coerce").to_numpy(np.float64)
            for name in ("percent", "mean")
        )
        mean = _by_mass(variable, mass) * mean
        here = np.isfinite(mean) & (percent % EVERY == 0)
        whole = np.clip(np.rint(mean[here] / STEPS[get_curve_kind(variable)]), GAP + 1, -GAP - 1)
        packed[
            VARIABLES.index(variable), SIDES.index(side), (percent[here] / EVERY).astype(int)
        ] = whole
    return "" if (packed == GAP).all() else base64.b64encode(packed.tobytes()).decode("ascii")


def no_curves() -> str:
    """The curves of somebody who has none."""
    return base64.b64encode(np.full(SHAPE, GAP, dtype="<i2").tobytes()).decode("ascii")


def row_of(folder: Path) -> dict[str, Cell]:
    """Column -> value of a result folder, all but those of the cohort itself (group, folder, ...).

    Raises InputError: It is no result of a calibration.
    """
    manifest: dict[str, Any] = read_json_object(folder / MANIFEST)
    summary: dict[str, Any] = read_json_object(folder / SUMMARY)
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
        **{
            name: subject.get(name) for name in ("sex", "mass_kg", "height_m", "age_years", *RECORD)
        },
        "walks": len(walks),
        "activities": " ".join(
            name for name, trial in trials.items() if trial.get("role") == "motion"
        ),
        **_legs(walks),
        **dict(_fits(walks or list(trials.values()))),
        **dict(_residuals(walks)),
        **dict(_spatiotemporal(summary.get("spatiotemporal") or {})),
        **dict(_profile_scores(summary.get("gait_profile") or {})),
        **dict(_peaks(folder / PEAKS_FILE, float(subject["mass_kg"]))),
        "gaitcal": manifest["gaitcal"],
        **{
            f"{key.removesuffix('_sha256')}_sha256": _digest(manifest.get(key))
            for key in ("settings", "inputs_sha256")
        },
    }
    for name, value in row.items():
        if isinstance(value, float):
            row[name] = round(value, DIGITS) if math.isfinite(value) else None
    return {name: row[name] for name in NAMES if name in row}


def reasons_of(folder: Path) -> tuple[dict[str, str], ...]:
    """Severity, cause and action of every reason of a result folder's verdict, the worst first."""
    summary: dict[str, Any] = read_json_object(folder / SUMMARY)
    found: Iterable[Mapping[str, Any]] = summary.get("reasons") or ()
    return tuple(
        {name: str(reason.get(name) or "") for name in ("severity", "cause", "action")}
        for reason in found
    )


def _digest(content: object) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _legs(walks: Iterable[Mapping[str, Any]]) -> dict[str, Cell]:
    """Verdict of each leg, and in how many walks it is refused."""
    out: dict[str, Cell] = {}
    for side in SIDES:
        said = [Judgement(walk[f"verdict_{side}"]) for walk in walks if f"verdict_{side}" in walk]
        left = [judgement for judgement in said if judgement is not Judgement.REFUSED]
        judged = Judgement.select_worst(left) if left else Judgement.REFUSED
        out[f"verdict_{side}"] = judged.value if said else ""
        out[f"walks_refused_{side}"] = len(said) - len(left)
    return out


def _fits(trials: Iterable[Mapping[str, Any]]) -> Iterator[tuple[str, Cell]]:
    found = list(trials)
    for where, entry in _FITS.items():
        for name in ("nominal", "calibrated", "rigid_floor", "joint_floor"):
            pairs = [
                (t["frames"], (t.get(entry) or t.get("rms_mm") or {}).get(name))
                for t in found
                if "frames" in t
            ]
            yield f"{where}_{name}_mm", _together(pairs)


def _residuals(walks: Iterable[Mapping[str, Any]]) -> Iterator[tuple[str, Cell]]:
    stages = [
        (w["valid_frames"], list(w["pelvis_residual"].values()))
        for w in walks
        if "pelvis_residual" in w
    ]
    limits = [
        (w["valid_frames"], w["pelvis_residual_limit"])
        for w in walks
        if "pelvis_residual_limit" in w
    ]
    for stage, found in (
        ("nominal", [(frames, of_stage[0]) for frames, of_stage in stages]),
        ("calibrated", [(frames, of_stage[-1]) for frames, of_stage in stages]),
        ("limit", limits),
    ):
        yield (
            f"residual_force_{stage}_N",
            _together([(frames, one["force_N"]) for frames, one in found]),
        )
        yield (
            f"residual_moment_{stage}_Nm",
            _together([(frames, one["torque_Nm"]) for frames, one in found]),
        )


def _together(pairs: Iterable[tuple[int, float | None]]) -> float | None:
    """RMS over trials of so many frames; None where none tells it."""
    known = [(n, value) for n, value in pairs if value is not None]
    frames = sum(n for n, _ in known)
    return math.sqrt(sum(n * value**2 for n, value in known) / frames) if frames else None


def _profile_scores(profile: Mapping[str, Mapping[str, Any]]) -> Iterator[tuple[str, Cell]]:
    for side, of_side in profile.items():
        yield f"gait_profile_score_{side}", of_side[profile_score.GPS]["score"]
        yield f"gait_profile_score_se_{side}", of_side[profile_score.GPS].get("se")


def _spatiotemporal(means: Mapping[str, Mapping[str, Any]]) -> Iterator[tuple[str, Cell]]:
    for side in SIDES:
        for name in MEASURED:
            found = means.get(name, {}).get(side) or {}
            yield f"{name}_{side}", found.get("mean")
            yield f"{name}_sd_{side}", found.get("sd")
        yield f"strides_{side}", (means.get("stride_time", {}).get(side) or {}).get("strides", 0)
