"""Gait cycles from foot strike to foot strike, and the table of strides (`cycles.csv`).

Signals are resampled to 0 to 100 % of a cycle,

    percent(t) = 100 (t - t_strike) / (t_next strike - t_strike).

Strikes and toe-offs come from `gait/events.py`, each with its source. Two strikes between which
events show that a strike is missing make no cycle.

A variable of the table of strides is named after its coordinate, without the side of its leg. An
ending gives the kind of quantity: `hip_flexion` (deg), `hip_flexion_moment` (N m). A further kind
is one more member of `CurveKind`.
"""

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Final

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.errors import Code, InputError
from gaitcal.io.labels import FootEvent
from gaitcal.io.recording import find_runs
from gaitcal.model.coordinates import COORDINATE_TABLE, GROUPS, LEG_GROUPS, LOCKED, SEGMENT_ANGLES

if TYPE_CHECKING:
    import pandas as pd

SHORTEST_PHASE = 0.1
"""s: a shorter contact, or a shorter swing, is a flicker of the threshold."""
SINGLE = float(np.finfo(np.float32).eps)
"""Relative rounding of times in single precision."""
CYCLE_RANGE = (0.4, 4.0)
"""s, duration of a stride: from running to very slow pathological gait."""
POINTS = 101
"""Points of a cycle: 0, 1, ..., 100 %."""


class EventSource(Enum):
    """Source of an event, in order of precedence."""

    PERSON = "corrected"
    """A person, in `events.csv`; all other sources are ignored then."""
    FILE = "file"
    """Events in the file of the recording, where they agree with forces and motion."""
    PLATES = "plates"
    """A force plate becomes loaded, or unloaded."""
    MOTION = "motion"
    """The foot comes to rest, or leaves."""


_SOURCE_LABELS = {
    EventSource.PERSON: "corrected by hand",
    EventSource.FILE: "the file's events",
    EventSource.PLATES: "force plates",
    EventSource.MOTION: "the motion of the feet",
}


@dataclass(frozen=True)
class GaitEvent(FootEvent):
    """Strike or off of one foot, and the source of its time."""

    source: EventSource


def describe_sources(sources: Iterable[EventSource]) -> str:
    """Describe the sources of events.

    Parameters
    ----------
    sources : iterable of EventSource
        Sources, in any order.

    Returns
    -------
    str
        Each source once, in order of precedence: `force plates and the motion of the feet`.
    """
    found = set(sources)
    return " and ".join(label for source, label in _SOURCE_LABELS.items() if source in found)


@dataclass(frozen=True)
class FootEvents:
    """Times (s, increasing) at which one foot meets and leaves the ground."""

    strikes: Array
    toe_offs: Array
    sources: tuple[EventSource, ...] = ()
    """Source of each strike."""


@dataclass(frozen=True)
class GaitCycle:
    """One stride of one foot, or one repetition of another activity."""

    start: float
    """s, foot strike."""
    stop: float
    """s, next strike of the same foot."""
    toe_off: float | None
    """s, end of stance; None where it is not known."""
    sources: tuple[EventSource, ...] = ()
    """Sources of the first and of the second strike."""
    parts: tuple[tuple[str, float], ...] = ()
    """Phases of a repetition in order, each with its end (s)."""

    def compute_percent(self, time: Array | float) -> Array:
        """Compute the percent of the cycle at the times `time` (s, any shape)."""
        return 100.0 * (np.asarray(time) - self.start) / (self.stop - self.start)

    @property
    def stance(self) -> float | None:
        """Percent of the cycle at which stance ends; None where the off is not known."""
        return None if self.toe_off is None else float(self.compute_percent(self.toe_off))

    @property
    def phases(self) -> list[str]:
        """Name of the phase at 0, 1, ... 100 %; empty where the off of a stride is not known."""
        parts = self.parts
        if not parts and self.toe_off is None:
            parts = (("", self.stop),)
        elif not parts and self.toe_off is not None:
            parts = (("stance", self.toe_off), ("swing", self.stop))
        names, ends = zip(*parts, strict=True)
        times = np.linspace(self.start, self.stop, POINTS)
        return [names[k] for k in np.searchsorted(ends[:-1], times, side="right")]


