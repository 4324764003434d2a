"""`cohort.toml`, which names people one by one, and `people.csv` of a spreadsheet: read once, checked once."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, Literal

from pydantic import Field, field_validator

from gaitcal.codes import Code
from gaitcal.cohort.people import SHEET, Cohort, CohortPerson, Told, in_order, people_in, with_told
from gaitcal.errors import InputError
from gaitcal.files.toml import toml_table
from gaitcal.files.validation import Table, read_validated, shown, validated
from gaitcal.intake.person_facts import Options
from gaitcal.study.settings import CalibrationSettings

COHORT = "cohort.toml"
MOST_BYTES = 20_000_000
"""Of it, and of people.csv: some 50 000 people."""
_NUMBERS: Final = ("mass_kg", "height_m", "age_years")
_SEXES: Final = {"f": "female", "w": "female", "m": "male"}


class PersonTable(Table):
    """What is said of a person in either file."""

    name: str = Field(default="", max_length=200)
    session: str = Field(default="", max_length=200)
    group: str = Field(default="", max_length=200)
    sex: Literal["male", "female"] | None = None
    mass_kg: float | None = Field(default=None, ge=2, le=400)
    height_m: float | None = Field(default=None, ge=0.3, le=2.6)
    age_years: float | None = Field(default=None, ge=0, le=130)

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
    sheet = path / SHEET
    if sheet.is_file():
        cohort = with_told(cohort, read_sheet(sheet), sheet)
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
    return Cohort(file.parent, in_order(people, file)), content.calibration


def settings_text(settings: CalibrationSettings) -> str:
    """What is said for everyone, as the table of a study file; empty where nothing is."""
    said = settings.model_dump(exclude_unset=True)
    return toml_table("[calibration]", said) if said else ""


def read_sheet(path: Path) -> tuple[Told, ...]:
    """The rows of `people.csv`: person, session, group, sex, mass_kg, height_m, age_years; other columns are ignored.

    Commas, semicolons (with decimal commas) or tabs between columns.

    Raises
    ------
    InputError
        No column `person`, or a value that cannot be, with its row.
    """
    text = _text(path)
    head = text.split("\n", 1)[0]
    delimiter = max(",;\t", key=head.count)
    rows = csv.DictReader(io.StringIO(text, newline=""), delimiter=delimiter)
    names = [str(name).strip().lower() for name in rows.fieldnames or ()]
    if "person" not in names:
        message = f"found the columns {', '.join(names) or 'none'}; allowed: person, and any of session, group, sex, "
        raise InputError(f"{message}mass_kg, height_m, age_years", source=path, code=Code.COHORT)
    rows.fieldnames = names
    try:
        return tuple(
            _row(row, f"{path}: row {number}") for number, row in enumerate(rows, start=2) if any(row.values())
        )
    except csv.Error as error:
        raise InputError(f"cannot be read as a table: {error}", source=path, code=Code.COHORT) from None


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
    for name in ("session", "group", "sex", *_NUMBERS):
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
