"""Find why a trial contradicts the static trial: the one cause that explains it best.

A trial contradicts the static one if a cluster's offsets, a joint's gap or its rotation
(`marker_clusters.py`, `joint_links.py`) exceed those of clean recordings. A marker that moved
deforms its cluster and, through the segment's pose, both joints of the segment; the cause is
therefore sought with all of them together. For a segment with markers m_i (static position s_i) and
the axis points p_k of its joints, which the adjacent segments have at q_k, each explanation has the
cost

    J = min over rigid C of  sum_i |C m_i - s_i|^2 / sigma^2
                           + sum_k |C q_k - p_k|^2 / (2 sigma_k^2)  +  price.

The explanations are: one marker moved (without its term), two labels are swapped (m exchanged), the
cluster is mirrored (m reflected), or it slid or rotated on the segment, with or without the markers
on landmarks (the terms of those that slid have another C). The price is what a free quantity
gains by chance. The cheapest explanation of the segments concerned is reported; its C corrects the
pose, all quantities are computed again, and what is left is explained in turn.

A cause that is too weak to be reported may still be true. An explanation that saves S of J is
exp(S / 2) times as likely as no change (its price holds the prior odds), and if it is true the pose
is wrong by its C. Over all explanations of a segment, weighted by their probabilities, that is an
uncertainty of its pose (`find_possible_moves`).
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from itertools import combinations

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import softmax

from gaitcal.arrays import Array
from gaitcal.model.rotations import compute_root_angles
from gaitcal.preprocess.joint_links import JointLink, compute_rotation_angle
from gaitcal.preprocess.marker_clusters import FEWEST, MarkerCluster, align_points

OFFSET_M: Mapping[str, float] = {"pelvis": 0.008, "thigh": 0.010, "shank": 0.008, "foot": 0.008}
"""m, limit of a cluster's offsets. 91 clean trials of 20 people (10 of them synthetic, with noise)
reach 5.4, 6.4, 5.2 and 6.1 mm."""
STEADY_M = 0.007
"""m, limit of an offset that is constant in time."""
STEADY_RATIO = 4.0
"""Ratio of a constant offset to its scatter in time."""
JITTER_M = 0.0015
"""m, smallest scatter in that ratio."""
REDUCED = 1.6
"""Factor of the limit for a cluster of a large set that borrows from the segment above, whose skin
moves differently; sets that always borrow stay within the limits without it."""
SPREAD = 3.0
"""Standard deviations that a limit stands for."""
PRICE = {"marker": 12.0, "labels": 4.0, "mirrored": 12.0, "cluster": 12.0, "loose": 18.0}
"""Price of an explanation, in units of J. A marker's displacement has three free quantities that
the cluster determines well, a cluster's motion and a mirror plane have six and three that the
joints determine roughly: by chance they gain about as much. A cluster that left the landmarks of
its segment looks like one of these that moved: it needs odds of 20 to 1."""
CERTAIN = {"marker": 5.0, "labels": 4.0, "mirrored": 4.0, "cluster": 4.0}
"""Saving from which a cause is reported although no single quantity exceeds its limit. On 91 clean
trials of 20 people no marker saves more than 2.0, no cluster more than 0.1, no swap anything."""
LIKELY = -6.0
"""Saving from which a cause is accepted for quantities that exceed their limits."""
DISPLACEMENT_M = 0.04
"""m, standard deviation of the displacement of a marker that was attached again: a longer one is
less likely.
"""
ALIKE_M = 0.008
"""m. Two markers closer than this in the static posture are not checked for a swap."""
SLID_WEIGHT = 1e-3
"""Weight of markers that slid together: it determines the flexion, which joints leave free."""
MIRRORED = 0.5
"""Share of the offsets that a reflection may leave."""
MOST_CAUSES = 4
"""Causes that are sought in one trial."""

Pose = tuple[Array, Array]
"""Rotation (3, 3) and translation (3,) m."""
NO_MOTION: Pose = (np.eye(3), np.zeros(3))


class Fault(Enum):
    """Kinds of causes."""

    MARKER = "marker"
    LABELS = "labels"
    MIRRORED = "mirrored"
    CLUSTER = "cluster"
    UNKNOWN = "unknown"


@dataclass(frozen=True, kw_only=True)
class Contradiction:
    """One cause, and its effect."""

    fault: Fault
    segment: str
    """For an unknown cause the joint that exceeds its limits."""
    labels: tuple[str, ...] = ()
    rotation: float
    """rad, angle by which the segment's pose is wrong."""
    shift: float
    """m, by how much the pose displaces a joint centre."""
    direction: Array
    """(3,) m forward, up, to the right: the largest offset of its markers, or the displacement of a
    cluster that slid.
    """
    excess: float
    """Largest ratio of a quantity to its limit."""
    exceeded_at: tuple[str, ...]
    """Segments and joints that exceed their limits."""
    rivals: tuple[str, ...] = ()
    """Markers whose displacement would look the same: the other one of a segment with two."""

    @property
    def offset(self) -> float:
        """Length (m) of `direction`."""
        return float(np.linalg.norm(self.direction))


