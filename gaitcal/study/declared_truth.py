"""The known truth of a made-up person, as files beside the recordings: written by who made them,
read with the study.

    PARAMETERS            name,unit,value: joint and inertial parameters, names and units of a result's parameters.csv
    LANDMARKS             name,x,y,z: landmarks of the static trial, m, laboratory, y up
    TRIAL_motion.csv      names and units of a result's motion/TRIAL.csv: time, coordinates, _velocity, _acceleration
    TRIAL_moments.csv     names and units of a result's moments/TRIAL.csv: time, generalised forces, _bwh

What follows a `#` in a line is a comment; curves have their units in a comment line, which must be
there as it is written. All numbers are in the segment frames and from the ankle zero that the
calibration makes of the static trial: they are those of a calibration without error. The study file
says with which rules (`[truth]` markers, hip_centre, ankle_zero) and of which landmarks; a study
that calibrates with others would be compared with numbers that mean something else, and is refused.
Landmarks are compared by their distances from each other and their heights above their mean, which
no turn of the laboratory about the vertical, height of its floor or format of the recording
changes.
"""

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.errors import Code, InputError, nearest
from gaitcal.io import text_file, toml
from gaitcal.io.recording import Recording, still_window
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

COLUMNS = ["name", "x", "y", "z"]
SAME = 1e-4
"""m: files keep a thousandth of this; a tenth of a millimetre turns a segment by less than 0.1
degrees.
"""
MOTION, MOMENTS = "_motion.csv", "_moments.csv"
"""Endings of the files of a trial."""
MOTION_UNITS = "true coordinates in degrees and m, _velocity per s, _acceleration per s^2"
MOMENT_UNITS = (
    "true generalised forces: N m (pelvis_tx, _ty, _tz: N); NAME_bwh percent of body weight times "
    "height"
)
"""Comment lines of the two kinds: what their numbers are."""
FORCE_NAMES: tuple[str, ...] = (*FILE_COORDINATES, *REACTIONS)
"""Columns of a moments file, without time."""
DIGITS = "%.9g"
"""Of written numbers: a millionth of a degree and of a newton metre, and more."""
SLACK = 1e-4
"""s: a tenth of a millisecond of rounding in times that were written as text."""
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

    def covers(self, time: Array) -> BoolArray:
        """(n,) which instants lie between its ends."""
        out: BoolArray = (time >= self.time[0] - SLACK) & (time <= self.time[-1] + SLACK)
        return out

    def at(self, time: Array) -> dict[str, Array]:
        """Name -> values at `time` (n,); between rows of the file linear, NaN beyond its ends."""
        inside = self.covers(time)
        return {
            n: np.where(inside, np.interp(time, self.time, v), np.nan)
            for n, v in self.values.items()
        }


@dataclass(frozen=True, kw_only=True)
class Truth:
    """What is known to be true of the person of a study."""

    told: TruthTable
    """By which rules."""
    landmarks: Mapping[str, Array]
    """Landmark of the static trial whose frames it is told in -> (3,) m."""
    parameters: Mapping[str, float]
    """Parameter -> m, rad, kg, kg m^2, as far as the file has it."""
    motions: Mapping[str, TrueCurves]
    """Trial -> coordinates."""
    moments: Mapping[str, TrueCurves]
    """Trial -> generalised forces."""


def _fault(message: str, path: Path, field: str | None = None) -> InputError:
    return InputError(message, source=path, field=field, code=Code.TRUTH)


def motion_text(
    time: Array, q: Array, velocity: Array | None = None, acceleration: Array | None = None
) -> str:
    """The content of TRIAL_motion.csv; (nf,) s, then (nf, 27) m and rad, and their derivatives
    where given.
    """
    columns, parts = {"time": time}, {"": q, "_velocity": velocity, "_acceleration": acceleration}
    for suffix, values in ((suffix, part) for suffix, part in parts.items() if part is not None):
        for name in FILE_COORDINATES:
            columns[name + suffix] = values[:, COORDINATES.index(name)] / _scale(name)
    return _text(MOTION_UNITS, columns)


def moments_text(time: Array, forces: Array, bwh: float) -> str:
    """The content of TRIAL_moments.csv; (nf,) s, (nf, 29) N·m and N, and body weight times height
    in N·m.
    """
    columns = {"time": time}
    for name in FORCE_NAMES:
        value = forces[:, (*COORDINATES, *REACTIONS).index(name)]
        columns[name] = value
        columns[f"{name}_bwh"] = (
            np.full(len(time), np.nan) if is_translation(name) else 100.0 * value / bwh
        )
    return _text(MOMENT_UNITS, columns)


