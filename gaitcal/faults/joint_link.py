"""Two neighbouring segments of a trial at their joint, near the posture of the static trial.

Both carry the joint centre c and the medial-lateral axis z of the static posture. With M_f = R_above^T R_below and
t_f = R_above^T (o_below - o_above), a point p of the lower segment lies in the upper one's static axes at

    M_f p + t_f  ~  B (p - c) + g,      B = median M_f,   g = median (M_f c + t_f)

over the frames whose flexion is near that of the static trial. g - c is the gap of the two joint centres, and B = Rz(f)
Rx(a) Ry(r) holds the ab/adduction a and the axial turn r against the static posture. A centre that is wrong by e opens
a gap |(M_f - 1) e|, and a joint may move about all its axes: how far those frames turn from the static posture on the
whole says how much the gap and B can tell.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gaitcal.arrays import Array
from gaitcal.faults.cluster import Cluster
from gaitcal.model.linkage import SIDES

CHAIN = {"hip": ("pelvis", "thigh"), "knee": ("thigh", "shank"), "ankle": ("shank", "foot")}
NEAR_RAD = np.deg2rad(30.0)
"""Flexion from the static posture within which the joint is near it; at least the nearest tenth of the frames."""
NEAREST_PERCENT = 10.0
FEWEST_FRAMES = 5
STANDS_RAD = np.deg2rad(15.0)
"""Turn from the static posture that walks have in their nearest frames."""
AXIS_FLEXION = np.deg2rad(75.0)
AXIS_RANGE = np.deg2rad(35.0)
AXIS_PERCENTILES = (5.0, 95.0)
AXIS_FRAMES = 20
"""The axis of a knee is read below the flexion where its skin slides much, from a movement as large as that."""


@dataclass(frozen=True, kw_only=True)
class JointLink:
    """A joint of a trial."""

    joint: str
    """`hip_r`, ..."""
    above: str
    below: str
    centre: Array
    """(3,) m, c."""
    rotation: Array
    """(3, 3) B."""
    carried_up: Array
    """(3,) m, g: the lower segment's centre in the upper segment's static axes."""
    carried_down: Array
    """(3,) m: the upper segment's centre in the lower one's."""
    rms: float
    """rad, RMS turn about the mean posture of the joint."""
    gap_spread: float
    """m, standard deviation of the gap as the markers of both segments scatter in the trial."""
    turn_spread: Array
    """(2,) rad, the same of ab/adduction and axial turn."""
    far: float
    """rad, median turn of those frames from the static posture, beyond the usual of walks; 0 within it."""
    size: float
    """Of the person, as of the clusters."""
    axis_turn: float | None
    """rad, transverse angle from the measured axis of a knee to its epicondyles; None where it cannot be told."""

    @property
    def name(self) -> str:
        """`hip`, `knee`, `ankle`."""
        return self.joint.split("_")[0]


def links_of(
    clusters: Mapping[str, Cluster], centres: Mapping[str, Array], knee_axes: Mapping[str, Array]
) -> dict[str, JointLink]:
    """Joint -> its link, where both segments are seen."""
    out = {}
    for name, (upper, lower) in CHAIN.items():
        for side in SIDES:
            joint = f"{name}_{side}"
            above, below = (
                clusters.get(upper if upper == "pelvis" else f"{upper}_{side}"),
                clusters.get(f"{lower}_{side}"),
            )
            if above is None or below is None or joint not in centres:
                continue
            link = _link(joint, above, below, centres[joint], knee_axes.get(joint))
            if link is not None:
                out[joint] = link
    return out


def _link(joint: str, above: Cluster, below: Cluster, centre: Array, axis: Array | None) -> JointLink | None:
    known = above.determined & below.determined
    if known.sum() < FEWEST_FRAMES:
        return None
    upper, lower = above.rotation[known], below.rotation[known]
    turn = upper.transpose(0, 2, 1) @ lower
    shift = np.einsum("fji,fj->fi", upper, below.origin[known] - above.origin[known])
    flexion = flexion_of(turn)
    away = np.abs(flexion)
    near = away <= max(NEAR_RAD, float(np.percentile(away, NEAREST_PERCENT)))
    down = np.einsum("fji,fj->fi", turn[near], centre - shift[near])
    (place_above, turn_above), (place_below, turn_below) = above.pose_spread(centre), below.pose_spread(centre)
    return JointLink(
        joint=joint,
        above=above.segment,
        below=below.segment,
        centre=centre,
        rotation=nearest_rotation(np.median(turn[near], axis=0)),
        carried_up=np.median(turn[near] @ centre + shift[near], axis=0),
        carried_down=np.median(down, axis=0),
        rms=_rms_turn(turn),
        gap_spread=float(np.hypot(place_above, place_below)),
        turn_spread=np.hypot(turn_above, turn_below)[:2],
        far=max(0.0, float(np.median(angle_of(turn[near]))) - STANDS_RAD),
        size=above.size,
        axis_turn=None if axis is None else _axis_turn(turn, flexion, axis),
    )


def flexion_of(turn: Array) -> Array:
    """(nf,) rad, f of turns (nf, 3, 3) = Rz(f) Rx(a) Ry(r)."""
    out: Array = np.arctan2(-turn[:, 0, 1], turn[:, 1, 1])
    return out


def side_turns(rotation: Array) -> Array:
    """(2,) rad, ab/adduction a and axial turn r of (3, 3) Rz(f) Rx(a) Ry(r)."""
    return np.array([np.arcsin(np.clip(rotation[2, 1], -1, 1)), np.arctan2(-rotation[2, 0], rotation[2, 2])])


def nearest_rotation(matrix: Array) -> Array:
    """(3, 3) rotation nearest to a matrix."""
    u, _, vt = np.linalg.svd(matrix)
    out: Array = (u * [1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return out


def angle_of(rotation: Array) -> Array:
    """rad, angle of rotations (..., 3, 3)."""
    out: Array = np.arccos(np.clip(0.5 * (np.trace(rotation, axis1=-2, axis2=-1) - 1.0), -1.0, 1.0))
    return out


def _rms_turn(turn: Array) -> float:
    mean = nearest_rotation(turn.mean(axis=0))
    return float(np.sqrt(np.mean(angle_of(mean.T @ turn) ** 2)))


def _axis_turn(turn: Array, flexion: Array, epicondyles: Array) -> float | None:
    """rad, transverse angle between the axis that the turns vary about and a line (3,)."""
    used = flexion > -AXIS_FLEXION  # a knee bends to negative f
    if used.sum() <= AXIS_FRAMES or np.ptp(np.percentile(flexion[used], AXIS_PERCENTILES)) <= AXIS_RANGE:
        return None
    about = turn[used] @ nearest_rotation(turn[used].mean(axis=0)).T
    vector = 0.5 * np.stack([about[:, i, j] - about[:, j, i] for i, j in ((2, 1), (0, 2), (1, 0))], axis=1)
    axis = np.linalg.svd(vector - vector.mean(axis=0), full_matrices=False)[2][0]
    (ax, az), (ex, ez) = (v[[0, 2]] * np.sign(v[2]) for v in (axis, epicondyles))
    return float(np.arctan2(ex, ez) - np.arctan2(ax, az))
