"""Joint centres under the names of lateral markers: a program exports what it computed beside what
it measured.

Of two points that stay together, no skin is half a joint's width outwards of a lateral epicondyle
or malleolus: then the inner one, whatever its name, is the centre of the joint, and the outer one
the marker. Nor are two points that keep their distance to a hundredth of a millimetre, while
somebody moves, both on skin: the inner one is computed.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from gaitcal.arrays import Array
from gaitcal.errors import Code, Finding
from gaitcal.io.recording import Recording, average_visible, find_still_window
from gaitcal.model.body_plan import LENGTHS
from gaitcal.model.linkage import SIDES
from gaitcal.model.marker_set import MarkerSet
from gaitcal.model.present_markers import resolve_marker_set
from gaitcal.model.segment_frames import PLAUSIBLE_WIDTH, compute_half_width, sign
from gaitcal.preprocess.trial_evidence import TrialEvidence
from gaitcal.quality.marker_checks import COMMON_FRAMES, FIXED_DISTANCE_M

MEASURED_M = 1e-5
"""Least scatter of a distance that cameras measure while somebody moves; of less, a program
computed a point.
"""
CENTRE = " (centre)"  # Ends the name of a joint centre that bore the label of a marker


def find_measured_markers(
    standing: Recording, moving: Sequence[Recording], marker_set: MarkerSet
) -> dict[str, str]:
    """Find the measured markers of joints whose centres bear the names of lateral markers.

    Parameters
    ----------
    standing, moving : Recording, sequence of Recording
        Where points are, and which stay together, spelt as in the set; InputError where nobody
        stands still.

    Returns
    -------
    dict of str to str
        Lateral marker of the set -> the label that the set does not know, of joints of which both
        sides show it.
    """
    window = find_still_window(standing, marker_set.labels).frames
    at = average_visible({m: standing.markers[window, i] for i, m in enumerate(standing.labels)})
    named = {
        n: m[0]
        for n, m in resolve_marker_set(marker_set, standing).landmarks.items()
        if len(m) == 1 and m[0] in at
    }
    if (
        not {f"{name}_{side}" for name in ("asis", "knee_lat", "ankle_lat") for side in SIDES}
        <= named.keys()
    ):
        return {}
    right = (at[named["asis_r"]] - at[named["asis_l"]]) * [1.0, 0.0, 1.0]
    right /= np.linalg.norm(right)
    height = (
        float(np.linalg.norm(at[named["knee_lat_r"]] - at[named["ankle_lat_r"]]))
        / LENGTHS["shank"][2]
    )
    strangers = [m for m in at if m not in marker_set.labels and m not in marker_set.devices]
    out: dict[str, str] = {}
    for joint in ("knee", "ankle"):
        found: dict[str, str] = {}
        for lateral, side in ((named[f"{joint}_lat_{side}"], side) for side in SIDES):
            for other in strangers:
                away = at[other] - at[lateral]
                outwards = sign(side) * float(away @ right)
                wide = (
                    PLAUSIBLE_WIDTH[0]
                    <= outwards / compute_half_width(joint, height)
                    <= PLAUSIBLE_WIDTH[1]
                )
                if (
                    wide
                    and 2.0 * outwards**2 > away @ away
                    and _is_rigid_pair(moving, lateral, other, strangers)
                ):
                    found[lateral] = other
        out |= found if len(found) == len(SIDES) else {}
    return out


def _is_rigid_pair(
    moving: Sequence[Recording], one: str, other: str, strangers: Sequence[str]
) -> bool:
    """Whether two points keep their distance, and the second one is no computed point that a third
    one shows.
    """

    def scatter(recording: Recording, label: str) -> float:
        if not {label, other} <= set(recording.labels):
            return np.nan
        a, b = (recording.markers[:, recording.labels.index(m)] for m in (label, other))
        apart = np.linalg.norm(a - b, axis=1)
        return (
            float(np.nanstd(apart))
            if np.isfinite(apart).sum() >= min(COMMON_FRAMES, len(apart))
            else np.nan
        )

    kept = [value for r in moving if np.isfinite(value := scatter(r, one))]
    thirds = (m for m in strangers if m != other)
    return (
        bool(kept)
        and max(kept) < FIXED_DISTANCE_M
        and not any(scatter(r, m) < MEASURED_M for m in thirds for r in moving)
    )


def identify_computed_points(one: Array, other: Array, middle: Array) -> tuple[bool, bool]:
    """Which of two points (3,) that keep their distance exactly are computed: the inner one; both,
    where the body's `middle` (3,) lies between them.
    """
    along = (other - one) * [1.0, 0.0, 1.0]
    first, second = along @ (one - middle), along @ (other - middle)
    return bool(first * second <= 0 or first > 0), bool(first * second <= 0 or first < 0)


def check_named_centres(trials: Sequence[TrialEvidence]) -> Iterator[Finding]:
    """Joint centres that a study takes for lateral markers."""
    static = next((t for t in trials if t.makes_model and t.model is not None), None)
    if static is None or static.marker_set.noise is not None:
        return
    moving = [t.recording for t in trials if not t.is_static]
    if found := find_measured_markers(static.recording, moving, static.marker_set):
        names = ", ".join(
            f'"{label}" = "{label}{CENTRE}", "{other}" = "{label}"'
            for label, other in found.items()
        )
        pairs = ", ".join(f"'{other}' outwards of '{label}'" for label, other in found.items())
        yield static.error(
            "landmarks",
            f"half a joint's width apart, and together in every trial: {pairs}",
            f"rename = {{ {names} }} under [markers]",
            cause=f"{', '.join(map(repr, found))} are joint centres that a program computed, not "
            "lateral markers",
            weight=10.0,
            code=Code.LANDMARK_DISPLACED,
        )
