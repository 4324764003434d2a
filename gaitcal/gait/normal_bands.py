"""Normal bands: mean and standard deviation of healthy people over the gait cycle, from a CSV file.

    # source: Somebody et al. 2020, 50 adults, barefoot, free speed
    # signs: clinical
    variable,unit,percent,mean,sd
    hip_flexion,deg,0,35.2,6.1
    hip_flexion,deg,2,34.9,6.1
    hip_flexion_moment,N m/kg,0,0.31,0.14

Lines that begin with `#` are comments, but for `signs`, which must be there, as no number shows it.
Empty cells at the end of a line and lines of empty cells, as spreadsheet programs write them, are
left out.

| signs | angles | moments |
|---|---|---|
| `gaitcal`, `opensim` | as in `cycles.csv` | internal, in the coordinate's direction: flexor, adductor, dorsiflexor |
| `external` | as in `cycles.csv` | external: all of the other sign |
| `clinical` | pelvis: forward tilt, this side up, this side forward; trunk: forward, to this side, this side forward \
| internal: extensor, abductor, plantarflexor |

Angles of legs mean the same in all three; powers and ground reactions have one sign.

Variables are those of `cycles.csv` and have no side; percents are of the stride of that foot, from
its strike, increasing, at any steps: between them a straight line. Other percents are empty, not
extended.

`norm_for` chooses which healthy people somebody is held against, by age and non-dimensional speed.

Gait changes with speed more than with age, and speed means the same for a small and a tall body
once length and time are told in leg length L and sqrt(L / g) (Hof, Gait Posture 4:222-223, 1996):

    speed v / sqrt(g L)        cadence f sqrt(L / g), f in steps/s        step length s / L

L is from the anterior superior iliac spine to the medial malleolus, as clinics measure it; where
nobody did, 0.52 of body height, as in the 81 children below (SD 0.028).

Curves: typically developing children of 4 to 17 years at five speeds (Schwartz, Rozumalski and
Trost, J Biomech 41:1639-1650, 2008), in files that gaitcal brings (`models/norms/`). Their limits
between speeds are the paper's; the 81 children of the same laboratory whose own figures are
published (Pinzone et al., Gait Posture 40:286-290, 2014, centre one) walk freely at 0.431 (SD
0.069), so that `free` is mean -+ SD, and `slow` and `fast` the next two SD. From the same 81 come
the spatiotemporal norms.

There are no curves of adults that gaitcal could bring, and whose age is not told may be a small
adult: neither is held against children. Own norms (`--normal FILE`) are taken as they are.
"""

import csv
import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, NamedTuple, TypeAlias

import numpy as np

from gaitcal.arrays import Array
from gaitcal.errors import Code, InputError, nearest
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
"""Bands that gaitcal brings -> their file in `models/`, whose first lines say of whom they are."""


class _BandsError(InputError):
    code = Code.NORMAL_BANDS


class _Row(NamedTuple):
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
"""What a file of bands says of its signs; see the module's table."""
UNITS: Final[Mapping[CurveKind, tuple[str, ...]]] = {
    CurveKind.ANGLE: ("deg", "rad"),
    CurveKind.MOMENT: ("N m/kg", "N mm/kg", "%BW*H", "N m"),
    CurveKind.POWER: ("W/kg", "W"),
    CurveKind.FORCE: ("BW", "%BW", "N/kg", "N"),
}
"""What a file may say, per kind of variable."""


@dataclass(frozen=True, kw_only=True)
class NormalBand:
    """One variable of healthy people, as its file has it."""

    variable: str  # as in `cycles.csv`: `hip_flexion_moment`
    unit: str  # one of `UNITS` of its kind
    signs: Convention  # one of `BAND_SIGNS`
    percent: Array  # (n,) % of the stride, increasing
    mean: Array  # (n,)
    sd: Array  # (n,) at least 0
    source: str = ""  # what the file says of where it is from

    def scale_to_person(self, subject: Subject, side: str = "r") -> tuple[Array, Array]:
        """Mean and SD (101,) at 0 to 100 %, in the unit and with the sign of `cycles.csv`, for a
        body of that size.
        """
        at = np.arange(float(POINTS))
        factor = _get_unit_factor(self.unit, subject)
        mean, sd = (
            np.interp(at, self.percent, v, left=np.nan, right=np.nan) for v in (self.mean, self.sd)
        )
        # in `cycles.csv`'s own unit a convention is a sign, which leads back as well
        return self.signs.convert_values(self.variable, factor * mean, side, subject), factor * sd


Bands: TypeAlias = Mapping[str, NormalBand]  # variable of `cycles.csv` -> its band


