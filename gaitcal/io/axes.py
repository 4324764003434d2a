"""Which way is up, and which way is forward: both read from the data, both brought about by exact
permutations.

A turn by a multiple of 90 degrees about a coordinate axis only swaps and negates coordinates, so no
number is rounded and a file converted to CSV reads back bit for bit. What a file *says* of its
screen axes is not looked at.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from gaitcal.arrays import Array
from gaitcal.io.labels import ComputedPoints
from gaitcal.io.recording import ForcePlate, Recording, seen_mask

LOADED_N = 100.0  # Force that tells the vertical: well above any offset
BODY_MARKERS, CLEARLY_TALLER = 10, 1.5
"""So many markers, so many times more spread along one axis than along either other, are a body
that stands. Arms held out sideways make 0.9."""
DOMINANT = 0.8  # Share of a force, or of a plate's normal, that must lie along one axis
PROGRESSION_M = (
    0.5  # Horizontal way above which a trial has a direction of its own; less is a step on the spot
)

OFF_X_DEG = 10.0
"""Angle between walk and x above which pelvis list and tilt mix noticeably: a sixth of the one is
in the other.
"""

AXES = "xyz"


@dataclass(frozen=True)
class Turn:
    """A proper rotation that maps axes onto axes: new coordinate i = sign[i] * old coordinate
    source[i].
    """

    source: tuple[int, int, int]
    sign: tuple[int, int, int]

    @property
    def is_identity(self) -> bool:
        """True where nothing changes."""
        return self.source == (0, 1, 2) and self.sign == (1, 1, 1)

    def apply(self, vectors: Array) -> Array:
        """Vectors (..., 3) in the new axes, exactly."""
        turned = vectors[..., list(self.source)]
        for axis, sign in enumerate(self.sign):
            if sign < 0:
                turned[..., axis] = -turned[..., axis]
        return np.asarray(turned)


UP_TO_Y = {
    (0, 1): Turn((2, 0, 1), (1, 1, 1)),
    (0, -1): Turn((2, 0, 1), (1, -1, -1)),
    (1, 1): Turn((0, 1, 2), (1, 1, 1)),
    (1, -1): Turn((0, 1, 2), (1, -1, -1)),
    (2, 1): Turn((0, 2, 1), (1, 1, -1)),
    (2, -1): Turn((0, 2, 1), (1, -1, 1)),
}
"""The turn that makes (axis, sign) the y axis."""

ABOUT_Y = (
    Turn((0, 1, 2), (1, 1, 1)),
    Turn((2, 1, 0), (1, 1, -1)),
    Turn((0, 1, 2), (-1, 1, -1)),
    Turn((2, 1, 0), (-1, 1, 1)),
)
"""Quarter turns about y; the old direction that becomes x is +x, +z, -x, -z."""
NEW_X = ("+x", "+z", "-x", "-z")


@dataclass(frozen=True)
class Vertical:
    """The axis that points up, and what showed it."""

    axis: int
    sign: int
    evidence: str

    @property
    def direction(self) -> Array:
        """(3,) unit vector."""
        up = np.zeros(3)
        up[self.axis] = self.sign
        return up

    def __str__(self) -> str:
        return f"{'+' if self.sign > 0 else '-'}{AXES[self.axis]}"


def find_vertical(markers: Array, plates: tuple[ForcePlate, ...]) -> Vertical | None:
    """The vertical of markers (nf, nm, 3) and plates in the axes of their file; None where nothing
    tells it.

    The axis is that of the plate forces under load, else of the plates' normals, else of the
    largest spread of the markers within a frame (a body is taller than wide, also with its arms
    out, where spread is the standard deviation). Its sign is that on which the body lies: above the
    plates, else above the origin.
    """
    axis, evidence = force_axis(plates), "the plate forces"
    if axis is None:
        axis, evidence = _normal_axis(plates), "the plate corners"
    if axis is None:
        spread, evidence = _spread(markers, 3), "the spread of the markers"
        if spread is None or not spread.max() > 0:
            return None
        axis = int(np.argmax(spread))
    heights = markers[..., axis][np.isfinite(markers[..., axis])]
    floors = [float(p.corners[:, axis].mean()) for p in plates if p.corners is not None]
    above = float(np.median(heights)) - (floors[0] if floors else 0.0) if len(heights) else 0.0
    return Vertical(axis, -1 if above < 0 else 1, evidence)


def force_axis(plates: Iterable[ForcePlate]) -> int | None:
    """The axis along which nearly all of the plates' force acts under load; None where there is
    none.
    """
    total = np.zeros(3)
    length = 0.0
    for plate in plates:
        size = np.linalg.norm(plate.force, axis=1)
        loaded = size > LOADED_N
        total += np.abs(plate.force[loaded]).sum(axis=0)
        length += float(size[loaded].sum())
    return int(np.argmax(total)) if length > 0 and total.max() > DOMINANT * length else None


def _normal_axis(plates: tuple[ForcePlate, ...]) -> int | None:
    """The axis along which the normals of all plates lie; None where they disagree or lie aslant."""
    corners = [plate.corners for plate in plates if plate.corners is not None]
    normals = [np.abs(np.cross(c[0] - c[1], c[0] - c[3])) for c in corners]
    axes = {int(np.argmax(n)) if n.max() > DOMINANT * np.linalg.norm(n) else None for n in normals}
    return axes.pop() if len(axes) == 1 else None


def _spread(markers: Array, fewest: int) -> Array | None:
    """(3,) m, how much the markers (nf, nm, 3) of a frame differ along each axis: median over some
    200 frames.

    Of frames with at least `fewest` markers; None where there is none.
    """
    visible = seen_mask(markers)
    frames = np.flatnonzero(visible.sum(axis=1) >= fewest)
    if not len(frames):
        return None
    spread = [np.std(markers[i][visible[i]], axis=0) for i in frames[:: max(1, len(frames) // 200)]]
    return np.asarray(np.median(spread, axis=0))


def body_vertical(markers: Array) -> Vertical | None:
    """The axis along which a whole body of markers (nf, nm, 3) stands; None where they do not tell
    it clearly.
    """
    spread = _spread(markers, BODY_MARKERS)
    if spread is None:
        return None
    axis = int(np.argmax(spread))
    clear = spread[axis] > CLEARLY_TALLER * np.delete(spread, axis).max()
    return Vertical(axis, 1, "the spread of the markers") if clear else None


def turn_plate(plate: ForcePlate, turn: Turn) -> ForcePlate:
    """A plate in new axes: force, point, moment and corners together."""
    force, point, moment = (
        turn.apply(vectors) for vectors in (plate.force, plate.point, plate.moment)
    )
    corners = None if plate.corners is None else turn.apply(plate.corners)
    return replace(plate, force=force, point=point, moment=moment, corners=corners)


def turn_recording(recording: Recording, turn: Turn) -> Recording:
    """Markers and plates in new axes; force, point, moment and corners turn together."""
    if turn.is_identity:
        return recording
    plates = tuple(turn_plate(plate, turn) for plate in recording.plates)
    computed = recording.computed
    if computed is not None:
        computed = ComputedPoints(computed.labels, turn.apply(computed.points))
    return replace(
        recording, markers=turn.apply(recording.markers), plates=plates, computed=computed
    )


def make_y_up(recording: Recording, otherwise: Vertical) -> Recording:
    """The recording with its vertical, found from the data, as y; `otherwise` where the data do not
    tell.
    """
    vertical = find_vertical(recording.markers, recording.plates)
    if vertical is not None and UP_TO_Y[vertical.axis, vertical.sign].is_identity:
        return recording
    return turn_up(recording, vertical or otherwise)


def turn_up(recording: Recording, vertical: Vertical) -> Recording:
    """The recording with `vertical` as y, and a note that tells which axis of the file that was."""
    turned = turn_recording(recording, UP_TO_Y[vertical.axis, vertical.sign])
    return turned.with_notes(
        f"Vertical axis of the file is {vertical}, after {vertical.evidence}; y is up here."
    )


def net_progression(recording: Recording) -> Array:
    """(3,) m, horizontal way of the body from first to last sight: median over the markers seen
    most of the time.
    """
    visible = seen_mask(recording.markers)
    ways = []
    for marker in np.flatnonzero(visible.sum(axis=0) > 0.5 * len(recording.time)):
        frames = np.flatnonzero(visible[:, marker])
        ways.append(recording.markers[frames[-1], marker] - recording.markers[frames[0], marker])
    way = np.median(ways, axis=0) if ways else np.zeros(3)
    way[1] = 0.0
    return np.asarray(way)


def turn_to_progression(recording: Recording, forward: Array | None = None) -> Recording:
    """Quarter turns about y until x is nearest to the way the body goes.

    A trial that moves less than PROGRESSION_M takes `forward` (3,), the direction the body faces,
    if given; else it stays. The whole recording turns, so x is within 45 degrees of the
    progression, and no number is rounded. A note tells a walk that is then more than OFF_X_DEG off
    x.
    """
    way = net_progression(recording)
    walks = bool(np.hypot(way[0], way[2]) > PROGRESSION_M)
    if not walks:
        if forward is None:
            return recording
        way = np.asarray(forward, dtype=np.float64)
    along = np.array([way[0], way[2], -way[0], -way[2]])
    if not np.all(np.isfinite(along)) or not along.any():
        return recording
    choice = int(np.argmax(along))
    notes: tuple[str, ...] = ()
    if choice:
        notes += (
            f"Turned about the vertical so that the file's {NEW_X[choice]} (y up) is forward, +x.",
        )
    ahead, _, right = ABOUT_Y[choice].apply(way)
    angle = float(np.rad2deg(np.arctan2(right, ahead)))
    if walks and abs(angle) > OFF_X_DEG:
        notes += (
            f"The walk goes {abs(angle):.0f} deg to the {'right' if angle > 0 else 'left'} of x: "
            "pelvis angles are "
            "relative to the laboratory's x, so list and tilt mix and rotation holds this angle "
            "(those of cycles.csv "
            "are along each stride); other joint angles and torques do not depend on it.",
        )
    return turn_recording(recording, ABOUT_Y[choice]).with_notes(*notes) if notes else recording
