"""Normal bands: mean and standard deviation of healthy people over the gait cycle, from a CSV file.

    # source: Somebody et al. 2020, 50 adults, barefoot, free speed
    # signs: clinical
    variable,unit,percent,mean,sd
    hip_flexion,deg,0,35.2,6.1
    hip_flexion,deg,2,34.9,6.1
    hip_flexion_moment,N m/kg,0,0.31,0.14

Lines that begin with `#` are comments, but for `signs`, which must be there, as no number shows it. Empty cells at the
end of a line and lines of empty cells, as spreadsheet programs write them, are left out.

| signs | angles | moments |
|---|---|---|
| `gaitcal`, `opensim` | as in `cycles.csv` | internal, in the coordinate's direction: flexor, adductor, dorsiflexor |
| `external` | as in `cycles.csv` | external: all of the other sign |
| `clinical` | pelvis: forward tilt, this side up, this side forward; trunk: forward, to this side, this side forward \
| internal: extensor, abductor, plantarflexor |

Angles of legs mean the same in all three; powers and ground reactions have one sign.

Variables are those of `cycles.csv` and have no side; percents are of the stride of that foot, from its strike,
increasing, at any steps: between them a straight line. Other percents are empty, not extended.
"""

from __future__ import annotations

import csv
import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple, TypeAlias

import numpy as np

from gaitcal.arrays import Array
from gaitcal.codes import Code
from gaitcal.errors import InputError, nearest
from gaitcal.gait.conventions import Acting, Convention, Signs
from gaitcal.gait.cycles import POINTS, Kind, kind_of, known_variables
from gaitcal.io.text_file import read_lines
from gaitcal.io.toml import models_path
from gaitcal.model.coordinates import split_side
from gaitcal.model.subject_model import Subject

COLUMNS: Final = ("variable", "unit", "percent", "mean", "sd")
LEAST_POINTS: Final = 2
_SPEEDS: Final = ("very_slow", "slow", "free", "fast", "very_fast")
SHIPPED: Final[Mapping[str, str]] = {"schwartz2008": "norms/schwartz2008_free.csv"} | {
    f"schwartz2008-{speed.replace('_', '-')}": f"norms/schwartz2008_{speed}.csv" for speed in _SPEEDS
}
"""Bands that gaitcal brings -> their file in `models/`, whose first lines say of whom they are (`gait/norms.py`)."""


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
UNITS: Final[Mapping[Kind, tuple[str, ...]]] = {
    Kind.ANGLE: ("deg", "rad"),
    Kind.MOMENT: ("N m/kg", "N mm/kg", "%BW*H", "N m"),
    Kind.POWER: ("W/kg", "W"),
    Kind.FORCE: ("BW", "%BW", "N/kg", "N"),
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

    def for_person(self, subject: Subject, side: str = "r") -> tuple[Array, Array]:
        """Mean and SD (101,) at 0 to 100 %, in the unit and with the sign of `cycles.csv`, for a body of that size."""
        at = np.arange(float(POINTS))
        factor = _to_ours(self.unit, subject)
        mean, sd = (np.interp(at, self.percent, v, left=np.nan, right=np.nan) for v in (self.mean, self.sd))
        # in `cycles.csv`'s own unit a convention is a sign, which leads back as well
        return self.signs.values(self.variable, factor * mean, side, subject), factor * sd


Bands: TypeAlias = Mapping[str, NormalBand]  # variable of `cycles.csv` -> its band


def _to_ours(unit: str, subject: Subject) -> float:
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


def bands_file(name: Path | str) -> Path:
    """The file of normal bands of that path, or of that name among those that gaitcal brings (`schwartz2008`).

    Raises
    ------
    InputError
        There is neither.
    """
    path, shipped = Path(name), SHIPPED.get(str(name).lower())
    if path.exists():
        return path
    if shipped is None:
        allowed = f"a CSV file, or the name of bands that gaitcal brings: {', '.join(SHIPPED)}"
        raise _BandsError(f"no such file; allowed: {allowed}{nearest(str(name), SHIPPED)}", source=path)
    return models_path() / shipped


def read_normal_bands(path: Path | str) -> dict[str, NormalBand]:
    """Variable -> its band, from a CSV file as the module describes it, or of a name in `SHIPPED`.

    Raises
    ------
    InputError
        One line: file, line, what was found, what is allowed.
    """
    source = bands_file(path)
    comments, rows = _parted(source)
    named = _named(comments)
    signs = _signs(named.get("signs", []), source)
    header = tuple(rows[0][1]) if rows else ()
    if header != COLUMNS:
        raise _BandsError(f"found '{','.join(header)}'; allowed: '{','.join(COLUMNS)}'", source=source, field="columns")
    points: dict[str, list[_Row]] = {}
    for row in _read(rows[1:], source):
        points.setdefault(row.variable, []).append(row)
    if not points:
        raise _BandsError("found no row below the names of the columns", source=source)
    origin = "; ".join(named.get("source", []))
    return {variable: _band(variable, found, signs, origin, source) for variable, found in points.items()}


def _parted(source: Path) -> tuple[list[str], list[tuple[int, list[str]]]]:
    """Comments without their `#`, and numbered rows of cells."""
    comments, rows = [], []
    for number, line in enumerate(read_lines(source), start=1):
        cells = [cell.strip() for cell in next(csv.reader([line]), [])]
        while cells and not cells[-1]:
            cells.pop()
        if cells and cells[0].startswith("#"):
            # a spreadsheet program may have put the comment, or a part of it, in quotation marks
            comments.append(", ".join(cells).lstrip("# "))
        elif cells:
            rows.append((number, cells))
    return comments, rows


def _named(comments: Sequence[str]) -> dict[str, list[str]]:
    """What comments of the form `name: text` say, each text once."""
    out: dict[str, list[str]] = {}
    for name, colon, text in (comment.partition(":") for comment in comments):
        if colon and text.strip() not in (texts := out.setdefault(name.strip().lower(), [])):
            texts.append(text.strip())
    return out


def _signs(texts: Sequence[str], source: Path) -> Convention:
    """What all lines on signs agree in."""
    names = {**BAND_SIGNS, "opensim": BAND_SIGNS["gaitcal"]}
    wrong = [text for text in texts if text.lower() not in names]
    found = f"found '{wrong[0]}'" if wrong else "" if texts else "missing"
    if not found and len({names[text.lower()] for text in texts}) > 1:
        found = f"found {' and '.join(map(repr, texts))}"
    if found:
        raise _BandsError(f"{found}; allowed: a line '# signs: {' | '.join(names)}'", source=source, field="signs")
    return names[texts[0].lower()]


def _read(rows: Sequence[tuple[int, list[str]]], source: Path) -> Iterator[_Row]:
    known = known_variables()
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
        allowed = UNITS[kind_of(variable)]
        spelt = {_plain(u): u for u in allowed}
        if _plain(unit) not in spelt:
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
        yield _Row(number, variable, spelt[_plain(unit)], *numbers)


def _plain(unit: str) -> str:
    """A unit without what people write differently: `N·m/kg`, `Nm/kg`, `N m / kg`."""
    return unit.replace("·", "").replace("*", "").replace(" ", "").lower()


def _band(variable: str, rows: Sequence[_Row], signs: Convention, origin: str, source: Path) -> NormalBand:
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
