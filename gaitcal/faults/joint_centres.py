"""Joint centres under the names of lateral markers: a program exports what it computed beside what it measured.

Of two points p, q that stay together, q lies outwards of p where, with z to the right of the person who stands and
s = 1 on the right and -1 on the left,

    d = q - p,     s d_z > |(d_x, d_y)|,     a half joint width as people have it.

No skin is half a joint's width outwards of a lateral epicondyle or malleolus: then p, whatever its name, is the centre
of the joint, and q the marker. Nor are two points that keep their distance to a hundredth of a millimetre, while
somebody moves, both on skin: of such a pair the one nearer to the middle of the body is computed.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from gaitcal.arrays import Array
from gaitcal.errors import Code, Finding
from gaitcal.faults.evidence import MarkerEvidence
from gaitcal.faults.markers import KEEPS_M, TOGETHER
from gaitcal.io.recording import Recording, seen_means
from gaitcal.model.linkage import SIDES
from gaitcal.model.marker_set import MarkerSet
from gaitcal.model.segment_frames import PLAUSIBLE_WIDTH, half_width, sign

MEASURED_M = 1e-5
"""Least scatter of a distance that cameras measure while somebody moves; of less, a program computed a point."""
MOST_FRAMES = 150


def measured_instead(
    standing: Recording, window: slice, moving: Sequence[Recording], marker_set: MarkerSet, height: float
) -> dict[str, str]:
    """Find the measured markers of joints whose centres bear the names of lateral markers.

    Parameters
    ----------
    standing : Recording
        Somebody stands in the frames `window`; labels are those of the set.
    moving : sequence of Recording
        What shows which points stay together; without one nothing is found.
    height : float
        Of the body, m.

    Returns
    -------
    dict of str to str
        Lateral marker of the set -> the label that the set does not know, of joints of which both sides show it.
    """
    at = seen_means({m: standing.markers[window, i] for i, m in enumerate(standing.labels)})
    asis = [[at.get(m) for m in marker_set.landmarks.get(f"asis_{side}", ())] for side in SIDES]
    if not all(len(found) == 1 and found[0] is not None for found in asis):
        return {}
    right = (asis[0][0] - asis[1][0]) * [1.0, 0.0, 1.0]
    right /= np.linalg.norm(right)
    known = {*marker_set.labels, *marker_set.devices}
    strangers = [m for m in at if m not in known]
    out: dict[str, str] = {}
    for joint in ("knee", "ankle"):
        found: dict[str, str] = {}
        for side in SIDES:
            named = next((o[0] for o in marker_set.options(f"{joint}_lat_{side}") if len(o) == 1 and o[0] in at), None)
            for other in strangers if named is not None else ():
                away = at[other] - at[named]
                outwards = sign(side) * float(away @ right)
                share = outwards / half_width(joint, height)
                if not PLAUSIBLE_WIDTH[0] <= share <= PLAUSIBLE_WIDTH[1] or 2.0 * outwards**2 < float(away @ away):
                    continue
                if _stay_together(moving, named, other, strangers):
                    found[named] = other
        if len(found) == len(SIDES):
            out |= found
    return out


def _stay_together(moving: Sequence[Recording], named: str, other: str, strangers: Sequence[str]) -> bool:
    """Whether two points keep their distance, and the second one is no computed point that a third one shows."""
    scatter = [_scatter(r, named, other) for r in moving]
    if not any(np.isfinite(scatter)) or np.nanmax(scatter) > KEEPS_M:
        return False
    thirds = [m for m in strangers if m != other]
    return not any(_scatter(r, other, third) < MEASURED_M for r in moving for third in thirds)


def _scatter(recording: Recording, one: str, other: str) -> float:
    """m, standard deviation of the distance of two points; NaN where they are hardly seen together."""
    if not {one, other} <= set(recording.labels):
        return np.nan
    a, b = (
        recording.markers[:: max(1, len(recording.time) // MOST_FRAMES), recording.labels.index(m)]
        for m in (one, other)
    )
    apart = np.linalg.norm(a - b, axis=1)
    apart = apart[np.isfinite(apart)]
    return float(apart.std()) if len(apart) >= min(TOGETHER, len(recording.time)) else np.nan


def computed_of_pair(one: Array, other: Array, middle: Array) -> tuple[bool, bool]:
    """Which of two points (3,) that keep their distance exactly are computed: the inner one; both, where the body's
    `middle` (3,) lies between them.
    """
    along = (other - one) * [1.0, 0.0, 1.0]
    first, second = along @ (one - middle), along @ (other - middle)
    return bool(first * second <= 0 or first > 0), bool(first * second <= 0 or first < 0)


def named_centres(trials: Sequence[MarkerEvidence]) -> Iterator[Finding]:
    """Joint centres that a study takes for lateral markers."""
    static = next((t for t in trials if t.makes_model), None)
    if static is None or static.still_frames is None or static.marker_set.noise is not None:
        return
    moving = [t.recording for t in trials if not t.is_static]
    found = measured_instead(static.recording, static.still_frames, moving, static.marker_set, static.subject.height)
    if found:
        names = ", ".join(f'"{named}" = "{named} (centre)", "{other}" = "{named}"' for named, other in found.items())
        pairs = ", ".join(f"'{other}' outwards of '{named}'" for named, other in found.items())
        yield static.error(
            "landmarks",
            f"half a joint's width apart, and together in every trial: {pairs}",
            f"rename = {{ {names} }} under [markers]",
            cause=f"{', '.join(map(repr, found))} are joint centres that a program computed, not lateral markers",
            weight=10.0,
            code=Code.LANDMARK_DISPLACED,
        )
