"""Priors on coordinates: joint limits, and normal priors where markers determine nothing.

With n_ak the coefficient a of coordinate k, and a range [l_ak, u_ak] that costs nothing,

    d_ak = n_ak - clip(n_ak, l_ak, u_ak),
    C(N) = sum_ak w_ak d_ak^2,
    w_ak = (e / s_k)^2 sum_f b_a(f)

is added to the marker cost. Being s_k outside the range costs as much in every frame as e = 5 mm of
one marker. A B-spline lies in the hull of its coefficients, so the range bounds the motion. Half
the gradient is w d; half the Gauss-Newton matrix has w on its diagonal where d is not zero. The
range is one of two things:

    joint limit   l < u: no cost inside.
    centre        l = u = c, a normal prior of standard deviation s, for coordinates that no
                  marker determines.

The error of a centre repeats itself with the stride. For coordinate k it is s_k e_k(t),

    e_k(t) = sqrt(0.8) z_0 + sqrt(0.2) [z_1 cos(2 pi t / T_k) + z_2 sin(2 pi t / T_k)],

all z independent with variance 1: a constant offset of posture (80 % of the variance) and a swing.
Its period T_k is a stride, about 1 s, and half of it for the tilt of the trunk, which follows the
steps. The variance is s_k^2 in every frame.

A segment determines its coordinates if three of its markers are visible in half of the frames and
do not lie on one line. For all other segments, the coordinates of the joint before it are examined.
With H_f the Gauss-Newton matrix of frame f at equal weights, marker errors of 5 mm leave

    s_f^2 = diag( (H_f / MARKER_M^2 + 1 / MAX_UNCERTAINTY^2)^-1 ).

A coordinate whose median s_f exceeds its prior standard deviation gets that prior. All others get
none, as it would only bias them. Markers of the arms do not count for the trunk: shoulders move
against it by centimetres, those of the model do not.

The centre of arms and legs is the static posture, or an arm that hangs along the trunk. The centre
of the lumbar joint keeps the trunk in the laboratory as it was in the static trial, while the
pelvis moves. R_p is the pelvis, R_0 the trunk of the static trial without its heading, and psi the
heading of the pelvis without its swing. (Local straight lines with Gaussian weights of 0.35 s leave
9 % of a movement of 1 Hz.)

    Rz(extension) Rx(bending) Ry(rotation) = R_p^T Ry(psi) R_0.

The prior exerts no force on the pelvis: the course is computed from a motion, and again after the
motion has changed.
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

MARKER_M = 0.005
"""m, e: noise of a marker on skin."""
LIMIT_SCALE_RAD = np.deg2rad(5.0)
"""rad outside a joint limit that cost as much as e."""
JOINT_LIMITS_DEG: Mapping[str, tuple[float, float]] = {
    with_side(row.name, side): row.wall
    for side in SIDES
    for row in COORDINATE_TABLE.values()
    if row.wall
}
"""Coordinate -> deg from the static posture."""
PRIOR_DEVIATION_DEG: Mapping[str, float] = {
    with_side(row.name, side): row.spread
    for side in SIDES
    for row in COORDINATE_TABLE.values()
    if row.spread
}
"""Coordinate -> deg, standard deviation of a normal prior."""
CONSTANT_SHARE = 0.8
"""Share of the variance of e_k that is a constant offset."""
STRIDE_S = 1.0
"""s, period T_k."""
STEP_COORDINATES = ("lumbar_extension",)
"""Coordinates that follow the steps: T_k is half a stride."""
POSES = 20
"""Frames in which coordinates are examined."""
MAX_UNCERTAINTY = 1.0
"""rad, m: uncertainty of a coordinate that nothing determines."""
MIN_VISIBLE_SHARE = 0.5
"""Share of the frames in which a marker must have weight."""
HEADING_S = 0.35
"""s, standard deviation of the weights that smooth the heading."""


@dataclass(frozen=True, kw_only=True)
class CoordinatePrior:
    """Ranges of some coordinates, constant or given at some times."""

    names: tuple[str, ...]  # (k,) coordinates
    time: Array  # (nt,) s
    low: Array  # (nt, k) rad
    high: Array  # (nt, k) rad
    scale: Array  # (k,) rad, s
    share: float = 1.0  # factor of the cost

    def compute_scores(self, basis: spline.SplineBasis, coordinates: tuple[str, ...]) -> Array:
        """Compute the half gradients caused by the errors of the centres.

        Parameters
        ----------
        basis
            Splines of the trial.
        coordinates
            (nq,) names, in the order of the coefficients.

        Returns
        -------
        (nn * nq, 3 k) array
            A column for each z_0, z_1, z_2 = 1 of each of the k coordinates.
        """
        prior = self.express_on(basis, coordinates)
        out = np.zeros((basis.control_points, len(coordinates), len(self.names), 3))
        for k, name in enumerate(self.names):
            # e_k(t) of a unit z_0, z_1 and z_2, as splines
            cycles_per_stride = 2.0 if name in STEP_COORDINATES else 1.0
            phase = 2.0 * np.pi / STRIDE_S * cycles_per_stride * basis.time
            swing = np.sqrt(1.0 - CONSTANT_SHARE) * np.stack([np.cos(phase), np.sin(phase)], axis=1)
            constant = np.full(len(phase), np.sqrt(CONSTANT_SHARE))
            courses = basis.fit(np.column_stack([constant, swing]))
            out[:, prior.columns[k], k] = prior.weight[:, [k]] * self.scale[k] * courses
        return out.reshape(basis.control_points * len(coordinates), -1)

    @property
    def centred(self) -> bool:
        """Whether it is a normal prior."""
        return bool((self.low == self.high).all())

    def select(self, coordinates: tuple[str, ...]) -> "CoordinatePrior":
        """Return the prior restricted to those of the given coordinates."""
        kept = [k for k, name in enumerate(self.names) if name in coordinates]
        names = tuple(self.names[k] for k in kept)
        return replace(
            self,
            names=names,
            low=self.low[:, kept],
            high=self.high[:, kept],
            scale=self.scale[kept],
        )

    def scale_cost(self, share: float) -> "CoordinatePrior":
        """Multiply the cost by `share`."""
        return replace(self, share=share * self.share)

    def express_on(
        self, basis: spline.SplineBasis, coordinates: tuple[str, ...]
    ) -> "CoefficientPrior":
        """Express the prior on the spline coefficients of a trial.

        `coordinates`: (nq,) names of all coordinates, `names` among them.
        """
        low = self._fit_course(self.low, basis)
        high = low if self.centred else self._fit_course(self.high, basis)
        frames = basis.matrices[0].T @ np.ones(len(basis.time))
        weight = self.share * frames[:, None] * (MARKER_M / self.scale) ** 2
        columns = np.array([coordinates.index(name) for name in self.names], dtype=np.intp)
        return CoefficientPrior(columns, low, high, weight)

    def _fit_course(self, values: Array, basis: spline.SplineBasis) -> Array:
        """Return (nn, k) coefficients of values (nt, k)."""
        if len(values) == 1:
            return np.repeat(values, basis.control_points, axis=0)
        at_frames = [np.interp(basis.time, self.time, column) for column in values.T]
        return basis.fit(np.stack(at_frames, axis=1))


@dataclass(frozen=True)
class CoefficientPrior:
    """A prior on the coefficients of one trial."""

    columns: IntArray  # (k,) coordinates
    low: Array  # (nn, k) rad
    high: Array  # (nn, k) rad
    weight: Array  # (nn, k) m^2/rad^2, w

    def evaluate(self, coefficients: Array) -> tuple[float, Array]:
        """Compute the cost and half its gradient.

        Parameters
        ----------
        coefficients
            (nn, nq) m, rad.

        Returns
        -------
        float
            m^2.
        (nn, nq) array
        """
        out = np.zeros_like(coefficients)
        excess = self._compute_excess(coefficients)
        weighted = self.weight * excess
        out[:, self.columns] = weighted
        return float(np.vdot(weighted, excess)), out

    def add_to(self, band: Array, coefficients: Array) -> None:
        """Add half the Gauss-Newton matrix at `coefficients` to `band` (nn * nq, 6 nq)."""
        outside = (self.low == self.high) | (self._compute_excess(coefficients) != 0.0)
        band[:, 0].reshape(coefficients.shape)[:, self.columns] += np.where(
            outside, self.weight, 0.0
        )

    def _compute_excess(self, coefficients: Array) -> Array:
        """Return (nn, k) rad, d."""
        coefficients = coefficients[:, self.columns]
        return coefficients - np.clip(coefficients, self.low, self.high)


def build_joint_limits(
    coordinates: tuple[str, ...], posture: Mapping[str, float]
) -> CoordinatePrior:
    """Build the joint limits of coordinates about a static posture.

    Parameters
    ----------
    coordinates
        Names; those without a limit are skipped.
    posture
        Coordinate -> rad in the static posture; zero where it is missing.

    Returns
    -------
    CoordinatePrior
    """
    names = tuple(name for name in coordinates if name in JOINT_LIMITS_DEG)
    about = np.array([posture.get(name, 0.0) for name in names])
    low, high = np.deg2rad([JOINT_LIMITS_DEG[name] for name in names]).reshape(-1, 2).T
    scale = np.full(len(names), LIMIT_SCALE_RAD)
    return CoordinatePrior(
        names=names,
        time=np.zeros(1),
        low=(about + low)[None],
        high=(about + high)[None],
        scale=scale,
    )


def clip_to_joint_limits(
    coordinates: Sequence[str], angles: Array, known: BoolArray, *, determined: bool
) -> Array:
    """Unwrap the starting angles of a joint, and clip them to its limits about zero.

    Parameters
    ----------
    coordinates
        (k,) names of the joint's coordinates.
    angles
        (nf, k) rad.
    known
        (nf,) frames in which the angles were found.
    determined
        Whether a rigid fit gave them. If not, and if every coordinate has limits, a joint outside
        its limits in any known frame starts from zero.

    Returns
    -------
    (nf, k) array
        rad.
    """
    limited = [k for k, name in enumerate(coordinates) if name in JOINT_LIMITS_DEG]
    if not limited:
        return angles
    low, high = np.deg2rad([JOINT_LIMITS_DEG[coordinates[k]] for k in limited]).T
    # angles without whole turns, in [-pi, pi]
    wrapped = np.angle(np.exp(1j * angles[:, limited]))
    out, clipped = angles.copy(), np.clip(wrapped, low, high)
    out[:, limited] = clipped
    # Without a rigid fit, a start outside the limits is more likely wrong than near them.
    if not determined and len(limited) == len(coordinates) and (clipped != wrapped)[known].any():
        out[:] = 0.0
    return out


def list_prior_candidates(
    segments: Sequence[str], of_marker: Sequence[str], local: Array, pulls: BoolArray
) -> tuple[str, ...]:
    """List coordinates with a known deviation before segments that markers may not determine.

    Parameters
    ----------
    segments
        Segments of the moving part, its base segment first.
    of_marker
        (nm,) segment of each marker.
    local
        (nm, 3) m, marker positions in their segments.
    pulls
        (nm, nf) whether a marker is visible with weight.

    Returns
    -------
    tuple of str
    """
    counts = pulls.mean(axis=1) >= MIN_VISIBLE_SHARE
    names = np.array(of_marker, dtype=object)
    candidates, passed = list[str](), list[str]()
    for segment in segments[1:]:
        passed += list_joint_coordinates([segment])
        if not get_segment(segment).markers:
            # no marker sits on it: its joint is the foot's
            continue
        places = local[counts & (names == segment)]
        if (
            len(places) < rigid.FEWEST_MARKERS
            or segment_frames.measure_distance_from_line(places) < trunk.OFF_LINE
        ):
            candidates += [name for name in passed if name in PRIOR_DEVIATION_DEG]
        passed = []
    return tuple(candidates)


def select_undetermined(
    candidates: Sequence[str], coordinates: tuple[str, ...], hessians: Array
) -> tuple[str, ...]:
    """Select the coordinates that frames leave more uncertain than their prior.

    Parameters
    ----------
    candidates
        Coordinates to examine.
    coordinates
        (nq,) names, in the order of the matrices.
    hessians
        (nf, nq, nq) m^2, Gauss-Newton matrices of frames.

    Returns
    -------
    tuple of str
    """
    s = np.sqrt(np.median(compute_uncertainty(hessians) ** 2, axis=0))
    return tuple(
        name
        for name in candidates
        if s[coordinates.index(name)] > np.deg2rad(PRIOR_DEVIATION_DEG[name])
    )


def compute_uncertainty(hessians: Array) -> Array:
    """Compute the uncertainty s_f that marker errors leave in each frame.

    Parameters
    ----------
    hessians
        (nf, nq, nq) m^2, Gauss-Newton matrices of frames.

    Returns
    -------
    (nf, nq) array
        m, rad.
    """
    inverse = np.linalg.inv(hessians / MARKER_M**2 + np.eye(hessians.shape[1]) / MAX_UNCERTAINTY**2)
    return np.sqrt(np.diagonal(inverse, axis1=1, axis2=2))


def find_undetermined_joints(guessed: Sequence[str]) -> frozenset[str]:
    """Find the joints of coordinates that have a normal prior.

    Where a prior determines the angle, markers do not determine the position of the joint.

    Parameters
    ----------
    guessed
        Coordinates with a normal prior.

    Returns
    -------
    frozenset of str
        Names of joints.
    """
    joints = set[str]()
    for joint in JOINTS:
        names = {element.name for element in joint.elements}
        if not names.isdisjoint(guessed):
            joints.add(joint.name)
    return frozenset(joints)


def build_posture_prior(names: tuple[str, ...], posture: Mapping[str, float]) -> CoordinatePrior:
    """Build normal priors about the static posture.

    `names`: coordinates. `posture`: coordinate -> rad; zero where it is missing.
    """
    centre = np.array([[posture.get(name, 0.0) for name in names]])
    scale = np.deg2rad([PRIOR_DEVIATION_DEG[name] for name in names])
    return CoordinatePrior(names=names, time=np.zeros(1), low=centre, high=centre, scale=scale)


def compute_upright_trunk(time: Array, pelvis: Array, posture: Mapping[str, float]) -> Array:
    """Compute lumbar coordinates that keep the trunk of a static posture in the laboratory.

    Parameters
    ----------
    time
        (nf,) s.
    pelvis
        (nf, 3) rad: tilt, list and rotation.
    posture
        Coordinate -> rad in the static posture.

    Returns
    -------
    (nf, 3) array
        rad: extension, bending and rotation.
    """
    standing = _build_posture_rotation(PELVIS_ANGLES, posture)
    trunk_standing = standing @ _build_posture_rotation(LUMBAR, posture)
    moving = Rotation.from_euler("ZXY", pelvis).as_matrix()
    # heading of the pelvis without its swing, relative to the static trial
    heading = _smooth(time, np.unwrap(_compute_heading(moving))) - _compute_heading(standing[None])
    trunk_upright = Rotation.from_euler("Y", heading[:, None]).as_matrix() @ trunk_standing
    return np.unwrap(
        rotations.compute_root_angles(moving.transpose(0, 2, 1) @ trunk_upright), axis=0
    )


def _build_posture_rotation(names: Sequence[str], posture: Mapping[str, float]) -> Array:
    """Build (3, 3), the rotation of three coordinates in the static posture."""
    angles = [posture.get(name, 0.0) for name in names]
    return np.asarray(Rotation.from_euler("ZXY", angles).as_matrix())


def _compute_heading(rotation: Array) -> Array:
    """Compute (nf,) rad, the rotation of the x axis about the vertical."""
    return np.arctan2(-rotation[:, 2, 0], rotation[:, 0, 0])


def _smooth(time: Array, angle: Array) -> Array:
    """Smooth angles (nf,) rad by weighted lines through their neighbours."""
    out = np.empty_like(angle)
    for k, now in enumerate(time):
        # weighted line through the neighbours, evaluated at this frame
        near = slice(*np.searchsorted(time, [now - 4 * HEADING_S, now + 4 * HEADING_S]))
        offset = time[near] - now
        weight = np.exp(-0.5 * (offset / HEADING_S) ** 2)
        weight /= weight.sum()
        mean = float(weight @ offset)
        spread = float(weight @ (offset - mean) ** 2)
        slope = float((weight * (offset - mean)) @ angle[near]) / spread if spread > 0 else 0.0
        out[k] = float(weight @ angle[near]) - slope * mean
    return out
