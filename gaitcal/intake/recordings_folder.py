"""Read every file of a folder once, and pair tables of forces with recordings.

Only files directly in the folder are read: one person per folder. A file that cannot be read keeps
the reason, and the others are still read.

A recording with force plates needs no table. A table can belong to another recording if it covers
its time and if, under load, the centre of pressure is near a foot. The feet decide; names decide
only if the feet do not. A table named after a recording that needs no forces belongs to no other.
"""

import difflib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path, PureWindowsPath
from xml.etree import ElementTree

import numpy as np

from gaitcal.arrays import Array
from gaitcal.errors import Code, InputError
from gaitcal.io import csv_recordings as csv_files
from gaitcal.io import force_plate, formats, result_folder, toml
from gaitcal.io.force_tables import Forces
from gaitcal.io.recording import Recording
from gaitcal.model.marker_set import MarkerSet, load_marker_set

MOST_FILES = 2000
"""Largest number of files in the folder of one person."""
MARKER_ENDINGS = (".c3d", ".trc")
TABLE_ENDINGS = (".mot", ".sto")
LARGEST_XML = 1_000_000
"""Bytes. The settings of external forces take some 3 kB."""
_HIDDEN = re.compile(r"[.~]")


class FileKind(Enum):
    """Kinds of files."""

    RECORDING = "recording"
    FORCES = "forces"
    EXTERNAL_LOADS = "external forces"
    """OpenSim's XML that assigns the columns of a table to forces."""
    CORNERS = "corners of plates"
    FACTS = "person and events"
    EVENTS = "foot events"
    MARKER_SET = "marker set"
    STUDY = "study"
    UNREADABLE = "not readable"
    OTHER = "other"


@dataclass(frozen=True, kw_only=True)
class FolderFile:
    """One file, as it was read."""

    path: Path
    name: str
    """Path relative to the folder."""
    kind: FileKind
    recording: Recording | None = None
    forces: Forces | None = None
    marker_set: MarkerSet | None = None
    table_name: str = ""
    """Of external forces: the table that they describe."""
    reason: str = ""
    """Why it cannot be used; empty if it can."""


@dataclass(frozen=True, kw_only=True)
class Folder:
    """A folder as it was read."""

    path: Path
    files: tuple[FolderFile, ...]
    """Sorted by name, ignoring case."""
    subfolders: tuple[tuple[str, int], ...]
    """Name of each subfolder with recordings, and their number."""
    deep: bool = False
    """Whether `files` includes the files of the subfolders."""

    def select_kind(self, kind: FileKind) -> tuple[FolderFile, ...]:
        """Return its files of one kind."""
        return tuple(file for file in self.files if file.kind is kind)

    @property
    def name(self) -> str:
        """Name of the folder, links resolved."""
        return self.path.resolve().name


def read_folder(path: Path, *, deep: bool = False) -> Folder:
    """Read every file of a folder.

    Parameters
    ----------
    path
        Of the folder.
    deep
        Whether to read its direct subfolders with recordings, too.

    Returns
    -------
    Folder

    Raises
    ------
    InputError
        It is no folder, cannot be read, or holds more than `MOST_FILES` files.
    """
    if not path.is_dir():
        raise InputError(
            "is not a folder; give a folder with the recordings of one person",
            source=path,
            code=Code.FOLDER,
        )
    try:
        entries = sorted(path.iterdir(), key=lambda p: (p.name.lower(), p.name))
    except OSError as error:
        raise InputError(
            f"the folder cannot be read: {error.strerror}", source=path, code=Code.UNREADABLE
        ) from None
    files = _list_files(path)
    below = [
        (p.name, _count_recordings(p)) for p in entries if p.is_dir() and not _HIDDEN.match(p.name)
    ]
    subfolders = tuple((name, count) for name, count in below if count)
    if deep:
        files += [file for name, _ in subfolders for file in _list_files(path / name)]
    if len(files) > MOST_FILES:
        message = f"found {len(files)} files; at most {MOST_FILES} are allowed for one person"
        raise InputError(message, source=path, code=Code.FOLDER)
    read = tuple(_read(file, file.relative_to(path).as_posix()) for file in files)
    return Folder(path=path, files=read, subfolders=subfolders, deep=deep)


