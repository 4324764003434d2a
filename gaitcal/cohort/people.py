"""Who belongs to a cohort: every sub-folder with recordings is a person, or a session of one; what a lab says of them.

A sub-folder of the cohort that holds recordings, or a study file, is a person. One that holds none itself, but whose
own sub-folders all hold a complete set (a study file, or at least two recordings), is a person with these sessions.
`people.csv` beside them, as spreadsheets write it, tells what no file does.

`cohort.toml`, which names people one by one, and `people.csv` of a spreadsheet: read once, checked once.
"""

from __future__ import annotations

import csv
import hashlib
import io
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Literal

from pydantic import Field, field_validator

from gaitcal.codes import Code
from gaitcal.errors import InputError, alike, nearest
from gaitcal.io.csv import is_force_header, read_header
from gaitcal.io.lock import MANIFEST, PEOPLE, read_object
from gaitcal.io.toml import require_file
from gaitcal.io.validation import Table, read_validated, shown, validated
from gaitcal.session.draft import STUDY
from gaitcal.session.folder import MARKER_ENDINGS
from gaitcal.session.person_facts import NOTHING_SAID, Options
from gaitcal.study.joint_prior import require_joint_prior
from gaitcal.study.settings import CalibrationSettings

SHEET = "people.csv"
"""What a lab says of the people, beside their folders."""
COMPLETE = 2
"""Recordings of a session at least: standing and moving."""
MOST_PLACE = 80
"""Bytes, in UTF-8, of a folder's name made of a person's or session's; file systems count these."""
_UNSAFE = re.compile(r"[^\w.()+=@ -]")
_DEVICE = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.IGNORECASE)


@dataclass(frozen=True, kw_only=True)
class CohortPerson:
    """One session of one person."""

    folder: Path
    """Where the recordings or the study lie, absolute."""
    name: str
    session: str = ""
    """Empty where there is only one."""
    group: str = ""
    told: Options = NOTHING_SAID
    """What the user says of the person, for a folder without a study file."""

    @property
    def key(self) -> tuple[str, str]:
        """By which tables are sorted."""
        return self.name, self.session

    @property
    def place(self) -> str:
        """Folder of the result, as `people/P01/pre`, within that of the cohort."""
        return "/".join([PEOPLE, *(safe_name(part) for part in self.key if part)])

    @property
    def words(self) -> str:
        """Name and session, as messages show them."""
        return " ".join(filter(None, self.key))


@dataclass(frozen=True)
class Cohort:
    """People in the order of their names and sessions, and where they come from."""

    source: Path
    people: tuple[CohortPerson, ...]
    ignored: tuple[str, ...] = ()
    """Sub-folders without recordings."""
    notes: tuple[str, ...] = ()
    """What of the list of people is not used."""


def safe_name(text: str) -> str:
    """A name as a folder may be called: itself, or, where a file system would refuse it, one made of it."""
    plain = _UNSAFE.sub("_", text).strip(". ").encode()[:MOST_PLACE].decode(errors="ignore")
    if plain == text and not _DEVICE.fullmatch(text):
        return text
    return f"{plain or '_'}-{hashlib.sha256(text.encode()).hexdigest()[:6]}"


def people_in(folder: Path, out: Path) -> Cohort:
    """The people in a folder, by name.

    Parameters
    ----------
    out : where the results go: no person, wherever it lies.

    Raises
    ------
    InputError
        There are none, or the folder cannot be listed.
    """
    found: list[CohortPerson] = []
    ignored = []
    for below in _folders(folder, out):
        sessions = _sessions(below, out)
        if not sessions:
            ignored.append(below.name)
        for session in sessions:
            name = "" if session == below else session.name
            told = Options(name=below.name, session=name or None)
            found.append(CohortPerson(folder=session.resolve(), name=below.name, session=name, told=told))
    if not found:
        here = "recordings lie in the folder itself; " if _recordings(folder) else ""
        raise InputError(
            f"{here}no sub-folder holds recordings; each person needs a folder ('gaitcal calibrate' is for one person)",
            source=folder,
            code=Code.COHORT,
        )
    return Cohort(folder, in_order(found, folder), tuple(ignored))


def in_order(people: Iterable[CohortPerson], source: Path) -> tuple[CohortPerson, ...]:
    """By name and session; InputError where two results would be one folder, or lie within each other."""
    out = sorted(people, key=lambda person: person.key)
    places: dict[str, CohortPerson] = {}
    for person in out:
        other = places.setdefault(person.place.casefold(), person)
        if other is not person:
            if other.key == person.key:
                raise InputError(
                    f"found '{person.words}' twice, in '{other.folder.name}' and '{person.folder.name}'; allowed: once "
                    "for each session; name the sessions",
                    source=source,
                    code=Code.COHORT,
                )
            message = f"found '{person.words}' and '{other.words}', which one folder would hold; allowed: other names"
            raise InputError(message, source=source, code=Code.COHORT)
    several = {person.name for person in out if person.session}
    for person in out:
        if not person.session and person.name in several:
            message = f"found '{person.name}' with a session and without one; allowed: a session for each"
            raise InputError(message, source=source, code=Code.COHORT)
    return tuple(out)


