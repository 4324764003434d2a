"""Calibrate one person of a cohort, and make the row and curves of a result.

It does what `gaitcal calibrate FOLDER` does, without questions. The row of a result in the table of
people, and its mean curves for the page, come from its files. Marker errors and residuals are
pooled over walks: RMS = sqrt(sum n_i rms_i^2 / sum n_i) over n_i frames (residuals: valid frames)
of walk i. Peaks are those of the phases of the stride (`gait/peaks.py`); loads are per body mass.

Curves are means over valid strides (`gait/ensemble.py`) at every second percent, as 16-bit integers
in steps that are the same for everyone, so that people can be packed one by one. Three bytes are
four letters of base64, and the number of a person's bytes is divisible by three: the texts of all
people in sequence are the text of all.
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

from gaitcal.cohort.cohort_people import CohortPerson, describe_missing_folder, is_folder
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

CONTRADICTION = 0.005
"""Relative difference between mass or height of a study file and of the cohort from which it is
reported: rounding.
"""


@dataclass(frozen=True, kw_only=True)
class CommonSettings:
    """Settings of everyone in a cohort."""

    calibration: CalibrationSettings = field(default_factory=CalibrationSettings)
    """Given settings apply; a person's study file takes precedence."""
    normal: Path | None = None
    """File of normal bands."""
    priors: Path | None = None
    """`priors.json` of a cohort: prior of the joint parameters."""

    @property
    def given_settings(self) -> dict[str, object]:
        """The settings that were given, by name."""
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
    """Calibrate a person and write the result folder; a refused verdict is also a result.

    Parameters
    ----------
    person : CohortPerson
        One session of a person.
    out : Path
        The result folder.
    common : CommonSettings
        Settings of everyone.

    Raises
    ------
    InputError
        The folder gives no study, or the checks find an error; a `PersonError` has what to do.
    """
    if not is_folder(person.folder):
        raise PersonError(
            describe_missing_folder(person),
            "put the recordings there, or remove the person from the list",
            code=Code.FOLDER,
        )
    folder = read_folder(person.folder)
    source = drafts.find_study_in_folder(folder) or _require_complete(
        draft_folder(folder, person.options)
    )
    # Frees the recordings of all files, also of those that are not used.
    del folder
    # The study is run as `gaitcal calibrate` does it, so that both give the same result.
    settings = RunSettings(
        normal=common.normal, priors=common.priors, calibration=common.calibration
    )

    def note_contradictions(study: Study) -> tuple[str, ...]:
        return _describe_contradictions(person, study, common) if isinstance(source, Path) else ()

    try:
        run_found_study(source, out, settings, notes_on=note_contradictions)
    except FaultyStudyError as refused:
        # The table of failures has one line for each person: the first error, and how many more.
        first, more = refused.errors[0], len(refused.errors) - 1
        where = "" if first.where == STUDY else f"trial '{first.where}': "
        others = f" (and {more} more errors)" if more else ""
        cause = f"{where}{first.topic}: {first.evidence}{others}"
        action = first.cure or "gaitcal check shows all errors"
        raise PersonError(cause, action, code=first.code) from None


def _require_complete(draft: drafts.Draft) -> drafts.Draft:
    """Return the draft; PersonError if it cannot be run."""
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


def _describe_contradictions(
    person: CohortPerson, study: Study, common: CommonSettings
) -> tuple[str, ...]:
    """Describe settings of the cohort that differ from those of a person's study file."""
    subject = (
        ("mass_kg", person.options.mass, study.subject.mass),
        ("height_m", person.options.height, study.subject.height),
    )
    found = [
        f"{field} = {other:g} is given for the cohort; {value:g} of the study file is used"
        for field, other, value in subject
        if other is not None and abs(other / value - 1) > CONTRADICTION
    ]
    # Priors are compared by content, not by name.
    prior, priors = study.joint_prior, common.priors
    if prior is not None and priors is not None and prior.sha256 != compute_sha256(priors):
        found.append(
            f"priors = {priors.name} is given for the cohort; {prior.file} of the study file is "
            "used"
        )
    return tuple(found)


