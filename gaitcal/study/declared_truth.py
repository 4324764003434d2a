"""Read and write the known truth of a synthetic subject: files beside the recordings.

    PARAMETERS            name,unit,value: joint and inertial parameters, names and units of a
                          result's parameters.csv
    LANDMARKS             name,x,y,z: landmarks of the static trial, m, laboratory, y up
    TRIAL_motion.csv      names and units of a result's motion/TRIAL.csv: time, coordinates,
                          _velocity, _acceleration
    TRIAL_moments.csv     names and units of a result's moments/TRIAL.csv: time, generalised forces,
                          _bwh

Text after a `#` in a line is a comment. Curves have their units in a comment line, which must be
present without changes. All numbers are in the segment frames, and from the ankle zero, that the
calibration derives from the static trial: those of a calibration without error. The study file
declares the rules of these frames (`[truth]` markers, hip_centre, ankle_zero) and their landmarks.
A study that calibrates with other rules is refused, as its numbers have another meaning. Landmarks
are compared by their mutual distances and by their heights above their mean. Rotation about the
vertical, height of the floor and format of the recording do not change these.
"""

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.errors import Code, InputError, suggest_name
from gaitcal.io import text_file, toml
from gaitcal.io.recording import Recording, find_still_window
from gaitcal.model.landmarks import measure_static_posture
from gaitcal.model.linkage import COORDINATES, FILE_COORDINATES, REACTIONS, is_translation
from gaitcal.model.marker_set import MarkerSet
from gaitcal.model.parameters import (
    IP_NAMES,
    IP_TO_SI,
    IP_UNITS,
    JOINT_PARAMETERS,
    JP_NAMES,
    JP_TO_SI,
)
from gaitcal.study.settings import CalibrationSettings
from gaitcal.study.study_file import TruthTable

LANDMARK_COLUMNS = ["name", "x", "y", "z"]
LANDMARK_TOLERANCE_M = 1e-4
"""Largest difference (m) of landmarks; files hold a thousandth of it.

A tenth of a millimetre rotates a segment by less than 0.1 degrees.
"""
MOTION_SUFFIX, MOMENTS_SUFFIX = "_motion.csv", "_moments.csv"
"""Endings of the files of a trial."""
MOTION_UNITS = "true coordinates in degrees and m, _velocity per s, _acceleration per s^2"
MOMENT_UNITS = (
    "true generalised forces: N m (pelvis_tx, _ty, _tz: N); NAME_bwh percent of body weight times "
    "height"
)
"""Comment lines of the two kinds: units of their numbers."""
FORCE_NAMES: tuple[str, ...] = (*FILE_COORDINATES, *REACTIONS)
"""Columns of a moments file, without time."""
NUMBER_FORMAT = "%.9g"
"""Format of written numbers: finer than a millionth of a degree and of a newton metre."""
TIME_TOLERANCE_S = 1e-4
"""Largest error (s) of times by rounding in text."""
_UNIT = dict(zip(JP_NAMES, (p.kind.unit for p in JOINT_PARAMETERS), strict=True)) | dict(
    zip(IP_NAMES, IP_UNITS, strict=True)
)
_TO_SI = dict(zip(JP_NAMES, JP_TO_SI, strict=True)) | dict(zip(IP_NAMES, IP_TO_SI, strict=True))


@dataclass(frozen=True, kw_only=True)
class TrueCurves:
    """Curves of one trial over time, of which some may be unknown."""

    time: Array
    """(nf,) s."""
    values: Mapping[str, Array]
    """Name -> (nf,): m and rad of coordinates, N and N·m of generalised forces."""

    def find_covered(self, time: Array) -> BoolArray:
        """Return which instants (n,) s are within the curves."""
        out: BoolArray = (time >= self.time[0] - TIME_TOLERANCE_S) & (
            time <= self.time[-1] + TIME_TOLERANCE_S
        )
        return out

    def interpolate(self, time: Array) -> dict[str, Array]:
        """Interpolate the curves linearly; NaN beyond their ends.

        Parameters
        ----------
        time : (n,)
            s.

        Returns
        -------
        dict
            Name -> (n,) m and rad, or N and N·m.
        """
        inside = self.find_covered(time)
        return {
            n: np.where(inside, np.interp(time, self.time, v), np.nan)
            for n, v in self.values.items()
        }


