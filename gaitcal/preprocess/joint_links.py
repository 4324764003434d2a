"""Relate two adjacent segments of a trial at their joint, near the static posture.

Both segments carry the joint centre c and the medial-lateral axis z of the static posture. With
M_f = R_above^T R_below and t_f = R_above^T (o_below - o_above), a point p of the lower segment is
located in the upper segment's static axes at

    M_f p + t_f  ~  B (p - c) + g,      B = median M_f,   g = median (M_f c + t_f)

over the frames whose flexion is near that of the static trial. g - c is the gap between the two
joint centres, and B = Rz(f) Rx(a) Ry(r) holds the ab/adduction a and the axial rotation r relative
to the static posture. A centre with an error e opens a gap |(M_f - 1) e|, and a joint may rotate
about all its axes. The rotation of those frames from the static posture therefore limits what gap
and B show.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array
from gaitcal.model import linkage, rotations, segment_frames
from gaitcal.preprocess.marker_clusters import NEAR_RAD, NEAREST_PERCENT, MarkerCluster

CHAIN = {"hip": ("pelvis", "thigh"), "knee": ("thigh", "shank"), "ankle": ("shank", "foot")}
"""Joint -> segment above and below it."""
FEWEST_LINK_FRAMES = 5
STANDS_RAD = np.deg2rad(15.0)
"""Rotation from the static posture that walks have in their nearest frames."""

GAP_M: Mapping[str, float] = {"hip": 0.035, "knee": 0.028, "ankle": 0.016}
"""m, limit of the gap. Clean recordings reach 27, 25 and 13 mm, without the scatter of noise."""
TURN_RAD: Mapping[str, tuple[float, float]] = {
    name: (float(np.deg2rad(ab)), float(np.deg2rad(axial)))
    for name, (ab, axial) in {
        "hip": (15.0, 18.0),
        "knee": (12.0, 15.0),
        "ankle": (20.0, 18.0),
    }.items()
}
"""Limits (rad) of ab/adduction and axial rotation relative to the static posture. Clean recordings
reach 11 and 13, 6 and 15, 16 and 15 deg."""
SCATTERED = 2.0
"""Standard deviations of the marker scatter that widen both limits: a small cluster far from the
joint hardly determines it."""
GAP_PER_RAD = 0.10
"""m per rad by which the trial stays away from the static posture, added to the limit of the gap.
Parts of clean trials with a flexed thigh reach gaps of 43 mm at 20 deg."""
TURN_PER_RAD = 1.0
"""rad per rad, the same for rotations: feet that stay inverted reach 30 deg at 35 deg."""
KNEE_TURN_FROM = float(np.deg2rad(10.0))
"""rad, from which the rotation limits of the knee widen: it is a hinge with small rotations."""


@dataclass(frozen=True, kw_only=True)
class JointLink:
    """The relative pose of the two segments at a joint of a trial."""

    joint: str
    """`hip_r`, ..."""
    above: str
    """Segment above the joint."""
    below: str
    """Segment below the joint."""
    centre: Array
    """(3,) m, c."""
    rotations: Array
    """(n, 3, 3) M in the frames in which both segments are determined."""
    median_rotation: Array
    """(3, 3) B."""
    carried_up: Array
    """(3,) m, g: the lower segment's joint centre in the upper segment's static axes."""
    carried_down: Array
    """(3,) m, the upper segment's joint centre in the lower segment's static axes."""
    gap_spread: float
    """m, standard deviation of the gap by the scatter of both segments' markers."""
    rotation_spread: Array
    """(2,) rad, the same of ab/adduction and axial rotation."""
    far: float
    """rad, median rotation of the nearest frames from the static posture beyond `STANDS_RAD`; 0
    within it.
    """
    size: float
    """Of the person, see `MarkerCluster.size`."""

    @property
    def name(self) -> str:
        """`hip`, `knee`, `ankle`."""
        return self.joint.split("_")[0]

    @property
    def rms(self) -> float:
        """Angle (rad), RMS, of the joint's rotation about its mean posture."""
        mean = segment_frames.find_nearest_rotation(self.rotations.mean(axis=0))
        return float(np.sqrt(np.mean(compute_rotation_angle(mean.T @ self.rotations) ** 2)))

    @property
    def gap_base(self) -> float:
        """Limit (m) of the gap without scatter of the markers."""
        return self.size * float(np.hypot(GAP_M[self.name], GAP_PER_RAD * self.far))

    @property
    def rotation_base(self) -> Array:
        """Limits (2,) rad of ab/adduction and axial rotation without scatter of the markers."""
        far = max(0.0, self.far - KNEE_TURN_FROM) if self.name == "knee" else self.far
        out: Array = np.hypot(TURN_RAD[self.name], TURN_PER_RAD * far)
        return out

    @property
    def gap_limit(self) -> float:
        """Limit (m) of the gap in this trial."""
        return float(np.hypot(self.gap_base, SCATTERED * self.gap_spread))

    @property
    def rotation_limits(self) -> Array:
        """Limits (2,) rad of ab/adduction and axial rotation in this trial."""
        out: Array = np.hypot(self.rotation_base, SCATTERED * self.rotation_spread)
        return out

    @property
    def reach(self) -> float:
        """Distance (m) of axis points from the centre at which both limits weigh the same."""
        return self.gap_base / float(np.mean(self.rotation_base))


