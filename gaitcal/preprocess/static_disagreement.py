"""What makes a trial's body another one than the static trial's: the one cause that explains it
best.

A trial contradicts the static one where a cluster's offsets, a joint's gap or its turn
(`marker_clusters.py`, `joint_links.py`) exceed what clean recordings show. A marker that moved bends its
cluster and, through the segment's pose, both joints of the segment; so the cause is sought with all
of them together. For a segment with markers m_i (static place s_i) and the axis points p_k of its
joints, which the neighbours have at q_k, every explanation has a cost

    J = min over rigid C of   sum_i |C m_i - s_i|^2 / sigma^2  +  sum_k |C q_k - p_k|^2 / (2 sigma_k^2)   +  price:

one marker left its place (without its term), two markers carry each other's label (m exchanged),
the cluster is mirrored (m reflected), or all of it, or all but the markers on landmarks, slid or
turned on the segment (the terms of those with a C of their own). The price is what a free quantity
gains by chance. The cheapest of the segments concerned is told; its C puts the pose right, all
quantities are read with it, and what is left is explained anew.

What is too weak to be told may be so all the same. An explanation that saves S of J is exp(S / 2)
times as likely as that nothing moved (its price holds the odds before anything was seen), and if it
is true the pose is wrong by its C. Over all explanations of a segment, weighed by their
probabilities, that is an error of its pose (`possible_moves`).
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
"""Largest offset of a cluster. 91 clean trials of 20 people (10 of them synthetic, with noise)
reach 5.4, 6.4, 5.2 and 6.1 mm."""
STEADY_M, STEADY_RATIO, JITTER_M = 0.007, 4.0, 0.0015
"""A smaller offset counts where it is so many times its own scatter in time, which is at least
JITTER.
"""
REDUCED = 1.6
"""Factor of the offset where a cluster of a large set borrows from the segment above, whose skin
moves otherwise; sets that always borrow stay within the limits without it."""
SPREAD = 3.0  # A limit is taken as so many standard deviations
PRICE = {"marker": 12.0, "labels": 4.0, "mirrored": 12.0, "cluster": 12.0, "loose": 18.0}
"""Of an explanation. A marker's way is three free quantities that the cluster tells sharply, a
cluster's motion and a mirror's plane are six and three that the joints tell roughly: by chance they
gain about as much. A cluster that left the landmarks of its segment behind looks like one of these
that moved: odds of 20 to 1 must speak for it."""
CERTAIN = {"marker": 5.0, "labels": 4.0, "mirrored": 4.0, "cluster": 4.0}
"""Saving from which a cause is told though no single quantity exceeds its limit. On 91 clean trials
of 20 people no marker saves more than 2.0, no cluster more than 0.1, no exchange anything."""
LIKELY = -6.0  # Saving from which a cause is taken for the quantities that exceed their limits
WAY_M = 0.04
"""Spread of the ways that markers go when they are put on again or lie elsewhere: a longer one is
the less likely.
"""
ALIKE_M = 0.008  # Two markers whose exchange moves neither by more are not told apart by it
SLID_WEIGHT = 1e-3
"""Weight of the markers of a cluster that moved as a whole: enough to tell its flexion, which
joints leave free.
"""
MIRRORED = 0.5  # Share of the offsets that a reflection may leave
MOST_CAUSES = 4

Pose = tuple[Array, Array]  # Rotation (3, 3) and shift (3,) m
NO_MOTION: Pose = (np.eye(3), np.zeros(3))


class Fault(Enum):
    """What can be wrong with a cluster."""

    MARKER = "marker"
    LABELS = "labels"
    MIRRORED = "mirrored"
    CLUSTER = "cluster"
    UNKNOWN = "unknown"


@dataclass(frozen=True, kw_only=True)
class Contradiction:
    """One cause, and what it does."""

    fault: Fault
    segment: str  # For an unknown cause the joint at which it is seen
    labels: tuple[str, ...] = ()
    rotation: float  # rad, by which the segment's pose is wrong
    shift: float  # m, by which the pose carries a joint centre away
    direction: Array
    """(3,) m, forward, up, to the right: offset of the marker, of the largest one, or by which a
    cluster slid.
    """
    excess: float  # How many times the limits were exceeded, the worst
    exceeded_at: tuple[str, ...]  # Segments and joints that exceeded their limits
    rivals: tuple[str, ...] = ()
    """Markers of which one elsewhere would look alike: the other one of a segment that has two."""

    @property
    def offset(self) -> float:
        """M."""
        return float(np.linalg.norm(self.direction))


@dataclass(frozen=True)
class _Explanation:
    fault: Fault
    labels: tuple[str, ...]
    cost: float  # With its price
    pose: Pose  # The C that belongs to it


def find_contradictions(
    clusters: Mapping[str, MarkerCluster], links: Mapping[str, JointLink]
) -> tuple[Contradiction, ...]:
    """The causes found in one trial, in the order in which they explain most."""
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
    """How far the pose of a segment may be wrong by what markers did since the static trial:
    standard deviations.
    """

    rotation: Array  # (3,) rad, about forward, up, to the right in the static posture
    shift: float  # m, at its joints


def find_possible_moves(
    clusters: Mapping[str, MarkerCluster], links: Mapping[str, JointLink]
) -> dict[str, PossibleMove]:
    """Segment -> what its markers may have done, told or not."""
    body, out = _Body(clusters, links), dict[str, PossibleMove]()
    for segment, cluster in clusters.items():
        before, found = body.compute_cost(cluster)[0], list(_list_explanations(body, cluster))
        share = softmax([0.0, *(0.5 * _compute_saving(body, cluster, before, e) for e in found)])[
            1:
        ]
        turns = np.array([Rotation.from_matrix(e.pose[0]).as_rotvec() for e in found]).reshape(
            -1, 3
        )
        shifts = np.array([_measure_centre_shift(body, segment, e.pose) for e in found])
        out[segment] = PossibleMove(np.sqrt(share @ turns**2), float(np.sqrt(share @ shifts**2)))
    return out


def compute_offset_limit(cluster: MarkerCluster) -> float:
    """m, largest offset of a marker of the cluster, in a person of its size."""
    usual = cluster.size * OFFSET_M[cluster.part] * (REDUCED if cluster.reduced else 1.0)
    return float(
        np.hypot(usual, SPREAD * np.sqrt(3.0) * cluster.compute_tissue_spread(together=True))
    )


@dataclass
class _Body:
    """The clusters and joints of one trial, and what was found wrong with them so far."""

    clusters: Mapping[str, MarkerCluster]
    links: Mapping[str, JointLink]
    pose: dict[str, Pose] = field(default_factory=dict)
    """Segment -> rigid motion that puts its mean shape where it belongs, where that is not the
    nearest.
    """
    cleared: dict[str, tuple[str, ...]] = field(
        default_factory=dict
    )  # Segment -> markers that are explained

    def apply_cause(self, cause: Contradiction, pose: Pose) -> None:
        """Put the pose of a segment right, and leave out what rested on what was wrong with it.

        These are the clusters that borrow of it and their joints, of a mirrored one its own joints
        too.
        """
        segment, labels = cause.segment, cause.labels
        self.pose[segment] = pose
        whole = len(labels) == self.clusters[segment].marker_count
        if not (
            cause.fault is Fault.CLUSTER and whole
        ):  # a reflection or an exchange is in the shape
            explained = (
                labels
                if cause.fault in (Fault.MARKER, Fault.CLUSTER)
                else self.clusters[segment].labels
            )
            self.cleared[segment] = (*self.cleared.get(segment, ()), *explained)
        lost = {
            name
            for name, c in self.clusters.items()
            if c.borrowed
            and name != segment
            and (c.labels[-1] in labels or (segment == "pelvis" and c.part == "thigh"))
        }
        self.clusters = {name: c for name, c in self.clusters.items() if name not in lost}
        gone = lost | {segment} if cause.fault is Fault.MIRRORED else lost
        self.links = {j: k for j, k in self.links.items() if gone.isdisjoint((k.above, k.below))}

    def list_unexplained(self, cluster: MarkerCluster, among: Sequence[int]) -> list[int]:
        """Those of the points that nothing explains yet."""
        cleared = self.cleared.get(cluster.segment, ())
        return [i for i in among if cluster.labels[i] not in cleared]

    def compute_relation(self, link: JointLink) -> Pose:
        """Turn (3, 3) and gap (3,) m of a joint, both segments' poses as corrected."""
        (rp, tp), (rq, tq) = (
            self.pose.get(segment, NO_MOTION) for segment in (link.above, link.below)
        )
        at = rq.T @ (link.centre - tq)
        carried = link.median_rotation @ (at - link.centre) + link.carried_up
        return rp @ link.median_rotation @ rq.T, rp @ carried + tp - link.centre

    def list_axis_points(self, segment: str) -> Iterator[tuple[JointLink, Array, Array]]:
        """Joint, p (2, 3) and q (2, 3) m, the axis points of a segment's joints where its
        neighbours have them.
        """
        for link in self.links.values():
            if segment not in (link.above, link.below):
                continue
            up = segment == link.above
            aside = [0.0, 0.0, link.reach]
            points = np.array([link.centre + aside, link.centre - aside])
            turn, shift = self.pose.get(link.below if up else link.above, NO_MOTION)
            rotation, carried = (
                (link.median_rotation, link.carried_up)
                if up
                else (link.median_rotation.T, link.carried_down)
            )
            yield link, points, ((points - shift) @ turn - link.centre) @ rotation.T + carried

    def compute_excesses(self) -> dict[str, float]:
        """Segment or joint -> the largest of its quantities in units of the limit, where that is
        above 1.
        """
        out = {name: self.compute_offset_excess(cluster) for name, cluster in self.clusters.items()}
        for joint, link in self.links.items():
            turn, gap = self.compute_relation(link)
            ratios = np.abs(compute_root_angles(turn)[1:]) / link.rotation_limits
            out[joint] = max(float(np.linalg.norm(gap)) / link.gap_limit, float(ratios.max()))
        return {name: value for name, value in out.items() if value > 1.0}

    def compute_offset_excess(self, cluster: MarkerCluster) -> float:
        """The largest offset of a cluster in units of the limit."""
        kept = self.list_unexplained(cluster, range(len(cluster.labels)))
        if len(kept) < FEWEST:
            return 0.0
        turn, shift = align_points(cluster.shape[kept], cluster.static[kept])
        away = np.linalg.norm(cluster.shape[kept] @ turn.T + shift - cluster.static[kept], axis=1)
        value = float((away / np.hypot(compute_offset_limit(cluster), cluster.scatter[kept])).max())
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
        """J without its price, and the C that makes it least, in which those that `slid` hardly
        count.
        """
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
        turn, shift = align_points(a, b, w)
        return float(w @ ((a @ turn.T + shift - b) ** 2).sum(axis=1)), (turn, shift)


