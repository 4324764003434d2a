"""Gait cycles: from one foot strike to the next of the same foot, and the table of strides.

Signals are brought to 0 to 100 % of a cycle,

    percent(t) = 100 (t - t_strike) / (t_next strike - t_strike).

Strikes and toe-offs come from `gait/events.py`, each with its source. A cycle inside which events
show that a strike is missing is none.

A variable of the table of strides (`cycles.csv`) is named after its coordinate, without the side of
its leg; an ending says what it is if not the angle: `hip_flexion` (deg), `hip_flexion_moment` (N
m). A further kind is one more member of `Kind`.
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

SHORTEST_PHASE = 0.1  # s: a shorter contact, or a shorter swing, is a flicker of the threshold
SINGLE = float(np.finfo(np.float32).eps)  # relative rounding of times in single precision
CYCLE_RANGE = (
    0.4,
    4.0,
)  # s: from running to very slow pathological gait; anything else is no stride
POINTS = 101  # 0, 1, ..., 100 %


class EventSource(Enum):
    """What tells an event, the first that there is."""

    PERSON = "corrected"  # A person, in `events.csv`: nothing else is asked then
    FILE = "file"  # The recording's own list of events, where it fits forces and motion
    PLATES = "plates"  # A force plate becomes loaded, or unloaded
    MOTION = "motion"  # The foot comes to rest, or leaves


_SOURCE_LABELS = {
    EventSource.PERSON: "corrected by hand",
    EventSource.FILE: "the file's events",
    EventSource.PLATES: "force plates",
    EventSource.MOTION: "the motion of the feet",
}


@dataclass(frozen=True)
class GaitEvent(FootEvent):
    """One foot meets or leaves the ground, and how this is known."""

    source: EventSource


def describe_sources(sources: Iterable[EventSource]) -> str:
    """`force plates and the motion of the feet`: each source once, the best first; empty without
    sources.
    """
    found = set(sources)
    return " and ".join(words for source, words in _SOURCE_LABELS.items() if source in found)


@dataclass(frozen=True)
class FootEvents:
    """When one foot meets and leaves the ground, s, increasing."""

    strikes: Array
    toe_offs: Array
    sources: tuple[EventSource, ...] = ()  # of each strike


@dataclass(frozen=True)
class GaitCycle:
    """One stride of one foot, or one repetition of another activity."""

    start: float  # s, foot strike
    stop: float  # s, next strike of the same foot
    toe_off: float | None  # s, end of stance; None where it is not known
    sources: tuple[EventSource, ...] = ()  # of its first and of its second strike
    parts: tuple[
        tuple[str, float], ...
    ] = ()  # of a repetition, in order: phase, and when it ends, s

    def compute_percent(self, time: Array | float) -> Array:
        """Percent of the cycle at `time` (s)."""
        return 100.0 * (np.asarray(time) - self.start) / (self.stop - self.start)

    @property
    def stance(self) -> float | None:
        """Percent at which stance ends."""
        return None if self.toe_off is None else float(self.compute_percent(self.toe_off))

    @property
    def phases(self) -> list[str]:
        """Phase at 0, 1, ... 100 %: of a repetition its `parts`, else stance and swing; empty: not
        known.
        """
        of_stride = (
            (("", self.stop),)
            if self.toe_off is None
            else (("stance", self.toe_off), ("swing", self.stop))
        )
        names, ends = zip(*(self.parts or of_stride), strict=True)
        at = np.searchsorted(ends[:-1], np.linspace(self.start, self.stop, POINTS), side="right")
        return [names[k] for k in at]


def is_stride(start: float, stop: float, foot: FootEvents, other: FootEvents | None = None) -> bool:
    """Whether a foot makes one stride from its strike at `start` (s) to the next one that is known,
    at `stop`.

    Two offs of its own between them, or two strikes of the other foot, and a strike of its own is
    missing there.
    """
    long_enough = CYCLE_RANGE[0] <= stop - start <= CYCLE_RANGE[1]
    theirs = np.array([]) if other is None else other.strikes
    return (
        long_enough
        and len(select_between(foot.toe_offs, start, stop)) < 2
        and len(select_between(theirs, start, stop)) < 2
    )


def select_between(times: Array, start: float, stop: float) -> Array:
    """Those of `times` (s) after `start` and before `stop`."""
    return times[(times > start) & (times < stop)]


def find_gait_cycles(events: FootEvents, other: FootEvents | None = None) -> tuple[GaitCycle, ...]:
    """All complete cycles of one foot, in time order; `other`: of the other foot, which shows
    missing strikes, too.
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
    """Time (s) and whether the foot is down after it, in order of time."""
    return sorted(
        [(t, True) for t in foot.strikes.tolist()] + [(t, False) for t in foot.toe_offs.tolist()]
    )


