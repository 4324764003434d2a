"""Every file of a folder, read once, and which table of forces belongs to which recording.

Only files directly in the folder: one person a folder. A file that cannot be read ends nothing; it
keeps its reason.

A recording that has plates of its own needs no table. For another one, a table can be its own only
if it covers its time and if, under load, the centre of pressure lies near a foot: the feet decide,
names only where feet do not. One that is called after a recording which needs no forces is nobody
else's.
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

MOST_FILES = 2000  # A folder with more files is no person's
MARKER_ENDINGS, TABLE_ENDINGS = (".c3d", ".trc"), (".mot", ".sto")
LARGEST_XML = 1_000_000  # Bytes; the settings of external forces take some 3 kB
_HIDDEN = re.compile(r"[.~]")


class FileKind(Enum):
    """What a file is."""

    RECORDING = "recording"
    FORCES = "forces"
    EXTERNAL_LOADS = (
        "external forces"  # OpenSim's XML that says which columns of a table are which force
    )
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
    name: str  # As seen from the folder
    kind: FileKind
    recording: Recording | None = None
    forces: Forces | None = None
    marker_set: MarkerSet | None = None
    table_name: str = ""  # Of external forces: the table that they name
    reason: str = ""  # Why it is of no use, where it is of none


@dataclass(frozen=True, kw_only=True)
class Folder:
    """A folder as it was read."""

    path: Path
    files: tuple[FolderFile, ...]  # In the order of their names, letters without case
    subfolders: tuple[tuple[str, int], ...]  # Folders in it that hold recordings, and how many
    deep: bool = False  # Whether the files of these are among `files`

    def select_kind(self, kind: FileKind) -> tuple[FolderFile, ...]:
        """Its files of one kind."""
        return tuple(file for file in self.files if file.kind is kind)

    @property
    def name(self) -> str:
        """Name of the folder, whatever way leads to it."""
        return self.path.resolve().name


def read_folder(path: Path, *, deep: bool = False) -> Folder:
    """Read every file that lies in a folder; `deep`: and in the folders directly in it that hold
    recordings.

    Raises InputError: It is no folder, cannot be listed, or holds more than `MOST_FILES` files.
    """
    if not path.is_dir():
        raise InputError(
            "is no folder; a folder with one person's recordings is needed",
            source=path,
            code=Code.FOLDER,
        )
    try:
        entries = sorted(path.iterdir(), key=lambda p: (p.name.lower(), p.name))
    except OSError as error:
        raise InputError(
            f"cannot be listed: {error.strerror}", source=path, code=Code.UNREADABLE
        ) from None
    files = _list_files(path)
    below = [
        (p.name, _count_recordings(p)) for p in entries if p.is_dir() and not _HIDDEN.match(p.name)
    ]
    subfolders = tuple((name, count) for name, count in below if count)
    if deep:
        files += [file for name, _ in subfolders for file in _list_files(path / name)]
    if len(files) > MOST_FILES:
        message = f"found {len(files)} files; a folder of one person has fewer than {MOST_FILES}"
        raise InputError(message, source=path, code=Code.FOLDER)
    read = tuple(_read(file, file.relative_to(path).as_posix()) for file in files)
    return Folder(path=path, files=read, subfolders=subfolders, deep=deep)


def _list_files(folder: Path) -> list[Path]:
    try:
        files = sorted(folder.iterdir(), key=lambda p: (p.name.lower(), p.name))
    except OSError:
        return []
    return [p for p in files if p.is_file() and not _HIDDEN.match(p.name)]


def _count_recordings(folder: Path) -> int:
    try:
        manifest, example = folder / result_folder.MANIFEST, result_folder.ResultKind.EXAMPLE.value
        if manifest.is_file() and result_folder.read_json_object(manifest).get("kind") != example:
            return 0  # a result of ours
        return sum(p.suffix.lower() in MARKER_ENDINGS for p in folder.iterdir())
    except OSError:
        return 0


def _read(path: Path, name: str) -> FolderFile:
    """A file by its ending and content; one that cannot be read keeps the reason, without its path."""
    try:
        with np.errstate(all="ignore"):
            return replace(_read_by_ending(path), name=name)
    except InputError as fault:
        reason = str(fault).removeprefix(f"{path}: ")
        return FolderFile(path=path, name=name, kind=FileKind.UNREADABLE, reason=reason)


def _read_by_ending(path: Path) -> FolderFile:
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
    return replace(file, reason=f"gaitcal reads no file ending in '{ending}'")


def _read_csv(file: FolderFile) -> FolderFile:
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
    content = toml.read_toml(file.path)
    if is_study(content):
        return replace(file, kind=FileKind.STUDY)
    if "landmarks" in content:
        return replace(file, kind=FileKind.MARKER_SET, marker_set=load_marker_set(file.path))
    return replace(file, reason="neither a study nor a marker set")


def is_study(content: Mapping[str, object]) -> bool:
    """Whether a TOML table is a study."""
    return "trial" in content or "subject" in content


def _read_xml(file: FolderFile) -> FolderFile:
    path = file.path
    try:
        text = path.read_bytes()
        if len(text) > LARGEST_XML or b"<!ENTITY" in text:
            raise InputError("is no XML of external forces", source=path, code=Code.FILE_FORMAT)
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, OSError) as error:
        raise InputError(
            f"is no readable XML: {error}", source=path, code=Code.FILE_FORMAT
        ) from None
    table = (root.findtext(".//datafile") or "").strip()
    if not table:
        return replace(file, reason="an XML that names no table of external forces")
    forces = None
    if ".xml" in formats.FORCE_READERS and _try_reading_forces(path.parent / table) is None:
        forces = _try_reading_forces(path)  # the table has columns that only the XML explains
    return replace(file, kind=FileKind.EXTERNAL_LOADS, table_name=table, forces=forces)


def _try_reading_forces(path: Path) -> Forces | None:
    """The forces of a table or of an XML that names one; None where they cannot be read."""
    try:
        return formats.read_forces(path)
    except InputError:
        return None


def find_marker_sets_above(folder: Path) -> tuple[FolderFile, ...]:
    """Marker sets that lie beside the folder, where laboratories keep one for all of their people."""
    above = folder.resolve().parent
    try:
        files = sorted(p for p in above.iterdir() if p.suffix.lower() == ".toml" and p.is_file())
    except OSError:
        return ()
    return tuple(
        found
        for found in (_read(file, file.name) for file in files)
        if found.kind is FileKind.MARKER_SET
    )


_JOINT_WORD = re.compile(r"(hip|knee|ankle)(?![a-z]*cent)", re.IGNORECASE)


def describe_name_conflict(stem: str, role: tuple[str, str]) -> str:
    """What a file's name says against its role; empty where it says nothing."""
    word = _JOINT_WORD.search(stem)
    if word is None:
        return ""
    name = word.group(1).lower()
    if role[0] == "joint" and role[1].startswith(name):
        return ""
    return f"though its name says {name}"