@dataclass(frozen=True)
class _Explanation:
    """A candidate cause: its cost J with price, and its C."""

    fault: Fault
    labels: tuple[str, ...]
    cost: float
    pose: Pose


def find_contradictions(
    clusters: Mapping[str, MarkerCluster], links: Mapping[str, JointLink]
) -> tuple[Contradiction, ...]:
    """Find the causes of the contradictions between one trial and the static posture.

    Parameters
    ----------
    clusters
        Segment -> its markers in the trial.
    links
        Joint -> relative pose of its segments.

    Returns
    -------
    tuple of Contradiction
        In the order in which they explain most, at most `MOST_CAUSES`, then those without
        explanation.
    """
    body, found = _Body(clusters, links), []
    for _ in range(MOST_CAUSES):
        excess = body.compute_excesses()
        best = _find_cheapest(body, excess)
        if best is None:
            found += [
                _build_unexplained(body, joint, excess[joint]) for joint in excess if joint in links
            ]
            break
        cause, pose = best
        found.append(cause)
        body.apply_cause(cause, pose)
    return tuple(found)


@dataclass(frozen=True)
class PossibleMove:
    """Uncertainty of a segment's pose because its markers may have moved since the static trial."""

    rotation: Array
    """(3,) rad, standard deviations about forward, up and right of the static posture."""
    shift: float
    """m, standard deviation at its joints."""


def find_possible_moves(
    clusters: Mapping[str, MarkerCluster], links: Mapping[str, JointLink]
) -> dict[str, PossibleMove]:
    """Compute the uncertainty of the segments' poses by markers that may have moved.

    Parameters
    ----------
    clusters
        Segment -> its markers in the trial.
    links
        Joint -> relative pose of its segments.

    Returns
    -------
    dict
        Segment -> uncertainty, over all explanations, reported or not.
    """
    body, out = _Body(clusters, links), dict[str, PossibleMove]()
    for segment, cluster in clusters.items():
        before, found = body.compute_cost(cluster)[0], list(_list_explanations(body, cluster))
        savings = [_compute_saving(body, cluster, before, e) for e in found]
        # posterior probabilities; 0: nothing moved
        share = softmax([0.0, *(0.5 * saving for saving in savings)])[1:]
        rotations = np.array([e.pose[0] for e in found]).reshape(-1, 3, 3)
        angles = Rotation.from_matrix(rotations).as_rotvec()
        shifts = np.array([_measure_centre_shift(body, segment, e.pose) for e in found])
        out[segment] = PossibleMove(np.sqrt(share @ angles**2), float(np.sqrt(share @ shifts**2)))
    return out


def compute_offset_limit(cluster: MarkerCluster) -> float:
    """Compute the limit (m) of the offsets of a cluster's markers, for a person of its size.

    Parameters
    ----------
    cluster
        Markers of a segment.

    Returns
    -------
    float
        m, widened by soft tissue where no frame is near the static posture.
    """
    usual = cluster.size * OFFSET_M[cluster.part] * (REDUCED if cluster.reduced else 1.0)
    return float(
        np.hypot(usual, SPREAD * np.sqrt(3.0) * cluster.compute_tissue_spread(together=True))
    )


