"""Two neighbouring segments of a trial at their joint, near the posture of the static trial.

Both carry the joint centre c and the medial-lateral axis z of the static posture. With M_f =
R_above^T R_below and t_f = R_above^T (o_below - o_above), a point p of the lower segment lies in
the upper one's static axes at

    M_f p + t_f  ~  B (p - c) + g,      B = median M_f,   g = median (M_f c + t_f)

over the frames whose flexion is near that of the static trial. g - c is the gap of the two joint
centres, and B = Rz(f) Rx(a) Ry(r) holds the ab/adduction a and the axial turn r against the static
posture. A centre that is wrong by e opens a gap |(M_f - 1) e|, and a joint may move about all its
axes: how far those frames turn from the static posture on the whole says how much the gap and B can
tell.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array
from gaitcal.model import linkage, rotations, segment_frames
from gaitcal.preprocess.marker_clusters import NEAR_RAD, NEAREST_PERCENT, MarkerCluster

CHAIN = {"hip": ("pelvis", "thigh"), "knee": ("thigh", "shank"), "ankle": ("shank", "foot")}
FEWEST_FRAMES = 5
STANDS_RAD = np.deg2rad(
    15.0
)  # Turn from the static posture that walks have in their nearest frames

GAP_M: Mapping[str, float] = {"hip": 0.035, "knee": 0.028, "ankle": 0.016}
"""Gap of a joint. Clean recordings reach 27, 25 and 13 mm, noise that scatters apart."""
TURN_RAD: Mapping[str, tuple[float, float]] = {
    name: (float(np.deg2rad(ab)), float(np.deg2rad(axial)))
    for name, (ab, axial) in {
        "hip": (15.0, 18.0),
        "knee": (12.0, 15.0),
        "ankle": (20.0, 18.0),
    }.items()
}
"""Ab/adduction and axial turn of a joint against the static posture. Clean recordings reach 11 and
13, 6 and 15, 16 and 15 deg."""
SCATTERED = 2.0
"""Standard deviations, as markers scatter within the trial, that widen the limits of gap and turn:
a small cluster far from the joint tells little of it."""
GAP_PER_RAD, TURN_PER_RAD = 0.10, 1.0
"""m and rad that widen them for each rad by which the trial stays away from the static posture.
Parts of clean trials in which a thigh stays flexed reach gaps of 43 mm at 20 deg, feet that stay
inverted turns of 30 deg at 35 deg."""
KNEE_TURN_FROM = float(
    np.deg2rad(10.0)
)  # rad, from where on those of the knee, a hinge whose turns stay small, widen


@dataclass(frozen=True, kw_only=True)
class JointLink:
    """A joint of a trial."""

    joint: str  # `hip_r`, ...
    above: str
    below: str
    centre: Array  # (3,) m, c
    rotations: Array  # (n, 3, 3) M in the frames in which both segments are determined
    median_rotation: Array  # (3, 3) B
    carried_up: Array  # (3,) m, g: the lower segment's centre in the upper segment's static axes
    carried_down: Array  # (3,) m: the upper segment's centre in the lower one's
    # m, standard deviation of the gap as the markers of both segments scatter in the trial
    gap_spread: float
    rotation_spread: Array  # (2,) rad, the same of ab/adduction and axial turn
    # rad, median turn of those frames from the static posture, beyond the usual of walks; 0 within
    # it
    far: float
    size: float  # Of the person, as of the clusters

    @property
    def name(self) -> str:
        """`hip`, `knee`, `ankle`."""
        return self.joint.split("_")[0]

    @property
    def rms(self) -> float:
        """rad, RMS turn about the mean posture of the joint."""
        mean = segment_frames.find_nearest_rotation(self.rotations.mean(axis=0))
        return float(np.sqrt(np.mean(compute_rotation_angle(mean.T @ self.rotations) ** 2)))

    @property
    def gap_base(self) -> float:
        """m, gap that says something where no marker scatters."""
        return self.size * float(np.hypot(GAP_M[self.name], GAP_PER_RAD * self.far))

    @property
    def rotation_base(self) -> Array:
        """(2,) rad, ab/adduction and axial turn that say something where no marker scatters."""
        far = max(0.0, self.far - KNEE_TURN_FROM) if self.name == "knee" else self.far
        out: Array = np.hypot(TURN_RAD[self.name], TURN_PER_RAD * far)
        return out

    @property
    def gap_limit(self) -> float:
        """m, gap of a joint of this trial that says something."""
        return float(np.hypot(self.gap_base, SCATTERED * self.gap_spread))

    @property
    def rotation_limits(self) -> Array:
        """(2,) rad, ab/adduction and axial turn of a joint of this trial that say something."""
        out: Array = np.hypot(self.rotation_base, SCATTERED * self.rotation_spread)
        return out

    @property
    def reach(self) -> float:
        """m, from the joint centre to the points on its axis at which the limits of gap and turn
        weigh alike.
        """
        return self.gap_base / float(np.mean(self.rotation_base))


def compute_joint_links(
    clusters: Mapping[str, MarkerCluster], centres: Mapping[str, Array]
) -> dict[str, JointLink]:
    """Joint -> its link, where both segments are seen; `centres` (3,) m of the joints in the static
    posture.
    """
    out: dict[str, JointLink] = {}
    for name, (upper, lower) in CHAIN.items():
        for side in linkage.SIDES:
            joint = f"{name}_{side}"
            above, below = (
                clusters.get(linkage.add_side(segment, side)) for segment in (upper, lower)
            )
            if above is not None and below is not None and joint in centres:
                link = _compute_link(joint, above, below, centres[joint])
                if link is not None:
                    out[joint] = link
    return out


def _compute_link(
    joint: str, above: MarkerCluster, below: MarkerCluster, centre: Array
) -> JointLink | None:
    known = above.determined & below.determined
    if known.sum() < FEWEST_FRAMES:
        return None
    upper, lower = above.rotation[known], below.rotation[known]
    turn = upper.transpose(0, 2, 1) @ lower
    shift = np.einsum("fji,fj->fi", upper, below.origin[known] - above.origin[known])
    away = np.abs(rotations.compute_root_angles(turn)[:, 0])
    near = away <= max(NEAR_RAD, float(np.percentile(away, NEAREST_PERCENT)))
    (place_above, turn_above), (place_below, turn_below) = (
        above.compute_pose_spread(centre),
        below.compute_pose_spread(centre),
    )
    return JointLink(
        joint=joint,
        above=above.segment,
        below=below.segment,
        centre=centre,
        rotations=turn,
        median_rotation=segment_frames.find_nearest_rotation(np.median(turn[near], axis=0)),
        carried_up=np.median(turn[near] @ centre + shift[near], axis=0),
        carried_down=np.median(np.einsum("fji,fj->fi", turn[near], centre - shift[near]), axis=0),
        gap_spread=float(np.hypot(place_above, place_below)),
        rotation_spread=np.hypot(turn_above, turn_below)[:2],
        far=max(0.0, float(np.median(compute_rotation_angle(turn[near]))) - STANDS_RAD),
        size=above.size,
    )


def compute_rotation_angle(rotation: Array) -> Array:
    """rad, angle of rotations (..., 3, 3)."""
    out: Array = np.arccos(np.clip(0.5 * (np.trace(rotation, axis1=-2, axis2=-1) - 1.0), -1.0, 1.0))
    return out