def _get_unit_factor(unit: str, subject: Subject) -> float:
    """What one of a unit is in that of `cycles.csv`, for a body of that mass and height."""
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
    """The file of normal bands of that path, or of that name among those that gaitcal brings
    (`schwartz2008`).

    Raises InputError: There is neither.
    """
    path, shipped = Path(name), SHIPPED.get(str(name).lower())
    if path.exists():
        return path
    if shipped is None:
        allowed = f"a CSV file, or the name of bands that gaitcal brings: {', '.join(SHIPPED)}"
        raise _BandsError(
            f"no such file; allowed: {allowed}{nearest(str(name), SHIPPED)}", source=path
        )
    return toml.find_models_folder() / shipped


def read_normal_bands(path: Path | str) -> dict[str, NormalBand]:
    """Variable -> its band, from a CSV file as the module describes it, or of a name in `SHIPPED`.

    Raises
    ------
    InputError
        One line: file, line, what was found, what is allowed.
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
    """Comments without their `#`, and numbered rows of cells."""
    comments, rows = [], []
    for number, line in enumerate(text_file.read_lines(source), start=1):
        cells = [cell.strip() for cell in next(csv.reader([line]), [])]
        while cells and not cells[-1]:
            cells.pop()
        if cells and cells[0].startswith("#"):
            # a spreadsheet program may have put the comment, or a part of it, in quotation marks
            comments.append(", ".join(cells).lstrip("# "))
        elif cells:
            rows.append((number, cells))
    return comments, rows


def _read_named_comments(comments: Sequence[str]) -> dict[str, list[str]]:
    """What comments of the form `name: text` say, each text once."""
    out: dict[str, list[str]] = {}
    for name, colon, text in (comment.partition(":") for comment in comments):
        if colon and text.strip() not in (texts := out.setdefault(name.strip().lower(), [])):
            texts.append(text.strip())
    return out


def _read_signs(texts: Sequence[str], source: Path) -> Convention:
    """What all lines on signs agree in."""
    names = {**BAND_SIGNS, "opensim": BAND_SIGNS["gaitcal"]}
    wrong = [text for text in texts if text.lower() not in names]
    found = f"found '{wrong[0]}'" if wrong else "" if texts else "missing"
    if not found and len({names[text.lower()] for text in texts}) > 1:
        found = f"found {' and '.join(map(repr, texts))}"
    if found:
        raise _BandsError(
            f"{found}; allowed: a line '# signs: {' | '.join(names)}'", source=source, field="signs"
        )
    return names[texts[0].lower()]


def _read_rows(rows: Sequence[tuple[int, list[str]]], source: Path) -> Iterator[_Row]:
    known = list_variables()
    ranges = {"percent": (0.0, 100.0), "mean": (-1e6, 1e6), "sd": (0.0, 1e6)}
    for number, cells in rows:

        def fault(text: str, at: str = f"line {number}") -> _BandsError:
            return _BandsError(text, source=source, field=at)

        if len(cells) != len(COLUMNS):
            raise fault(f"found {len(cells)} cells; allowed: {len(COLUMNS)}")
        variable, unit = cells[:2]
        if variable not in known:
            hint = "; names have no side" if split_side(variable)[1] else nearest(variable, known)
            raise fault(f"found variable '{variable}'; allowed: those of cycles.csv{hint}")
        allowed = UNITS[get_curve_kind(variable)]
        spelt = {_normalise_unit(u): u for u in allowed}
        if _normalise_unit(unit) not in spelt:
            raise fault(f"found unit '{unit}' of {variable}; allowed: {', '.join(allowed)}")
        numbers = []
        for (name, (low, high)), cell in zip(ranges.items(), cells[2:], strict=True):
            try:
                value = float(cell)
            except ValueError:
                value = float("nan")
            if not low <= value <= high:
                raise fault(f"found {name} '{cell}'; allowed: a number from {low:g} to {high:g}")
            numbers.append(value)
        yield _Row(number, variable, spelt[_normalise_unit(unit)], *numbers)


def _normalise_unit(unit: str) -> str:
    """A unit without what people write differently: `N·m/kg`, `Nm/kg`, `N m / kg`."""
    return unit.replace("·", "").replace("*", "").replace(" ", "").lower()


def _make_band(
    variable: str, rows: Sequence[_Row], signs: Convention, origin: str, source: Path
) -> NormalBand:
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
AGES: Final = (4.0, 18.0)  # Years, from and below which the children's norms hold


class _Speed(NamedTuple):
    name: str  # Of `SHIPPED`
    label: str
    high: float  # Non-dimensional speed below which it holds


SPEEDS: Final = (
    _Speed("schwartz2008-very-slow", "very slow", 0.227),
    _Speed("schwartz2008-slow", "slow", 0.363),
    _Speed("schwartz2008-free", "free", 0.500),
    _Speed("schwartz2008-fast", "fast", 0.636),
    _Speed("schwartz2008-very-fast", "very fast", 0.705),
)
SLOWEST: Final = 0.158
"""Non-dimensional speed below which none holds. This and the highest are one SD of `FREE` beyond
the paper's limits: outside few of those children walked."""
FREE: Final = {"speed": (0.431, 0.069), "cadence": (0.561, 0.050), "step_length": (0.765, 0.080)}
"""Measure -> mean and SD, non-dimensional, of 81 children at the speed of their choice."""
MODEL_REMARK: Final = (
    "Theirs is Plug-in Gait's model: offsets of hip rotation and adduction are partly that."
)
"""In a child's straight walk the vendor's hip rotation is 15 and 5 deg from ours, adduction 2 and
3.5.
"""
FREE_LABEL: Final = "children 4 to 17 years, free speed, n = 81 (Pinzone 2014), by leg length"


