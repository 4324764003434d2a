"""Detect computed joint centres under the labels of lateral markers.

Some programs export computed points beside measured ones. Of two points that move together, soft
tissue is never half a joint width outward of a lateral epicondyle or malleolus. The inner one,
whatever its label, is then the joint centre, and the outer one the marker. Two points that keep
their distance to a hundredth of a millimetre in motion are not both on the skin: the inner one is
computed.
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
"""Least scatter (m) of a measured distance in motion; below it one of the points is computed."""
CENTRE = " (centre)"  # Suffix for the label of a joint centre that had the label of a marker


def find_measured_markers(
    standing: Recording, moving: Sequence[Recording], marker_set: MarkerSet
) -> dict[str, str]:
    """Find the measured markers of joints whose centres have the labels of lateral markers.

    Parameters
    ----------
    standing
        The static trial, with the labels of the set.
    moving
        Moving trials: points that belong together keep their distance in them.
    marker_set
        The marker set.

    Returns
    -------
    dict of str to str
        Lateral marker of the set -> the unknown label of its measured point, for joints with one on
        both sides.

    Raises
    ------
    InputError
        If the person never stands still in `standing`.
    """
    window = find_still_window(standing, marker_set.labels).frames
    at = average_visible({m: standing.markers[window, i] for i, m in enumerate(standing.labels)})
    named = {}
    for n, m in resolve_marker_set(marker_set, standing).landmarks.items():
        if len(m) == 1 and m[0] in at:
            named[n] = m[0]
    if (
        not {f"{name}_{side}" for name in ("asis", "knee_lat", "ankle_lat") for side in SIDES}
        <= named.keys()
    ):
        return {}
    right = (at[named["asis_r"]] - at[named["asis_l"]]) * [1.0, 0.0, 1.0]
    right /= np.linalg.norm(right)
    # body height from the length of a shank
    height = (
        float(np.linalg.norm(at[named["knee_lat_r"]] - at[named["ankle_lat_r"]]))
        / LENGTHS["shank"][2]
    )
    # points of the file that the set does not know may be the measured markers
    strangers = [m for m in at if m not in marker_set.labels and m not in marker_set.devices]
    out: dict[str, str] = {}
    for joint in ("knee", "ankle"):
        found: dict[str, str] = {}
        for lateral, side in ((named[f"{joint}_lat_{side}"], side) for side in SIDES):
            for other in strangers:
                away = at[other] - at[lateral]
                outwards = sign(side) * float(away @ right)
                # half a joint width outward of the point with the marker's label
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
    """Return whether two points keep their distance, and `other` is not computed from others."""

    def measure_scatter(recording: Recording, label: str) -> float:
        if not {label, other} <= set(recording.labels):
            return np.nan
        a, b = (recording.markers[:, recording.labels.index(m)] for m in (label, other))
        distance = np.linalg.norm(a - b, axis=1)
        if np.isfinite(distance).sum() < min(COMMON_FRAMES, len(distance)):
            return np.nan
        return float(np.nanstd(distance))

    scatters = [measure_scatter(recording, one) for recording in moving]
    known = [scatter for scatter in scatters if np.isfinite(scatter)]
    thirds = (m for m in strangers if m != other)
    return (
        bool(known)
        and max(known) < FIXED_DISTANCE_M
        and not any(measure_scatter(r, m) < MEASURED_M for m in thirds for r in moving)
    )


def identify_computed_points(one: Array, other: Array, middle: Array) -> tuple[bool, bool]:
    """Identify which of two points that keep their distance exactly is computed: the inner one.

    Parameters
    ----------
    one, other
        (3,) m.
    middle
        (3,) m, middle of the body.

    Returns
    -------
    tuple of bool
        Whether `one` and whether `other` is computed; both if `middle` is between them.
    """
    along = (other - one) * [1.0, 0.0, 1.0]
    first, second = along @ (one - middle), along @ (other - middle)
    return bool(first * second <= 0 or first > 0), bool(first * second <= 0 or first < 0)


def check_named_centres(trials: Sequence[TrialEvidence]) -> Iterator[Finding]:
    """Report joint centres that have the labels of lateral markers.

    Yields one error of the static trial, or nothing.
    """
    static = next((t for t in trials if t.makes_model and t.model is not None), None)
    if static is None or static.marker_set.noise is not None:
        return
    moving = [t.recording for t in trials if not t.is_static]
    found = find_measured_markers(static.recording, moving, static.marker_set)
    if found:
        names = ", ".join(
            f'"{label}" = "{label}{CENTRE}", "{other}" = "{label}"'
            for label, other in found.items()
        )
        pairs = ", ".join(f"'{other}' outward of '{label}'" for label, other in found.items())
        yield static.error(
            "landmarks",
            f"half a joint width apart, at a constant distance in every trial: {pairs}",
            f"set rename = {{ {names} }} under [markers]",
            cause=f"{', '.join(map(repr, found))} are computed joint centres, not lateral markers",
            weight=10.0,
            code=Code.LANDMARK_DISPLACED,
        )
