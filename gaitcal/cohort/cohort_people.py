"""Find the people of a cohort and their metadata: sub-folders, `people.csv`, or a `cohort.toml`.

A sub-folder of the cohort with recordings, or with a study file, is a person. A sub-folder without
them, whose sub-folders all have a complete set (a study file, or at least two recordings), is a
person with these sessions. `people.csv`, as spreadsheets write it, adds metadata; `cohort.toml`
names people one by one.
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

from gaitcal.errors import Code, InputError, find_similar_names, suggest_name
from gaitcal.intake.draft_file import STUDY
from gaitcal.intake.recordings_folder import MARKER_ENDINGS
from gaitcal.intake.subject_metadata import NO_OPTIONS, Options
from gaitcal.io import result_folder, snapshot
from gaitcal.io.csv_recordings import is_force_header, read_header
from gaitcal.io.toml import Table, format_value, read_validated, require_file, validate_table
from gaitcal.study.cohort_prior import require_joint_prior
from gaitcal.study.settings import CalibrationSettings

SHEET = "people.csv"
"""Metadata of the people, in the same folder as theirs."""
COHORT = "cohort.toml"
COMPLETE = 2
"""Fewest recordings of a session: standing and moving."""
MOST_NAME_BYTES = 80
"""Largest size, in UTF-8, of a folder's name made from the name of a person or session."""
MOST_BYTES = 20_000_000
"""Largest size of cohort.toml and of people.csv: some 50 000 people."""
_UNSAFE = re.compile(r"[^\w.()+=@ -]")
_DEVICE = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.IGNORECASE)
_NUMBERS: Final = ("mass_kg", "height_m", "age_years")
_COLUMNS: Final = ("person", "session", "group", "sex", *_NUMBERS)
_FIELDS: Final = {"mass": "mass_kg", "height": "height_m", "age": "age_years"}
_SYNONYMS: Final = {
    **_FIELDS,
    **dict.fromkeys(
        ("weight", "weight_kg", "weight (kg)", "weight [kg]", "body mass", "body_mass"), "mass_kg"
    ),
    "gender": "sex",
}
"""Other names of columns -> the column."""
_SEXES: Final = {"f": "female", "w": "female", "m": "male"}


@dataclass(frozen=True, kw_only=True)
class CohortPerson:
    """One session of one person."""

    folder: Path
    """Folder of the recordings or the study, absolute."""
    name: str
    session: str = ""
    """Empty if there is only one."""
    group: str = ""
    options: Options = NO_OPTIONS
    """Metadata that the user gives, for a folder without a study file."""

    @property
    def key(self) -> tuple[str, str]:
        """Name and session: sort key of tables."""
        return self.name, self.session

    @property
    def subfolder(self) -> str:
        """Folder of the result within that of the cohort, as `people/P01/pre`."""
        return "/".join(
            [snapshot.PEOPLE_FOLDER, *(make_safe_name(part) for part in self.key if part)]
        )

    @property
    def label(self) -> str:
        """Name and session, for messages."""
        return " ".join(filter(None, self.key))


@dataclass(frozen=True)
class Cohort:
    """People in the order of their names and sessions."""

    source: Path
    """Folder of the people's folders."""
    people: tuple[CohortPerson, ...]
    ignored: tuple[str, ...] = ()
    """Sub-folders without recordings."""
    notes: tuple[str, ...] = ()
    """Columns of the list of people that are not used."""


class PersonTable(Table):
    """Metadata of a person, or of one session, in either file."""

    name: str = Field(
        default="", max_length=200, description="name of the person; that of the folder if missing"
    )
    session: str = Field(
        default="", max_length=200, description="date or label; needed if a person has several"
    )
    group: str = Field(default="", max_length=200, description="any label; a column of the tables")
    sex: Literal["male", "female"] | None = Field(default=None, description="if no file has it")
    mass_kg: float | None = Field(
        default=None, ge=2, le=400, description="body mass in kg, if no file has it"
    )
    height_m: float | None = Field(
        default=None, ge=0.3, le=2.6, description="body height in m, if no file has it"
    )
    age_years: float | None = Field(
        default=None, ge=0, le=130, description="age in years, if no file has it"
    )

    @field_validator("name", "session", "group")
    @classmethod
    def _require_printable(cls, text: str) -> str:
        if not text.isprintable():
            raise ValueError(f"found {format_value(text)}; allowed: printable characters")
        return text.strip()

    @property
    def options(self) -> Options:
        """Metadata for the draft of a study."""
        return Options(
            mass=self.mass_kg,
            height=self.height_m,
            sex=self.sex,
            age=self.age_years,
            name=self.name or None,
            session=self.session or None,
        )


