"""Interpret marker labels, and read subject data and foot events from the parameters of a C3D file.

The POINT list of a C3D file may contain, besides markers, outputs of a vendor's program: angles,
moments, powers, joint centres, four points for each segment's axes. These were not measured and
must not be fitted.

Vicon's programs keep manual measurements in the group PROCESSING: kg and mm, angles in rad. EVENT
is the standard's group: TIMES is (2, n), minutes and seconds from the beginning of the recording.
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
"""Trajectories without a name: `*12` (Vicon) and blanks."""

NON_POSITION = re.compile(r"[LR]?[A-Z]\w*(Angles?|Moments?|Forces?|Powers?|GRF|ProgressAngles)")
"""Names of computed points that are no positions: angles, moments, forces, powers."""
COMPUTED_POINT = re.compile(
    r"Cent(re|er)OfMass\w*"
    rf"|{NON_POSITION.pattern}"
    r"|[LR]?(HJC|KJC|AJC|SJC|EJC|WJC)"
)
"""Names that vendors give to computed points; used besides the lists of the file."""

SEGMENT_POINT = re.compile(r"(?P<stem>[A-Z][A-Z0-9]{2}|\w+_M?)(?P<point>[OALP])", re.IGNORECASE)
"""Points of segment axes: origin, anterior, lateral, proximal, in upper or lower case.

Examples are PELO PELA PELL PELP (Vicon) and Pelvis_MO _MA _ML _MP. All four must be present.
"""


def clean_label(label: str) -> str:
    """Strip a label, and replace control characters and broken encodings by `?`.

    `label`: label as in the file. Returns: printable text.
    """
    text = label.encode("utf-8", "replace").decode("utf-8").strip()
    return "".join("?" if unicodedata.category(c) in ("Cc", "Cs", "Zl", "Zp") else c for c in text)


def find_common_prefix(labels: Sequence[str]) -> tuple[str, tuple[str, ...]]:
    """Find the prefix `Subj:` that all labels share.

    Parameters
    ----------
    labels
        Labels of a file.

    Returns
    -------
    prefix, notes
        Empty if there is none; else with a note that it is removed.
    """
    heads = {label.partition(":")[0] if ":" in label else "" for label in labels}
    head = heads.pop() if len(heads) == 1 else ""
    prefix = head + ":" if head and all(len(label) > len(head) + 1 for label in labels) else ""
    return prefix, (f"Prefix '{prefix}' taken off the marker names.",) if prefix else ()


def number_repetitions(labels: Iterable[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Make labels unique by numbering repetitions: `X`, `X#2`, `X#3`.

    Parameters
    ----------
    labels
        Labels of a file.

    Returns
    -------
    labels, notes
        Unique labels, and a note with the new names if any.
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
    """Return whether a trajectory has no name."""
    return UNLABELLED.fullmatch(label) is not None


def is_number(label: str) -> bool:
    """Return whether a computed point is no position by its name: angle, moment, force or power."""
    return NON_POSITION.fullmatch(label) is not None


def find_axes_points(labels: Sequence[str]) -> set[str]:
    """Find the labels of complete sets of four points of a segment's axes.

    `labels`: labels of a file. Returns: those of `labels`.
    """
    matches = {label: SEGMENT_POINT.fullmatch(label) for label in labels}
    points: dict[str, set[str]] = {}
    for match in matches.values():
        if match:
            points.setdefault(match["stem"], set()).add(match["point"].upper())
    whole = {stem for stem, found in points.items() if len(found) == 4}
    return {label for label, match in matches.items() if match and match["stem"] in whole}


def find_computed_points(labels: Sequence[str]) -> set[str]:
    """Find the labels that are computed points by their names.

    `labels`: labels of a file. Returns: those of `labels`.
    """
    return find_axes_points(labels) | {label for label in labels if COMPUTED_POINT.fullmatch(label)}


class FootMoment(Enum):
    """Type of a foot event."""

    STRIKE = "foot strike"
    OFF = "foot off"


@dataclass(frozen=True)
class FootEvent:
    """Instant at which a foot meets or leaves the ground."""

    moment: FootMoment
    side: str
    """`r` or `l`."""
    time: float
    """s, on the time axis of the recording."""


def select_event_times(events: Iterable[FootEvent], side: str, moment: FootMoment) -> list[float]:
    """Select the times of the events of one side and type.

    Parameters
    ----------
    events
        Foot events.
    side
        "r" or "l".
    moment
        Type of event.

    Returns
    -------
    list of float
        s, in the order of `events`.
    """
    return [e.time for e in events if e.side == side and e.moment is moment]


@dataclass(frozen=True, kw_only=True)
class Facts:
    """Subject data of a file; None, or no entry for a side, where it has none."""

    name: str | None = None
    mass: float | None = None
    """kg."""
    height: float | None = None
    """m."""
    marker_set: str | None = None
    """Name of the laboratory's set."""
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
    """Fact, such as `height` or `knee_width_r` -> description and proposed value.

    The file has a number that is impossible in its units. The proposed value (kg, m) is the one in
    the only other unit that makes sense; None if there are several or none.
    """
    session_date: str | None = None
    """Day of the recording, as 2016-03-09."""
    birth_date: str | None = None
    """As 2008-11-30. It is used for the age and appears in no result."""
    is_static: bool | None = None
    """Whether the file is marked as a static trial."""


