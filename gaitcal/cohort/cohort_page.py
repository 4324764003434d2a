"""Write `cohort.html` from the tables of a cohort and the stored outcomes.

Curves come from the people one by one, so that little is in memory. The page has no date: the same
people give the same bytes.
"""

import csv
import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow.parquet as pq

from gaitcal.arrays import Array
from gaitcal.cohort.cohort_people import CohortPerson
from gaitcal.cohort.one_person import (
    COLUMNS,
    EVERY,
    PER_KG,
    STEPS,
    VARIABLES,
    CommonSettings,
    pack_no_curves,
)
from gaitcal.cohort.outcome import Outcome, Outcomes
from gaitcal.gait import conventions, normal_bands
from gaitcal.gait.cycles import CurveKind, get_coordinate, get_curve_kind, get_unit
from gaitcal.gait.peaks import ADDUCTION_PEAK, PEAKS, Peak, PeakKind
from gaitcal.io.toml import get_package_version
from gaitcal.model.linkage import SIDES
from gaitcal.model.subject_model import Subject
from gaitcal.report.page.page_html import write_cohort_page
from gaitcal.report.page.plain_data import dump_script_json, pack_floats
from gaitcal.results.trial_curves import find_joint


@dataclass(frozen=True, kw_only=True)
class CohortMeasure:
    """One measure."""

    name: str
    title: str
    unit: str
    digits: int
    column: str
    """Of the table of people; `{}` is replaced by the leg, `r` or `l`, if there is one for each."""
    error: str = ""
    """Column of its standard error."""
    sign: int = 1
    """-1: it is the negative of the column."""
    joined: str = ""
    """How the columns of both legs become one number: `mean`, or `asymmetry` = 200 % (r - l) /
    (r + l); empty: one number for each leg."""


def _make_peak_measure(name: str, title: str, peak: Peak) -> CohortMeasure:
    """Make the measure of a peak, of each leg."""
    kind, sign = get_curve_kind(peak.variable), -1 if peak.figure is PeakKind.LOWEST else 1
    digits, title = (1 if kind is CurveKind.ANGLE else 2), f"{title}, peak in {peak.phase}"
    column, error = f"{peak.name}_{{}}", f"{peak.name}_se_{{}}"
    return CohortMeasure(
        name=name,
        title=title,
        unit=PER_KG[kind],
        digits=digits,
        column=column,
        error=error,
        sign=sign,
    )


MEASURES: Final = (
    CohortMeasure(name="mass", title="Mass", unit="kg", digits=1, column="mass_kg"),
    CohortMeasure(name="height", title="Height", unit="m", digits=2, column="height_m"),
    CohortMeasure(
        name="marker_rms",
        title="Marker RMS, pelvis and legs",
        unit="mm",
        digits=1,
        column="legs_rms_calibrated_mm",
    ),
    CohortMeasure(
        name="residual",
        title="Pelvis residual",
        unit="N",
        digits=1,
        column="residual_force_calibrated_N",
    ),
    CohortMeasure(
        name="speed", title="Speed", unit="m/s", digits=2, column="speed_{}", joined="mean"
    ),
    CohortMeasure(
        name="cadence",
        title="Cadence",
        unit="steps/min",
        digits=0,
        column="cadence_{}",
        joined="mean",
    ),
    CohortMeasure(
        name="step_asymmetry",
        title="Step length asymmetry",
        unit="%",
        digits=1,
        column="step_length_{}",
        joined="asymmetry",
    ),
    _make_peak_measure("knee_flexion", "Knee flexion", PEAKS["knee_flexion_swing"]),
    _make_peak_measure("hip_extension", "Hip extension", PEAKS["hip_extension_terminal_stance"]),
    _make_peak_measure(
        "plantarflexor_moment", "Ankle plantarflexor moment", PEAKS["plantarflexion_moment"]
    ),
    _make_peak_measure("ankle_power", "Ankle power", PEAKS["ankle_power_2"]),
    _make_peak_measure("adduction_moment", "Knee adduction moment (external)", ADDUCTION_PEAK),
)


