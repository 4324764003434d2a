"""Read and check the study file `study.toml`: subject, marker set, trials and settings.

Every error of a user is one `InputError` in one line: the file, the field such as `trial[2].file`
(trials count from 1, in the order of the file), what was found and what is allowed. Only the first
error is reported.
"""

import datetime
import math
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

from pydantic import AfterValidator, BeforeValidator, Field, ValidationInfo, field_validator

from gaitcal.io.toml import Table, format_toml_table, format_value, read_validated, require_file
from gaitcal.study.settings import CalibrationSettings, allow_frequency

__all__ = [
    "CalibrationSettings",
    "Markers",
    "StudyFile",
    "SubjectTable",
    "TrialTable",
    "TruthTable",
    "load_study_file",
]

Joint: TypeAlias = Literal["hip_r", "knee_r", "ankle_r", "hip_l", "knee_l", "ankle_l"]
Side: TypeAlias = Literal["r", "l", "none"]

RECORDING_SUFFIXES = (".c3d", ".trc", ".csv")
FORCES_SUFFIXES = (".mot", ".sto", ".csv", ".xml")
MAX_LINE_CHARACTERS = 200  # Characters in what is said of a person or a session
MAX_NAME_CHARACTERS = 80  # Characters in a trial's name, which becomes a file name
# Names that are no file names on Windows
_WINDOWS_DEVICES = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.IGNORECASE)


def _require_suffix(allowed: tuple[str, ...]) -> AfterValidator:
    def check(path: Path) -> Path:
        if path.suffix.lower() not in allowed:
            raise ValueError(
                f"found {format_value(str(path))}; allowed: a file ending in {' '.join(allowed)}"
            )
        return path

    return AfterValidator(check)


def _parse_interval(value: object) -> tuple[float, float]:
    numbers = (
        [v for v in value if isinstance(v, int | float)] if isinstance(value, list | tuple) else []
    )
    if len(numbers) != 2 or len(numbers) != len(value) or not -1e9 < numbers[0] < numbers[1] < 1e9:  # type: ignore[arg-type]
        raise ValueError(
            f"found {format_value(value)}; allowed: two increasing numbers, [start, end] in seconds"
        )
    return float(numbers[0]), float(numbers[1])


def _check_millimetres(low: float, high: float) -> Callable[[object], float]:
    """Check a length of the body in mm; the message recognises other units."""

    def check(value: object) -> float:
        number = (
            float(value)
            if isinstance(value, int | float) and not isinstance(value, bool)
            else math.nan
        )
        if low <= number <= high:
            return number
        # A length of the right size in another unit is the most frequent mistake.
        units = (("centimetres", 10.0), ("metres", 1000.0))
        fits = [f"{unit}: {mm * number:g} mm" for unit, mm in units if low <= mm * number <= high]
        hint = f"; this looks like {fits[0]}" if fits else ""
        raise ValueError(f"found {format_value(value)}; allowed: {low:g} to {high:g} mm{hint}")

    return check


def _check_sides(low: float, high: float) -> BeforeValidator:
    """Check a length in mm of both sides together, or of each."""
    check_side = _check_millimetres(low, high)

    def check(value: object) -> object:
        if isinstance(value, int | float) and not isinstance(value, bool):
            value = {"r": value, "l": value}
        if not isinstance(value, dict) or not set(value) <= {"r", "l"}:
            raise ValueError(
                f"found {format_value(value)}; allowed: a length in mm, or {{ r = ..., l = ... }}"
            )
        return {side: check_side(length) for side, length in value.items()}

    return BeforeValidator(check)


_WIDTHS = _check_sides(20, 300)


def _parse_date(value: object) -> str:
    """Convert a date of TOML, or its text, to text."""
    try:
        found = (
            value if isinstance(value, datetime.date) else datetime.date.fromisoformat(str(value))
        )
    except ValueError:
        raise ValueError(f"found {format_value(value)}; allowed: a date as 2016-03-09") from None
    return found.isoformat()[:10]


_Date: TypeAlias = Annotated[str, BeforeValidator(_parse_date)]


def _check_line(value: str) -> str:
    if len(value) > MAX_LINE_CHARACTERS or not value.isprintable():
        raise ValueError(
            f"found {format_value(value)}; allowed: up to {MAX_LINE_CHARACTERS} printable "
            "characters"
        )
    return value


_Line: TypeAlias = Annotated[str, AfterValidator(_check_line)]