def _find_cheapest(body: _Body, excess: Mapping[str, float]) -> tuple[Contradiction, Pose] | None:
    """The explanation that leaves least of the whole body, if it saves enough; of the pelvis first,
    where both thighs borrow from it.
    """
    best, least = None, np.inf
    for segment, cluster in body.clusters.items():
        if (
            best is not None
            and best[0].segment == "pelvis"
            and cluster.borrowed
            and {"hip_r", "hip_l"} <= set(excess)
        ):
            break
        joints = [link.joint for link in body.links.values() if segment in (link.above, link.below)]
        concerned = tuple(name for name in (segment, *joints) if name in excess)
        before, rest = body.compute_cost(cluster)[0], None
        for found in _list_explanations(body, cluster):
            saving = _compute_saving(body, cluster, before, found)
            if saving <= (LIKELY if concerned else CERTAIN[found.fault.value]):
                continue
            rest = _compute_remaining_cost(body, segment) if rest is None else rest
            left = rest + before - saving
            if left < least:
                worst = max((excess[name] for name in concerned), default=1.0)
                best, least = (
                    (
                        _build_contradiction(body, cluster, found, worst, concerned or (segment,)),
                        found.pose,
                    ),
                    left,
                )
    return best


def _compute_remaining_cost(body: _Body, segment: str) -> float:
    """Cost of all other clusters, and of the joints that are not this segment's, poses as they are."""
    total = sum(
        body.compute_cost(other, joints=False)[0]
        for name, other in body.clusters.items()
        if name != segment
    )
    for link in body.links.values():
        if segment not in (link.above, link.below):
            turn, shift = body.pose.get(link.below, NO_MOTION)
            _, p, q = next(seen for seen in body.list_axis_points(link.below) if seen[0] is link)
            total += _compute_joint_weight(link) * float(((q @ turn.T + shift - p) ** 2).sum())
    return total