@dataclass(frozen=True, kw_only=True)
class Truth:
    """Known truth of the subject of a study."""

    rules: TruthTable
    """Rules by which its segment frames are made."""
    landmarks: Mapping[str, Array]
    """Landmark of the static trial that defines the frames -> (3,) m."""
    parameters: Mapping[str, float]
    """Parameter -> m, rad, kg, kg m^2, as far as the file has it."""
    motions: Mapping[str, TrueCurves]
    """Trial -> coordinates."""
    moments: Mapping[str, TrueCurves]
    """Trial -> generalised forces."""


def _make_fault(message: str, path: Path, field: str | None = None) -> InputError:
    return InputError(message, source=path, field=field, code=Code.TRUTH)


def format_motion(
    time: Array, q: Array, velocity: Array | None = None, acceleration: Array | None = None
) -> str:
    """Format the content of TRIAL_motion.csv.

    Parameters
    ----------
    time : (nf,)
        s.
    q : (nf, 27)
        Coordinates, m and rad.
    velocity, acceleration : (nf, 27), optional
        Their derivatives.

    Returns
    -------
    str
        Text of the file.
    """
    columns, parts = {"time": time}, {"": q, "_velocity": velocity, "_acceleration": acceleration}
    for suffix, values in ((suffix, part) for suffix, part in parts.items() if part is not None):
        for name in FILE_COORDINATES:
            columns[name + suffix] = values[:, COORDINATES.index(name)] / _get_scale(name)
    return _format_table(MOTION_UNITS, columns)


def format_moments(time: Array, forces: Array, bwh: float) -> str:
    """Format the content of TRIAL_moments.csv.

    Parameters
    ----------
    time : (nf,)
        s.
    forces : (nf, 29)
        Generalised forces, N·m and N.
    bwh
        Body weight times height, N·m.

    Returns
    -------
    str
        Text of the file.
    """
    columns = {"time": time}
    for name in FORCE_NAMES:
        value = forces[:, (*COORDINATES, *REACTIONS).index(name)]
        columns[name] = value
        columns[f"{name}_bwh"] = (
            np.full(len(time), np.nan) if is_translation(name) else 100.0 * value / bwh
        )
    return _format_table(MOMENT_UNITS, columns)


def format_landmarks(landmarks: Mapping[str, Array]) -> str:
    """Format the content of the landmarks file.

    Parameters
    ----------
    landmarks
        Name -> (3,) m, laboratory, y up.

    Returns
    -------
    str
        Text of the file.
    """
    places = np.array(list(landmarks.values())).reshape(-1, 3)
    columns = {"name": list(landmarks), **{axis: places[:, k] for k, axis in enumerate("xyz")}}
    return _format_table("landmarks of the static trial in m, laboratory, y up", columns)


def _format_table(units: str, columns: Mapping[str, Any]) -> str:
    import pandas as pd  # loaded by who writes: it takes a third of a second

    rows: str = pd.DataFrame(columns).to_csv(
        index=False, lineterminator="\n", float_format=NUMBER_FORMAT
    )
    return f"# {units}\n{rows}"


def list_truth_files(table: TruthTable | None, trials: Sequence[str]) -> tuple[Path, ...]:
    """List the files that `[truth]` names; those of trials only if they exist.

    Parameters
    ----------
    table
        Table of the study file, or None.
    trials
        Names of the trials.

    Returns
    -------
    tuple of Path
        The files.
    """
    if table is None:
        return ()
    curves = (
        (table.folder / (name + end) for name in trials for end in (MOTION_SUFFIX, MOMENTS_SUFFIX))
        if table.folder
        else ()
    )
    return (table.parameters, table.landmarks, *(file for file in curves if file.is_file()))


def read_truth(
    table: TruthTable | None,
    settings: CalibrationSettings,
    marker_set: str,
    trials: Sequence[str],
    source: Path,
) -> Truth | None:
    """Read the truth that a study file declares.

    Parameters
    ----------
    table
        Table `[truth]`, or None.
    settings
        Settings of the calibration.
    marker_set
        Name of the marker set of the study.
    trials
        Names of the trials.
    source
        The study file, for messages.

    Returns
    -------
    Truth or None
        None without a table.

    Raises
    ------
    InputError
        A name, unit, number or rule differs from those of a result, or no trial has curves.
    """
    if table is None:
        return None
    other = find_rule_mismatch(table, settings, marker_set)
    if other is not None:
        raise _make_fault(
            f"{other.message}; allowed: the same, or no [truth]", source, f"truth.{other.rule}"
        )
    motions, moments = (
        _read_curves(table.folder, trials, end) for end in (MOTION_SUFFIX, MOMENTS_SUFFIX)
    )
    if table.folder and not motions and not moments:
        wanted = f"TRIAL{MOTION_SUFFIX} or TRIAL{MOMENTS_SUFFIX} of a trial of the study"
        raise _make_fault(
            f"found no such file in '{table.folder.name}'; allowed: {wanted}",
            source,
            "truth.folder",
        )
    return Truth(
        rules=table,
        landmarks=_read_landmarks(table.landmarks),
        parameters=_read_parameters(table.parameters),
        motions=motions,
        moments=moments,
    )


