"""The clusters and joints of one trial as one body, and by how much each quantity exceeds what clean recordings show.

The quantities: the offsets of a cluster, the gap and the turns of a joint near the static posture. A segment whose pose
is wrong for a reason that was found gets a rigid motion C that puts it right, and all quantities are read with it.

Two neighbouring segments of a trial at their joint, near the posture of the static trial.

Both carry the joint centre c and the medial-lateral axis z of the static posture. With M_f = R_above^T R_below and
t_f = R_above^T (o_below - o_above), a point p of the lower segment lies in the upper one's static axes at

    M_f p + t_f  ~  B (p - c) + g,      B = median M_f,   g = median (M_f c + t_f)

over the frames whose flexion is near that of the static trial. g - c is the gap of the two joint centres, and B = Rz(f)
Rx(a) Ry(r) holds the ab/adduction a and the axial turn r against the static posture. A centre that is wrong by e opens
a gap |(M_f - 1) e|, and a joint may move about all its axes: how far those frames turn from the static posture on the
whole says how much the gap and B can tell.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from gaitcal.arrays import Array
from gaitcal.faults.cluster import FEWEST, Cluster, alignment
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


OFFSET_M: Mapping[str, float] = {"pelvis": 0.008, "thigh": 0.010, "shank": 0.008, "foot": 0.008}
"""Largest offset of a cluster. 91 clean trials of 20 people (10 of them synthetic, with noise) reach
5.4, 6.4, 5.2 and 6.1 mm."""
STEADY_M, STEADY_RATIO, JITTER_M = 0.007, 4.0, 0.0015
"""A smaller offset counts where it is so many times its own scatter in time, which is at least JITTER."""
REDUCED = 1.6
"""Factor of the offset where a cluster of a large set borrows from the segment above, whose skin moves otherwise; sets
that always borrow stay within the limits without it."""
GAP_M: Mapping[str, float] = {"hip": 0.035, "knee": 0.028, "ankle": 0.016}
"""Gap of a joint. Clean recordings reach 27, 25 and 13 mm, noise that scatters apart."""
TURN_RAD: Mapping[str, tuple[float, float]] = {
    name: (float(np.deg2rad(ab)), float(np.deg2rad(axial)))
    for name, (ab, axial) in {"hip": (15.0, 18.0), "knee": (12.0, 15.0), "ankle": (20.0, 18.0)}.items()
}
"""Ab/adduction and axial turn of a joint against the static posture. Clean recordings reach 11 and 13, 6 and 15, 16
and 15 deg."""
SCATTERED = 2.0
"""Standard deviations, as markers scatter within the trial, that widen the limits of gap and turn: a small cluster far
from the joint tells little of it."""
GAP_PER_RAD, TURN_PER_RAD = 0.10, 1.0
"""m and rad that widen them for each rad by which the trial stays away from the static posture. Parts of clean trials
in which a thigh stays flexed reach gaps of 43 mm at 20 deg, feet that stay inverted turns of 30 deg at 35 deg."""
KNEE_TURN_FROM = float(np.deg2rad(10.0))
"""rad, from where on those of the knee, a hinge whose turns stay small, widen."""
SPREAD = 3.0
"""A limit is taken as so many standard deviations."""
NO_MOTION = (np.eye(3), np.zeros(3))


def gap_limit(link: JointLink) -> float:
    """m, gap of a joint of this trial that says something."""
    return float(np.hypot(_gap_base(link), SCATTERED * link.gap_spread))


def turn_limits(link: JointLink) -> Array:
    """(2,) rad, ab/adduction and axial turn of a joint of this trial that say something."""
    out: Array = np.hypot(_turn_base(link), SCATTERED * link.turn_spread)
    return out


def reach(link: JointLink) -> float:
    """M from the joint centre to the points on its axis: there the limits of gap and turn weigh alike."""
    return _gap_base(link) / float(np.mean(_turn_base(link)))


def _gap_base(link: JointLink) -> float:
    return link.size * float(np.hypot(GAP_M[link.name], GAP_PER_RAD * link.far))


def _turn_base(link: JointLink) -> Array:
    far = max(0.0, link.far - KNEE_TURN_FROM) if link.name == "knee" else link.far
    out: Array = np.hypot(TURN_RAD[link.name], TURN_PER_RAD * far)
    return out


def offset_limit(cluster: Cluster) -> float:
    """m, largest offset of a marker of the cluster, in a person of its size."""
    return cluster.size * OFFSET_M[cluster.part] * (REDUCED if cluster.reduced else 1.0)


@dataclass
class Body:
    """The clusters and joints of one trial, and what was found wrong with them so far."""

    clusters: Mapping[str, Cluster]
    links: Mapping[str, JointLink]
    pose: dict[str, tuple[Array, Array]] = field(default_factory=dict)
    """Segment -> rigid motion that puts its mean shape where it belongs, where that is not the nearest."""
    cleared: dict[str, tuple[str, ...]] = field(default_factory=dict)
    """Segment -> markers that are explained."""
    strictness: float = 1.0
    """Factor of the limits of offsets."""

    def forget(self, segment: str, labels: tuple[str, ...], pose_lost: bool) -> None:
        """Leave out what rests on a segment that was found wrong: clusters that borrow of it, and the joints of these;
        with `pose_lost` its own joints too.
        """
        lost = {
            name
            for name, c in self.clusters.items()
            if c.borrowed
            and name != segment
            and (c.labels[-1] in labels or (segment == "pelvis" and c.part == "thigh"))
        }
        self.clusters = {name: c for name, c in self.clusters.items() if name not in lost}
        gone = lost | {segment} if pose_lost else lost
        self.links = {j: k for j, k in self.links.items() if gone.isdisjoint((k.above, k.below))}

    def moved(self, segment: str) -> tuple[Array, Array]:
        """The rigid motion of a segment's mean shape."""
        return self.pose.get(segment, NO_MOTION)

    def relation(self, link: JointLink) -> tuple[Array, Array]:
        """Turn (3, 3) and gap (3,) m of a joint, both segments' poses as corrected."""
        (rp, tp), (rq, tq) = self.moved(link.above), self.moved(link.below)
        at = rq.T @ (link.centre - tq)
        carried = link.rotation @ (at - link.centre) + link.carried_up
        return rp @ link.rotation @ rq.T, rp @ carried + tp - link.centre

    def seen_from(self, segment: str) -> Iterator[tuple[JointLink, Array, Array]]:
        """Joint, p (2, 3) and q (2, 3) m, the axis points of a segment's joints where its neighbours have them."""
        for link in self.links.values():
            if segment not in (link.above, link.below):
                continue
            up = segment == link.above
            aside = [0.0, 0.0, reach(link)]
            points = np.array([link.centre + aside, link.centre - aside])
            turn, shift = self.moved(link.below if up else link.above)
            rotation, carried = (link.rotation, link.carried_up) if up else (link.rotation.T, link.carried_down)
            yield link, points, ((points - shift) @ turn - link.centre) @ rotation.T + carried

    def excesses(self) -> dict[str, float]:
        """Segment or joint -> the largest of its quantities in units of the limit, where that is above 1."""
        out = {name: value for name, c in self.clusters.items() if (value := self.offset_excess(c)) > 1.0}
        for joint, link in self.links.items():
            turn, gap = self.relation(link)
            ratios = np.abs(side_turns(turn)) / turn_limits(link)
            value = max(float(np.linalg.norm(gap)) / gap_limit(link), float(ratios.max()))
            if value > 1.0:
                out[joint] = value
        return out

    def offset_excess(self, cluster: Cluster) -> float:
        """The largest offset of a cluster in units of the limit."""
        kept = [i for i, label in enumerate(cluster.labels) if label not in self.cleared.get(cluster.segment, ())]
        if len(kept) < FEWEST:
            return 0.0
        turn, shift = alignment(cluster.shape[kept], cluster.static[kept])
        away = np.linalg.norm(cluster.shape[kept] @ turn.T + shift - cluster.static[kept], axis=1)
        steady = away / np.hypot(cluster.scatter[kept], JITTER_M)
        limit = self.strictness * offset_limit(cluster)
        value = float((away / np.hypot(limit, cluster.scatter[kept])).max())
        if not cluster.reduced and self.strictness == 1.0:
            least = cluster.size * STEADY_M
            counted = (away > least) & (steady > STEADY_RATIO)
            value = max(value, float((away[counted] / least).max(initial=0.0)))
        return value
