"""`cohort.toml`, which names people one by one, and `people.csv` of a spreadsheet: read once, checked once."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Literal

from pydantic import Field, field_validator

from gaitcal.codes import Code
from gaitcal.cohort.people import PAGE_DATA, Cohort, CohortPerson, Told, in_order, people_in, with_told
from gaitcal.errors import InputError, alike
from gaitcal.io.toml import require_file
from gaitcal.io.validation import Table, read_validated, shown, validated
from gaitcal.session.person_facts import Options
from gaitcal.study.joint_prior import require_joint_prior
from gaitcal.study.settings import CalibrationSettings

COHORT = "cohort.toml"
MOST_BYTES = 20_000_000
"""Of it, and of people.csv: some 50 000 people."""
_NUMBERS: Final = ("mass_kg", "height_m", "age_years")
_COLUMNS: Final = ("person", "session", "group", "sex", *_NUMBERS)
_FIELDS: Final = {"mass": "mass_kg", "height": "height_m", "age": "age_years"}
_OTHER_WORDS: Final = {
    **_FIELDS,
    **dict.fromkeys(("weight", "weight_kg", "weight (kg)", "weight [kg]", "body mass", "body_mass"), "mass_kg"),
    "gender": "sex",
}
"""What people call a column -> the column."""
_SEXES: Final = {"f": "female", "w": "female", "m": "male"}


class PersonTable(Table):
    """What is said of a person in either file."""

    name: str = Field(default="", max_length=200, description="the person; else the name of the folder")
    session: str = Field(default="", max_length=200, description="a date or label; needed where a person has several")
    group: str = Field(default="", max_length=200, description="any word; stands in the tables")
    sex: Literal["male", "female"] | None = Field(default=None, description="where no file says it")
    mass_kg: float | None = Field(default=None, ge=2, le=400, description="body mass in kg, where no file says it")
    height_m: float | None = Field(default=None, ge=0.3, le=2.6, description="body height in m, where no file says it")
    age_years: float | None = Field(default=None, ge=0, le=130, description="age in years, where no file says it")

    @field_validator("name", "session", "group")
    @classmethod
    def _printable(cls, text: str) -> str:
        if not text.isprintable():
            raise ValueError(f"found {shown(text)}; allowed: printable characters")
        return text.strip()

    @property
    def options(self) -> Options:
        """As the draft of a folder takes it."""
        return Options(
            mass=self.mass_kg,
            height=self.height_m,
            sex=self.sex,
            age=self.age_years,
            name=self.name or None,
            session=self.session or None,
        )


class ListedPerson(PersonTable):
    """`[[person]]`: a folder, and what is said of the person."""

    folder: str = Field(min_length=1, description="the person's recordings, from the folder of cohort.toml")


class CohortFile(Table):
    """`cohort.toml`."""

    people: tuple[ListedPerson, ...] = Field(
        alias="person", strict=False, min_length=1, description="at least one [[person]], with folder"
    )
    calibration: CalibrationSettings = Field(
        default=CalibrationSettings(), description="for everyone whose own study file does not say otherwise"
    )


def read_cohort(path: Path, out: Path) -> tuple[Cohort, CalibrationSettings]:
    """The people of a folder, or of a `cohort.toml`, and settings for all of them.

    Raises
    ------
    InputError
        It is neither, or what it says cannot be; nobody is in it.
    """
    file = path / COHORT if path.is_dir() and (path / COHORT).is_file() else path
    if not file.is_dir():
        return _listed(file)
    cohort = people_in(path, out)
    sheet = path / PAGE_DATA
    if sheet.is_file():
        told = read_page_data(sheet)
        cohort = replace(with_told(cohort, told.rows, sheet), notes=told.notes)
    return cohort, CalibrationSettings()


def _listed(file: Path) -> tuple[Cohort, CalibrationSettings]:
    content = read_validated(CohortFile, file, most_bytes=MOST_BYTES)
    people = []
    for table in content.people:
        folder = (file.parent / table.folder).resolve()
        name = table.name or folder.name
        person = CohortPerson(
            folder=folder, name=name, session=table.session, group=table.group, told=replace(table.options, name=name)
        )
        people.append(person)
    folder = file.parent.absolute()
    require_joint_prior(content.calibration, file)
    settings = content.calibration.found(
        lambda named: require_file(folder / named, source=file, field="calibration.priors"), file
    )
    return Cohort(file.parent, in_order(people, file)), settings


@dataclass(frozen=True)
class Sheet:
    """What `people.csv` says."""

    rows: tuple[Told, ...]
    notes: tuple[str, ...] = ()
    """Columns that are not used."""


def read_page_data(path: Path) -> Sheet:
    """Read `people.csv`: person, session, group, sex, mass_kg, height_m, age_years; other columns are told.

    Commas, semicolons (with decimal commas) or tabs between columns.

    Raises
    ------
    InputError
        No column `person`, a column twice or with a name like one of these, two rows that contradict each other, or a
        value that cannot be, with its row.
    """
    text = _text(path)
    head = text.split("\n", 1)[0]
    delimiter = max(",;\t", key=head.count)
    lines = csv.DictReader(io.StringIO(text, newline=""), delimiter=delimiter)
    names = [str(name).strip().lower() for name in lines.fieldnames or ()]
    notes = tuple(_not_used(names, path))
    lines.fieldnames = names
    said: dict[tuple[str, str], dict[str, tuple[object, int]]] = {}
    rows = []
    try:
        for number, line in enumerate(lines, start=2):
            if any(line.values()):
                source = f"{path}: row {number}"
                rows.append(_row(line, source))
                _require_agreement(rows[-1], number, said, source)
    except csv.Error as error:
        raise InputError(f"cannot be read as a table: {error}", source=path, code=Code.COHORT) from None
    return Sheet(tuple(rows), notes)


def _not_used(names: Sequence[str], path: Path) -> Iterator[str]:
    """A note on every column that is not known; InputError where it may be one that is, or one is there twice."""
    if "person" not in names:
        message = f"found the columns {', '.join(filter(None, names)) or 'none'}; allowed: person, and any of "
        raise InputError(message + ", ".join(_COLUMNS[1:]), source=path, code=Code.COHORT)
    for name in dict.fromkeys(filter(None, names)):
        if names.count(name) > 1:
            raise InputError(
                f"found {names.count(name)} columns {shown(name)}; allowed: one", source=path, code=Code.COHORT
            )
        if name in _COLUMNS:
            continue
        meant = _OTHER_WORDS.get(name) or next(iter(alike(name, _COLUMNS)), None)
        if meant is not None and meant not in names:
            raise InputError(
                f"found the column {shown(name)}, which is not known; did you mean '{meant}'? A column of something "
                "else needs a name that is less like it",
                source=path,
                code=Code.COHORT,
            )
        yield f"{path.name}: column {shown(name)} is not used"


def _require_agreement(
    row: Told, number: int, said: dict[tuple[str, str], dict[str, tuple[object, int]]], source: str
) -> None:
    """InputError where an earlier row says something else of the same session; `said`: what earlier rows say."""
    before = said.setdefault((row.person, row.session), {})
    for name, value in {"group": row.group or None, **vars(row.options)}.items():
        if value is None:
            continue
        other, at = before.setdefault(name, (value, number))
        if other != value:
            raise InputError(
                f"found {_written(value)}, but row {at} says {_written(other)} of the same person and session; "
                "allowed: one of them",
                source=source,
                field=_FIELDS.get(name, name),
                code=Code.COHORT,
            )


def _written(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else shown(value)


def _text(path: Path) -> str:
    try:
        with path.open("rb") as stream:
            raw = stream.read(MOST_BYTES + 1)
        if len(raw) > MOST_BYTES:
            raise InputError(
                f"over {MOST_BYTES // 1_000_000} MB: no table of people is that long", source=path, code=Code.COHORT
            )
        return raw.decode("utf-8-sig")
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", source=path, code=Code.UNREADABLE) from None
    except UnicodeDecodeError:
        raise InputError("is not UTF-8 text; save it as CSV UTF-8", source=path, code=Code.NOT_TEXT) from None


def _row(row: Mapping[str | Any, object], source: str) -> Told:
    said: dict[str, object] = {}
    beyond = row.get(None)  # where a DictReader puts them
    if isinstance(beyond, list) and any(beyond):
        message = "found more cells than columns; a decimal comma needs semicolons between columns"
        raise InputError(message, source=source, code=Code.COHORT)
    for name in _COLUMNS[1:]:
        text = str(row.get(name) or "").strip()
        if not text:
            continue
        if name in _NUMBERS:
            said[name] = _number(text, name, source)
        else:
            said[name] = _SEXES.get(text.lower(), text.lower()) if name == "sex" else text
    person = str(row.get("person") or "").strip()
    table = validated(PersonTable, {**said, "name": person}, source)
    if not person:
        raise InputError(
            "found nothing; allowed: the name of a folder", source=source, field="person", code=Code.COHORT
        )
    return Told(person=person, session=table.session, group=table.group, options=table.options)


def _number(text: str, name: str, source: str) -> float:
    try:
        return float(text.replace(",", "."))
    except ValueError:
        raise InputError(
            f"found {shown(text)}; allowed: a number", source=source, field=name, code=Code.BAD_NUMBER
        ) from None
