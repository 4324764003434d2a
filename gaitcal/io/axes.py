"""Find the vertical and the direction of progression of a recording, and rotate it accordingly.

Both are found from the data; what a file declares about its screen axes is not used. A rotation by
a multiple of 90 degrees about a coordinate axis only swaps and negates coordinates. No number is
rounded, so a file that is converted to CSV reads back to the same bits.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from gaitcal.arrays import Array
from gaitcal.io.labels import ComputedPoints
from gaitcal.io.recording import ForcePlate, Recording, find_visible

# Least force (N) that shows the vertical axis: well above any plate offset
LEAST_FORCE_N = 100.0
BODY_MARKERS, CLEARLY_TALLER = 10, 1.5
"""Least number of markers, and least ratio of their spread along one axis to that along any other,
for a standing body. Arms held out sideways give a ratio of 0.9.
"""
# Least share of a force, or of a plate's normal, along one axis; 0.8 is within 37 degrees
DOMINANT_SHARE = 0.8
# Least horizontal displacement (m) that defines a direction of walking; less is a step on the spot
LEAST_PROGRESSION_M = 0.5

OFF_X_DEG = 10.0
"""Largest angle (deg) between walk and x without a note. Above it pelvic list and tilt mix
noticeably: a sixth of one appears in the other.
"""

AXES = "xyz"


@dataclass(frozen=True)
class AxisPermutation:
    """Proper rotation that maps axes onto axes: new[i] = sign[i] * old[source[i]]."""

    source: tuple[int, int, int]
    sign: tuple[int, int, int]

    @property
    def is_identity(self) -> bool:
        """True if the rotation changes nothing."""
        return self.source == (0, 1, 2) and self.sign == (1, 1, 1)

    def apply(self, vectors: Array) -> Array:
        """Rotate vectors exactly.

        Parameters
        ----------
        vectors : (..., 3)
            Vectors in the old axes.

        Returns
        -------
        Array
            (..., 3) in the new axes.
        """
        rotated = vectors[..., list(self.source)]
        for axis, sign in enumerate(self.sign):
            if sign < 0:
                rotated[..., axis] = -rotated[..., axis]
        return np.asarray(rotated)


UP_TO_Y = {
    (0, 1): AxisPermutation((2, 0, 1), (1, 1, 1)),
    (0, -1): AxisPermutation((2, 0, 1), (1, -1, -1)),
    (1, 1): AxisPermutation((0, 1, 2), (1, 1, 1)),
    (1, -1): AxisPermutation((0, 1, 2), (1, -1, -1)),
    (2, 1): AxisPermutation((0, 2, 1), (1, 1, -1)),
    (2, -1): AxisPermutation((0, 2, 1), (1, -1, 1)),
}
"""(axis, sign) of the vertical -> the rotation that makes it the y axis."""

QUARTER_ROTATIONS = (
    AxisPermutation((0, 1, 2), (1, 1, 1)),
    AxisPermutation((2, 1, 0), (1, 1, -1)),
    AxisPermutation((0, 1, 2), (-1, 1, -1)),
    AxisPermutation((2, 1, 0), (-1, 1, 1)),
)
"""Quarter rotations about y; the old direction that becomes x is +x, +z, -x, -z (`NEW_X`)."""
NEW_X = ("+x", "+z", "-x", "-z")


@dataclass(frozen=True)
class Vertical:
    """Axis that points up, and the evidence for it."""

    axis: int
    sign: int
    evidence: str

    @property
    def direction(self) -> Array:
        """(3,) unit vector that points up."""
        up = np.zeros(3)
        up[self.axis] = self.sign
        return up

    def __str__(self) -> str:
        return f"{'+' if self.sign > 0 else '-'}{AXES[self.axis]}"


def find_vertical(markers: Array, plates: tuple[ForcePlate, ...]) -> Vertical | None:
    """Find the vertical from markers and plates in the axes of their file.

    The axis is that of the plate forces under load, else of the plates' normals, else of the
    largest spread (standard deviation) of the markers within a frame. A body is taller than wide,
    also with its arms out. The sign is the side on which the body is: above the plates, else above
    the origin.

    Parameters
    ----------
    markers : (nf, nm, 3)
        Marker positions, m; NaN where a marker was not visible.
    plates
        Force plates in the same axes.

    Returns
    -------
    Vertical or None
        None if the data do not show it.
    """
    axis, evidence = find_force_axis(plates), "the plate forces"
    if axis is None:
        axis, evidence = _find_normal_axis(plates), "the plate corners"
    if axis is None:
        spread, evidence = _measure_spread(markers, 3), "the spread of the markers"
        if spread is None or not spread.max() > 0:
            return None
        axis = int(np.argmax(spread))
    heights = markers[..., axis][np.isfinite(markers[..., axis])]
    floors = [float(p.corners[:, axis].mean()) for p in plates if p.corners is not None]
    above = float(np.median(heights)) - (floors[0] if floors else 0.0) if len(heights) else 0.0
    return Vertical(axis, -1 if above < 0 else 1, evidence)


def find_force_axis(plates: Iterable[ForcePlate]) -> int | None:
    """Find the axis along which most of the plate force acts under load.

    Parameters
    ----------
    plates
        Force plates in the axes of their file.

    Returns
    -------
    int or None
        Axis 0, 1 or 2; None if no axis has `DOMINANT_SHARE` of the force.
    """
    total = np.zeros(3)
    length = 0.0
    for plate in plates:
        size = np.linalg.norm(plate.force, axis=1)
        loaded = size > LEAST_FORCE_N
        total += np.abs(plate.force[loaded]).sum(axis=0)
        length += float(size[loaded].sum())
    return int(np.argmax(total)) if length > 0 and total.max() > DOMINANT_SHARE * length else None


def _find_normal_axis(plates: tuple[ForcePlate, ...]) -> int | None:
    """Find the axis of all plate normals; None if they disagree or are oblique."""
    corners = [plate.corners for plate in plates if plate.corners is not None]
    normals = [np.abs(np.cross(c[0] - c[1], c[0] - c[3])) for c in corners]
    axes = {
        int(np.argmax(n)) if n.max() > DOMINANT_SHARE * np.linalg.norm(n) else None for n in normals
    }
    return axes.pop() if len(axes) == 1 else None


def _measure_spread(markers: Array, fewest: int) -> Array | None:
    """Measure the spread (m) of the markers within a frame along each axis.

    Returns the median (3,) of standard deviations over some 200 frames that have at least `fewest`
    markers; None without such a frame.
    """
    visible = find_visible(markers)
    frames = np.flatnonzero(visible.sum(axis=1) >= fewest)
    if not len(frames):
        return None
    spread = [np.std(markers[i][visible[i]], axis=0) for i in frames[:: max(1, len(frames) // 200)]]
    return np.asarray(np.median(spread, axis=0))


def find_body_vertical(markers: Array) -> Vertical | None:
    """Find the axis along which a whole body stands.

    Parameters
    ----------
    markers : (nf, nm, 3)
        Marker positions, m.

    Returns
    -------
    Vertical or None
        Positive sign by convention; None if the spread of the markers is ambiguous.
    """
    spread = _measure_spread(markers, BODY_MARKERS)
    if spread is None:
        return None
    axis = int(np.argmax(spread))
    clear = spread[axis] > CLEARLY_TALLER * np.delete(spread, axis).max()
    return Vertical(axis, 1, "the spread of the markers") if clear else None


def rotate_plate(plate: ForcePlate, rotation: AxisPermutation) -> ForcePlate:
    """Rotate force, point, moment and corners of a plate into new axes.

    Parameters
    ----------
    plate
        Plate in the old axes.
    rotation
        Rotation from the old axes to the new ones.

    Returns
    -------
    ForcePlate
        The plate in the new axes.
    """
    force, point, moment = (
        rotation.apply(vectors) for vectors in (plate.force, plate.point, plate.moment)
    )
    corners = None if plate.corners is None else rotation.apply(plate.corners)
    return replace(plate, force=force, point=point, moment=moment, corners=corners)


def rotate_recording(recording: Recording, rotation: AxisPermutation) -> Recording:
    """Rotate markers, computed points and plates of a recording into new axes.

    `recording`: recording in the old axes. `rotation`: rotation from the old axes to the new ones.
    Returns: the recording in the new axes.
    """
    if rotation.is_identity:
        return recording
    plates = tuple(rotate_plate(plate, rotation) for plate in recording.plates)
    computed = recording.computed
    if computed is not None:
        computed = ComputedPoints(computed.labels, rotation.apply(computed.points))
    return replace(
        recording, markers=rotation.apply(recording.markers), plates=plates, computed=computed
    )


def make_y_up(recording: Recording, otherwise: Vertical) -> Recording:
    """Rotate a recording so that its vertical is y.

    Parameters
    ----------
    recording
        Recording in the axes of its file.
    otherwise
        Vertical to use if the data do not show it.

    Returns
    -------
    Recording
        The recording with y up, with a note if it was rotated.
    """
    vertical = find_vertical(recording.markers, recording.plates)
    if vertical is not None and UP_TO_Y[vertical.axis, vertical.sign].is_identity:
        return recording
    return rotate_vertical_to_y(recording, vertical or otherwise)


def rotate_vertical_to_y(recording: Recording, vertical: Vertical) -> Recording:
    """Rotate a recording so that `vertical` becomes y, with a note that names the file's axis.

    Parameters
    ----------
    recording
        Recording in the axes of its file.
    vertical
        Its vertical and the evidence for it.

    Returns
    -------
    Recording
        The recording with y up.
    """
    rotated = rotate_recording(recording, UP_TO_Y[vertical.axis, vertical.sign])
    return rotated.with_notes(
        f"Vertical axis of the file is {vertical}, after {vertical.evidence}; y is up here."
    )


def measure_progression(recording: Recording) -> Array:
    """Measure the horizontal displacement of the body over a recording.

    Parameters
    ----------
    recording
        Recording with y up.

    Returns
    -------
    Array
        (3,) m, from first to last visible position. It is the median over markers that are visible
        in more than half of the frames.
    """
    visible = find_visible(recording.markers)
    ways = []
    for marker in np.flatnonzero(visible.sum(axis=0) > 0.5 * len(recording.time)):
        frames = np.flatnonzero(visible[:, marker])
        ways.append(recording.markers[frames[-1], marker] - recording.markers[frames[0], marker])
    displacement = np.median(ways, axis=0) if ways else np.zeros(3)
    displacement[1] = 0.0
    return np.asarray(displacement)


def rotate_to_progression(recording: Recording, forward: Array | None = None) -> Recording:
    """Rotate a recording about y by quarter turns until x is nearest to the direction of walking.

    A trial that moves less than `LEAST_PROGRESSION_M` uses `forward`. The whole recording is
    rotated, so x is within 45 degrees of the progression and no number is rounded. A note reports a
    walk that is then more than `OFF_X_DEG` off x.

    Parameters
    ----------
    forward
        (3,), optional Direction that the body faces, for a trial without progression; without it
        such a trial stays.

    Returns
    -------
    Recording
        The rotated recording, or the same one.
    """
    displacement = measure_progression(recording)
    walks = bool(np.hypot(displacement[0], displacement[2]) > LEAST_PROGRESSION_M)
    if not walks:
        if forward is None:
            return recording
        displacement = np.asarray(forward, dtype=np.float64)
    along = np.array([displacement[0], displacement[2], -displacement[0], -displacement[2]])
    if not np.all(np.isfinite(along)) or not along.any():
        return recording
    choice = int(np.argmax(along))
    notes: tuple[str, ...] = ()
    if choice:
        notes += (
            f"Turned about the vertical so that the file's {NEW_X[choice]} (y up) is forward, +x.",
        )
    ahead, _, right = QUARTER_ROTATIONS[choice].apply(displacement)
    angle = float(np.rad2deg(np.arctan2(right, ahead)))
    if walks and abs(angle) > OFF_X_DEG:
        notes += (
            f"The walk goes {abs(angle):.0f} deg to the {'right' if angle > 0 else 'left'} of x: "
            "pelvis angles are "
            "relative to the laboratory's x, so list and tilt mix and rotation includes this angle "
            "(those of cycles.csv "
            "are along each stride); other joint angles and torques do not depend on it.",
        )
    return (
        rotate_recording(recording, QUARTER_ROTATIONS[choice]).with_notes(*notes)
        if notes
        else recording
    )