def remove_flicker(time: Array, state: BoolArray) -> BoolArray:
    """`state` (nf,) without flickers: short gaps are closed, then short stretches dropped."""
    out = state.copy()
    for value in (False, True):
        for run in find_runs(out == value):
            inner = run.start > 0 and run.stop < len(time)
            if inner and time[run.stop] - time[run.start] < SHORTEST_PHASE:
                out[run] = not value
    return out


def normalise(time: Array, values: Array, cycle: GaitCycle, points: int = POINTS) -> Array:
    """(points, ...) `values` (nf, ...) at equal steps of the cycle, linear between frames.

    A NaN stays a gap: every point between a frame that is NaN and its neighbours is NaN.
    """
    return resample(time, values, np.linspace(cycle.start, cycle.stop, points))


def find_valid_percents(time: Array, valid: BoolArray, cycle: GaitCycle) -> BoolArray:
    """(101,) percents of the cycle at which a signal that is valid in some frames (nf,) is so."""
    return np.isfinite(normalise(time, np.where(valid, 1.0, np.nan), cycle))


def resample(time: Array, values: Array, at: Array) -> Array:
    """(len(at), ...) `values` (nf, ...) at the times `at`, linear; NaN in gaps and outside.

    A time that is a frame's but for rounding takes nothing from a neighbour that is a gap: C3D
    files keep the times of their events in single precision.
    """
    right = np.clip(np.searchsorted(time, at), 1, len(time) - 1)
    left = right - 1
    step, ends = time[right] - time[left], (-1, *([1] * (values.ndim - 1)))
    share, rounding = (at - time[left]) / step, SINGLE * np.abs(at) / step
    before, after, part = values[left], values[right], share.reshape(ends)
    is_left, is_right = ((np.abs(share - side) <= rounding).reshape(ends) for side in (0.0, 1.0))
    out: Array = before + part * (after - before)
    out = np.where((part == 0.0) | (is_left & np.isnan(after)), before, out)
    out = np.where((part == 1.0) | (is_right & np.isnan(before)), after, out)
    out[(share < -rounding) | (share > 1.0 + rounding)] = np.nan
    return out


def select_best_cycle(cycles: Sequence[GaitCycle], time: Array, valid: BoolArray) -> GaitCycle:
    """The cycle with the largest share of valid frames; the first of equals."""
    return max(cycles, key=lambda c: float(valid[(time >= c.start) & (time <= c.stop)].mean()))


class CurveKind(Enum):
    """What a variable is. `ending`: of its name; `unit`: in tables; `words`: on pages."""

    ANGLE = ("", "deg", "angle")
    MOMENT = ("_moment", "N m", "moment")
    POWER = ("_power", "W", "power")
    FORCE = ("_force", "N", "force")

    def __init__(self, ending: str, unit: str, label: str) -> None:
        self.ending, self.unit, self.label = ending, unit, label


GROUND_REACTION = "ground_reaction_vertical"
"""Upward force of the ground on the foot of that side, N: a force whose name has no ending."""


def get_curve_kind(variable: str) -> CurveKind:
    """Of a variable of `cycles.csv`: `knee_angle` is an angle, `knee_angle_moment` a moment."""
    if variable.startswith("ground_reaction_"):
        return CurveKind.FORCE
    return next(
        (kind for kind in CurveKind if kind.ending and variable.endswith(kind.ending)),
        CurveKind.ANGLE,
    )


def get_unit(variable: str) -> str:
    """`deg`, `N m`, `W`, `N`."""
    return get_curve_kind(variable).unit


def get_coordinate(variable: str) -> str:
    """The coordinate of a variable, without a side: `knee_angle_moment` -> `knee_angle`."""
    kind = get_curve_kind(variable)
    return variable.removesuffix(kind.ending) if kind.ending else variable


