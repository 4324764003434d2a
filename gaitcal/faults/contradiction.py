"""What makes a trial's body another one than the static trial's: the one cause that explains it best.

A trial contradicts the static one where a cluster's offsets, a joint's gap or its turn (`cluster.py`, `joint_link.py`)
exceed what clean recordings show. A marker that moved bends its cluster and, through the segment's pose, both joints of
the segment; so the cause is sought with all of them together. For a segment with markers m_i (static place s_i) and the
axis points p_k of its joints, which the neighbours have at q_k, every explanation has a cost

    J = min over rigid C of   sum_i |C m_i - s_i|^2 / sigma^2  +  sum_k |C q_k - p_k|^2 / (2 sigma_k^2)   +  price:

one marker left its place (without its term), two markers carry each other's label (m exchanged), the cluster is
mirrored (m reflected), or all of it slid or turned on the segment (the two sums each with a C of its own). The price is
what a free quantity gains by chance. The cheapest of the segments concerned is told; what is left is explained anew.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import Enum
from itertools import combinations

import numpy as np

from gaitcal.arrays import Array
from gaitcal.faults.cluster import FEWEST, Cluster, alignment
from gaitcal.faults.trial_body import NO_MOTION, SPREAD, Body, JointLink, angle_of, gap_limit, offset_limit, side_turns

PRICE = {"marker": 12.0, "labels": 4.0, "mirrored": 12.0, "cluster": 12.0}
"""Of an explanation. A marker's way is three free quantities that the cluster tells sharply, a cluster's motion and a
mirror's plane are six and three that the joints tell roughly: by chance they gain about as much."""
CERTAIN = {"marker": 5.0, "labels": 4.0, "mirrored": 4.0, "cluster": 4.0}
"""Saving from which a cause is told though no single quantity exceeds its limit. On 91 clean trials of 20 people no
marker saves more than 2.0, no cluster more than 0.1, no exchange anything."""
LIKELY = -6.0
"""Saving from which a cause is taken for the quantities that exceed their limits."""
WAY_M = 0.04
"""Spread of the ways that markers go when they are put on again or lie elsewhere: a longer one is the less likely."""
ALIKE_M = 0.008
"""Two markers whose exchange moves neither by more are not told apart by it."""
LIGHTLY = 1e-3
"""Weight of the markers of a cluster that moved as a whole: enough to tell its flexion, which joints leave free."""
MIRRORED = 0.5
"""Share of the offsets that a reflection may leave."""
MOST_CAUSES = 4


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
    segment: str
    """For an unknown cause the joint at which it is seen."""
    labels: tuple[str, ...]
    offset: float
    """m: of the marker, of the largest one, or by which a cluster slid."""
    turn: float
    """rad, by which the segment's pose is wrong."""
    shift: float
    """m, by which the pose carries a joint centre away."""
    direction: Array
    """(3,) m, of the offset: forward, up, to the right."""
    excess: float
    """How many times the limits were exceeded, the worst."""
    seen_at: tuple[str, ...]
    """What exceeded its limit, in words."""
    rivals: tuple[str, ...] = ()
    """Markers of which one elsewhere would look alike: the other one of a segment that has two."""


def contradictions(
    clusters: Mapping[str, Cluster], links: Mapping[str, JointLink], strictness: float = 1.0
) -> tuple[Contradiction, ...]:
    """The causes found in one trial, in the order in which they explain most; `strictness`: factor of the limits."""
    body, found = Body(clusters, links, strictness=strictness), []
    for _ in range(MOST_CAUSES):
        excess = body.excesses()
        best = _cheapest(body, excess)
        if best is None:
            found += [_unexplained(body, joint, excess[joint]) for joint in excess if joint in links]
            break
        cause, pose, cleared = best
        found.append(cause)
        body.pose[cause.segment] = pose
        body.cleared[cause.segment] = (*body.cleared.get(cause.segment, ()), *cleared)
        body.forget(cause.segment, cause.labels, cause.fault is Fault.MIRRORED)
    return tuple(found)


