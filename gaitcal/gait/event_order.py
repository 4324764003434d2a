"""Strikes and offs of a foot take turns: two of a kind in a row, and the event between them is missing.

Whether a foot is on the ground at a moment is known where the events around it agree: down after a strike and before an
off, in the air after an off and before a strike. The ends of a recording hide nothing that matters of a foot that is
down; a foot whose first strike comes later may have been down before it, and have left the ground out of sight.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping

import numpy as np

from gaitcal.codes import Code
from gaitcal.findings import Finding, Severity, listed
from gaitcal.gait.cycles import FootEvents

SIDE_WORDS = {"r": "right", "l": "left"}


def changes(foot: FootEvents) -> list[tuple[float, bool]]:
    """Time (s) and whether the foot is down after it, in order of time."""
    return sorted([(t, True) for t in foot.strikes.tolist()] + [(t, False) for t in foot.toe_offs.tolist()])


def is_down(before: bool | None, after: bool | None) -> bool | None:
    """Whether a foot is on the ground between two of its events that follow each other; None where it is not known.

    `before`, `after`: whether they are strikes; None where the recording has none there.
    """
    if before == after:
        return None
    if before is None or after is None:
        return True if (before or after is False) else None
    return before


def order_findings(feet: Mapping[str, FootEvents]) -> tuple[Finding, ...]:
    """What to say of feet (`r`, `l`) whose strikes and offs do not take turns."""
    named = []
    for side, foot in feet.items():
        of_foot = changes(foot)
        if not (len(foot.strikes) and len(foot.toe_offs)):
            continue
        for (first, struck), (second, again) in itertools.pairwise(of_foot):
            if struck == again:
                kind, missing = ("strike", "off") if struck else ("off", "strike")
                named.append(f"{SIDE_WORDS[side]} {kind} {first:.2f} and {second:.2f} s without {missing} between")
    if not named:
        return ()
    return (
        Finding(
            severity=Severity.INFO,
            topic="events",
            where="",
            cause="foot strikes or offs are missing",
            found=f"{listed(named)}; phases that need them are not told, and stretches with a missing strike are no "
            "strides",
            cure="",
            code=Code.MISSING_EVENTS,
        ),
    )


def double_support(other: FootEvents, strike: float, off: float) -> dict[str, float]:
    """Double and single support (s) of a stance from `strike` to `off`, of which it is known when the other foot is
    down: 0 where it is in the air (running), absent where an event is missing.
    """
    out: dict[str, float] = {}
    of_other = changes(other)
    before = [down for t, down in of_other if t <= strike]
    inside = [(t, down) for t, down in of_other if strike < t < off]
    after = [down for t, down in of_other if t >= off]
    whole = [*before[-1:], *(down for _, down in inside), *after[:1]]
    first = is_down(before[-1] if before else None, next(iter([*(d for _, d in inside), *after]), None))
    last = is_down(next(iter([*(d for _, d in reversed(inside)), *reversed(before)]), None), next(iter(after), None))
    if first is not None:
        left = [t for t, down in inside if not down]
        out |= {"first_double_support": left[0] - strike} if first and left else {}
        out |= {} if first else {"first_double_support": 0.0}
    if last is not None:
        struck = [t for t, down in inside if down]
        out |= {"second_double_support": off - struck[-1]} if last and struck else {}
        out |= {} if last else {"second_double_support": 0.0}
    if len(out) == 2 and bool(np.all([a != b for a, b in itertools.pairwise(whole)])):
        both = sum(out.values())
        out |= {"double_support": both, "single_support": off - strike - both}
    return out