DAYS_A_YEAR: Final = 365.2425
GREATEST_AGE: Final = 110.0
"""Years. An unknown date of birth is often 1900-01-01."""


def compute_age(birth_date: str | None, session_date: str | None) -> float | None:
    """Compute the age from two dates such as 2016-03-09.

    Parameters
    ----------
    birth_date, session_date
        Dates, or None.

    Returns
    -------
    float or None
        Years, negative if the dates are reversed; None if a date is missing or invalid.
    """
    try:
        born, then = (datetime.date.fromisoformat(day or "") for day in (birth_date, session_date))
    except ValueError:
        return None
    return (then - born).days / DAYS_A_YEAR


@dataclass(frozen=True)
class ComputedPoints:
    """Points that another program computed, such as joint centres; not measured, never fitted."""

    labels: tuple[str, ...]
    points: Array
    """(nf, np, 3) m, at the frames of the recording and in its axes; NaN where not known."""


# ------------------------------------------------------ facts and events of a C3D file's parameters

SIDES: Final = {"right": "r", "left": "l"}
EVENT_MOMENTS: Final = {
    "foot strike": FootMoment.STRIKE,
    "heel strike": FootMoment.STRIKE,
    "initial contact": FootMoment.STRIKE,
    "foot contact": FootMoment.STRIKE,
    "foot off": FootMoment.OFF,
    "toe off": FootMoment.OFF,
}
_SESSION_DATES: Final = ("DATE", "RECORDING_DATE", "CAPTURE_DATE", "SESSION_DATE")
_BIRTH_DATES: Final = ("DATE_OF_BIRTH", "BIRTH_DATE")
_MM, _CM, _INCH, _NEWTON = 1e-3, 1e-2, 0.0254, 1 / 9.80665
_Range = tuple[float, float]


@dataclass(frozen=True)
class _Figure:
    """Number of PROCESSING: its parameters (without R and L of a side), units and range."""

    parameters: tuple[str, ...]
    units: tuple[float, ...]
    """In kg, m or rad; the first in which the number is in `allowed` is used."""
    allowed: _Range
    """kg, m, rad. A number outside is not a measurement; forms that were not filled in hold 0."""
    no: str = ""
    """What a number is not, if none of `units` fits; then it may be in one of the `others`."""
    others: Mapping[str, float] = field(default_factory=dict)
    likely: _Range = (0.0, 0.0)
    """Range in which a number in another unit is accepted as a proposal."""


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


