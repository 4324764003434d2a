"""What `cohort.html` shows, from the tables of a cohort and from what is kept of every person.

Numbers come from `people.parquet` one column at a time, curves from the people one by one, so that little is held in
memory. There is no date in it: the same people give the same bytes.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow.parquet as pq

from gaitcal.cohort.one_person import CommonSettings
from gaitcal.cohort.outcome import Outcome, Outcomes
from gaitcal.cohort.people import CohortPerson
from gaitcal.cohort.row import COLUMNS, EVERY, STEPS, VARIABLES, Column, no_curves
from gaitcal.gait.cycles import Kind, coordinate_of, kind_of, unit_of
from gaitcal.gait.normal_bands import read_normal_bands
from gaitcal.io.toml import package_version
from gaitcal.model.coordinates import coordinate_words
from gaitcal.model.subject_model import Subject
from gaitcal.page.packing import floats
from gaitcal.page.sheet.rows import joint_of, sheet_rows
from gaitcal.page.view import write_cohort_page


@dataclass(frozen=True, kw_only=True)
class Measure:
    """One measure."""

    name: str
    title: str
    unit: str
    digits: int
    column: str
    """Of the table of people; `{}` stands for the leg, `r` or `l`, where it has one for each."""
    error: str = ""
    """Column of its standard error."""
    sign: int = 1
    """-1: it is the column's opposite."""
    joined: str = ""
    """How the legs' columns become one number: `mean`, or `asymmetry` = 200 % (r - l) / (r + l); empty: each has its
    own."""


def _peak(name: str, title: str, unit: str, variable: str, peak: str) -> Measure:
    column, error = f"{variable}_{peak}_{{}}", f"{variable}_{peak}_se_{{}}"
    digits, sign = (1 if unit == "deg" else 2), (-1 if peak == "min" else 1)
    title = f"{title}, peak of mean curve"
    return Measure(name=name, title=title, unit=unit, digits=digits, column=column, error=error, sign=sign)


MEASURES: Final = (
    Measure(name="mass", title="Mass", unit="kg", digits=1, column="mass_kg"),
    Measure(name="height", title="Height", unit="m", digits=2, column="height_m"),
    Measure(
        name="marker_rms", title="Marker RMS, pelvis and legs", unit="mm", digits=1, column="legs_rms_calibrated_mm"
    ),
    Measure(name="residual", title="Pelvis residual", unit="N", digits=1, column="residual_force_calibrated_N"),
    Measure(name="speed", title="Speed", unit="m/s", digits=2, column="speed_{}", joined="mean"),
    Measure(name="cadence", title="Cadence", unit="steps/min", digits=0, column="cadence_{}", joined="mean"),
    Measure(
        name="step_asymmetry",
        title="Step length asymmetry",
        unit="%",
        digits=1,
        column="step_length_{}",
        joined="asymmetry",
    ),
    _peak("knee_flexion", "Knee flexion", "deg", "knee_angle", "max"),
    _peak("hip_extension", "Hip extension", "deg", "hip_flexion", "min"),
    _peak("plantarflexion_moment", "Ankle plantarflexor moment", "N m/kg", "ankle_angle_moment", "min"),
    _peak("ankle_power", "Ankle power", "W/kg", "ankle_power", "max"),
    _peak("adduction_moment", "Knee adduction moment (external)", "N m/kg", "knee_adduction_moment", "min"),
)


def measures() -> list[dict[str, Any]]:
    """As plain data."""
    return [asdict(measure) for measure in MEASURES]


PAGE: Final = "cohort.html"
NO_STRIDE: Final = (
    "info",
    "no stride of these walks counts",
    "no numbers of gait are known: see in the person's page which strides turn or are cut off, and record walks along "
    "a straight line in which each foot comes down twice",
)
"""Severity, cause and action where the verdict has nothing to say of strides, and there is none."""
_DIGITS: Final = 4


def write_page(
    path: Path, tables: Mapping[str, Path], people: Sequence[CohortPerson], ended: Outcomes, common: CommonSettings
) -> None:
    """Write the page. `tables`: `people` (Parquet) and `failures`, as they are written."""
    causes = _Causes()
    data = {"CURVES": _curves(people, ended, causes), "COHORT": _content(tables, people, common, causes)}
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
        self._of.append(list(dict.fromkeys(self._known.setdefault(key, len(self._known)) for key in keys)))

    @property
    def content(self) -> dict[str, Any]:
        """As plain data."""
        names = ("severity", "cause", "action")
        causes = [dict(zip(names, key, strict=True)) for key in self._known]
        return {"causes": causes, "of": self._of, "strideless": self._known.get(NO_STRIDE)}


