"""Which complete strides of a walk have moments throughout, on which plate, and in words why others have not.

A frame of a leg does not count where its foot is down without a plate of its own, or on one that does not carry the
whole of it (`dynamics/ground_reactions.py`). Of a stride that has such frames the kind that takes most of them is told.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from gaitcal.gait.cycles import GaitCycle
from gaitcal.gait.moments import SIDE_WORDS, listed
from gaitcal.gait.strides import strides_of, turns
from gaitcal.model.linkage import SIDES
from gaitcal.session.result import TrialResult

REFUSED = "the verdict refuses this leg"
NO_PLATES = "no force plates"
BESIDE = "foot beside the plate"
PART = "part of the stance beside the plate"
NOT_WHOLLY = "foot not wholly on a plate of its own"
ENDS = "at the end of the recording"
UNSEEN = "markers do not show the leg"
NEAR_END = 0.3
"""s: frames this near to an end of a trial are lost with the ends of its splines and filters."""


@dataclass(frozen=True, kw_only=True)
class StrideUse:
    """One complete stride."""

    side: str
    number: int
    plate: str
    """Names of the plates that carry the foot in it; empty: none."""
    whole: bool
    """Moments of the leg are valid throughout."""
    turns: bool
    """It turns, and takes no part in means."""
    reason: str
    """Why it is not whole; empty where it is."""
    repeats: bool = False
    """It is no stride, but a repetition of another activity."""


def stride_uses(trial: TrialResult) -> tuple[StrideUse, ...]:
    """Of every complete stride, right ones first; none of an isolated trial."""
    if trial.joint is not None:
        return ()
    bent = {(s.side, s.number) for s in trial.strides if turns(s.turn)}
    out = []
    for foot, side in enumerate(SIDES):
        for number, cycle in enumerate(strides_of(trial.events)[side], start=1):
            plate, reason = _use(trial, foot, side, cycle)
            turning = (side, number) in bent
            out.append(
                StrideUse(
                    side=side,
                    number=number,
                    plate=plate,
                    whole=not reason,
                    turns=turning,
                    reason=reason,
                    repeats=bool(trial.events.repeats),
                )
            )
    return tuple(out)


def usable_words(uses: Iterable[StrideUse]) -> str:
    """`Usable for moments: 1 of 4 right, 2 of 4 left strides; others: foot beside the plate.`"""
    if not (uses := tuple(uses)):
        return "No complete stride."
    of_sides = {side: [use for use in uses if use.side == side] for side in SIDES}
    counts = (f"{sum(u.whole for u in of)} of {len(of)} {SIDE_WORDS[side]}" for side, of in of_sides.items())
    reasons = reason_words(uses)
    what = "repetitions" if all(use.repeats for use in uses) else "strides"
    return f"Usable for moments: {', '.join(counts)} {what}{f'; others: {reasons}' if reasons else ''}."


def reason_words(uses: Iterable[StrideUse]) -> str:
    """Why strides are not whole, the most frequent reason first; empty where all are."""
    return listed([reason for reason, _ in Counter(use.reason for use in uses if not use.whole).most_common()])


def _use(trial: TrialResult, foot: int, side: str, cycle: GaitCycle) -> tuple[str, str]:
    """Plates and reason of one stride."""
    if trial.loads is None:
        return "", NO_PLATES
    time, found = trial.body.time, trial.loads.reactions
    inside = (time >= cycle.start) & (time <= cycle.stop)
    stance = inside & (time < (cycle.toe_off or cycle.stop))
    plates = dict.fromkeys(name for name, of, frames in found.steps if of == foot and stance[frames].any())
    words = ", ".join(plates)
    lost = inside & ~found.valid_legs[:, foot]
    if side in trial.refused_legs:
        return words, REFUSED
    if not lost.any():
        return words, ""
    loaded, resting = found.loaded[:, foot], found.resting[:, foot]
    near_end = (time < time[0] + NEAR_END) | (time > time[-1] - NEAR_END)
    if trial.events.repeats and not (lost & ~near_end).any():
        return words, ENDS
    beside = PART if (loaded & stance).any() else BESIDE
    kinds = {beside: lost & resting & ~loaded, NOT_WHOLLY: lost & loaded}
    rest = lost & ~loaded & ~resting
    kinds |= {ENDS: rest & near_end, UNSEEN: rest & ~near_end}
    return words, max(kinds, key=lambda kind: int(np.count_nonzero(kinds[kind])))
