"""Normal bands: mean and standard deviation of healthy people over the gait cycle (CSV files).

    # source: Somebody et al. 2020, 50 adults, barefoot, free speed
    # signs: clinical
    variable,unit,percent,mean,sd
    hip_flexion,deg,0,35.2,6.1
    hip_flexion,deg,2,34.9,6.1
    hip_flexion_moment,N m/kg,0,0.31,0.14

Lines that begin with `#` are comments. The comment `signs` is required, because the numbers cannot
show the signs. Empty cells at the end of a line and lines of empty cells, as spreadsheet programs
write them, are skipped.

| signs | angles | moments |
|---|---|---|
| `gaitcal`, `opensim` | as in `cycles.csv` | internal: flexor, adductor, dorsiflexor |
| `external` | as in `cycles.csv` | external: the opposite sign |
| `clinical` | pelvis, trunk: see below | internal: extensor, abductor, plantarflexor |

Clinical signs of the pelvis: forward tilt, this side up, this side forward; of the trunk: forward,
to this side, this side forward.

Angles of legs are the same in all three; powers and ground reactions have one sign.

Variables are those of `cycles.csv` without a side. Percents are of the stride of that foot, from
its strike, increasing, at any steps, with linear interpolation between them. Other percents stay
empty: there is no extrapolation.

`select_norm` selects the healthy people for comparison by age and non-dimensional speed. Gait
changes more with speed than with age. Speeds of small and tall people compare once length and time
are in units of leg length L and sqrt(L / g) (Hof, Gait Posture 4:222-223, 1996):

    speed v / sqrt(g L)        cadence f sqrt(L / g), f in steps/s        step length s / L

L is from the anterior superior iliac spine to the medial malleolus, as clinics measure it. Without
a measurement it is 0.52 of body height, as in the 81 children below (SD 0.028).

Curves: typically developing children of 4 to 17 years at five speeds (Schwartz, Rozumalski and
Trost, J Biomech 41:1639-1650, 2008), in `models/norms/`. The limits between speeds are those of the
paper. The 81 children of the same laboratory with published individual data (Pinzone et al., Gait
Posture 40:286-290, 2014, centre one) walk freely at 0.431 (SD 0.069): `free` is mean -+ SD, `slow`
and `fast` are the next two SD. The spatiotemporal norms are from these 81 children.

No curves of adults may be distributed with gaitcal. A person whose age is not given may be a small
adult. Neither is compared with children. Norms of the laboratory (`--normal FILE`) are used as
given.
"""

import csv
import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, NamedTuple, TypeAlias

import numpy as np

from gaitcal.arrays import Array
from gaitcal.errors import Code, InputError, suggest_name
from gaitcal.gait.conventions import Acting, Convention, Signs
from gaitcal.gait.cycles import POINTS, CurveKind, get_curve_kind, list_variables
from gaitcal.io import text_file, toml
from gaitcal.model.coordinates import split_side
from gaitcal.model.subject_model import GRAVITY, Subject

COLUMNS: Final = ("variable", "unit", "percent", "mean", "sd")
LEAST_POINTS: Final = 2
_SPEEDS: Final = ("very_slow", "slow", "free", "fast", "very_fast")
SHIPPED: Final[Mapping[str, str]] = {"schwartz2008": "norms/schwartz2008_free.csv"} | {
    f"schwartz2008-{speed.replace('_', '-')}": f"norms/schwartz2008_{speed}.csv"
    for speed in _SPEEDS
}
"""Built-in bands -> their file in `models/`, whose first lines describe the people."""


class _BandsError(InputError):
    """Error in a file of normal bands."""

    code = Code.NORMAL_BANDS


class _Row(NamedTuple):
    """One row of the file."""

    line: int
    variable: str
    unit: str
    percent: float
    mean: float
    sd: float