RECORD: Final = ("session_date", "diagnosis", "affected_side", "aids", "laboratory")
"""Fields of the patient record that are columns of the table of people."""
_LEGS: Final = tuple(zip(SIDES, ("right", "left"), strict=True))
Cell: TypeAlias = str | int | float | None
"""A cell of the table of people."""
PER_KG: Final = {
    CurveKind.ANGLE: "deg",
    CurveKind.MOMENT: "N m/kg",
    CurveKind.POWER: "W/kg",
    CurveKind.FORCE: "N/kg",
}
"""Kind of curve -> unit, per body mass."""
MEASURED: Final = (
    "speed",
    "cadence",
    "stride_length",
    "step_length",
    "step_width",
    "stride_time",
    "stance_percent",
    "double_support_percent",
    "single_support_percent",
)
"""Measures of `spatiotemporal.csv` in the table of people."""
_FIT: Final = {
    "nominal": "from the nominal model",
    "calibrated": "from the calibrated model",
    "rigid_floor": "from rigid segments without joints (soft tissue)",
    "joint_floor": "from segments with each joint by itself (soft tissue)",
}
_WALKS: Final = "pooled over the frames of all walks (functional trials if there is no walk)"


@dataclass(frozen=True)
class Column:
    """One column of the table of people."""

    name: str
    kind: type
    """`str`, `int` or `float`."""
    unit: str
    meaning: str


def _make_text_columns(*columns: tuple[str, str]) -> list[Column]:
    """Make columns of text from names and meanings."""
    return [Column(name, str, "", meaning) for name, meaning in columns]