@dataclass
class _Body:
    """The clusters and joints of one trial, and the corrections found so far."""

    clusters: Mapping[str, MarkerCluster]
    links: Mapping[str, JointLink]
    pose: dict[str, Pose] = field(default_factory=dict)
    """Segment -> rigid motion C that corrects its mean shape."""
    cleared: dict[str, tuple[str, ...]] = field(default_factory=dict)
    """Segment -> markers that are explained."""

    def apply_cause(self, cause: Contradiction, pose: Pose) -> None:
        """Correct the pose of a segment, and leave out all that depends on the wrong markers.

        These are the clusters that borrow from it and their joints; after mirroring also its
        joints.
        """
        segment, labels = cause.segment, cause.labels
        self.pose[segment] = pose
        whole = len(labels) == self.clusters[segment].marker_count
        # the pose alone corrects a whole cluster that slid
        if not (cause.fault is Fault.CLUSTER and whole):
            explained = labels
            # a reflection or a swap is in the shape of all markers
            if cause.fault not in (Fault.MARKER, Fault.CLUSTER):
                explained = self.clusters[segment].labels
            self.cleared[segment] = (*self.cleared.get(segment, ()), *explained)
        lost = set()
        for name, cluster in self.clusters.items():
            if cluster.borrowed and name != segment:
                from_pelvis = segment == "pelvis" and cluster.part == "thigh"
                if cluster.labels[-1] in labels or from_pelvis:
                    lost.add(name)
        self.clusters = {name: c for name, c in self.clusters.items() if name not in lost}
        gone = lost | {segment} if cause.fault is Fault.MIRRORED else lost
        self.links = {j: k for j, k in self.links.items() if gone.isdisjoint((k.above, k.below))}

    def list_unexplained(self, cluster: MarkerCluster, among: Sequence[int]) -> list[int]:
        """Return those of the point indices that no cause explains yet."""
        cleared = self.cleared.get(cluster.segment, ())
        return [i for i in among if cluster.labels[i] not in cleared]

    def compute_relation(self, link: JointLink) -> Pose:
        """Compute rotation (3, 3) and gap (3,) m of a joint with both segments' poses corrected."""
        rp, tp = self.pose.get(link.above, NO_MOTION)
        rq, tq = self.pose.get(link.below, NO_MOTION)
        centre = rq.T @ (link.centre - tq)
        carried = link.median_rotation @ (centre - link.centre) + link.carried_up
        return rp @ link.median_rotation @ rq.T, rp @ carried + tp - link.centre

    def list_axis_points(self, segment: str) -> Iterator[tuple[JointLink, Array, Array]]:
        """List a segment's joints with their axis points p (2, 3) m and q (2, 3) m."""
        for link in self.links.values():
            if segment not in (link.above, link.below):
                continue
            up = segment == link.above
            aside = [0.0, 0.0, link.reach]
            points = np.array([link.centre + aside, link.centre - aside])
            correction, shift = self.pose.get(link.below if up else link.above, NO_MOTION)
            rotation = link.median_rotation if up else link.median_rotation.T
            carried = link.carried_up if up else link.carried_down
            yield link, points, ((points - shift) @ correction - link.centre) @ rotation.T + carried

    def compute_excesses(self) -> dict[str, float]:
        """Compute segment or joint -> its largest ratio of a quantity to the limit, if above 1."""
        out = {name: self.compute_offset_excess(cluster) for name, cluster in self.clusters.items()}
        for joint, link in self.links.items():
            rotation, gap = self.compute_relation(link)
            ratios = np.abs(compute_root_angles(rotation)[1:]) / link.rotation_limits
            out[joint] = max(float(np.linalg.norm(gap)) / link.gap_limit, float(ratios.max()))
        return {name: value for name, value in out.items() if value > 1.0}

    def compute_offset_excess(self, cluster: MarkerCluster) -> float:
        """Compute the largest ratio of an offset of a cluster to the limit."""
        kept = self.list_unexplained(cluster, range(len(cluster.labels)))
        if len(kept) < FEWEST:
            return 0.0
        rotation, shift = align_points(cluster.shape[kept], cluster.static[kept])
        away = np.linalg.norm(
            cluster.shape[kept] @ rotation.T + shift - cluster.static[kept], axis=1
        )
        value = float((away / np.hypot(compute_offset_limit(cluster), cluster.scatter[kept])).max())
        # a smaller offset counts if it is constant in time
        if not cluster.reduced:
            least = cluster.size * STEADY_M
            steady = away / np.hypot(cluster.scatter[kept], JITTER_M)
            counted = (away > least) & (steady > STEADY_RATIO)
            value = max(value, float((away[counted] / least).max(initial=0.0)))
        return value

    def compute_cost(
        self,
        cluster: MarkerCluster,
        shape: Array | None = None,
        kept: Sequence[int] | None = None,
        *,
        joints: bool = True,
        slid: Sequence[int] = (),
    ) -> tuple[float, Pose]:
        """Compute J without price, and its C; the terms of the points `slid` hardly count."""
        shape = cluster.shape if shape is None else shape
        taken = self.list_unexplained(cluster, range(len(cluster.labels)) if kept is None else kept)
        sigma = np.hypot(compute_offset_limit(cluster), cluster.scatter[taken]) / SPREAD
        points, targets = [shape[taken]], [cluster.static[taken]]
        weights = [np.where(np.isin(taken, slid), SLID_WEIGHT, 1.0) * sigma**-2]
        for link, p, q in self.list_axis_points(cluster.segment) if joints else ():
            points.append(q)
            targets.append(p)
            weights.append(np.full(2, _compute_joint_weight(link)))
        a, b, w = np.concatenate(points), np.concatenate(targets), np.concatenate(weights)
        if len(a) < 2:
            return 0.0, NO_MOTION
        rotation, shift = align_points(a, b, w)
        return float(w @ ((a @ rotation.T + shift - b) ** 2).sum(axis=1)), (rotation, shift)