def is_stride(start: float, stop: float, foot: FootEvents, other: FootEvents | None = None) -> bool:
    """Check that two consecutive strikes of a foot enclose one stride.

    A strike is missing between them where the foot leaves the ground twice, or where the other foot
    strikes twice.

    Parameters
    ----------
    start, stop : float
        s, times of the two strikes.
    foot, other : FootEvents
        Events of this foot and, where known, of the other one.

    Returns
    -------
    bool
        True where the duration is within `CYCLE_RANGE` and no strike is missing.
    """
    if not CYCLE_RANGE[0] <= stop - start <= CYCLE_RANGE[1]:
        return False
    other_strikes = np.array([]) if other is None else other.strikes
    return (
        len(select_between(foot.toe_offs, start, stop)) < 2
        and len(select_between(other_strikes, start, stop)) < 2
    )


def select_between(times: Array, start: float, stop: float) -> Array:
    """Select those of `times` (s, 1-D) after `start` and before `stop`."""
    return times[(times > start) & (times < stop)]


def find_gait_cycles(events: FootEvents, other: FootEvents | None = None) -> tuple[GaitCycle, ...]:
    """Find all complete cycles of one foot, in order of time.

    Parameters
    ----------
    events : FootEvents
        Events of this foot.
    other : FootEvents, optional
        Events of the other foot, which also show missing strikes.

    Returns
    -------
    tuple of GaitCycle
    """
    cycles = []
    for k, (start, stop) in enumerate(itertools.pairwise(events.strikes.tolist())):
        if is_stride(start, stop, events, other):
            off = select_between(events.toe_offs, start, stop)
            cycles.append(
                GaitCycle(
                    start, stop, float(off[0]) if len(off) else None, events.sources[k : k + 2]
                )
            )
    return tuple(cycles)


def list_contact_changes(foot: FootEvents) -> list[tuple[float, bool]]:
    """List the times (s) at which a foot's contact changes, and whether it is down afterwards."""
    return sorted(
        [(t, True) for t in foot.strikes.tolist()] + [(t, False) for t in foot.toe_offs.tolist()]
    )


def remove_flicker(time: Array, state: BoolArray) -> BoolArray:
    """Close gaps of contact shorter than `SHORTEST_PHASE`, then remove contacts shorter than that.

    Parameters
    ----------
    time : (nf,) Array
        s.
    state : (nf,) BoolArray
        Whether the foot is loaded.

    Returns
    -------
    (nf,) BoolArray
        The state at both ends of the trial stays.
    """
    out = state.copy()
    for value in (False, True):
        for run in find_runs(out == value):
            inner = run.start > 0 and run.stop < len(time)
            if inner and time[run.stop] - time[run.start] < SHORTEST_PHASE:
                out[run] = not value
    return out


def normalise(time: Array, values: Array, cycle: GaitCycle, points: int = POINTS) -> Array:
    """Resample a signal at equal steps of a cycle, linear between frames.

    Parameters
    ----------
    time : (nf,) Array
        s.
    values : (nf, ...) Array
        Signal. Points between a NaN frame and its neighbours become NaN.
    cycle : GaitCycle
        Cycle over which to resample.
    points : int
        Number of points, 0 and 100 % included.

    Returns
    -------
    (points, ...) Array
    """
    return resample(time, values, np.linspace(cycle.start, cycle.stop, points))


def find_valid_percents(time: Array, valid: BoolArray, cycle: GaitCycle) -> BoolArray:
    """Find the percents of a cycle at which a signal is valid, given its valid frames (nf,)."""
    return np.isfinite(normalise(time, np.where(valid, 1.0, np.nan), cycle))


def resample(time: Array, values: Array, at: Array) -> Array:
    """Resample a signal at given times, linear between frames.

    A time that equals a frame up to the rounding of single precision takes nothing from a NaN
    neighbour: C3D files store the times of their events in single precision.

    Parameters
    ----------
    time : (nf,) Array
        s, increasing.
    values : (nf, ...) Array
        Signal; NaN in gaps.
    at : (n,) Array
        s.

    Returns
    -------
    (n, ...) Array
        NaN in gaps and outside of the trial.
    """
    right = np.clip(np.searchsorted(time, at), 1, len(time) - 1)
    left = right - 1
    step, ends = time[right] - time[left], (-1, *([1] * (values.ndim - 1)))
    share, rounding = (at - time[left]) / step, SINGLE * np.abs(at) / step
    before, after, part = values[left], values[right], share.reshape(ends)
    is_left, is_right = ((np.abs(share - side) <= rounding).reshape(ends) for side in (0.0, 1.0))
    out: Array = before + part * (after - before)
    # At a frame (up to rounding) the value is that of the frame, also where its neighbour is NaN.
    out = np.where((part == 0.0) | (is_left & np.isnan(after)), before, out)
    out = np.where((part == 1.0) | (is_right & np.isnan(before)), after, out)
    out[(share < -rounding) | (share > 1.0 + rounding)] = np.nan
    return out


