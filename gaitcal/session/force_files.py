"""Which table of forces belongs to which recording: by time, by the feet that stand where the forces act, by name.

A recording that has plates of its own needs none. For another one, a table can be its own only if it covers its time
and if, under load, the centre of pressure lies near one of the feet: the feet decide, names only where feet do not.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import PureWindowsPath

import numpy as np

from gaitcal.arrays import Array
from gaitcal.io.force_plate import BODY_N
from gaitcal.io.recording import Recording
from gaitcal.model.marker_set import MarkerSet
from gaitcal.session.folder import FileKind, FolderFile

UNDER_M = 0.25
"""Median distance, in the floor's plane, of the centre of pressure from the nearest marker of a foot under load."""
MOST_CUT = 0.5
"""Share of the recording's time that a table may leave uncovered; the trial is then cut to what it covers."""
SAME_NAME = 0.6
WORDS = re.compile(r"(grfs?|forces?|force|fp|plates?|analog|kinetics|ext|external|loads?)", re.IGNORECASE)
"""Words of names that say only that a file holds forces."""


@dataclass(frozen=True, kw_only=True)
class ForceChoice:
    """The forces of one recording."""

    file: FolderFile
    """The table, or the XML that names it."""
    reason: str
    certain: bool
    time: tuple[float, float] | None = None
    """s: the part that the forces cover, where that is not all."""


@dataclass(frozen=True)
class _Match:
    recording: int
    table: int
    away: float | None
    """m, of the centre of pressure from the feet; None where nothing is loaded."""
    alike: float
    time: tuple[float, float] | None


def pair_forces(
    recordings: Mapping[int, tuple[str, Recording]], marker_set: MarkerSet, files: Sequence[FolderFile]
) -> tuple[dict[int, ForceChoice], dict[str, str]]:
    """Recording -> its forces, and table -> why it is nobody's. `recordings`: number -> file name without ending, and
    recording with the set's labels; those of which forces are wanted.
    """
    tables = [file for file in files if file.forces is not None]
    named = [file for file in files if file.kind is FileKind.EXTERNAL_LOADS]
    loads = {PureWindowsPath(file.names).name.lower(): file for file in named}  # takes / and \\ alike
    matches: list[_Match] = []
    why: dict[str, str] = {}
    for t, table in enumerate(tables):
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
            why[table.name] = "nothing tells whose forces these are: no foot is loaded, and no name is alike"
            continue
        by = loads.get(table.path.name.lower())
        rival = _named(match, {number: stem for number, (stem, _) in recordings.items()}, table.path.stem)
        out[match.recording] = ForceChoice(
            file=table, reason=_words(match, by, rival), certain=match.away is not None and not rival, time=match.time
        )
        used.add(match.table)
    for t, table in enumerate(tables):
        if t not in used:
            better = "its recording has another table that fits better"
            why.setdefault(table.name, better if recordings else "no walk without plates of its own needs it")
    return out, {table.name: why[table.name] for t, table in enumerate(tables) if t not in used}


def _rank(match: _Match) -> tuple[object, ...]:
    """Smallest first: no time is lost, names are alike (in steps), the feet are near, then the order of the files."""
    away = np.inf if match.away is None else match.away
    return (match.away is None, match.time is not None, -round(match.alike, 1), away, match.recording, match.table)


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
    if high - low < MOST_CUT * float(np.ptp(time)):
        return f"its forces run from {start:.2f} to {stop:.2f} s, {stem} from {time[0]:.2f} to {time[-1]:.2f} s"
    cut = None
    if start > time[0] + step or stop < time[-1] - step:
        inside = time[(time >= start) & (time <= stop)]
        cut = (float(inside[0]), float(inside[-1]))
    away = _from_feet(recording, marker_set, table)
    if away is not None and away > UNDER_M:
        return f"its centres of pressure are {away:.2f} m from the feet of {stem}"
    return _Match(number, t, away, names_alike(stem, table.path.stem), cut)


def _from_feet(recording: Recording, marker_set: MarkerSet, table: FolderFile) -> float | None:
    """m, median distance of centres of pressure under load from the nearest foot marker; None without load."""
    feet = [i for i, m in enumerate(recording.labels) if marker_set.segment_of.get(m, "").startswith("foot")]
    distances: list[float] = []
    for plate in table.forces.plates if table.forces else ():
        point = np.stack([np.interp(recording.time, plate.time, plate.point[:, k]) for k in (0, 2)], axis=1)
        force = np.interp(recording.time, plate.time, np.nan_to_num(plate.force[:, 1]))
        covered = (recording.time >= plate.time[0]) & (recording.time <= plate.time[-1])
        loaded = np.flatnonzero((force > BODY_N) & covered & np.isfinite(point).all(axis=1))
        away: Array = np.linalg.norm(recording.markers[loaded][:, feet][:, :, [0, 2]] - point[loaded][:, None], axis=2)
        away = away[np.isfinite(away).any(axis=1)]
        distances.extend(np.nanmin(away, axis=1).tolist() if away.size else ())
    return float(np.median(distances)) if distances else None


def names_alike(stem: str, table: str) -> float:
    """0 to 1, how alike two names are but for words that only say `forces`."""
    a, b = (re.sub(r"[^a-z0-9]", "", WORDS.sub("", name).lower()) for name in (stem, table))
    return 1.0 if a == b else difflib.SequenceMatcher(None, a, b).ratio()


def _named(match: _Match, stems: Mapping[int, str], table: str) -> str:
    """Another recording whose name fits the table better than that of the one it is paired with; empty where none."""
    alike = {number: names_alike(stem, table) for number, stem in stems.items()}
    best = max(alike, key=lambda number: (alike[number], number == match.recording))
    return stems[best] if alike[best] >= SAME_NAME and alike[best] > alike[match.recording] else ""


def _words(match: _Match, named: FolderFile | None, rival: str) -> str:
    parts = []
    if match.away is not None:
        parts.append(f"covers the time, and under load acts {100 * match.away:.0f} cm from the feet")
    else:
        parts.append("covers the time; no foot is loaded in it")
    if rival:
        parts.append(f"though its name says {rival}")
    elif match.alike >= SAME_NAME:
        parts.append("the names are alike")
    if named is not None:
        parts.append(f"{named.name} names it")
    return "; ".join(parts)