@dataclass(frozen=True)
class RuleMismatch:
    """Rule of the truth's frames that differs from that of the calibration."""

    rule: str
    declared: str
    used: str

    @property
    def message(self) -> str:
        """The difference, and why it matters."""
        return (
            f"found '{self.declared}', and the study uses '{self.used}', whose segment frames and "
            "zeros are others"
        )


def find_rule_mismatch(
    table: TruthTable, settings: CalibrationSettings, marker_set: str
) -> RuleMismatch | None:
    """Find the first rule by which the frames of the truth differ from those of the calibration.

    Parameters
    ----------
    table
        Table `[truth]`.
    settings
        Settings of the calibration.
    marker_set
        Name of the marker set of the study.

    Returns
    -------
    RuleMismatch or None
        None if the numbers have the same meaning.
    """
    used = {
        "markers": marker_set,
        "hip_centre": settings.hip_rule,
        "ankle_zero": settings.ankle_rule,
    }
    return next(
        (
            RuleMismatch(rule, declared, u)
            for rule, u in used.items()
            if (declared := getattr(table, rule)) != u
        ),
        None,
    )


def _read_rows(path: Path) -> tuple[list[str], list[list[str]]]:
    """Read header and cells of a table, rows padded to the header; InputError if it is none."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, ValueError) as error:
        raise _make_fault(f"cannot be read as CSV: {error}", path) from None
    # Comment lines and trailing comments are no data.
    lines = (line.split("#", 1)[0] for line in text.splitlines())
    names, *rows = list(csv.reader(line for line in lines if line.strip())) or [[]]
    if not names:
        raise _make_fault("cannot be read as CSV: found no header", path)
    if twice := [name for name in names if names.count(name) > 1]:
        raise _make_fault(f"cannot be read as CSV: found the column {twice[0]} twice", path)
    # Short rows are padded below; long ones would shift values to other columns.
    for k, row in enumerate(rows, start=1):
        if len(row) > len(names):
            raise _make_fault(
                f"cannot be read as CSV: found {len(row)} cells in row {k}, below {len(names)} "
                "names",
                path,
            )
    return names, [row + [""] * (len(names) - len(row)) for row in rows]


def _parse_number(cell: str) -> float:
    """Parse a number; NaN if it is none."""
    try:
        return text_file.parse_number(cell)
    except ValueError:
        return float("nan")


def _parse_numbers(cells: Sequence[str]) -> Array:
    """Parse numbers (n,): at once, or one by one where a cell is none."""
    try:
        if "_" not in "".join(cells):
            return np.array(list(map(float, cells)))
    except ValueError:
        pass
    return np.array(list(map(_parse_number, cells)))


def _read_landmarks(path: Path) -> dict[str, Array]:
    """Read landmark -> (3,) m."""
    names, rows = _read_rows(path)
    if names != LANDMARK_COLUMNS or not rows:
        raise _make_fault(f"found columns {names}; allowed: name,x,y,z and a landmark a row", path)
    out = {name: _parse_numbers(cells) for name, *cells in rows}
    if not all(np.isfinite(position).all() for position in out.values()):
        raise _make_fault("found a position that is no finite number; allowed: m", path, "x,y,z")
    return out


def _read_parameters(path: Path) -> dict[str, float]:
    names, rows = _read_rows(path)
    if names != ["name", "unit", "value"]:
        raise _make_fault(
            f"found columns {toml.format_value(names)}; allowed: name,unit,value", path
        )
    out: dict[str, float] = {}
    for name, unit, cell in rows:
        value = _parse_number(cell)
        if name not in _UNIT:
            hint = suggest_name(name, _UNIT) or "; allowed: names of a result's parameters.csv"
            raise _make_fault(
                f"found {toml.format_value(name)}, which is no parameter{hint}", path, "name"
            )
        # Units are fixed by parameter: a file in other units is refused, never converted.
        if unit != _UNIT[name]:
            raise _make_fault(
                f"found {toml.format_value(unit)}; allowed: {_UNIT[name]}", path, f"unit of {name}"
            )
        if name in out:
            raise _make_fault("found twice; a parameter has one true value", path, name)
        if not np.isfinite(value):
            raise _make_fault(
                f"found {toml.format_value(cell)}; allowed: a finite number", path, name
            )
        out[name] = float(value * _TO_SI[name])
    return out


def _read_curves(folder: Path | None, trials: Sequence[str], ending: str) -> dict[str, TrueCurves]:
    files = {} if folder is None else {name: folder / (name + ending) for name in trials}
    return {name: _read_curve(path, ending) for name, path in files.items() if path.is_file()}


def _read_curve(path: Path, ending: str) -> TrueCurves:
    """Read one file without columns that follow from others (derivatives, _bwh)."""
    units, known, derived = (
        (MOTION_UNITS, FILE_COORDINATES, ("_velocity", "_acceleration"))
        if ending == MOTION_SUFFIX
        else (MOMENT_UNITS, FORCE_NAMES, ("_bwh",))
    )
    first = (
        path.read_text(encoding="utf-8", errors="replace")
        .split("\n", 1)[0]
        .removeprefix("#")
        .strip()
    )
    if first != units:
        raise _make_fault(
            f"found {toml.format_value(first)}; allowed: '# {units}'", path, "line 1, the units"
        )
    names, rows = _read_rows(path)
    # Derivatives and normalised torques may be present, but follow from the others.
    allowed = {"time", *known, *(name + suffix for name in known for suffix in derived)}
    for column in names:
        if column not in allowed:
            hint = suggest_name(
                column, allowed
            ) or "; allowed: names of a result's " + ending.strip("_")
            raise _make_fault(
                f"found {toml.format_value(column)}, which is no column{hint}", path, "columns"
            )
    columns = {
        name: _parse_numbers([row[k] for row in rows])
        for k, name in enumerate(names)
        if name in ("time", *known)
    }
    for column, values in columns.items():
        if not np.isfinite(values).all():
            raise _make_fault(
                "found a value that is no finite number; allowed: numbers", path, column
            )
    time = columns.pop("time", np.empty(0))
    if len(time) < 2 or (np.diff(time) <= 0).any():
        raise _make_fault(
            "found no increasing times; allowed: two rows or more, in s", path, "time"
        )
    # Angles are stored in degrees; moments are in SI units.
    scale = {name: _get_scale(name) if ending == MOTION_SUFFIX else 1.0 for name in columns}
    return TrueCurves(
        time=time, values={name: columns[name] * scale[name] for name in known if name in columns}
    )


def _get_scale(coordinate: str) -> float:
    """Return the SI value of the coordinate's unit in files."""
    return 1.0 if is_translation(coordinate) else np.pi / 180.0