def make_trial_names(stems: Sequence[str]) -> list[str]:
    """Names of trials from those of files: safe as file names, and each once whatever the case."""
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
"""Median distance, in the floor's plane, of the centre of pressure from the nearest marker of a
foot under load.
"""
SAME_NAME = 0.6
WORDS = re.compile(
    r"(grfs?|forces?|force|fp|plates?|analog|kinetics|ext|external|loads?)", re.IGNORECASE
)
"""Words of names that say only that a file holds forces."""


@dataclass(frozen=True, kw_only=True)
class ForceChoice:
    """The forces of one recording."""

    file: FolderFile  # The table, or the XML that names it
    reason: str
    certain: bool


@dataclass(frozen=True)
class _Match:
    recording: int
    table: int
    away: float | None  # m, of the centre of pressure from the feet; None where nothing is loaded
    alike: float
    covered: tuple[float, float]  # s, from when to when the table has forces
    lost: float  # Share of the recording's time without forces


def pair_forces(
    recordings: Mapping[int, tuple[str, Recording]],
    marker_set: MarkerSet,
    files: Sequence[FolderFile],
) -> tuple[dict[int, ForceChoice], dict[str, str]]:
    """Recording -> its forces, and table -> why it is nobody's. `recordings`: number -> file name
    without ending, and recording with the set's labels; those of which forces are wanted.
    """
    tables = [file for file in files if file.forces is not None]
    named = [file for file in files if file.kind is FileKind.EXTERNAL_LOADS]
    loads = {
        PureWindowsPath(file.table_name).name.lower(): file for file in named
    }  # takes / and \\ alike
    matches: list[_Match] = []
    why: dict[str, str] = {}
    wanted = {stem for stem, _ in recordings.values()}
    for t, table in enumerate(tables):
        partner = find_partner(table, files)
        if partner is not None and partner.path.stem not in wanted:
            why[table.name] = f"the forces of {partner.name}, which needs none or is not used"
            continue
        for number, (stem, recording) in recordings.items():
            match = _match(number, stem, recording, marker_set, t, table)
            if isinstance(match, str):
                why.setdefault(table.name, match)
            else:
                matches.append(match)
    out: dict[int, ForceChoice] = {}
    used: set[int] = set()
    for match in sorted(matches, key=_rank):
        if match.recording in out or match.table in used:
            continue
        table = tables[match.table]
        rivals = [m for m in matches if m.recording == match.recording and m.table != match.table]
        unsure = match.away is None and match.alike < SAME_NAME
        if unsure and (rivals or len(recordings) > 1):
            why[table.name] = (
                "nothing tells whose forces these are: no foot is loaded, and no name is alike"
            )
            continue
        alike = {
            number: compare_names(stem, table.path.stem) for number, (stem, _) in recordings.items()
        }
        best = max(alike, key=lambda number: (alike[number], number == match.recording))
        rival = alike[best] >= SAME_NAME and alike[best] > alike[match.recording]
        covers = (
            "covers the time"
            if match.lost == 0.0
            else "covers {:.2f} to {:.2f} s".format(*match.covered)
        )
        parts = [f"{covers}; no foot is loaded in it"]
        if match.away is not None:
            parts = [f"{covers}, and under load acts {100 * match.away:.0f} cm from the feet"]
        if rival:
            parts.append(f"though its name says {recordings[best][0]}")
        elif match.alike >= SAME_NAME:
            parts.append("the names are alike")
        if (by := loads.get(table.path.name.lower())) is not None:
            parts.append(f"{by.name} names it")
        out[match.recording] = ForceChoice(
            file=table, reason="; ".join(parts), certain=match.away is not None and not rival
        )
        used.add(match.table)
    for t, table in enumerate(tables):
        if t not in used:
            better = "its recording has another table that fits better"
            why.setdefault(
                table.name, better if recordings else "no walk without plates of its own needs it"
            )
    return out, {table.name: why[table.name] for t, table in enumerate(tables) if t not in used}


