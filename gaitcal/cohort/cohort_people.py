"""Who belongs to a cohort, and what a lab says of them: sub-folders, `people.csv` beside them, or a
`cohort.toml`.

A sub-folder of the cohort that holds recordings, or a study file, is a person. One that holds none
itself, but whose own sub-folders all hold a complete set (a study file, or at least two
recordings), is a person with these sessions. `people.csv`, as spreadsheets write it, says what no
file does; `cohort.toml` names people one by one.
"""

import csv
import hashlib
import io
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Literal

from pydantic import Field, field_validator

from gaitcal.errors import Code, InputError, alike, nearest
from gaitcal.intake.draft_file import STUDY
from gaitcal.intake.recordings_folder import MARKER_ENDINGS
from gaitcal.intake.subject_metadata import NO_OPTIONS, Options
from gaitcal.io import result_folder, snapshot
from gaitcal.io.csv_recordings import is_force_header, read_header
from gaitcal.io.toml import Table, format_value, read_validated, require_file, validate_table
from gaitcal.study.cohort_prior import require_joint_prior
from gaitcal.study.settings import CalibrationSettings

SHEET = "people.csv"  # What a lab says of the people, beside their folders
COHORT = "cohort.toml"
COMPLETE = 2  # Recordings of a session at least: standing and moving
# Bytes, in UTF-8, of a folder's name made of a person's or session's; file systems count these
MOST_PLACE = 80
MOST_BYTES = 20_000_000  # Of cohort.toml and of people.csv: some 50 000 people
_UNSAFE = re.compile(r"[^\w.()+=@ -]")
_DEVICE = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.IGNORECASE)
_NUMBERS: Final = ("mass_kg", "height_m", "age_years")
_COLUMNS: Final = ("person", "session", "group", "sex", *_NUMBERS)
_FIELDS: Final = {"mass": "mass_kg", "height": "height_m", "age": "age_years"}
_OTHER_WORDS: Final = {
    **_FIELDS,
    **dict.fromkeys(
        ("weight", "weight_kg", "weight (kg)", "weight [kg]", "body mass", "body_mass"), "mass_kg"
    ),
    "gender": "sex",
}
"""What people call a column -> the column."""
_SEXES: Final = {"f": "female", "w": "female", "m": "male"}


@dataclass(frozen=True, kw_only=True)
class CohortPerson:
    """One session of one person."""

    folder: Path  # Where the recordings or the study lie, absolute
    name: str
    session: str = ""  # Empty where there is only one
    group: str = ""
    told: Options = (
        NO_OPTIONS  # What the user says of the person, for a folder without a study file
    )

    @property
    def key(self) -> tuple[str, str]:
        """By which tables are sorted."""
        return self.name, self.session

    @property
    def place(self) -> str:
        """Folder of the result, as `people/P01/pre`, within that of the cohort."""
        return "/".join([snapshot.PEOPLE_FOLDER, *(safe_name(part) for part in self.key if part)])

    @property
    def words(self) -> str:
        """Name and session, as messages show them."""
        return " ".join(filter(None, self.key))


@dataclass(frozen=True)
class Cohort:
    """People in the order of their names and sessions, and where they come from."""

    source: Path
    people: tuple[CohortPerson, ...]
    ignored: tuple[str, ...] = ()  # Sub-folders without recordings
    notes: tuple[str, ...] = ()  # What of the list of people is not used


class PersonTable(Table):
    """What is said of a person, or of one session, in either file."""

    name: str = Field(
        default="", max_length=200, description="the person; else the name of the folder"
    )
    session: str = Field(
        default="", max_length=200, description="a date or label; needed where a person has several"
    )
    group: str = Field(default="", max_length=200, description="any word; stands in the tables")
    sex: Literal["male", "female"] | None = Field(default=None, description="where no file says it")
    mass_kg: float | None = Field(
        default=None, ge=2, le=400, description="body mass in kg, where no file says it"
    )
    height_m: float | None = Field(
        default=None, ge=0.3, le=2.6, description="body height in m, where no file says it"
    )
    age_years: float | None = Field(
        default=None, ge=0, le=130, description="age in years, where no file says it"
    )

    @field_validator("name", "session", "group")
    @classmethod
    def _printable(cls, text: str) -> str:
        if not text.isprintable():
            raise ValueError(f"found {format_value(text)}; allowed: printable characters")
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

    folder: str = Field(
        min_length=1, description="the person's recordings, from the folder of cohort.toml"
    )