def _list_files(folder: Path) -> list[Path]:
    """List the visible files of a folder; none if it cannot be read."""
    try:
        files = sorted(folder.iterdir(), key=lambda p: (p.name.lower(), p.name))
    except OSError:
        return []
    return [p for p in files if p.is_file() and not _HIDDEN.match(p.name)]


def _count_recordings(folder: Path) -> int:
    """Count the marker files of a folder; 0 in a result folder."""
    try:
        manifest, example = folder / result_folder.MANIFEST, result_folder.ResultKind.EXAMPLE.value
        if manifest.is_file() and result_folder.read_json_object(manifest).get("kind") != example:
            return 0
        return sum(p.suffix.lower() in MARKER_ENDINGS for p in folder.iterdir())
    except OSError:
        return 0


def _read(path: Path, name: str) -> FolderFile:
    """Read a file by its ending and content; if that fails keep the reason without its path."""
    try:
        with np.errstate(all="ignore"):
            return replace(_read_by_ending(path), name=name)
    except InputError as fault:
        reason = str(fault).removeprefix(f"{path}: ")
        return FolderFile(path=path, name=name, kind=FileKind.UNREADABLE, reason=reason)


def _read_by_ending(path: Path) -> FolderFile:
    """Read a file by its ending."""
    file = FolderFile(path=path, name=path.name, kind=FileKind.OTHER)
    ending = path.suffix.lower()
    if ending in MARKER_ENDINGS:
        return replace(file, kind=FileKind.RECORDING, recording=formats.read_recording(path))
    if ending in TABLE_ENDINGS:
        return replace(file, kind=FileKind.FORCES, forces=formats.read_forces(path))
    if ending == ".csv":
        return _read_csv(file)
    if ending == ".toml":
        return _read_toml(file)
    if ending == ".xml":
        return _read_xml(file)
    return replace(file, reason=f"files ending in '{ending}' are not supported")


def _read_csv(file: FolderFile) -> FolderFile:
    """Read a CSV file by its header: events, markers, forces, plate corners or facts."""
    if file.path.name == csv_files.EVENT_FILE:
        if not csv_files.is_event_table(file.path):
            return replace(file, reason=csv_files.NOT_AN_EVENT_TABLE)
        csv_files.read_events(file.path)
        return replace(file, kind=FileKind.EVENTS)
    try:
        header = csv_files.read_header(file.path)
    except InputError:
        lines = file.path.read_bytes()[:4000].decode("utf-8", "replace").lower().splitlines()
        for columns, kind in (
            (csv_files.CORNER_HEADER, FileKind.CORNERS),
            (csv_files.FACT_HEADER, FileKind.FACTS),
        ):
            if ",".join(columns) in map(str.strip, lines):
                return replace(file, kind=kind)
        raise
    if csv_files.is_force_header(header):
        return replace(file, kind=FileKind.FORCES, forces=formats.read_forces(file.path))
    return replace(file, kind=FileKind.RECORDING, recording=formats.read_recording(file.path))


def _read_toml(file: FolderFile) -> FolderFile:
    """Read a TOML file: a study or a marker set."""
    content = toml.read_toml(file.path)
    if is_study(content):
        return replace(file, kind=FileKind.STUDY)
    if "landmarks" in content:
        return replace(file, kind=FileKind.MARKER_SET, marker_set=load_marker_set(file.path))
    return replace(file, reason="neither a study nor a marker set")


def is_study(content: Mapping[str, object]) -> bool:
    """Return whether a TOML table is a study.

    Parameters
    ----------
    content
        Of the file.

    Returns
    -------
    bool
    """
    return "trial" in content or "subject" in content


def _read_xml(file: FolderFile) -> FolderFile:
    """Read OpenSim's external forces."""
    path = file.path
    try:
        text = path.read_bytes()
        if len(text) > LARGEST_XML or b"<!ENTITY" in text:
            message = "is not an XML file of external forces"
            raise InputError(message, source=path, code=Code.FILE_FORMAT)
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, OSError) as error:
        raise InputError(
            f"the XML cannot be read: {error}", source=path, code=Code.FILE_FORMAT
        ) from None
    table = (root.findtext(".//datafile") or "").strip()
    if not table:
        return replace(file, reason="an XML file without a table of external forces")
    forces = None
    if ".xml" in formats.FORCE_READERS and _try_reading_forces(path.parent / table) is None:
        # the table has columns that only the XML explains
        forces = _try_reading_forces(path)
    return replace(file, kind=FileKind.EXTERNAL_LOADS, table_name=table, forces=forces)