_Explanation = tuple[Contradiction, tuple[Array, Array], tuple[str, ...]]


def _cheapest(body: Body, excess: Mapping[str, float]) -> _Explanation | None:
    """The explanation that leaves least of the whole body, if it saves enough; of the pelvis first, where both thighs
    borrow from it.
    """
    best, least = None, np.inf
    for segment, cluster in body.clusters.items():
        if best is not None and best[0].segment == "pelvis" and cluster.borrowed and {"hip_r", "hip_l"} <= set(excess):
            break
        joints = [link.joint for link in body.links.values() if segment in (link.above, link.below)]
        concerned = [name for name in (segment, *joints) if name in excess]
        before = _cost(body, cluster, cluster.shape, range(len(cluster.labels)))[0]
        rest = None
        for fault, labels, cost, pose, shape in _explanations(body, cluster):
            saving = before - cost + (_lent(body, segment, labels) if fault is Fault.MARKER else 0.0)
            if saving <= (LIKELY if concerned else CERTAIN[fault.value]):
                continue
            rest = _rest(body, segment) if rest is None else rest
            left = rest + before - saving
            if left < least:
                least = left
                worst = max((excess[name] for name in concerned), default=1.0)
                best = _told(body, cluster, fault, labels, pose, shape, worst, tuple(concerned) or (segment,))
    return best


def _rest(body: Body, segment: str) -> float:
    """Cost of all other clusters, and of the joints that are not this segment's, poses as they are."""
    total = 0.0
    for name, other in body.clusters.items():
        if name != segment:
            total += _cost(body, other, other.shape, range(len(other.labels)), joints=False)[0]
    for link in body.links.values():
        if segment not in (link.above, link.below):
            turn, shift = body.moved(link.below)
            _, p, q = next(seen for seen in body.seen_from(link.below) if seen[0] is link)
            total += _joint_weight(link) * float(((q @ turn.T + shift - p) ** 2).sum())
    return total


def _lent(body: Body, segment: str, labels: tuple[str, ...]) -> float:
    """What a marker's absence saves in the cluster that borrows it."""
    for name, other in body.clusters.items():
        if other.borrowed and name != segment and other.labels[-1] in labels:
            n = len(other.labels)
            return _cost(body, other, other.shape, range(n))[0] - _cost(body, other, other.shape, range(n - 1))[0]
    return 0.0


def _explanations(
    body: Body, cluster: Cluster
) -> Iterator[tuple[Fault, tuple[str, ...], float, tuple[Array, Array], Array]]:
    """Fault, markers, cost with its price, the pose that belongs to it, and the shape as it should have been."""
    n, own = len(cluster.labels), cluster.own
    free = [i for i in range(own) if cluster.labels[i] not in body.cleared.get(cluster.segment, ())]
    for i in free:
        cost, (turn, shift) = _cost(body, cluster, cluster.shape, [k for k in range(n) if k != i])
        way = float(np.linalg.norm(turn @ cluster.shape[i] + shift - cluster.static[i]))
        price = PRICE["marker"] + (way / WAY_M) ** 2
        yield Fault.MARKER, (cluster.labels[i],), cost + price, (turn, shift), cluster.shape
    for i, k in combinations(free, 2):
        if np.linalg.norm(cluster.static[i] - cluster.static[k]) < ALIKE_M:
            continue
        order = np.arange(n)
        order[[i, k]] = k, i
        shape = cluster.shape[order]
        cost, pose = _cost(body, cluster, shape, range(n))
        yield Fault.LABELS, (cluster.labels[i], cluster.labels[k]), cost + PRICE["labels"], pose, shape
    if len(free) == own and cluster.segment not in body.pose:
        inside = _cost(body, cluster, cluster.shape, range(n), joints=False)[0]
        across, pose = _cost(body, cluster, cluster.shape, range(n), markers=LIGHTLY)
        yield Fault.CLUSTER, cluster.labels[:own], inside + across + PRICE["cluster"], pose, cluster.shape
        reflected = _cost(body, cluster, cluster.shape * [1.0, 1.0, -1.0], range(n), joints=False)[0]
        if not cluster.borrowed and reflected < MIRRORED**2 * inside:
            yield Fault.MIRRORED, cluster.labels, reflected + across + PRICE["mirrored"], pose, cluster.shape