BAND_SIGNS: Final[Mapping[str, Convention]] = {
    "gaitcal": Convention(),
    "external": Convention(acting=Acting.EXTERNAL),
    "clinical": Convention(signs=Signs.CLINICAL),
}
"""Signs of a file of bands -> convention; see the table of the module."""
UNITS: Final[Mapping[CurveKind, tuple[str, ...]]] = {
    CurveKind.ANGLE: ("deg", "rad"),
    CurveKind.MOMENT: ("N m/kg", "N mm/kg", "%BW*H", "N m"),
    CurveKind.POWER: ("W/kg", "W"),
    CurveKind.FORCE: ("BW", "%BW", "N/kg", "N"),
}
"""Kind of variable -> units that a file may have."""


@dataclass(frozen=True, kw_only=True)
class NormalBand:
    """Normal band of one variable, as in its file."""

    variable: str  # as in `cycles.csv`: `hip_flexion_moment`
    unit: str  # one of `UNITS` of its kind
    signs: Convention  # one of `BAND_SIGNS`
    percent: Array  # (n,) % of the stride, increasing
    mean: Array  # (n,), in `unit`
    sd: Array  # (n,), in `unit`, at least 0
    source: str = ""  # comment `source` of the file

    def scale_to_person(self, subject: Subject, side: str = "r") -> tuple[Array, Array]:
        """Scale the band to a person, with unit and sign of `cycles.csv`.

        Parameters
        ----------
        subject : Subject
            Mass (kg) and height (m).
        side : {"r", "l"}
            Side of the stride; it matters for pelvis and trunk.

        Returns
        -------
        tuple of (101,) Array
            Mean and SD at 0, 1, ... 100 %; NaN outside of the percents of the file.
        """
        at = np.arange(float(POINTS))
        factor = _get_unit_factor(self.unit, subject)
        mean, sd = (
            np.interp(at, self.percent, v, left=np.nan, right=np.nan) for v in (self.mean, self.sd)
        )
        # In the unit of `cycles.csv` a convention is only a sign: its inverse is the same.
        return self.signs.values(self.variable, factor * mean, side, subject), factor * sd


Bands: TypeAlias = Mapping[str, NormalBand]
"""Variable of `cycles.csv` -> its band."""


def _get_unit_factor(unit: str, subject: Subject) -> float:
    """Get the factor from a unit to that of `cycles.csv`, for a person's mass and height."""
    return {
        "deg": 1.0,
        "rad": 180.0 / np.pi,
        "N m/kg": subject.mass,
        "N mm/kg": 1e-3 * subject.mass,
        "%BW*H": 0.01 * subject.bwh,
        "W/kg": subject.mass,
        "BW": subject.weight,
        "%BW": 0.01 * subject.weight,
        "N/kg": subject.mass,
    }.get(unit, 1.0)


def find_bands_file(name: Path | str) -> Path:
    """Find a file of normal bands by its path, or by a name in `SHIPPED` (`schwartz2008`).

    Parameters
    ----------
    name : Path or str
        Path of a CSV file, or a name.

    Returns
    -------
    Path

    Raises
    ------
    InputError
        There is no such file and no such name.
    """
    path, shipped = Path(name), SHIPPED.get(str(name).lower())
    if path.exists():
        return path
    if shipped is None:
        allowed = f"a CSV file, or the name of built-in bands: {', '.join(SHIPPED)}"
        raise _BandsError(
            f"no such file; allowed: {allowed}{suggest_name(str(name), SHIPPED)}", source=path
        )
    return toml.find_models_folder() / shipped