def _build_measure_columns(
    measure: CohortMeasure, read: Callable[[str], Array]
) -> list[dict[str, Any]]:
    """Build the columns of a measure for the page.

    `read`: name of a column of the table of people -> its numbers (people,), NaN if missing.
    Returns: of the person, or of each leg; without columns that have no number.
    """
    about = {"title": measure.title, "unit": measure.unit, "digits": measure.digits}
    per_leg = "{}" in measure.column
    if measure.joined:
        right, left = (read(measure.column.format(side)) for side in SIDES)
        if measure.joined == "asymmetry":
            # Symmetry index, percent.
            joined = 200.0 * (right - left) / (right + left)
            meaning = "200 % (right − left) / (right + left): positive if the right is longer"
        else:
            # The mean of both legs, or the only one.
            mean = np.where(np.isnan(left), right, (right + left) / 2)
            joined = np.where(np.isnan(right), left, mean)
            meaning = f"mean of both legs' {measure.column.replace('_{}', '')}"
        if not np.isfinite(joined).any():
            return []
        return [{"name": measure.name, **about, "meaning": meaning, "numbers": pack_floats(joined)}]
    out = []
    for side in SIDES if per_leg else ("",):
        column = measure.column.format(side)
        if not np.isfinite(read(column)).any():
            continue
        meaning = f"{column} with the other sign" if measure.sign < 0 else column
        if measure.error:
            meaning += ": mean of each stride's peak"
        error = measure.error.format(side)
        # Without a single known error the page offers no error bars.
        has_error = bool(error) and bool(np.isfinite(read(error)).any())
        leg = (
            {"name": f"{measure.name}_{side}", "measure": measure.name, "side": side}
            if side
            else {"name": measure.name}
        )
        source = {"of": column, "sign": measure.sign, "error": error if has_error else None}
        out.append({**leg, **about, "meaning": meaning, **source})
    return out


TITLES: Final = {
    "person": "Person", "session": "Session", "group": "Group", "verdict": "Verdict",
    "first_cause": "First cause",
}  # fmt: skip
"""The first columns, of text -> title."""
DEFAULTS: Final = {
    "columns": [
        *TITLES, "mass", "height", "marker_rms", "residual", "speed", "cadence", "step_asymmetry",
        *("knee_flexion_r", "knee_flexion_l", "hip_extension_r", "hip_extension_l",
            "plantarflexor_moment_r"),
        *("plantarflexor_moment_l", "ankle_power_r", "ankle_power_l", "adduction_moment_r",
            "adduction_moment_l"),
    ],
    "measures": ["speed", "step_asymmetry", "knee_flexion", "plantarflexor_moment"],
}  # fmt: skip
"""Default columns of the table, and measures of the distributions."""
PAGE: Final = "cohort.html"
NO_STRIDE: Final = (
    "info",
    "no stride of these walks is valid",
    "measures of gait are not available: the page of the person shows which strides turn or are "
    "incomplete; record walks along a straight line in which each foot strikes twice",
)
"""Severity, cause and action of a result without valid strides."""
_DIGITS: Final = 4


def write_page(
    path: Path,
    tables: Mapping[str, Path],
    people: Sequence[CohortPerson],
    ended: Outcomes,
    common: CommonSettings,
) -> None:
    """Write the page of a cohort.

    Parameters
    ----------
    path : Path
        The page.
    tables : mapping
        `people` (Parquet) and `failures` (CSV) -> file.
    people : sequence of CohortPerson
        In the order of the tables.
    ended : Outcomes
        Their outcomes.
    common : CommonSettings
        Settings of everyone.
    """
    causes = _Causes()
    # Curves come first: the causes are collected while they are written.
    data = {
        "CURVES": _pack_curves(people, ended, causes),
        "COHORT": _build_content(tables, people, common, causes),
    }
    write_cohort_page(path, data)


class _Causes:
    """The reasons of all verdicts, each once, with the people that have it."""

    def __init__(self) -> None:
        self._known: dict[tuple[str, str, str], int] = {}
        self._of_people: list[list[int]] = []

    def add(self, outcome: Outcome) -> None:
        """Add the reasons of one person."""
        keys = [(r["severity"], r["cause"], r["action"]) for r in outcome.reasons]
        if outcome.has_no_strides:
            keys.append(NO_STRIDE)
        numbers = [self._known.setdefault(key, len(self._known)) for key in keys]
        self._of_people.append(list(dict.fromkeys(numbers)))

    @property
    def content(self) -> dict[str, Any]:
        """The causes, and for each person the numbers of those that apply."""
        names = ("severity", "cause", "action")
        causes = [dict(zip(names, key, strict=True)) for key in self._known]
        return {"causes": causes, "of": self._of_people, "strideless": self._known.get(NO_STRIDE)}

    def rank(self, failures: Sequence[Mapping[str, str]]) -> list[dict[str, Any]]:
        """Rank all causes, with those of failures, by the number of people; with actions."""
        keys = list(self._known)
        found: dict[str, dict[str, Any]] = {}

        def merge(severity: str, cause: str, action: str) -> str:
            entry = found.setdefault(
                cause, {"severity": severity, "cause": cause, "actions": [], "count": 0}
            )
            if severity == "error":
                entry["severity"] = severity
            if action and action not in entry["actions"]:
                entry["actions"].append(action)
            return cause

        for numbers in self._of_people:
            # A cause counts once for each person, however many trials have it.
            for cause in {merge(*keys[k]) for k in numbers}:
                found[cause]["count"] += 1
        for line in failures:
            found[merge("failed", line["cause"], line["what_to_do"])]["count"] += 1
        return sorted(found.values(), key=lambda entry: (-entry["count"], entry["cause"]))