class CohortFile(Table):
    """`cohort.toml`."""

    people: tuple[ListedPerson, ...] = Field(
        alias="person",
        strict=False,
        min_length=1,
        description="at least one [[person]], with folder",
    )
    calibration: CalibrationSettings = Field(
        default=CalibrationSettings(),
        description="for everyone whose own study file does not say otherwise",
    )


def safe_name(text: str) -> str:
    """A name as a folder may be called: itself, or, where a file system would refuse it, one made
    of it.
    """
    plain = _UNSAFE.sub("_", text).strip(". ").encode()[:MOST_PLACE].decode(errors="ignore")
    if plain == text and not _DEVICE.fullmatch(text):
        return text
    return f"{plain or '_'}-{hashlib.sha256(text.encode()).hexdigest()[:6]}"


def joined(first: Options, second: Options) -> Options:
    """Options, the second before the first."""
    return replace(
        first, **{name: value for name, value in vars(second).items() if value is not None}
    )


def is_folder(path: Path) -> bool:
    """Whether a folder is there; no is the answer where pathlib raises: over-long names."""
    return os.path.isdir(path)  # noqa: PTH112


def read_cohort(path: Path, out: Path) -> tuple[Cohort, CalibrationSettings]:
    """The people of a folder, or of a `cohort.toml`, and settings for all of them.

    Raises InputError: It is neither, or what it says cannot be; nobody is in it.
    """
    file = path / COHORT if path.is_dir() and (path / COHORT).is_file() else path
    if file.is_dir():
        cohort, sheet = people_in(path, out), path / SHEET
        if sheet.is_file():
            rows, notes = read_sheet(sheet)
            cohort = replace(_with_rows(cohort, rows, sheet), notes=tuple(notes))
        return cohort, CalibrationSettings()
    content, folder = (
        read_validated(CohortFile, file, most_bytes=MOST_BYTES),
        file.parent.absolute(),
    )
    people = []
    for table in content.people:
        place = (file.parent / table.folder).resolve()
        name = table.name or place.name
        told = replace(table.options, name=name)
        people.append(
            CohortPerson(
                folder=place, name=name, session=table.session, group=table.group, told=told
            )
        )
    require_joint_prior(content.calibration, file)
    settings = content.calibration.resolve_paths(
        lambda named: require_file(folder / named, source=file, field="calibration.priors"), file
    )
    return Cohort(file.parent, _in_order(people, file)), settings