def _cost(
    body: Body, cluster: Cluster, shape: Array, kept: range | list[int], joints: bool = True, markers: float = 1.0
) -> tuple[float, tuple[Array, Array]]:
    """J without its price, and the C that makes it least; `markers`: factor of their weight."""
    taken = [i for i in kept if cluster.labels[i] not in body.cleared.get(cluster.segment, ())]
    sigma = offset_limit(cluster) / SPREAD
    points, targets = [shape[taken]], [cluster.static[taken]]
    weights = [np.full(len(taken), markers * sigma**-2)]
    for link, p, q in body.seen_from(cluster.segment) if joints else ():
        points.append(q)
        targets.append(p)
        weights.append(np.full(2, _joint_weight(link)))
    a, b, w = np.concatenate(points), np.concatenate(targets), np.concatenate(weights)
    if len(a) < 2:
        return 0.0, NO_MOTION
    turn, shift = alignment(a, b, w)
    return float(w @ ((a @ turn.T + shift - b) ** 2).sum(axis=1)), (turn, shift)


def _joint_weight(link: JointLink) -> float:
    """1/m^2, of each of the two axis points of a joint."""
    return 0.5 * float(gap_limit(link) / SPREAD) ** -2


def _told(
    body: Body,
    cluster: Cluster,
    fault: Fault,
    labels: tuple[str, ...],
    pose: tuple[Array, Array],
    shape: Array,
    excess: float,
    seen_at: tuple[str, ...],
) -> _Explanation:
    turn, shift = pose
    own = cluster.own
    at = [cluster.labels.index(label) for label in labels]
    centres = [link.centre for link in body.links.values() if cluster.segment in (link.above, link.below)]
    moved = [turn @ c + shift - c for c in centres]
    if fault is Fault.CLUSTER:
        direction = -(turn @ cluster.static.mean(axis=0) + shift - cluster.static.mean(axis=0))
    else:
        away = cluster.shape[at] @ turn.T + shift - cluster.static[at]
        direction = away[int(np.linalg.norm(away, axis=1).argmax())]
    cause = Contradiction(
        fault=fault,
        segment=cluster.segment,
        labels=labels,
        offset=float(np.linalg.norm(direction)),
        turn=float(angle_of(turn)),
        shift=max((float(np.linalg.norm(m)) for m in moved), default=0.0),
        direction=direction,
        excess=excess,
        seen_at=seen_at,
        rivals=tuple(m for m in cluster.labels[:own] if m not in labels)
        if fault is Fault.MARKER and own < FEWEST
        else (),
    )
    # The reflection or the exchange is in the shape: what is left to be explained is judged without these markers.
    cleared = cluster.labels if fault in (Fault.MIRRORED, Fault.LABELS) else labels if fault is Fault.MARKER else ()
    return cause, pose, cleared


def _unexplained(body: Body, joint: str, excess: float) -> Contradiction:
    """A joint whose segments disagree for no reason that was found."""
    turn, gap = body.relation(body.links[joint])
    return Contradiction(
        fault=Fault.UNKNOWN,
        segment=joint,
        labels=(),
        offset=float(np.linalg.norm(gap)),
        turn=float(np.abs(side_turns(turn)).max()),
        shift=float(np.linalg.norm(gap)),
        direction=gap,
        excess=excess,
        seen_at=(joint,),
    )
