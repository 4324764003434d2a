"""Checks of foot events: those of the file, those that a person corrected, and their order.

Each event of the file that lies inside the trial is compared with the nearest event of the same
foot and kind in force plates or motion. Where most of them disagree, the known causes are tried in
order: times that count from the first frame of the file, or that contain the time of the first
frame twice; swapped left and right; a common time offset. Only a wrong zero of time is corrected,
as the right times then follow to the millisecond.

Where most of them agree, events with an offset common to one foot or to one kind are left out. So
is each single event that disagrees with the plate under its foot.

Strikes and offs of a foot alternate. Two of a kind in a row show that the event between them is
missing.

Whether a foot is on the ground follows from the events before and after: down between a strike and
an off, in the air between an off and a strike. A foot whose first event is a strike may have been
down before it, outside of the recording.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from gaitcal.arrays import Array
from gaitcal.errors import Code, Finding, Severity, join_names
from gaitcal.gait.cycles import FootEvents, list_contact_changes
from gaitcal.io.labels import FootEvent, FootMoment
from gaitcal.model.linkage import OTHER_SIDE, SIDE_WORDS

AGREE: Final = 0.1
"""s: motion alone misses contacts by up to 0.08 s where a foot drags (`python -m scripts.validation
events STUDY`).
"""
FIT: Final = 0.75
"""Share of the events that must agree."""
RIVAL: Final = 0.4
"""s: an event this near to one of the motion, but not in agreement, has a wrong time."""
FEWEST: Final = 4
"""Events from which a common cause can be recognised."""
SAME_EVENT: Final = 0.2
"""s: two events of one foot and kind that are nearer are the same event."""
PLATE_OFFSET: Final = 0.04
"""s against the forces, of one event or common to several: events that are set by eye stay within
that (largest in the laboratories checked: 0.014).
"""
MOTION_OFFSET: Final = 0.06
"""s common to strikes and offs against the motion, whose errors have opposite signs for the two."""
SCATTER: Final = 0.02
"""s, largest median distance of single events from a common offset."""
ALIKE: Final = 0.03
"""s, largest distance of one event of a foot or a kind from an offset that they share."""
WHOLE: Final = 0.9
"""Share of the events that must lie inside the trial after a correction of the zero of time."""
EDGE: Final = 0.2
"""s at either end of a trial, where the motion may not show the event."""


@dataclass(frozen=True)
class _Agreement:
    """Agreement of a set of events with plates and motion."""

    agreeing: int
    compared: int
    spread: float  # s, RMS of the differences of those that agree

    @property
    def good(self) -> bool:
        """Whether enough events agree."""
        return self.compared > 0 and self.agreeing >= FIT * self.compared

    def __str__(self) -> str:
        return f"{self.agreeing} of {self.compared}"


def check_file_events(
    file: Sequence[FootEvent], plates: Sequence[FootEvent], motion: Sequence[FootEvent], time: Array
) -> tuple[list[FootEvent], tuple[Finding, ...]]:
    """Select the events of a file that agree with forces and motion, and report all others.

    Parameters
    ----------
    file, plates, motion : sequence of FootEvent
        Events of the file, of the force plates and of the motion of the feet.
    time : (nf,) Array
        s, frames of the trial.

    Returns
    -------
    list of FootEvent
        Events to use, inside the trial.
    tuple of Finding
        What was left out or corrected, and why; without the name of the trial.
    """
    half = 0.5 * float(np.median(np.diff(time))) if len(time) > 1 else 0.0
    first, last = time[0] - half, time[-1] + half
    file, notes = _remove_duplicates(file, plates, motion)
    inside = [e for e in file if first <= e.time <= last]
    if not file or not (plates or motion):
        return inside, notes
    shown = [*plates, *motion]
    agreement = _compare_events(file, shown, time)
    if agreement.good:
        used, findings = _remove_misfits(inside, plates, motion)
        return used, (*notes, *findings)
    if len(file) < FEWEST:
        if agreement.compared == 0:
            return inside, notes
        cause = "events of the file do not agree with forces and motion"
        return [], (*notes, _make_note(cause, f"{_describe_agreement(agreement)}; not used"))
    for offset, cause in (
        (float(time[0]), "the file's events count time from its first frame, not from frame 0"),
        (-float(time[0]), "the file's events contain the time of the first frame twice"),
    ):
        moved = [e for e in _shift_events(file, offset) if first <= e.time <= last]
        again, differences = _compare_events(moved, shown, time), _list_differences(moved, shown)
        whole = len(moved) >= WHOLE * len(file) and again.good and again.compared >= FEWEST
        # An offset of the zero of time is exact: no systematic difference may remain.
        if abs(offset) > AGREE and whole and abs(float(np.median(differences))) < PLATE_OFFSET:
            later = "later" if offset > 0 else "earlier"
            found = (
                f"{_describe_agreement(agreement)}; {abs(offset):.3f} s {later}: {again}; used "
                "with these times"
            )
            return moved, (*notes, _make_note(cause, found))
    return [], (*notes, _diagnose_misfit(file, shown, time, agreement))


def _remove_misfits(
    inside: list[FootEvent], plates: Sequence[FootEvent], motion: Sequence[FootEvent]
) -> tuple[list[FootEvent], tuple[Finding, ...]]:
    """Remove groups of events with a common offset, then single ones that disagree."""
    shown = [*plates, *motion]
    used, findings = _remove_offset_events(inside, plates, motion)
    astray = [e for e in used if AGREE < abs(_measure_nearest(e, shown)) < RIVAL]
    contradicted = [
        e
        for e in used
        if e not in astray
        and PLATE_OFFSET < abs(_measure_plate_difference(e, plates, motion)) < SAME_EVENT
    ]
    if astray:
        cause = "single events of the file do not agree with its forces and motion"
        names = ", ".join(_format_event(e) for e in astray)
        findings += (_make_note(cause, f"{names}; not used: those of forces or motion are"),)
    if contradicted:
        cause = "single events of the file do not agree with the plate under their foot"
        names = ", ".join(
            f"{_format_event(e)} (plate {e.time + _measure_nearest(e, plates):.2f} s)"
            for e in contradicted
        )
        findings += (_make_note(cause, f"{names}; not used: those of the plates are"),)
    return [e for e in used if e not in astray and e not in contradicted], findings


def check_corrected_events(
    events: Sequence[FootEvent], shown: Sequence[FootEvent], time: Array
) -> tuple[Finding, ...]:
    """Report where events that a person corrected differ from forces and motion.

    All of them are used nevertheless. A foot without any event of a kind is warned of, as it has no
    strides, or none of their phases, in any table.

    Parameters
    ----------
    events : sequence of FootEvent
        Corrected events.
    shown : sequence of FootEvent
        Events of force plates and motion.
    time : (nf,) Array
        s, frames of the trial.

    Returns
    -------
    tuple of Finding
        Without the name of the trial.
    """
    low, high = time[0] + EDGE, time[-1] - EDGE
    inside = [e for e in events if shown and low < e.time < high]
    different = [_format_event(e) for e in inside if abs(_measure_nearest(e, shown)) > AGREE]
    lacking = list[FootEvent]()
    for event in (e for e in shown if low < e.time < high):
        # Plates and motion may both show the same event: count it once.
        if abs(_measure_nearest(event, [*events, *lacking])) > SAME_EVENT:
            lacking.append(event)
    findings = list[Finding]()
    for side, word in SIDE_WORDS.items():
        counts = _count_moments(events, side)
        unset = {m: n for m, n in _count_moments(lacking, side).items() if not counts[m]}
        lacking = [e for e in lacking if e.side != side or counts[e.moment]]
        if any(unset.values()) or (unset and max(counts.values()) > 1):
            kinds = " and no ".join(m.value for m in unset)
            missed = " and ".join(f"{n} {m.value}{'s' * (n != 1)}" for m, n in unset.items())
            missing = "strides" if FootMoment.STRIKE in unset else "stance and swing"
            found = (
                f"forces and motion show {missed}, which are not used: {missing} of this foot are "
                "not computed"
            )
            remedy = "add them to events.csv, or remove the recording from it"
            cause = f"corrected events have no {kinds} of the {word} foot"
            findings.append(_make_warning(cause, found, remedy))
    if lacking:
        names = join_names([_format_event(e) for e in sorted(lacking, key=lambda e: e.time)])
        cause = "corrected events lack some that forces and motion show"
        findings.append(_make_note(cause, f"{names}; not used"))
    if different:
        limit = f"more than {1e3 * AGREE:.0f} ms from the events of forces and motion"
        found = f"{', '.join(different)}: {limit}; used as given"
        findings.append(_make_note("corrected events differ from forces and motion", found))
    return tuple(findings)


def _count_moments(events: Sequence[FootEvent], side: str) -> dict[FootMoment, int]:
    """Count strikes and offs of one side."""
    return {m: sum(e.side == side and e.moment is m for e in events) for m in FootMoment}


def _diagnose_misfit(
    file: Sequence[FootEvent], shown: Sequence[FootEvent], time: Array, agreement: _Agreement
) -> Finding:
    """Report the single cause that makes most of the events agree, or that none is known."""
    swapped = _compare_events([replace(e, side=OTHER_SIDE[e.side]) for e in file], shown, time)
    offset = _estimate_common_offset(file, shown, time)
    shifted = _compare_events(_shift_events(file, offset), shown, time)
    can_swap, can_shift = (f.good and f.compared >= FEWEST for f in (swapped, shifted))
    unused = "not used; strides are those of forces and motion"
    # Both causes may explain the events. The offset wins where it leaves half the spread.
    if can_swap and not (can_shift and shifted.spread < 0.5 * swapped.spread):
        found = f"{_describe_agreement(agreement)}; with sides swapped {swapped}"
        if can_shift:
            later = "later" if offset > 0 else "earlier"
            found += f" ({abs(offset):.2f} s {later}: {shifted})"
        remedy = "check the sides of the events and of the marker labels"
        cause = "left and right of the file's events are swapped"
        return _make_warning(cause, f"{found}; {unused}", remedy)
    if can_shift:
        found = f"{_describe_agreement(agreement)}; after this shift {shifted}; {unused}"
        early = "early" if offset > 0 else "late"
        cause = f"the file's events come {abs(offset):.2f} s too {early}"
        return _make_warning(cause, found, OFFSET_REMEDY)
    cause = "the file's events do not agree with its forces and motion"
    return _make_note(cause, f"{_describe_agreement(agreement)}; {unused}")


OFFSET_REMEDY: Final = (
    "correct the times of the events, or the synchronisation of the program that set them"
)


def _remove_duplicates(
    file: Sequence[FootEvent], plates: Sequence[FootEvent], motion: Sequence[FootEvent]
) -> tuple[list[FootEvent], tuple[Finding, ...]]:
    """Keep one of two equal events: the nearer one to plates, else to the motion."""
    kept: list[FootEvent] = []
    named: list[str] = []
    for event in sorted(file, key=lambda e: e.time):
        alike = next(
            (e for e in kept if _is_same_kind(e, event) and event.time - e.time < SAME_EVENT), None
        )
        if alike is None:
            kept.append(event)
            continue
        named.append(f"{_format_event(alike)} and {event.time:.2f} s")
        shown = next(
            (by for by in (plates, motion) if abs(_measure_nearest(event, by)) < SAME_EVENT), ()
        )
        if abs(_measure_nearest(event, shown)) < abs(_measure_nearest(alike, shown)):
            kept[kept.index(alike)] = event
    if not named:
        return list(file), ()
    found = f"{', '.join(named)}; the one nearer to forces or motion is used"
    return kept, (_make_note("the file has the same event more than once", found),)


def _remove_offset_events(
    inside: list[FootEvent], plates: Sequence[FootEvent], motion: Sequence[FootEvent]
) -> tuple[list[FootEvent], tuple[Finding, ...]]:
    """Remove all events, those of a foot or those of a kind that share a time offset."""
    if len(_list_differences(inside, plates)) < FEWEST - 1:
        offset = _find_motion_offset(inside, motion)
        if offset is not None:
            count = len(_list_differences(inside, motion))
            return [], (_report_offset("", offset, f"{count} against the motion of the feet"),)
    # Label in messages -> events that may share an offset.
    groups = {"": inside}
    for moment in FootMoment:
        groups[f"{moment.value} "] = [e for e in inside if e.moment is moment]
    for side, word in SIDE_WORDS.items():
        groups[f"{word} "] = [e for e in inside if e.side == side]
    used, findings = inside, []
    for single, word in itertools.product((False, True), groups):
        group = groups[word]
        from_plate = [-_measure_plate_difference(e, plates, motion) for e in group if e in used]
        against = [d for d in from_plate if abs(d) <= AGREE]
        enough = len(against) >= (2 if word else FEWEST - 1)
        if single:
            # One event on a plate represents others that are as late relative to the motion.
            by_motion = _list_differences(group, motion)
            enough = (
                bool(against and word)
                and len(by_motion) >= FEWEST - 1
                and _compute_deviations(by_motion).max() <= 2 * SCATTER
            )
        if (
            enough
            and abs(float(np.median(against))) > PLATE_OFFSET
            and _compute_deviations(against).max() <= ALIKE
        ):
            used = [e for e in used if e not in group]
            source = f"{len(against)} against force plates"
            findings.append(_report_offset(word, float(np.median(against)), source))
    return used, tuple(findings)


def _find_motion_offset(inside: list[FootEvent], motion: Sequence[FootEvent]) -> float | None:
    """Find an offset (s) that strikes and offs share against the motion; None without one."""
    kinds = [_list_differences([e for e in inside if e.moment is m], motion) for m in FootMoment]
    middles = [float(np.median(d)) if len(d) > 1 else 0.0 for d in kinds]
    offset = min(middles, key=abs)
    # A foot that drags shows late strikes and early offs: opposite signs are no offset.
    if abs(offset) <= MOTION_OFFSET or middles[0] * middles[1] <= 0:
        return None
    scatter = np.median(_compute_deviations(_list_differences(inside, motion)))
    return offset if scatter <= SCATTER else None


def _compute_deviations(differences: Sequence[float]) -> Array:
    """Compute the distances (n,) s from the median."""
    return np.abs(np.array(differences) - np.median(differences))


def _report_offset(group: str, offset: float, source: str) -> Finding:
    """Report a time offset (s) of a group of events (`left `, `foot strike ` or all)."""
    late = "late" if offset > 0 else "early"
    cause = f"the file's {group}events come {1e3 * abs(offset):.0f} ms too {late}"
    found = f"median of {source}; not used; strides are those of forces and motion"
    return _make_warning(cause, found, OFFSET_REMEDY)


def _measure_plate_difference(
    event: FootEvent, plates: Sequence[FootEvent], motion: Sequence[FootEvent]
) -> float:
    """Measure the time (s) from an event to that of the plate under the foot.

    Infinite where the plate may be wrong: a foot that comes down in front of a plate loads it late,
    one that rolls over its edge unloads it early. There the plate is right only where the motion
    does not have the event of the file. A plate is never loaded without a foot.
    """
    from_plate, from_motion = _measure_nearest(event, plates), _measure_nearest(event, motion)
    partial = from_plate > 0 if event.moment is FootMoment.STRIKE else from_plate < 0
    if partial and abs(from_motion) < abs(from_plate - from_motion):
        return float("inf")
    return from_plate


def _compare_events(
    events: Sequence[FootEvent], shown: Sequence[FootEvent], time: Array
) -> _Agreement:
    """Count the events that agree with plates or motion.

    Events before and after the trial count as disagreeing only where no event lies inside: the
    trial may have been cut.
    """
    nearest = [_measure_nearest(event, shown) for event in events]
    agreeing = [d for d in nearest if abs(d) <= AGREE]
    inside = [time[0] + EDGE < event.time < time[-1] - EDGE for event in events]
    compared = sum(
        abs(d) <= AGREE or is_inside for d, is_inside in zip(nearest, inside, strict=True)
    )
    if compared == 0:
        compared = sum(not time[0] <= e.time <= time[-1] for e in events)
    spread = float(np.sqrt(np.mean(np.square(agreeing)))) if agreeing else np.inf
    return _Agreement(len(agreeing), compared, spread)


def _estimate_common_offset(
    file: Sequence[FootEvent], shown: Sequence[FootEvent], time: Array
) -> float:
    """Estimate the shift (s) with which most events agree; among equals the smallest."""
    steps = [
        s.time - e.time for e in file for s in shown if s.side == e.side and s.moment is e.moment
    ]
    if not steps:
        return 0.0
    best = max(
        steps,
        key=lambda d: (_compare_events(_shift_events(file, d), shown, time).agreeing, -abs(d)),
    )
    moved = _shift_events(file, best)
    return best + float(np.median([_measure_nearest(e, shown) for e in moved]))


def _measure_nearest(event: FootEvent, shown: Sequence[FootEvent]) -> float:
    """Measure the time (s) to the nearest event of the same foot and kind; infinite without one."""
    steps = [s.time - event.time for s in shown if _is_same_kind(s, event)]
    return min(steps, key=abs) if steps else float("inf")


def _list_differences(events: Sequence[FootEvent], shown: Sequence[FootEvent]) -> list[float]:
    """List the delays (s) after the nearest shown event, of the events that agree."""
    nearest = [_measure_nearest(e, shown) for e in events]
    return [-d for d in nearest if abs(d) <= AGREE]


def _is_same_kind(one: FootEvent, other: FootEvent) -> bool:
    return one.side == other.side and one.moment is other.moment


def _format_event(event: FootEvent) -> str:
    return f"{SIDE_WORDS[event.side]} {event.moment.value} {event.time:.2f} s"


def _shift_events(events: Sequence[FootEvent], offset: float) -> list[FootEvent]:
    return [replace(e, time=e.time + offset) for e in events]


def _describe_agreement(agreement: _Agreement) -> str:
    limit = f"{1e3 * AGREE:.0f} ms"
    return f"with the times of the file {agreement} agree with forces and motion within {limit}"


def _make_warning(
    cause: str, found: str, remedy: str, severity: Severity = Severity.WARNING
) -> Finding:
    return Finding(
        severity=severity,
        topic="events",
        cause=cause,
        found=found,
        cure=remedy,
        code=Code.FILE_EVENTS,
    )


def _make_note(cause: str, found: str) -> Finding:
    return _make_warning(cause, found, "", Severity.INFO)


def _is_down(before: bool | None, after: bool | None) -> bool | None:
    """Check whether a foot is on the ground between two of its consecutive events.

    `before`, `after`: whether the event is a strike (an off otherwise); None where the recording
    has none. Returns: None where it is not known.
    """
    if before == after:
        return None
    if before is None or after is None:
        return True if (before or after is False) else None
    return before


def check_event_order(feet: Mapping[str, FootEvents]) -> tuple[Finding, ...]:
    """Report feet whose strikes and offs do not alternate.

    Parameters
    ----------
    feet : mapping
        `r`, `l` -> events of the foot.

    Returns
    -------
    tuple of Finding
        At most one, without the name of the trial.
    """
    named = []
    for side, foot in feet.items():
        # A foot with events of one kind only has nothing to alternate.
        if not len(foot.strikes) or not len(foot.toe_offs):
            continue
        for (first, struck), (second, again) in itertools.pairwise(list_contact_changes(foot)):
            if struck == again:
                kind, missing = ("strike", "off") if struck else ("off", "strike")
                named.append(
                    f"{SIDE_WORDS[side]} {kind} {first:.2f} and {second:.2f} s without {missing} "
                    "between"
                )
    if not named:
        return ()
    found = (
        f"{join_names(named)}; phases that need them are not computed, and there is no stride "
        "across a missing strike"
    )
    note = _make_note("foot strikes or offs are missing", found)
    return (replace(note, code=Code.MISSING_EVENTS),)


def compute_double_support(other: FootEvents, strike: float, off: float) -> dict[str, float]:
    """Compute the double and single support of one stance.

    Parameters
    ----------
    other : FootEvents
        Events of the other foot.
    strike, off : float
        s, beginning and end of the stance.

    Returns
    -------
    dict
        `first_double_support`, `second_double_support`, `double_support`, `single_support` -> s.
        0 where the other foot is in the air (running); absent where an event is missing.
    """
    out: dict[str, float] = {}
    changes = list_contact_changes(other)
    before = [down for t, down in changes if t <= strike]
    inside = [(t, down) for t, down in changes if strike < t < off]
    after = [down for t, down in changes if t >= off]
    downs = [down for _, down in inside]
    # Contact of the other foot around the strike and around the off.
    first = _is_down(before[-1] if before else None, [*downs, *after, None][0])
    last = _is_down([None, *before, *downs][-1], after[0] if after else None)
    left, struck = [t for t, down in inside if not down], [t for t, down in inside if down]
    if first is False or (first and left):
        out["first_double_support"] = left[0] - strike if first else 0.0
    if last is False or (last and struck):
        out["second_double_support"] = off - struck[-1] if last else 0.0
    sequence = [*before[-1:], *downs, *after[:1]]
    alternates = all(a != b for a, b in itertools.pairwise(sequence))
    if len(out) == 2 and alternates:
        both = sum(out.values())
        out |= {"double_support": both, "single_support": off - strike - both}
    return out
