"""Whether a trial shows the trunk: three markers with weight that do not lie on one line.

Its three turns are free, and arms hang on it. With fewer markers it may turn about the line of those that are left, or
end turned over; head, trunk and arms then keep the posture of the static trial on the pelvis, as in a person whose
trunk has no markers at all.
"""

from __future__ import annotations

import numpy as np

from gaitcal.arrays import Array, BoolArray
from gaitcal.model.linkage import LOWER_BODY
from gaitcal.model.trunk import OFF_LINE, TRUNK_SUPPORT, spread_off_line

TRUNK = "head_trunk"
SEEN = 0.5
"""Share of the frames in which a marker must be seen to count."""


def follows_trunk(segments: tuple[str, ...], local: Array, pulls: BoolArray) -> bool:
    """Whether markers of these segments, at (nm, 3) m in them, show the trunk; `pulls` (nm, nf): seen, with weight."""
    counts = np.array([s == TRUNK for s in segments]) & (pulls.mean(axis=1) >= SEEN)
    return bool(counts.sum() >= TRUNK_SUPPORT) and spread_off_line(local[counts]) >= OFF_LINE


def telling(part: tuple[str, ...], segments: tuple[str, ...], local: Array, pulls: BoolArray) -> BoolArray:
    """(nm,) which of these markers may be followed: none of head, trunk and arms where they do not show the trunk.

    `part`: the segments that move, the root first; where the trunk hangs on none of them there is nothing to ask.
    """
    if TRUNK not in part[1:] or follows_trunk(segments, local, pulls):
        return np.ones(len(segments), dtype=bool)
    return np.array([s in LOWER_BODY for s in segments], dtype=bool)