def select_best_cycle(cycles: Sequence[GaitCycle], time: Array, valid: BoolArray) -> GaitCycle:
    """Select the cycle with the largest share of valid frames (nf,); the first among equals."""
    return max(cycles, key=lambda c: float(valid[(time >= c.start) & (time <= c.stop)].mean()))


class CurveKind(Enum):
    """Quantity of a variable: `ending` of its name, `unit` in tables, `label` on pages."""

    ANGLE = ("", "deg", "angle")
    MOMENT = ("_moment", "N m", "moment")
    POWER = ("_power", "W", "power")
    FORCE = ("_force", "N", "force")

    def __init__(self, ending: str, unit: str, label: str) -> None:
        self.ending, self.unit, self.label = ending, unit, label


GROUND_REACTION = "ground_reaction_vertical"
"""Upward force of the ground on the foot of that side, N: a force whose name has no ending."""


def get_curve_kind(variable: str) -> CurveKind:
    """Get the kind of a variable.

    Parameters
    ----------
    variable : str
        Variable of `cycles.csv`.

    Returns
    -------
    CurveKind
        `knee_angle` is an angle, `knee_angle_moment` a moment.
    """
    if variable.startswith("ground_reaction_"):
        return CurveKind.FORCE
    return next(
        (kind for kind in CurveKind if kind.ending and variable.endswith(kind.ending)),
        CurveKind.ANGLE,
    )


def get_unit(variable: str) -> str:
    """Get the unit of a variable of `cycles.csv`: `deg`, `N m`, `W` or `N`."""
    return get_curve_kind(variable).unit


def get_coordinate(variable: str) -> str:
    """Get the coordinate of a variable.

    Parameters
    ----------
    variable : str
        Variable of `cycles.csv`.

    Returns
    -------
    str
        Coordinate without a side: `knee_angle_moment` -> `knee_angle`.
    """
    kind = get_curve_kind(variable)
    return variable.removesuffix(kind.ending) if kind.ending else variable


def list_variables() -> tuple[str, ...]:
    """List every variable that a table of strides may hold.

    Returns
    -------
    tuple of str
        Without sides; coordinates of the arms are left out.
    """
    rows = [row for row in COORDINATE_TABLE.values() if row.group != "arm"]
    angles = tuple(row.name for row in rows if row.name not in LOCKED)
    moved = (*(n for n in angles if COORDINATE_TABLE[n].group != "pelvis"), *LOCKED)
    powers = (*moved, *(GROUPS[key].power for key in LEG_GROUPS))
    return (
        *angles,
        *SEGMENT_ANGLES,
        *(f"{name}{CurveKind.MOMENT.ending}" for name in moved),
        *(f"{name}{CurveKind.POWER.ending}" for name in powers),
        GROUND_REACTION,
    )


CYCLE_COLUMNS: Final = (
    "person",
    "session",
    "trial",
    "side",
    "stride",
    "percent",
    "variable",
    "value",
    "se",
    "valid",
    "se_stride",
    "turn",
    "activity",
    "phase",
)
WALKING: Final = "gait"
"""`activity` of strides of walks. That of any other activity is the name of its trial."""
CONVENTION_COLUMNS: Final = ("unit", "positive")
"""Further columns that describe the convention of a table (`gaitcal export --format cycles`)."""
_NAMES: Final = {"person": "", "session": "", "activity": WALKING, "phase": ""}
"""Columns of text -> value where a table lacks them."""
_LACKING: Final = ("se", "se_stride", "turn")
"""Columns of numbers that a table or a stride may lack."""
_WHOLE: Final = ("stride", "percent", "valid")
"""Columns of whole numbers."""
_NEEDED: Final = tuple(name for name in CYCLE_COLUMNS if name not in (*_NAMES, *_LACKING))