def _try_reading_forces(path: Path) -> Forces | None:
    """Read the forces of a table, or of an XML that describes one; None if they cannot be read."""
    try:
        return formats.read_forces(path)
    except InputError:
        return None


def find_marker_sets_above(folder: Path) -> tuple[FolderFile, ...]:
    """Find marker sets next to the folder, where laboratories keep one for all their subjects.

    Parameters
    ----------
    folder
        Its path.

    Returns
    -------
    tuple of FolderFile
    """
    above = folder.resolve().parent
    try:
        files = sorted(p for p in above.iterdir() if p.suffix.lower() == ".toml" and p.is_file())
    except OSError:
        return ()
    found = [_read(file, file.name) for file in files]
    return tuple(file for file in found if file.kind is FileKind.MARKER_SET)


_JOINT_WORD = re.compile(r"(hip|knee|ankle)(?![a-z]*cent)", re.IGNORECASE)


def describe_name_conflict(stem: str, role: tuple[str, str]) -> str:
    """Describe a joint in a file's name that contradicts its role.

    Parameters
    ----------
    stem
        File name without ending.
    role
        Role and joint.

    Returns
    -------
    str
        Empty without a contradiction.
    """
    word = _JOINT_WORD.search(stem)
    if word is None:
        return ""
    name = word.group(1).lower()
    if role[0] == "joint" and role[1].startswith(name):
        return ""
    return f"although its name contains '{name}'"


def make_trial_names(stems: Sequence[str]) -> list[str]:
    """Make trial names from file names: valid as file names, and unique whatever the case.

    Parameters
    ----------
    stems
        File names without ending.

    Returns
    -------
    list of str
        In the same order.
    """
    out: list[str] = []
    for stem in stems:
        plain = re.sub(r"[^A-Za-z0-9_-]+", "_", stem).strip("_")[:60] or "trial"
        if re.fullmatch(r"(con|prn|aux|nul|com\d|lpt\d)", plain, re.IGNORECASE):
            plain += "_"
        name, count = plain, 1
        while name.lower() in {other.lower() for other in out}:
            count += 1
            name = f"{plain}_{count}"
        out.append(name)
    return out


UNDER_M = 0.25
"""m, largest median distance in the floor plane between centre of pressure and nearest foot marker
under load.
"""
SAME_NAME = 0.6
"""Similarity from which two names are alike."""
WORDS = re.compile(
    r"(grfs?|forces?|force|fp|plates?|analog|kinetics|ext|external|loads?)", re.IGNORECASE
)
"""Words of names that mean only that a file contains forces."""


@dataclass(frozen=True, kw_only=True)
class ForceChoice:
    """The forces of one recording."""

    file: FolderFile
    """The table, or the XML that describes it."""
    reason: str
    certain: bool


@dataclass(frozen=True)
class _Match:
    """A table of forces that may belong to a recording."""

    recording: int
    table: int
    away: float | None
    """m, distance of the centre of pressure from the feet; None without load."""
    alike: float
    """Similarity of the names, 0 to 1."""
    covered: tuple[float, float]
    """s, from when to when the table has forces."""
    lost: float
    """Share of the recording's time without forces."""