def _make_subject_columns() -> list[Column]:
    """Make the columns of person, verdict, metadata and trials."""
    return [
        *_make_text_columns(
            ("person", "name"),
            ("session", "empty if there is only one"),
            ("group", "from people.csv or cohort.toml"),
            ("folder", "result folder, relative to this table"),
            ("page", "page of the result, relative to this table"),
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
        *_make_text_columns(("status", "converged or not converged"), ("sex", "female or male")),
        Column("mass_kg", float, "kg", "body mass"),
        Column("height_m", float, "m", "body height"),
        Column("age_years", float, "years", "as given"),
        *_make_text_columns(
            ("session_date", "of the recordings"),
            ("diagnosis", "from the study file"),
            ("affected_side", "of the diagnosis: right, left, both or none"),
            ("aids", "orthoses, shoes, crutches, walkers, from the study file"),
            ("laboratory", "from the study file"),
        ),
        Column("walks", int, "", "walks that were used"),
        Column(
            "activities",
            str,
            "",
            "trials of any other activity; activity_peaks.csv has their repetitions",
        ),
        *(
            Column(f"walks_refused_{s}", int, "", f"walks in which the {leg} leg is refused")
            for s, leg in _LEGS
        ),
    ]


def _make_fit_columns() -> list[Column]:
    """Make the columns of marker errors and pelvis residuals."""
    out = []
    for where, markers in (
        ("marker_rms", "all markers"),
        ("legs_rms", "markers of pelvis and legs"),
    ):
        for name, reference in _FIT.items():
            meaning = f"RMS distance of {markers} {reference}, {_WALKS}"
            out.append(Column(f"{where}_{name}_mm", float, "mm", meaning))
    for stage, residual in (
        ("nominal", "pelvis residual of the nominal model"),
        ("calibrated", "pelvis residual of the calibrated model"),
        ("limit", "largest pelvis residual that errors explain"),
    ):
        for quantity, name, unit in (("force", "N", "N"), ("moment", "Nm", "N m")):
            meaning = f"{residual}, RMS over valid frames of all walks"
            out.append(Column(f"residual_{quantity}_{stage}_{name}", float, unit, meaning))
    return out


def _make_gait_columns() -> list[Column]:
    """Make the columns of spatiotemporal measures, peaks and profile scores."""
    out = []
    for name in MEASURED:
        unit = spatiotemporal.MEASURES[name]
        for side, leg in _LEGS:
            strides = f"{name} of the {leg} leg's valid straight strides"
            deviation = f"standard deviation, {strides}"
            out.append(Column(f"{name}_{side}", float, unit, f"mean {strides}"))
            out.append(Column(f"{name}_sd_{side}", float, unit, deviation))
    out += [
        Column(f"strides_{side}", int, "", f"valid straight strides of the {leg} leg")
        for side, leg in _LEGS
    ]
    # Moments and powers per kg, so that people can be compared.
    for peak in PEAKS.values():
        unit = PER_KG[get_curve_kind(peak.variable)]
        for side, leg in _LEGS:
            meaning = (
                f"{peak.make_title()} ({peak.window_label}): "
                f"mean over straight strides of the {leg} foot"
            )
            out.append(Column(f"{peak.name}_{side}", float, unit, meaning))
            out.append(Column(f"{peak.name}_se_{side}", float, unit, f"standard error: {meaning}"))
    for side, leg in (*_LEGS, (profile_score.BOTH, "both legs")):
        name = f"gait_profile_score_{side}"
        error = f"gait_profile_score_se_{side}"
        meaning = f"Gait Profile Score of {leg}, against healthy people of that age and speed"
        out.append(Column(name, float, "deg", meaning))
        out.append(Column(error, float, "deg", f"standard error: {meaning}"))
    return out


COLUMNS: Final = (
    *_make_subject_columns(),
    *_make_fit_columns(),
    *_make_gait_columns(),
    *_make_text_columns(
        ("gaitcal", "version"),
        ("settings_sha256", "of the settings in manifest.json"),
        ("inputs_sha256", "of the SHA-256 of all inputs in manifest.json"),
    ),
)
"""Columns of the table of people."""
NAMES: Final = tuple(column.name for column in COLUMNS)
EVERY: Final = 2
"""% of the stride between two points of a curve."""
STEPS: Final = {CurveKind.ANGLE: 0.01, CurveKind.MOMENT: 0.0005, CurveKind.POWER: 0.002}
"""Size of one of the whole numbers: deg, N m/kg, W/kg."""
VARIABLES: Final = (
    "hip_flexion",
    "hip_flexion_moment",
    "hip_power",
    "hip_adduction",
    "hip_adduction_moment",
    "hip_rotation",
    "knee_angle",
    "knee_angle_moment",
    "knee_power",
    "knee_adduction_moment",
    "ankle_angle",
    "ankle_angle_moment",
    "ankle_power",
)
"""Of `cycles.csv`, in the order of the packed curves; right before left."""
SHAPE: Final = (len(VARIABLES), len(SIDES), 100 // EVERY + 1)
"""Variables, sides and points of the packed curves."""
PAGE = "result.html"
DIGITS = 6
_FITS = {"marker_rms": "rms_mm", "legs_rms": "pelvis_and_legs_mm"}
"""Columns of marker errors -> key of a trial in `summary.json`."""


def _read_table(path: Path, *, walking: bool = True) -> pd.DataFrame | None:
    """Read a table of a result as text, its rows of walking or of other activities; None if
    missing.
    """
    try:
        table, _ = read_csv(path)
    except (OSError, pd.errors.EmptyDataError):
        return None
    return table[(table["activity"] == WALKING) == walking] if "activity" in table else table


def read_activity_peaks(folder: Path) -> list[list[str]]:
    """Read the rows of `peaks.csv` of activities other than walking.

    Parameters
    ----------
    folder : Path
        A result folder.

    Returns
    -------
    list of list
        Cells in the order of `PEAK_COLUMNS`; empty if there are none.
    """
    table = _read_table(folder / PEAKS_FILE, walking=False)
    return [] if table is None else table[[*PEAK_COLUMNS]].to_numpy().tolist()


def _choose_factor(variable: str, mass: float) -> float:
    """Choose the factor of a curve: 1 for angles, else per body mass (kg)."""
    return 1.0 if get_curve_kind(variable) is CurveKind.ANGLE else 1.0 / mass


def _read_peaks(peaks: Path, mass: float) -> Iterator[tuple[str, float]]:
    """Read column and value of every peak, per body mass (kg)."""
    table = _read_table(peaks)
    for row in () if table is None else table.to_dict("records"):
        for column, name in (("mean", row["peak"]), ("se", f"{row['peak']}_se")):
            value = _choose_factor(row["variable"], mass) * float(row[column] or "nan")
            yield f"{name}_{row['side']}", value


def pack_mean_curves(ensemble: Path, mass: float) -> str:
    """Pack the mean curves of a result.

    Parameters
    ----------
    ensemble : Path
        Its `ensemble.csv`.
    mass : float
        Body mass, kg.

    Returns
    -------
    str
        Base64 of little-endian integers of `SHAPE`; empty without curves.
    """
    packed, table = np.full(SHAPE, GAP, dtype="<i2"), _read_table(ensemble)
    curves = (
        []
        if table is None
        else table[table["variable"].isin(VARIABLES)].groupby(["variable", "side"], sort=False)
    )
    for (variable, side), rows in curves:
        percent, mean = (
            pd.to_numeric(rows[name], errors="coerce").to_numpy(np.float64)
            for name in ("percent", "mean")
        )
        mean = _choose_factor(variable, mass) * mean
        # Integers of a step are a quarter of the size of floats; extreme values are cut off.
        is_kept = np.isfinite(mean) & (percent % EVERY == 0)
        whole = np.clip(np.rint(mean[is_kept] / STEPS[get_curve_kind(variable)]), GAP + 1, -GAP - 1)
        points = (percent[is_kept] / EVERY).astype(int)
        packed[VARIABLES.index(variable), SIDES.index(side), points] = whole
    return "" if (packed == GAP).all() else base64.b64encode(packed.tobytes()).decode("ascii")


def pack_no_curves() -> str:
    """Pack the curves of a person without any, as `pack_mean_curves` does."""
    return base64.b64encode(np.full(SHAPE, GAP, dtype="<i2").tobytes()).decode("ascii")


def make_row(folder: Path) -> dict[str, Cell]:
    """Make the row of a result in the table of people.

    Parameters
    ----------
    folder : Path
        The result folder.

    Returns
    -------
    dict
        Column -> value, without those of the cohort (group, folder, ...).

    Raises
    ------
    InputError
        It is no result of a calibration.
    """
    manifest: dict[str, Any] = read_json_object(folder / MANIFEST)
    summary: dict[str, Any] = read_json_object(folder / SUMMARY)
    if "subject" not in manifest or "trials" not in summary:
        raise InputError("is no result of 'gaitcal calibrate'", source=folder, code=Code.NO_RESULT)
    subject, reasons = manifest["subject"], summary.get("reasons") or [{}]
    trials: dict[str, dict[str, Any]] = summary["trials"]
    # Other activities are in another table: their peaks are not those of walking.
    walks = [trial for trial in trials.values() if trial.get("role") == "gait"]
    activities = [name for name, trial in trials.items() if trial.get("role") == "motion"]
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
        "activities": " ".join(activities),
        **_summarise_leg_verdicts(walks),
        **dict(_pool_marker_errors(walks or list(trials.values()))),
        **dict(_pool_residuals(walks)),
        **dict(_list_spatiotemporal(summary.get("spatiotemporal") or {})),
        **dict(_list_profile_scores(summary.get("gait_profile") or {})),
        **dict(_read_peaks(folder / PEAKS_FILE, float(subject["mass_kg"]))),
        "gaitcal": manifest["gaitcal"],
        "settings_sha256": _compute_digest(manifest.get("settings")),
        "inputs_sha256": _compute_digest(manifest.get("inputs_sha256")),
    }
    for name, value in row.items():
        # JSON and Parquet have no common notation for NaN: unknown values are empty.
        if isinstance(value, float):
            row[name] = round(value, DIGITS) if math.isfinite(value) else None
    return {name: row[name] for name in NAMES if name in row}


def read_reasons(folder: Path) -> tuple[dict[str, str], ...]:
    """Read the reasons of the verdict of a result.

    Parameters
    ----------
    folder : Path
        The result folder.

    Returns
    -------
    tuple of dict
        Severity, cause and action of each reason, the worst first.
    """
    summary: dict[str, Any] = read_json_object(folder / SUMMARY)
    out = []
    for reason in summary.get("reasons") or ():
        out.append({name: str(reason.get(name) or "") for name in ("severity", "cause", "action")})
    return tuple(out)


def _compute_digest(content: object) -> str:
    """Compute SHA-256 of JSON content."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _summarise_leg_verdicts(walks: Iterable[Mapping[str, Any]]) -> dict[str, Cell]:
    """Summarise the verdict of each leg, and count the walks in which it is refused."""
    out: dict[str, Cell] = {}
    for side in SIDES:
        key = f"verdict_{side}"
        verdicts = [Judgement(walk[key]) for walk in walks if key in walk]
        usable = [verdict for verdict in verdicts if verdict is not Judgement.REFUSED]
        worst = Judgement.select_worst(usable) if usable else Judgement.REFUSED
        out[key] = worst.value if verdicts else ""
        out[f"walks_refused_{side}"] = len(verdicts) - len(usable)
    return out


def _pool_marker_errors(trials: Iterable[Mapping[str, Any]]) -> Iterator[tuple[str, Cell]]:
    """Pool marker errors over trials."""
    found = list(trials)
    for where, entry in _FITS.items():
        for name in _FIT:
            pairs = [
                (t["frames"], (t.get(entry) or t.get("rms_mm") or {}).get(name))
                for t in found
                if "frames" in t
            ]
            yield f"{where}_{name}_mm", _pool(pairs)


def _pool_residuals(walks: Iterable[Mapping[str, Any]]) -> Iterator[tuple[str, Cell]]:
    """Pool pelvis residuals and their limits over walks."""
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
        # RMS values are pooled by their numbers of frames.
        forces = [(frames, residual["force_N"]) for frames, residual in found]
        moments = [(frames, residual["torque_Nm"]) for frames, residual in found]
        yield f"residual_force_{stage}_N", _pool(forces)
        yield f"residual_moment_{stage}_Nm", _pool(moments)


def _pool(pairs: Iterable[tuple[int, float | None]]) -> float | None:
    """Pool RMS values of trials, given with their frames; None if there are none."""
    known = [(n, value) for n, value in pairs if value is not None]
    frames = sum(n for n, _ in known)
    return math.sqrt(sum(n * value**2 for n, value in known) / frames) if frames else None


def _list_profile_scores(profile: Mapping[str, Mapping[str, Any]]) -> Iterator[tuple[str, Cell]]:
    """List columns and values of Gait Profile Scores."""
    for side, of_side in profile.items():
        yield f"gait_profile_score_{side}", of_side[profile_score.GPS]["score"]
        yield f"gait_profile_score_se_{side}", of_side[profile_score.GPS].get("se")


def _list_spatiotemporal(means: Mapping[str, Mapping[str, Any]]) -> Iterator[tuple[str, Cell]]:
    """List columns and values of spatiotemporal measures."""
    for side in SIDES:
        for name in MEASURED:
            found = means.get(name, {}).get(side) or {}
            yield f"{name}_{side}", found.get("mean")
            yield f"{name}_sd_{side}", found.get("sd")
        yield f"strides_{side}", (means.get("stride_time", {}).get(side) or {}).get("strides", 0)