def describe_landmark_mismatch(
    known: Mapping[str, Array], static: Recording, marker_set: MarkerSet
) -> str | None:
    """Describe why the landmarks of a static trial differ from those of the truth.

    Parameters
    ----------
    known
        Landmark -> (3,) m of the truth.
    static
        Recording of the static trial.
    marker_set
        Marker set of the study.

    Returns
    -------
    str or None
        None if they agree within `LANDMARK_TOLERANCE_M`.
    """
    found = measure_static_posture(
        static, marker_set, find_still_window(static, marker_set.labels).frames
    ).landmarks
    unlike = sorted(set(known) ^ set(found))
    if unlike:
        there = (
            "the static trial does not show it"
            if unlike[0] in known
            else "the truth does not have it"
        )
        return f"found other landmarks than those of the static trial: {unlike[0]}, {there}"
    names = sorted(known)
    # Compare shapes, not positions: the static trial may be rotated and moved as a whole.
    one, other = (np.array([places[name] for name in names]) for places in (known, found))
    gap = np.abs(_compute_shape(one) - _compute_shape(other))
    if gap.max() <= LANDMARK_TOLERANCE_M:
        return None
    worst = names[int(np.argmax(gap.mean(axis=1)))]
    return (
        f"found landmarks that the static trial has elsewhere, by up to {1e3 * gap.max():.1f} mm "
        f"({worst} most): the "
        "truth is declared in the segment frames of another static trial or marker set"
    )


def _compute_shape(places: Array) -> Array:
    """Compute mutual distances (n, n) m, and on the diagonal heights above their mean."""
    out: Array = np.linalg.norm(places[:, None] - places[None], axis=-1)
    out[np.diag_indices(len(places))] = places[:, 1] - places[:, 1].mean()
    return out
