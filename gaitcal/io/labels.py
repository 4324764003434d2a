"""What a file says beside its samples: names of markers, facts about the person, moments at which
feet meet the ground.

A C3D file's POINT list may hold, besides markers, everything a vendor's pipeline computed: angles,
moments, powers, joint centres, four points for each segment's axes. None of these was measured;
none may be fitted.

Its group PROCESSING is where Vicon's programs keep what was measured by hand: kg and mm, angles in
rad. EVENT is the standard's own group: TIMES is (2, n), minutes and seconds from the beginning of
the recording, as the frames count.
"""

import contextlib
import datetime
import re
import unicodedata
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, Final

import numpy as np

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

SEGMENT_POINT = re.compile(r"(?P<stem>[A-Z][A-Z0-9]{2}|\w+_M?)(?P<point>[OALP])", re.IGNORECASE)
"""Segment axes: origin, anterior, lateral, proximal, as PELO PELA PELL PELP (Vicon) or Pelvis_MO
_MA _ML _MP, in capitals or not. Only where all four are there."""


def clean(label: str) -> str:
    """The label without outer blanks; control characters and broken encodings become `?`."""
    text = label.encode("utf-8", "replace").decode("utf-8").strip()
    return "".join("?" if unicodedata.category(c) in ("Cc", "Cs", "Zl", "Zp") else c for c in text)


def common_prefix(labels: Sequence[str]) -> tuple[str, tuple[str, ...]]:
    """`Subj:` where every label begins so, else the empty string; and a note that it is taken off,
    if any.
    """
    heads = {label.partition(":")[0] if ":" in label else "" for label in labels}
    head = heads.pop() if len(heads) == 1 else ""
    prefix = head + ":" if head and all(len(label) > len(head) + 1 for label in labels) else ""
    return prefix, (f"Prefix '{prefix}' taken off the marker names.",) if prefix else ()


