"""Marker names: which of a file's labels are markers, and how they are spelt inside.

A C3D file's POINT list may hold, besides markers, everything a vendor's pipeline computed: angles, moments, powers,
joint centres, four points for each segment's axes. None of these was measured; none may be fitted.

What a file says beside its samples: about the person, the moments at which feet meet the ground, computed points.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from enum import Enum

from gaitcal.arrays import Array

UNLABELLED = re.compile(r"\*\d*|")
"""Trajectories the operator did not name: `*12` (Vicon) and blanks."""

NUMBER = re.compile(r"[LR]?[A-Z]\w*(Angles?|Moments?|Forces?|Powers?|GRF|ProgressAngles)")
"""Names of computed points that hold three numbers of another kind than places."""
COMPUTED = re.compile(
    r"Cent(re|er)OfMass\w*"
    rf"|{NUMBER.pattern}"
    r"|[LR]?(HJC|KJC|AJC|SJC|EJC|WJC)"
)
"""Names that vendors give to computed points; used besides the file's own lists."""

SEGMENT_POINT = re.compile(r"(?P<stem>[A-Z][A-Z0-9]{2}|\w+_M?)(?P<point>[OALP])")
"""Segment axes: origin, anterior, lateral, proximal, as PELO PELA PELL PELP (Vicon) or Pelvis_MO _MA _ML _MP. Only
where all four are there."""


def clean(label: str) -> str:
    """The label without outer blanks; control characters and broken encodings become `?`."""
    text = label.encode("utf-8", "replace").decode("utf-8").strip()
    return "".join("?" if unicodedata.category(c) in ("Cc", "Cs", "Zl", "Zp") else c for c in text)


def common_prefix(labels: Sequence[str]) -> tuple[str, tuple[str, ...]]:
    """`Subj:` where every label begins so, else the empty string; and a note that it is taken off, if any."""
    heads = {label.partition(":")[0] if ":" in label else "" for label in labels}
    head = heads.pop() if len(heads) == 1 else ""
    prefix = head + ":" if head and all(len(label) > len(head) + 1 for label in labels) else ""
    return prefix, (f"Prefix '{prefix}' taken off the marker names.",) if prefix else ()


def unique(labels: Iterable[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Labels with every repetition numbered, `X`, `X#2`, `X#3`, and a note that tells the new names, if any."""
    given = list(labels)
    spellings = set(given)
    names: list[str] = []
    used: set[str] = set()
    renamed: list[str] = []
    for label in given:
        name, count = label, 1
        while name in used or (count > 1 and name in spellings):
            count += 1
            name = f"{label}#{count}"
        used.add(name)
        names.append(name)
        if name != label:
            renamed.append(name)
    notes = (f"Marker names that occur more than once were numbered: {', '.join(renamed)}.",) if renamed else ()
    return tuple(names), notes


def is_unlabelled(label: str) -> bool:
    """True for trajectories without a name."""
    return UNLABELLED.fullmatch(label) is not None


def is_number(label: str) -> bool:
    """True for computed points that are no places by their spelling: angles, moments, forces, powers."""
    return NUMBER.fullmatch(label) is not None


def axes_points(labels: Sequence[str]) -> set[str]:
    """Those of `labels` that are the four points of a segment's axes."""
    matches = {label: SEGMENT_POINT.fullmatch(label) for label in labels}
    points: dict[str, set[str]] = {}
    for match in matches.values():
        if match:
            points.setdefault(match["stem"], set()).add(match["point"])
    whole = {stem for stem, found in points.items() if len(found) == 4}
    return {label for label, match in matches.items() if match and match["stem"] in whole}


def computed_points(labels: Sequence[str]) -> set[str]:
    """Those of `labels` that name computed points, judged by their spelling."""
    return axes_points(labels) | {label for label in labels if COMPUTED.fullmatch(label)}


class FootMoment(Enum):
    """What a foot does at an event."""

    STRIKE = "foot strike"
    OFF = "foot off"


@dataclass(frozen=True)
class FootEvent:
    """One foot meets or leaves the ground."""

    moment: FootMoment
    side: str
    """`r` or `l`."""
    time: float
    """s, on the clock of the recording."""


@dataclass(frozen=True, kw_only=True)
class Facts:
    """What a file says about the person; None, or no entry for a side, where it says nothing."""

    name: str | None = None
    mass: float | None = None
    """kg."""
    height: float | None = None
    """m."""
    marker_set: str | None = None
    """As the laboratory calls its own."""
    marker_diameter: float | None = None
    """m."""
    asis_distance: float | None = None
    """m, between the two anterior superior iliac spines."""
    knee_width: dict[str, float] = field(default_factory=dict)
    """Side -> m, across the femoral epicondyles."""
    ankle_width: dict[str, float] = field(default_factory=dict)
    """Side -> m, across the malleoli."""
    leg_length: dict[str, float] = field(default_factory=dict)
    """Side -> m, from the anterior superior iliac spine to the medial malleolus."""
    static_plantarflexion: dict[str, float] = field(default_factory=dict)
    """Side -> rad, from the line ankle centre to toe marker up to the foot's long axis (`StaticPlantFlex`)."""
    doubtful: dict[str, tuple[str, float | None]] = field(default_factory=dict)
    """Fact, as `height` or `knee_width_r` -> what the file says that cannot be in its units, in words, and what it is
    in the only other unit that makes sense of it; None where several do, or none."""
    is_static: bool | None = None
    """Whether the file calls itself a static trial."""


@dataclass(frozen=True)
class ComputedPoints:
    """Points that another program computed: joint centres, modelled markers. Not measured, and in no fit."""

    labels: tuple[str, ...]
    points: Array
    """(nf, np, 3) m, at the frames of the recording and in its axes; NaN where not known."""
