"""Compare the landmarks of a standing person with those of people.

A measure m of the landmarks p has the deviation z from people's mean, in their standard deviations,

    z = (m(p) - mean) / sd,        J(p) = sum z^2.

Lengths are shares of body height, so that they serve children. Differences between right and left
are in mm. Body axes: x the mean horizontal direction from heels to toes (or across the pelvis if a
foot is missing); y up; z = x x y, to the right. Widths and distances have the sign of their
component along their axis. A landmark on the wrong side then deviates by twice the length.

Means: de Leva 1996 (thigh, shank), Winter 2009 (foot, height of the hips), ANSUR II (ankle width
0.0415, lateral epicondyle less malleolus 0.240 of stature, standard deviations 0.0022 and 0.007),
widths with 7 mm of marker and skin on either side. Standard deviations include palpation. They were
measured on thirteen recordings of adults and children (largest |z| 2.5).

People differ in build and stance although no landmark is wrong. A joint rotated by theta and
shifted by s moves all landmarks distal to it. With theta ~ N(0, JOINT_ROTATION_DEG^2) and s ~ N(0,
JOINT_SHIFT_M^2) about and along each body axis at hips, knees and ankles of both sides, and B = [dz
/ dtheta JOINT_ROTATION_DEG, dz / ds JOINT_SHIFT_M] at p, the best such explanation of z costs

    min over x of |z - B x|^2 + |x|^2  =  z^T (I + B B^T)^-1 z.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from gaitcal.arrays import Array, cross
from gaitcal.model.linkage import SIDE_WORDS, SIDES
from gaitcal.model.segment_frames import sign

Landmarks = Mapping[str, Array]  # Name -> (3,) m, y up
WIDTHS = {"knee": (0.066, 0.009), "ankle": (0.052, 0.006)}
"""Mean and sd of the distance from lateral to medial marker. Knees of four heavy children and
women, by callipers: 0.057 to 0.078 of height, 0.009 more with markers."""
LENGTHS: dict[str, tuple[str, str, float, float]] = {
    "shank": ("knee_lat", "ankle_lat", 0.245, 0.011),
    "medial shank": ("knee_med", "ankle_med", 0.235, 0.015),
    "ASIS to knee": ("asis", "knee_lat", 0.285, 0.015),
    "ASIS to sacrum": ("asis", "sacrum", 0.130, 0.015),
    "heel to toe": ("heel", "toe", 0.135, 0.028),
    "heel to ankle": ("heel", "ankle_lat", 0.050, 0.009),
    "toe to ankle": ("toe", "ankle_lat", 0.100, 0.026),
    "heel to medial ankle": ("heel", "ankle_med", 0.060, 0.010),
    "toe to medial ankle": ("toe", "ankle_med", 0.095, 0.026),
}
"""Measure -> two landmarks of a leg, mean and sd of their distance, shares of height."""
LENGTH_DIRECTIONS = {
    "heel to toe": (0, 1.0),
    "ASIS to sacrum": (0, -1.0),
    "shank": (1, -1.0),
    "medial shank": (1, -1.0),
    "ASIS to knee": (1, -1.0),
}
"""Length -> the axis of the body along which it should lie, and to which end of it."""
DIFFERENCES_MM = {
    "shank": 11.0,
    "medial shank": 11.0,
    "ASIS to knee": 9.0,
    "ASIS to sacrum": 7.0,
    "heel to toe": 6.0,
    "heel to ankle": 9.0,
    "toe to ankle": 9.0,
    "heel to medial ankle": 7.0,
    "toe to medial ankle": 9.0,
    "knee": 5.0,
    "ankle": 4.0,
}
"""Measure -> sd of its right less its left."""
HEIGHTS_MM = {
    "asis": 12.0,
    "knee_lat": 12.0,
    "knee_med": 10.0,
    "ankle_lat": 5.0,
    "ankle_med": 7.0,
    "heel": 6.0,
}
HEIGHTS_MM |= {"toe": 6.0}
"""Landmark -> sd of the difference in height of its right and left, standing."""
SIDE_DISTANCES: dict[str, tuple[float, float]] = {
    "asis": (0.144, 0.02),
    "knee_lat": (0.20, 0.06),
    "knee_med": (0.09, 0.06),
    "ankle_lat": (0.18, 0.07),
    "ankle_med": (0.11, 0.07),
    "heel": (0.13, 0.07),
    "toe": (0.16, 0.07),
}
"""Landmark -> mean and sd of how far its right lies to the right of its left, share of height."""
# Height of the ASIS above the lateral malleoli, share of height: mean and sd
HIP_HEIGHT = (0.53, 0.035)
BOW_DEG, BEND_DEG = 2.5, 5.0
"""sd of the difference between right and left of the angle at the lateral knee, from the front and
from the side.
"""
LINES_DEG = {("asis", "knee_lat"): 4.0, ("knee_lat", "ankle_lat"): 4.0}
"""sd of the angle from above between the lines from left to right through two landmarks."""
# sd of the difference between right and left of a joint's line, seen from above
AXIS_DEG = 11.0
JOINT_ROTATION_DEG = 8.0
"""Standard deviation about each axis. Torsion of the tibia scatters by 8 deg, version of the femur
by 9 (Strecker et al. 1997), the line of the leg from the front by 2 to 3, all more in patients."""
# Standard deviation along each axis: as joints lie otherwise in their segments than in most people
JOINT_SHIFT_M = 0.006
STEP_DEG, STEP_M = 0.5, 5e-4
DISTAL_LANDMARKS = {
    "hip": ("knee_lat", "knee_med", "ankle_lat", "ankle_med", "heel", "toe"),
    "knee": ("ankle_lat", "ankle_med", "heel", "toe"),
    "ankle": ("heel", "toe"),
}
"""Joint -> landmarks that move with what lies beyond it."""
CENTRE_LANDMARKS = {
    "hip": ("asis",),
    "knee": ("knee_lat", "knee_med"),
    "ankle": ("ankle_lat", "ankle_med"),
}
"""Joint -> landmarks whose mean stands for its centre."""


@dataclass(frozen=True)
class LandmarkMeasure:
    """One measure of the landmarks, with mean and standard deviation of people."""

    name: str  # In words: `knee width, right`
    value: float  # mm, or degrees
    mean: float
    sd: float
    landmarks: tuple[str, ...]  # Which it depends on most
    unit: str = "mm"
    # A length against people of that height, and not right against left
    absolute: bool = False
    postural: bool = False  # Depends on how the person stands

    @property
    def z(self) -> float:
        """Deviation from the mean in standard deviations."""
        return (self.value - self.mean) / self.sd

    @property
    def description(self) -> str:
        """The measured value and the usual range, for messages."""
        if self.absolute:
            low, high = self.mean - 3 * self.sd, self.mean + 3 * self.sd
            return (
                f"{self.name} {self.value:.0f} {self.unit} (people of this height have {low:.0f} "
                f"to {high:.0f})"
            )
        return f"{self.name} {self.value:+.0f} {self.unit} (usual within {3 * self.sd:.0f})"


def sum_squared_deviations(found: Sequence[LandmarkMeasure]) -> float:
    """Sum the squared deviations z of measures: the cost J."""
    return float(sum(m.z**2 for m in found))


def compute_body_axes(p: Landmarks) -> Array | None:
    """Compute the body axes of a standing person.

    Parameters
    ----------
    p : mapping of str to (3,) array
        Landmarks, m, y up. Forward is the mean of both feet. One foot alone is rotated outwards by
        up to 26 degrees, so the direction across the pelvis is used then.

    Returns
    -------
    (3, 3) array or None
        Columns x forward, y up, z right; None if no landmarks give a direction.
    """
    feet = np.array(
        [p[f"toe_{s}"] - p[f"heel_{s}"] for s in SIDES if f"toe_{s}" in p and f"heel_{s}" in p]
    )
    if len(feet) < len(SIDES) and "asis_r" in p and "asis_l" in p:
        feet = cross(np.array([0.0, 1.0, 0.0]), p["asis_r"] - p["asis_l"])[None]
    if not len(feet):
        return None
    feet[:, 1] = 0.0
    forward = feet.mean(axis=0)
    length = math.sqrt(forward @ forward)
    if length < 1e-6:
        return None
    x, y = forward / length, np.array([0.0, 1.0, 0.0])
    return np.column_stack([x, y, cross(x, y)])


def measure_landmarks(p: Landmarks, height: float, *, even: bool = True) -> list[LandmarkMeasure]:
    """Measure all lengths, widths, angles and differences that the landmarks allow.

    Parameters
    ----------
    p : mapping of str to (3,) array
        Landmarks, m, y up.
    height : float
        Body height, m.
    even : bool
        Whether the person stands evenly on straight legs; else measures of the posture are left
        out.

    Returns
    -------
    list of LandmarkMeasure
        Empty if the body axes are unknown.
    """
    axes = compute_body_axes(p)
    if axes is None:
        return []
    q, mm = {name: 1e3 * (point @ axes) for name, point in p.items()}, 1e3 * height
    found = [
        *_measure_lengths(q, mm),
        *_measure_widths(q, mm),
        *_measure_side_distances(q, mm),
        *_measure_knee_angles(q),
        *_measure_line_angles(q),
    ]
    return found if even else [m for m in found if not m.postural]


def estimate_height(p: Landmarks) -> tuple[float, float] | None:
    """Estimate the body height from the legs of a standing person.

    Parameters
    ----------
    p : mapping of str to (3,) array
        Landmarks, m, y up.

    Returns
    -------
    tuple of float, or None
        Height and its standard deviation, m; None without landmarks of a leg.

    Notes
    -----
    Each length gives a height with the deviation of its share among people. Long thighs go with
    long shanks, so the errors are taken as fully correlated. (Eleven people: 3.5 % RMS, 4.8 %
    claimed.)
    """
    heights = []
    for name in ("shank", "medial shank", "ASIS to knee"):
        a, b, mean, sd = LENGTHS[name]
        pairs = [
            (p[f"{a}_{s}"], p[f"{b}_{s}"]) for s in SIDES if {f"{a}_{s}", f"{b}_{s}"} <= set(p)
        ]
        heights += [(math.dist(*pair) / mean, sd / mean) for pair in pairs]
    share, sd = HIP_HEIGHT
    standing = [s for s in SIDES if {f"asis_{s}", f"ankle_lat_{s}"} <= set(p)]
    heights += [
        (float(p[f"asis_{s}"][1] - p[f"ankle_lat_{s}"][1]) / share, sd / share) for s in standing
    ]
    if not heights:
        return None
    height, relative = np.array(heights).T
    weight = relative**-2 / (relative**-2).sum()
    return float(weight @ height), float(weight @ height * (weight @ relative))


def _measure_lengths(q: Landmarks, height: float) -> Iterator[LandmarkMeasure]:
    """Measure lengths of a leg (mm); negative if they point the wrong way along their axis."""
    for name, (a, b, mean, sd) in LENGTHS.items():
        found, pairs = {}, {s: (f"{a}_{s}", b if b == "sacrum" else f"{b}_{s}") for s in SIDES}
        axis, towards = LENGTH_DIRECTIONS.get(name, (0, 0.0))
        for side, (one, other) in pairs.items():
            if one in q and other in q:
                d = q[other] - q[one]
                found[side] = math.sqrt(d @ d) * (1.0 if towards * d[axis] >= 0 else -1.0)
        yield from _compare_sides(name, found, pairs, (mean * height, sd * height))


def _measure_widths(q: Landmarks, height: float) -> Iterator[LandmarkMeasure]:
    """Measure the widths (mm) of knees and ankles; negative if lateral and medial are swapped."""
    for joint, (mean, sd) in WIDTHS.items():
        found, pairs = {}, {side: (f"{joint}_lat_{side}", f"{joint}_med_{side}") for side in SIDES}
        for side, (lateral, medial) in pairs.items():
            if lateral in q and medial in q:
                d = q[lateral] - q[medial]
                found[side] = math.sqrt(d @ d) * (1.0 if sign(side) * d[2] >= 0 else -1.0)
        yield from _compare_sides(f"{joint} width", found, pairs, (mean * height, sd * height))


def _compare_sides(
    name: str,
    found: Mapping[str, float],
    pairs: Mapping[str, tuple[str, str]],
    people: tuple[float, float],
) -> Iterator[LandmarkMeasure]:
    """Compare a length (mm) with people, and right with left."""
    for side, value in found.items():
        yield LandmarkMeasure(
            f"{name}, {SIDE_WORDS[side]}", value, *people, pairs[side], absolute=True
        )
    if len(found) == 2:
        sd = DIFFERENCES_MM[name.removesuffix(" width")]
        yield LandmarkMeasure(
            f"{name}, right less left", found["r"] - found["l"], 0.0, sd, (*pairs["r"], *pairs["l"])
        )


def _measure_side_distances(q: Landmarks, height: float) -> Iterator[LandmarkMeasure]:
    """Measure distances and heights (mm) between right and left landmarks."""
    for name, (mean, sd) in SIDE_DISTANCES.items():
        both = (f"{name}_r", f"{name}_l")
        if all(end in q for end in both):
            _, up, right = (q[both[0]] - q[both[1]]).tolist()
            yield LandmarkMeasure(
                f"{name} right of left", right, mean * height, sd * height, both, absolute=True
            )
            yield LandmarkMeasure(
                f"height of {name}, right less left", up, 0.0, HEIGHTS_MM[name], both, postural=True
            )
    ends = tuple(f"{name}_{side}" for name in ("asis", "ankle_lat") for side in SIDES)
    if all(name in q for name in ends):
        above = 0.5 * float(q[ends[0]][1] + q[ends[1]][1] - q[ends[2]][1] - q[ends[3]][1])
        mean, sd = (share * height for share in HIP_HEIGHT)
        yield LandmarkMeasure(
            "ASIS above ankles", above, mean, sd, ends, absolute=True, postural=True
        )


def _measure_knee_angles(q: Landmarks) -> Iterator[LandmarkMeasure]:
    """Measure differences of knee angles (deg), right less left (mirrored)."""
    chain = ("asis", "knee_lat", "ankle_lat")
    names = tuple(f"{name}_{side}" for side in SIDES for name in chain)
    if not all(name in q for name in names):
        return
    for axis, what, sd in (
        (2, "bow of the leg from the front", BOW_DEG),
        (0, "bend of the knee", BEND_DEG),
    ):
        at_knee = {}
        for side in SIDES:
            hip, knee, ankle = (q[f"{name}_{side}"] for name in chain)
            turn = sign(side) if axis == 2 else 1.0
            above = np.arctan2(turn * (knee - hip)[axis], -(knee - hip)[1])
            below = np.arctan2(turn * (ankle - knee)[axis], -(ankle - knee)[1])
            at_knee[side] = float(np.rad2deg(above - below))
        value = at_knee["r"] - at_knee["l"]
        yield LandmarkMeasure(
            f"{what}, right less left", value, 0.0, sd, names, "deg", postural=True
        )


def _measure_line_angles(q: Landmarks) -> Iterator[LandmarkMeasure]:
    """Measure angles (deg) from above between lines of a joint and lines from left to right."""

    def from_above(across: Array) -> float:
        return float(np.rad2deg(np.arctan2(across[0], across[2])))

    for joint in WIDTHS:
        ends = tuple(f"{joint}_{end}_{side}" for side in SIDES for end in ("lat", "med"))
        if all(name in q for name in ends):
            right = from_above(q[ends[0]] - q[ends[1]])
            left = -from_above(q[ends[3]] - q[ends[2]])
            name = f"line of the {joint} from above, right less left"
            yield LandmarkMeasure(name, _wrap_degrees(right - left), 0.0, AXIS_DEG, ends, "deg")
    for pair, sd in LINES_DEG.items():
        ends = tuple(f"{name}_{side}" for name in pair for side in SIDES)
        if all(name in q for name in ends):
            upper, lower = (from_above(q[f"{name}_r"] - q[f"{name}_l"]) for name in pair)
            name = f"line through {pair[0]} against {pair[1]} from above"
            yield LandmarkMeasure(
                name, _wrap_degrees(upper - lower), 0.0, sd, ends, "deg", postural=True
            )


def _wrap_degrees(degrees: float) -> float:
    """Wrap an angle to -180 to 180 deg."""
    return (degrees + 180.0) % 360.0 - 180.0


def compute_build_cost(p: Landmarks, height: float, *, even: bool = True) -> float:
    """Compute the cost of explaining landmarks by build and stance alone.

    Parameters
    ----------
    p : mapping of str to (3,) array
        Landmarks, m, y up.
    height : float
        Body height, m.
    even : bool
        As in `measure_landmarks`.

    Returns
    -------
    float
        z^T (I + B B^T)^-1 z, without unit.
    """

    def deviations(landmarks: Landmarks) -> Array:
        return np.array([m.z for m in measure_landmarks(landmarks, height, even=even)])

    z = deviations(p)
    columns = [(deviations(other) - z) * scale for other, scale in move_joints(p)]
    if not columns:
        return float(z @ z)
    U, s, _ = np.linalg.svd(np.stack(columns, axis=1), full_matrices=False)
    return float(z @ z - np.sum((U.T @ z) ** 2 * s**2 / (1.0 + s**2)))


def move_joints(p: Landmarks) -> Iterator[tuple[dict[str, Array], float]]:
    """Move the landmarks by a small rotation or shift of each joint.

    Yields: moved landmarks (m), and how many such steps are one standard deviation.
    """
    axes = compute_body_axes(p)
    if axes is None:
        return
    for joint, distal in DISTAL_LANDMARKS.items():
        for side in SIDES:
            points = [f"{name}_{side}" for name in distal if f"{name}_{side}" in p]
            centre = [
                p[f"{name}_{side}"] for name in CENTRE_LANDMARKS[joint] if f"{name}_{side}" in p
            ]
            if not points or not centre:
                continue
            origin = np.mean(centre, axis=0)
            for axis in axes.T:
                R = pin.exp3(np.deg2rad(STEP_DEG) * axis)
                yield (
                    {**p, **{n: origin + R @ (p[n] - origin) for n in points}},
                    JOINT_ROTATION_DEG / STEP_DEG,
                )
                yield {**p, **{n: p[n] + STEP_M * axis for n in points}}, JOINT_SHIFT_M / STEP_M