def _curves(people: Sequence[CohortPerson], ended: Outcomes, causes: _Causes) -> Iterator[str]:
    """Packed curves of everyone with a result, in the order of the table, whose causes are noted meanwhile."""
    for person in people:
        outcome = ended.of(person)
        if outcome.failed:
            continue
        causes.add(outcome)
        yield outcome.curves or no_curves()


def _content(
    tables: Mapping[str, Path], people: Sequence[CohortPerson], common: CommonSettings, causes: _Causes
) -> Iterator[str]:
    with pq.ParquetFile(tables["people"]) as table:
        about = {
            "people": len({person.name for person in people}),
            "sessions": len(people),
            "results": table.metadata.num_rows,
            "version": package_version("gaitcal"),
            "settings": json.loads(common.calibration.model_dump_json(exclude_unset=True)),
        }
        yield f'{{"about":{_text(about)},"measures":{_text(measures())},"every":{EVERY},"columns":['
        means = {}
        comma = ""
        for column in COLUMNS:
            values = table.read(columns=[column.name]).column(0)
            packed = _column(column, values.to_numpy())
            if column.name in ("mass_kg", "height_m") and values.null_count < len(values):
                means[column.name] = float(np.nanmean(values.to_numpy().astype(float)))
            if packed is not None:
                yield comma + _text(packed)
                comma = ","
    yield f'],"reasons":{_text(causes.content)},"curves":{_text(_variables(common, means))},"failures":['
    comma = ""
    with tables["failures"].open(encoding="utf-8", newline="") as stream:
        for line in csv.DictReader(stream):
            yield comma + _text(line)
            comma = ","
    yield "]}"


def _column(column: Column, values: Any) -> dict[str, Any] | None:
    """A column as the page takes it; None where nobody has a value."""
    about = {"name": column.name, "unit": column.unit, "meaning": column.meaning}
    if column.kind is str:
        words = [str(value or "") for value in values]
        if not any(words):
            return None
        known = {word: number for number, word in enumerate(dict.fromkeys(words))}
        return {**about, "words": list(known), "of": [known[word] for word in words]}
    numbers = np.asarray(values, dtype=np.float64)
    return {**about, "numbers": floats(numbers)} if np.isfinite(numbers).any() else None


def _variables(common: CommonSettings, means: Mapping[str, float]) -> list[dict[str, Any]]:
    """What the packed curves are of, with normal bands where there are some, per kg for a body of mean size."""
    bands = {} if common.normal is None else read_normal_bands(common.normal)
    mass, height = means.get("mass_kg", 70.0), means.get("height_m", 1.7)
    body = Subject(name="", mass=mass, height=height, sex="male")
    words = {row["base"]: row for joint in sheet_rows() for row in joint["rows"]}
    out = []
    for name in VARIABLES:
        base, kind = coordinate_of(name), kind_of(name)
        senses = ["generated", "absorbed"] if kind is Kind.POWER else words[base][kind.words]
        title = f"{base.capitalize()} power" if kind is Kind.POWER else coordinate_words(base).title
        variable: dict[str, Any] = {
            "name": name,
            "joint": joint_of(base),
            "kind": kind.words,
            "title": f"{title} moment" if kind is Kind.MOMENT else title,
            "unit": unit_of(name) if kind is Kind.ANGLE else f"{unit_of(name)}/kg",
            "step": STEPS[kind],
            "senses": senses,
        }
        if name in bands:
            scale = 1.0 if kind is Kind.ANGLE else 1.0 / mass
            mean, sd = (scale * values[::EVERY] for values in bands[name].for_person(body))
            variable["normal"] = {"mean": _rounded(mean), "sd": _rounded(sd), "source": bands[name].source}
        out.append(variable)
    return out


def _rounded(values: Any) -> list[float | None]:
    return [round(float(value), _DIGITS) if np.isfinite(value) else None for value in values]


def _text(content: object) -> str:
    """JSON that may stand in a page."""
    return json.dumps(content, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