class SubjectTable(Table):
    """Table `[subject]`: the person."""

    name: str = Field(description="the subject's name as reports show it")
    mass_kg: float = Field(gt=0, description="body mass in kg")
    height_m: float | None = Field(
        default=None,
        description="body height in m; if not given, that of a file, or as people with legs as "
        "long "
        "have it: their "
        "standard deviation counts in the errors then",
    )
    height_error_m: float = Field(
        default=0.0,
        ge=0,
        le=0.3,
        description="standard deviation of an estimated height, m; counts in the errors",
    )
    sex: Literal["male", "female"] | None = Field(
        default=None,
        description="'male' or 'female': which anthropometric table is used; without it the mean "
        "of both, and their "
        "difference counts in the errors",
    )
    age_years: float | None = Field(default=None, ge=0, le=130, description="age in years")
    knee_width_mm: Annotated[dict[str, float], _WIDTHS] = Field(
        default={},
        description="width of the knee across the epicondyles, mm: one number, or { r = 105, l = "
        "107 }",
    )
    ankle_width_mm: Annotated[dict[str, float], _WIDTHS] = Field(
        default={},
        description="width of the ankle across the malleoli, mm: one number, or { r = 70, l = 72 }",
    )
    leg_length_mm: Annotated[dict[str, float], _check_sides(150, 1500)] = Field(
        default={},
        description="anterior superior iliac spine to medial malleolus, mm: one number, or { r = "
        "..., l = }",
    )
    asis_distance_mm: Annotated[float, BeforeValidator(_check_millimetres(80, 500))] | None = Field(
        default=None,
        description="distance between the two anterior superior iliac spines as measured by hand, "
        "mm",
    )
    marker_diameter_mm: Annotated[float, BeforeValidator(_check_millimetres(3, 40))] | None = Field(
        default=None, description="diameter of the markers, mm"
    )
    session: _Line = Field(
        default="", description="the day of the recordings, a date or a label, as tables show it"
    )
    session_date: _Date | None = Field(
        default=None, description="the day of the recordings, as 2016-03-09"
    )
    birth_date: _Date | None = Field(
        default=None,
        description="as 2008-11-30; with session_date it gives the age. Stands in the results",
    )
    diagnosis: _Line = Field(default="", description="as reports and tables show it")
    affected_side: Literal["right", "left", "both", "none"] | None = Field(
        default=None, description="of the diagnosis"
    )
    aids: _Line = Field(
        default="",
        description="orthoses, shoes, crutches, walkers, as reports and tables show them",
    )
    laboratory: _Line = Field(default="", description="where it was recorded, as reports show it")

    @field_validator("name")
    @classmethod
    def _check_name(cls, name: str) -> str:
        if not name.strip() or len(name) > MAX_LINE_CHARACTERS or not name.isprintable():
            raise ValueError(
                f"found {format_value(name)}; allowed: 1 to {MAX_LINE_CHARACTERS} printable "
                "characters"
            )
        return name

    @field_validator("height_m")
    @classmethod
    def _check_height(cls, height: float | None) -> float | None:
        if height is None or 0.3 <= height <= 2.6:
            return height
        unit = {
            30 <= height <= 260: ("centimetres", 100),
            300 <= height <= 2600: ("millimetres", 1000),
        }.get(True)
        hint = f"; this looks like {unit[0]}: height_m = {height / unit[1]:g}" if unit else ""
        raise ValueError(f"found {height:g}; allowed: 0.3 to 2.6 m{hint}")


class Markers(Table):
    """Table `[markers]`: what the labels in the files mean."""

    set: str = Field(
        min_length=1, description="a built-in marker set, or the path of a TOML file of your own"
    )
    rename: dict[str, str] = Field(
        default={},
        description="label in the files -> label in the marker set, before anything else is looked "
        "up",
    )
    weights: dict[str, Annotated[float, Field(ge=0)]] = Field(
        default={},
        description="label in the marker set -> weight instead of the set's own; 0 leaves the "
        "marker out",
    )
    tracking: dict[str, list[str]] = Field(
        default={},
        description="segment -> labels of further markers, which the set does not know, that move "
        "with it",
    )
    confirmed: bool = Field(
        default=True,
        description="false where the meaning of labels was proposed and has not been checked yet",
    )

    @property
    def set_path(self) -> Path | None:
        """File of an individual marker set; None for a built-in set."""
        return (
            Path(self.set)
            if self.set.lower().endswith(".toml") or re.search(r"[/\\]", self.set)
            else None
        )

    @field_validator("rename")
    @classmethod
    def _require_one_to_one(cls, rename: dict[str, str]) -> dict[str, str]:
        first_use: dict[str, str] = {}
        for old, new in rename.items():
            if new in first_use:
                first, second, label = map(format_value, (first_use[new], old, new))
                message = f"{first} and {second} both become {label}; a label names one marker"
                raise ValueError(message)
            first_use[new] = old
        return rename