def people_in(folder: Path, out: Path) -> Cohort:
    """The people in a folder, by name.

    `out`: where the results go: no person, wherever it lies.

    Raises InputError: There are none, or the folder cannot be listed.
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
            found.append(
                CohortPerson(folder=session.resolve(), name=below.name, session=name, told=told)
            )
    if not found:
        here = "recordings lie in the folder itself; " if _recordings(folder) else ""
        raise InputError(
            f"{here}no sub-folder holds recordings; each person needs a folder ('gaitcal "
            "calibrate' is for one person)",
            source=folder,
            code=Code.COHORT,
        )
    return Cohort(folder, _in_order(found, folder), tuple(ignored))


def _in_order(people: Iterable[CohortPerson], source: Path) -> tuple[CohortPerson, ...]:
    """By name and session; InputError where two results would be one folder, or lie within each
    other.
    """
    out = sorted(people, key=lambda person: person.key)
    several = {person.name for person in out if person.session}
    places: dict[str, CohortPerson] = {}
    message = ""
    for person in out:
        other = places.setdefault(person.place.casefold(), person)
        if other is not person:
            message = (
                f"found '{person.words}' and '{other.words}', which one folder would hold; "
                "allowed: other names"
            )
            if other.key == person.key:
                message = (
                    f"found '{person.words}' twice, in '{other.folder.name}' and "
                    f"'{person.folder.name}'; allowed: once "
                    "for each session; name the sessions"
                )
            break
    else:
        for person in out:
            if not person.session and person.name in several:
                message = (
                    f"found '{person.name}' with a session and without one; allowed: a session for "
                    "each"
                )
                break
    if message:
        raise InputError(message, source=source, code=Code.COHORT)
    return tuple(out)


def _folders(folder: Path, out: Path) -> list[Path]:
    """Sub-folders that are not hidden and not results of ours; a synthetic study is one to be
    calibrated.
    """
    try:
        entries = sorted(folder.iterdir())
    except OSError as error:
        raise InputError(
            f"cannot be listed: {error.strerror}", source=folder, code=Code.UNREADABLE
        ) from None
    return [
        path
        for path in entries
        if path.is_dir()
        and path.name[0] not in ".~"
        and path.resolve() != out.resolve()
        and (
            "gaitcal" not in result_folder.read_json_object(path / result_folder.MANIFEST)
            or _has_study(path)
        )
    ]


def _has_study(folder: Path) -> bool:
    made = result_folder.read_json_object(folder / result_folder.MANIFEST).get("gaitcal")
    return (folder / STUDY).is_file() and made in (None, "synthetic subject")


def _recordings(folder: Path) -> int:
    try:
        return sum(
            path.suffix.lower() in MARKER_ENDINGS or _is_recording(path)
            for path in folder.iterdir()
        )
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
    """The folders of a person's sessions: itself, where it is not made of complete ones; none
    without recordings.
    """
    if _has_study(folder) or _recordings(folder):
        return (folder,)
    below = [p for p in _folders(folder, out) if _has_study(p) or _recordings(p)]
    if below and all(_has_study(p) or _recordings(p) >= COMPLETE for p in below):
        return below
    return (folder,) if below else ()


def _with_rows(cohort: Cohort, rows: Sequence[PersonTable], source: Path) -> Cohort:
    """The cohort with what a spreadsheet says. A row without a session is about all of a person's.

    A row of nobody who has a folder becomes a person without one, whose failure is told with those
    of the others.
    """
    people = {person.key: person for person in cohort.people}
    for row in sorted(
        rows, key=lambda row: row.session != ""
    ):  # what is said of one session comes after
        of_person = [p for p in people.values() if p.name == row.name]
        mine = [p for p in of_person if not row.session or p.session == row.session]
        mine = mine or [p for p in of_person if not p.session]
        if not mine:
            for field, name in (("person", row.name), ("session", row.session)):
                if name and (
                    name == ".." or Path(name).parts != (name,)
                ):  # it would lie elsewhere than in the cohort
                    message = (
                        f"found {format_value(name)}; allowed: the name of a folder, without a path"
                    )
                    raise InputError(message, source=source, field=field, code=Code.COHORT)
            folder = cohort.source.resolve() / row.name / row.session
            mine = [CohortPerson(folder=folder, name=row.name, session=row.session)]
        for person in mine:
            people.pop(person.key, None)
            session, group = row.session or person.session, row.group or person.group
            new = replace(
                person, session=session, group=group, told=joined(person.told, row.options)
            )
            people[new.key] = new
    return replace(cohort, people=_in_order(people.values(), source))


def read_sheet(path: Path) -> tuple[list[PersonTable], list[str]]:
    """Read `people.csv`: person, session, group, sex, mass_kg, height_m, age_years; and notes on
    other columns.

    Commas, semicolons (with decimal commas) or tabs between columns.

    Raises InputError: No column `person`, a column twice or with a name like one of these, two rows
    that contradict each other, or a value that cannot be, with its row.
    """
    text = _text(path)
    head = text.split("\n", 1)[0]
    lines = csv.DictReader(io.StringIO(text, newline=""), delimiter=max(",;\t", key=head.count))
    names = [str(name).strip().lower() for name in lines.fieldnames or ()]
    notes = list(_not_used(names, path))
    lines.fieldnames = names
    said: dict[tuple[str, str, str], tuple[object, int]] = {}
    rows = []
    try:
        for number, line in enumerate(lines, start=2):
            if any(line.values()):
                source = f"{path}: row {number}"
                row = _row(line, source)
                for name, value in {"group": row.group or None, **vars(row.options)}.items():
                    if value is None:
                        continue
                    other, at = said.setdefault((row.name, row.session, name), (value, number))
                    if other != value:
                        found, before = (
                            f"{v:g}" if isinstance(v, float) else format_value(v)
                            for v in (value, other)
                        )
                        raise InputError(
                            f"found {found}, but row {at} says {before} of the same person and "
                            "session; allowed: one "
                            "of them",
                            source=source,
                            field=_FIELDS.get(name, name),
                            code=Code.COHORT,
                        )
                rows.append(row)
    except csv.Error as error:
        raise InputError(
            f"cannot be read as a table: {error}", source=path, code=Code.COHORT
        ) from None
    return rows, notes


def _not_used(names: Sequence[str], path: Path) -> Iterator[str]:
    """A note on every column that is not known; InputError where it may be one that is, or one is
    there twice.
    """
    if "person" not in names:
        message = (
            f"found the columns {', '.join(filter(None, names)) or 'none'}; allowed: person, and "
            "any of "
        )
        raise InputError(message + ", ".join(_COLUMNS[1:]), source=path, code=Code.COHORT)
    for name in dict.fromkeys(filter(None, names)):
        if names.count(name) > 1:
            message = f"found {names.count(name)} columns {format_value(name)}; allowed: one"
            raise InputError(message, source=path, code=Code.COHORT)
        if name in _COLUMNS:
            continue
        meant = _OTHER_WORDS.get(name) or next(iter(alike(name, _COLUMNS)), None)
        if meant is not None and meant not in names:
            raise InputError(
                f"found the column {format_value(name)}, which is not known; did you mean '{meant}'? A "
                "column of something "
                "else needs a name that is less like it",
                source=path,
                code=Code.COHORT,
            )
        yield f"{path.name}: column {format_value(name)} is not used"


def _text(path: Path) -> str:
    try:
        with path.open("rb") as stream:
            raw = stream.read(MOST_BYTES + 1)
        if len(raw) > MOST_BYTES:
            message = f"over {MOST_BYTES // 1_000_000} MB: no table of people is that long"
            raise InputError(message, source=path, code=Code.COHORT)
        return raw.decode("utf-8-sig")
    except OSError as error:
        raise InputError(
            f"cannot be read: {error.strerror}", source=path, code=Code.UNREADABLE
        ) from None
    except UnicodeDecodeError:
        raise InputError(
            "is not UTF-8 text; save it as CSV UTF-8", source=path, code=Code.NOT_TEXT
        ) from None


def _row(cells: Mapping[str | None, object], source: str) -> PersonTable:
    beyond = cells.get(None)  # where a DictReader puts them
    if isinstance(beyond, list) and any(beyond):
        message = "found more cells than columns; a decimal comma needs semicolons between columns"
        raise InputError(message, source=source, code=Code.COHORT)
    text = {name: str(cells.get(name) or "").strip() for name in _COLUMNS}
    said: dict[str, object] = {name: text[name] for name in _COLUMNS[1:] if text[name]}
    for name in _NUMBERS:
        if text[name]:
            try:
                said[name] = float(text[name].replace(",", "."))
            except ValueError:
                message = f"found {format_value(text[name])}; allowed: a number"
                raise InputError(message, source=source, field=name, code=Code.BAD_NUMBER) from None
    if text["sex"]:
        said["sex"] = _SEXES.get(text["sex"].lower(), text["sex"].lower())
    table = validate_table(PersonTable, {**said, "name": text["person"]}, source)
    if not table.name:
        message = "found nothing; allowed: the name of a folder"
        raise InputError(message, source=source, field="person", code=Code.COHORT)
    return table


def no_folder(person: CohortPerson) -> str:
    """That a person has no folder, and which one may be meant."""
    above = next(folder for folder in person.folder.parents if is_folder(folder))
    names = [path.name for path in above.iterdir() if path.is_dir()]
    return f"no folder '{person.folder.name}'{nearest(person.folder.name, names)}"
