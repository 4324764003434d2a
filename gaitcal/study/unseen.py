"""Where a leg segment shows no marker: its motion there is a guess of the splines, and no torque follows from it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gaitcal.motion.motion import Motion
from gaitcal.study.checks.evidence import LEG_SEGMENTS, runs, spans

BoolArray = NDArray[np.bool_]


def unseen_frames(motion: Motion) -> dict[str, BoolArray]:
    """Leg segment -> (nf,) frames in which none of its markers with weight is seen; segments always seen left out."""
    errors = motion.errors
    names = np.array(errors.segments, dtype=str)
    out: dict[str, BoolArray] = {}
    for segment in LEG_SEGMENTS:
        own = (names == segment) & (errors.weight > 0)
        seen = np.isfinite(errors.distance[:, own]).any(axis=1)
        if not seen.all():
            out[segment] = np.asarray(~seen)
    return out


def unseen_warnings(motion: Motion) -> tuple[str, ...]:
    """What to say of them: one line for the segments that are lost in the same frames."""
    together: dict[bytes, list[str]] = {}
    frames = unseen_frames(motion)
    for segment, lost in frames.items():
        together.setdefault(lost.tobytes(), []).append(segment)
    told = []
    for segments in together.values():
        lost, which = frames[segments[0]], ", ".join(segments)
        if lost.all():
            told.append(f"no marker of {which} with weight in this trial; no torque is valid")
        else:
            span = spans(motion.time, runs(lost))
            told.append(f"{span}: no marker of {which} is seen; {int(lost.sum())} frames are not valid")
    return tuple(told)
