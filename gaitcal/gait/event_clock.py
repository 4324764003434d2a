"""Whether the events of a file fit its own forces and motion, and what is wrong with them where they do not.

Every event that lies inside the trial is held against the nearest moment of the same foot and kind that plates or
motion show. Where most of them do not fit, the faults that are known are undone in turn: times that are counted from
the file's first frame, or once too often from frame 0; left and right exchanged; one offset common to all. Only times
that are counted otherwise are used after all: there the right ones are known to the millisecond.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from gaitcal.arrays import Array
from gaitcal.findings import Finding, Severity
from gaitcal.recording.metadata import FootEvent, FootMoment

AGREE: Final = 0.1
"""s: motion alone misses contacts by up to 0.08 s where a foot drags (`scripts/check_events.py`)."""
FIT: Final = 0.75
"""Share of the events that must agree."""
RIVAL: Final = 0.4
"""s: where the motion has the event this near, but does not agree, the file's is at the wrong place."""
FEWEST: Final = 4
"""Events from which a fault common to all can be told."""
PLATE_OFFSET: Final = 0.04
"""s common to all events against the forces: who sets events by eye stays within that (laboratories seen: 0.014)."""
MOTION_OFFSET: Final = 0.06
"""s common to strikes and offs against the motion: its own faults have opposite signs for the two."""
SCATTER: Final = 0.02
"""s, median distance from the common offset, above which it is no common one."""
WHOLE: Final = 0.9
"""Share of the events that lie inside the trial where they are counted otherwise."""
EDGE: Final = 0.2
"""s at either end of a trial, where the motion may not show the event."""
SIDE_WORDS: Final = {"r": "right", "l": "left"}
OTHER: Final = {"r": "l", "l": "r"}


@dataclass(frozen=True)
class _Fit:
    """How a set of events lies on what plates and motion show."""

    agreeing: int
    judged: int
    spread: float
    """s, RMS of the differences of those that agree."""

    @property
    def good(self) -> bool:
        return self.judged > 0 and self.agreeing >= FIT * self.judged

    def __str__(self) -> str:
        return f"{self.agreeing} of {self.judged}"


def checked_events(
    file: Sequence[FootEvent], plates: Sequence[FootEvent], motion: Sequence[FootEvent], time: Array
) -> tuple[list[FootEvent], tuple[Finding, ...]]:
    """The events of the file that may be used, inside the trial `time` (nf,) s, and what is said of the rest."""
    half = 0.5 * float(np.median(np.diff(time))) if len(time) > 1 else 0.0
    inside = [e for e in file if time[0] - half <= e.time <= time[-1] + half]
    if not file or not (plates or motion):
        return inside, ()
    shown = [*plates, *motion]
    fit = _fit(file, shown, time)
    if fit.good:
        used, findings = _without_offset(inside, plates, motion)
        astray = [e for e in used if AGREE < abs(_nearest(e, shown)) < RIVAL]
        return [e for e in used if e not in astray], (*findings, *(_astray(astray) if astray else ()))
    if len(file) < FEWEST:
        if fit.judged == 0:
            return inside, ()
        return [], (_finding(Severity.INFO, "events of the file do not fit forces and motion", _stand(fit), ""),)
    for offset, cause in (
        (float(time[0]), "the file's events are counted from its first frame, not from frame 0"),
        (-float(time[0]), "the file's events are counted from frame 0 twice over"),
    ):
        moved = [e for e in _moved(file, offset) if time[0] - half <= e.time <= time[-1] + half]
        again, rest = _fit(moved, shown, time), _differences(moved, shown)
        whole = len(moved) >= WHOLE * len(file) and again.good and again.judged >= FEWEST
        if abs(offset) > AGREE and whole and abs(float(np.median(rest))) < PLATE_OFFSET:
            found = f"{_stand(fit)}; {abs(offset):.3f} s {_word(offset)}, {again}: used so"
            return moved, (_finding(Severity.INFO, cause, found, ""),)
    return [], (_fault(file, shown, time, fit),)


def _fault(file: Sequence[FootEvent], shown: Sequence[FootEvent], time: Array, fit: _Fit) -> Finding:
    """The single fault that makes most of the events agree, with its rival; else that none is known."""
    swapped = _fit([replace(e, side=OTHER[e.side]) for e in file], shown, time)
    offset = _common_offset(file, shown, time)
    shifted = _fit(_moved(file, offset), shown, time)
    can_swap, can_shift = (f.good and f.judged >= FEWEST for f in (swapped, shifted))
    unused = "not used; strides are those of forces and motion"
    if can_swap and not (can_shift and shifted.spread < 0.5 * swapped.spread):
        found = f"{_stand(fit)}; with the sides exchanged, {swapped}"
        found += f" ({abs(offset):.2f} s {_word(offset)}, {shifted})" if can_shift else ""
        cure = "see whether the events or the markers bear the wrong side"
        return _finding(
            Severity.WARNING, "left and right of the file's events are exchanged", f"{found}; {unused}", cure
        )
    if can_shift:
        found = f"{_stand(fit)}; moved by as much, {shifted}; {unused}"
        cause = f"the file's events come {abs(offset):.2f} s too {'early' if offset > 0 else 'late'}"
        return _finding(Severity.WARNING, cause, found, "correct the events, or the clock that they were set with")
    cause = "the file's events do not fit its forces and motion"
    return _finding(Severity.INFO, cause, f"{_stand(fit)}; {unused}", "")