class ListedPerson(PersonTable):
    """`[[person]]`: a folder, and metadata of the person."""

    folder: str = Field(
        min_length=1, description="folder of the recordings, relative to that of cohort.toml"
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
        description="for everyone; a person's study file takes precedence",
    )


def make_safe_name(text: str) -> str:
    """Make a folder name from the name of a person or session.

    `text`: the name. Returns: the name itself if every file system allows it; else a similar one
    with part of its hash.
    """
    plain = _UNSAFE.sub("_", text).strip(". ").encode()[:MOST_NAME_BYTES].decode(errors="ignore")
    if plain == text and not _DEVICE.fullmatch(text):
        return text
    return f"{plain or '_'}-{hashlib.sha256(text.encode()).hexdigest()[:6]}"


def merge_options(first: Options, second: Options) -> Options:
    """Merge options; those given in the second take precedence."""
    given = {name: value for name, value in vars(second).items() if value is not None}
    return replace(first, **given)


def is_folder(path: Path) -> bool:
    """Return whether a folder exists; False for names that are too long, where pathlib raises."""
    return os.path.isdir(path)  # noqa: PTH112


def read_cohort(path: Path, out: Path) -> tuple[Cohort, CalibrationSettings]:
    """Read the people of a folder, or of a `cohort.toml`, and their common settings.

    Parameters
    ----------
    path : Path
        Folder of the people's folders, or the file.
    out : Path
        Folder of the results, which is no person.

    Returns
    -------
    Cohort, CalibrationSettings

    Raises
    ------
    InputError
        It is neither, has a value that is not allowed, or has no people.
    """
    file = path / COHORT if path.is_dir() and (path / COHORT).is_file() else path
    if file.is_dir():
        # A bare folder: sub-folders are people, and a spreadsheet may describe them.
        cohort, sheet = find_people(path, out), path / SHEET
        if sheet.is_file():
            rows, notes = read_sheet(sheet)
            cohort = replace(_with_rows(cohort, rows, sheet), notes=tuple(notes))
        return cohort, CalibrationSettings()
    content = read_validated(CohortFile, file, most_bytes=MOST_BYTES)
    folder = file.parent.absolute()
    people = []
    for table in content.people:
        recordings = (file.parent / table.folder).resolve()
        name = table.name or recordings.name
        people.append(
            CohortPerson(
                folder=recordings,
                name=name,
                session=table.session,
                group=table.group,
                options=replace(table.options, name=name),
            )
        )
    # A fault of the common settings is reported once, not by every person.
    require_joint_prior(content.calibration, file)
    settings = content.calibration.resolve_paths(
        lambda named: require_file(folder / named, source=file, field="calibration.priors"), file
    )
    return Cohort(file.parent, _sort_people(people, file)), settings


def find_people(folder: Path, out: Path) -> Cohort:
    """Find the people in the sub-folders of a folder.

    Parameters
    ----------
    folder : Path
        Of the cohort.
    out : Path
        Folder of the results, which is no person.

    Returns
    -------
    Cohort

    Raises
    ------
    InputError
        There are no people, or the folder cannot be listed.
    """
    found: list[CohortPerson] = []
    ignored = []
    for below in _list_folders(folder, out):
        sessions = _find_sessions(below, out)
        if not sessions:
            ignored.append(below.name)
        for session in sessions:
            # Recordings in the person's folder itself are the only session.
            name = "" if session == below else session.name
            options = Options(name=below.name, session=name or None)
            found.append(
                CohortPerson(
                    folder=session.resolve(), name=below.name, session=name, options=options
                )
            )
    if not found:
        direct = "the recordings are in the folder itself; " if _count_recordings(folder) else ""
        raise InputError(
            f"{direct}no sub-folder has recordings; each person needs a folder ('gaitcal "
            "calibrate' is for one person)",
            source=folder,
            code=Code.COHORT,
        )
    return Cohort(folder, _sort_people(found, folder), tuple(ignored))


def _sort_people(people: Iterable[CohortPerson], source: Path) -> tuple[CohortPerson, ...]:
    """Sort people by name and session; InputError if two results would share a folder."""
    out = sorted(people, key=lambda person: person.key)
    message = _describe_shared_folder(out)
    if message:
        raise InputError(message, source=source, code=Code.COHORT)
    return tuple(out)