class TrialTable(Table):
    """Table `[[trial]]`: one recording and its role."""

    name: str = Field(description="the trial's name, which also names its result files")
    role: Literal["static", "joint", "gait", "motion"] = Field(
        description="'static' (standing still; of several the first gives the model, the others "
        "must agree with it), "
        "'joint' (one joint moved in isolation), 'gait' (walking) or 'motion' (any other activity "
        "of the whole body)"
    )
    joint: Joint | None = Field(
        default=None,
        validate_default=True,
        description="the joint that a trial with role = 'joint' moves",
    )
    file: Annotated[Path, _require_suffix(RECORDING_SUFFIXES)] = Field(
        strict=False, description="the recording, .c3d .trc or .csv"
    )
    forces: Annotated[Path, _require_suffix(FORCES_SUFFIXES)] | None = Field(
        default=None,
        strict=False,
        description="ground reactions, .mot .sto .csv or ExternalLoads .xml; a C3D brings its own",
    )
    plates: dict[str, Side] = Field(
        default={},
        description="force plate -> foot on it: 'r', 'l' or 'none'; else found from the centre of "
        "pressure",
    )
    time: Annotated[tuple[float, float], BeforeValidator(_parse_interval)] | None = Field(
        default=None, description="[start, end] in s of the part to use; else all of it"
    )
    filter_hz: Annotated[float | Literal["none"], allow_frequency("none")] | None = Field(
        default=None,
        description="low-pass cut-off of this trial's forces in Hz, or 'none'; else as in "
        "[calibration]",
    )

    @field_validator("name")
    @classmethod
    def _require_safe_file_name(cls, name: str) -> str:
        # Names become names of files on every operating system.
        safe = re.fullmatch(
            r"[A-Za-z0-9_-]([A-Za-z0-9 _.-]*[A-Za-z0-9_-])?", name
        ) and not _WINDOWS_DEVICES.fullmatch(name)
        if not safe or len(name) > MAX_NAME_CHARACTERS:
            raise ValueError(
                f"found {format_value(name)}; allowed, as it names files: 1 to "
                f"{MAX_NAME_CHARACTERS} of A-Z a-z 0-9 _ - and, inside, "
                "space and dot; no name that Windows reserves"
            )
        return name

    @field_validator("joint")
    @classmethod
    def _require_joint(cls, joint: str | None, info: ValidationInfo) -> str | None:
        # Without a valid role, its own error is reported
        role = info.data.get("role", "joint" if joint else "gait")
        if role == "joint" and joint is None:
            raise ValueError(
                "missing: role = 'joint' needs the joint: hip_r knee_r ankle_r hip_l knee_l ankle_l"
            )
        if role != "joint" and joint is not None:
            raise ValueError(
                f"found {format_value(joint)} with role = '{role}'; allowed only with role = "
                "'joint'"
            )
        return joint


class TruthTable(Table):
    """Table `[truth]`: known truth of a synthetic subject, written by its program."""

    parameters: Path = Field(
        strict=False, description="CSV of the true parameters: name,unit,value"
    )
    folder: Path | None = Field(
        default=None,
        strict=False,
        description="folder of TRIAL_motion.csv and TRIAL_moments.csv, the true curves",
    )
    landmarks: Path = Field(
        strict=False,
        description="CSV of the static trial's landmarks, which make the truth's segment frames: "
        "name,x,y,z, m",
    )
    markers: str = Field(
        description="name of the marker set whose landmarks make the truth's segment frames"
    )
    hip_centre: Literal["bell", "orthotrak", "harrington", "given"] = Field(
        description="the nominal hip centre that defines the segment frames of the truth; that of "
        "the "
        "calibration"
    )
    ankle_zero: Literal["auto", "sole", "markers", "file"] = Field(
        description="what the true ankle angles are counted from; that of the calibration"
    )

    def resolve_paths(self, at: Callable[[Path], Path], source: Path) -> "TruthTable":
        """Resolve the paths by `at`, and require the files."""
        files = {
            field: require_file(at(getattr(self, field)), source=source, field=f"truth.{field}")
            for field in ("parameters", "landmarks")
        }
        return self.model_copy(update=files | ({"folder": at(self.folder)} if self.folder else {}))