def read_normal_bands(path: Path | str) -> dict[str, NormalBand]:
    """Read normal bands from a CSV file.

    Parameters
    ----------
    path : Path or str
        CSV file as described in the manual, or a name in `SHIPPED` (`schwartz2008`).

    Returns
    -------
    dict
        Variable of `cycles.csv` -> its band.

    Raises
    ------
    InputError
        The message names file, line, the value found and the allowed ones.
    """
    source = find_bands_file(path)
    comments, rows = _split_lines(source)
    named = _read_named_comments(comments)
    signs = _read_signs(named.get("signs", []), source)
    header = tuple(rows[0][1]) if rows else ()
    if header != COLUMNS:
        raise _BandsError(
            f"found '{','.join(header)}'; allowed: '{','.join(COLUMNS)}'",
            source=source,
            field="columns",
        )
    points: dict[str, list[_Row]] = {}
    for row in _read_rows(rows[1:], source):
        points.setdefault(row.variable, []).append(row)
    if not points:
        raise _BandsError("found no row below the names of the columns", source=source)
    origin = "; ".join(named.get("source", []))
    return {
        variable: _make_band(variable, found, signs, origin, source)
        for variable, found in points.items()
    }


def _split_lines(source: Path) -> tuple[list[str], list[tuple[int, list[str]]]]:
    """Split the file into comments without `#`, and numbered rows of cells."""
    comments, rows = [], []
    for number, line in enumerate(text_file.read_lines(source), start=1):
        cells = [cell.strip() for cell in next(csv.reader([line]), [])]
        while cells and not cells[-1]:
            cells.pop()
        if cells and cells[0].startswith("#"):
            # Spreadsheet programs may put the comment, or a part of it, in quotation marks.
            comments.append(", ".join(cells).lstrip("# "))
        elif cells:
            rows.append((number, cells))
    return comments, rows


def _read_named_comments(comments: Sequence[str]) -> dict[str, list[str]]:
    """Read comments of the form `name: text`, each text once."""
    out: dict[str, list[str]] = {}
    for comment in comments:
        name, colon, text = comment.partition(":")
        if colon:
            texts = out.setdefault(name.strip().lower(), [])
            if text.strip() not in texts:
                texts.append(text.strip())
    return out


def _read_signs(texts: Sequence[str], source: Path) -> Convention:
    """Read the convention of the comments `signs`, which must agree."""
    names = {**BAND_SIGNS, "opensim": BAND_SIGNS["gaitcal"]}
    wrong = [text for text in texts if text.lower() not in names]
    fault = ""
    if not texts:
        fault = "missing"
    elif wrong:
        fault = f"found '{wrong[0]}'"
    elif len({names[text.lower()] for text in texts}) > 1:
        fault = f"found {' and '.join(map(repr, texts))}"
    if fault:
        allowed = f"a line '# signs: {' | '.join(names)}'"
        raise _BandsError(f"{fault}; allowed: {allowed}", source=source, field="signs")
    return names[texts[0].lower()]


def _read_rows(rows: Sequence[tuple[int, list[str]]], source: Path) -> Iterator[_Row]:
    """Read and validate the rows below the header."""
    known = list_variables()
    ranges = {"percent": (0.0, 100.0), "mean": (-1e6, 1e6), "sd": (0.0, 1e6)}
    for number, cells in rows:

        def make_error(text: str, where: str = f"line {number}") -> _BandsError:
            return _BandsError(text, source=source, field=where)

        if len(cells) != len(COLUMNS):
            raise make_error(f"found {len(cells)} cells; allowed: {len(COLUMNS)}")
        variable, unit = cells[:2]
        if variable not in known:
            hint = (
                "; names have no side" if split_side(variable)[1] else suggest_name(variable, known)
            )
            raise make_error(f"found variable '{variable}'; allowed: those of cycles.csv{hint}")
        allowed = UNITS[get_curve_kind(variable)]
        spelt = {_normalise_unit(u): u for u in allowed}
        if _normalise_unit(unit) not in spelt:
            raise make_error(f"found unit '{unit}' of {variable}; allowed: {', '.join(allowed)}")
        numbers = []
        for (name, (low, high)), cell in zip(ranges.items(), cells[2:], strict=True):
            try:
                value = float(cell)
            except ValueError:
                value = float("nan")
            if not low <= value <= high:
                allowed_range = f"a number from {low:g} to {high:g}"
                raise make_error(f"found {name} '{cell}'; allowed: {allowed_range}")
            numbers.append(value)
        yield _Row(number, variable, spelt[_normalise_unit(unit)], *numbers)