def _folders(folder: Path, out: Path) -> list[Path]:
    try:
        entries = sorted(folder.iterdir())
    except OSError as error:
        raise InputError(f"cannot be listed: {error.strerror}", source=folder, code=Code.UNREADABLE) from None
    return [p for p in entries if p.is_dir() and p.name[0] not in ".~" and not _is_result(p, out)]


def _is_result(folder: Path, out: Path) -> bool:
    """Whether a folder is written by us; a synthetic study is one to be calibrated nevertheless."""
    if folder.resolve() == out.resolve():
        return True
    return (folder / MANIFEST).is_file() and "gaitcal" in read_object(folder / MANIFEST) and not _has_study(folder)


def _has_study(folder: Path) -> bool:
    made = read_object(folder / MANIFEST).get("gaitcal")
    return (folder / STUDY).is_file() and made in (None, "synthetic subject")


def _recordings(folder: Path) -> int:
    try:
        return sum(p.suffix.lower() in MARKER_ENDINGS or _is_recording(p) for p in folder.iterdir())
    except OSError:
        return 0


def _is_recording(path: Path) -> bool:
    """Whether a CSV table holds markers, by its header."""
    if path.suffix.lower() != ".csv" or path.name == SHEET:
        return False
    try:
        return not is_force_header(read_header(path))
    except InputError:
        return False


def _sessions(folder: Path, out: Path) -> Sequence[Path]:
    """The folders of a person's sessions: itself, where it is not made of complete ones; none without recordings."""
    if _has_study(folder) or _recordings(folder):
        return (folder,)
    below = [p for p in _folders(folder, out) if _has_study(p) or _recordings(p)]
    if below and all(_has_study(p) or _recordings(p) >= COMPLETE for p in below):
        return below
    return (folder,) if below else ()


@dataclass(frozen=True, kw_only=True)
class Told:
    """What a spreadsheet says of a person, or of one session."""

    person: str
    session: str = ""
    group: str = ""
    options: Options = NOTHING_SAID


def with_told(cohort: Cohort, rows: Sequence[Told], source: Path) -> Cohort:
    """The cohort with what a spreadsheet says. A row without a session is about all of a person's.

    A row of nobody who has a folder becomes a person without one, whose failure is told with those of the others.
    """
    people = {person.key: person for person in cohort.people}
    for row in sorted(rows, key=lambda row: row.session != ""):  # what is said of one session comes after
        mine = [p for p in people.values() if p.name == row.person and (not row.session or p.session == row.session)]
        if not mine:
            mine = [p for p in people.values() if p.name == row.person and not p.session]
        if not mine:
            _require_names(row, source)
            folder = cohort.source.resolve() / row.person / row.session
            mine = [CohortPerson(folder=folder, name=row.person, session=row.session)]
        for person in mine:
            people.pop(person.key, None)
            new = replace(
                person,
                session=row.session or person.session,
                group=row.group or person.group,
                told=joined(person.told, row.options),
            )
            people[new.key] = new
    return replace(cohort, people=in_order(people.values(), source))


def _require_names(row: Told, source: Path) -> None:
    """InputError where a folder of the table would lie elsewhere than in the cohort."""
    for field, name in (("person", row.person), ("session", row.session)):
        if name and (name == ".." or Path(name).parts != (name,)):
            message = f"found {shown(name)}; allowed: the name of a folder, without a path"
            raise InputError(message, source=source, field=field, code=Code.COHORT)


def joined(first: Options, second: Options) -> Options:
    """Options, the second before the first."""
    said = {name: value for name, value in vars(second).items() if value is not None}
    return replace(first, **said)


def is_folder(path: Path) -> bool:
    """Whether a folder is there; no is the answer where pathlib raises: over-long names."""
    return os.path.isdir(path)  # noqa: PTH112


def no_folder(person: CohortPerson) -> str:
    """That a person has no folder, and which one may be meant."""
    above = next(folder for folder in person.folder.parents if is_folder(folder))
    names = [p.name for p in above.iterdir() if p.is_dir()]
    return f"no folder '{person.folder.name}'{nearest(person.folder.name, names)}"


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
    sheet = path / SHEET
    if sheet.is_file():
        told = read_sheet(sheet)
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


def read_sheet(path: Path) -> Sheet:
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