def _find_cheapest(body: _Body, excess: Mapping[str, float]) -> tuple[Contradiction, Pose] | None:
    """Find the explanation that leaves the least cost of the whole body, if it saves enough.

    A cause in the pelvis comes first if both thighs borrow from it.
    """
    best, least = None, np.inf
    both_hips = {"hip_r", "hip_l"} <= set(excess)
    for segment, cluster in body.clusters.items():
        is_pelvis = best is not None and best[0].segment == "pelvis"
        if is_pelvis and cluster.borrowed and both_hips:
            break
        joints = [link.joint for link in body.links.values() if segment in (link.above, link.below)]
        concerned = tuple(name for name in (segment, *joints) if name in excess)
        before, remaining = body.compute_cost(cluster)[0], None
        for found in _list_explanations(body, cluster):
            saving = _compute_saving(body, cluster, before, found)
            if saving <= (LIKELY if concerned else CERTAIN[found.fault.value]):
                continue
            # the cost of all others, once per segment
            if remaining is None:
                remaining = _compute_remaining_cost(body, segment)
            left = remaining + before - saving
            if left < least:
                worst = max((excess[name] for name in concerned), default=1.0)
                cause = _build_contradiction(body, cluster, found, worst, concerned or (segment,))
                best, least = (cause, found.pose), left
    return best


def _compute_remaining_cost(body: _Body, segment: str) -> float:
    """Compute the cost of all other clusters and of the joints of other segments."""
    total = sum(
        body.compute_cost(other, joints=False)[0]
        for name, other in body.clusters.items()
        if name != segment
    )
    for link in body.links.values():
        if segment not in (link.above, link.below):
            rotation, shift = body.pose.get(link.below, NO_MOTION)
            joints = body.list_axis_points(link.below)
            _, p, q = next(joint for joint in joints if joint[0] is link)
            total += _compute_joint_weight(link) * float(((q @ rotation.T + shift - p) ** 2).sum())
    return total


def _compute_saving(
    body: _Body, cluster: MarkerCluster, before: float, found: _Explanation
) -> float:
    """Compute how much an explanation lowers the cost `before` it, with borrowing clusters."""
    saving = before - found.cost
    if found.fault is not Fault.MARKER:
        return saving
    for name, other in body.clusters.items():
        if other.borrowed and name != cluster.segment and other.labels[-1] in found.labels:
            without = body.compute_cost(other, kept=range(len(other.labels) - 1))[0]
            return saving + body.compute_cost(other)[0] - without
    return saving


def _measure_centre_shift(body: _Body, segment: str, pose: Pose) -> float:
    """Measure how far a motion displaces a joint centre of the segment at most (m)."""
    centres = [link.centre for link in body.links.values() if segment in (link.above, link.below)]
    return max((float(np.linalg.norm(pose[0] @ c + pose[1] - c)) for c in centres), default=0.0)