def find_partner(table: FolderFile, files: Sequence[FolderFile]) -> FolderFile | None:
    """The recording after which a table of forces is called (`gait.csv`: `gait_forces.csv`), if
    there is one.
    """
    recordings = (
        f for f in files if f.kind is FileKind.RECORDING and compare_names(f.path.stem, "") < 1.0
    )
    return next(
        (file for file in recordings if compare_names(file.path.stem, table.path.stem) == 1.0), None
    )


def _rank(match: _Match) -> tuple[object, ...]:
    """Smallest first: little time is lost, names are alike (in steps), feet are near, then the
    order of the files.
    """
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
    """How well a table fits a recording, or why it does not."""
    if table.forces is None:
        return "it holds no forces"
    plates, time = table.forces.plates, recording.time
    step = float(np.median(np.diff(time)))
    start, stop = max(float(p.time[0]) for p in plates), min(float(p.time[-1]) for p in plates)
    low, high = max(start, float(time[0])), min(stop, float(time[-1]))
    if high - low < force_plate.STANCE_S:
        return (
            f"its forces run from {start:.2f} to {stop:.2f} s, {stem} from {time[0]:.2f} to "
            f"{time[-1]:.2f} s"
        )
    whole = start <= time[0] + step and stop >= time[-1] - step
    lost = 0.0 if whole else 1.0 - (high - low) / float(np.ptp(time))
    points, feet = _select_loaded_frames(recording, marker_set, table)
    away = _measure_distance(points, feet)
    if away is not None and away > UNDER_M:
        # in another unit, centres travel by a power of ten further than any foot
        room = float(np.max(np.nanmax(feet, axis=(0, 1)) - np.nanmin(feet, axis=(0, 1))))
        if np.ptp(points, axis=0).max() > 10.0 * room:
            scaled = {
                unit: _measure_distance(metres * points, feet) or 0.0
                for unit, metres in (("mm", 1e-3), ("cm", 1e-2))
            }
            unit = min(scaled, key=lambda name: scaled[name])
            if scaled[unit] <= UNDER_M:
                return (
                    f"its centres of pressure are in {unit}, not in m: only so are they under the "
                    f"feet of {stem}"
                )
        return f"its centres of pressure are {away:.2f} m from the feet of {stem}"
    return _Match(number, t, away, compare_names(stem, table.path.stem), (low, high), lost)


def _select_loaded_frames(
    recording: Recording, marker_set: MarkerSet, table: FolderFile
) -> tuple[Array, Array]:
    """Centres of pressure (n, 2) and foot markers (n, k, 2) in the floor's plane, m, of each plate
    in loaded frames.
    """
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
        seen = np.asarray(np.isfinite(recording.markers[:, feet]).all(axis=2)).any(axis=1)
        loaded = np.flatnonzero(
            (force > force_plate.BODY_N) & covered & seen & np.isfinite(point).all(axis=1)
        )
        points.append(point[loaded])
        frames.append(loaded)
    return np.concatenate(points), recording.markers[np.concatenate(frames)][:, feet][:, :, [0, 2]]


def _measure_distance(points: Array, feet: Array) -> float | None:
    """m, median distance of centres of pressure from the nearest foot marker; None without load."""
    away: Array = np.linalg.norm(feet - points[:, None], axis=2)
    return float(np.median(np.nanmin(away, axis=1))) if away.size else None


def compare_names(stem: str, table: str) -> float:
    """0 to 1, how alike two names are but for words that only say `forces`."""
    a, b = (re.sub(r"[^a-z0-9]", "", WORDS.sub("", name).lower()) for name in (stem, table))
    return 1.0 if a == b else difflib.SequenceMatcher(None, a, b).ratio()


def describe_empty_folder(folder: Folder) -> str:
    """That a folder has no recording, and where some are."""
    if folder.subfolders:
        below = ", ".join(f"{name} ({count})" for name, count in folder.subfolders[:6])
        return (
            f"holds no recording that can be read; folders in it do: {below}; name one of them, "
            "one person a folder"
        )
    if not folder.files:
        return "is empty; .c3d, .trc or .csv files of one person are needed"
    files = "1 file" if len(folder.files) == 1 else f"{len(folder.files)} files"
    return f"holds {files}, but no recording that can be read (.c3d, .trc or .csv)"
