"""What is known of coordinates besides markers: a quadratic cost on spline coefficients outside a
range.

With n_ak the coefficient a of coordinate k, in a range [l_ak, u_ak] that costs nothing,

    d_ak = n_ak - clip(n_ak, l_ak, u_ak),      C(N) = sum_ak w_ak d_ak^2,      w_ak = (e / s_k)^2 sum_f b_a(f)

is added to the marker cost: being s_k beyond the range costs in every frame what e = 5 mm of one
marker do. A B-spline lies in the hull of its coefficients, so that the range bounds the motion,
half the gradient is w d, and half the Gauss-Newton matrix has w on its diagonal where d is not
zero. The range is one of two things:

    wall      a joint does not turn further: l < u. Nothing inside, to the last digit.
    centre    a normal prior: l = u = c, s its standard deviation, for coordinates that no marker determines,
              whose errors it makes.

The error of a centre is not white: it repeats itself with the stride. For coordinate k it is taken
as s_k e_k(t),

    e_k(t) = sqrt(0.8) z_0 + sqrt(0.2) [z_1 cos(2 pi t / T_k) + z_2 sin(2 pi t / T_k)],

all z independent with variance 1: a posture that is another one (80 % of the variance), and a
swing. Its period T_k is a stride, about 1 s; half of it where the trunk tilts, which it does with
every step. The variance is s_k^2 in every frame.

A segment is determined by itself where three of its markers pull in half of the frames and do not
lie on one line. Of every other segment, and of all that have no marker, the coordinates of the
joint before it are asked: with H_f the Gauss-Newton matrix of frame f, every marker that pulls
counting as much, errors of 5 mm leave them uncertain by

    s_f^2 = diag( (H_f / MARKER_M^2 + 1 / WIDEST^2)^-1 ),

and a coordinate whose median s_f is above its standard deviation here gets that as a normal prior:
there one frame's markers know less than is known without them. All others get none, as a prior on
angles that markers determine only biases them. Markers of the arms pull on the trunk as on all
before them, but do not count for it: shoulders move against it by centimetres, as the model's do
not.

The centre of arms and legs is the static posture, or an arm that hangs along the trunk. The centre
of the lumbar joint is the course that keeps the trunk as it was in the static trial, in the
laboratory, while the pelvis moves: with R_p the pelvis, R_0 the trunk of the static trial with its
heading taken off, and psi the heading of the pelvis without its swing (local straight lines through
it, Gaussian weights of 0.35 s, which leave 9 % of what repeats once a second)

    Rz(extension) Rx(bending) Ry(rotation) = R_p^T Ry(psi) R_0.

The pelvis is not pulled by it: the course is found from a motion, and found again where the motion
has moved.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from gaitcal.arrays import Array, BoolArray, IntArray
from gaitcal.model import rotations, segment_frames, trunk
from gaitcal.model.coordinates import COORDINATE_TABLE, with_side
from gaitcal.model.linkage import (
    JOINTS,
    LUMBAR,
    PELVIS_ANGLES,
    SIDES,
    get_segment,
    list_joint_coordinates,
)
from gaitcal.tracking import rigid, spline

MARKER_M = 0.005  # m, e: the noise of a marker on skin
BEYOND = np.deg2rad(5.0)  # rad beyond a wall that cost e
WALLS: Mapping[str, tuple[float, float]] = {
    with_side(row.name, side): row.wall
    for side in SIDES
    for row in COORDINATE_TABLE.values()
    if row.wall
}
"""Coordinate -> deg from the static posture."""
DEVIATION: Mapping[str, float] = {
    with_side(row.name, side): row.spread
    for side in SIDES
    for row in COORDINATE_TABLE.values()
    if row.spread
}
"""Coordinate -> deg, standard deviation of a normal prior."""
STEADY = 0.8  # part of the variance of e_k
STRIDE_S = 1.0  # s, T_k
WITH_EVERY_STEP = ("lumbar_extension",)  # coordinates whose T_k is half of that
POSES = 20  # frames that are asked
WIDEST = 1.0  # rad, m: how far a coordinate that nothing tells may be off
PULLS = 0.5  # share of the frames in which a marker must pull to count
HEADING_S = 0.35  # s, standard deviation of the weights that smooth the heading


@dataclass(frozen=True, kw_only=True)
class CoordinatePrior:
    """Ranges of some coordinates, at some times or at all."""

    names: tuple[str, ...]  # (k,) coordinates
    time: Array  # (nt,) s
    low: Array  # (nt, k) rad
    high: Array  # (nt, k) rad
    scale: Array  # (k,) rad, s
    share: float = 1.0  # factor of the cost

    def scores(self, basis: spline.SplineBasis, coordinates: tuple[str, ...]) -> Array:
        """(nn * nq, 3 k) half gradients that the errors of the centres make, z = 1 one after the
        other.
        """
        prior = self.on(basis, coordinates)
        out = np.zeros((basis.nodes, len(coordinates), len(self.names), 3))
        for k, name in enumerate(self.names):
            turn = 2.0 * np.pi / STRIDE_S * (2.0 if name in WITH_EVERY_STEP else 1.0) * basis.time
            swing = np.sqrt(1.0 - STEADY) * np.stack([np.cos(turn), np.sin(turn)], axis=1)
            courses = basis.fit(np.column_stack([np.full(len(turn), np.sqrt(STEADY)), swing]))
            out[:, prior.columns[k], k] = prior.weight[:, [k]] * self.scale[k] * courses
        return out.reshape(basis.nodes * len(coordinates), -1)

    @property
    def centred(self) -> bool:
        """Whether it is a normal prior."""
        return bool((self.low == self.high).all())

    def of(self, coordinates: tuple[str, ...]) -> "CoordinatePrior":
        """The same of those among some coordinates."""
        kept = [k for k, name in enumerate(self.names) if name in coordinates]
        names = tuple(self.names[k] for k in kept)
        return replace(
            self,
            names=names,
            low=self.low[:, kept],
            high=self.high[:, kept],
            scale=self.scale[kept],
        )

    def scaled(self, share: float) -> "CoordinatePrior":
        """`share` times the cost."""
        return replace(self, share=share * self.share)

    def on(self, basis: spline.SplineBasis, coordinates: tuple[str, ...]) -> "CoefficientPrior":
        """The same for the coefficients of all coordinates of a trial (`names` must be among them)."""
        low = self._course(self.low, basis)
        high = low if self.centred else self._course(self.high, basis)
        frames = basis.matrices[0].T @ np.ones(len(basis.time))
        weight = self.share * frames[:, None] * (MARKER_M / self.scale) ** 2
        columns = np.array([coordinates.index(name) for name in self.names], dtype=np.intp)
        return CoefficientPrior(columns, low, high, weight)

    def _course(self, values: Array, basis: spline.SplineBasis) -> Array:
        """(nn, k) coefficients of a course (nt, k)."""
        if len(values) == 1:
            return np.repeat(values, basis.nodes, axis=0)
        at_frames = [np.interp(basis.time, self.time, column) for column in values.T]
        return basis.fit(np.stack(at_frames, axis=1))


@dataclass(frozen=True)
class CoefficientPrior:
    """A prior on the coefficients of one trial."""

    columns: IntArray  # (k,) coordinates
    low: Array  # (nn, k) rad
    high: Array  # (nn, k) rad
    weight: Array  # (nn, k) m^2/rad^2, w

    def both(self, coefficients: Array) -> tuple[float, Array]:
        """Cost (m^2), and (nn, nq) half its gradient, at coefficients (nn, nq)."""
        out = np.zeros_like(coefficients)
        beyond = self._beyond(coefficients)
        pull = self.weight * beyond
        out[:, self.columns] = pull
        return float(np.vdot(pull, beyond)), out

    def add_to(self, band: Array, coefficients: Array) -> None:
        """Add half the Gauss-Newton matrix at `coefficients` to `band` (nn * nq, 6 nq), in place."""
        outside = (self.low == self.high) | (self._beyond(coefficients) != 0.0)
        band[:, 0].reshape(coefficients.shape)[:, self.columns] += np.where(
            outside, self.weight, 0.0
        )

    def _beyond(self, coefficients: Array) -> Array:
        """(nn, k) rad, d."""
        coefficients = coefficients[:, self.columns]
        return coefficients - np.clip(coefficients, self.low, self.high)


def walls(coordinates: tuple[str, ...], posture: Mapping[str, float]) -> CoordinatePrior:
    """The walls of those of some coordinates that have one, about a static posture (coordinate ->
    rad; else zero).
    """
    names = tuple(name for name in coordinates if name in WALLS)
    about = np.array([posture.get(name, 0.0) for name in names])
    low, high = np.deg2rad([WALLS[name] for name in names]).reshape(-1, 2).T
    scale = np.full(len(names), BEYOND)
    return CoordinatePrior(
        names=names,
        time=np.zeros(1),
        low=(about + low)[None],
        high=(about + high)[None],
        scale=scale,
    )


def within_walls(
    coordinates: Sequence[str], angles: Array, known: BoolArray, *, determined: bool
) -> Array:
    """(nf, k) rad, starting angles of a joint less whole turns, and no further from zero than the
    walls about it.

    `determined`: whether a rigid fit tells them in the frames `known` (nf,); else a joint that has
    walls in all its coordinates starts from zero if it is beyond them in any of these.
    """
    walled = [k for k, name in enumerate(coordinates) if name in WALLS]
    if not walled:
        return angles
    low, high = np.deg2rad([WALLS[coordinates[k]] for k in walled]).T
    turned = np.angle(np.exp(1j * angles[:, walled]))
    out, kept = angles.copy(), np.clip(turned, low, high)
    out[:, walled] = kept
    if not determined and len(walled) == len(coordinates) and (kept != turned)[known].any():
        out[:] = 0.0
    return out


def coordinates_asked(
    segments: Sequence[str], of_marker: Sequence[str], local: Array, pulls: BoolArray
) -> tuple[str, ...]:
    """Coordinates before segments that are not determined by themselves, and that something is
    known of.

    `segments`: of the part that moves, its root first. `of_marker` (nm,) their segments, `local`
    (nm, 3) m their places, `pulls` (nm, nf) whether they are seen with weight.
    """
    counts = pulls.mean(axis=1) >= PULLS
    names = np.array(of_marker, dtype=object)
    asked, turns = list[str](), list[str]()
    for segment in segments[1:]:
        turns += list_joint_coordinates([segment])
        if not get_segment(segment).markers:
            continue  # no marker sits on it: its joint is the foot's
        places = local[counts & (names == segment)]
        if (
            len(places) < rigid.FEWEST_MARKERS
            or segment_frames.measure_distance_from_line(places) < trunk.OFF_LINE
        ):
            asked += [name for name in turns if name in DEVIATION]
        turns = []
    return tuple(asked)


def undetermined(
    asked: Sequence[str], coordinates: tuple[str, ...], hessians: Array
) -> tuple[str, ...]:
    """Those of the coordinates `asked` that frames with Gauss-Newton matrices (nf, nq, nq), m^2,
    leave uncertain.
    """
    s = np.sqrt(np.median(left_uncertain(hessians) ** 2, axis=0))
    return tuple(name for name in asked if s[coordinates.index(name)] > np.deg2rad(DEVIATION[name]))


def left_uncertain(hessians: Array) -> Array:
    """(nf, nq) m, rad: s_f of frames with Gauss-Newton matrices (nf, nq, nq), m^2."""
    inverse = np.linalg.inv(hessians / MARKER_M**2 + np.eye(hessians.shape[1]) / WIDEST**2)
    return np.sqrt(np.diagonal(inverse, axis1=1, axis2=2))


def joints_left_open(guessed: Sequence[str]) -> frozenset[str]:
    """The joints of some coordinates: where a prior holds the angle, markers do not tell where the
    joint lies.
    """
    return frozenset(
        joint.name for joint in JOINTS if {e.name for e in joint.elements} & set(guessed)
    )


def about_posture(names: tuple[str, ...], posture: Mapping[str, float]) -> CoordinatePrior:
    """Normal priors about the static posture (coordinate -> rad; what it lacks is zero)."""
    centre = np.array([[posture.get(name, 0.0) for name in names]])
    scale = np.deg2rad([DEVIATION[name] for name in names])
    return CoordinatePrior(names=names, time=np.zeros(1), low=centre, high=centre, scale=scale)


def upright_trunk(time: Array, pelvis: Array, posture: Mapping[str, float]) -> Array:
    """(nf, 3) rad, lumbar coordinates that keep the trunk of a static posture in the laboratory.

    `pelvis`: (nf, 3) rad, tilt, list and rotation.
    """
    standing, lumbar = (
        Rotation.from_euler("ZXY", [posture.get(name, 0.0) for name in names]).as_matrix()
        for names in (PELVIS_ANGLES, LUMBAR)
    )
    turned = Rotation.from_euler("ZXY", pelvis).as_matrix()
    away = _smooth(time, np.unwrap(_heading(turned))) - _heading(standing[None])
    kept = Rotation.from_euler("Y", away[:, None]).as_matrix() @ (standing @ lumbar)
    return np.unwrap(rotations.compute_root_angles(turned.transpose(0, 2, 1) @ kept), axis=0)


def _heading(rotation: Array) -> Array:
    """(nf,) rad, turn about the vertical of where x points."""
    return np.arctan2(-rotation[:, 2, 0], rotation[:, 0, 0])


def _smooth(time: Array, angle: Array) -> Array:
    """(nf,) rad: at each time the line through its neighbours."""
    out = np.empty_like(angle)
    for k, now in enumerate(time):
        near = slice(*np.searchsorted(time, [now - 4 * HEADING_S, now + 4 * HEADING_S]))
        away = time[near] - now
        weight = np.exp(-0.5 * (away / HEADING_S) ** 2)
        weight /= weight.sum()
        mean = float(weight @ away)
        spread = float(weight @ (away - mean) ** 2)
        slope = float((weight * (away - mean)) @ angle[near]) / spread if spread > 0 else 0.0
        out[k] = float(weight @ angle[near]) - slope * mean
    return out