def _pack_curves(people: Sequence[CohortPerson], ended: Outcomes, causes: _Causes) -> Iterator[str]:
    """Yield the packed curves of everyone with a result, and collect the causes."""
    for person in people:
        outcome = ended.get_outcome(person)
        if outcome.failed:
            continue
        causes.add(outcome)
        yield outcome.curves or pack_no_curves()


def _build_content(
    tables: Mapping[str, Path],
    people: Sequence[CohortPerson],
    common: CommonSettings,
    causes: _Causes,
) -> Iterator[str]:
    """Yield the content of the page without curves, as JSON."""
    with pq.ParquetFile(tables["people"]) as table:

        def read(name: str) -> Array:
            return np.asarray(table.read(columns=[name]).column(0).to_numpy(), dtype=np.float64)

        about = {
            "people": len({person.name for person in people}),
            "sessions": len(people),
            "results": table.metadata.num_rows,
            "version": get_package_version("gaitcal"),
            "settings": json.loads(common.calibration.model_dump_json(exclude_unset=True)),
        }
        content = {
            "about": about,
            "usual": DEFAULTS,
            "every": EVERY,
            "columns": list(_build_columns(table, read)),
        }
        sizes = [
            read(name) if table.metadata.num_rows else np.array([])
            for name in ("mass_kg", "height_m")
        ]
        # Normal bands are scaled to the mean person; defaults (kg, m) if no person has a value.
        mass, height = (
            float(np.nanmean(values)) if np.isfinite(values).any() else default
            for values, default in zip(sizes, (70.0, 1.7), strict=True)
        )
    with tables["failures"].open(encoding="utf-8", newline="") as stream:
        failures = list(csv.DictReader(stream))
    content |= {"reasons": causes.content, "ranked": causes.rank(failures)}
    yield dump_script_json(
        content | {"curves": _describe_variables(common, mass, height), "failures": failures}
    )


def _build_columns(table: pq.ParquetFile, read: Callable[[str], Array]) -> Iterator[dict[str, Any]]:
    """Yield the columns of the page that have a value: first text, measures, all others."""
    columns = {column.name: column for column in COLUMNS}

    def build(name: str, title: str) -> Iterator[dict[str, Any]]:
        about = {
            "name": name,
            "title": title,
            "unit": columns[name].unit,
            "meaning": columns[name].meaning,
        }
        if columns[name].kind is str:
            cells = [str(value or "") for value in table.read(columns=[name]).column(0).to_numpy()]
            # Text columns have few values: each once, and its number for every row.
            numbered = {text: number for number, text in enumerate(dict.fromkeys(cells))}
            if any(cells):
                yield {**about, "words": list(numbered), "of": [numbered[text] for text in cells]}
            return
        numbers = read(name)
        if np.isfinite(numbers).any():
            yield {**about, "digits": _choose_digits(numbers), "numbers": pack_floats(numbers)}

    for name, title in TITLES.items():
        yield from build(name, title)
    for measure in MEASURES:
        yield from _build_measure_columns(measure, read)
    for name in columns:
        if name not in TITLES:
            yield from build(name, name)


def _choose_digits(numbers: Array) -> int:
    """Choose the digits after the point for about three significant ones; at most four."""
    sizes = np.abs(numbers[np.isfinite(numbers)])
    most = float(sizes.max())
    if most == 0.0 or (sizes == np.rint(sizes)).all():
        return 0
    return min(4, max(0, 2 - math.floor(math.log10(most))))


def _describe_variables(common: CommonSettings, mass: float, height: float) -> list[dict[str, Any]]:
    """Describe the packed curves, with normal bands per kg for a body of mean mass and height."""
    bands = {} if common.normal is None else normal_bands.read_normal_bands(common.normal)
    body = Subject(name="", mass=mass, height=height, sex="male")
    clinical, out = conventions.Convention(signs=conventions.Signs.CLINICAL), []
    for name in VARIABLES:
        kind, sign = (get_curve_kind(name), float(clinical.values(name, np.ones(1), "r", body)[0]))
        acting = "internal, " if kind is CurveKind.MOMENT else ""
        variable: dict[str, Any] = {
            "name": name,
            "joint": find_joint(get_coordinate(name)),
            "kind": kind.label,
            "title": clinical.title(name),
            "unit": get_unit(name) if kind is CurveKind.ANGLE else f"{get_unit(name)}/kg",
            "step": sign * STEPS[kind],
            "positive": f"{acting}{clinical.senses(name, 'r')[0]}",
        }
        if name in bands:
            # The page shows moments and powers per kg body mass.
            scale = 1.0 if kind is CurveKind.ANGLE else 1.0 / mass
            mean, sd = (scale * values[::EVERY] for values in bands[name].scale_to_person(body))
            variable["normal"] = {
                "mean": _round(sign * mean),
                "sd": _round(sd),
                "source": bands[name].source,
            }
        out.append(variable)
    return out


def _round(values: Any) -> list[float | None]:
    """Round values; None for those that are not finite."""
    return [round(float(value), _DIGITS) if np.isfinite(value) else None for value in values]