def _describe_shared_folder(people: Sequence[CohortPerson]) -> str:
    """Describe the first two people whose results would share a folder; empty if there are none."""
    subfolders: dict[str, CohortPerson] = {}
    for person in people:
        # Some file systems do not distinguish capitals: Ann and ann would share a folder.
        other = subfolders.setdefault(person.subfolder.casefold(), person)
        if other is person:
            continue
        if other.key == person.key:
            return (
                f"found '{person.label}' twice, in '{other.folder.name}' and "
                f"'{person.folder.name}'; allowed: once for each session; name the sessions"
            )
        return (
            f"found '{person.label}' and '{other.label}', whose results would be in one folder; "
            "allowed: other names"
        )
    # The folder of a person's only result would have those of the sessions in it.
    with_session = {person.name for person in people if person.session}
    for person in people:
        if not person.session and person.name in with_session:
            return f"found '{person.name}' with and without a session; allowed: a session for each"
    return ""


def _list_folders(folder: Path, out: Path) -> list[Path]:
    """List sub-folders, without hidden ones and results; a synthetic study is no result."""
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
    """Return whether a folder has a study file that gaitcal calibrate did not write."""
    made = result_folder.read_json_object(folder / result_folder.MANIFEST).get("gaitcal")
    return (folder / STUDY).is_file() and made in (None, "synthetic subject")


def _count_recordings(folder: Path) -> int:
    """Count the recordings of markers in a folder."""
    try:
        return sum(
            path.suffix.lower() in MARKER_ENDINGS or _is_recording(path)
            for path in folder.iterdir()
        )
    except OSError:
        return 0


def _is_recording(path: Path) -> bool:
    """Return whether a CSV table has markers, by its header."""
    if path.suffix.lower() != ".csv" or path.name == SHEET:
        return False
    try:
        return not is_force_header(read_header(path))
    except InputError:
        return False


def _find_sessions(folder: Path, out: Path) -> Sequence[Path]:
    """Find the folders of a person's sessions.

    It is the folder itself unless its sub-folders are complete sessions; none without recordings.
    """
    if _has_study(folder) or _count_recordings(folder):
        return (folder,)
    below = [p for p in _list_folders(folder, out) if _has_study(p) or _count_recordings(p)]
    if below and all(_has_study(p) or _count_recordings(p) >= COMPLETE for p in below):
        return below
    return (folder,) if below else ()


def _with_rows(cohort: Cohort, rows: Sequence[PersonTable], source: Path) -> Cohort:
    """Return the cohort with the metadata of a spreadsheet.

    A row without a session is about all sessions of a person. A row without a folder becomes a
    person without one, which is reported with the failures.
    """
    people = {person.key: person for person in cohort.people}
    # Rows of one session come last and take precedence.
    for row in sorted(rows, key=lambda row: row.session != ""):
        of_person = [p for p in people.values() if p.name == row.name]
        described = [p for p in of_person if not row.session or p.session == row.session]
        # A row may name the session of recordings that are not in a folder of one.
        described = described or [p for p in of_person if not p.session]
        if not described:
            described = [_make_person_without_folder(cohort, row, source)]
        for person in described:
            people.pop(person.key, None)
            new = replace(
                person,
                session=row.session or person.session,
                group=row.group or person.group,
                options=merge_options(person.options, row.options),
            )
            people[new.key] = new
    return replace(cohort, people=_sort_people(people.values(), source))


def _make_person_without_folder(cohort: Cohort, row: PersonTable, source: Path) -> CohortPerson:
    """Make a person from a row; InputError if a name would lead out of the cohort's folder."""
    for field, name in (("person", row.name), ("session", row.session)):
        if name and (name == ".." or Path(name).parts != (name,)):
            message = f"found {format_value(name)}; allowed: the name of a folder, without a path"
            raise InputError(message, source=source, field=field, code=Code.COHORT)
    folder = cohort.source.resolve() / row.name / row.session
    return CohortPerson(folder=folder, name=row.name, session=row.session)