class StudyFile(Table):
    """Whole study file; after `load_study_file` every path is absolute and its file exists."""

    subject: SubjectTable = Field(
        description="the table [subject] with name, mass_kg, height_m, sex"
    )
    markers: Markers = Field(description="the table [markers] with set")
    trials: tuple[TrialTable, ...] = Field(
        alias="trial", strict=False, description="at least one [[trial]], with name, role and file"
    )
    calibration: CalibrationSettings = Field(
        default=CalibrationSettings(), description="settings, all optional"
    )
    truth: TruthTable | None = Field(
        default=None, description="what is known to be true of a made-up person"
    )

    @field_validator("trials", mode="before")
    @classmethod
    def _require_array_of_tables(cls, trials: object) -> object:
        if isinstance(trials, dict):
            raise ValueError(
                "found a single table [trial]; write [[trial]], with two brackets, for each trial"
            )
        return trials

    @field_validator("trials")
    @classmethod
    def _require_names_and_static(cls, trials: tuple[TrialTable, ...]) -> tuple[TrialTable, ...]:
        first_use: dict[str, int] = {}
        for number, trial in enumerate(trials, start=1):
            # Some file systems do not distinguish Walk from walk
            if (other := first_use.setdefault(trial.name.lower(), number)) != number:
                message = (
                    f"trials {other} and {number} are both named {format_value(trial.name)}; every "
                    "name occurs once "
                )
                message += "(capitals make no difference)"
                raise ValueError(message)
        if not any(trial.role == "static" for trial in trials):
            raise ValueError(
                "no trial stands still; add [[trial]] with name = 'static', role = 'static', file "
                "= '...'"
            )
        return trials

    @property
    def static(self) -> TrialTable:
        """Static trial of which the model is made: the first; further ones must agree with it."""
        return next(trial for trial in self.trials if trial.role == "static")

    def to_toml(self, folder: Path | None = None) -> str:
        """Format the study as the text of a study file, without defaults.

        Parameters
        ----------
        folder
            Absolute paths become relative to this folder.

        Returns
        -------
        str
            Text of the file.
        """

        def content(table: Table) -> dict[str, object]:
            values = {key: getattr(table, key) for key in type(table).model_fields}
            written = table.model_dump(exclude_defaults=True)
            return {
                key: _make_plain(value, folder) for key, value in values.items() if key in written
            }

        markers = content(self.markers)
        if self.markers.set_path:
            markers["set"] = _make_relative(self.markers.set_path, folder)
        tables = [
            format_toml_table("[subject]", content(self.subject)),
            format_toml_table("[markers]", markers),
        ]
        tables += [format_toml_table("[[trial]]", content(trial)) for trial in self.trials]
        if settings := content(self.calibration):
            tables.append(format_toml_table("[calibration]", settings))
        if self.truth:
            tables.append(format_toml_table("[truth]", content(self.truth)))
        return "\n".join(tables)


def _make_plain(value: object, folder: Path | None) -> object:
    """Convert a value for TOML: paths relative to `folder`, nested tables as mappings."""
    if isinstance(value, dict):
        return {key: _make_plain(inner, folder) for key, inner in value.items()}
    if isinstance(value, Table):
        return value.model_dump(exclude_none=True)
    return _make_relative(value, folder) if isinstance(value, Path) else value


def _make_relative(path: Path, folder: Path | None) -> Path:
    return Path(os.path.relpath(path, folder)) if folder and path.is_absolute() else path


def load_study_file(path: Path | str) -> StudyFile:
    """Read and check a study file; relative paths are resolved from its folder.

    Parameters
    ----------
    path
        The file `study.toml`.

    Returns
    -------
    StudyFile
        Its content with absolute paths.

    Raises
    ------
    InputError
        One line: file, field, what was found, what is allowed.
    """
    source = Path(path)
    study = read_validated(StudyFile, source)

    def found(file: Path, field: str) -> Path:
        return require_file(source.parent.absolute() / file, source=source, field=field)

    # Paths in a study file are relative to its folder, wherever the command is run.
    markers = study.markers
    if markers.set_path:
        markers = markers.model_copy(update={"set": str(found(markers.set_path, "markers.set"))})
    trials = []
    for number, trial in enumerate(study.trials, start=1):
        files: dict[str, Any] = {"file": found(trial.file, f"trial[{number}].file")}
        if trial.forces:
            files["forces"] = found(trial.forces, f"trial[{number}].forces")
        trials.append(trial.model_copy(update=files))
    truth = study.truth and study.truth.resolve_paths(
        lambda file: source.parent.absolute() / file, source
    )
    settings = study.calibration.resolve_paths(
        lambda file: found(file, "calibration.priors"), source
    )
    return study.model_copy(
        update={
            "markers": markers,
            "trials": tuple(trials),
            "calibration": settings,
            "truth": truth,
        }
    )
