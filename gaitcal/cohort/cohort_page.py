"""What `cohort.html` shows, from the tables of a cohort and from what is kept of every person.

Curves come from the people one by one, so that little is held in memory. There is no date in it:
the same people give the same bytes.
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
    no_curves,
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
    # Of the table of people; `{}` stands for the leg, `r` or `l`, where it has one for each
    column: str
    error: str = ""  # Column of its standard error
    sign: int = 1  # -1: it is the column's opposite
    joined: str = ""
    """How the legs' columns become one number: `mean`, or `asymmetry` = 200 % (r - l) / (r + l);
    empty: each has its own."""


def _peak(name: str, title: str, peak: Peak) -> CohortMeasure:
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
    _peak("knee_flexion", "Knee flexion", PEAKS["knee_flexion_swing"]),
    _peak("hip_extension", "Hip extension", PEAKS["hip_extension_terminal_stance"]),
    _peak("plantarflexor_moment", "Ankle plantarflexor moment", PEAKS["plantarflexion_moment"]),
    _peak("ankle_power", "Ankle power", PEAKS["ankle_power_2"]),
    _peak("adduction_moment", "Knee adduction moment (external)", ADDUCTION_PEAK),
)


def measured(measure: CohortMeasure, read: Callable[[str], Array]) -> list[dict[str, Any]]:
    """The columns of a measure as the page takes them: of the person, or of each leg; none that
    nobody has.

    `read`: name of a column of the table of people -> its numbers (people,), NaN where there is
    none.
    """
    about = {"title": measure.title, "unit": measure.unit, "digits": measure.digits}
    per_leg = "{}" in measure.column
    if measure.joined:
        right, left = (read(measure.column.format(side)) for side in SIDES)
        if measure.joined == "asymmetry":
            joined = 200.0 * (right - left) / (right + left)
            words = "200 % (right − left) / (right + left): positive where the right is longer"
        else:
            joined = np.where(
                np.isnan(right), left, np.where(np.isnan(left), right, (right + left) / 2)
            )
            words = f"mean of both legs' {measure.column.replace('_{}', '')}"
        known = bool(np.isfinite(joined).any())
        return (
            [{"name": measure.name, **about, "meaning": words, "numbers": pack_floats(joined)}]
            if known
            else []
        )
    out = []
    for side in SIDES if per_leg else ("",):
        column = measure.column.format(side)
        if not np.isfinite(read(column)).any():
            continue
        words = f"{column} with the other sign" if measure.sign < 0 else column
        if measure.error:
            words += ": mean of each stride's peak"
        error = measure.error.format(side)
        known_error = bool(error) and bool(np.isfinite(read(error)).any())
        leg = (
            {"name": f"{measure.name}_{side}", "measure": measure.name, "side": side}
            if side
            else {"name": measure.name}
        )
        source = {"of": column, "sign": measure.sign, "error": error if known_error else None}
        out.append({**leg, **about, "meaning": words, **source})
    return out


TITLES: Final = {
    "person": "Person", "session": "Session", "group": "Group", "verdict": "Verdict", "first_cause": "First cause",
}  # fmt: skip
"""What columns of words are called that stand first."""
DEFAULTS: Final = {
    "columns": [
        *TITLES, "mass", "height", "marker_rms", "residual", "speed", "cadence", "step_asymmetry",
        *("knee_flexion_r", "knee_flexion_l", "hip_extension_r", "hip_extension_l", "plantarflexor_moment_r"),
        *("plantarflexor_moment_l", "ankle_power_r", "ankle_power_l", "adduction_moment_r", "adduction_moment_l"),
    ],
    "measures": ["speed", "step_asymmetry", "knee_flexion", "plantarflexor_moment"],
}  # fmt: skip
"""What table and distributions show unless something else is chosen."""
PAGE: Final = "cohort.html"
NO_STRIDE: Final = (
    "info",
    "no stride of these walks counts",
    "no numbers of gait are known: see in the person's page which strides turn or are cut off, and "
    "record walks along "
    "a straight line in which each foot comes down twice",
)
"""Severity, cause and action where the verdict has nothing to say of strides, and there is none."""
_DIGITS: Final = 4


def write_page(
    path: Path,
    tables: Mapping[str, Path],
    people: Sequence[CohortPerson],
    ended: Outcomes,
    common: CommonSettings,
) -> None:
    """Write the page. `tables`: `people` (Parquet) and `failures`, as they are written."""
    causes = _Causes()
    data = {
        "CURVES": _curves(people, ended, causes),
        "COHORT": _content(tables, people, common, causes),
    }
    write_cohort_page(path, data)


class _Causes:
    """The reasons of everybody's verdict, and that no stride counts: each once, and who has which."""

    def __init__(self) -> None:
        self._known: dict[tuple[str, str, str], int] = {}
        self._of: list[list[int]] = []

    def add(self, outcome: Outcome) -> None:
        """Note those of one person."""
        keys = [(r["severity"], r["cause"], r["action"]) for r in outcome.reasons]
        if outcome.strideless:
            keys.append(NO_STRIDE)
        self._of.append(
            list(dict.fromkeys(self._known.setdefault(key, len(self._known)) for key in keys))
        )

    @property
    def content(self) -> dict[str, Any]:
        """As plain data."""
        names = ("severity", "cause", "action")
        causes = [dict(zip(names, key, strict=True)) for key in self._known]
        return {"causes": causes, "of": self._of, "strideless": self._known.get(NO_STRIDE)}

    def ranked(self, failures: Sequence[Mapping[str, str]]) -> list[dict[str, Any]]:
        """Each cause once, those of `failures` too, with what to do and how many people; that of
        most first.
        """
        keys = list(self._known)
        found: dict[str, dict[str, Any]] = {}

        def noted(severity: str, cause: str, action: str) -> str:
            entry = found.setdefault(
                cause, {"severity": severity, "cause": cause, "actions": [], "count": 0}
            )
            if severity == "error":
                entry["severity"] = severity
            if action and action not in entry["actions"]:
                entry["actions"].append(action)
            return cause

        for own in self._of:
            for cause in {noted(*keys[k]) for k in own}:
                found[cause]["count"] += 1
        for line in failures:
            found[noted("failed", line["cause"], line["what_to_do"])]["count"] += 1
        return sorted(found.values(), key=lambda entry: (-entry["count"], entry["cause"]))


