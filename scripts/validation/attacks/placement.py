"""Markers that sit elsewhere on their segment than the static trial says.

Displacements are along the body's axes: (forward, up, right) of the pelvis in the first whole frame, carried on by the
segment.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from gaitcal import MarkerSet, Recording
from gaitcal.arrays import Array
from scripts.validation.attacks.markers import MM, NEIGHBOUR, WHOLE, Change, Part, columns, put
from scripts.validation.truth.rigid import rigid_motion


def body_axes(recording: Recording, markers: MarkerSet, frame: int) -> Array:
    """(3, 3) columns forward, up, right of the pelvis in a frame, horizontal."""
    right, left = (recording.markers[frame, columns(recording, markers, f"asis_{side}")].mean(axis=0) for side in "rl")
    across = (right - left) * [1.0, 0.0, 1.0]
    across /= np.linalg.norm(across)
    up = np.array([0.0, 1.0, 0.0])
    return np.column_stack([np.cross(up, across), up, across])


def segment_frames(recording: Recording, markers: MarkerSet, segment: str) -> tuple[Array, Array]:
    """(nf, 3, 3) body axes carried along by a segment, and (nf, 3) the middle of its markers."""
    own = columns(recording, markers, segment)
    helped = own
    if len(own) < 3:
        name, _, side = segment.partition("_")
        other = NEIGHBOUR[name] if NEIGHBOUR[name] == "pelvis" else f"{NEIGHBOUR[name]}_{side}"
        helped = [*own, *columns(recording, markers, other)]
    asis = [*columns(recording, markers, "asis_r"), *columns(recording, markers, "asis_l")]
    whole = np.isfinite(recording.markers[:, helped]).all(axis=(1, 2))
    first = int(np.flatnonzero(whole & np.isfinite(recording.markers[:, asis]).all(axis=(1, 2)))[0])
    turns, _ = rigid_motion(recording.markers[first, helped], recording.markers[whole][:, helped])
    carried = turns @ body_axes(recording, markers, first)
    seen = np.flatnonzero(whole)
    nearest = np.abs(np.arange(len(whole))[:, None] - seen).argmin(axis=1)
    with np.errstate(all="ignore"):
        middle = recording.markers[seen][:, own].mean(axis=1)
    return carried[nearest], middle[nearest]


def transformed(segment: str, change: Callable[[Array], Array], only: str | None = None, part: Part = WHOLE) -> Change:
    """Markers of a segment moved within it: `change` of (nf, nm, 3) m along forward, up, right from their middle."""

    def spoil(recording: Recording, markers: MarkerSet) -> Recording:
        axes, middle = segment_frames(recording, markers, segment)
        at = columns(recording, markers, only or segment)
        local = np.einsum("fji,fmj->fmi", axes, recording.markers[:, at] - middle[:, None])
        moved = np.einsum("fij,fmj->fmi", axes, change(local)) + middle[:, None]
        return put(recording, at, part, moved)

    return spoil


def displaced(segment: str, only: str, mm: tuple[float, float, float], part: Part = WHOLE) -> Change:
    """One marker (or landmark) of a segment elsewhere on it, by mm forward, up, right."""
    return transformed(segment, lambda local: local + MM * np.array(mm), only, part)


def slid(segment: str, mm: tuple[float, float, float], part: Part = WHOLE) -> Change:
    """All markers of a segment displaced together."""
    return transformed(segment, lambda local: local + MM * np.array(mm), None, part)


def turned(segment: str, degrees: float, axis: str = "y", part: Part = WHOLE) -> Change:
    """All markers of a segment turned together about their middle: x forward, y up, z right."""
    turn = Rotation.from_euler(axis, degrees, degrees=True).as_matrix()
    return transformed(segment, lambda local: local @ turn.T, None, part)


def mirrored_cluster(segment: str, part: Part = WHOLE) -> Change:
    """The markers of a segment as on the other side of its middle: a cluster of the other handedness."""
    return transformed(segment, lambda local: local * [1.0, 1.0, -1.0], None, part)