def pair_forces(
    recordings: Mapping[int, tuple[str, Recording]],
    marker_set: MarkerSet,
    files: Sequence[FolderFile],
) -> tuple[dict[int, ForceChoice], dict[str, str]]:
    """Pair tables of forces with recordings.

    Parameters
    ----------
    recordings
        Number -> file name without ending, and recording with the labels of the set; those that
        need forces.
    marker_set
        Of the recordings.
    files
        Of the folder.

    Returns
    -------
    forces : dict
        Recording -> its forces.
    unpaired : dict
        Table -> why it belongs to no recording.
    """
    tables = [file for file in files if file.forces is not None]
    named = [file for file in files if file.kind is FileKind.EXTERNAL_LOADS]
    # a Windows path takes / and \ as separators
    loads = {PureWindowsPath(file.table_name).name.lower(): file for file in named}
    matches: list[_Match] = []
    why: dict[str, str] = {}
    wanted = {stem for stem, _ in recordings.values()}
    for t, table in enumerate(tables):
        partner = find_partner(table, files)
        if partner is not None and partner.path.stem not in wanted:
            why[table.name] = f"forces of {partner.name}, which needs none or is not used"
            continue
        for number, (stem, recording) in recordings.items():
            match = _match(number, stem, recording, marker_set, t, table)
            if isinstance(match, str):
                why.setdefault(table.name, match)
            else:
                matches.append(match)
    out: dict[int, ForceChoice] = {}
    used: set[int] = set()
    # the best pairs first, each recording and table once
    for match in sorted(matches, key=_rank):
        if match.recording in out or match.table in used:
            continue
        table = tables[match.table]
        rivals = [m for m in matches if m.recording == match.recording and m.table != match.table]
        unsure = match.away is None and match.alike < SAME_NAME
        if unsure and (rivals or len(recordings) > 1):
            why[table.name] = (
                "cannot be assigned to a recording: no foot is loaded, and no name is similar"
            )
            continue
        stems = {number: stem for number, (stem, _) in recordings.items()}
        external = loads.get(table.path.name.lower())
        out[match.recording] = _choose_forces(match, table, stems, external)
        used.add(match.table)
    reason = "no walk without force plates needs it"
    if recordings:
        reason = "its recording has another table that fits better"
    unused = [table for t, table in enumerate(tables) if t not in used]
    for table in unused:
        why.setdefault(table.name, reason)
    return out, {table.name: why[table.name] for table in unused}


def _choose_forces(
    match: _Match, table: FolderFile, stems: Mapping[int, str], external: FolderFile | None
) -> ForceChoice:
    """Describe why a table belongs to a recording; uncertain if another name is more similar."""
    alike = {number: compare_names(stem, table.path.stem) for number, stem in stems.items()}
    best = max(alike, key=lambda number: (alike[number], number == match.recording))
    is_rival = alike[best] >= SAME_NAME and alike[best] > alike[match.recording]
    covers = "covers the time"
    if match.lost != 0.0:
        covers = "covers {:.2f} to {:.2f} s".format(*match.covered)
    parts = [f"{covers}; no foot is loaded in it"]
    if match.away is not None:
        distance = f"{100 * match.away:.0f} cm"
        parts = [f"{covers}, centre of pressure under load {distance} from the feet"]
    if is_rival:
        parts.append(f"although its name is more similar to {stems[best]}")
    elif match.alike >= SAME_NAME:
        parts.append("similar names")
    if external is not None:
        parts.append(f"described by {external.name}")
    certain = match.away is not None and not is_rival
    return ForceChoice(file=table, reason="; ".join(parts), certain=certain)


def find_partner(table: FolderFile, files: Sequence[FolderFile]) -> FolderFile | None:
    """Find the recording after which a table of forces is named (`gait.csv`: `gait_forces.csv`)."""
    recordings = (
        f for f in files if f.kind is FileKind.RECORDING and compare_names(f.path.stem, "") < 1.0
    )
    return next(
        (file for file in recordings if compare_names(file.path.stem, table.path.stem) == 1.0), None
    )


def _rank(match: _Match) -> tuple[object, ...]:
    """Rank a match, smallest first: time lost and names in steps, distance, order of files."""
    away = np.inf if match.away is None else match.away
    return (
        match.away is None,
        round(match.lost, 1),
        -round(match.alike, 1),
        away,
        match.recording,
        match.table,
    )