def _curves(people: Sequence[CohortPerson], ended: Outcomes, causes: _Causes) -> Iterator[str]:
    """Packed curves of everyone with a result, in the order of the table, whose causes are noted
    meanwhile.
    """
    for person in people:
        outcome = ended.of(person)
        if outcome.failed:
            continue
        causes.add(outcome)
        yield outcome.curves or no_curves()


def _content(
    tables: Mapping[str, Path],
    people: Sequence[CohortPerson],
    common: CommonSettings,
    causes: _Causes,
) -> Iterator[str]:
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
            "columns": list(_columns(table, read)),
        }
        sizes = [
            read(name) if table.metadata.num_rows else np.array([])
            for name in ("mass_kg", "height_m")
        ]
        mass, height = (
            float(np.nanmean(values)) if np.isfinite(values).any() else default
            for values, default in zip(sizes, (70.0, 1.7), strict=True)
        )
    with tables["failures"].open(encoding="utf-8", newline="") as stream:
        failures = list(csv.DictReader(stream))
    content |= {"reasons": causes.content, "ranked": causes.ranked(failures)}
    yield dump_script_json(
        content | {"curves": _variables(common, mass, height), "failures": failures}
    )


def _columns(table: pq.ParquetFile, read: Callable[[str], Array]) -> Iterator[dict[str, Any]]:
    """The columns of the page that somebody has a value in: words that stand first, measures, and
    every other one.
    """
    columns = {column.name: column for column in COLUMNS}

    def known(name: str, title: str) -> Iterator[dict[str, Any]]:
        about = {
            "name": name,
            "title": title,
            "unit": columns[name].unit,
            "meaning": columns[name].meaning,
        }
        if columns[name].kind is str:
            words = [str(value or "") for value in table.read(columns=[name]).column(0).to_numpy()]
            numbered = {word: number for number, word in enumerate(dict.fromkeys(words))}
            if any(words):
                yield {**about, "words": list(numbered), "of": [numbered[word] for word in words]}
            return
        numbers = read(name)
        if np.isfinite(numbers).any():
            yield {**about, "digits": _digits_of(numbers), "numbers": pack_floats(numbers)}

    for name, title in TITLES.items():
        yield from known(name, title)
    for measure in MEASURES:
        yield from measured(measure, read)
    for name in columns:
        if name not in TITLES:
            yield from known(name, name)


def _digits_of(numbers: Array) -> int:
    """As many digits as tell people apart: about three that count."""
    there = np.abs(numbers[np.isfinite(numbers)])
    most = float(there.max())
    if most == 0.0 or (there == np.rint(there)).all():
        return 0
    return min(4, max(0, 2 - math.floor(math.log10(most))))


def _variables(common: CommonSettings, mass: float, height: float) -> list[dict[str, Any]]:
    """What the packed curves are of, with normal bands where there are some, per kg for a body of
    mean size.
    """
    bands = {} if common.normal is None else normal_bands.read_normal_bands(common.normal)
    body = Subject(name="", mass=mass, height=height, sex="male")
    clinical, out = conventions.Convention(signs=conventions.Signs.CLINICAL), []
    for name in VARIABLES:
        kind, sign = (
            get_curve_kind(name),
            float(clinical.convert_values(name, np.ones(1), "r", body)[0]),
        )
        whose = "internal, " if kind is CurveKind.MOMENT else ""
        variable: dict[str, Any] = {
            "name": name,
            "joint": find_joint(get_coordinate(name)),
            "kind": kind.label,
            "title": clinical.make_title(name),
            "unit": get_unit(name) if kind is CurveKind.ANGLE else f"{get_unit(name)}/kg",
            "step": sign * STEPS[kind],
            "positive": f"{whose}{clinical.describe_senses(name, 'r')[0]}",
        }
        if name in bands:
            scale = 1.0 if kind is CurveKind.ANGLE else 1.0 / mass
            mean, sd = (scale * values[::EVERY] for values in bands[name].scale_to_person(body))
            variable["normal"] = {
                "mean": _rounded(sign * mean),
                "sd": _rounded(sd),
                "source": bands[name].source,
            }
        out.append(variable)
    return out


def _rounded(values: Any) -> list[float | None]:
    return [round(float(value), _DIGITS) if np.isfinite(value) else None for value in values]