def _make_error(text: str, source: object, field: str | None = None) -> InputError:
    """Make the error of a table of strides."""
    return InputError(text, source=source, field=field, code=Code.STRIDE_TABLE)


def validate_stride_table(table: "pd.DataFrame", source: object = None) -> "pd.DataFrame":
    """Validate a table of strides and convert its columns to their types.

    A person or session without a name becomes empty text. Strides without an activity are of walks.
    Standard errors and turns that the table lacks become NaN.

    Parameters
    ----------
    table : pandas.DataFrame
        Table as `gaitcal.cycles` makes it, or as pandas reads it from a file (columns of text).
    source : object, optional
        File that error messages name.

    Returns
    -------
    pandas.DataFrame
        Columns `CYCLE_COLUMNS`, then all others of `table`.

    Raises
    ------
    InputError
        A column is missing, or holds text where a number is needed.
    """
    missing = [name for name in _NEEDED if name not in table]
    if missing:
        found = ", ".join(map(str, table.columns[: len(CYCLE_COLUMNS)]))
        without = f"found the columns {found}, without {', '.join(missing)}"
        allowed = "those of cycles.csv, separated by commas"
        raise _make_error(f"is not a table of strides: {without}; allowed: {allowed}", source)
    # Columns that a table may lack are NaN; columns with a stride's number must be complete.
    numbers = {
        name: _convert_column(table, name, source) for name in ("value", *_LACKING) if name in table
    }
    for name in _WHOLE:
        values = _convert_column(table, name, source)
        if not np.isfinite(values).all():
            row = int(np.flatnonzero(~np.isfinite(values))[0]) + 1
            allowed = (
                "a whole number (a reader that takes # for a comment cuts lines with # in a name: "
                "use gaitcal.read_cycles)"
            )
            raise _make_error(f"found nothing in row {row}; allowed: {allowed}", source, name)
        numbers[name] = values.astype(int)
    names = {
        n: table[n].where(table[n].notna(), default) if n in table else default
        for n, default in _NAMES.items()
    }
    lacking = {name: np.nan for name in _LACKING if name not in table}
    further = [name for name in table.columns if name not in CYCLE_COLUMNS]
    return table.assign(**names, **numbers, **lacking)[[*CYCLE_COLUMNS, *further]]


def _convert_column(table: "pd.DataFrame", name: str, source: object) -> "pd.Series":
    """Convert a column of text to floats; raise InputError at text that is no number."""
    import pandas as pd

    text = table[name]
    if pd.api.types.is_numeric_dtype(text):
        return text.astype(np.float64)
    numbers = pd.to_numeric(text, errors="coerce").astype(np.float64)
    # Empty cells and `nan` are missing values, any other text is an error.
    wrong = np.flatnonzero(numbers.isna() & text.notna() & (text.astype(str).str.strip() != ""))
    first = str(text.iloc[wrong[0]]) if len(wrong) else "nan"
    if first.lower() != "nan":
        raise _make_error(f"found '{first}' in row {wrong[0] + 1}; allowed: a number", source, name)
    return numbers


def read_conventions(strides: "pd.DataFrame") -> dict[str, tuple[str, str]]:
    """Read the unit and the positive sense of each variable of a table of strides.

    Parameters
    ----------
    strides : pandas.DataFrame
        Table of strides, with or without the columns `CONVENTION_COLUMNS`.

    Returns
    -------
    dict
        Variable -> unit and positive sense; the sense is empty where the table has OpenSim's signs.

    Raises
    ------
    InputError
        A variable appears in two conventions.
    """
    if not any(name in strides for name in CONVENTION_COLUMNS):
        return {str(name): (get_unit(str(name)), "") for name in strides["variable"].unique()}
    columns = (
        strides.reindex(columns=["variable", *CONVENTION_COLUMNS]).fillna("").drop_duplicates()
    )
    out: dict[str, tuple[str, str]] = {}
    for variable, unit, positive in columns.itertuples(index=False, name=None):
        convention = (unit or get_unit(variable), positive)
        known = out.setdefault(variable, convention)
        if known != convention:
            both = " and as ".join(f"[{u}] {p}".strip() for u, p in (known, convention))
            raise _make_error(
                f"found {variable} as {both}; allowed: one convention", None, "strides"
            )
    return out