def _compute_saving(
    body: _Body, cluster: MarkerCluster, before: float, found: _Explanation
) -> float:
    """What an explanation saves of the cost `before` it; a marker's absence, in the cluster that
    borrows it, too.
    """
    saving = before - found.cost
    for name, other in body.clusters.items() if found.fault is Fault.MARKER else ():
        if other.borrowed and name != cluster.segment and other.labels[-1] in found.labels:
            return (
                saving
                + body.compute_cost(other)[0]
                - body.compute_cost(other, kept=range(len(other.labels) - 1))[0]
            )
    return saving


def _measure_centre_shift(body: _Body, segment: str, pose: Pose) -> float:
    """m, the farthest that a motion carries a joint centre of the segment."""
    centres = [link.centre for link in body.links.values() if segment in (link.above, link.below)]
    return max((float(np.linalg.norm(pose[0] @ c + pose[1] - c)) for c in centres), default=0.0)


def _list_explanations(body: _Body, cluster: MarkerCluster) -> Iterator[_Explanation]:
    n, own, shape, labels = len(cluster.labels), cluster.marker_count, cluster.shape, cluster.labels
    free = body.list_unexplained(cluster, range(own))
    for i in free:
        cost, (turn, shift) = body.compute_cost(cluster, kept=[k for k in range(n) if k != i])
        way = float(np.linalg.norm(turn @ shape[i] + shift - cluster.static[i]))
        price = PRICE["marker"] + (way / WAY_M) ** 2
        yield _Explanation(Fault.MARKER, (labels[i],), cost + price, (turn, shift))
    for i, k in combinations(free, 2):
        if np.linalg.norm(cluster.static[i] - cluster.static[k]) < ALIKE_M:
            continue
        order = np.arange(n)
        order[[i, k]] = k, i
        cost, pose = body.compute_cost(cluster, shape[order])
        yield _Explanation(Fault.LABELS, (labels[i], labels[k]), cost + PRICE["labels"], pose)
    if len(free) == own and cluster.segment not in body.pose:
        inside = body.compute_cost(cluster, joints=False)[0]
        across, pose = body.compute_cost(cluster, slid=range(n))
        yield _Explanation(Fault.CLUSTER, labels[:own], inside + across + PRICE["cluster"], pose)
        if FEWEST <= len(cluster.loose) < own:
            among = body.compute_cost(cluster, kept=cluster.loose, joints=False)[0]
            rest, bone = body.compute_cost(cluster, slid=cluster.loose)
            names = tuple(labels[i] for i in cluster.loose)
            yield _Explanation(Fault.CLUSTER, names, among + rest + PRICE["loose"], bone)
        reflected = body.compute_cost(cluster, shape * [1.0, 1.0, -1.0], joints=False)[0]
        if not cluster.borrowed and reflected < MIRRORED**2 * inside:
            yield _Explanation(Fault.MIRRORED, labels, reflected + across + PRICE["mirrored"], pose)