def _match(
    number: int, stem: str, recording: Recording, marker_set: MarkerSet, t: int, table: FolderFile
) -> _Match | str:
    """Match a table with a recording; return why it does not fit."""
    if table.forces is None:
        return "it contains no forces"
    plates, time = table.forces.plates, recording.time
    step = float(np.median(np.diff(time)))
    start, stop = max(float(p.time[0]) for p in plates), min(float(p.time[-1]) for p in plates)
    low, high = max(start, float(time[0])), min(stop, float(time[-1]))
    if high - low < force_plate.STANCE_S:
        return (
            f"its forces run from {start:.2f} to {stop:.2f} s, {stem} from {time[0]:.2f} to "
            f"{time[-1]:.2f} s"
        )
    # share of the time without forces, to one frame
    whole = start <= time[0] + step and stop >= time[-1] - step
    lost = 0.0 if whole else 1.0 - (high - low) / float(np.ptp(time))
    # under load the centre of pressure must be near a foot
    points, feet = _select_loaded_frames(recording, marker_set, table)
    away = _measure_distance(points, feet)
    if away is not None and away > UNDER_M:
        # in another unit, centres of pressure move by a power of ten farther than any foot
        room = float(np.max(np.nanmax(feet, axis=(0, 1)) - np.nanmin(feet, axis=(0, 1))))
        if np.ptp(points, axis=0).max() > 10.0 * room:
            scaled = {
                unit: _measure_distance(metres * points, feet) or 0.0
                for unit, metres in (("mm", 1e-3), ("cm", 1e-2))
            }
            unit = min(scaled, key=lambda name: scaled[name])
            if scaled[unit] <= UNDER_M:
                return (
                    f"its centres of pressure are in {unit}, not in m: in {unit} they are under "
                    f"the feet of {stem}"
                )
        return f"its centres of pressure are {away:.2f} m from the feet of {stem}"
    return _Match(number, t, away, compare_names(stem, table.path.stem), (low, high), lost)


def _select_loaded_frames(
    recording: Recording, marker_set: MarkerSet, table: FolderFile
) -> tuple[Array, Array]:
    """Select centres of pressure (n, 2) m and foot markers (n, k, 2) m of loaded frames."""
    feet = [
        i
        for i, m in enumerate(recording.labels)
        if marker_set.segment_of.get(m, "").startswith("foot")
    ]
    points, frames = [np.empty((0, 2))], [np.empty(0, dtype=int)]
    for plate in table.forces.plates if table.forces else ():
        point = np.stack(
            [np.interp(recording.time, plate.time, plate.point[:, k]) for k in (0, 2)], axis=1
        )
        force = np.interp(recording.time, plate.time, np.nan_to_num(plate.force[:, 1]))
        covered = (recording.time >= plate.time[0]) & (recording.time <= plate.time[-1])
        visible = np.asarray(np.isfinite(recording.markers[:, feet]).all(axis=2)).any(axis=1)
        # frames of the recording in which the plate is loaded and a foot visible
        loaded = np.flatnonzero(
            (force > force_plate.BODY_N) & covered & visible & np.isfinite(point).all(axis=1)
        )
        points.append(point[loaded])
        frames.append(loaded)
    return np.concatenate(points), recording.markers[np.concatenate(frames)][:, feet][:, :, [0, 2]]


def _measure_distance(points: Array, feet: Array) -> float | None:
    """Measure the median distance (m) of centres of pressure from the nearest foot marker."""
    away: Array = np.linalg.norm(feet - points[:, None], axis=2)
    return float(np.median(np.nanmin(away, axis=1))) if away.size else None


def compare_names(stem: str, table: str) -> float:
    """Compare two names without words that mean only `forces`.

    Parameters
    ----------
    stem, table
        File names without ending.

    Returns
    -------
    float
        Similarity, 0 to 1.
    """
    a, b = (re.sub(r"[^a-z0-9]", "", WORDS.sub("", name).lower()) for name in (stem, table))
    return 1.0 if a == b else difflib.SequenceMatcher(None, a, b).ratio()


def describe_empty_folder(folder: Folder) -> str:
    """Describe that a folder has no recording, and which subfolders have some."""
    if folder.subfolders:
        below = ", ".join(f"{name} ({count})" for name, count in folder.subfolders[:6])
        return (
            f"no readable recording in this folder, but in its subfolders: {below}; give one of "
            "them, with one person per folder"
        )
    if not folder.files:
        return "the folder is empty; .c3d, .trc or .csv files of one person are needed"
    files = "1 file" if len(folder.files) == 1 else f"{len(folder.files)} files"
    return f"{files}, but no readable recording (.c3d, .trc or .csv)"