def unique(labels: Iterable[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Labels with every repetition numbered, `X`, `X#2`, `X#3`, and a note that tells the new
    names, if any.
    """
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
    notes = (
        (f"Marker names that occur more than once were numbered: {', '.join(renamed)}.",)
        if renamed
        else ()
    )
    return tuple(names), notes


def is_unlabelled(label: str) -> bool:
    """True for trajectories without a name."""
    return UNLABELLED.fullmatch(label) is not None


def is_number(label: str) -> bool:
    """True for computed points that are no places by their spelling: angles, moments, forces,
    powers.
    """
    return NUMBER.fullmatch(label) is not None


def axes_points(labels: Sequence[str]) -> set[str]:
    """Those of `labels` that are the four points of a segment's axes."""
    matches = {label: SEGMENT_POINT.fullmatch(label) for label in labels}
    points: dict[str, set[str]] = {}
    for match in matches.values():
        if match:
            points.setdefault(match["stem"], set()).add(match["point"].upper())
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


def times_of(events: Iterable[FootEvent], side: str, moment: FootMoment) -> list[float]:
    """Times (s) of the events of one kind."""
    return [e.time for e in events if e.side == side and e.moment is moment]


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
    """Side -> rad, from the line ankle centre to toe marker up to the foot's long axis
    (`StaticPlantFlex`).
    """
    doubtful: dict[str, tuple[str, float | None]] = field(default_factory=dict)
    """Fact, as `height` or `knee_width_r` -> what the file says that cannot be in its units, in
    words, and what it is in the only other unit that makes sense of it; None where several do, or
    none."""
    session_date: str | None = None
    """Day of the recording, as 2016-03-09."""
    birth_date: str | None = None
    """As 2008-11-30. It gives the age; of itself it goes into no result."""
    is_static: bool | None = None
    """Whether the file calls itself a static trial."""


DAYS_A_YEAR: Final = 365.2425
OLDEST: Final = 110.0
"""Years: who does not tell a date of birth often leaves 1900-01-01 in it."""


def years_between(birth_date: str | None, session_date: str | None) -> float | None:
    """Age by two dates as 2016-03-09, negative where the first is the later one; None where one is
    not known.
    """
    try:
        born, then = (datetime.date.fromisoformat(day or "") for day in (birth_date, session_date))
    except ValueError:
        return None
    return (then - born).days / DAYS_A_YEAR


@dataclass(frozen=True)
class ComputedPoints:
    """Points that another program computed: joint centres, modelled markers. Not measured, and in
    no fit.
    """

    labels: tuple[str, ...]
    points: Array
    """(nf, np, 3) m, at the frames of the recording and in its axes; NaN where not known."""


# ------------------------------------------------------------------------- facts and events of a C3D file's parameters

SIDES: Final = {"right": "r", "left": "l"}
MOMENTS: Final = {
    "foot strike": FootMoment.STRIKE,
    "heel strike": FootMoment.STRIKE,
    "initial contact": FootMoment.STRIKE,
    "foot contact": FootMoment.STRIKE,
    "foot off": FootMoment.OFF,
    "toe off": FootMoment.OFF,
}
_SESSION_DAYS: Final = ("DATE", "RECORDING_DATE", "CAPTURE_DATE", "SESSION_DATE")
_BIRTH_DAYS: Final = ("DATE_OF_BIRTH", "BIRTH_DATE")
_MM, _CM, _INCH, _NEWTON = 1e-3, 1e-2, 0.0254, 1 / 9.80665
_Range = tuple[float, float]


@dataclass(frozen=True)
class _Figure:
    """A number of PROCESSING: its parameters (of a side: without R and L), its units, and what it
    may be.
    """

    parameters: tuple[str, ...]
    units: tuple[float, ...]
    """Each in kg, m or rad; the first in which the number lies in `allowed` is the one that was
    meant.
    """
    allowed: _Range
    """kg, m, rad; outside of it a number is none of these: 0 stands where nobody filled in the
    form.
    """
    no: str = ""
    """What a number is not where none of `units` fits; then it may be in one of the `others`."""
    others: Mapping[str, float] = field(default_factory=dict)
    likely: _Range = (0.0, 0.0)
    """Of a person whose figures are in another unit than they should be: a guess has to be a likely
    one.
    """


_MASS = _Figure(
    ("Bodymass", "Mass", "Weight"),
    (1.0,),
    (2.0, 400.0),
    "mass in kg",
    {"N": _NEWTON, "g": 1e-3},
    (5.0, 250.0),
)
_HEIGHT = _Figure(
    ("Height",),
    (_MM, 1.0),
    (0.3, 2.6),
    "height in mm or m",
    {"cm": _CM, "inches": _INCH},
    (0.5, 2.3),
)
_DIAMETER = _Figure(("MarkerDiameter",), (_MM,), (0.003, 0.04))
_ASIS = _Figure(("InterAsisDistance",), (_MM,), (0.08, 0.5))
_SIDED = {
    "knee_width": _Figure(
        ("KneeWidth",), (_MM,), (0.02, 0.3), "width in mm", {"cm": _CM}, (0.05, 0.2)
    ),
    "ankle_width": _Figure(
        ("AnkleWidth",), (_MM,), (0.02, 0.3), "width in mm", {"cm": _CM}, (0.03, 0.15)
    ),
    "leg_length": _Figure(
        ("LegLength",), (_MM,), (0.15, 1.5), "length in mm", {"cm": _CM}, (0.3, 1.3)
    ),
    "static_plantarflexion": _Figure(("StaticPlantFlex",), (1.0,), (-1.5, 1.5)),
}


def facts_of(parameters: Mapping[str, Mapping[str, Any]]) -> Facts:
    """What the groups PROCESSING and SUBJECTS say; a number that cannot be meant is taken as not
    given.
    """
    group = {str(name).lower(): value for name, value in parameters.get("PROCESSING", {}).items()}
    subjects = parameters.get("SUBJECTS", {})
    doubtful: dict[str, tuple[str, float | None]] = {}

    def number(fact: str, figure: _Figure, side: str = "") -> float | None:
        names = [side.upper() + name for name in figure.parameters]
        values = {
            name: value for name in names if (value := _first_number(group.get(name.lower())))
        }
        for unit in figure.units:
            for value in values.values():
                if figure.allowed[0] <= value * unit <= figure.allowed[1]:
                    return value * unit
        for name, value in values.items():
            low, high = figure.likely
            meant = {
                unit: value * by for unit, by in figure.others.items() if low <= value * by <= high
            }
            if meant:
                si = "kg" if figure is _MASS else "m"
                words = " or ".join(f"{size:.4g} {si} if {unit}" for unit, size in meant.items())
                only = next(iter(meant.values())) if len(meant) == 1 else None
                doubtful[f"{fact}_{side}" if side else fact] = (
                    f"{name} = {value:g}: no {figure.no}; {words}",
                    only,
                )
                break
        return None

    mass, height = number("mass", _MASS), number("height", _HEIGHT)
    sided: dict[str, dict[str, float]] = {}
    for fact, figure in _SIDED.items():
        found = {side: number(fact, figure, side) for side in SIDES.values()}
        sided[fact] = {side: value for side, value in found.items() if value is not None}
    static = _first_number(subjects.get("IS_STATIC"))
    return Facts(
        name=_first_text(subjects.get("NAMES")),
        mass=mass,
        height=height,
        marker_set=_first_text(subjects.get("MARKER_SETS")),
        marker_diameter=number("marker_diameter", _DIAMETER),
        asis_distance=number("asis_distance", _ASIS),
        **sided,
        doubtful=doubtful,
        session_date=_first_day(parameters, ("TRIAL", "PROCESSING", "SUBJECTS"), _SESSION_DAYS),
        birth_date=_first_day(parameters, ("SUBJECT", "SUBJECTS", "PROCESSING"), _BIRTH_DAYS),
        is_static=True if static else None,
    )


def events_of(parameters: Mapping[str, Mapping[str, Any]]) -> tuple[FootEvent, ...]:
    """Foot strikes and offs with a side, in order of time."""
    group = parameters.get("EVENT", {})
    labels, contexts = _texts(group.get("LABELS")), _texts(group.get("CONTEXTS"))
    times = np.asarray(group.get("TIMES", ()), dtype=np.float64)
    if times.ndim != 2 or times.shape[0] != 2:
        return ()
    seconds = 60.0 * times[0] + times[1]
    events = [
        FootEvent(MOMENTS[label.lower()], SIDES[context.lower()], float(second))
        for label, context, second in zip(labels, contexts, seconds, strict=False)
        if label.lower() in MOMENTS and context.lower() in SIDES and np.isfinite(second)
    ]
    return tuple(sorted(events, key=lambda e: e.time))


def _texts(values: Any) -> list[str]:
    return [
        clean(text) if isinstance(text, str) else "" for text in ([] if values is None else values)
    ]


def _first_text(values: Any) -> str | None:
    return next((text for text in _texts(values) if text), None)


def _first_day(
    parameters: Mapping[str, Mapping[str, Any]], groups: Sequence[str], names: Sequence[str]
) -> str | None:
    """The first date among such parameters that can be read in one way only: year, month, day."""
    for group in groups:
        told = {str(name).upper(): value for name, value in parameters.get(group, {}).items()}
        for text in (_first_text(told.get(name)) or "" for name in names):
            if found := re.fullmatch(r"(\d{4})[-/.]?(\d\d)[-/.]?(\d\d)([T ].*)?", text):
                with contextlib.suppress(ValueError):
                    return datetime.date(*(int(found[k]) for k in (1, 2, 3))).isoformat()
    return None


def _first_number(values: Any) -> float | None:
    try:
        found = np.asarray(values, dtype=np.float64).ravel()
    except (TypeError, ValueError):
        return None
    return float(found[0]) if len(found) and np.isfinite(found[0]) else None