def compute_joint_links(
    clusters: Mapping[str, MarkerCluster], centres: Mapping[str, Array]
) -> dict[str, JointLink]:
    """Relate the segments at the hips, knees and ankles of a trial.

    Parameters
    ----------
    clusters
        Segment -> its markers in the trial.
    centres
        Joint -> centre (3,) m in the static posture.

    Returns
    -------
    dict
        Joint -> link; joints of which a segment is not visible are left out.
    """
    out: dict[str, JointLink] = {}
    for name, (upper, lower) in CHAIN.items():
        for side in linkage.SIDES:
            joint = f"{name}_{side}"
            above = clusters.get(linkage.add_side(upper, side))
            below = clusters.get(linkage.add_side(lower, side))
            if above is not None and below is not None and joint in centres:
                link = _compute_link(joint, above, below, centres[joint])
                if link is not None:
                    out[joint] = link
    return out


def _compute_link(
    joint: str, above: MarkerCluster, below: MarkerCluster, centre: Array
) -> JointLink | None:
    """Relate two clusters at a joint centre (3,) m; None with too few common frames."""
    known = above.determined & below.determined
    if known.sum() < FEWEST_LINK_FRAMES:
        return None
    upper, lower = above.rotation[known], below.rotation[known]
    relative = upper.transpose(0, 2, 1) @ lower
    shift = np.einsum("fji,fj->fi", upper, below.origin[known] - above.origin[known])
    # frames near the static posture, at least the nearest tenth
    flexion = np.abs(rotations.compute_root_angles(relative)[:, 0])
    near = flexion <= max(NEAR_RAD, float(np.percentile(flexion, NEAREST_PERCENT)))
    position_above, rotation_above = above.compute_pose_spread(centre)
    position_below, rotation_below = below.compute_pose_spread(centre)
    return JointLink(
        joint=joint,
        above=above.segment,
        below=below.segment,
        centre=centre,
        rotations=relative,
        median_rotation=segment_frames.find_nearest_rotation(np.median(relative[near], axis=0)),
        carried_up=np.median(relative[near] @ centre + shift[near], axis=0),
        carried_down=np.median(
            np.einsum("fji,fj->fi", relative[near], centre - shift[near]), axis=0
        ),
        gap_spread=float(np.hypot(position_above, position_below)),
        rotation_spread=np.hypot(rotation_above, rotation_below)[:2],
        far=max(0.0, float(np.median(compute_rotation_angle(relative[near]))) - STANDS_RAD),
        size=above.size,
    )


def compute_rotation_angle(rotation: Array) -> Array:
    """Compute the angle of rotations.

    `rotation`: (..., 3, 3). Returns: (...,) rad, 0 to pi.
    """
    out: Array = np.arccos(np.clip(0.5 * (np.trace(rotation, axis1=-2, axis2=-1) - 1.0), -1.0, 1.0))
    return out