def _without_offset(
    inside: list[FootEvent], plates: Sequence[FootEvent], motion: Sequence[FootEvent]
) -> tuple[list[FootEvent], tuple[Finding, ...]]:
    """The events, unless all of them come early or late by as much."""
    against = _differences(inside, plates)
    if len(against) >= FEWEST - 1:
        offset, by = float(np.median(against)), "force plates"
        common = abs(offset) > PLATE_OFFSET
    else:
        against = _differences(inside, motion)
        kinds = [_differences([e for e in inside if e.moment is m], motion) for m in FootMoment]
        middles = [float(np.median(d)) if len(d) > 1 else 0.0 for d in kinds]
        offset, by = min(middles, key=abs), "the motion of the feet"
        common = abs(offset) > MOTION_OFFSET and middles[0] * middles[1] > 0
    if not common or float(np.median(np.abs(np.array(against) - np.median(against)))) > SCATTER:
        return inside, ()
    cause = f"the file's events come {1e3 * abs(offset):.0f} ms too {'late' if offset > 0 else 'early'}"
    found = f"median of {len(against)} against {by}; not used; strides are those of forces and motion"
    return [], (_finding(Severity.WARNING, cause, found, "correct the events, or the clock that they were set with"),)


def _astray(events: Sequence[FootEvent]) -> tuple[Finding, ...]:
    named = ", ".join(f"{SIDE_WORDS[e.side]} {e.moment.value} {e.time:.2f} s" for e in events)
    cause = "single events of the file do not fit its forces and motion"
    return (_finding(Severity.INFO, cause, f"{named}; not used, forces or motion tell them", ""),)


def _fit(events: Sequence[FootEvent], shown: Sequence[FootEvent], time: Array) -> _Fit:
    """Events before and after the trial count as not agreeing: unless others do, nothing tells that they were cut."""
    agreeing = judged = 0
    squares = 0.0
    for event in events:
        nearest = _nearest(event, shown)
        if abs(nearest) <= AGREE:
            agreeing, judged, squares = agreeing + 1, judged + 1, squares + nearest**2
        elif time[0] + EDGE < event.time < time[-1] - EDGE:
            judged += 1
    if judged == 0:  # all of them lie outside of the trial
        judged = sum(not time[0] <= e.time <= time[-1] for e in events)
    return _Fit(agreeing, judged, float(np.sqrt(squares / agreeing)) if agreeing else np.inf)


def _common_offset(file: Sequence[FootEvent], shown: Sequence[FootEvent], time: Array) -> float:
    """Time (s) by which the events must be moved so that most of them agree; of equals the smallest."""
    steps = [s.time - e.time for e in file for s in shown if s.side == e.side and s.moment is e.moment]
    if not steps:
        return 0.0
    best = max(steps, key=lambda d: (_fit(_moved(file, d), shown, time).agreeing, -abs(d)))
    return best + float(np.median([_nearest(e, shown) for e in _moved(file, best)]))


def _nearest(event: FootEvent, shown: Sequence[FootEvent]) -> float:
    """Time (s) from an event to the nearest one of the same foot and kind; infinite where there is none."""
    steps = [s.time - event.time for s in shown if s.side == event.side and s.moment is event.moment]
    return min(steps, key=abs) if steps else float("inf")


def _differences(events: Sequence[FootEvent], shown: Sequence[FootEvent]) -> list[float]:
    """Times (s) by which events come after the nearest shown ones, of those that agree."""
    return [-d for d in (_nearest(e, shown) for e in events) if abs(d) <= AGREE]


def _moved(events: Sequence[FootEvent], offset: float) -> list[FootEvent]:
    return [replace(e, time=e.time + offset) for e in events]


def _word(offset: float) -> str:
    return "later" if offset > 0 else "earlier"


def _stand(fit: _Fit) -> str:
    return f"as they stand {fit} lie within {1e3 * AGREE:.0f} ms of what forces and motion show"


def _finding(severity: Severity, cause: str, found: str, cure: str) -> Finding:
    return Finding(severity=severity, topic="events", where="", cause=cause, found=found, cure=cure)