def list_variables() -> tuple[str, ...]:
    """Every variable that a table of strides may hold, without sides: all but those of the arms."""
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
    *(
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
    ),
    *("turn", "activity", "phase"),
)
WALKING: Final = "gait"
"""`activity` of strides of walks; repetitions, or strides, of any other activity have the name of
their trial.
"""
CONVENTION_COLUMNS: Final = ("unit", "positive")
"""Further columns of a table in another convention (`gaitcal export --format cycles`): they say
which.
"""
_NAMES: Final = {
    "person": "",
    "session": "",
    "activity": WALKING,
    "phase": "",
}  # with what a table that lacks them means
_LACKING: Final = ("se", "se_stride", "turn")  # numbers that a table or a stride may lack
_WHOLE: Final = ("stride", "percent", "valid")
_NEEDED: Final = tuple(name for name in CYCLE_COLUMNS if name not in (*_NAMES, *_LACKING))


def _make_error(text: str, source: object, field: str | None = None) -> InputError:
    return InputError(text, source=source, field=field, code=Code.STRIDE_TABLE)


def validate_stride_table(table: "pd.DataFrame", source: object = None) -> "pd.DataFrame":
    """A table of strides, which may hold text or be read by pandas alone, made whole.

    Numbers stand where numbers belong; a person or session that is not named is empty text, strides
    of no activity are of walks, an error or a turn that the table lacks is NaN. Columns:
    `CYCLE_COLUMNS`, then what else there is.

    Raises InputError: A column is missing, or holds something else than numbers. `source`: what the
    message says it is of.
    """
    missing = [name for name in _NEEDED if name not in table]
    if missing:
        found = ", ".join(map(str, table.columns[: len(CYCLE_COLUMNS)]))
        without = f"found the columns {found}, without {', '.join(missing)}"
        allowed = "those of cycles.csv, with commas between them"
        raise _make_error(f"is no table of strides: {without}; allowed: {allowed}", source)
    numbers = {
        name: _convert_column(table, name, source) for name in ("value", *_LACKING) if name in table
    }
    for name in _WHOLE:
        values = _convert_column(table, name, source)
        if not np.isfinite(values).all():
            at = int(np.flatnonzero(~np.isfinite(values))[0]) + 1
            allowed = (
                "a whole number (a line that is read as if it ended at a # in a name loses them: "
            )
            allowed += "gaitcal.read_cycles reads it whole)"
            raise _make_error(f"found nothing in row {at}; allowed: {allowed}", source, name)
        numbers[name] = values.astype(int)
    names = {
        n: table[n].where(table[n].notna(), lacked) if n in table else lacked
        for n, lacked in _NAMES.items()
    }
    whole = table.assign(
        **names, **numbers, **{name: np.nan for name in _LACKING if name not in table}
    )
    return whole[[*CYCLE_COLUMNS, *(name for name in table.columns if name not in CYCLE_COLUMNS)]]


def _convert_column(table: "pd.DataFrame", name: str, source: object) -> "pd.Series":
    import pandas as pd

    text = table[name]
    if pd.api.types.is_numeric_dtype(text):
        return text.astype(np.float64)
    numbers = pd.to_numeric(text, errors="coerce").astype(np.float64)
    wrong = np.flatnonzero(numbers.isna() & text.notna() & (text.astype(str).str.strip() != ""))
    if len(wrong) and (said := str(text.iloc[wrong[0]])).lower() != "nan":
        raise _make_error(f"found '{said}' in row {wrong[0] + 1}; allowed: a number", source, name)
    return numbers


def read_conventions(strides: "pd.DataFrame") -> dict[str, tuple[str, str]]:
    """Variable -> its unit and what is positive (nothing where the table does not say it: as in
    `cycles.csv`).

    Raises InputError: A variable is there in two conventions.
    """
    if not any(name in strides for name in CONVENTION_COLUMNS):
        return {str(name): (get_unit(str(name)), "") for name in strides["variable"].unique()}
    columns = (
        strides.reindex(columns=["variable", *CONVENTION_COLUMNS]).fillna("").drop_duplicates()
    )
    out: dict[str, tuple[str, str]] = {}
    for variable, unit, positive in columns.itertuples(index=False, name=None):
        now = (unit or get_unit(variable), positive)
        before = out.setdefault(variable, now)
        if before != now:
            ways = " and as ".join(" ".join(filter(None, (f"[{u}]", p))) for u, p in (before, now))
            raise _make_error(
                f"found {variable} as {ways}; allowed: one convention", None, "strides"
            )
    return out