def parse_facts(parameters: Mapping[str, Mapping[str, Any]]) -> Facts:
    """Parse the subject data of the groups PROCESSING, SUBJECTS and TRIAL.

    Parameters
    ----------
    parameters
        Group -> parameter -> value.

    Returns
    -------
    Facts
        SI units; an impossible number counts as not given and may be in `doubtful`.
    """
    group = {str(name).lower(): value for name, value in parameters.get("PROCESSING", {}).items()}
    subjects = parameters.get("SUBJECTS", {})
    doubtful: dict[str, tuple[str, float | None]] = {}

    def number(fact: str, figure: _Figure, side: str = "") -> float | None:
        names = [side.upper() + name for name in figure.parameters]
        values = {
            name: value for name in names if (value := _find_first_number(group.get(name.lower())))
        }
        for unit in figure.units:
            for value in values.values():
                if figure.allowed[0] <= value * unit <= figure.allowed[1]:
                    return value * unit
        # No unit fits: propose the value in another one for the first number that allows it
        for name, value in values.items():
            if proposal := _propose_unit(name, value, figure):
                doubtful[f"{fact}_{side}" if side else fact] = proposal
                break
        return None

    mass, height = number("mass", _MASS), number("height", _HEIGHT)
    sided: dict[str, dict[str, float]] = {}
    for fact, figure in _SIDED.items():
        found = {side: number(fact, figure, side) for side in SIDES.values()}
        sided[fact] = {side: value for side, value in found.items() if value is not None}
    static = _find_first_number(subjects.get("IS_STATIC"))
    return Facts(
        name=_find_first_text(subjects.get("NAMES")),
        mass=mass,
        height=height,
        marker_set=_find_first_text(subjects.get("MARKER_SETS")),
        marker_diameter=number("marker_diameter", _DIAMETER),
        asis_distance=number("asis_distance", _ASIS),
        **sided,
        doubtful=doubtful,
        session_date=_find_first_date(
            parameters, ("TRIAL", "PROCESSING", "SUBJECTS"), _SESSION_DATES
        ),
        birth_date=_find_first_date(
            parameters, ("SUBJECT", "SUBJECTS", "PROCESSING"), _BIRTH_DATES
        ),
        is_static=True if static else None,
    )


def _propose_unit(name: str, value: float, figure: _Figure) -> tuple[str, float | None] | None:
    """Describe an impossible number, with its value (kg, m) if a single other unit is likely."""
    low, high = figure.likely
    likely = {unit: value * by for unit, by in figure.others.items() if low <= value * by <= high}
    if not likely:
        return None
    si = "kg" if figure is _MASS else "m"
    proposals = " or ".join(f"{size:.4g} {si} if {unit}" for unit, size in likely.items())
    only = next(iter(likely.values())) if len(likely) == 1 else None
    return f"{name} = {value:g}: no {figure.no}; {proposals}", only


def parse_events(parameters: Mapping[str, Mapping[str, Any]]) -> tuple[FootEvent, ...]:
    """Parse foot strikes and offs that have a side.

    Parameters
    ----------
    parameters
        Group -> parameter -> value.

    Returns
    -------
    tuple of FootEvent
        In order of time.
    """
    group = parameters.get("EVENT", {})
    labels, contexts = _clean_texts(group.get("LABELS")), _clean_texts(group.get("CONTEXTS"))
    times = np.asarray(group.get("TIMES", ()), dtype=np.float64)
    if times.ndim != 2 or times.shape[0] != 2:
        return ()
    seconds = 60.0 * times[0] + times[1]
    events = []
    for label, context, second in zip(labels, contexts, seconds, strict=False):
        if label.lower() in EVENT_MOMENTS and context.lower() in SIDES and np.isfinite(second):
            events.append(
                FootEvent(EVENT_MOMENTS[label.lower()], SIDES[context.lower()], float(second))
            )
    return tuple(sorted(events, key=lambda e: e.time))


def _clean_texts(values: Any) -> list[str]:
    return [
        clean_label(text) if isinstance(text, str) else ""
        for text in ([] if values is None else values)
    ]


def _find_first_text(values: Any) -> str | None:
    return next((text for text in _clean_texts(values) if text), None)


def _find_first_date(
    parameters: Mapping[str, Mapping[str, Any]], groups: Sequence[str], names: Sequence[str]
) -> str | None:
    """Find the first date that is unambiguous: year, month, day."""
    for group in groups:
        given = {str(name).upper(): value for name, value in parameters.get(group, {}).items()}
        for text in (_find_first_text(given.get(name)) or "" for name in names):
            if found := re.fullmatch(r"(\d{4})[-/.]?(\d\d)[-/.]?(\d\d)([T ].*)?", text):
                with contextlib.suppress(ValueError):
                    return datetime.date(*(int(found[k]) for k in (1, 2, 3))).isoformat()
    return None


def _find_first_number(values: Any) -> float | None:
    try:
        found = np.asarray(values, dtype=np.float64).ravel()
    except (TypeError, ValueError):
        return None
    return float(found[0]) if len(found) and np.isfinite(found[0]) else None