def _list_explanations(body: _Body, cluster: MarkerCluster) -> Iterator[_Explanation]:
    """Generate the explanations for the markers of a cluster."""
    shape, labels = cluster.shape, cluster.labels
    n, count = len(labels), cluster.marker_count
    free = body.list_unexplained(cluster, range(count))
    # one marker moved
    for i in free:
        cost, (rotation, shift) = body.compute_cost(cluster, kept=[k for k in range(n) if k != i])
        distance = float(np.linalg.norm(rotation @ shape[i] + shift - cluster.static[i]))
        price = PRICE["marker"] + (distance / DISPLACEMENT_M) ** 2
        yield _Explanation(Fault.MARKER, (labels[i],), cost + price, (rotation, shift))
    # two labels are swapped
    for i, k in combinations(free, 2):
        if np.linalg.norm(cluster.static[i] - cluster.static[k]) < ALIKE_M:
            continue
        order = np.arange(n)
        order[[i, k]] = k, i
        cost, pose = body.compute_cost(cluster, shape[order])
        yield _Explanation(Fault.LABELS, (labels[i], labels[k]), cost + PRICE["labels"], pose)
    if len(free) == count and cluster.segment not in body.pose:
        # all markers slid
        inside = body.compute_cost(cluster, joints=False)[0]
        across, pose = body.compute_cost(cluster, slid=range(n))
        yield _Explanation(Fault.CLUSTER, labels[:count], inside + across + PRICE["cluster"], pose)
        # all markers slid that are not on landmarks
        if FEWEST <= len(cluster.loose) < count:
            among = body.compute_cost(cluster, kept=cluster.loose, joints=False)[0]
            others, bone = body.compute_cost(cluster, slid=cluster.loose)
            names = tuple(labels[i] for i in cluster.loose)
            yield _Explanation(Fault.CLUSTER, names, among + others + PRICE["loose"], bone)
        # the cluster is mirrored
        reflected = body.compute_cost(cluster, shape * [1.0, 1.0, -1.0], joints=False)[0]
        if not cluster.borrowed and reflected < MIRRORED**2 * inside:
            yield _Explanation(Fault.MIRRORED, labels, reflected + across + PRICE["mirrored"], pose)


def _compute_joint_weight(link: JointLink) -> float:
    """Compute the weight (1/m^2) of each of the two axis points of a joint."""
    return 0.5 * float(link.gap_limit / SPREAD) ** -2


def _build_contradiction(
    body: _Body,
    cluster: MarkerCluster,
    found: _Explanation,
    excess: float,
    exceeded_at: tuple[str, ...],
) -> Contradiction:
    """Describe an explanation as a cause."""
    rotation, shift = found.pose
    rows = [cluster.labels.index(label) for label in found.labels]
    present = cluster.shape[rows] @ rotation.T + shift
    away, angle = present - cluster.static[rows], compute_rotation_angle(rotation)
    direction = away[int(np.linalg.norm(away, axis=1).argmax())]
    if found.fault is Fault.CLUSTER:
        # motion of the cluster relative to the bone
        direction = away.mean(axis=0)
        angle = compute_rotation_angle(align_points(cluster.static[rows], present)[0])
    rivals: tuple[str, ...] = ()
    if found.fault is Fault.MARKER and cluster.marker_count < FEWEST:
        markers = cluster.labels[: cluster.marker_count]
        rivals = tuple(label for label in markers if label not in found.labels)
    return Contradiction(
        fault=found.fault,
        segment=cluster.segment,
        labels=found.labels,
        rotation=float(angle),
        shift=_measure_centre_shift(body, cluster.segment, found.pose),
        direction=direction,
        excess=excess,
        exceeded_at=exceeded_at,
        rivals=rivals,
    )


def _build_unexplained(body: _Body, joint: str, excess: float) -> Contradiction:
    """Describe a joint whose segments disagree without a known cause."""
    rotation, gap = body.compute_relation(body.links[joint])
    return Contradiction(
        fault=Fault.UNKNOWN,
        segment=joint,
        rotation=float(np.abs(compute_root_angles(rotation)[1:]).max()),
        shift=float(np.linalg.norm(gap)),
        direction=gap,
        excess=excess,
        exceeded_at=(joint,),
    )
