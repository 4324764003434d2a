"""Who belongs to a cohort: every sub-folder with recordings is a person, or a session of one; what a lab says of them.

A sub-folder of the cohort that holds recordings, or a study file, is a person. One that holds none itself, but whose
own sub-folders all hold a complete set (a study file, or at least two recordings), is a person with these sessions.
`people.csv` beside them, as spreadsheets write it, tells what no file does.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from gaitcal.codes import Code
from gaitcal.errors import InputError, nearest
from gaitcal.io.csv import is_force_header, read_header
from gaitcal.io.lock import MANIFEST, PEOPLE, read_object
from gaitcal.io.validation import shown
from gaitcal.session.draft import STUDY
from gaitcal.session.folder import MARKER_ENDINGS
from gaitcal.session.person_facts import NOTHING_SAID, Options

PAGE_DATA = "people.csv"
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
    if path.suffix.lower() != ".csv" or path.name == PAGE_DATA:
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