def _compute_joint_weight(link: JointLink) -> float:
    """1/m^2, of each of the two axis points of a joint."""
    return 0.5 * float(link.gap_limit / SPREAD) ** -2


def _build_contradiction(
    body: _Body,
    cluster: MarkerCluster,
    found: _Explanation,
    excess: float,
    seen_at: tuple[str, ...],
) -> Contradiction:
    turn, shift = found.pose
    at = [cluster.labels.index(label) for label in found.labels]
    now = cluster.shape[at] @ turn.T + shift
    away, angle = now - cluster.static[at], compute_rotation_angle(turn)
    direction = away[int(np.linalg.norm(away, axis=1).argmax())]
    if found.fault is Fault.CLUSTER:
        direction, angle = (
            away.mean(axis=0),
            compute_rotation_angle(align_points(cluster.static[at], now)[0]),
        )
    of_two = found.fault is Fault.MARKER and cluster.marker_count < FEWEST
    return Contradiction(
        fault=found.fault,
        segment=cluster.segment,
        labels=found.labels,
        rotation=float(angle),
        shift=_measure_centre_shift(body, cluster.segment, found.pose),
        direction=direction,
        excess=excess,
        exceeded_at=seen_at,
        rivals=tuple(m for m in cluster.labels[: cluster.marker_count] if m not in found.labels)
        if of_two
        else (),
    )


def _build_unexplained(body: _Body, joint: str, excess: float) -> Contradiction:
    """A joint whose segments disagree for no reason that was found."""
    turn, gap = body.compute_relation(body.links[joint])
    return Contradiction(
        fault=Fault.UNKNOWN,
        segment=joint,
        rotation=float(np.abs(compute_root_angles(turn)[1:]).max()),
        shift=float(np.linalg.norm(gap)),
        direction=gap,
        excess=excess,
        exceeded_at=(joint,),
    )