def landmarks_text(landmarks: Mapping[str, Array]) -> str:
    """The content of the landmarks file: name -> (3,) m, laboratory, y up."""
    places = np.array(list(landmarks.values())).reshape(-1, 3)
    columns = {"name": list(landmarks), **{axis: places[:, k] for k, axis in enumerate("xyz")}}
    return _text("landmarks of the static trial in m, laboratory, y up", columns)


def _text(units: str, columns: Mapping[str, Any]) -> str:
    import pandas as pd  # loaded by who writes: it takes a third of a second

    rows: str = pd.DataFrame(columns).to_csv(index=False, lineterminator="\n", float_format=DIGITS)
    return f"# {units}\n{rows}"


def truth_files(table: TruthTable | None, trials: Sequence[str]) -> tuple[Path, ...]:
    """The files that `[truth]` names, those of the trials as far as they are there."""
    if table is None:
        return ()
    curves = (
        (table.folder / (name + end) for name in trials for end in (MOTION, MOMENTS))
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
    """The truth that the study file `source` names; None where it names none. `marker_set`: its
    name.

    Raises InputError: One line: a name, a unit, a number or a rule that is not what a result has;
    no curves of any trial.
    """
    if table is None:
        return None
    other = other_rule(table, settings, marker_set)
    if other is not None:
        raise _fault(
            f"{other.words}; allowed: the same, or no [truth]", source, f"truth.{other.rule}"
        )
    motions, moments = (_curves(table.folder, trials, end) for end in (MOTION, MOMENTS))
    if table.folder and not motions and not moments:
        wanted = f"TRIAL{MOTION} or TRIAL{MOMENTS} of a trial of the study"
        raise _fault(
            f"found no such file in '{table.folder.name}'; allowed: {wanted}",
            source,
            "truth.folder",
        )
    return Truth(
        told=table,
        landmarks=_landmarks(table.landmarks),
        parameters=_parameters(table.parameters),
        motions=motions,
        moments=moments,
    )


@dataclass(frozen=True)
class OtherRule:
    """A rule by which the truth is told and the calibration is not."""

    rule: str
    told: str
    used: str

    @property
    def words(self) -> str:
        """What was found, and what it would do."""
        return (
            f"found '{self.told}', and the study uses '{self.used}', whose segment frames and "
            "zeros are others"
        )


def other_rule(
    table: TruthTable, settings: CalibrationSettings, marker_set: str
) -> OtherRule | None:
    """The first rule that makes frames other than those of the truth; None: its numbers mean the
    same.
    """
    used = {
        "markers": marker_set,
        "hip_centre": settings.hip_rule,
        "ankle_zero": settings.ankle_rule,
    }
    return next(
        (
            OtherRule(rule, told, u)
            for rule, u in used.items()
            if (told := getattr(table, rule)) != u
        ),
        None,
    )


def _rows(path: Path) -> tuple[list[str], list[list[str]]]:
    """Header and cells of a file; a row has as many as the header. InputError where it is no table."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, ValueError) as error:
        raise _fault(f"cannot be read as CSV: {error}", path) from None
    lines = (line.split("#", 1)[0] for line in text.splitlines())
    names, *rows = list(csv.reader(line for line in lines if line.strip())) or [[]]
    if not names:
        raise _fault("cannot be read as CSV: found no header", path)
    if twice := [name for name in names if names.count(name) > 1]:
        raise _fault(f"cannot be read as CSV: found the column {twice[0]} twice", path)
    for k, row in enumerate(rows, start=1):
        if len(row) > len(names):
            raise _fault(
                f"cannot be read as CSV: found {len(row)} cells in row {k}, below {len(names)} "
                "names",
                path,
            )
    return names, [row + [""] * (len(names) - len(row)) for row in rows]


def _number(cell: str) -> float:
    """NaN where it is none."""
    try:
        return text_file.parse_number(cell)
    except ValueError:
        return float("nan")


def _landmarks(path: Path) -> dict[str, Array]:
    """Landmark -> (3,) m."""
    names, rows = _rows(path)
    if names != COLUMNS or not rows:
        raise _fault(f"found columns {names}; allowed: name,x,y,z and a landmark a row", path)
    out = {name: np.array([_number(cell) for cell in place]) for name, *place in rows}
    if not all(np.isfinite(place).all() for place in out.values()):
        raise _fault("found a place that is no finite number; allowed: m", path, "x,y,z")
    return out


def _parameters(path: Path) -> dict[str, float]:
    names, rows = _rows(path)
    if names != ["name", "unit", "value"]:
        raise _fault(f"found columns {toml.shown(names)}; allowed: name,unit,value", path)
    out: dict[str, float] = {}
    for name, unit, cell in rows:
        value = _number(cell)
        if name not in _UNIT:
            hint = nearest(name, _UNIT) or "; allowed: names of a result's parameters.csv"
            raise _fault(f"found {toml.shown(name)}, which is no parameter{hint}", path, "name")
        if unit != _UNIT[name]:
            raise _fault(
                f"found {toml.shown(unit)}; allowed: {_UNIT[name]}", path, f"unit of {name}"
            )
        if name in out:
            raise _fault("found twice; a parameter has one true value", path, name)
        if not np.isfinite(value):
            raise _fault(f"found {toml.shown(cell)}; allowed: a finite number", path, name)
        out[name] = float(value * _TO_SI[name])
    return out


def _curves(folder: Path | None, trials: Sequence[str], ending: str) -> dict[str, TrueCurves]:
    files = {} if folder is None else {name: folder / (name + ending) for name in trials}
    return {name: _curve(path, ending) for name, path in files.items() if path.is_file()}


def _curve(path: Path, ending: str) -> TrueCurves:
    """One file; columns that follow from others (derivatives, _bwh) are for people and are not
    read.
    """
    units, known, derived = (
        (MOTION_UNITS, FILE_COORDINATES, ("_velocity", "_acceleration"))
        if ending == MOTION
        else (MOMENT_UNITS, FORCE_NAMES, ("_bwh",))
    )
    first = (
        path.read_text(encoding="utf-8", errors="replace")
        .split("\n", 1)[0]
        .removeprefix("#")
        .strip()
    )
    if first != units:
        raise _fault(f"found {toml.shown(first)}; allowed: '# {units}'", path, "line 1, the units")
    names, rows = _rows(path)
    allowed = {"time", *known, *(name + suffix for name in known for suffix in derived)}
    for column in names:
        if column not in allowed:
            hint = nearest(column, allowed) or "; allowed: names of a result's " + ending.strip("_")
            raise _fault(f"found {toml.shown(column)}, which is no column{hint}", path, "columns")
    columns = {
        name: np.array([_number(row[k]) for row in rows])
        for k, name in enumerate(names)
        if name in ("time", *known)
    }
    for column, values in columns.items():
        if not np.isfinite(values).all():
            raise _fault("found a value that is no finite number; allowed: numbers", path, column)
    time = columns.pop("time", np.empty(0))
    if len(time) < 2 or (np.diff(time) <= 0).any():
        raise _fault("found no increasing times; allowed: two rows or more, in s", path, "time")
    scale = {name: _scale(name) if ending == MOTION else 1.0 for name in columns}
    return TrueCurves(
        time=time, values={name: columns[name] * scale[name] for name in known if name in columns}
    )


def _scale(coordinate: str) -> float:
    """SI per unit of the file."""
    return 1.0 if is_translation(coordinate) else np.pi / 180.0


def other_landmarks(
    told: Mapping[str, Array], static: Recording, marker_set: MarkerSet
) -> str | None:
    """Why the landmarks of a static trial, as worn by `marker_set`, are not those of the truth;
    None: they are.
    """
    found = measure_static_posture(
        static, marker_set, still_window(static, marker_set.labels).frames
    ).landmarks
    unlike = sorted(set(told) ^ set(found))
    if unlike:
        there = (
            "the static trial does not show it"
            if unlike[0] in told
            else "the truth does not have it"
        )
        return f"found other landmarks than those of the static trial: {unlike[0]}, {there}"
    names = sorted(told)
    one, other = (np.array([places[name] for name in names]) for places in (told, found))
    gap = np.abs(_shape(one) - _shape(other))
    if gap.max() <= SAME:
        return None
    worst = names[int(np.argmax(gap.mean(axis=1)))]
    return (
        f"found landmarks that the static trial has elsewhere, by up to {1e3 * gap.max():.1f} mm "
        f"({worst} most): the "
        "truth was told in the segment frames of another static trial or marker set"
    )


def _shape(places: Array) -> Array:
    """(n, n) m: distances from each other, and on the diagonal heights above their mean."""
    out: Array = np.linalg.norm(places[:, None] - places[None], axis=-1)
    out[np.diag_indices(len(places))] = places[:, 1] - places[:, 1].mean()
    return out