@dataclass(frozen=True, kw_only=True)
class Norm:
    """Healthy people to hold somebody against; empty where none fit."""

    bands: Bands = field(default_factory=dict)
    steps: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Measure of `spatiotemporal.MEASURES` -> mean and SD, in its unit, for a leg of this length,
    at free speed.
    """
    label: str = ""  # Who they are: for legends
    remark: str = ""  # Why these, or why none: a sentence


def estimate_leg_length(subject: Subject) -> tuple[float, str]:
    """m, and how it is known."""
    measured = list(subject.leg_length.values())
    if measured:
        return float(np.mean(measured)), f"{np.mean(measured):.2f} m"
    length = LEG_OF_HEIGHT * subject.height
    return length, f"{length:.2f} m estimated from the height"


def select_norm(subject: Subject, speed: float | None) -> Norm:
    """The norm that gaitcal brings for somebody who walks at `speed` (m/s; None: not known)."""
    low, high = AGES
    theirs = f"the built-in norms are for children of {low:.0f} to {high - 1:.0f} years"
    if subject.age is None:
        return Norm(remark=f"No norm: the age is not given (age_years), and {theirs}.")
    if not low <= subject.age < high:
        age = _format_age(subject.age)
        return Norm(
            remark=f"No norm fits an age of {age} years: {theirs}. Your laboratory's own: --normal "
            "FILE."
        )
    length, how = estimate_leg_length(subject)
    steps = compute_free_steps(length)
    if speed is None:
        return Norm(
            steps=steps, remark="No norm of curves: no stride tells the speed, which chooses it."
        )
    relative = speed / np.sqrt(GRAVITY * length)
    walk = f"Walks at {speed:.2f} m/s, {relative:.2f} times √(g · leg length), {how}"
    chosen = next((of for of in SPEEDS if SLOWEST <= relative < of.high), None)
    if chosen is None:
        limits = f"{SLOWEST:g} to {SPEEDS[-1].high:g}"
        return Norm(
            steps=steps,
            remark=f"{walk}: no norm of curves fits, those that gaitcal brings are of {limits}.",
        )
    bands = read_normal_bands(chosen.name)
    return Norm(
        bands=bands,
        steps=steps,
        label=list_sources(bands),
        remark=f"{walk}: {chosen.label} speed. {MODEL_REMARK}",
    )


def make_user_norm(bands: Bands, name: str, subject: Subject) -> Norm:
    """The norm that somebody names (`--normal`), with a word where those of children are taken for
    an adult.
    """
    low, high = AGES
    remark = ""
    if name.lower().startswith("schwartz2008") and not (
        subject.age is not None and low <= subject.age < high
    ):
        age = (
            "the age is not given"
            if subject.age is None
            else f"this person is {_format_age(subject.age)} years old"
        )
        remark = f"Bands of children of {low:.0f} to {high - 1:.0f} years, as asked for: {age}."
    return Norm(bands=bands, label=list_sources(bands), remark=remark)


def _format_age(age: float) -> str:
    """As people tell it: whom a day is missing to 4 years is 3.9."""
    return f"{np.floor(10.0 * age) / 10.0:g}"


def list_sources(bands: Bands) -> str:
    """Whom the bands are of, each source once."""
    return "; ".join(dict.fromkeys(band.source for band in bands.values() if band.source))


def compute_free_steps(length: float) -> dict[str, tuple[float, float]]:
    """`speed` m/s, `cadence` steps/min, `step_length` and `stride_length` m: mean and SD for a leg
    of `length` m.
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