def _normalise_unit(unit: str) -> str:
    """Normalise the spelling of a unit: `N·m/kg`, `Nm/kg`, `N m / kg`."""
    return unit.replace("·", "").replace("*", "").replace(" ", "").lower()


def _make_band(
    variable: str, rows: Sequence[_Row], signs: Convention, origin: str, source: Path
) -> NormalBand:
    """Make the band of one variable from its rows, with increasing percents and one unit."""
    for before, row in itertools.pairwise(rows):
        fault = ""
        if row.unit != before.unit:
            fault = f"found {variable} in {row.unit}, before it in {before.unit}; allowed: one unit"
        elif row.percent <= before.percent:
            found = f"found percent {row.percent:g} of {variable} after {before.percent:g}"
            fault = f"{found}; allowed: increasing percents"
        if fault:
            raise _BandsError(fault, source=source, field=f"line {row.line}")
    if len(rows) < LEAST_POINTS:
        raise _BandsError(f"found one percent of {variable}; allowed: two or more", source=source)
    return NormalBand(
        variable=variable,
        unit=rows[0].unit,
        signs=signs,
        percent=np.array([row.percent for row in rows]),
        mean=np.array([row.mean for row in rows]),
        sd=np.array([row.sd for row in rows]),
        source=origin,
    )


LEG_OF_HEIGHT: Final = 0.52
"""Leg length over body height."""
AGES: Final = (4.0, 18.0)
"""Years, from and below which the children's norms hold."""


class _Speed(NamedTuple):
    """Range of non-dimensional speed of a set of bands."""

    name: str  # in `SHIPPED`
    label: str
    high: float  # non-dimensional speed below which it holds


SPEEDS: Final = (
    _Speed("schwartz2008-very-slow", "very slow", 0.227),
    _Speed("schwartz2008-slow", "slow", 0.363),
    _Speed("schwartz2008-free", "free", 0.500),
    _Speed("schwartz2008-fast", "fast", 0.636),
    _Speed("schwartz2008-very-fast", "very fast", 0.705),
)
SLOWEST: Final = 0.158
"""Non-dimensional speed below which no norm holds. This and the highest speed are one SD of `FREE`
beyond the limits of the paper: few of those children walked outside of them.
"""
FREE: Final = {"speed": (0.431, 0.069), "cadence": (0.561, 0.050), "step_length": (0.765, 0.080)}
"""Measure -> mean and SD, non-dimensional, of 81 children at the speed of their choice."""
MODEL_REMARK: Final = (
    "These norms are of Plug-in Gait's model: offsets of hip rotation and adduction are partly due "
    "to it."
)
"""In a child's straight walk, hip rotation of the vendor differs from ours by 15 and 5 deg,
adduction by 2 and 3.5 deg.
"""
FREE_LABEL: Final = "children 4 to 17 years, free speed, n = 81 (Pinzone 2014), by leg length"


