"""Whether the events of a file fit its own forces and motion, and what is wrong with them where
they do not.

Every event that lies inside the trial is held against the nearest moment of the same foot and kind
that plates or motion show. Where most of them do not fit, the faults that are known are undone in
turn: times that are counted from the file's first frame, or once too often from frame 0; left and
right exchanged; one offset common to all. Only times that are counted otherwise are used after all:
there the right ones are known to the millisecond.

Where most of them fit, an offset common to one foot or to one kind is looked for, too, and every
event that a plate under its own foot contradicts gives way to that plate.

Strikes and offs of a foot take turns: two of a kind in a row, and the event between them is
missing.

Whether a foot is on the ground at a moment is known where the events around it agree: down after a
strike and before an off, in the air after an off and before a strike. The ends of a recording hide
nothing that matters of a foot that is down; a foot whose first strike comes later may have been
down before it, and have left the ground out of sight.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from gaitcal.arrays import Array
from gaitcal.errors import Code, Finding, Severity, listed
from gaitcal.gait.cycles import FootEvents, list_contact_changes
from gaitcal.io.labels import FootEvent, FootMoment
from gaitcal.model.linkage import OTHER_SIDE, SIDE_WORDS

AGREE: Final = 0.1
"""s: motion alone misses contacts by up to 0.08 s where a foot drags (`python -m scripts.validation
events STUDY`).
"""
FIT: Final = 0.75  # share of the events that must agree
# s: where the motion has the event this near, but does not agree, the file's is at the wrong place
RIVAL: Final = 0.4
FEWEST: Final = 4  # events from which a fault common to all can be told
SAME_EVENT: Final = (
    0.2  # s: an event of one foot this near to another of its kind is the same event
)
PLATE_OFFSET: Final = 0.04
"""s against the forces, of one event or common to several: who sets events by eye stays within that
(laboratories seen: 0.014)."""
MOTION_OFFSET: Final = 0.06
"""s common to strikes and offs against the motion: its own faults have opposite signs for the two.
"""
SCATTER: Final = 0.02  # s, median distance from the common offset, above which it is no common one
ALIKE: Final = (
    0.03  # s, most distance of one event of a foot or a kind from the offset that they are to share
)
WHOLE: Final = 0.9  # share of the events that lie inside the trial where they are counted otherwise
EDGE: Final = 0.2  # s at either end of a trial, where the motion may not show the event


@dataclass(frozen=True)
class _Agreement:
    """How a set of events lies on what plates and motion show."""

    agreeing: int
    compared: int
    spread: float  # s, RMS of the differences of those that agree

    @property
    def good(self) -> bool:
        return self.compared > 0 and self.agreeing >= FIT * self.compared

    def __str__(self) -> str:
        return f"{self.agreeing} of {self.compared}"


def check_file_events(
    file: Sequence[FootEvent], plates: Sequence[FootEvent], motion: Sequence[FootEvent], time: Array
) -> tuple[list[FootEvent], tuple[Finding, ...]]:
    """The events of the file that may be used, inside the trial `time` (nf,) s, and what is said of
    the rest.
    """
    half = 0.5 * float(np.median(np.diff(time))) if len(time) > 1 else 0.0
    file, twice = _remove_duplicates(file, plates, motion)
    inside = [e for e in file if time[0] - half <= e.time <= time[-1] + half]
    if not file or not (plates or motion):
        return inside, twice
    shown = [*plates, *motion]
    fit = _compare_events(file, shown, time)
    if fit.good:
        used, findings = _remove_offset_events(inside, plates, motion)
        astray = [e for e in used if AGREE < abs(_measure_nearest(e, shown)) < RIVAL]
        apart = [
            e
            for e in used
            if e not in astray
            and PLATE_OFFSET < abs(_measure_plate_difference(e, plates, motion)) < SAME_EVENT
        ]
        if astray:
            found = f"{', '.join(_format_event(e) for e in astray)}; not used, forces or motion tell them"
            findings += (
                _make_note("single events of the file do not fit its forces and motion", found),
            )
        if apart:
            named = ", ".join(
                f"{_format_event(e)} (plate {e.time + _measure_nearest(e, plates):.2f} s)"
                for e in apart
            )
            cause = "single events of the file do not fit the plate under their foot"
            findings += (_make_note(cause, f"{named}; not used, the plates tell them"),)
        return [e for e in used if e not in astray and e not in apart], (*twice, *findings)
    if len(file) < FEWEST:
        if fit.compared == 0:
            return inside, twice
        return [], (
            *twice,
            _make_note("events of the file do not fit forces and motion", _describe_agreement(fit)),
        )
    for offset, cause in (
        (float(time[0]), "the file's events are counted from its first frame, not from frame 0"),
        (-float(time[0]), "the file's events are counted from frame 0 twice over"),
    ):
        moved = [
            e for e in _shift_events(file, offset) if time[0] - half <= e.time <= time[-1] + half
        ]
        again, rest = _compare_events(moved, shown, time), _list_differences(moved, shown)
        whole = len(moved) >= WHOLE * len(file) and again.good and again.compared >= FEWEST
        if abs(offset) > AGREE and whole and abs(float(np.median(rest))) < PLATE_OFFSET:
            later = "later" if offset > 0 else "earlier"
            return moved, (
                *twice,
                _make_note(
                    cause,
                    f"{_describe_agreement(fit)}; {abs(offset):.3f} s {later}, {again}: used so",
                ),
            )
    return [], (*twice, _diagnose_misfit(file, shown, time, fit))


def check_corrected_events(
    events: Sequence[FootEvent], shown: Sequence[FootEvent], time: Array
) -> tuple[Finding, ...]:
    """Where the events that a person set differ from what forces and motion show; they are used all
    the same.

    A foot of which a whole kind is missing is warned of: it has no strides, or none of their
    phases, in any table.
    """
    low, high = time[0] + EDGE, time[-1] - EDGE
    inside = [e for e in events if shown and low < e.time < high]
    apart = [_format_event(e) for e in inside if abs(_measure_nearest(e, shown)) > AGREE]
    lacking = list[FootEvent]()
    for event in (e for e in shown if low < e.time < high):
        if (
            abs(_measure_nearest(event, [*events, *lacking])) > SAME_EVENT
        ):  # plates and motion have the same one
            lacking.append(event)
    findings = list[Finding]()
    for side, word in SIDE_WORDS.items():
        counts = {m: sum(e.side == side and e.moment is m for e in events) for m in FootMoment}
        unset = {
            m: sum(e.side == side and e.moment is m for e in lacking)
            for m in FootMoment
            if not counts[m]
        }
        lacking = [e for e in lacking if e.side != side or counts[e.moment]]
        if any(unset.values()) or (unset and max(counts.values()) > 1):
            kinds = " and no ".join(m.value for m in unset)
            seen = " and ".join(f"{n} {m.value}{'s' * (n != 1)}" for m, n in unset.items())
            missing = "strides" if FootMoment.STRIKE in unset else "stance and swing"
            found = (
                f"forces and motion show {seen}, which are not used: {missing} of this foot are "
                "not computed"
            )
            cure = "set them, too, or take the recording out of events.csv"
            findings.append(
                _make_warning(f"corrected events have no {kinds} of the {word} foot", found, cure)
            )
    if lacking:
        names = listed([_format_event(e) for e in sorted(lacking, key=lambda e: e.time)])
        found = f"{names}: forces or motion show them; not used"
        findings.append(
            _make_note("corrected events leave out some that forces and motion show", found)
        )
    if apart:
        by = f"more than {1e3 * AGREE:.0f} ms from what forces and motion show"
        found = f"{', '.join(apart)}: {by}; used as they stand"
        findings.append(_make_note("corrected events lie apart from forces and motion", found))
    return tuple(findings)


def _diagnose_misfit(
    file: Sequence[FootEvent], shown: Sequence[FootEvent], time: Array, fit: _Agreement
) -> Finding:
    """The single fault that makes most of the events agree, with its rival; else that none is
    known.
    """
    swapped = _compare_events([replace(e, side=OTHER_SIDE[e.side]) for e in file], shown, time)
    offset = _estimate_common_offset(file, shown, time)
    shifted = _compare_events(_shift_events(file, offset), shown, time)
    can_swap, can_shift = (f.good and f.compared >= FEWEST for f in (swapped, shifted))
    unused = "not used; strides are those of forces and motion"
    if can_swap and not (can_shift and shifted.spread < 0.5 * swapped.spread):
        found = f"{_describe_agreement(fit)}; with the sides exchanged, {swapped}"
        found += (
            f" ({abs(offset):.2f} s {'later' if offset > 0 else 'earlier'}, {shifted})"
            if can_shift
            else ""
        )
        cure = "see whether the events or the markers bear the wrong side"
        return _make_warning(
            "left and right of the file's events are exchanged", f"{found}; {unused}", cure
        )
    if can_shift:
        found = f"{_describe_agreement(fit)}; moved by as much, {shifted}; {unused}"
        cause = (
            f"the file's events come {abs(offset):.2f} s too {'early' if offset > 0 else 'late'}"
        )
        return _make_warning(
            cause, found, "correct the events, or the clock that they were set with"
        )
    return _make_note(
        "the file's events do not fit its forces and motion",
        f"{_describe_agreement(fit)}; {unused}",
    )


def _remove_duplicates(
    file: Sequence[FootEvent], plates: Sequence[FootEvent], motion: Sequence[FootEvent]
) -> tuple[list[FootEvent], tuple[Finding, ...]]:
    """The events without those that stand there twice: of two, the one that plates, else the
    motion, have nearer.
    """
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
    found = f"{', '.join(named)}; of two, the one nearer to forces or motion is used"
    return kept, (_make_note("events stand in the file more than once", found),)


def _remove_offset_events(
    inside: list[FootEvent], plates: Sequence[FootEvent], motion: Sequence[FootEvent]
) -> tuple[list[FootEvent], tuple[Finding, ...]]:
    """The events without those that come early or late by as much: all, those of a foot, or those
    of a kind.
    """
    if len(_list_differences(inside, plates)) < FEWEST - 1:
        against = _list_differences(inside, motion)
        kinds = [
            _list_differences([e for e in inside if e.moment is m], motion) for m in FootMoment
        ]
        middles = [float(np.median(d)) if len(d) > 1 else 0.0 for d in kinds]
        offset = min(middles, key=abs)
        if (
            abs(offset) > MOTION_OFFSET
            and middles[0] * middles[1] > 0
            and np.median(_compute_deviations(against)) <= SCATTER
        ):
            return [], (
                _report_offset("", offset, f"{len(against)} against the motion of the feet"),
            )
    groups = {"": inside}
    groups |= {f"{m.value} ": [e for e in inside if e.moment is m] for m in FootMoment}
    groups |= {
        f"{word} ": [e for e in inside if e.side == side] for side, word in SIDE_WORDS.items()
    }
    used, findings = inside, []
    for one_speaks, word in itertools.product((False, True), groups):
        group = groups[word]
        from_plate = [-_measure_plate_difference(e, plates, motion) for e in group if e in used]
        against, beside = (
            [d for d in from_plate if abs(d) <= AGREE],
            _list_differences(group, motion),
        )
        enough = len(against) >= (2 if word else FEWEST - 1)
        if one_speaks:  # one event on a plate, for those that the motion has late by as much
            enough = (
                bool(against and word)
                and len(beside) >= FEWEST - 1
                and _compute_deviations(beside).max() <= 2 * SCATTER
            )
        if (
            enough
            and abs(float(np.median(against))) > PLATE_OFFSET
            and _compute_deviations(against).max() <= ALIKE
        ):
            used = [e for e in used if e not in group]
            findings.append(
                _report_offset(
                    word, float(np.median(against)), f"{len(against)} against force plates"
                )
            )
    return used, tuple(findings)


def _compute_deviations(differences: Sequence[float]) -> Array:
    """(n,) s, distances from their median."""
    return np.abs(np.array(differences) - np.median(differences))


def _report_offset(of: str, offset: float, by: str) -> Finding:
    cause = (
        f"the file's {of}events come {1e3 * abs(offset):.0f} ms too "
        f"{'late' if offset > 0 else 'early'}"
    )
    found = f"median of {by}; not used; strides are those of forces and motion"
    return _make_warning(cause, found, "correct the events, or the clock that they were set with")


def _measure_plate_difference(
    event: FootEvent, plates: Sequence[FootEvent], motion: Sequence[FootEvent]
) -> float:
    """Time (s) from an event to that of the plate under the foot; infinite where the plate need not
    be right.

    A foot that comes down in front of a plate loads it late, one that rolls over its edge unloads
    it early: there the plate is right only where the motion does not have the event of the file. It
    is never loaded without a foot.
    """
    from_plate, from_motion = _measure_nearest(event, plates), _measure_nearest(event, motion)
    beside = from_plate > 0 if event.moment is FootMoment.STRIKE else from_plate < 0
    if beside and abs(from_motion) < abs(from_plate - from_motion):
        return float("inf")
    return from_plate


def _compare_events(
    events: Sequence[FootEvent], shown: Sequence[FootEvent], time: Array
) -> _Agreement:
    """Events before and after the trial count as not agreeing: unless others do, nothing tells that
    they were cut.
    """
    nearest = [_measure_nearest(event, shown) for event in events]
    agreeing = [d for d in nearest if abs(d) <= AGREE]
    inside = [time[0] + EDGE < event.time < time[-1] - EDGE for event in events]
    judged = sum(abs(d) <= AGREE or is_inside for d, is_inside in zip(nearest, inside, strict=True))
    if judged == 0:  # all of them lie outside of the trial
        judged = sum(not time[0] <= e.time <= time[-1] for e in events)
    return _Agreement(
        len(agreeing), judged, float(np.sqrt(np.mean(np.square(agreeing)))) if agreeing else np.inf
    )


def _estimate_common_offset(
    file: Sequence[FootEvent], shown: Sequence[FootEvent], time: Array
) -> float:
    """Time (s) by which the events must be moved so that most of them agree; of equals the
    smallest.
    """
    steps = [
        s.time - e.time for e in file for s in shown if s.side == e.side and s.moment is e.moment
    ]
    if not steps:
        return 0.0
    best = max(
        steps,
        key=lambda d: (_compare_events(_shift_events(file, d), shown, time).agreeing, -abs(d)),
    )
    return best + float(np.median([_measure_nearest(e, shown) for e in _shift_events(file, best)]))


def _measure_nearest(event: FootEvent, shown: Sequence[FootEvent]) -> float:
    """Time (s) from an event to the nearest one of the same foot and kind; infinite where there is
    none.
    """
    steps = [s.time - event.time for s in shown if _is_same_kind(s, event)]
    return min(steps, key=abs) if steps else float("inf")


def _list_differences(events: Sequence[FootEvent], shown: Sequence[FootEvent]) -> list[float]:
    """Times (s) by which events come after the nearest shown ones, of those that agree."""
    return [-d for d in (_measure_nearest(e, shown) for e in events) if abs(d) <= AGREE]


def _is_same_kind(one: FootEvent, other: FootEvent) -> bool:
    return one.side == other.side and one.moment is other.moment


def _format_event(event: FootEvent) -> str:
    return f"{SIDE_WORDS[event.side]} {event.moment.value} {event.time:.2f} s"


def _shift_events(events: Sequence[FootEvent], offset: float) -> list[FootEvent]:
    return [replace(e, time=e.time + offset) for e in events]


def _describe_agreement(fit: _Agreement) -> str:
    return f"as they stand {fit} lie within {1e3 * AGREE:.0f} ms of what forces and motion show"


def _make_warning(
    cause: str, found: str, cure: str, severity: Severity = Severity.WARNING
) -> Finding:
    return Finding(
        severity=severity,
        topic="events",
        cause=cause,
        found=found,
        cure=cure,
        code=Code.FILE_EVENTS,
    )


def _make_note(cause: str, found: str) -> Finding:
    return _make_warning(cause, found, "", Severity.INFO)


def is_down(before: bool | None, after: bool | None) -> bool | None:
    """Whether a foot is on the ground between two of its events that follow each other; None where
    it is not known.

    `before`, `after`: whether they are strikes; None where the recording has none there.
    """
    if before == after:
        return None
    if before is None or after is None:
        return True if (before or after is False) else None
    return before


def check_event_order(feet: Mapping[str, FootEvents]) -> tuple[Finding, ...]:
    """What to say of feet (`r`, `l`) whose strikes and offs do not take turns."""
    named = []
    for side, foot in feet.items():
        both = len(foot.strikes) and len(foot.toe_offs)
        for (first, struck), (second, again) in itertools.pairwise(list_contact_changes(foot)):
            if both and struck == again:
                kind, missing = ("strike", "off") if struck else ("off", "strike")
                named.append(
                    f"{SIDE_WORDS[side]} {kind} {first:.2f} and {second:.2f} s without {missing} "
                    "between"
                )
    if not named:
        return ()
    found = (
        f"{listed(named)}; phases that need them are not computed, and stretches with a missing strike "
        "are no strides"
    )
    return (
        replace(_make_note("foot strikes or offs are missing", found), code=Code.MISSING_EVENTS),
    )


def compute_double_support(other: FootEvents, strike: float, off: float) -> dict[str, float]:
    """Double and single support (s) of a stance from `strike` to `off`, of which it is known when
    the other foot is down: 0 where it is in the air (running), absent where an event is missing.
    """
    out: dict[str, float] = {}
    of_other = list_contact_changes(other)
    before = [down for t, down in of_other if t <= strike]
    inside = [(t, down) for t, down in of_other if strike < t < off]
    after = [down for t, down in of_other if t >= off]
    downs = [down for _, down in inside]
    whole = [*before[-1:], *downs, *after[:1]]
    first = is_down(before[-1] if before else None, [*downs, *after, None][0])
    last = is_down([None, *before, *downs][-1], after[0] if after else None)
    left, struck = [t for t, down in inside if not down], [t for t, down in inside if down]
    if first is False or (first and left):
        out["first_double_support"] = left[0] - strike if first else 0.0
    if last is False or (last and struck):
        out["second_double_support"] = off - struck[-1] if last else 0.0
    if len(out) == 2 and bool(np.all([a != b for a, b in itertools.pairwise(whole)])):
        both = sum(out.values())
        out |= {"double_support": both, "single_support": off - strike - both}
    return out