def read_sheet(path: Path) -> tuple[list[PersonTable], list[str]]:
    """Read `people.csv`: person, session, group, sex, mass_kg, height_m, age_years.

    Columns are separated by commas, semicolons (with decimal commas) or tabs.

    `path`: the file. Returns: a row per person and session; notes on columns
    that are not used. Raises InputError: no
    column `person`, a column twice or with a similar name, two rows that contradict each other, or
    a value that is not allowed, with its row.
    """
    text = _read_text(path)
    head = text.split("\n", 1)[0]
    # Spreadsheets separate columns by comma, semicolon or tab, depending on their language.
    lines = csv.DictReader(io.StringIO(text, newline=""), delimiter=max(",;\t", key=head.count))
    names = [str(name).strip().lower() for name in lines.fieldnames or ()]
    notes = list(_note_unused_columns(names, path))
    lines.fieldnames = names
    # Person, session and field -> value and number of its row.
    given: dict[tuple[str, str, str], tuple[object, int]] = {}
    rows = []
    try:
        for number, line in enumerate(lines, start=2):
            if any(line.values()):
                source = f"{path}: row {number}"
                row = _read_row(line, source)
                for name, value in {"group": row.group or None, **vars(row.options)}.items():
                    if value is None:
                        continue
                    # Two rows may describe one session, but must not contradict each other.
                    first, at = given.setdefault((row.name, row.session, name), (value, number))
                    if first != value:
                        found, before = _format_cell(value), _format_cell(first)
                        raise InputError(
                            f"found {found}, but row {at} has {before} for the same person and "
                            "session; allowed: one of them",
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


def _format_cell(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else format_value(value)


def _note_unused_columns(names: Sequence[str], path: Path) -> Iterator[str]:
    """Note unknown columns; InputError for those similar to a known one, and for columns twice."""
    if "person" not in names:
        message = (
            f"found the columns {', '.join(filter(None, names)) or 'none'}; allowed: person, and "
            f"any of {', '.join(_COLUMNS[1:])}"
        )
        raise InputError(message, source=path, code=Code.COHORT)
    for name in dict.fromkeys(filter(None, names)):
        if names.count(name) > 1:
            message = f"found {names.count(name)} columns {format_value(name)}; allowed: one"
            raise InputError(message, source=path, code=Code.COHORT)
        if name in _COLUMNS:
            continue
        # A misspelt column would be ignored, and its values with it.
        meant = _SYNONYMS.get(name) or next(iter(find_similar_names(name, _COLUMNS)), None)
        if meant is not None and meant not in names:
            raise InputError(
                f"found the unknown column {format_value(name)}; did you mean '{meant}'? Otherwise "
                "give the column a name that is less similar",
                source=path,
                code=Code.COHORT,
            )
        yield f"{path.name}: column {format_value(name)} is not used"


def _read_text(path: Path) -> str:
    """Read a spreadsheet as text, up to `MOST_BYTES`."""
    try:
        with path.open("rb") as stream:
            # One byte more than is allowed, to notice a larger file without reading it.
            raw = stream.read(MOST_BYTES + 1)
        if len(raw) > MOST_BYTES:
            message = f"larger than {MOST_BYTES // 1_000_000} MB, the limit of a table of people"
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


def _read_row(cells: Mapping[str | None, object], source: str) -> PersonTable:
    """Validate the cells of a row."""
    # A DictReader has cells beyond the last column under the key None.
    surplus = cells.get(None)
    if isinstance(surplus, list) and any(surplus):
        message = "found more cells than columns; a decimal comma needs semicolons between columns"
        raise InputError(message, source=source, code=Code.COHORT)
    text = {name: str(cells.get(name) or "").strip() for name in _COLUMNS}
    values: dict[str, object] = {name: text[name] for name in _COLUMNS[1:] if text[name]}
    for name in _NUMBERS:
        if text[name]:
            try:
                # Decimal commas, where columns are separated otherwise.
                values[name] = float(text[name].replace(",", "."))
            except ValueError:
                message = f"found {format_value(text[name])}; allowed: a number"
                raise InputError(message, source=source, field=name, code=Code.BAD_NUMBER) from None
    if text["sex"]:
        values["sex"] = _SEXES.get(text["sex"].lower(), text["sex"].lower())
    table = validate_table(PersonTable, {**values, "name": text["person"]}, source)
    if not table.name:
        message = "found nothing; allowed: the name of a folder"
        raise InputError(message, source=source, field="person", code=Code.COHORT)
    return table


def describe_missing_folder(person: CohortPerson) -> str:
    """Describe that a person has no folder, with the most similar folder name."""
    parent = next(folder for folder in person.folder.parents if is_folder(folder))
    names = [path.name for path in parent.iterdir() if path.is_dir()]
    return f"no folder '{person.folder.name}'{suggest_name(person.folder.name, names)}"