@dataclass(frozen=True, kw_only=True)
class Norm:
    """Healthy people to compare a person with; empty where none fit."""

    bands: Bands = field(default_factory=dict)
    steps: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Measure of `spatiotemporal.MEASURES` -> mean and SD in its unit, for a leg of this length, at
    free speed.
    """
    label: str = ""
    """Description of these people, for legends."""
    remark: str = ""
    """Reason for these, or for none: a sentence."""


def estimate_leg_length(subject: Subject) -> tuple[float, str]:
    """Estimate the length of the legs.

    `subject`: person with or without measured legs. Returns: m; and a text of the length, with its
    source.
    """
    measured = list(subject.leg_length.values())
    if measured:
        return float(np.mean(measured)), f"{np.mean(measured):.2f} m"
    length = LEG_OF_HEIGHT * subject.height
    return length, f"{length:.2f} m estimated from the height"


def select_norm(subject: Subject, speed: float | None) -> Norm:
    """Select the built-in norm for a person by age and speed.

    Parameters
    ----------
    subject : Subject
        Person with age (years), leg length or height (m).
    speed : float or None
        m/s, mean speed of walking; None where it is not known.

    Returns
    -------
    Norm
        `remark` gives the reason for the choice.
    """
    low, high = AGES
    theirs = f"the built-in norms are for children of {low:.0f} to {high - 1:.0f} years"
    if subject.age is None:
        return Norm(remark=f"No norm: the age is not given (age_years), and {theirs}.")
    if not low <= subject.age < high:
        age = _format_age(subject.age)
        return Norm(
            remark=f"No norm for an age of {age} years: {theirs}. Norms of your laboratory can be "
            "given by --normal FILE."
        )
    length, how = estimate_leg_length(subject)
    steps = compute_free_steps(length)
    if speed is None:
        remark = "No norm of curves: the walking speed, which selects it, is not known."
        return Norm(steps=steps, remark=remark)
    # Dimensionless speed (Froude number's root): children of different size walk alike at the same.
    relative = speed / np.sqrt(GRAVITY * length)
    walk = f"Walks at {speed:.2f} m/s, {relative:.2f} times √(g · leg length), {how}"
    chosen = next((row for row in SPEEDS if SLOWEST <= relative < row.high), None)
    if chosen is None:
        limits = f"{SLOWEST:g} to {SPEEDS[-1].high:g}"
        remark = f"{walk}: no norm of curves for this speed; the built-in ones are for {limits}."
        return Norm(steps=steps, remark=remark)
    bands = read_normal_bands(chosen.name)
    return Norm(
        bands=bands,
        steps=steps,
        label=_list_sources(bands),
        remark=f"{walk}: {chosen.label} speed. {MODEL_REMARK}",
    )


def make_user_norm(bands: Bands, name: str, subject: Subject) -> Norm:
    """Make the norm that a user named (`--normal`).

    Parameters
    ----------
    bands : Bands
        Bands that were read.
    name : str
        Name or file that the user gave.
    subject : Subject
        Person; a remark is added where children are compared with somebody of another age.

    Returns
    -------
    Norm
    """
    low, high = AGES
    remark = ""
    is_child = subject.age is not None and low <= subject.age < high
    if name.lower().startswith("schwartz2008") and not is_child:
        age = "the age is not given"
        if subject.age is not None:
            age = f"this person is {_format_age(subject.age)} years old"
        remark = f"Bands of children of {low:.0f} to {high - 1:.0f} years, as requested: {age}."
    return Norm(bands=bands, label=_list_sources(bands), remark=remark)


def _format_age(age: float) -> str:
    """Format an age in years, rounded down: 3.99 years are 3.9."""
    return f"{np.floor(10.0 * age) / 10.0:g}"


def _list_sources(bands: Bands) -> str:
    """List the sources of the bands, each once."""
    return "; ".join(dict.fromkeys(band.source for band in bands.values() if band.source))


def compute_free_steps(length: float) -> dict[str, tuple[float, float]]:
    """Compute norms of steps at free speed.

    `length`: m, of the leg. Returns: `speed` (m/s), `cadence` (steps/min), `step_length` and
    `stride_length` (m) -> mean and SD.
    """
    units = {
        "speed": np.sqrt(GRAVITY * length),
        "cadence": 60.0 * np.sqrt(GRAVITY / length),
        "step_length": length,
    }
    out = {
        name: (float(unit * FREE[name][0]), float(unit * FREE[name][1]))
        for name, unit in units.items()
    }
    return out | {"stride_length": (2.0 * out["step_length"][0], 2.0 * out["step_length"][1])}
